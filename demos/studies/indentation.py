# %% [markdown]
# # Which modulus does an indentation test tell? A published inverse problem
#
# A quarter of a block of saturated neo-Hookean ground, 5 m wide and deep, carries a smooth rigid
# footing. Its half-width is 1 m. In 25 steps of 0.1 s it sinks by 0.02 m each. GeoWarp (Zhao and
# others 2025, arXiv 2507.09435) differentiates this problem backwards through its kernels on a
# graphics card, and descends along the gradient from E = 1 MPa to the modulus that gives a measured
# force. Here `study.differentiate` finds force and derivative in one run.
#
# Three things check the derivative: differences of whole runs; dimensions, since the force over E
# depends on the product of E and the permeability only; and a second run with the modulus that one
# step of Newton's method finds. GeoWarp's target is a stiffness of 13 567 kN/m at E = 10 MPa, with
# cells of 0.25 m and 64 points per cell: `--cells 20 --points-per-cell 4`. Its points begin inside
# the footing by half their size, so that the footing sinks by 0.53 m in all.
#
# With two points per direction and cells of 0.5 m, the stiffness is 1219 kN/m at E = 1 MPa. Cells
# of 0.25 m (`--cells 20`) change it by about 1 %. So cells do not explain the 1357 kN/m of
# GeoWarp. The edge of the footing may: a half-width of 1.25 m gives 1973 kN/m, so some 5 cm would
# explain the difference.

# %%
from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from derivative_scenes import by_whole_runs, grid_of, history_of, in_time
from options import Options, natural, option, positive, values
from scene import finish, say

import dolfinmpm as mpm
from dolfinmpm import study

NAMES = ("E", "mobility")


# %%
@dataclass
class Input(Options):
    """Indentation of saturated ground, and the modulus that a force tells."""

    cells: int = natural(10, "along the block's 5 m, in multiples of 5")
    points_per_cell: int = natural(2, "in each direction")
    steps: int = natural(25, "of 0.02 m")
    modulus: float = positive(1e6, "Young's modulus of the ground (Pa)")
    mobility: float = positive(1e-11, "permeability over viscosity (m²/(Pa s))")
    target: float = positive(1.2, "measured force by the force with this modulus")
    difference: float = positive(1e-4, "h of the differences of whole runs")
    checked: list[str] = option(
        list(NAMES), "derivatives to compare with whole runs", type=values(str, NAMES)
    )


args = Input.parse()
SIDE, WIDTH, STEP, DT, OFFSET = 5.0, 1.0, 0.02, 0.1, 0.03125  # m, m, m, s, m
GAMMA = 9810.0  # weight of water (N/m³)


# %% [markdown]
# ## The problem
# The penalty of the footing grows with the modulus, as GeoWarp's does. The top drains.


# %%
def scene(m):
    """The block and its footing; the figure is the force on a quarter of the footing (N)."""
    h = SIDE / args.cells
    grid = grid_of((SIDE, SIDE, SIDE + h), (args.cells, args.cells, args.cells + 1))
    points = mpm.fill(grid, mpm.Box((0, 0, 0), (SIDE,) * 3), args.points_per_cell, 1500.0)
    V, Q = mpm.Space(grid, "gimp"), mpm.Space(grid, "gimp", shape=())
    u, v, p, q = V.increment, V.test, Q.increment, Q.test
    top = mpm.Surface(points, lambda x: x[2] > SIDE - 1e-9, (0, 0, 1), name="top")
    under = mpm.Surface(
        points, lambda x: (x[2] > SIDE - 1e-9) & (x[0] < WIDTH) & (x[1] < WIDTH), (0, 0, 1),
        name="under",
    )  # fmt: skip
    F = mpm.poromechanics(
        mpm.materials.NeoHookean(m["E"], 0.3), points, (u, p), (v, q),
        permeability=m["mobility"] * GAMMA, porosity=0.5, drained=top,
    )  # fmt: skip

    def sunk(t):
        return (0.0, 0.0, -OFFSET * min(t / DT, 1.0) - STEP * t / DT)

    footing = mpm.RigidBody(mpm.Plane((0, 0, SIDE), (0, 0, -1)), displacement=sunk, name="footing")
    F += mpm.contact(footing, points, u, v, stiffness_per_area=1e3 * m["E"], surface=under)
    bcs = mpm.rollers(V, "left", "right", "front", "back", "bottom")
    problem = mpm.Transient(
        F, [u, p], points, bcs, stabilisation=["ghost", "ghost"], tolerance=1e-11
    )
    times = [DT * (k + 1) for k in range(args.steps)]
    return study.Run(problem, in_time(problem, times), {"force": lambda: footing.force[2]})


# %% [markdown]
# ## Force, derivative, and the modulus of a measured force

# %%
parameters = {"E": args.modulus, "mobility": args.mobility}
# positions round the force of so stiff a footing in its 12th digit: a wider perturbation
found = study.differentiate(scene, parameters, central=True)
force = found.figures["force"]
by = {k: d / force for k, d in found.derivatives["force"].items()}
stiffness = float(force[-1] / (STEP * args.steps))
say(f"stiffness {stiffness / 1e3:.1f} kN/m, dF/dE {by['E'][-1] * force[-1] / args.modulus:.4f} m²")
say(f"dlnF/dlnE {by['E'][-1]:.6f}, dlnF/dlnk {by['mobility'][-1]:.2e}")
by_dimensions = float(np.abs(by["E"] - by["mobility"] - 1.0).max())
say(f"largest error by dimensions {by_dimensions:.1e}")

apart = {}
for name in args.checked:
    whole = by_whole_runs(scene, parameters, name, found.scales[name], args.difference)
    apart[name] = float(np.abs(whole["force"] / force - by[name]).max())
    say(f"{name}: {apart[name]:.1e} from differences of whole runs")

# %%
# one step of Newton's method on ln F of ln E, as ln F is almost linear in ln E
fitted = args.modulus * args.target ** (1.0 / by["E"][-1])
again = history_of(scene, {**parameters, "E": fitted})["force"][-1]
missed = float(again / (args.target * force[-1]) - 1.0)
say(f"modulus {fitted / 1e6:.4f} MPa for {args.target:g} times the force, missed by {missed:.1e}")

if not args.no_plot:
    sunk = OFFSET + STEP * np.arange(1, args.steps + 1)
    with mpm.figure(args.output / "indentation.png", 6.4, 2.6, ncols=2) as (_, axes):
        axes[0].plot(sunk, force / 1e3)
        axes[0].set(xlabel="settlement (m)", ylabel="force (kN)")
        for name, value in by.items():
            axes[1].plot(sunk, value, label=f"by ln {name}")
        axes[1].set(xlabel="settlement (m)", ylabel="derivative of ln force")
        axes[1].legend()
finish(args, {"stiffness": stiffness, "by_ln": {k: float(v[-1]) for k, v in by.items()},
              "apart": apart, "by_dimensions": by_dimensions, "fitted": fitted,
              "missed": missed, "seconds": found.seconds, "notes": found.notes})  # fmt: skip
