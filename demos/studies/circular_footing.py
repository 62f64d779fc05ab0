# %% [markdown]
# # A circular footing on clay
#
# A rigid disc of radius $B = 1$ m is pressed into weightless clay (Tresca, $c_u$). The mean
# pressure under which the ground flows is
#
# $$q = 5.69\,c_u \quad\text{(smooth)}, \qquad q = 6.05\,c_u \quad\text{(rough)}$$
#
# (Shield 1955; Eason & Shield 1960; Cox, Eason & Hopkins 1961). This is more than under a strip,
# 5.14: the ground that flows outwards is also stretched around the axis. The hoop stress decides.
# All of the ground is at an edge of Tresca's hexagon. Points are rings. F-bar prevents locking.

# %%
import time
from dataclasses import dataclass

started = time.perf_counter()

import numpy as np
from dolfinx import fem
from grids import grid_of_lines, lines
from options import Options, natural, option, positive, switch
from scene import draw_points, finish, say, solver_figures

import dolfinmpm as mpm

RADIUS, COHESION = 1.0, 10e3  # m, Pa
FACTORS = {"off": 5.69, "on": 6.05}


@dataclass
class Input(Options):
    """A rigid circular footing on clay."""

    rough: str = option("off", "no slip under it", choices=tuple(FACTORS))
    h: float = positive(0.025, "size of the cells at its edge (m)", most=0.5)
    coarsest: float = positive(0.25, "far from there (m)")
    width: float = option(4.0, "radius of the ground (m)", least=2 * RADIUS)
    depth: float = option(2.5, "of the ground (m)", least=RADIUS)
    points_per_cell: int = natural(2, "in each direction")
    basis: str = option("gimp", choices=("linear", "gimp", "bspline2"))
    fbar: str = switch("on", "against locking")
    modulus: float = positive(1e9, "Young's modulus (Pa)")
    poisson: float = 0.33
    steps: int = natural(20)
    settlement: float = positive(4e-4, "at the end (m)")
    stabilisation: str = option("aggregation", choices=("none", "ghost", "aggregation"))

    def _check(self):
        self.coarsest = max(self.h, self.coarsest)


# %% [markdown]
# ## The problem
# Cells grow away from the edge of the footing, where the stress jumps. The ground is so stiff that
# it flows before its shape changes. Forces are those on the whole disc. What moves with the disc
# is as wide as it and a part of the next cell, so that the load is too high by about h/B.

# %%
args = Input.parse()
width, depth, rough = args.width, args.depth, args.rough == "on"
grid = grid_of_lines(
    lines(width, RADIUS, args.h, args.coarsest), lines(depth + 0.5, depth, args.h, args.coarsest)
)
ground = mpm.Box((0, 0), (width, depth))
points = mpm.fill(grid, ground, args.points_per_cell, 1000.0, axisymmetric=True)
V = mpm.Space(grid, args.basis)
u, v = V.increment, V.test
under = mpm.Surface(
    points, lambda x: np.isclose(x[1], depth) & (x[0] < RADIUS), (0, 1), name="under"
)
settlement = fem.Constant(grid, 0.0)
footing = mpm.RigidFooting(under, settlement, rough=rough, E=args.modulus)
clay = mpm.materials.Tresca(args.modulus, args.poisson, COHESION)
F = mpm.momentum(clay, points, u, v, fbar=args.fbar == "on") + footing.contact(u, v)
problem = mpm.QuasiStatic(
    F,
    u,
    points,
    mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom"),
    stabilisation=args.stabilisation,
)

# %% [markdown]
# ## Settlement by settlement
# The mean pressure is the load by the area of the disc.

# %%
ready = time.perf_counter()
curve = [(0.0, 0.0)]
for share in mpm.steps(args.steps, label="settlement"):
    settlement.value = args.settlement * share
    problem.step()
    curve.append((args.settlement * share, footing.load() / (under.total_area * COHESION)))
curve = np.array(curve)
exact = FACTORS[args.rough]
figures = {
    "factor": float(curve[-1, 1]),
    "factor_exact": exact,
    "error": float(curve[-1, 1] / exact - 1),
    "load": float(footing.load()),
    "settlements": curve[:, 0].tolist(),
    "factors": curve[:, 1].tolist(),
    **solver_figures(problem),
    "seconds_setup": ready - started,
    "seconds_solve": sum(record.seconds for record in problem.history),
}
say(
    f"{'rough' if rough else 'smooth'} disc, {args.basis}, F-bar {args.fbar}, h = {args.h:g} m, "
    f"{figures['points']} points, {grid.comm.size} rank(s): bearing factor {curve[-1, 1]:.3f} "
    f"({figures['error']:+.2%} from {exact:g}), {figures['newton_iterations']} Newton iterations "
    f"in {args.steps} steps, {figures['seconds_solve']:.1f} s"
)


# %% [markdown]
# ## Picture
# The curve, and where the ground yields in a half of the section.


# %%
def picture(path, gathered):
    """Bearing factor over settlement, and plastic strain."""
    x, deformation, l0, plastic = gathered
    with mpm.figure(path, 7.0, 2.6, ncols=2, width_ratios=(1, 1.3)) as (fig, (left, right)):
        left.plot(1e3 * curve[:, 0], curve[:, 1], "o-", ms=3, color="C1", label="material points")
        left.axhline(exact, color="C0", label="limit")
        left.set(xlabel="settlement (mm)", ylabel="$q/c_u$", ylim=(0, None))
        left.legend(loc="lower right")
        drawn = draw_points(
            right, x, deformation[:, :2, :2], l0, 1e3 * plastic, cmap="viridis",
            clim=(0, 5e3 * args.settlement),
        )  # fmt: skip
        right.plot([0, RADIUS], [depth + 0.05] * 2, "k-", lw=3)
        right.set(xlim=(0, 2.5), ylim=(depth - 1.5, depth + 0.15))
        right.set(xlabel="radius (m)", ylabel="height (m)")
        fig.colorbar(drawn, ax=right, label=r"plastic strain ($10^{-3}$)")


gathered = None if args.no_plot else points.gather("x", "F", "l0", "plastic_strain")
if gathered is not None:
    picture(args.output / f"circular_footing_{args.rough}.png", gathered)

finish(args, figures)
