"""Step 1. A column under its own weight

A column of soft soil, 50 m high, is compressed by its own weight to half of its height. You meet
the five parts of each program: a grid, a body of material points, a basis, a weak form, a problem.

The answer is known. A point of first height Y carries the weight above it, so the vertical stress
at the end is σ(Y) = −ρ₀ g (50 m − Y).
"""

# %%
# The background grid is a mesh of DOLFINx. It is one cell wide and 60 cells high. The grid never
# moves: the body will move through it.

import numpy as np
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

import dolfinmpm as mpm

cells = mesh.CellType.quadrilateral
grid = mesh.create_rectangle(MPI.COMM_WORLD, [(0, 0), (1, 60)], (1, 60), cells)
soil = mpm.materials.Hencky(E=10e3, nu=0.0)  # Pa

# %%
# The problem is a function of the basis, because we want to compare two. ``mpm.fill`` puts 2²
# points into each cell of the body. ``V.increment`` is the unknown: the displacement of one step.
# ``points.dX`` is a sum over the material points, and the rest is UFL as in each FEniCS program.
#
# The last term is the ghost penalty. It stabilises the cells that the top of the column cuts. Step
# 2 tells more about it.


def column(basis):
    """Mean error of the vertical stress, over the largest stress."""
    points = mpm.fill(grid, mpm.Box((0, 0), (1, 50)), per_cell=2, density=80.0)
    V = mpm.Space(grid, basis=basis)
    u, v = V.increment, V.test
    gravity = fem.Constant(grid, (0.0, 0.0))
    F = mpm.momentum(soil, points, u, v) - ufl.inner(points.density * gravity, v) * points.dX
    F += mpm.ghost(points, u, v, gamma=10e3 / 30)
    bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
    problem = mpm.QuasiStatic(F, u, points, bcs)
    for load in mpm.steps(40, label=basis):
        gravity.value[1] = -10.0 * load
        problem.step()
    mpm.plot(points, f"output/column_{basis}.png", size=(2.2, 4.5))
    Y, V0 = points["x0"][:, 1], points["V0"]
    deviation = np.abs(points["stress"][:, 1, 1] + 800.0 * (50.0 - Y)) @ V0
    return grid.comm.allreduce(deviation) / (800.0 * 50.0 * grid.comm.allreduce(V0.sum()))


# %%
# ``problem.step()`` solves one load step by Newton's method, and then moves the points.

errors = {basis: column(basis) for basis in ("linear", "gimp")}
if grid.comm.rank == 0:
    for basis, error in errors.items():
        print(f"{basis}: error of the stress {error:.2e}")
assert errors["gimp"] < 1e-3

# %%
# What it shows
# -------------
# With linear functions the standard material point method errs by 8 %. A point acts on one cell
# only, and its force jumps when it crosses a cell boundary. More cells do not help. GIMP spreads
# each point over a domain. The domain is in two cells while it crosses, and the force changes
# smoothly.
#
# Try next
# --------
# - ``basis="bspline2"``: quadratic B-splines have the smallest error here. ``"bspline3"`` needs
#   ``per_cell=3`` in a grid that is one cell wide.
# - ``per_cell=1`` or ``3``.
# - 10 load steps in place of 40: the error of GIMP becomes 1.6e-3, and the assertion fails. The law
#   is elastic, but a step takes the functions at the points' places at its start.
# - Run it on two ranks: ``docker/run mpirun -n 2 python3 step_1_column.py``. The figures are the
#   same.
