# %% [markdown]
# # A cantilever bends far beyond small displacements
#
# A beam of length $L$ and depth $d$ is held at one end and carries a dead load $P$ at
# the other (Coombs & Augarde 2020, doi 10.1016/j.advengsoft.2019.102748). Its tip ends
# more than $0.8\,L$ below where it was: the material points rotate by up to 80° and
# pass through many cells, while the grid stays as it is.
#
# The exact shape of a thin beam is Euler's *elastica*. With the slope $\theta$ along
# the arc $s$, and $EI = E d^3/12$ per unit of width,
#
# $$EI\,\theta'' = -P\cos\theta, \qquad \theta(0) = 0, \quad \theta'(L) = 0,$$
#
# whose solution by elliptic integrals of the first kind $F$ and the second kind
# $\mathcal E$ with modulus $k$, where $1 + \sin\theta = 2k^2\sin^2\varphi$ and
# $\sin\varphi_0 = 1/(k\sqrt 2)$ at the support, is
#
# $$\sqrt{\alpha}\,\frac sL = F(\varphi) - F(\varphi_0), \qquad
#   \frac xL = \frac{2k}{\sqrt\alpha}(\cos\varphi_0 - \cos\varphi), \qquad
#   \frac yL = \frac sL - \frac{2}{\sqrt\alpha}
#   \bigl(\mathcal E(\varphi) - \mathcal E(\varphi_0)\bigr), \qquad
#   \alpha = \frac{PL^2}{EI}.$$
#
# The tip has $\varphi = \pi/2$, which gives $k$; it moves by $u = L - x$ towards the
# support and by $v = y$ with the load (Bisshopp & Drucker 1945, doi 10.1090/qam/13360).

# %%
import time
from dataclasses import dataclass

started = time.perf_counter()

import numpy as np
import ufl
from dolfinx import fem
from grids import box_grid
from mpi4py import MPI
from options import Options, natural, option, positive
from scene import draw_points, fibre_stress, finish, outline_of_beam, say, solver_figures
from scipy.optimize import brentq
from scipy.special import ellipe, ellipeinc, ellipk, ellipkinc

import dolfinmpm as mpm

# %% [markdown]
# The elastica knows neither shear, nor stretching, nor that a beam in plane strain is
# stiffer by $1/(1-\nu^2)$. A beam ten times as long as deep, bent to strains of 20 %,
# therefore departs from it by up to 2 % of its length: a conforming finite-element
# computation of the same body (biquadratic elements; `tests/verification/test_cantilever.py`)
# ends at $u/L = 0.555$, $v/L = 0.828$, where the elastica says 0.555 and 0.811.


# %%
def elastica(alpha, places=201):
    """Shape (x/L, y/L) of a thin cantilever under α = PL²/EI, from support to tip."""

    def arc(m):
        return ellipk(m) - ellipkinc(np.arcsin(np.sqrt(0.5 / m)), m) - np.sqrt(alpha)

    # SciPy's elliptic integrals take the parameter m = k²
    m = brentq(arc, 0.5 + 1e-15, 1 - 1e-15, xtol=1e-16)
    start = np.arcsin(np.sqrt(0.5 / m))
    phi = np.linspace(start, np.pi / 2, places)
    s = ellipkinc(phi, m) - ellipkinc(start, m)
    whole = np.where(phi < np.pi / 2, ellipeinc(phi, m), ellipe(m))
    x = 2 * np.sqrt(m) * (np.cos(start) - np.cos(phi))
    y = s - 2 * (whole - ellipeinc(start, m))
    return x / np.sqrt(alpha), y / np.sqrt(alpha)


def elastica_tip(alpha):
    """Displacement of its tip (u/L, v/L), towards the support and with the load."""
    x, y = elastica(alpha, places=2)
    return 1 - x[-1], y[-1]


@dataclass
class Input(Options):
    """A cantilever under a dead load at its tip."""

    h: float = positive(0.25, "size of the cells (m)")
    points_per_cell: int = natural(6, "in each direction")
    steps: int = natural(50)
    modulus: float = positive(12e6, "Young's modulus (Pa)")
    poisson: float = 0.2
    load: float = option(100e3, "downwards (N/m)")
    length: float = option(10.0, "m")
    depth: float = option(1.0, "m")
    basis: str = option("gimp", choices=("linear", "gimp", "bspline2"))
    ghost: str = option("none", choices=("none", "literal", "scaled"))
    factor: float = option(1.0, "ghost penalty in units of E/30")
    stages: float = option(
        [1.0, 2.0, 4.0, 6.0, 8.0, 10.0], "values of PL²/EI to report and draw", nargs="+"
    )


# %% [markdown]
# ## The problem
# The beam's axis is $y = 0$, and nodes, or the centres of splines, lie on it whatever the size
# of the cells. The grid reaches as far as the elastica says that the beam will go, and a little
# further.
#
# The load is shared by the two points at the free end that are nearest to the axis (by
# one, if a point lies on the axis). A field of the points says how: its integral over
# the body is one. It moves with the points, and so does the load.
#
# The weak form has internal forces minus the load, both summed over the material points in their
# initial volume $\mathrm dX$, and if asked for the ghost penalty. Without it luck decides whether
# a run comes to its end: with `--points-per-cell 4 --steps 25` the domain of a point reaches
# into a new cell by a sliver, next to nothing holds that cell's nodes, and no step however
# small converges. With `--ghost scaled` as well, 112 Newton iterations do.
#
# Rollers hold the whole left side, so that the support can shrink and swell; the node
# on the axis alone keeps it from falling.


# %%
class Beam:
    """The beam with its load, step by step.

    Args:
        args: The command line, or a variation of it.
        stabilisation: One of the stabilisations besides the penalty that `args.ghost` writes into
            the form.

    Attributes:
        full: PL²/EI at the end.
    """

    def __init__(self, args, stabilisation="none"):
        h, self.length, depth = args.h, args.length, args.depth
        self.full = abs(args.load) * self.length**2 / (args.modulus * depth**3 / 12)
        self.args = args
        deflection = 1.05 * elastica_tip(self.full)[1] * self.length
        below = int(np.ceil((deflection + depth) / h)) + 1
        above = int(np.ceil(0.5 * depth / h)) + 2
        if args.load < 0:
            below, above = above, below
        along = int(np.ceil(self.length / h)) + 2
        # quadratic splines have their centres in the middle of cells
        shift = 0.5 * h if args.basis == "bspline2" else 0.0
        self.grid = grid = box_grid(
            [(0, -below * h + shift), (along * h, above * h + shift)], (along, below + above)
        )
        beam = mpm.Box((0, -0.5 * depth), (self.length, 0.5 * depth))
        self.points = points = mpm.fill(grid, beam, per_cell=args.points_per_cell, density=1.0)
        V = mpm.Space(grid, basis=args.basis)
        u, v = V.increment, V.test

        x0, comm, slack = points["x0"], grid.comm, 1e-6 * h
        end = comm.allreduce(x0[:, 0].max(initial=-np.inf), op=MPI.MAX)
        at_end = x0[:, 0] > end - slack
        nearest = comm.allreduce(np.abs(x0[at_end, 1]).min(initial=np.inf), op=MPI.MIN)
        loaded = at_end & (np.abs(x0[:, 1]) < nearest + slack)
        tip = points.add_field("tip", unit="1/m^2")
        points["tip"] = loaded / (comm.allreduce(int(loaded.sum())) * points["V0"])

        rubber = mpm.materials.Hencky(E=args.modulus, nu=args.poisson)
        self.load = fem.Constant(grid, (0.0, 0.0))
        F = mpm.momentum(rubber, points, u, v) - tip * ufl.inner(self.load, v) * points.dX
        if args.ghost != "none":
            gamma = args.factor * args.modulus / 30
            F += mpm.ghost(points, u, v, gamma=gamma, scaling=args.ghost)

        def support(x):
            """The node where the beam's axis meets the left side."""
            return (np.abs(x[0]) < 0.6 * h) & (np.abs(x[1]) < slack)

        bcs = mpm.rollers(V, "left") + mpm.prescribed(V, support, 1)
        self.problem = mpm.QuasiStatic(F, u, points, bcs=bcs, stabilisation=stabilisation)

    def step(self, share):
        """Bring the load to a share of the whole; returns u/L and v/L of the tip. Collective.

        That is the mean displacement of the loaded points, through which the load does its work.
        """
        self.load.value[1] = -self.args.load * share
        self.problem.step()
        points = self.points
        weight = points["tip"] * points["V0"]
        du, dv = self.grid.comm.allreduce(weight @ (points["x"] - points["x0"]))
        return -du / self.length, -np.sign(self.args.load) * dv / self.length


# %% [markdown]
# ## Picture
# Every point is drawn as the parallelogram that its part of the body has become, with
# the stress along the beam's fibres, $t\cdot\sigma t$ with $t = F e_x/|F e_x|$: tension
# outside the bend, compression inside. The dashed lines are the elastica.


# %%
def picture(path, shapes, curve, stages, length, depth, downwards):
    """Draw the bent beam and the load-displacement curves."""
    fibre = {alpha: fibre_stress(F, stress) / 1e6 for alpha, (*_, F, _, stress) in shapes.items()}
    top = np.percentile(np.abs(fibre[max(fibre)]), 99.5)
    with mpm.figure(path, 7.0, 3.1, ncols=2, width_ratios=(1.25, 1)) as (figure, (left, right)):
        for layer, (alpha, (x0, x, F, l0, _)) in enumerate(shapes.items(), start=3):
            look = {"cmap": "RdBu_r", "clim": (-top, top), "zorder": layer}
            drawn = draw_points(left, x, F, l0, fibre[alpha], **look)
            left.plot(*outline_of_beam(x0, x, F, l0).T, color="0.3", lw=0.4, zorder=layer)
            xE, yE = elastica(alpha)
            left.plot(xE * length, -downwards * yE * length, "k--", lw=0.6, zorder=layer)
        left.plot([], [], "k--", lw=0.6, label="elastica")
        box = np.array([(0, -1), (length, -1), (length, 1), (0, 1), (0, -1)]) * (1, 0.5 * depth)
        left.plot(*box.T, color="0.5", lw=0.6)
        left.legend(loc="lower left" if downwards > 0 else "upper left")
        figure.colorbar(drawn, ax=left, label="stress along the fibres (MPa)")
        load = np.linspace(0, curve[-1, 0], 101)[1:]
        exact = np.array([elastica_tip(alpha) for alpha in load])
        for k, (name, colour) in enumerate((("$u/L$", "C0"), ("$v/L$", "C1")), start=1):
            right.plot(load, exact[:, k - 1], "--", color=colour, lw=0.8)
            right.plot(curve[:, 0], curve[:, k], color=colour, label=name)
            right.plot(stages[:, 0], stages[:, k], "o", color=colour)
        right.plot([], [], "k-", label="material points")
        right.plot([], [], "k--", lw=0.8, label="elastica")
        right.set(xlabel="$PL^2/EI$", ylabel="displacement of the tip / $L$")
        right.set(xlim=(0, None), ylim=(0, 1))
        right.legend(loc="lower right")


# %% [markdown]
# ## Runs

# %%
if __name__ == "__main__":
    args = Input.parse()
    length, depth = args.length, args.depth
    scene = Beam(args)
    problem, points, comm, full = scene.problem, scene.points, scene.grid.comm, scene.full

    # %% [markdown]
    # ## Fifty steps
    # The displacement of the tip after each is a point of the load–displacement curve. The chosen
    # stages go to ParaView and into the picture.

    # %%
    ready = time.perf_counter()
    wanted = {min(max(round(stage / full * args.steps), 1), args.steps) for stage in args.stages}
    curve, shapes = [(0.0, 0.0, 0.0)], {}
    file = None if args.no_plot else mpm.ParaView(args.output / "cantilever.pvd", points)
    for share in mpm.steps(args.steps, label="tip load"):
        curve.append((share * full, *scene.step(share)))
        if file is not None and len(problem.history) in wanted:
            file.write(share)
            shapes[curve[-1][0]] = points.gather("x0", "x", "F", "l0", "stress")
    curve = np.array(curve)

    # %% [markdown]
    # ## Against the elastica

    # %%
    stages = curve[sorted(wanted)]
    exact = np.array([elastica_tip(alpha) for alpha in stages[:, 0]])
    difference = stages[:, 1:] - exact
    iterations = [record.iterations for record in problem.history]
    figures = {
        "PL2_EI": stages[:, 0].tolist(),
        "u_L": stages[:, 1].tolist(),
        "v_L": stages[:, 2].tolist(),
        "u_L_elastica": exact[:, 0].tolist(),
        "v_L_elastica": exact[:, 1].tolist(),
        "u_L_difference": difference[:, 0].tolist(),
        "v_L_difference": difference[:, 1].tolist(),
        "max_u_L_difference": float(np.abs(difference[:, 0]).max()),
        "max_v_L_difference": float(np.abs(difference[:, 1]).max()),
        **solver_figures(problem),
        "seconds_setup": ready - started,
        "seconds_solve": sum(record.seconds for record in problem.history),
    }
    say(" PL²/EI     u/L  elastica      v/L  elastica")
    for (alpha, uL, vL), (uE, vE) in zip(stages, exact):
        say(f"{alpha:7.2f} {uL:8.5f}  {uE:8.5f} {vL:8.5f}  {vE:8.5f}")
    say(
        f"{args.basis}, h = {args.h:g} m, {figures['points']} points, {comm.size} rank(s): "
        f"{sum(iterations)} Newton iterations in {args.steps} steps (at most {max(iterations)}), "
        f"{figures['seconds_solve']:.2f} s after {figures['seconds_setup']:.2f} s of set-up"
    )

    if not args.no_plot and comm.rank == 0:
        path = args.output / "cantilever.png"
        picture(path, shapes, curve, stages, length, depth, np.sign(args.load))

    finish(args, figures)
