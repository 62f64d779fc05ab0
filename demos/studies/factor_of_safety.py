# %% [markdown]
# # How safe is a slope?
#
# Strength reduction divides cohesion and $\tan\varphi$ of a soil by a factor $F$, loads the body
# by its weight, and looks for the $F$ at which it fails: the factor of safety. Griffiths and Lane
# (1999, doi 10.1680/geot.1999.49.3.387) do so for a homogeneous slope of 26.57°, two to one, on a
# rigid base at the level of its toe, with $\varphi = 20°$, $c/(\gamma H) = 0.05$ and no dilation,
# and find 1.4; Bishop and Morgenstern's charts say 1.38.
#
# A run has failed if gravity cannot be applied in full, or if the largest displacement leaves the
# line that it followed at first. In units of $\gamma H^2/E$, with cells of 1 m, GIMP and F-bar,
# this displacement is 0.38 for $F = 1$, 0.8 at 1.41 and 6.1 at 1.45.
#
# The soil shears at constant volume. Linear functions and GIMP then lock, and the slope seems
# safer than it is. Factors found, with 2² points per cell:
#
# | | $h$ = 2 m | 1 m | 0.5 m |
# |---|---|---|---|
# | GIMP | 1.555 | 1.508 | 1.430 |
# | GIMP with F-bar | 1.492 | 1.414 | 1.367 |
# | quadratic splines | 1.477 | 1.414 | 1.367 |
# | quadratic splines with F-bar | 1.461 | 1.398 | 1.367 |

# %%
from __future__ import annotations

import time
from dataclasses import dataclass

import ufl
from dolfinx import fem
from grids import box_grid
from mpi4py import MPI
from options import BASES, Options, natural, option, positive, switch
from scene import finish, say

import dolfinmpm as mpm
from dolfinmpm import study

HEIGHT, CREST, RUN = 10.0, 12.0, 20.0
E, NU, UNIT_WEIGHT, GRAVITY = 1e8, 0.3, 20e3, 10.0
COHESION, FRICTION = 0.05 * UNIT_WEIGHT * HEIGHT, 20.0
ROOM = 4.0
PUBLISHED = 1.4
SCALE = UNIT_WEIGHT * HEIGHT**2 / E


@dataclass
class Input(Options):
    """Factor of safety of a homogeneous slope by reduction of its strength."""

    h: float = positive(1.0, "size of the cells (m), divides 2")
    points_per_cell: int = natural(2, "in each direction")
    basis: str = option("gimp", choices=BASES)
    fbar: str = switch("on")
    strain: str = option("large", choices=("large", "small", "jaumann"))
    stabilisation: str = "ghost"
    dilation: float = option(0.0, "dilation angle (degrees)")
    steps: int = natural(10, "of gravity")
    low: float = option(1.0, "a factor at which it stands")
    high: float = option(2.0, "a factor at which it fails")
    tolerance: float = option(0.02, "of the factor")
    growth: float = option(3.0, "of displacements at failure")

    def _check(self):
        if self.h > 2 or abs(2 / self.h - round(2 / self.h)) > 1e-9:
            raise ValueError(f"h = {self.h:g} m must divide 2 m")


# %% [markdown]
# ## One trial: the slope with its strength divided by a factor
# A generator: it builds body and problem, and then sets the load of one step after the other.


# %%
def slope(factor, args):
    """Gravity on the slope with strength divided by the factor, step by step."""
    size = CREST + RUN + ROOM, HEIGHT + 2.0
    cells = [round(length / args.h) for length in size]
    grid = box_grid([(0, 0), size], cells)
    outline = mpm.Polygon([(0, 0), (CREST + RUN, 0), (CREST, HEIGHT), (0, HEIGHT)])
    points = mpm.fill(grid, outline, args.points_per_cell, UNIT_WEIGHT / GRAVITY)
    V = mpm.Space(grid, args.basis)
    u, v = V.increment, V.test
    cohesion, friction = study.reduced_strength(COHESION, FRICTION, factor)
    soil = mpm.materials.MohrCoulomb(E, NU, cohesion, friction, dilation_angle=args.dilation)
    gravity = fem.Constant(grid, (0.0, 0.0))
    F = mpm.momentum(soil, points, u, v, strain=args.strain, fbar=args.fbar == "on")
    F -= ufl.inner(points.density * gravity, v) * points.dX
    bcs = mpm.rollers(V, "left") + mpm.fixed(V, "bottom")
    problem = mpm.QuasiStatic(F, u, points, bcs, stabilisation=args.stabilisation, max_halvings=4)
    for step in range(1, args.steps + 1):
        gravity.value[1] = -GRAVITY * step / args.steps
        yield problem


# %%
args = Input.parse()
started = time.perf_counter()
found = study.factor_of_safety(
    lambda factor: slope(factor, args), args.low, args.high, tolerance=args.tolerance,
    growth=args.growth,
)  # fmt: skip
for trial in found.trials:
    say(
        f"F = {trial.factor:.4f}: E δ/(γH²) = {trial.displacement / SCALE:6.2f} after "
        f"{trial.steps} of {args.steps} steps, {trial.iterations} iterations; "
        f"{'stands' if trial.stands else 'fails ' + trial.reason.split(':')[0]}"
    )
say(
    f"factor of safety {found.factor:.3f}, between {found.bracket[0]:.4f} and "
    f"{found.bracket[1]:.4f}; published {PUBLISHED}. Failure: {found.criterion}"
)

# %% [markdown]
# ## Picture and table

# %%
if not args.no_plot:
    study.write_table(found.table(), args.output / "factor_of_safety.csv")
    with mpm.figure(args.output / "factor_of_safety.png") as (_, axes):
        study.draw_reduction(axes, found.table(), scale=SCALE)
        axes.set_ylabel(r"largest displacement $E\delta/(\gamma H^2)$")

finish(
    args,
    {
        "factor": found.factor,
        "bracket": found.bracket,
        "published": PUBLISHED,
        "error": found.factor / PUBLISHED - 1,
        "criterion": found.criterion,
        "trials": found.table(),
        "displacement_scale": SCALE,
        "seconds": time.perf_counter() - started,
        "ranks": MPI.COMM_WORLD.size,
    },
)
