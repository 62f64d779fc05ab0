"""Step 5. A rigid body in soil

A smooth wall is pushed into sand. You meet rigid bodies, contact, and initial stress.

Rankine (1857) gives the thrust on the wall when all of the sand yields: P = ½ K γ H² + 2 c √K H
with K = tan²(45° + φ/2).
"""

# %%
# The sand lies between the wall at its left and the side of the grid at its right. The grid has
# two columns of cells more at the left.

import math

import ufl
from dolfinx import mesh
from mpi4py import MPI

import dolfinmpm as mpm

H, weight, phi, c = 1.0, 16e3, 33.0, 300.0  # m, N/m³, degrees, Pa
corners, cells = [(-0.25, 0), (3, 1.25)], (26, 10)
grid = mesh.create_rectangle(MPI.COMM_WORLD, corners, cells, mesh.CellType.quadrilateral)
points = mpm.fill(grid, mpm.Box((0, 0), (3, H)), per_cell=2, density=weight / 9.81)
V = mpm.Space(grid, basis="gimp")
u, v = V.increment, V.test

# %%
# The ground is at rest at first. The horizontal stress is K₀ times the vertical stress.

sand = mpm.materials.MohrCoulomb(26e6, 0.3, cohesion=c, friction_angle=phi, dilation_angle=3.0)
rest = 1 - math.sin(math.radians(phi))
mpm.set_stress(sand, points, mpm.geostatic_stress(H, weight, rest))

# %%
# The wall is a plane with a normal that points into the sand. It moves by ``ahead`` in each step.
# ``mpm.contact`` adds the forces between the wall and the corners of the points' domains.

ahead = [0.0]
wall = mpm.RigidBody(mpm.Plane((0, 0), (1, 0)), name="wall", increment=lambda t: (ahead[0], 0.0))
F = mpm.momentum(sand, points, u, v)
F -= ufl.inner(points.density * ufl.as_vector((0.0, -9.81)), v) * points.dX
F += mpm.contact(wall, points, u, v, penalty=12.5)
bcs = mpm.rollers(V, "right", "bottom")
problem = mpm.QuasiStatic(F, u, points, bcs)

# %%
# A first step without motion lets the wall take the thrust at rest. Then the wall is pushed by 6
# mm.

curve = mpm.History()
problem.step()
ahead[0] = 6e-3 / 40
for share in mpm.steps(40, label="wall"):
    problem.step()
    curve.record(way=6.0 * share, thrust=-wall.force[0])

K = math.tan(math.radians(45 + phi / 2)) ** 2
exact = 0.5 * K * weight * H**2 + 2 * c * math.sqrt(K) * H
found = curve["thrust"][-1]
if grid.comm.rank == 0:
    print(f"thrust {found / 1e3:.2f} kN/m, Rankine {exact / 1e3:.2f} kN/m")
with mpm.figure("output/thrust.png", 4.0, 2.6) as (_, axes):
    axes.plot(curve["way"], curve["thrust"] / 1e3, label="material points")
    axes.axhline(exact / 1e3, color="k", lw=1, label="Rankine")
    axes.set(xlabel="displacement of the wall (mm)", ylabel="thrust (kN/m)")
    axes.legend()
assert abs(found / exact - 1) < 0.02

# %%
# What it shows
# -------------
# The thrust grows from the value at rest to Rankine's passive thrust. After that it rises slowly,
# because the ground becomes higher.
#
# Try next
# --------
# - ``ahead[0] = -6e-3 / 40``: the active thrust, 2.03 kN/m. The assertion is of the passive thrust:
#   leave it out.
# - ``mpm.contact(wall, ..., friction=0.3)``: a rough wall carries more.
# - Other bodies: ``mpm.Wedge``, ``mpm.Cone``, ``mpm.Disc``, a polygon, a surface mesh in 3D.
# - :doc:`A cone </demos/cone>` and :doc:`a blade </demos/plough>` in large motion.
