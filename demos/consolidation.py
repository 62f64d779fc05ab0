"""A layer of saturated clay settles by 21 % of its height as its water drains.

The layer is 1 m thick, stands on a sealed base between smooth walls and drains at its top. An even
load of 0.3 M acts on the top at once. At first the water carries the whole load. Then the water
leaves through the top, and the soil takes over the load, until the layer is 21 % thinner.

With Hencky's law and the hydraulic conductivity k = k₀ λ³/(1 − ln λ) of a stretch λ the exact
solution is known: λ obeys the linear heat equation, and the degree of consolidation

    U = 1 − Σ 2/M² exp(−M² T),    M = (2m + 1) π/2,    T = k₀ M t/(γ_w H²),

is Terzaghi's at any strain. Load and drainage act on the surface of the body, which moves down
through the cells.
"""

import numpy as np
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

import dolfinmpm as mpm

n, M, k0, q = 24, 1e6, 1e-7, 0.3e6
water = mpm.Fluid(density=1000.0, gravity=9.81)
c_v = k0 * M / water.unit_weight

grid = mesh.create_rectangle(
    MPI.COMM_WORLD, [(0, 0), (1 / n, 1)], (1, n), mesh.CellType.quadrilateral
)
points = mpm.fill(grid, mpm.Box((0, 0), (1 / n, 1)), per_cell=4, density=1800.0)
V, Q = mpm.Space(grid, basis="gimp"), mpm.Space(grid, basis="gimp", shape=())
u, v, p, q_ = V.increment, V.test, Q.increment, Q.test
top = mpm.Surface(points, lambda x: np.isclose(x[1], 1.0), normal=(0, 1))

clay = mpm.materials.Hencky(E=M, nu=0.0)
F = mpm.poromechanics(
    clay, points, (u, p), (v, q_), porosity=0.5, fluid=water, drained=top, theta=0.5,
    permeability=lambda J, porosity: k0 * J**3 / (1 - ufl.ln(J)),
)  # fmt: skip
F += top.traction(fem.Constant(grid, (0.0, -q)), v)
problem = mpm.Transient(
    F, [u, p], points, mpm.rollers(V, "left", "right", "bottom"), stabilisation=["ghost", "ghost"]
)

times = np.unique(np.append(np.geomspace(1e-4, 1, 100), [0.05, 0.2, 0.5]))
settled, kept = [], {}
for T in mpm.times(times):
    problem.step(T / c_v)
    settled.append(-top.mean_displacement()[1])
    if T in (0.05, 0.2, 0.5, 1.0):
        kept[T] = points["x"][:, 1].copy(), points["pressure"] / q

# at rest ln λ/λ = −q/M
final = 1.0
for _ in range(60):
    final = np.exp(-0.3 * final)
odd = (2 * np.arange(500)[:, None] + 1) * np.pi / 2
exact = 1 - np.sum(2 / odd**2 * np.exp(-(odd**2) * times), axis=0)
U = np.array(settled) / (1 - final)

with mpm.figure("output/consolidation.png", 6.4, 2.6, ncols=2) as (_, (left, right)):
    left.semilogx(times, exact, color="0.6", lw=2.5, label="exact")
    left.semilogx(times, U, color="C0", lw=1.0, label="material points")
    left.set(xlabel="$T$", ylabel="degree of consolidation $U$", ylim=(1, 0))
    left.legend()
    for T, (height, pressure) in kept.items():
        right.plot(pressure, height, ".", ms=2.5, label=f"$T = {T:g}$")
    right.set(xlabel="excess pressure / load", ylabel="height (m)", ylim=(0, 1))
    right.legend()

degree = U[np.searchsorted(times, 0.5)]
if MPI.COMM_WORLD.rank == 0:
    print(f"settled by {1 - final:.4f} m in the end; U = {degree:.4f} at T = 0.5, exact 0.7639")
assert abs(degree - 0.7639) < 0.005
