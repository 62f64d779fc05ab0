# %% [markdown]
# # A round column of sand collapses
#
# A cylinder of sand of radius $R$ and height $H = aR$ collapses under its weight. Lube, Huppert,
# Sparks & Hallworth (2004, doi 10.1017/S0022112004009036) did this with grains of many kinds. The
# run-out, the final height and the time until all grains are at rest do not depend on the kind:
#
# $$\frac{\Delta R}{R} = \begin{cases} 1.24\,a & a < 1.7 \\ 1.6\,\sqrt a & a > 1.7 \end{cases},
#   \qquad \frac{H_\infty}{R} = \begin{cases} a & a < 0.74 \\ 0.88\,a^{1/6} & a > 0.74 \end{cases},
#   \qquad t_\infty \approx 3\,\sqrt{H/g} .$$
#
# Points are rings: sand that runs outwards is stretched around, and the heap becomes thin.
# `--plane` is the same between two walls, with the column's half width in the place of $R$ and
# $1.2\,a$, or $1.9\,a^{2/3}$ for $a > 2.3$ (Lube and others 2005, doi 10.1103/PhysRevE.72.041301).

# %%
import itertools
import time
from dataclasses import dataclass

started = time.perf_counter()

import numpy as np
import ufl
from dolfinx import fem
from grids import box_grid
from mpi4py import MPI
from options import Options, natural, option, positive, switch
from scene import draw_points, finish, say

import dolfinmpm as mpm

RADIUS, DENSITY, GRAVITY = 0.1, 1600.0, 9.81  # m, kg/m³, m/s²


@dataclass
class Input(Options):
    """A round column of sand collapses under its weight."""

    aspect: float = option(0.8, "height by radius", above=0, most=10)
    plane: bool = option(False, "between two walls")
    friction_angle: float = option(30.0, "(degrees)")
    modulus: float = positive(1e6, "Young's (Pa)")
    poisson: float = 0.3
    h: float = positive(0.005, "size of the cells (m)")
    points_per_cell: int = natural(2, "in each direction")
    basis: str = option("gimp", choices=("linear", "gimp", "bspline2"))
    fbar: str = switch("on")
    duration: float = positive(4.0, "in units of the time √(H/g)")

    def _check(self):
        if not self.h <= 0.25 * RADIUS * min(1, self.aspect):
            raise ValueError(f"h = {self.h:g} m must be at most a quarter of radius and height")


def scaling(a, plane):
    """Run-out and height that is left, by the radius."""
    if plane:
        return 1.2 * a if a < 2.3 else 1.9 * a ** (2 / 3), a if a < 1.0 else 0.65 * a**0.4
    return 1.24 * a if a < 1.7 else 1.6 * np.sqrt(a), a if a < 0.74 else 0.88 * a ** (1 / 6)


# %% [markdown]
# ## The problem
# The ground is rough, nothing holds the sand at its side, and gravity acts at once.

# %%
args = Input.parse()
h, height = args.h, args.aspect * RADIUS
runout, left_over = scaling(args.aspect, args.plane)
reach = RADIUS * (1.6 + 1.3 * runout)
cells = [int(np.ceil(reach / h)), int(np.ceil(1.15 * height / h)) + 2]
# two rows below the ground: functions of points beside it are whole
corners = [(0.0, -2 * h), (cells[0] * h, cells[1] * h)]
cells[1] += 2
grid = box_grid(corners, cells)
column = mpm.Box((0, 0), (RADIUS, height))
points = mpm.fill(
    grid, column, args.points_per_cell, DENSITY, aligned="body", axisymmetric=not args.plane
)
V = mpm.Space(grid, args.basis, domains="fixed")
u, v = V.increment, V.test
sand = mpm.materials.MohrCoulomb(args.modulus, args.poisson, 0.0, args.friction_angle)
centres = "centres" if args.basis != "bspline2" else True
F = mpm.momentum(sand, points, u, v, fbar=centres if args.fbar == "on" else False)
F -= ufl.inner(points.density * fem.Constant(grid, (0.0, -GRAVITY)), v) * points.dX
bcs = mpm.fixed(V, lambda x: x[1] < 1e-6 * h) + mpm.rollers(V, "left")
problem = mpm.Explicit(F, u, points, bcs, scheme="musl")

# %% [markdown]
# ## What is measured
# The height of a heap is the volume of sand over rings one cell wide by their area; its end is
# where that falls below a fiftieth of the radius.

# %%
lines = np.arange(0.0, corners[1][0] + 0.5 * h, h)
areas = np.diff(lines) if args.plane else np.pi * np.diff(lines**2)


def profile():
    """Heights over the cells (m). Collective."""
    x, l0, V0 = points["x"][:, 0], points["l0"][:, 0], points["V0"]
    low, high = np.maximum(x - l0, 0.0), x + l0
    found = np.empty(len(areas))
    for k, (a, b) in enumerate(itertools.pairwise(lines)):
        inside = np.clip(np.minimum(high, b) - np.maximum(low, a), 0.0, None)
        found[k] = np.sum(V0 * inside / (high - low))
    return points.comm.allreduce(found, op=MPI.SUM) / areas


def end_of(heights):
    """Where a heap ends (m)."""
    thin = 0.02 * RADIUS
    middles = 0.5 * (lines[1:] + lines[:-1])
    k = int(np.argmax((heights < thin) & (middles > 0.5 * RADIUS)))
    share = (heights[k - 1] - thin) / (heights[k - 1] - heights[k])
    return float(middles[k - 1] + share * h)


# %% [markdown]
# ## Until it is at rest

# %%
ready = time.perf_counter()
unit = np.sqrt(height / GRAVITY)
mass = points.comm.allreduce(float(points["density"] @ points["V0"]), op=MPI.SUM)
times, ends, kinetic = [], [], []
count = max(4, round(10 * args.duration))
for share in mpm.steps(count, label="collapse"):
    t = share * args.duration * unit
    problem.step(t)
    times.append(share * args.duration)
    ends.append(end_of(profile()))
    kinetic.append(problem.energies().kinetic)
heights = profile()
far = (np.array(ends) - RADIUS) / RADIUS
# at rest where the front has come to 98 % of its way
rest = times[int(np.argmax(far > 0.98 * far[-1]))]
figures = {
    "runout": float(far[-1]),
    "runout_exact": float(runout),
    "height": float(heights[:2].max() / RADIUS),
    "height_exact": float(left_over),
    "time_of_rest": float(rest),
    "times": times,
    "runouts": far.tolist(),
    "kinetic": [float(e / (mass * GRAVITY * height)) for e in kinetic],
    "mass": mass,
    "volume": float(areas @ heights),
    "unfused": problem.unfused,
    "steps": sum(record.parts for record in problem.history),
    "points": points.total,
    "ranks": points.comm.size,
    "seconds_setup": ready - started,
    "seconds": time.perf_counter() - ready,
}
say(
    f"{'plane' if args.plane else 'round'} column, a = {args.aspect:g}, h = {h:g} m, "
    f"{points.total} points, {points.comm.size} rank(s): run-out {far[-1]:.3f} R ({runout:.3f}), "
    f"height {figures['height']:.3f} R ({left_over:.3f}), at rest after {rest:.1f} √(H/g); "
    f"{figures['steps']} steps, {figures['seconds']:.1f} s"
)


# %% [markdown]
# ## Picture
# The heap at rest, and the front over time.


# %%
def picture(path, gathered):
    """The heap and its height, and the run-out over time."""
    x, l0, plastic = gathered
    with mpm.figure(path, 6.5, 3.6, nrows=2, height_ratios=(1.2, 1)) as (fig, (top, bottom)):
        squares = np.broadcast_to(np.eye(2), (len(x), 2, 2))
        drawn = draw_points(top, x, squares, 1.3 * l0, plastic, cmap="viridis", clim=(0, 4))
        top.step(lines[:-1], heights, where="post", color="#D55E00", lw=0.9, label="height")
        top.plot([0, RADIUS, RADIUS], [height, height, 0], color="0.5", ls="--", lw=0.6)
        top.axvline(RADIUS * (1 + runout), color="C0", lw=0.9, label="run-out of experiments")
        top.set(xlim=(0, RADIUS * (1.3 + max(runout, far[-1]))), ylim=(0, 1.1 * height))
        top.set(xlabel="radius (m)", ylabel="height (m)")
        top.legend()
        fig.colorbar(drawn, ax=top, label="plastic strain", extend="max")
        bottom.plot(times, far, "o-", ms=2.5, color="C1", label="material points")
        bottom.axhline(runout, color="C0", lw=0.9, label="experiments")
        bottom.set(xlabel=r"$t/\sqrt{H/g}$", ylabel=r"$\Delta R/R$", xlim=(0, None))
        bottom.legend(loc="lower right")


gathered = None if args.no_plot else points.gather("x", "l0", "plastic_strain")
if gathered is not None:
    picture(args.output / f"{'plane' if args.plane else 'round'}_collapse.png", gathered)

finish(args, figures)
