# %% [markdown]
# # A cone is pressed into clay: its factor against Teh and Houlsby's
#
# A smooth penetrometer of 60°, radius R, is pressed from the surface into weightless clay that
# flows under the shear stress $c_u$ (Tresca, rigidity index $I_r = G/c_u$). Its resistance rises
# until the clay no longer flows to the surface, and is then steady. Teh & Houlsby (1991, doi
# 10.1680/geot.1991.41.1.17) found
#
# $$N_c = \frac{q_c}{c_u} = \frac43 (1 + \ln I_r)\left(1.25 + \frac{I_r}{2000}\right)$$
#
# for smooth cones in clay without a difference of its stresses at rest. Points are rings about the
# axis; shaft and cone are one rigid body.

# %%
from __future__ import annotations

import math
import time

import numpy as np
from dolfinx import mesh
from mpi4py import MPI
from scene import draw_points, finish, parser, say, solver_figures

import dolfinmpm as mpm
from dolfinmpm._platform.errors import ConvergenceError

R, COHESION = 1.0, 1e4  # m, Pa


# %%
def arguments():
    """The command line."""
    options = parser("A cone is pressed into clay.")
    add = options.add_argument
    add("--rigidity-index", type=float, default=100.0, help="I_r = G/c_u")
    add("--poisson", type=float, default=0.45)
    add("--depth", type=float, default=8.0, help="of the cone's shoulder, by R")
    add("--h", type=float, default=0.25, help="size of the cells, by R")
    add("--points-per-cell", type=int, default=2)
    add("--step", type=float, default=0.02, help="that the cone goes at once, by R")
    add("--width", type=float, default=20.0, help="of the clay, by R")
    add("--growth", type=float, default=1.25, help="of cells where nothing flows")
    add("--basis", choices=("linear", "gimp", "bspline2"), default="gimp")
    add("--fbar", choices=("on", "off"), default="on")
    add("--penalty", type=float, default=50.0, help="κ/E (1/R)")
    add("--friction", type=float, default=0.0)
    add("--corners", choices=("domains", "material"), default="material")
    add("--stabilisation", choices=("none", "ghost", "aggregation"), default="ghost")
    return options.parse_args()


args = arguments()
comm, h = MPI.COMM_WORLD, args.h * R
G = args.rigidity_index * COHESION
E = 2 * G * (1 + args.poisson)
exact = 4 / 3 * (1 + math.log(args.rigidity_index)) * (1.25 + args.rigidity_index / 2000)
cone_height = R / math.tan(math.radians(30))
deepest = args.depth * R + cone_height


def lines(fine, width):
    """Lines of cells of the size h from 0 to `fine`, that grow from there to `width` (m)."""
    at, size = h * np.arange(math.ceil(fine / h - 1e-9) + 1), h
    while at[-1] < width:
        size *= args.growth
        at = np.append(at, at[-1] + size)
    return at


# %%
across = lines(3 * R, args.width * R)
down = lines(deepest + 2 * R, deepest + args.width * R)
up = np.r_[-down[:0:-1], h * np.arange(math.ceil(1.5 * R / h) + 1)]
n = len(across) - 1, len(up) - 1
grid = mesh.create_rectangle(comm, [(0, 0), n], n, mesh.CellType.quadrilateral)
at = grid.geometry.x
at[:, 0], at[:, 1] = across[np.rint(at[:, 0]).astype(int)], up[np.rint(at[:, 1]).astype(int)]

points = mpm.fill(
    grid, mpm.Box((0.0, up[0]), (across[-1], 0.0)), args.points_per_cell, 1000.0, axisymmetric=True
)
V = mpm.Space(grid, args.basis)
clay = mpm.materials.Tresca(E, args.poisson, COHESION)
# the whole meridian: cone, and a shaft that is longer than the way
top = deepest + 4 * R
outline = [(0.0, 0.0), (R, cone_height), (R, top), (-R, top), (-R, cone_height)]
cone = mpm.RigidBody(
    mpm.Polygon(outline), velocity=(0.0, -args.step * R), fillet=0.5 * h, name="cone"
)
F = mpm.momentum(clay, points, V.increment, V.test, fbar=args.fbar == "on")
F += mpm.contact(
    cone,
    points,
    V.increment,
    V.test,
    penalty=args.penalty / R,
    friction=args.friction,
    corners=args.corners,
)
bcs = mpm.prescribed(V, "left", 0) + mpm.prescribed(V, "right", 0) + mpm.fixed(V, "bottom")
problem = mpm.QuasiStatic(F, V.increment, points, bcs, stabilisation=args.stabilisation)

started, history, reason = time.perf_counter(), mpm.History(), ""
steps = round(deepest / (args.step * R))
for share in mpm.steps(steps, "press"):
    try:
        record = problem.step()
    except ConvergenceError as error:
        reason = str(error)
        break
    resistance = record.bodies["cone"]["force"][1] / (math.pi * R**2 * COHESION)
    history.record(depth=(share * steps * args.step) - cone_height / R, factor=resistance)
depth, factor = np.array(history["depth"]), np.array(history["factor"])
# of the last two diameters, in which the factor should be steady
last = depth > depth[-1] - 4.0
N_c, scatter = float(factor[last].mean()), float(factor[last].std())
drift = float(np.polyfit(depth[last], factor[last], 1)[0]) if last.sum() > 1 else 0.0
figures = {
    "factor": N_c,
    "factor_exact": exact,
    "error": N_c / exact - 1,
    "scatter": scatter,
    "drift": drift,
    "depth": depth.tolist(),
    "factors": factor.tolist(),
    "reached": float(depth[-1]),
    "reason": reason,
    **solver_figures(problem),
    "seconds": time.perf_counter() - started,
}
say(
    f"{args.basis}, h = {args.h:g} R: factor {N_c:.2f} ± {scatter:.2f} over the last two "
    f"diameters, drift {drift:+.2f} a radius, Teh & Houlsby {exact:.2f} "
    f"({100 * figures['error']:+.1f} %); shoulder {depth[-1]:.2f} R deep, "
    f"{figures['newton_iterations']} iterations, {figures['halvings']} halvings, "
    f"{figures['seconds']:.0f} s" + (f"; ended: {reason[:200]}" if reason else "")
)

# %%
if not args.no_plot:
    rows = [
        points["x"],
        points["F"][:, :2, :2],
        points["l0"],
        points["stress"],
        points["plastic_strain"],
    ]
    x, deformed, l0, stress, strain = (np.concatenate(comm.gather(a) or [a]) for a in rows)
    if comm.rank == 0:
        with mpm.figure(args.output / "cone_penetration.png", 7.0, 3.4, ncols=2) as (
            figure,
            (left, right),
        ):
            left.plot(factor, depth, lw=1)
            left.axvline(exact, color="0.6", lw=1.5)
            left.set(
                xlabel="$q_c/c_u$", ylabel="depth of the shoulder / R", ylim=(depth[-1], depth[0])
            )
            drawn = draw_points(right, x, deformed, l0, np.log10(strain + 1e-3), cmap="magma")
            right.fill(*(np.array(outline) - (0, args.step * len(depth) * R)).T, color="0.5")
            right.set(xlim=(0, 5 * R), ylim=(-deepest - 2 * R, 1.5 * R))
            figure.colorbar(drawn, label=r"$\log_{10}$ plastic strain")
finish(args, figures)
