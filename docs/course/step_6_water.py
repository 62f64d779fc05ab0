"""Step 6. Water in the soil

A layer of clay is loaded at once. At first the water carries the load, then it leaves through the
top, and the clay settles. You meet two fields, effective stress, and steps in time.

For small strains Terzaghi (1925) gives the degree of consolidation U over T = c_v t/H².
"""

# %%
# The column is one cell wide. Displacement and pore pressure are two fields. Each field has a
# space.

import numpy as np
from dolfinx import fem, mesh
from mpi4py import MPI

import dolfinmpm as mpm

n, M, k, load = 16, 1e6, 1e-8, 1e3  # cells, oedometric modulus (Pa), k (m/s), load (Pa)
water = mpm.Fluid(density=1000.0, gravity=9.81)
c_v = k * M / water.unit_weight
corners = [(0, 0), (1 / n, 1 + 1 / n)]
grid = mesh.create_rectangle(MPI.COMM_WORLD, corners, (1, n + 1), mesh.CellType.quadrilateral)
points = mpm.fill(grid, mpm.Box((0, 0), (1 / n, 1)), per_cell=2, density=1800.0)
V, Q = mpm.Space(grid, basis="gimp"), mpm.Space(grid, basis="gimp", shape=())
u, v, p, q = V.increment, V.test, Q.increment, Q.test

# %%
# The top of the layer is a surface of the body. It moves with the body. Load and drainage act on
# it. ``mpm.poromechanics`` returns plain UFL: balance of momentum with effective stress, and
# balance of water with Darcy's law.

top = mpm.Surface(points, lambda x: np.isclose(x[1], 1.0), normal=(0, 1))
clay = mpm.materials.Hencky(E=M, nu=0.0)
F = mpm.poromechanics(
    clay, points, (u, p), (v, q), porosity=0.5, fluid=water, drained=top, permeability=k
)
F += top.traction(fem.Constant(grid, (0.0, -load)), v)
bcs = mpm.rollers(V, "left", "right", "bottom")
problem = mpm.Transient(F, [u, p], points, bcs, stabilisation=["ghost", "ghost"])

# %%
# The steps in time grow, because the flow becomes slower.

times = np.geomspace(1e-3, 1.0, 50)
settled = []
for T in mpm.times(times):
    problem.step(T / c_v)
    settled.append(-top.mean_displacement()[1])

odd = (2 * np.arange(200)[:, None] + 1) * np.pi / 2
exact = 1 - np.sum(2 / odd**2 * np.exp(-(odd**2) * times), axis=0)
U = np.array(settled) * M / load
error = np.abs(U - exact)[times > 0.05].max()
if grid.comm.rank == 0:
    print(f"U at T = 1: {U[-1]:.4f}, Terzaghi {exact[-1]:.4f}; largest error {error:.4f}")
with mpm.figure("output/consolidation.png", 4.0, 2.8) as (_, axes):
    axes.semilogx(times, exact, color="0.6", lw=2.5, label="Terzaghi")
    axes.semilogx(times, U, label="material points")
    axes.set(xlabel="T", ylabel="degree of consolidation U", ylim=(1, 0))
    axes.legend()
assert error < 0.03

# %%
# What it shows
# -------------
# Steps of backward Euler are of first order, so the error falls with the length of the steps.
#
# Try next
# --------
# - ``theta=0.5`` in ``mpm.poromechanics``: Crank and Nicolson's steps of second order.
# - ``permeability=mpm.kozeny_carman(...)``: the permeability follows the porosity.
# - A load of 0.3 M: :doc:`consolidation at large strain </demos/consolidation>`.
# - :doc:`A saturated slope </demos/coupled_slope>` that is loaded fast or slowly.
