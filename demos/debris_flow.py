"""A debris flow runs down a winding valley and hits a wall, in 3D.

The valley is a raster of heights. Here a formula makes the raster; `mpm.Terrain.from_raster` also
takes a GeoTIFF or an ESRI ASCII grid. The bed is a rigid body of triangles through the heights. The
debris is a lens on top of the bed. Points fill the space between both surfaces, with the exact
volume under the bilinear surfaces.

A rigid wall closes the valley. Bed and wall record the forces of the points on them. So there are
two ways to the momentum of the debris along the valley: from the velocities of the points, and
from the forces. `demos/studies/debris_flow.py` has finer cells and a film.
"""

import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI

import dolfinmpm as mpm

density, g, h, end, wall_at = 2000.0, 9.81, 5.0, 9.0, 95.0  # kg/m³, m/s², m, s, m

# heights: a slope that levels out, a channel that winds, and the lens of debris
x, y = np.meshgrid(np.arange(0.0, 131.0, 5.0), np.arange(-30.0, 31.0, 5.0))
middle = 6.0 * np.sin(2 * np.pi * x / 130)
z = 8.0 + 40.0 * (1 - x / 130) ** 2 + 0.025 * (y - middle) ** 2
lens = np.maximum(4.0 * (1 - ((x - 30) / 16) ** 2 - ((y - middle) / 12) ** 2), 0.0)
valley = mpm.Terrain.from_raster(z, spacing=5.0, corner=(0.0, -30.0))
# a small gap keeps the corners of the points' domains out of the bed at first
debris = valley.raised(lens.T).ground(bottom=valley.raised(0.8))

comm = MPI.COMM_WORLD
lines = [np.arange(a, b + h, h) for a, b in ((0, 130), (-30, 30), (5, 65))]
grid = mpm.create_lattice(comm, lines)
points = mpm.fill(grid, debris, per_cell=3, density=density, exact=True)
V = mpm.Space(grid, "gimp", domains="volume")
u, v = V.increment, V.test

bed = mpm.RigidBody(valley.solid(bottom=0.0), name="bed")
wall = mpm.RigidBody(mpm.Box((wall_at, -30, 0), (wall_at + 5, 30, 30)), name="wall")
soil = mpm.materials.MohrCoulomb(E=1e6, nu=0.3, cohesion=0.0, friction_angle=30.0)
gravity = fem.Constant(grid, (0.0, 0.0, -g))
F = mpm.momentum(soil, points, u, v) - ufl.inner(points.density * gravity, v) * points.dX
F += mpm.contact(bed, points, u, v, friction=0.2) + mpm.contact(wall, points, u, v)
problem = mpm.Explicit(F, u, points, mapping="apic")

curve, shown, time, pushed, force = mpm.History(), [], 0.0, None, 0.0
# at_once=1: each call takes a single step, so that the record has the force of every step.
for t in mpm.times(end, dt="auto", at_once=1, label="debris"):
    if time >= 0.5 * end * len(shown):
        shown.append((time, points.gather("x", "velocity")))
    record = problem.step(t)
    momentum = problem.momentum()[0]
    # the forces that a record has act in the next step
    pushed = momentum if pushed is None else pushed - (record.time - time) * force
    force = sum(record.bodies[name]["force"][0] for name in ("wall", "bed"))
    time = record.time
    curve.record(t=time, momentum=momentum, balance=pushed)
shown.append((time, points.gather("x", "velocity")))

with mpm.figure("output/debris_flow.png", 6.6, 4.4, nrows=2, ncols=2) as (figure, axes):
    for ax, (t, found) in zip(axes.ravel(), shown):
        ax.contour(x, y, z, levels=12, colors="0.7", linewidths=0.5)
        if found is not None:
            speed = np.linalg.norm(found[1], axis=1)
            drawn = ax.scatter(*found[0].T[:2], s=1.5, c=speed, vmin=0, vmax=15, lw=0)
        ax.axvline(wall_at, color="k", lw=1.5)
        ax.set(aspect="equal", title=f"$t = {t:.1f}$ s", xlabel="$x$ (m)", ylabel="$y$ (m)")
    if found is not None:
        figure.colorbar(drawn, ax=axes[1, 0], shrink=0.8, label="speed (m/s)")
    last = axes[1, 1]
    last.plot(curve["t"], curve["momentum"] / 1e6, label="points")
    last.plot(curve["t"][::25], curve["balance"][::25] / 1e6, "o", ms=3, label="forces")
    last.set(xlabel="time (s)", ylabel="momentum (kt m/s)")
    last.legend()

volume = comm.allreduce(float(points["V0"].sum()))
error = np.abs(curve["momentum"] - curve["balance"]).max() / curve["momentum"].max()
if comm.rank == 0:
    print(f"{points.total} points, {volume:.3f} m³, off by {volume / debris.volume - 1:.0e}")
    print(f"momentum off by {100 * error:.2f} %")
assert abs(volume / debris.volume - 1) < 1e-12
assert error < 0.01
