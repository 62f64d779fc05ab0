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
# from the forces on the bed and on the wall. The energies are checked by the fall of the centre of
# mass: loads do the work $m g$ times this fall.
#
# With `--bed plane` the bed is an incline of the angle β, and the wall is out of reach. While all
# debris slides down on it, friction is μ times the normal force, however the debris deforms. So the
# centre of mass has the velocity of a block (with $v_n$ the velocity normal to the bed, at the end)
#
# $$v = g t\,(\sin\beta - \mu\cos\beta) - \mu v_n .$$
#
# Debris that spreads sideways or backwards rubs in other directions, so it is a little faster.

# %%
import contextlib
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

    bed: str = option("valley", choices=("valley", "plane"))
    angle: float = option(25.0, "of the plane (degrees)", above=0, below=45)
    raster: str = option("", "of heights (.asc, GeoTIFF), with (0, -30) at its lower corner")
    h: float = positive(2.5, "size of the cells (m)")
    points_per_cell: int = natural(2)
    friction_angle: float = option(30.0, "of the debris (degrees)", above=0, below=60)
    friction: float = option(0.2, "coefficient of the bed", least=0)
    wall: float = positive(105.0, "place of the wall (m)")
    duration: float | None = positive(None, "(s); 10, and 4 on a plane")
    film: bool = option(False, "debris_flow.gif, a film of the points in 3D; needs PyVista")

    def _check(self):
        if self.raster and self.bed == "plane":
            raise ValueError("--raster is a valley, and not --bed plane")
        self.fill(duration=4.0 if self.bed == "plane" else 10.0)


args = Input.parse()
g, density, h = 9.81, 2000.0, args.h

# %% [markdown]
# ## The valley
# A slope levels out, and a channel winds.

# %%
x, y = np.meshgrid(np.arange(0.0, 131.0, 5.0), np.arange(-30.0, 31.0, 5.0))
middle = 6.0 * np.sin(2 * np.pi * x / 130)
z = 8.0 + 40.0 * (1 - x / 130) ** 2 + 0.025 * (y - middle) ** 2
beta = np.radians(args.angle)
if args.bed == "plane":
    middle, z = 0.0 * x, 8.0 + np.tan(beta) * (130.0 - x)
if args.raster:
    valley = mpm.Terrain.from_raster(args.raster)
    x, y = np.meshgrid(*valley.lines)
    middle = 6.0 * np.sin(2 * np.pi * x / 130)
else:
    valley = mpm.Terrain.from_raster(z, spacing=5.0, corner=(0.0, -30.0))
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
place = args.wall if args.bed == "valley" else 124.0
wall = mpm.RigidBody(mpm.Box((place, -30, low), (place + 5, 30, high)), name="wall")
soil = mpm.materials.MohrCoulomb(1e6, 0.3, cohesion=0.0, friction_angle=args.friction_angle)
gravity = fem.Constant(grid, (0.0, 0.0, -g))
F = mpm.momentum(soil, points, u, v) - ufl.inner(points.density * gravity, v) * points.dX
F += mpm.contact(bed, points, u, v, friction=args.friction) + mpm.contact(wall, points, u, v)
problem = mpm.Explicit(F, u, points, mapping="apic")

film, frames = contextlib.nullcontext(), 0
if args.film:
    look = {"limits": (0, 15), "title": "t = {time:.1f} s", "bodies": (bed, wall)}
    film = mpm.animate(points, args.output / "debris_flow.gif", "velocity", **look)


def centre():
    """Centre of mass of the debris (m), and its mass (kg)."""
    m = points["density"] * points["V0"]
    sums = comm.allreduce(np.append(m @ points["x"], m.sum()))
    return sums[:3] / sums[3], sums[3]


start, mass = centre()
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

energies = problem.energies()
fall = mass * g * (start - centre()[0])[2]
losses = {name: loss / energies.external for name, loss in energies.losses.items() if loss}
say(f"weight does {fall / 1e6:.2f} MJ by the fall of the centre of mass, off by "
    f"{100 * (energies.external / fall - 1):.3f} % in the sum of energies; kinetic "
    f"{100 * energies.kinetic / energies.external:.1f} %, " +
    ", ".join(f"{name} {100 * share:.1f} %" for name, share in losses.items()))  # fmt: skip

block = None
if args.bed == "plane":
    velocity = problem.momentum() / mass
    along, normal = (
        velocity @ [np.cos(beta), 0, -np.sin(beta)],
        velocity @ [np.sin(beta), 0, np.cos(beta)],
    )
    exact = (
        g * curve["t"][-1] * (np.sin(beta) - args.friction * np.cos(beta)) - args.friction * normal
    )
    block = along / exact - 1
    say(f"velocity of the centre of mass {along:.3f} m/s, of a block {exact:.3f} m/s, "
        f"{100 * block:+.2f} %")  # fmt: skip

if not args.no_plot:
    with mpm.figure(args.output / "debris_flow.png", 7.0, 4.6, nrows=2, ncols=3) as (figure, axes):
        for ax, (t, found) in zip(axes.ravel(), shown):
            ax.contour(x, y, valley.heights.T, levels=12, colors="0.7", linewidths=0.5)
            if found is not None:
                speed = np.linalg.norm(found[1], axis=1)
                drawn = ax.scatter(*found[0].T[:2], s=0.6, c=speed, vmin=0, vmax=15, lw=0)
            ax.axvline(place, color="k", lw=1.5)
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
    "peak": float(hits.max()), "front": front, "steps": len(curve["t"]), "fall_work": float(fall),
    "work_error": float(energies.external / fall - 1),
    "kinetic": energies.kinetic / energies.external, "losses": losses, "block_error": block,
})  # fmt: skip
