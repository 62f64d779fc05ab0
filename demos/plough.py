"""A blade is dragged through sand, and carries more than a wall of its width.

One half of a steel blade, 0.6 m wide and deep, stands in a bed of sand of 44 % relative density,
whose strength, weight and stiffness follow from that (Brinkgreve, Engin & Engin 2010). The sand is
at rest at first. A smooth wall would carry Rankine's passive thrust on its width,

    P = w (½ K_p γ d² + 2 c √K_p d),   K_p = tan²(45° + φ/2),

if the ground flows in vertical planes. The wedge in front of a blade spreads to both sides, slides
along the sand beside it, and forms a heap. So the blade carries several times as much.

Blade and sand are in one form: the momentum of the points, and the contact of the corners of their
domains with the rigid body. Its tangent is not symmetric, because of friction, and because the sand
dilates less than its friction angle. The form tells this to the solver. The far sides of the sand
are Signorini plates, which push but do not pull.
"""

import math

import ufl
from dolfinx import mesh
from mpi4py import MPI

import dolfinmpm as mpm

h, depth, width, way, steps = 0.2, 0.6, 0.6, 0.1, 5
hexahedra = mesh.CellType.hexahedron
low, high = (0.0, 0.0, -1.2), (3.6, 1.2, 0.6)
grid = mesh.create_box(MPI.COMM_WORLD, [low, high], (18, 6, 9), hexahedra)
blade = mpm.Box((0.8, -width / 2, -depth), (1.0, width / 2, depth))
bed = mpm.Box(low, (*high[:2], 0.0))

sand = mpm.materials.sand(0.44)
ground = mpm.Deposit(0.0, mpm.Layer.of(sand))
law = mpm.materials.MohrCoulomb(E=ground.modulus(sand.E_ref, sand.exponent), **sand.parameters)
points = mpm.fill(grid, bed - blade, per_cell=2, density=sand.density)
mpm.set_stress(law, points, ground.stress)

V = mpm.Space(grid, basis="gimp")
u, v = V.increment, V.test
ahead = 0.0  # m per step
plough = mpm.RigidBody(blade, name="plough", fillet=0.02, increment=lambda t: (ahead, 0.0, 0.0))
F = mpm.momentum(law, points, u, v) - ufl.inner(ground.body_force(points), v) * points.dX
F += mpm.contact(plough, points, u, v, friction=0.3, penalty=12.5)
for side in ("left", "right"):
    plate = mpm.Boundary.from_side(points, side)
    F += mpm.signorini(plate, u, v, stiffness_per_area=1e9)
bcs = mpm.rollers(V, "front", "back") + mpm.fixed(V, "bottom")
problem = mpm.QuasiStatic(F, u, points, bcs, stabilisation="ghost", tolerance=1e-7)

problem.step()  # the sand comes to rest at the blade
ahead = way / steps
history = mpm.History()
for share in mpm.steps(steps, label="drag"):
    record = problem.step()
    pull = -2 * record.bodies["plough"]["force"][0]
    history.record(way=share * way, pull=pull)

K_p = math.tan(math.pi / 4 + math.radians(sand.friction_angle) / 2) ** 2
weight = 0.5 * K_p * sand.unit_weight * depth**2
thrust = width * (weight + 2 * sand.cohesion * math.sqrt(K_p) * depth)
ratio = pull / thrust

mpm.plot(
    points, "output/plough.png", colour="displacement", component=2, cut=("y", 0.06),
    bodies=[plough], view=((0.0, 2.8), (-1.2, 0.6)), label="rise (m)", cmap="RdBu_r",
    limits=(-0.2, 0.2), title=f"pull {pull / 1e3:.1f} kN after {way:g} m",
)  # fmt: skip
if MPI.COMM_WORLD.rank == 0:
    print(f"pull {pull:.0f} N, {ratio:.2f} times Rankine's thrust on the width, {thrust:.0f} N")
assert 1.5 < ratio < 8.0
