"""A landslide runs down a slope and hits a wall: the history of the force on the wall.

A block of dry sand, 12 m long and 6 m high, starts at rest on a slope of 35°. It collapses and runs
18 m down the slope, with a coefficient of friction of tan 20°. A smooth rigid wall stops it.
The front runs up the wall, and the rest comes to rest behind the front.

Gravity is tilted, so that the slope is level on the grid. Slope and wall are rigid bodies. Each
step records the forces of the points on them. So there are two ways to the momentum,

    p(t) = M g t sin 35° − ∫ (T_slope + N_wall) dt,

from the velocities of the points at the left, and from forces alone at the right.

The sand has no cohesion: points without contact fly. APIC carries velocities between points and
grid: it keeps momentum, and has less noise than FLIP in an impact.
"""

import math

import numpy as np
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

import dolfinmpm as mpm

angle, friction, g, density = math.radians(35), math.tan(math.radians(20)), 9.81, 1800.0
length, height, way, h, end = 12.0, 6.0, 18.0, 0.75, 7.0  # m, s

corners, cells = [(-3, -h), (33, 21)], (48, 29)
grid = mesh.create_rectangle(MPI.COMM_WORLD, corners, cells, mesh.CellType.quadrilateral)
points = mpm.fill(grid, mpm.Box((0, 0), (length, height)), per_cell=3, density=density)
V = mpm.Space(grid, basis="gimp", domains="volume")
u, v = V.increment, V.test

slope = mpm.RigidBody(mpm.Plane((0, 0), (0, 1)), name="slope")
face = length + way
wall = mpm.RigidBody(mpm.Box((face, -3), (face + 2, 30)), name="wall")
sand = mpm.materials.MohrCoulomb(E=5e6, nu=0.3, cohesion=0.0, friction_angle=30.0)
gravity = fem.Constant(grid, (g * math.sin(angle), -g * math.cos(angle)))
F = mpm.momentum(sand, points, u, v) - ufl.inner(points.density * gravity, v) * points.dX
F += mpm.contact(slope, points, u, v, friction=friction) + mpm.contact(wall, points, u, v)
problem = mpm.Explicit(F, u, points, mapping="apic")

weight, time, balance = length * height * density * g * math.sin(angle), 0.0, 0.0
curve, shown, wanted = mpm.History(), [], [0.0, 2.2, 3.5]
# at_once=1: each call takes a single step, so that the record has the force of every step.
for t in mpm.times(end, dt="auto", at_once=1, label="runout"):
    if wanted and time >= wanted[0]:
        shown.append((wanted.pop(0), points.gather("x", "velocity")))
    record = problem.step(t)
    rubbed, hit = (record.bodies[name]["force"][0] for name in ("slope", "wall"))
    balance += (record.time - time) * (weight - rubbed - hit)
    time = record.time
    curve.record(t=time, hit=hit, momentum=problem.momentum()[0], balance=balance)
shown.append((end, points.gather("x", "velocity")))

# means over tenths of a second, as from a load cell
impulse = np.cumsum(curve["hit"] * np.diff(curve["t"], prepend=0.0))
tenths = np.arange(0.0, end + 0.05, 0.1)
hits = np.diff(np.interp(tenths, curve["t"], impulse)) / 0.1

with mpm.figure("output/runout.png", 7.0, 4.0, nrows=2, ncols=3) as (figure, axes):
    for ax, (t, found) in zip(axes.ravel(), shown):
        if found is not None:
            speed = np.linalg.norm(found[1], axis=1)
            drawn = ax.scatter(*found[0].T, s=0.5, c=speed, vmin=0, vmax=12, lw=0)
        ax.plot([-3, face, face], [0, 0, 20], color="k", lw=1)
        ax.set(aspect="equal", xlim=(-3, 32), ylim=(-2, 20), title=f"$t = {t:g}$ s")
        ax.set(xlabel="$x$ (m)", ylabel="$y$ (m)")
    if found is not None:
        figure.colorbar(drawn, ax=axes[0, 2], shrink=0.8, label="speed (m/s)")
    left, right = axes[1, 1:]
    left.plot(curve["t"], curve["momentum"] / 1e3, label="points")
    left.plot(curve["t"][::150], curve["balance"][::150] / 1e3, "o", ms=3, label="forces")
    left.set(xlabel="time (s)", ylabel="momentum (t m/s per m)")
    left.legend()
    right.plot(tenths[1:] - 0.05, hits / 1e3)
    right.set(xlabel="time (s)", ylabel="force on the wall (kN/m)", ylim=(0, None))

push = float(impulse[-1])
error = np.abs(curve["momentum"] - curve["balance"]).max() / curve["momentum"].max()
if grid.comm.rank == 0:
    print(f"wall: peak {hits.max() / 1e3:.0f} kN/m, in the end {hits[-1] / 1e3:.0f} kN/m")
    print(f"impulse {push / 1e3:.0f} kN s/m; momentum differs from forces by {100 * error:.2f} %")
assert error < 0.01
