# %% [markdown]
# # Two elastic cylinders are pressed together
#
# Each of two cylinders of radius R has a field of its own on one grid, which fits neither of them;
# their boundaries touch with `contact_between`. With the moduli
# $1/E^* = (1-\nu^2)(1/E_1 + 1/E_2)$ and $R^* = R/2$ they touch under the line load P over the
# half-width $b = \sqrt{4PR^*/\pi E^*}$ with the pressure $p_0 = 2P/\pi b$ in the middle, and two
# whole cylinders come nearer by
# $\delta = \frac{P}{\pi E^*}\left(2\ln\frac{4R}{b} - 1\right)$ between their
# centres (Johnson, Contact Mechanics, 1985, ch. 4 and 5).
#
# Half of the halves that face each other is solved, whose diametral planes approach by δ, in cells
# of the size h around the contact that grow away from it. The half-width is that which an elliptic
# pressure with the found second moment has, $\langle x^2\rangle = b^2/4$; the peak that of the
# ellipse that fits best within 0.4 of it.
#
# What comes out with b/R = 0.05: the half-width within 0.6, 0.9 and 1.1 % with b/h = 6, 8 and 12,
# the peak within 1.5, 1.4 and 0.2 %; with b/R = 0.025 the half-width within 0.1 %. The planes
# approach by 4.5 % less than the closed form says of whole cylinders: they stay plane here. The
# pressure on single segments alternates by a tenth, for the surfaces have kinks where cells meet,
# and the more so the stiffer the penalty: with multipliers that bound the penetration to 20 μm, a
# third of a percent of a cell, the peak comes out 11 % too low.

# %%
import math

import numpy as np
from dolfinx import fem
from mpi4py import MPI
from scene import draw_points, finish, parser, say, solver_figures

import dolfinmpm as mpm


def arguments(words=None):
    """The command line."""
    options = parser("Two elastic cylinders are pressed together.")
    options.add_argument("--radius", type=float, default=1.0, help="R of both (m)")
    options.add_argument("--modulus", type=float, default=1e6, help="Young's modulus (Pa)")
    options.add_argument("--ratio", type=float, default=1.0, help="of the upper one's to it")
    options.add_argument("--poisson", type=float, default=0.3)
    options.add_argument("--half-width", type=float, default=0.05, help="to aim at, b/R")
    options.add_argument("--resolution", type=float, default=8.0, help="b/h")
    options.add_argument("--growth", type=float, default=1.35, help="of cells away from it")
    options.add_argument("--friction", type=float, default=0.0)
    options.add_argument("--penalty", type=float, default=5.0, help="see contact_between")
    options.add_argument("--penetration", type=float, help="bound, by multipliers (m)")
    options.add_argument("--points-per-cell", type=int, default=2)
    options.add_argument("--steps", type=int, default=4)
    options.add_argument("--basis", choices=("gimp", "linear", "bspline2"), default="gimp")
    given = options.parse_args(words)
    if not min(given.radius, given.modulus, given.ratio, given.resolution, given.penalty) > 0:
        options.error("radius, modulus, ratio, resolution and penalty must be positive")
    if not (0 <= given.poisson < 0.5 and 0 < given.half_width <= 0.2 and given.growth >= 1):
        options.error("poisson must be in [0, 0.5), half-width in (0, 0.2], growth at least 1")
    if min(given.steps, given.points_per_cell) < 1:
        options.error("steps and points-per-cell must be at least 1")
    return given


def stiffness(args):
    """E* of both (Pa)."""
    return args.modulus / (1 - args.poisson**2) / (1 + 1 / args.ratio)


def closed_form(args, force):
    """Half-width (m), peak pressure (Pa) and approach (m) under a line load (N/m)."""
    b = math.sqrt(2 * force * args.radius / (math.pi * stiffness(args)))
    approach = force / (math.pi * stiffness(args)) * (2 * math.log(4 * args.radius / b) - 1)
    return b, 2 * force / (math.pi * b), approach


def lines(h, fine, last, growth):
    """Grid lines from 0: cells of the size h at first, which grow then (m)."""
    count = math.ceil(fine / h)
    sizes = [h * growth]
    while h * count + sum(sizes) < last:
        sizes.append(sizes[-1] * growth)
    sizes = np.array(sizes) * (last - h * count) / sum(sizes)
    return np.r_[h * np.arange(count + 1), h * count + np.cumsum(sizes)]


# %% [markdown]
# ## The scene
# Halves of discs that end at their diametral planes; rims a few half-widths long, of segments of a
# quarter of a cell.


# %%
class Scene:
    """Quarters of two cylinders: the right half of the lower half, and of the upper one."""

    def __init__(self, args):
        R, b = args.radius, args.half_width * args.radius
        self.args, self.h = args, b / args.resolution
        out = lines(self.h, 1.6 * b, 1.02 * R, args.growth)
        up = lines(self.h, 1.2 * b, R, args.growth)
        grid = mpm.create_lattice(MPI.COMM_WORLD, [out, np.r_[-up[::-1], up[1:]]])
        quarters = [mpm.Ball((0, y), R) & mpm.Box((0, min(y, 0)), (R, max(y, 0))) for y in (-R, R)]
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
        turn = np.arange(0.0, min(4 * b / R, 0.5 * np.pi), 0.25 * self.h / R)
        rim = R * np.column_stack([np.sin(turn), np.cos(turn) - 1])
        self.rims = [
            mpm.Boundary.from_polygon(points, x, closed=False, rule=1)
            for x in (rim[::-1], rim * (1, -1))
        ]
        F += mpm.contact_between(
            self.rims[::-1], u[::-1], v[::-1], friction=args.friction, penalty=args.penalty,
            penetration=args.penetration,
        )  # fmt: skip
        # the load that the half-width would have, and how far that goes
        load = math.pi * stiffness(args) * b**2 / (2 * R)
        self.approach = closed_form(args, load)[2]
        down = fem.Constant(grid, -self.approach / args.steps)
        bcs = mpm.fixed(spaces[0], "bottom") + mpm.prescribed(spaces[1], "top", 0, 0.0)
        bcs += mpm.prescribed(spaces[1], "top", 1, down)
        bcs += mpm.rollers(spaces[0], "left") + mpm.rollers(spaces[1], "left")
        self.problem = mpm.QuasiStatic(F, u, points, bcs, stabilisation="ghost")

    def run(self):
        """Press them together. Collective."""
        for _ in range(self.args.steps):
            self.problem.step()

    @property
    def force(self):
        """The line load (N/m)."""
        (record,) = self.problem.history[-1].bodies.values()
        return 2 * record["force"][1]

    def pressures(self):
        """Distances from the middle (m), forces (N) and pressures (Pa) of segments. Collective."""
        rim = self.rims[1].markers
        name = self.problem.form.parts.between[0].names[1]
        own = rim["x"][:, 0], rim[name], rim[name] / rim["V"]
        x, force, pressure = (
            np.concatenate(part) for part in zip(*self.points.comm.allgather(own))
        )
        some = np.argsort(x)
        some = some[force[some] > 0]
        return x[some], force[some], pressure[some]


def measured(scene):
    """Half-width (m), from the second moment, and peak pressure (Pa). Collective."""
    x, force, pressure = scene.pressures()
    b = math.sqrt(4 * (force @ x**2) / force.sum())
    inner = x < 0.4 * b
    shape = np.sqrt(1 - (x[inner] / b) ** 2)
    return b, float(pressure[inner] @ shape / (shape @ shape))


def draw(args, scene, figures):
    """The cylinders and their pressure; rank 0 writes."""
    rows = scene.points.gather("x", "F", "l0", "stress")
    x, _, p = scene.pressures()
    if MPI.COMM_WORLD.rank:
        return
    b, peak = figures["exact_half_width"], figures["exact_peak_pressure"]
    with mpm.figure(args.output / "hertz_cylinders.png", 7.2, 3.2, ncols=2) as (whole, axes):
        left, right = np.ravel(axes)
        at, F, l0, stress = rows
        drawn = draw_points(left, at, F, l0, stress[:, 1, 1] / -1e3, clim=(0, peak / 1e3))
        left.set(xlim=(0, 3 * b), ylim=(-3 * b, 3 * b))
        whole.colorbar(drawn, ax=left, label=r"$-\sigma_{yy}$ (kPa)")
        s = np.linspace(0, b, 200)
        right.plot(s, peak * np.sqrt(1 - (s / b) ** 2) / 1e3, color="k", lw=1, label="Hertz")
        right.plot(x, p / 1e3, "o", ms=3, label="segments of the rim")
        right.set(xlabel="distance from the middle (m)", ylabel="pressure (kPa)")
        right.set(xlim=(0, 1.3 * b), ylim=(0, None))
        right.legend(frameon=False)


def main(words=None):
    """Run, print, and return the figures."""
    args = arguments(words)
    scene = Scene(args)
    scene.run()
    half_width, peak = measured(scene)
    b, p0, approach = closed_form(args, scene.force)
    figures = {
        "force": float(scene.force), "approach": scene.approach, "half_width": half_width,
        "peak_pressure": peak, "exact_half_width": b, "exact_peak_pressure": p0,
        "exact_approach": approach, "half_width_error": half_width / b - 1,
        "peak_error": peak / p0 - 1, "approach_error": scene.approach / approach - 1,
        "cells_in_half_width": half_width / scene.h, **solver_figures(scene.problem),
    }  # fmt: skip
    say(
        f"P = {scene.force:.6g} N/m, b/h = {figures['cells_in_half_width']:.1f}: half-width "
        f"{half_width:.5g} m ({b:.5g}, {100 * figures['half_width_error']:+.2f} %), peak "
        f"{peak:.5g} Pa ({p0:.5g}, {100 * figures['peak_error']:+.2f} %), approach "
        f"{scene.approach:.5g} m ({approach:.5g}, {100 * figures['approach_error']:+.2f} %)"
    )
    if not args.no_plot:
        draw(args, scene, figures)
    finish(args, figures)
    return figures


if __name__ == "__main__":
    main()
