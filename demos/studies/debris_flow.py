# %% [markdown]
# # A debris flow runs down a winding valley and hits a wall, in 3D
#
# The valley is a raster of heights, 5 m wide cells as in a coarse survey. A formula makes the
# raster; `--raster` takes an ESRI ASCII grid or a GeoTIFF instead. The bed is a rigid body of
# triangles through the heights. The debris that is let go is a lens on top of the bed. Points fill
# the space between both surfaces, with the exact volume under the bilinear surfaces.
#
# A rigid wall closes the valley. Bed and wall record the forces of the points on them. So there are
# two ways to the momentum of the debris along the valley: from the velocities of the points, and
# from the forces on the bed and on the wall.

# %%
import contextlib
import importlib.util
from dataclasses import dataclass

import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI
from options import Options, natural, option, positive
from scene import finish, say

import dolfinmpm as mpm


@dataclass
class Input(Options):
    """A debris flow in a valley of a raster, 130 m long and 60 m wide, against a wall."""

    raster: str = option("", "of heights (.asc, GeoTIFF), with (0, -30) at its lower corner")
    h: float = positive(2.5, "size of the cells (m)")
    points_per_cell: int = natural(2)
    friction_angle: float = option(30.0, "of the debris (degrees)", above=0, below=60)
    friction: float = option(0.2, "coefficient of the bed", least=0)
    wall: float = positive(105.0, "place of the wall (m)")
    duration: float = positive(10.0, "(s)")


args = Input.parse()
g, density, h = 9.81, 2000.0, args.h

# %% [markdown]
# ## The valley
# A slope levels out, and a channel winds.

# %%
x, y = np.meshgrid(np.arange(0.0, 131.0, 5.0), np.arange(-30.0, 31.0, 5.0))
middle = 6.0 * np.sin(2 * np.pi * x / 130)
z = 8.0 + 40.0 * (1 - x / 130) ** 2 + 0.025 * (y - middle) ** 2
if args.raster:
    valley = mpm.Terrain.from_raster(args.raster)
    x, y = np.meshgrid(*valley.lines)
else:
    valley = mpm.Terrain.from_raster(z, spacing=5.0, corner=(0.0, -30.0))
middle = 6.0 * np.sin(2 * np.pi * x / 130)
lens = np.maximum(4.0 * (1 - ((x - 30) / 16) ** 2 - ((y - middle) / 12) ** 2), 0.0)
# a small gap keeps the corners of the points' domains out of the bed at first
debris = valley.raised(lens.T).ground(bottom=valley.raised(0.5))

# %% [markdown]
# ## The flow

# %%
comm = MPI.COMM_WORLD
low = h * np.floor(valley.heights.min() / h) - h
high = h * np.ceil(valley.heights.max() / h) + 6 * h
lines = [np.arange(a, b + h, h) for a, b in ((0, 130), (-30, 30), (low, high))]
grid = mpm.create_lattice(comm, lines)
points = mpm.fill(grid, debris, args.points_per_cell, density, exact=True)
V = mpm.Space(grid, "gimp", domains="volume")
u, v = V.increment, V.test
bed = mpm.RigidBody(valley.solid(bottom=low - h), name="bed")
box = mpm.Box((args.wall, -30, low), (args.wall + 5, 30, high))
wall = mpm.RigidBody(box, name="wall")
soil = mpm.materials.MohrCoulomb(1e6, 0.3, cohesion=0.0, friction_angle=args.friction_angle)
gravity = fem.Constant(grid, (0.0, 0.0, -g))
F = mpm.momentum(soil, points, u, v) - ufl.inner(points.density * gravity, v) * points.dX
F += mpm.contact(bed, points, u, v, friction=args.friction) + mpm.contact(wall, points, u, v)
problem = mpm.Explicit(F, u, points, mapping="apic")

film, frames = contextlib.nullcontext(), 0
if not args.no_plot and importlib.util.find_spec("pyvista"):  # films in 3D need it
    look = {"limits": (0, 15), "title": "t = {time:.1f} s", "bodies": (bed, wall)}
    film = mpm.animate(points, args.output / "debris_flow.gif", "velocity", **look)

curve, shown, time, pushed, force = mpm.History(), [], 0.0, None, 0.0
with film as recorder:
    # at_once=1: each call takes a single step, so that the record has the force of every step.
    for t in mpm.times(args.duration, dt="auto", at_once=1, label="debris"):
        if time >= 0.4 * args.duration * len(shown):
            shown.append((time, points.gather("x", "velocity")))
        if recorder is not None and time >= 0.2 * frames:
            recorder.write(time)
            frames += 1
        record = problem.step(t)
        momentum = problem.momentum()[0]
        # the forces that a record has act in the next step
        pushed = momentum if pushed is None else pushed - (record.time - time) * force
        hit, rubbed = (record.bodies[name]["force"][0] for name in ("wall", "bed"))
        force, time = hit + rubbed, record.time
        curve.record(t=time, hit=hit, momentum=momentum, balance=pushed)
shown.append((time, points.gather("x", "velocity")))

# %% [markdown]
# ## What came out
# The force on the wall is the mean over quarters of a second, as from a load cell.

# %%
impulse = np.cumsum(curve["hit"] * np.diff(curve["t"], prepend=0.0))
parts = np.arange(0.0, args.duration + 0.01, 0.25)
hits = np.diff(np.interp(parts, curve["t"], impulse)) / 0.25
volume = comm.allreduce(float(points["V0"].sum()))
off = volume / debris.volume - 1
error = float(np.abs(curve["momentum"] - curve["balance"]).max() / curve["momentum"].max())
front = comm.allreduce(float(points["x"][:, 0].max(initial=0.0)), op=MPI.MAX)
say(f"{points.total} points, {volume:.3f} m³, off by {off:.0e}; the front is at {front:.1f} m")
say(f"wall: peak {hits.max() / 1e6:.2f} MN; momentum off by {100 * error:.2f} %")

if not args.no_plot:
    with mpm.figure(args.output / "debris_flow.png", 7.0, 4.6, nrows=2, ncols=3) as (figure, axes):
        for ax, (t, found) in zip(axes.ravel(), shown):
            ax.contour(x, y, valley.heights.T, levels=12, colors="0.7", linewidths=0.5)
            if found is not None:
                speed = np.linalg.norm(found[1], axis=1)
                drawn = ax.scatter(*found[0].T[:2], s=0.6, c=speed, vmin=0, vmax=15, lw=0)
            ax.axvline(args.wall, color="k", lw=1.5)
            ax.set(aspect="equal", title=f"$t = {t:.0f}$ s", xlabel="$x$ (m)", ylabel="$y$ (m)")
        if found is not None:
            figure.colorbar(drawn, ax=axes[0, 2], shrink=0.7, label="speed (m/s)")
        axes[1, 0].axis("off") if len(shown) < 4 else None
        left, right = axes[1, 1:]
        left.plot(curve["t"], curve["momentum"] / 1e6, label="points")
        few = max(len(curve["t"]) // 20, 1)
        left.plot(curve["t"][::few], curve["balance"][::few] / 1e6, "o", ms=3, label="forces")
        left.set(xlabel="time (s)", ylabel="momentum (kt m/s)")
        left.legend()
        right.plot(parts[1:] - 0.125, hits / 1e6)
        right.set(xlabel="time (s)", ylabel="force on the wall (MN)", ylim=(0, None))

finish(args, {
    "points": points.total, "volume": volume, "volume_error": off, "momentum_error": error,
    "peak": float(hits.max()), "front": front, "steps": len(curve["t"]),
})  # fmt: skip
