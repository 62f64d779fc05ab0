"""A block slides down a slope with friction.

An elastic block lies on a rigid slope of 45°, with Coulomb's friction, μ = 0.3. Gravity is tilted,
so that the slope is level on the grid. The block comes to rest on the slope first. Then it slides:
after the time t it has come down by

    d = ½ g t² (sin 45° − μ cos 45°).

The slope is a rigid body that stands still. It touches the corners of the points' domains. The
normal force on a corner is a penalty. The force of friction is at most μ times the normal force.
The tangent of friction is not symmetric, and the form tells this to the solver. The work of
friction is μ N times the way.
"""

import math

import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

import dolfinmpm as mpm

g, mu, density, length, height = 9.81, 0.3, 1000.0, 1.0, 0.5
down = along = g * math.sin(math.radians(45))

cells = mesh.CellType.quadrilateral
grid = mesh.create_rectangle(MPI.COMM_WORLD, [(-0.25, -0.25), (4.0, 0.75)], (17, 4), cells)
points = mpm.fill(grid, mpm.Box((0, 0), (length, height)), per_cell=2, density=density)
V = mpm.Space(grid, basis="gimp")
u, v = V.increment, V.test

stiffness = 1e8  # Pa/m: the weight presses the block in by 35 µm
sunk = density * down * height / stiffness
slope = mpm.RigidBody(mpm.Plane((0, sunk), (0, 1)), name="slope")
gravity = fem.Constant(grid, (0.0, 0.0))
F = mpm.momentum(mpm.materials.Hencky(E=1e6, nu=0.0), points, u, v)
F -= ufl.inner(points.density * gravity, v) * points.dX
F += mpm.contact(slope, points, u, v, friction=mu, stiffness_per_area=stiffness)

# friction holds 95 % of what it can
held = mpm.QuasiStatic(F, u, points, stabilisation="ghost")
for part in (0.5, 1.0):
    gravity.value[:] = 0.95 * mu * down * part, -down * part
    held.step()

gravity.value[:] = along, -down
problem = mpm.Newmark(F, u, points, stabilisation="ghost")
history = mpm.History()


def middle():
    """Where the block's middle is along the slope (m)."""
    return points.comm.allreduce(float(points["V0"] @ points["x"][:, 0])) / (length * height)


start = middle()
for t in mpm.times(1.0, dt=0.01, label="slide"):
    record = problem.step(t)
    way = middle() - start
    rubbed = record.bodies["slope"]["force"][0]
    history.record(t=t, way=way, rubbed=rubbed, exact=0.5 * t**2 * (along - mu * down))

with mpm.figure("output/incline.png", 6.0, 2.4, ncols=2) as (_, (left, right)):
    left.plot(history["t"], history["exact"], color="k", lw=1, label="closed form")
    left.plot(history["t"][::5], history["way"][::5], "o", ms=3, label="material points")
    left.set(xlabel="time (s)", ylabel="distance (m)")
    left.legend(loc="upper left")
    right.axhline(mu * density * length * height * down / 1e3, color="k", lw=1)
    right.plot(history["t"], history["rubbed"] / 1e3)
    right.set(xlabel="time (s)", ylabel="friction on the slope (kN/m)", ylim=(0, 1.5))

exact = history["exact"][-1]
if MPI.COMM_WORLD.rank == 0:
    print(
        f"way {way:.4f} m, closed form {exact:.4f} m; {history['rubbed'][-1]:.1f} N/m of friction"
    )
assert abs(way / exact - 1) < 0.01
