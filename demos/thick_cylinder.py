"""A thick tube yields from the inside outwards, on a grid of squares.

A tube of steel, radii a = 0.1 m and b = 0.2 m, is under internal pressure p. It yields for r ≤ c,
and by Hill's solution (de Souza Neto, Perić & Owen 2008, section 7.5.1), with Y = 2σ_y/√3,

    p = Y [ln(c/a) + (1 − c²/b²)/2],  u_b = Y c² (1 − ν²)/(E b),  p_lim = Y ln(b/a).

Finite elements need a curved mesh for this. Beyond p_lim there is no equilibrium, so the pressure
cannot be prescribed. It is an unknown, and each step prescribes the displacement of the outer face.
"""

import numpy as np
from dolfinx import fem, mesh
from mpi4py import MPI

import dolfinmpm as mpm

a, b, E, nu, strength = 0.1, 0.2, 210e9, 0.3, 0.24e9  # m, m, Pa, -, Pa
Y = 2 * strength / np.sqrt(3)
corners = [(0, 0), (0.225, 0.225)]
grid = mesh.create_rectangle(MPI.COMM_WORLD, corners, (18, 18), mesh.CellType.quadrilateral)

# Points in 16 rings, each the centroid of a part of a quarter of the tube and exactly as large, so
# that no volume is lost at the circles. Every rank makes all of them; each counts once.
radii, step = np.linspace(a, b, 17), np.pi / 2 / 40
low, high, angle = radii[:-1, None], radii[1:, None], (np.arange(40) + 0.5) * step
chord = np.sin(step / 2) / (step / 2)  # the centroid of an arc of angle `step` lies inside it
r = 2 / 3 * (high**3 - low**3) / (high**2 - low**2) * chord + 0 * angle
x = np.column_stack([(r * np.cos(angle)).ravel(), (r * np.sin(angle)).ravel()])
area = ((high**2 - low**2) / 2 * step + 0 * angle).ravel()
points = mpm.MaterialPoints.from_arrays(grid, x, volume=area, density=7850.0)


def face(ring, radius, sign):
    """The faces of a ring's points on a circle: where they are from the points, and how large."""
    at_ring = np.isclose(np.linalg.norm(points["x0"], axis=1), r[ring, 0])[:, None]
    outwards = points["x0"] / np.linalg.norm(points["x0"], axis=1, keepdims=True)
    middle = radius * chord * outwards
    return mpm.Surface.from_arrays(
        points, at_ring * (middle - points["x0"]), at_ring * sign * step * middle
    )


V = mpm.Space(grid, basis="gimp")
u, v = V.increment, V.test
steel = mpm.materials.VonMises(E, nu, yield_stress=strength)
inner, outer = face(0, a, -1), face(-1, b, 1)
pressure = fem.Constant(grid, Y * np.log(b / a))
F = mpm.momentum(steel, points, u, v) + inner.pressure(pressure, u, v)

# The path of equilibrium, in 24 steps of equal displacement of the outer face
limit = Y * b * (1 - nu**2) / E  # that face's displacement when all of the tube yields
problem = mpm.ArcLength(
    F, u, points, mpm.rollers(V, "left", "bottom"), load=pressure,
    control=outer.mean_normal(v), length=1.3 * limit / 24, max_length=1.3 * limit / 24,
    stabilisation="ghost",
)  # fmt: skip
for _ in mpm.steps(24, label="outer displacement"):
    problem.step()

p = np.array([record.factor for record in problem.history])
with mpm.figure("output/thick_cylinder.png") as (_, axes):
    c = np.linspace(a, b)
    exact = (np.log(c / a) + (1 - c**2 / b**2) / 2) / np.log(b / a)
    axes.plot(1e3 * np.r_[0, limit * c**2 / b**2, 1.3 * limit], np.r_[0, exact, 1], label="Hill")
    axes.plot([1e3 * record.displacement for record in problem.history], p, "o", label="points")
    axes.set(xlabel="displacement of the outer face (mm)", ylabel="pressure / limit pressure")
    axes.legend()
if grid.comm.rank == 0:
    print(f"the last pressure is {p[-1]:.4f} of the limit")
assert abs(p[-1] - 1) < 0.01
