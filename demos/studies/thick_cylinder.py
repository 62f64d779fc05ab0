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
from options import BASES, Options, natural, option, positive, switch
from scene import finish, say, solver_figures, stabilisation
from scipy.optimize import brentq

import dolfinmpm as mpm
from dolfinmpm.body.location import destinations

# %% [markdown]
# ## The closed form


# %%
class Hill:
    """Closed form of a tube of radii a and b (m) that flows under the pressure b ln(b/a)."""

    def __init__(self, a, b, E, nu, strength):
        self.a, self.b, self.Y = a, b, 2 * strength / np.sqrt(3)
        # u_b = compliance · c²
        self.compliance = self.Y * (1 - nu**2) / (E * b)
        self.limit = self.Y * np.log(b / a)
        self.last_displacement = self.compliance * b**2

    def pressure(self, u):
        """Pressure (Pa) at the outer displacement u (m)."""
        c2 = np.asarray(u, float) / self.compliance
        c = np.sqrt(np.clip(c2, self.a**2, self.b**2))
        plastic = self.Y * (np.log(c / self.a) + 0.5 * (1 - c**2 / self.b**2))
        elastic = 0.5 * self.Y * (1 / self.a**2 - 1 / self.b**2) * c2
        return np.where(c2 < self.a**2, elastic, plastic)

    def displacement(self, p):
        """Outer displacement (m) under a pressure (Pa) below the limit."""
        return brentq(lambda u: self.pressure(u) - p, 0, self.last_displacement, xtol=1e-16)

    def front(self, u):
        """Radius c (m) of the plastic zone."""
        return float(np.clip(np.sqrt(u / self.compliance), self.a, self.b))

    def stress(self, r, u):
        """Radial and hoop stress (Pa) at the radii r (m); once it yields anywhere."""
        c, b, Y = self.front(u), self.b, self.Y
        share = 0.5 * Y * c**2 / b**2
        flow = Y * (np.log(r / c) - 0.5 * (1 - c**2 / b**2))
        radial = np.where(r < c, flow, -share * (b**2 / r**2 - 1))
        return radial, np.where(r < c, flow + Y, share * (b**2 / r**2 + 1))


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
class Input(Options):
    """A thick cylinder under internal pressure, beyond its limit load."""

    h: float = positive(0.0125, "size of the cells (m)")
    points_per_cell: int = natural(3, "in each direction, about")
    basis: str = option("bspline2", choices=BASES)
    stabilisation: str = option(
        "aggregation", choices=("none", "ghost", "aggregation", "weak-aggregation", "extended")
    )
    factor: float = option(1.0, "of a penalty; see Stabilisation")
    threshold: float = option(0.5, "of aggregation")
    steps: int = natural(24, least=2)
    fbar: str = switch("off", "against locking")
    reach: float = option(1.3, "last outer displacement, over that at the limit", above=1)
    inner: float = positive(0.1, "inner radius (m)")
    outer: float = positive(0.2, "outer radius (m)")
    modulus: float = positive(210e9, "Young's modulus (Pa)")
    poisson: float = 0.3
    strength: float = option(0.24e9, "uniaxial yield stress, Pa")

    def _check(self):
        if not self.inner < self.outer < np.inf:
            raise ValueError(f"radii {self.inner} and {self.outer} m must increase")
        if not self.h <= 0.5 * (self.outer - self.inner):
            raise ValueError(f"h = {self.h} m must be at most half the wall")


# %% [markdown]
# ## The scene
# Rollers on the two lines of symmetry; nothing holds the tube else. The grid ends somewhere
# outside the tube. Von Mises' law takes $\rho_y = \sqrt{2/3}\,\sigma_y$, for
# $f = \sqrt{2 J_2} - \rho_y$.

# %%
args = Input.parse()
a, b, h = args.inner, args.outer, args.h
exact = Hill(a, b, args.modulus, args.poisson, args.strength)
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
length = args.reach * exact.last_displacement / args.steps
problem = mpm.ArcLength(
    F,
    u,
    points,
    bcs=mpm.rollers(V, "left", "bottom"),
    load=pressure,
    control=outer.mean_normal(v),
    length=length,
    max_length=length,
    target_iterations=50,
    stabilisation=stabilisation(
        args.stabilisation, factor=args.factor, threshold=args.threshold, E=args.modulus
    ),
)

# %% [markdown]
# ## Steps of equal outer displacement
# At the step next to $c = \sqrt{ab}$ the stresses are kept for the picture.

# %%
ready = time.perf_counter()
shown = max(1, round(exact.compliance * a * b / length))
curve, residuals, field = [(0.0, 0.0)], [], None
for _ in mpm.steps(args.steps, label="outer displacement"):
    record = problem.step()
    curve.append((record.displacement, record.factor * exact.limit))
    residuals.append(record.residuals[-2:])
    if len(problem.history) == shown:
        field = points.gather("x0", "corners", "stress")
curve = np.array(curve)

# %% [markdown]
# ## Against the closed form
# Hill's solution is one of small strains. At the limit the inner radius has grown by half
# a per cent, and a tube that flows carries $Y\ln(b'/a')$ with the radii $a'$, $b'$ that it
# has by then: with the usual numbers 0.6 % less than the limit load. With
# `--strength 0.024e9`, a tenth, the strains are a tenth too and the difference goes.

# %%
closed = exact.pressure(curve[1:, 0])
error = curve[1:, 1] / closed - 1
# near the limit the displacement says little about the pressure's error, and less in return
lower = curve[(curve[:, 1] > 0) & (curve[:, 1] < 0.95 * exact.limit)]
displacement_error = [w / exact.displacement(p) - 1 for w, p in lower]
# mean radial displacement of the inner face
face = points["inner_area"]
inwards = grid.comm.allreduce(float(np.sum(face * inner.displacements())), op=MPI.SUM)
limit_now = exact.Y * np.log((b + curve[-1, 0]) / (a - inwards / inner.total_area))
figures = {
    "outer_displacement": curve[:, 0].tolist(),
    "pressure": curve[:, 1].tolist(),
    "pressure_exact": [0.0, *closed.tolist()],
    "max_pressure_error": float(np.abs(error).max()),
    "max_displacement_error": float(np.abs(displacement_error).max()),
    "limit_load": float(curve[-1, 1]),
    "limit_load_exact": float(exact.limit),
    "limit_load_error": float(curve[-1, 1] / exact.limit - 1),
    "limit_load_of_present_radii": float(limit_now),
    **solver_figures(problem),
    "last_residuals": residuals,
    "seconds_setup": ready - started,
    "seconds_solve": sum(record.seconds for record in problem.history),
}
say("outer displacement (mm)   pressure (MPa)   closed form")
for (displacement, p), reference in zip(curve[1:], closed):
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
    radial = np.einsum("pi,pij,pj->p", e_r, stress[:, :2, :2], e_r) / 1e6
    hoop = np.einsum("pi,pij,pj->p", e_t, stress[:, :2, :2], e_t) / 1e6
    R = np.linspace(a, b, 300)
    with mpm.figure(path, 7.5, 2.5, ncols=3, width_ratios=(1, 1, 1.5)) as (fig, axes):
        left, middle, right = axes
        fine = np.linspace(0, curve[-1, 0], 400)
        left.plot(1e3 * fine, exact.pressure(fine) / 1e6, color="C0", label="closed form")
        left.plot(1e3 * curve[:, 0], curve[:, 1] / 1e6, "o", color="C1", label="material points")
        left.axhline(exact.limit / 1e6, color="0.5", ls="--", lw=0.8)
        left.text(30 * fine[-1], exact.limit / 1e6, "limit load", va="bottom", size=7)
        left.set(xlabel="outer displacement $u_b$ (mm)", ylabel="internal pressure $p$ (MPa)")
        left.set(xlim=(0, None), ylim=(0, 1.12 * exact.limit / 1e6))
        left.legend(loc="lower right")
        for values, closed, name, colour in zip(
            (hoop, radial), exact.stress(R, displacement)[::-1], ("\\theta", "r"), ("C1", "C2")
        ):
            middle.plot(1e3 * r, values, ".", ms=1.2, alpha=0.5, color=colour, rasterized=True)
            middle.plot(1e3 * R, closed / 1e6, "k-", lw=0.8)
            middle.plot([], [], ".", ms=5, color=colour, label=f"$\\sigma_{{{name}}}$")
        middle.plot([], [], "k-", lw=0.8, label="closed form")
        middle.set(xlabel="radius $r$ (mm)", ylabel="stress (MPa)")
        middle.legend(loc="lower right")
        drawn = PolyCollection(
            [*(1e3 * parts)], array=hoop, cmap="viridis", linewidths=0, antialiased=False,
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
    picture(args.output / "thick_cylinder.png", field, curve[shown, 0])

finish(args, figures)
