# %% [markdown]
# # How safe is a slope?
#
# Strength reduction divides cohesion and $\tan\varphi$ of a soil by a factor $F$, loads the body
# by its weight, and looks for the $F$ at which it fails: the factor of safety. Griffiths and Lane
# (1999, doi 10.1680/geot.1999.49.3.387) do so for a homogeneous slope of 26.57°, two to one, on a
# rigid base at the level of its toe, with $\varphi = 20°$, $c/(\gamma H) = 0.05$ and no dilation,
# and find 1.4; Bishop and Morgenstern's charts say 1.38.
#
# A run has failed if gravity cannot be applied in full, if the largest displacement leaves the
# line that it followed at first, or if the slope does not come to rest under its whole weight. A
# ghost penalty resists the increment of each step, so that a slope that fails can stand in one
# step. It moves on in the next ones. In units of $\gamma H^2/E$, with cells of 1 m, GIMP and
# F-bar, the displacement is 0.38 for $F = 1$, 0.68 at 1.39 and 1.2 at 1.41, where it fails.
#
# The soil shears at constant volume. Linear functions and GIMP then lock, and the slope seems
# safer than it is. Factors found, with 2² points per cell:
#
# | | $h$ = 2 m | 1 m | 0.5 m |
# |---|---|---|---|
# | GIMP | 1.539 | 1.477 | 1.430 |
# | GIMP with F-bar | 1.445 | 1.398 | 1.367 |
# | quadratic splines | 1.430 | 1.398 | 1.367 |
# | quadratic splines with F-bar | 1.414 | 1.398 | 1.352 |
#
# `--scene cut` is a vertical cut in clay without friction, of the height $3.776\,c/\gamma$, which
# stands as long as $F < 1$ (between 3.7752 and 3.7776: Kammoun, Pastor, Smaoui & Pastor 2010, doi
# 10.1002/nag.887). Factors with GIMP and F-bar, with a ghost penalty and with aggregation:
#
# | | $h$ = 2 m | 1 m | 0.5 m |
# |---|---|---|---|
# | ghost penalty | 1.134 | 1.079 | 1.046 |
# | aggregation | 1.123 | 1.068 | 1.035 |

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
# depth below the foot of a cut, and width beside it (m)
FOOT, BESIDE = 10.0, 18.0
PUBLISHED = {"slope": 1.4, "cut": 1.0}
# γH/c of a vertical cut that just stands
CUT = 3.776
SCALE = UNIT_WEIGHT * HEIGHT**2 / E


@dataclass
class Input(Options):
    """Factor of safety of a homogeneous slope by reduction of its strength."""

    scene: str = option("slope", choices=("slope", "cut"))
    h: float = positive(1.0, "size of the cells (m), divides 2")
    points_per_cell: int = natural(2, "in each direction")
    basis: str = option("gimp", choices=BASES)
    fbar: str = switch("on")
    strain: str = option("large", choices=("large", "small", "jaumann"))
    stabilisation: str = "ghost"
    dilation: float = option(0.0, "dilation angle (degrees)")
    steps: int = natural(10, "of gravity")
    low: float | None = option(None, "a factor at which it stands; 1, and 0.8 for the cut")
    high: float | None = option(None, "a factor at which it fails; 2, and 1.5 for the cut")
    tolerance: float = option(0.02, "of the factor")
    growth: float = option(3.0, "of displacements at failure")

    def _check(self):
        cut = self.scene == "cut"
        self.fill(low=0.8 if cut else 1.0, high=1.5 if cut else 2.0)
        if self.h > 2 or abs(2 / self.h - round(2 / self.h)) > 1e-9:
            raise ValueError(f"h = {self.h:g} m must divide 2 m")


# %% [markdown]
# ## One trial: the slope with its strength divided by a factor
# A generator: it builds body and problem, and then sets the load of one step after the other.


# %%
def outline(scene):
    """Corners of the body (m)."""
    if scene == "slope":
        return [(0, 0), (CREST + RUN, 0), (CREST, HEIGHT), (0, HEIGHT)]
    top, width = FOOT + HEIGHT, CREST + BESIDE
    return [(0, 0), (width, 0), (width, FOOT), (CREST, FOOT), (CREST, top), (0, top)]


def soil_of(args, factor):
    """The law with its strength divided by a factor."""
    if args.scene == "cut":
        return mpm.materials.Tresca(E, NU, UNIT_WEIGHT * HEIGHT / CUT / factor)
    cohesion, friction = study.reduced_strength(COHESION, FRICTION, factor)
    return mpm.materials.MohrCoulomb(E, NU, cohesion, friction, dilation_angle=args.dilation)


def slope(factor, args):
    """Gravity on the body with strength divided by the factor, step by step."""
    corners, cut = outline(args.scene), args.scene == "cut"
    # room for what slides, above the ground and, for the slope, at its side
    size = (max(x for x, _ in corners) + (0.0 if cut else ROOM), max(y for _, y in corners) + 2.0)
    cells = [round(length / args.h) for length in size]
    grid = box_grid([(0, 0), size], cells)
    points = mpm.fill(grid, mpm.Polygon(corners), args.points_per_cell, UNIT_WEIGHT / GRAVITY)
    V = mpm.Space(grid, args.basis)
    u, v = V.increment, V.test
    gravity = fem.Constant(grid, (0.0, 0.0))
    soil = soil_of(args, factor)
    F = mpm.momentum(soil, points, u, v, strain=args.strain, fbar=args.fbar == "on")
    F -= ufl.inner(points.density * gravity, v) * points.dX
    sides = ("left", "right") if cut else ("left",)
    bcs = mpm.rollers(V, *sides) + mpm.fixed(V, "bottom")
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
    f"{found.bracket[1]:.4f}; published {PUBLISHED[args.scene]}. Failure: {found.criterion}"
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
        "published": PUBLISHED[args.scene],
        "error": found.factor / PUBLISHED[args.scene] - 1,
        "criterion": found.criterion,
        "trials": found.table(),
        "displacement_scale": SCALE,
        "seconds": time.perf_counter() - started,
        "ranks": MPI.COMM_WORLD.size,
    },
)
