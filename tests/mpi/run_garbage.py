"""Some steps; then PETSc says how many objects wait to be freed."""

import sys

import ufl
from dolfinx import fem, mesh
from mpi4py import MPI
from petsc4py import PETSc

import dolfinmpm as mpm


def main(steps: int) -> None:
    """Take the steps, and view what waits."""
    cells = mesh.CellType.quadrilateral
    grid = mesh.create_rectangle(MPI.COMM_WORLD, [(0, 0), (1, 10)], (2, 20), cells)
    points = mpm.fill(grid, mpm.Box((0, 0), (1, 8)), 2, 80.0)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    gravity = fem.Constant(grid, (0.0, 0.0))
    F = mpm.momentum(mpm.materials.Hencky(E=10e3, nu=0.0), points, u, v)
    F -= ufl.inner(points.density * gravity, v) * points.dX
    bcs = mpm.rollers(V, "left", "right", "bottom")
    problem = mpm.QuasiStatic(F, u, points, bcs, stabilisation="ghost")
    for share in mpm.steps(steps):
        gravity.value[1] = -10.0 * share
        problem.step()
    PETSc.garbage_view(grid.comm)


if __name__ == "__main__":
    main(int(sys.argv[1]))
