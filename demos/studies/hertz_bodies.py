# %% [markdown]
# # Two elastic cylinders, or spheres, are pressed together
#
# Two bodies of radius R have separate fields on one grid. The grid fits neither of them. Their
# boundaries touch with `contact_between`. The moduli are $1/E^* = (1-\nu^2)(1/E_1 + 1/E_2)$, and
# $R^* = R/2$. Cylinders under the line load P touch over the half-width
# $b = \sqrt{4PR^*/\pi E^*}$, with the pressure $p_0 = 2P/\pi b$ in the middle. The centres of
# whole cylinders approach by $\delta = \frac{P}{\pi E^*}\left(2\ln\frac{4R}{b} - 1\right)$.
# Spheres under P touch within $b = (3PR^*/4E^*)^{1/3}$, with $p_0 = 3P/2\pi b^2$ and
# $\delta = b^2/R^*$ (Johnson, Contact Mechanics, 1985, ch. 4 and 5).
#
# The halves that face each other are solved: one half of these for cylinders, and a quarter for
# spheres. Their diametral planes approach by δ. Cells have the size h around the contact, and
# grow away from it. The half-width is that of an elliptic pressure with the same second moment:
# $\langle x^2\rangle = b^2/4$ for cylinders, $\langle r^2\rangle = 2b^2/5$ for spheres. The peak
# is that of the ellipse that fits best within 0.4 of the half-width.
#
# Results with b/R = 0.05: the half-width is within 0.6, 0.9 and 1.1 % with b/h = 6, 8 and 12, the
# peak within 1.5, 1.4 and 0.2 %. With b/R = 0.025 the half-width is within 0.1 %. The planes
# approach by 4.5 % less than the closed form of whole cylinders, because they stay plane here.
# The half-width of spheres is within 1.3 % with b/R = 0.12 and b/h = 4. They approach by 5 %
# less.
#
# The pressure on single segments alternates by a tenth, and on pieces of spheres by a third,
# because the surfaces have kinks where cells meet. It alternates more with a stiffer penalty.
# With multipliers that bound the penetration to 20 μm, a third of a per cent of a cell, the peak
# is 11 % too low.

# %%
import math
from dataclasses import dataclass

import numpy as np
from dolfinx import fem
from hertz_fit import draw_pressure, fitted_ellipse
from mpi4py import MPI
from options import Options, natural, option, positive
from scene import draw_points, finish, say, solver_figures

import dolfinmpm as mpm


@dataclass
class Input(Options):
    """Two elastic cylinders, or spheres, are pressed together."""

    shape: str = option("cylinder", choices=("cylinder", "sphere"))
    radius: float = positive(1.0, "R of both (m)")
    modulus: float = positive(1e6, "Young's modulus (Pa)")
    ratio: float = positive(1.0, "of the upper one's to it")
    poisson: float = option(0.3, least=0, below=0.5)
    half_width: float | None = positive(None, "to aim at, b/R; 0.05 or 0.12", most=0.2)
    resolution: float | None = positive(None, "b/h; 8, or of spheres 4")
    growth: float = option(1.35, "of cells away from it", least=1)
    friction: float = 0.0
    penalty: float = positive(5.0, "see contact_between")
    penetration: float | None = option(None, "bound, by multipliers (m)")
    points_per_cell: int = natural(2)
    steps: int = natural(4)
    basis: str = option("gimp", choices=("gimp", "linear", "bspline2"))

    def _check(self):
        sphere = self.shape == "sphere"
        self.fill(half_width=0.12 if sphere else 0.05, resolution=4.0 if sphere else 8.0)


def stiffness(args):
    """E* of both (Pa)."""
    return args.modulus / (1 - args.poisson**2) / (1 + 1 / args.ratio)


def closed_form(args, force):
    """Half-width (m), peak pressure (Pa) and approach (m) under a load (N; N/m of cylinders)."""
    if args.shape == "sphere":
        b = (3 * force * args.radius / (8 * stiffness(args))) ** (1 / 3)
        return b, 1.5 * force / (math.pi * b**2), 2 * b**2 / args.radius
    b = math.sqrt(2 * force * args.radius / (math.pi * stiffness(args)))
    approach = force / (math.pi * stiffness(args)) * (2 * math.log(4 * args.radius / b) - 1)
    return b, 2 * force / (math.pi * b), approach


def load_of(args, b):
    """The load whose half-width is b (m)."""
    if args.shape == "sphere":
        return 8 * stiffness(args) * b**3 / (3 * args.radius)
    return math.pi * stiffness(args) * b**2 / (2 * args.radius)


def lines(h, fine, last, growth):
    """Grid lines from 0: cells of the size h at first, which grow then (m)."""
    count = math.ceil(fine / h)
    sizes = [h * growth]
    while h * count + sum(sizes) < last:
        sizes.append(sizes[-1] * growth)
    sizes = np.array(sizes) * (last - h * count) / sum(sizes)
    return np.r_[h * np.arange(count + 1), h * count + np.cumsum(sizes)]


# %% [markdown]
# ## The problem
# Halves of bodies that end at their diametral planes; rims a few half-widths long, of segments of a
# quarter of a cell, or caps of triangles of half a cell.


# %%
def rims(points, args, b, h):
    """Boundaries of the lower and the upper body around the place where they touch."""
    R, far = args.radius, min(4 * b, args.radius)
    if args.shape == "cylinder":
        turn = np.arange(0.0, math.asin(far / R), 0.25 * h / R)
        rim = R * np.column_stack([np.sin(turn), np.cos(turn) - 1])
        both = rim[::-1], rim * (1, -1)
        return [mpm.Boundary.from_polygon(points, x, closed=False, rule=1) for x in both]
    r = np.linspace(0.0, 0.6 * far, math.ceil(1.2 * far / h) + 1)
    turn = np.linspace(0.0, 0.5 * np.pi, 9)
    x, y = np.outer(r, np.cos(turn)).ravel(), np.outer(r, np.sin(turn)).ravel()
    down = np.sqrt(R**2 - x**2 - y**2) - R
    n = len(turn)
    a = (n * np.arange(len(r) - 1)[:, None] + np.arange(n - 1)).ravel()
    # in the middle one of both triangles has no area
    inner = a[a >= n]
    sides = np.concatenate(
        [np.column_stack([a, a + n, a + n + 1]), np.column_stack([inner, inner + n + 1, inner + 1])]
    )
    caps = (down, sides), (-down, sides[:, ::-1])
    return [mpm.Boundary.from_triangles(points, np.column_stack([x, y, z]), t) for z, t in caps]


class Scene:
    """The part with positive x, and of spheres y, of the halves that face each other."""

    def __init__(self, args):
        R, b = args.radius, args.half_width * args.radius
        self.args, self.h = args, b / args.resolution
        d = 2 if args.shape == "cylinder" else 3
        self.parts = 2 ** (d - 1)
        zero, side = (0.0,) * (d - 1), (R,) * (d - 1)
        out = lines(self.h, 1.6 * b, 1.02 * R, args.growth)
        up = lines(self.h, 1.2 * b, R, args.growth)
        grid = mpm.create_lattice(MPI.COMM_WORLD, [out] * (d - 1) + [np.r_[-up[::-1], up[1:]]])
        quarters = [
            mpm.Ball((*zero, y), R) & mpm.Box((*zero, min(y, 0)), (*side, max(y, 0)))
            for y in (-R, R)
        ]
        parts = [
            mpm.fill(grid, shape, args.points_per_cell, 1000.0, tag=k + 1, exact=True)
            for k, shape in enumerate(quarters)
        ]
        self.points = points = parts[0] + parts[1]
        spaces = [mpm.Space(grid, args.basis, tag=k) for k in (1, 2)]
        u, v = [V.increment for V in spaces], [V.test for V in spaces]
        F = 0
        for k, E in enumerate((args.modulus, args.modulus * args.ratio)):
            law = mpm.materials.Hencky(E, args.poisson)
            F += mpm.momentum(law, points, u[k], v[k], tag=k + 1)
        self.rims = rims(points, args, b, self.h)
        F += mpm.contact_between(
            self.rims[::-1], u[::-1], v[::-1], friction=args.friction, penalty=args.penalty,
            penetration=args.penetration,
        )  # fmt: skip
        # the load that the half-width would have, and how far that goes
        self.approach = closed_form(args, load_of(args, b))[2]
        down = fem.Constant(grid, -self.approach / args.steps)
        bcs = mpm.fixed(spaces[0], "bottom") + mpm.prescribed(
            spaces[1], "top", d - 1, increment=down
        )
        for k in range(d - 1):
            bcs += mpm.prescribed(spaces[1], "top", k, increment=0.0)
        for V in spaces:
            bcs += mpm.rollers(V, *("left", "front")[: d - 1])
        self.problem = mpm.QuasiStatic(F, u, points, bcs, stabilisation="ghost")

    def run(self):
        """Press them together. Collective."""
        for _ in range(self.args.steps):
            self.problem.step()

    @property
    def force(self):
        """The load of whole bodies (N; N/m of cylinders)."""
        (record,) = self.problem.history[-1].bodies.values()
        return self.parts * record["force"][-1]

    def pressures(self):
        """Distances from the middle (m), forces (N) and pressures (Pa) of markers. Collective."""
        rim = self.rims[1].markers
        name = self.problem.form.parts.terms[0].names.normal_force
        own = np.linalg.norm(rim["x"][:, :-1], axis=1), rim[name], rim[name] / rim["V"]
        x, force, pressure = (
            np.concatenate(part) for part in zip(*self.points.comm.allgather(own))
        )
        some = np.argsort(x)
        some = some[force[some] > 0]
        return x[some], force[some], pressure[some]


def draw(args, scene, figures):
    """The bodies and their pressure, of spheres near the plane y = 0; rank 0 writes."""
    rows = scene.points.gather("x", "F", "l0", "stress")
    x, force, p = scene.pressures()
    if MPI.COMM_WORLD.rank:
        return
    label = "segments of the rim"
    if args.shape == "sphere":
        # means of rings, for there are thousands of markers
        label, ring = "rings of the cap", np.floor(4 * x / scene.h).astype(int)
        sums = [np.bincount(ring, weights) for weights in (force / p * x, force, force / p)]
        some = sums[2] > 0
        x, force, area = (values[some] for values in sums)
        x, p = x / area, force / area
    b, peak = figures["exact_half_width"], figures["exact_peak_pressure"]
    path = args.output / f"hertz_{args.shape}s.png"
    with mpm.figure(path, 7.2, 3.2, ncols=2) as (whole, axes):
        left, right = np.ravel(axes)
        up = rows[0].shape[1] - 1
        near = np.ones(len(rows[0]), bool) if up == 1 else rows[0][:, 1] < 0.5 * scene.h
        at, F, l0, stress = (values[near] for values in rows)
        at, F, l0 = at[:, [0, up]], F[:, [0, up]][:, :, [0, up]], l0[:, [0, up]]
        value = -stress[:, up, up] / 1e3
        drawn = draw_points(left, at, F, l0, value, clim=(0, peak / 1e3))
        left.set(xlim=(0, 3 * b), ylim=(-3 * b, 3 * b), ylabel=f"${'xyz'[up]}$ (m)")
        whole.colorbar(drawn, ax=left, label="pressure along the load (kPa)")
        draw_pressure(right, figures, x, p, label)


# %%
args = Input.parse()
scene = Scene(args)
scene.run()
half_width, peak = fitted_ellipse(*scene.pressures(), args.shape == "sphere")
b, p0, approach = closed_form(args, scene.force)
figures = {
    "force": float(scene.force), "approach": scene.approach, "half_width": half_width,
    "peak_pressure": peak, "exact_half_width": b, "exact_peak_pressure": p0,
    "exact_approach": approach, "half_width_error": half_width / b - 1,
    "peak_error": peak / p0 - 1, "approach_error": scene.approach / approach - 1,
    "cells_in_half_width": half_width / scene.h, **solver_figures(scene.problem),
}  # fmt: skip
say(
    f"P = {scene.force:.6g} N, b/h = {figures['cells_in_half_width']:.1f}: half-width "
    f"{half_width:.5g} m ({b:.5g}, {100 * figures['half_width_error']:+.2f} %), peak "
    f"{peak:.5g} Pa ({p0:.5g}, {100 * figures['peak_error']:+.2f} %), approach "
    f"{scene.approach:.5g} m ({approach:.5g}, {100 * figures['approach_error']:+.2f} %)"
)
if not args.no_plot:
    draw(args, scene, figures)
finish(args, figures)
