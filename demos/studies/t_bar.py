# %% [markdown]
# # A T-bar in deep clay
#
# A T-bar penetrometer is a cylinder that is pushed through clay across its axis. In deep clay the
# soil flows around it, and its resistance $q = F/D$ gives the undrained strength $c_u$. Theory of
# plasticity has the factor of a cylinder whose surface carries the shear stress $\alpha c_u$
# (Randolph & Houlsby 1984, doi 10.1680/geot.1984.34.4.613):
#
# $$N_T = \frac{q}{c_u} = \pi + 2\Delta + 4\cos\Big(\frac\pi4 - \frac\Delta2\Big)
#   \Big(\sqrt2 + \sin\Big(\frac\pi4 - \frac\Delta2\Big)\Big), \qquad \sin\Delta = \alpha :$$
#
# 9.14 for a smooth bar, and 11.94 for a rough one. It is exact for a rough bar, and else a lower
# bound: upper bounds are less than 1 % above it (Martin & Randolph 2006, doi
# 10.1680/geot.2006.56.2.141). The shear stress of the surface is `mpm.contact(..., friction=,
# shear_limit=)`. The clay is in plane strain, and under a pressure that keeps it at the bar.

# %%
import time
from dataclasses import dataclass

started = time.perf_counter()

import numpy as np
from mpi4py import MPI
from options import BASES, Options, natural, option, positive
from scene import draw_points, finish, say, solver_figures

import dolfinmpm as mpm


@dataclass
class Input(Options):
    """A cylinder that is pushed through deep clay."""

    adhesion: float = option(1.0, "shear stress of the surface by the strength", least=0, most=1)
    cells: int = natural(4, "along the radius of the bar")
    way: float = positive(0.8, "by the radius")
    step: float = positive(0.02, "by the radius")
    rigidity: float = positive(600.0, "Young's modulus by the strength")
    poisson: float = option(0.49, "Poisson's ratio", least=0, below=0.5)
    pressure: float = positive(20.0, "of the ground, by the strength")
    size: float = option(5.0, "half of the width of the ground by the radius", least=3)
    basis: str = option("bspline2", choices=BASES)
    fbar: bool = option(False, "means of volume changes over cells, against locking")
    points_per_cell: int = natural(3, "in each direction")


# %% [markdown]
# ## Half of the bar
# The ground does not move far away; beside the axis of symmetry it slides along it. The first
# points are cut by the surface of the bar. Quadratic splines do without F-bar. With F-bar the
# pressures of points in one cell drift apart as clay flows past, and the force on the bar falls.

# %%
args = Input.parse()
R, c = 1.0, 1.0
h, size, E = R / args.cells, args.size * R, args.rigidity * c
line = np.arange(0.0, size + h / 2, h)
grid = mpm.create_lattice(MPI.COMM_WORLD, [line, np.concatenate([-line[:0:-1], line])])
disc = mpm.Disc((0, 0), R)
ground = mpm.Box((0, -line[-1]), (line[-1], line[-1])) - disc
points = mpm.fill(grid, ground, args.points_per_cell, 1.0, exact=True)
V = mpm.Space(grid, args.basis, domains="volume")
u, v = V.increment, V.test
clay = mpm.materials.Tresca(E, args.poisson, cohesion=c)
mpm.set_stress(clay, points, -args.pressure * c * np.eye(3))
bar = mpm.RigidBody(disc, increment=(0, -args.step * R), name="bar")
surface = {"friction": 1.0, "shear_limit": args.adhesion * c} if args.adhesion else {}
F = mpm.momentum(clay, points, u, v, fbar=args.fbar)
F += mpm.contact(bar, points, u, v, **surface)
bcs = mpm.rollers(V, "left", "bottom", "top") + mpm.fixed(V, "right")
ghost = mpm.Stabilisation("ghost", factor=0.1)
problem = mpm.QuasiStatic(F, u, points, bcs, stabilisation=ghost, tolerance=1e-5)

# %% [markdown]
# ## The way
# The resistance is constant once the clay has yielded all around.

# %%
ready = time.perf_counter()
curve = []
for _ in mpm.steps(round(args.way / args.step), label="way of the bar"):
    problem.step()
    curve.append((-bar.position[1] / R, 2 * bar.force[1] / (2 * R * c)))
curve = np.array(curve)

delta = np.arcsin(args.adhesion)
angle = np.pi / 4 - delta / 2
exact = np.pi + 2 * delta + 4 * np.cos(angle) * (np.sqrt(2) + np.sin(angle))
steady = curve[len(curve) // 2 :, 1]
figures = {
    "factor": float(steady.mean()),
    "exact": float(exact),
    "error": float(steady.mean() / exact - 1),
    "wave": float((steady.max() - steady.min()) / (2 * steady.mean())),
    "largest": float(curve[:, 1].max()),
    "way": curve[:, 0].tolist(),
    "factors": curve[:, 1].tolist(),
    **solver_figures(problem),
    "seconds_setup": ready - started,
    "seconds_solve": sum(record.seconds for record in problem.history),
}
say(
    f"T-bar, adhesion {args.adhesion:g}, {args.basis}, h = R/{args.cells}, {figures['points']} "
    f"points, {points.comm.size} rank(s): N_T = {figures['factor']:.2f} over the second half of "
    f"the way, {figures['error']:+.1%} from {exact:.2f}, within {figures['wave']:.1%}; "
    f"{figures['newton_iterations']} Newton iterations in {len(curve)} steps, "
    f"{figures['seconds_solve']:.1f} s"
)


# %% [markdown]
# ## Picture
# The factor along the way, and where the clay has flowed.


# %%
def picture(path, gathered):
    """The factor along the way, and the plastic strain around the bar."""
    from matplotlib import pyplot as plt

    x, F, half, strain = gathered
    mirror = np.array([-1.0, 1.0])
    both = [np.concatenate(pair) for pair in ((x, x * mirror), (F, mirror[:, None] * F * mirror))]
    with mpm.figure(path, 6.5, 3.0, ncols=2) as (drawing, (left, right)):
        left.axhline(exact, color="k", lw=0.8, ls="--", label="Randolph & Houlsby")
        left.plot(curve[:, 0], curve[:, 1], "o-", ms=2.5, color="C1", label="material points")
        left.set(
            xlabel="displacement / $R$",
            ylabel="$N_T$",
            ylim=(0, 1.15 * max(exact, curve[:, 1].max())),
        )
        left.legend(loc="lower right")
        drawn = draw_points(right, *both, np.tile(half, (2, 1)), np.tile(strain, 2))
        right.add_patch(plt.Circle(bar.position, R, fc="0.8", ec="k", lw=0.6))
        middle = bar.position[1]
        right.set(xlim=(-2.5, 2.5), ylim=(middle - 2.5, middle + 2.5),
                  xlabel="$x/R$", ylabel="$y/R$")  # fmt: skip
        drawing.colorbar(drawn, ax=right, label="plastic strain")


gathered = None if args.no_plot else points.gather("x", "F", "l0", "plastic_strain")
if gathered is not None:
    picture(args.output / "t_bar.png", gathered)

finish(args, figures)
