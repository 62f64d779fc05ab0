# %% [markdown]
# # A plate on a cube: what a penalty does, exactly
#
# A rigid plate presses on an elastic cube with ν = 0. The sides of the cube cannot move, and its
# base is smooth (Bird, Coombs & others, AMPSSIE, tutorial 2). Under the stretch λ the stress of
# the cube is $E \ln\lambda/\lambda$. The penalty of the plate gives a pressure: the stiffness per
# area κ times the overlap. So
#
# $$ E \ln\lambda/\lambda + \kappa\,(\lambda H - z) = 0 $$
#
# for the plate at the height z. Grid, basis and steps make no error, because the motion is linear
# in space. With GIMP only rounding is left, at any stiffness. Averaged splines have an error of
# 2e-5.
#
# Corners of the points' domains touch the plate: those on the marked top (`--contact surface`),
# or all corners (`--contact corners`). Both are the same as long as the overlap is less than a
# domain. Beyond that, corners of the next points enter the plate, too. With `--penetration`,
# multipliers take over the pressure, and the cube ends at the plate.

# %%
import math
from dataclasses import dataclass

import numpy as np
from grids import box_grid
from options import Options, natural, option, positive
from scene import finish, say, solver_figures
from scipy.optimize import brentq

import dolfinmpm as mpm


@dataclass
class Input(Options):
    """A rigid plate presses on an elastic cube."""

    stiffness_per_area: float = positive(1e8, "κ (Pa/m)")
    height: float = positive(0.8, "of the cube (m)")
    modulus: float = positive(1e6, "Young's modulus (Pa)")
    h: float = positive(0.4, "size of the cells (m)")
    points_per_cell: int = natural(2, "in each direction")
    steps: int = natural(20)
    displacement: float = positive(0.2, "of the plate (m)")
    dimension: int = option(3, choices=(2, 3))
    basis: str = option("gimp", choices=("gimp", "bspline2", "bspline3"))
    contact: str = option("surface", choices=("surface", "corners"))
    penetration: float | None = option(None, "bound of the overlap (m)")

    def _check(self):
        if self.displacement >= self.height:
            raise ValueError("the displacement must be less than the height")


def exact(E, kappa, H, z):
    """Height of the cube (m) and stress in it (Pa)."""
    out_of_balance = lambda s: E * math.log(s) / s + kappa * (s * H - z)  # noqa: E731
    # stress and overlap both rise with the stretch
    stretch = brentq(out_of_balance, min(1e-3, 0.5 * z / H), 1.0, xtol=1e-15, rtol=1e-14)
    return stretch * H, E * math.log(stretch) / stretch


# %%
def solve(args):
    """Press; returns figures and the points."""
    d, H = args.dimension, args.height
    n = max(1, round(H / args.h))
    h = H / n
    corner = (H,) * (d - 1)
    grid = box_grid([(0.0,) * d, (*corner, H + h)], (n,) * (d - 1) + (n + 1,))
    points = mpm.fill(grid, mpm.Box((0.0,) * d, (*corner, H)), args.points_per_cell, 1000.0)
    V = mpm.Space(grid, args.basis)
    u, v = V.increment, V.test
    down = (0.0,) * (d - 1) + (-1.0,)
    plate = mpm.RigidBody(
        mpm.Plane((*(0.0,) * (d - 1), H), down), name="plate",
        increment=tuple(args.displacement / args.steps * c for c in down),
    )  # fmt: skip
    top = None
    if args.contact == "surface":
        top = mpm.Surface(points, lambda x: np.isclose(x[-1], H), [-c for c in down], name="top")
    F = mpm.momentum(mpm.materials.Hencky(E=args.modulus, nu=0.0), points, u, v)
    F += mpm.contact(
        plate, points, u, v, stiffness_per_area=args.stiffness_per_area, surface=top,
        penetration=args.penetration,
    )  # fmt: skip
    sides = ("left", "right", "bottom") if d == 2 else ("left", "right", "front", "back", "bottom")
    problem = mpm.QuasiStatic(F, u, points, mpm.rollers(V, *sides), tolerance=1e-10)
    history = mpm.History()
    for _ in mpm.steps(args.steps, label="plate"):
        problem.step()
        history.record(height=float(plate.position[-1]), force=float(plate.force[-1]))
    z = H - args.displacement
    volume = points.comm.allreduce(float(points["V"].sum()))
    stress = points.comm.allreduce(float(points["V"] @ points["stress"][:, d - 1, d - 1])) / volume
    height, sigma = exact(args.modulus, args.stiffness_per_area, H, z)
    if args.penetration is not None:
        height, sigma = z, args.modulus * math.log(z / H) / (z / H)
    figures = {
        "height": volume / H ** (d - 1), "stress": stress, "force": float(plate.force[-1]),
        "exact_height": height, "exact_stress": sigma,
    }  # fmt: skip
    figures["height_error"] = figures["height"] / height - 1
    figures["stress_error"] = stress / sigma - 1
    figures["penetration"] = figures["height"] - z
    return figures | solver_figures(problem), points, history, plate


def draw(args, points, history, figures, plate):
    """Force against the plate's height, and the closed form; rank 0 writes."""
    area = args.height ** (args.dimension - 1)
    z = np.linspace(args.height - args.displacement, args.height, 50)[:-1]
    curve = [-exact(args.modulus, args.stiffness_per_area, args.height, s)[1] for s in z]
    with mpm.figure(args.output / "plate_on_cube.png", 4.0, 3.0) as (_, axes):
        axes.plot(args.height - z, np.array(curve) / 1e3, color="k", lw=1, label="closed form")
        sunk = args.height - history["height"]
        axes.plot(sunk, history["force"] / area / 1e3, "o", ms=4, label="material points")
        axes.set(xlabel="displacement of the plate (m)", ylabel="pressure (kPa)")
        axes.legend()


# %%
args = Input.parse()
figures, points, history, plate = solve(args)
say(
    f"height {figures['height']:.9f} m ({figures['exact_height']:.9f}), stress "
    f"{figures['stress']:.6g} Pa ({figures['exact_stress']:.6g}), at most "
    f"{figures['max_newton_iterations']} Newton iterations per step"
)
if not args.no_plot:
    draw(args, points, history, figures, plate)
finish(args, figures)
