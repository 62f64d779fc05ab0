# %% [markdown]
# # Small cuts: conditioning and critical time steps
#
# A body moves through the background grid. It fills only a sliver of some cells. The basis
# functions of such cells have almost no mass and no stiffness. So the condition numbers
# $\kappa(K)$ and $\kappa(M)$ and the critical time step
#
# $$\Delta t_{\mathrm{crit}} = \frac{2}{\sqrt{\lambda_{\max}}},\qquad K x = \lambda M x,$$
#
# depend on the place of the body. Here a free elastic block is put at many places, in 2D also at
# many angles. $K$ and $M$ are assembled at each place. $\kappa(K)$ leaves out the rigid modes.
#
# In 1D the block is four cells long, with two points per cell and unit stiffness and density
# (Coombs 2023, doi 10.1002/nme.7332). Only full cells are roots of aggregation. In 2D the block
# is eight cells wide, with 3² points per cell. Cubic splines need so many points. A turned block
# must also have room for roots of four by four functions. In 2D the ghost penalty of linear
# functions and of GIMP is ten times the published one: with E/30, the worst place of linear
# functions has thirty times the κ(K) of an uncut block.

# %%
from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from grids import box_grid
from mpi4py import MPI
from options import BASES, Options, natural, option
from scene import finish, say, stabilisation

import dolfinmpm as mpm
from dolfinmpm import study

# the places of the published sweep, in units of the cell
PUBLISHED = (1e-6, 1e-4, 1e-3, 0.01, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.7, 0.9, 0.999, 1 - 1e-6)
E, NU, RHO = 1.0, 0.0, 1.0


# %% [markdown]
# ## A block anywhere on the grid


# %%
def block(args, dimension, offset, angle=0.0):
    """The block at an offset (cells) and an angle (degrees): its conditioning."""
    h = args.spacing
    length, n = (4 * h, 8) if dimension == 1 else (8 * h, 14)
    if dimension == 1:
        grid = box_grid([(0.0,), (n * h,)], (n,))
        body = mpm.Box(2 * h + offset * h, 2 * h + offset * h + length)
        points = mpm.fill(grid, body, args.points_per_cell, RHO, aligned="body")
    else:
        grid = box_grid([(0, 0), (n * h, n * h)], (n, n))
        corner = np.array([3 * h + offset * h, 3 * h + 0.7 * offset * h])
        body = mpm.TurnedBox(corner, corner + length, angle)
        points = mpm.fill(grid, body, args.points_per_cell, RHO, aligned="body")
    V = mpm.Space(grid, args.basis)
    chosen = stabilisation(
        args.stabilisation, E=E, nu=NU, factor=args.factor_k, threshold=args.threshold,
        scaling=args.scaling, eta=args.eta,
    )  # fmt: skip
    F = mpm.momentum(mpm.materials.Hencky(E=E, nu=NU), points, V.increment, V.test)
    problem = mpm.QuasiStatic(F, V.increment, points, stabilisation=chosen)
    found = study.conditioning(problem, RHO, args.factor_m)
    if args.jacobi:
        K, modes = problem.stiffness(), study.rigid_modes(problem.here)
        kappa = study.condition_number(K, kernel=modes, scaled=True)
        return replace(found, kappa_K=kappa)
    return found


@dataclass
class Input(Options):
    """Condition numbers and critical steps of a block pushed through the grid."""

    dimension: int = option(1, choices=(1, 2))
    basis: str = option("gimp", choices=BASES)
    stabilisation: str = option(
        "ghost", choices=("none", "ghost", "aggregation", "weak-aggregation", "extended", "soft")
    )
    offsets: str | None = option(
        None, "number of places, or places in cells by commas; the published ones in 1D"
    )
    factor_k: float | None = option(
        None, "penalty of K, units of E/30; by default that of the basis, in 2D 10 if it is linear"
    )
    factor_m: float = option(1.0, "penalty of M, units of ρ/4")
    scaling: str = option("scaled", choices=("scaled", "literal"))
    threshold: float | None = option(None, "filled share of a root cell; 0.995 in 1D, 0.9 in 2D")
    jacobi: bool = option(False, "κ(K) of the matrix scaled to a diagonal of 1")
    eta: float = option(3e-2, "share of soft stiffness")
    spacing: float = option(1.0, "size of the cells h (m)")
    points_per_cell: int | None = natural(None, "2 in 1D, 3 in 2D")

    def _check(self):
        self.fill(threshold=0.995 if self.dimension == 1 else 0.9)
        linear = self.basis in ("linear", "gimp") and self.stabilisation == "ghost"
        if self.dimension == 2 and linear:
            self.fill(factor_k=10.0)
        self.fill(points_per_cell=2 if self.dimension == 1 else 3)


# %%
args = Input.parse()
wave = args.spacing / np.sqrt(E / RHO)
if args.offsets is None:
    offsets = list(PUBLISHED) if args.dimension == 1 else list(np.linspace(0, 1, 40))
elif "," in args.offsets or "." in args.offsets:
    offsets = [float(a) for a in args.offsets.split(",")]
else:
    # low-discrepancy places, so that no offset meets only one angle
    offsets = [float(k * (np.sqrt(5) - 1) / 2 % 1) for k in range(1, int(args.offsets) + 1)]
angles = [0.0] * len(offsets)
if args.dimension == 2:
    angles = [float(k * (np.sqrt(2) - 1) % 1 * 90) for k in range(len(offsets))]

rows = study.sweep(
    lambda place: block(args, args.dimension, *place), list(zip(offsets, angles)), label="places"
)
for row in rows:
    row["offset"], row["angle"] = row.pop("place")
    # steps in units of h/c
    row["dt_consistent"] /= wave
    row["dt_lumped"] /= wave
worst = study.worst(rows)
scaled = [row["kappa_K"] for row in rows]
say(
    f"{args.dimension}D, {args.basis}, {args.stabilisation}, {len(rows)} places, worst: "
    f"κ(K) {worst['kappa_K']:.4g} ({max(scaled) / min(scaled):.3g} times the best), "
    f"κ(M) {worst['kappa_M']:.4g}, Δt c/h {worst['dt_consistent']:.4g} with consistent and "
    f"{worst['dt_lumped']:.4g} with lumped mass"
)

# %% [markdown]
# ## Picture and table

# %%
name = f"conditioning_{args.dimension}d_{args.basis}_{args.stabilisation}"
if not args.no_plot:
    study.write_table(rows, args.output / f"{name}.csv")
if not args.no_plot and MPI.COMM_WORLD.rank == 0:
    # turned blocks lie apart from each other, however close their offsets are
    style = {} if args.dimension == 1 else {"linestyle": "none"}
    steps = {"dt_consistent": "consistent mass", "dt_lumped": "lumped mass"}
    with mpm.figure(args.output / f"{name}.png", 6.5, 2.8, ncols=2) as (_, (left, right)):
        study.draw_sweep(
            left, rows, x="offset", keys={"kappa_K": "κ(K)", "kappa_M": "κ(M)"}, **style
        )
        left.set(xlabel="offset (cells)", ylabel="condition number")
        study.draw_sweep(right, rows, x="offset", keys=steps, **style)
        right.set(xlabel="offset (cells)", ylabel="critical step Δt c/h")

finish(args, {"places": rows, "worst": worst, "ranks": MPI.COMM_WORLD.size})
