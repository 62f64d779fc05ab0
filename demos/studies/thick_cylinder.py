# %% [markdown]
# # A thick cylinder yields from the inside outwards, on a grid that does not fit it
#
# A tube with inner and outer radius $a$ and $b$ is loaded by an internal pressure $p$
# in plane strain. Its material is elastic and perfectly plastic (von Mises, uniaxial yield
# stress $\sigma_y$), and yields for $r \le c$. With $Y = 2\sigma_y/\sqrt 3$ Hill's solution
# (de Souza Neto, Perić & Owen 2008, section 7.5.1) says
#
# $$p = Y\Bigl[\ln\frac ca + \frac12\Bigl(1 - \frac{c^2}{b^2}\Bigr)\Bigr], \qquad
#   u_b = \frac{Y c^2 (1-\nu^2)}{E\,b}, \qquad
#   p_{\lim} = Y \ln\frac ba ,$$
#
# with the stresses
#
# $$\sigma_r = \begin{cases} Y\bigl[\ln\frac rc - \frac12\bigl(1 - \frac{c^2}{b^2}\bigr)\bigr]
#   & r \le c \\ -\frac{Y c^2}{2 b^2}\bigl(\frac{b^2}{r^2} - 1\bigr) & r \ge c \end{cases}
#   \qquad
#   \sigma_\theta = \begin{cases} \sigma_r + Y & r \le c \\
#   \frac{Y c^2}{2 b^2}\bigl(\frac{b^2}{r^2} + 1\bigr) & r \ge c . \end{cases}$$
#
# Finite elements need a curved mesh for this. Here squares of side $h$ cover a quarter of
# the tube and know nothing of its two circles.

# %%
import itertools
import time
from dataclasses import dataclass

started = time.perf_counter()

import numpy as np
from dolfinx import fem
from grids import box_grid
from mpi4py import MPI
from options import BASES, natural, option, switch
from scene import finish, say, solver_figures, stabilisation
from yielding_shell import ShellInput, Yielding, compared, draw_curve, draw_stresses, widen

import dolfinmpm as mpm
from dolfinmpm.body.location import destinations

# %% [markdown]
# ## Points in rings
# The tube is divided into rings, and each ring into parts that are about as long as
# thick. A point stands at the centroid of a part and has exactly its area, so that the
# mass is exact. The innermost parts know where their face is and how large: $R$
# leads from the point to the mean of its arc, $A_0$ is the integral of the outward
# normal along it, $\mp 2 r \sin\frac{\Delta\theta}2\, e_r$. The forces of a pressure
# on all these faces sum up to that on the circle.


# %%
def rings(a, b, size):
    """Parts of a quarter of a tube.

    Args:
        a, b: Radii (m).
        size: Wanted size of the parts (m).

    Returns:
        Centroids, areas, and corners of the parts, then offset and area vector of the
        faces inside, and likewise outside.
    """
    radii = np.linspace(a, b, max(2, round((b - a) / size)) + 1)
    rows = []
    for low, high in itertools.pairwise(radii):
        number = max(2, round(0.25 * np.pi * (low + high) / size))
        step = 0.5 * np.pi / number
        middle = (np.arange(number) + 0.5) * step
        radial = np.column_stack([np.cos(middle), np.sin(middle)])
        # means over an arc lie inside it, by the sinc of half its angle
        chord = np.sin(0.5 * step) / (0.5 * step)
        x = 2 / 3 * (high**3 - low**3) / (high**2 - low**2) * chord * radial
        area = np.full(number, 0.5 * (high**2 - low**2) * step)
        ends = middle[:, None] + 0.5 * step * np.array([-1, 1])
        arc = np.stack([np.cos(ends), np.sin(ends)], axis=-1)
        corners = np.concatenate([low * arc, high * arc[:, ::-1]], axis=1)
        faces = []
        for end, sign, radius in ((low, -1, a), (high, 1, b)):
            at = np.isclose(end, radius)
            faces += [at * (end * chord * radial - x), at * sign * end * chord * step * radial]
        rows.append((x, area, corners, *faces))
    return [np.concatenate(parts) for parts in zip(*rows)]


def fill_rings(grid, a, b, size):
    """Material points of the parts, and the surfaces inside and outside. Collective."""
    x, area, corners, *faces = rings(a, b, size)
    # every rank makes all the points and keeps those whose cells it owns
    to = destinations(grid, x)
    mine = to.rank == grid.comm.rank
    cell = to.cell[mine] - grid.topology.index_map(2).local_range[0]
    half = np.repeat(0.5 * np.sqrt(area[mine, None]), 2, axis=1)
    points = mpm.MaterialPoints(grid, x[mine], cell, area[mine], half, density=1.0)
    points.add_field("corners", (4, 2), "m")
    points["corners"] = corners[mine]
    inner, outer = (
        mpm.Surface.from_arrays(points, faces[2 * k][mine], faces[2 * k + 1][mine], name=name)
        for k, name in enumerate(("inner", "outer"))
    )
    return points, inner, outer


@dataclass
class Input(ShellInput):
    """A thick cylinder under internal pressure, beyond its limit load."""

    points_per_cell: int = natural(3, "in each direction, about")
    basis: str = option("bspline2", choices=BASES)
    stabilisation: str = option(
        "aggregation", choices=("none", "ghost", "aggregation", "weak-aggregation", "extended")
    )
    factor: float = option(1.0, "of a penalty; see Stabilisation")
    threshold: float = option(0.5, "of aggregation")
    fbar: str = switch("off", "against locking")


# %% [markdown]
# ## The problem
# Rollers on the two lines of symmetry; nothing holds the tube else. The grid ends somewhere
# outside the tube. Von Mises' law takes $\rho_y = \sqrt{2/3}\,\sigma_y$, for
# $f = \sqrt{2 J_2} - \rho_y$.

# %%
args = Input.parse()
a, b, h = args.inner, args.outer, args.h
exact = Yielding("cylinder", args)
n = int(np.ceil(b / h)) + 2
corners = [(0, 0), (n * h, n * h)]
grid = box_grid(corners, (n, n))
points, inner, outer = fill_rings(grid, a, b, h / args.points_per_cell)

V = mpm.Space(grid, basis=args.basis)
u, v = V.increment, V.test
steel = mpm.materials.VonMises(E=args.modulus, nu=args.poisson, yield_stress=args.strength)

# %% [markdown]
# ## The weak form, and the pressure as an unknown
# The pressure follows the face; its tangent is derived with the rest. Under a given
# pressure no state of equilibrium is left beyond the limit load. The solver is
# therefore given the outer displacement and finds the pressure.

# %%
pressure = fem.Constant(grid, exact.limit)
options = {"fbar": True} if args.fbar == "on" else {}
F = mpm.momentum(steel, points, u, v, **options) + inner.pressure(pressure, u, v)

# %% [markdown]
# ## Steps of equal outer displacement
# At the step next to $c = \sqrt{ab}$ the stresses are kept for the picture.

# %%
ready = time.perf_counter()
problem, curve, field, shown = widen(
    args, exact, F, u, points, "x0", "corners", "stress",
    bcs=mpm.rollers(V, "left", "bottom"), load=pressure, control=outer.mean_normal(v),
    stabilisation=stabilisation(
        args.stabilisation, factor=args.factor, threshold=args.threshold, E=args.modulus
    ),
)  # fmt: skip

# %% [markdown]
# ## Against the closed form
# Hill's solution is one of small strains. At the limit the inner radius has grown by half
# a per cent, and a tube that flows carries $Y\ln(b'/a')$ with the radii $a'$, $b'$ that it
# has by then: with the usual numbers 0.6 % less than the limit load. With
# `--strength 0.024e9`, a tenth, the strains are a tenth too and the difference goes.

# %%
# mean radial displacement of the inner face
face = points["inner_area"]
inwards = grid.comm.allreduce(float(np.sum(face * inner.displacements())), op=MPI.SUM)
limit_now = exact.Y * np.log((b + curve[-1, 0]) / (a - inwards / inner.total_area))
figures = {
    **compared(exact, curve),
    "limit_load_of_present_radii": float(limit_now),
    **solver_figures(problem),
    "last_residuals": [record.residuals[-2:] for record in problem.history],
    "seconds_setup": ready - started,
    "seconds_solve": sum(record.seconds for record in problem.history),
}
say("outer displacement (mm)   pressure (MPa)   closed form")
for (displacement, p), reference in zip(curve[1:], figures["pressure_exact"][1:]):
    say(f"{1e3 * displacement:22.5f} {1e-6 * p:16.3f} {1e-6 * reference:13.3f}")
say(
    f"{args.basis}, {args.stabilisation}, h = {h:g} m, {figures['points']} points, "
    f"{grid.comm.size} rank(s): pressure within {figures['max_pressure_error']:.2%} of the closed "
    f"form, limit load {1e-9 * curve[-1, 1]:.5f} GPa ({figures['limit_load_error']:+.2%}; "
    f"{curve[-1, 1] / limit_now - 1:+.2%} with the radii as they are), "
    f"{figures['newton_iterations']} Newton iterations in {args.steps} steps, "
    f"{figures['seconds_solve']:.2f} s after {figures['seconds_setup']:.2f} s of set-up"
)


# %% [markdown]
# ## Picture
# Left the curve, in the middle the stresses of all points, at the step that was kept, and on the
# right the hoop stress with the front of the plastic zone and the grid. In the plastic zone,
# where the material hardly changes its volume, the mean stress of single points scatters about
# the closed form, a sign of volumetric locking, against which `--fbar on` is meant; the pressure
# hardly feels it. Ghost penalty and aggregation give the same pressures to four digits here.


# %%
def picture(path, field, displacement):
    """Pressure over displacement, stresses over the radius, and the field of hoop stress."""
    from matplotlib.collections import PolyCollection

    x0, parts, stress = field
    r = np.hypot(*x0.T)
    e_r = x0 / r[:, None]
    e_t = np.column_stack([-e_r[:, 1], e_r[:, 0]])
    radial, hoop = (np.einsum("pi,pij,pj->p", e, stress[:, :2, :2], e) for e in (e_r, e_t))
    with mpm.figure(path, 7.5, 2.5, ncols=3, width_ratios=(1, 1, 1.5)) as (fig, axes):
        left, middle, right = axes
        draw_curve(left, exact, curve)
        draw_stresses(middle, exact, displacement, r, hoop, radial)
        drawn = PolyCollection(
            [*(1e3 * parts)], array=hoop / 1e6, cmap="viridis", linewidths=0, antialiased=False,
            snap=False, rasterized=True, zorder=2,
        )  # fmt: skip
        right.add_collection(drawn)
        angle = np.linspace(0, 0.5 * np.pi, 200)
        c = 1e3 * exact.front(displacement)
        right.plot(c * np.cos(angle), c * np.sin(angle), "w--", lw=1.0, zorder=4)
        lines = 1e3 * h * np.arange(n + 1)
        right.vlines(lines, 0, lines[-1], color="0.6", lw=0.3, zorder=3)
        right.hlines(lines, 0, lines[-1], color="0.6", lw=0.3, zorder=3)
        right.grid(visible=False)
        right.set(aspect="equal", xlabel="$x$ (mm)", ylabel="$y$ (mm)")
        right.set(xlim=(0, lines[-1]), ylim=(0, lines[-1]))
        fig.colorbar(drawn, ax=right, label="$\\sigma_\\theta$ (MPa)")


if not args.no_plot and field is not None:
    picture(args.output / "thick_cylinder.png", field, shown)

finish(args, figures)
