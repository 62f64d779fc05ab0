"""Layered ground with a water table is at rest, then the wall of an excavation gives way.

Three layers, 6 m together, lie on a smooth base. Each layer has a friction angle, a cohesion, unit
weights above and below the water table, and K₀ = 1 − sin φ (Jaky 1944). `Deposit` gives the
effective stress in balance with the effective weight. So the first step moves nothing, and the
smooth wall at the left carries ∫ K₀ σ'_v dz.

Then the ground in front of the wall is excavated. The wall moves by a thousandth of its height, and
the thrust falls to Rankine's (1857), layer by layer,

    P = ∫ (K_a σ'_v − 2 c √K_a) dz,   K_a = tan²(45° − φ/2).

The thrust of the water stays as it is, and is not part of the effective stress. Cohesion pulls at
the wall in the uppermost 0.4 m, in the formula as in the computation. Real ground cracks there.
"""

import math

import numpy as np
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

import dolfinmpm as mpm

H, length, h, table = 6.0, 12.0, 0.25, 3.5  # m
# bottom (m), unit weights above and below the water table (N/m³), φ (degrees), c (Pa)
soils = {
    1: (4.0, 18e3, 19e3, 32.0, 2e3),
    2: (2.0, 17e3, 18e3, 25.0, 4e3),
    3: (0.0, 19e3, 20e3, 36.0, 1e3),
}
ground = mpm.Deposit(
    H,
    [
        mpm.Layer(bottom, dry, K0=1 - math.sin(math.radians(phi)), saturated_unit_weight=wet)
        for bottom, dry, wet, phi, _ in soils.values()
    ],
    water_table=table,
)

# The ground follows the wall into the cells to its left.
corners, cells = [(-h, 0), (length, H + h)], (round((length + h) / h), round((H + h) / h))
grid = mesh.create_rectangle(MPI.COMM_WORLD, corners, cells, mesh.CellType.quadrilateral)
points, top = None, H
for tag, (bottom, *_) in soils.items():
    layer = mpm.fill(grid, mpm.Box((0, bottom), (length, top)), 2, ground.density, tag=tag)
    points, top = layer if points is None else points + layer, bottom
V = mpm.Space(grid, basis="gimp")
u, v = V.increment, V.test

F = -ufl.inner(ground.body_force(points), v) * points.dX
for tag, (*_, phi, c) in soils.items():
    # without dilation a step takes hundreds of iterations once the wedge slides
    law = mpm.materials.MohrCoulomb(
        E=40e6, nu=0.3, cohesion=c, friction_angle=phi, dilation_angle=phi / 3
    )
    mpm.set_stress(law, points, ground.stress, tag=tag)
    F += mpm.momentum(law, points, u, v, tag=tag)
motion = fem.Constant(grid, 0.0)  # m per step
wall = mpm.prescribed(V, lambda x: x[0] < 1e-9, 0, increment=motion)
bcs = wall + mpm.rollers(V, "right", "bottom")
problem = mpm.QuasiStatic(F, u, points, bcs, tolerance=1e-6)


def thrust():
    """Effective thrust on the wall (N/m): without horizontal forces all sections carry the same."""
    both = np.array([points["V"] @ points["stress"][:, 0, 0], points["V"].sum()])
    both = grid.comm.allreduce(both)
    return -H * float(both[0] / both[1])


problem.step()  # at rest
moved = grid.comm.allreduce(np.abs(points["x"] - points["x0"]).max(initial=0.0), op=MPI.MAX)
steps, way = 10, 1e-3 * H
motion.value = -way / steps
curve = mpm.History()
curve.record(way=0.0, thrust=thrust())
for share in mpm.steps(steps, label="excavation"):
    problem.step()
    curve.record(way=share * way, thrust=thrust())

# Rankine by layers, at the middle of every millimetre
z = np.arange(0.0005, H, 0.001)
vertical, rest, active, top = -ground.vertical_stress([0 * z, z]), 0 * z, 0 * z, H
for bottom, *_, phi, c in soils.values():
    here = (z > bottom) & (z < top)
    Ka = math.tan(math.pi / 4 - math.radians(phi) / 2) ** 2
    rest[here] = (1 - math.sin(math.radians(phi))) * vertical[here]
    active[here] = Ka * vertical[here] - 2 * c * math.sqrt(Ka)
    top = bottom
P0, Pa = rest.sum() * 0.001, active.sum() * 0.001

state = points.gather("x", "stress")
with mpm.figure("output/layered_ground.png", 6.4, 2.6, ncols=2) as (_, (left, right)):
    left.axhline(P0 / 1e3, color="0.6", lw=1, ls="--", label="at rest, $K_0$")
    left.axhline(Pa / 1e3, color="k", lw=1, label="Rankine")
    left.plot(1e3 * curve["way"], curve["thrust"] / 1e3, "o-", ms=3, label="material points")
    left.set(xlabel="motion of the wall (mm)", ylabel="effective thrust (kN/m)", ylim=(0, 140))
    left.legend(loc="lower left")
    right.plot(rest / 1e3, z, color="0.6", lw=1, ls="--")
    right.plot(active / 1e3, z, color="k", lw=1)
    if state is not None:
        x, stress = state
        near = (x[:, 0] > 1) & (x[:, 0] < 1 + h / 2)
        right.plot(-stress[near, 0, 0] / 1e3, x[near, 1], "o", ms=2.5)
    right.axhline(table, color="C5", lw=0.8)
    right.text(34, table + 0.1, "water table", fontsize=7, color="C5", ha="right")
    right.set(xlabel="effective horizontal stress (kPa)", ylabel="height (m)", ylim=(0, H))

P = curve["thrust"][-1]
if grid.comm.rank == 0:
    print(f"at rest: moved by {moved:.1e} m, thrust {curve['thrust'][0]:.0f} N/m, K0 {P0:.0f} N/m")
    print(f"active thrust {P:.0f} N/m, Rankine {Pa:.0f} N/m")
assert abs(P / Pa - 1) < 0.005
assert abs(curve["thrust"][0] / P0 - 1) < 1e-9
assert moved < 1e-12
