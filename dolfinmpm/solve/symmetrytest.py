"""A test for the symmetry of tangents."""

from __future__ import annotations

import numpy as np

from dolfinmpm.assembly.stencilsums import Matrix
from dolfinmpm.grid.lattice import smallest_height
from dolfinmpm.solve.operator import Operator

__all__ = ["looks_symmetric"]

# Bound of yᵀKx − xᵀKy by rounding, relative to the size of the products
_SYMMETRIC = 1e-9
# Size of the increments in the test, in cells
_NEAR = 1e-4


def looks_symmetric(operator: Operator, matrix: Matrix) -> bool:
    """Whether the tangent is symmetric near the present state: yᵀKx = xᵀKy. Collective.

    Of many points, a sample tells.

    Args:
        operator: The equations; their increments change.
        matrix: A matrix for the tangent, which is overwritten.
    """
    random = np.random.default_rng(operator.here.unknowns.comm.rank)
    n, scale = operator.here.unknowns.owned, _NEAR * smallest_height(operator.form.points.grid)
    # without strain, some unsymmetric tangents are symmetric
    operator.move(scale * random.uniform(-1, 1, n))
    with operator.points.sampled():
        operator.tangent(matrix)
    x, y, Kx, Ky = (matrix.petsc.createVecRight() for _ in range(4))
    for v in (x, y):
        v.getArray()[:] = random.uniform(-1, 1, n)
    matrix.petsc.mult(x, Kx)
    matrix.petsc.mult(y, Ky)
    size = Kx.norm() * y.norm()
    return bool(abs(y.dot(Kx) - x.dot(Ky)) <= _SYMMETRIC * size)
