"""Balance of the equations of several fields, whose units differ."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from petsc4py import PETSc

from dolfinmpm.solve.operator import Operator

__all__ = ["others_balanced", "references"]

Array = npt.NDArray[np.float64]


def others_balanced(operator: Operator, by_field: Array, tolerance: float) -> bool:
    """Whether the equations of all fields but displacements are in balance.

    Args:
        operator: The equations.
        by_field: Norms of residual and reference, shape (fields, 2).
        tolerance: Residual over reference that may remain.
    """
    rest = np.delete(by_field, operator.here.movers, axis=0)
    return bool(np.all(rest[:, 0] <= tolerance * rest[:, 1]))


def references(operator: Operator, matrix: PETSc.Mat, x: PETSc.Vec, by_field: Array) -> Array:
    """Norm and reference of each field's residual, by means of a tangent. Collective.

    The reference is the largest term of the field's equations: external forces and reactions, or
    the contribution of a field's unknowns. All of these may be close to zero, such as volumes in a
    body at rest. Then the reference is converted from the first field: the ratio of the
    contributions of a displacement to both fields' equations converts it.

    Args:
        operator: The equations.
        matrix: Their tangent.
        x: The unknowns.
        by_field: Norms of residual, and of external forces and reactions, shape (fields, 2).

    Returns:
        Norms of residual and reference, shape (fields, 2).
    """
    own = np.maximum(by_field[:, 1], operator.sizes(matrix, x).max(axis=0))
    if np.all(by_field[:, 0] <= 1e-9 * own):
        return np.stack([by_field[:, 0], own], axis=1)
    probe = x.duplicate()
    probe.setRandom()
    stiffness = operator.sizes(matrix, probe)[0]
    same = own[0] * np.divide(stiffness, stiffness[0], out=np.zeros_like(own), where=stiffness > 0)
    return np.stack([by_field[:, 0], np.maximum(own, same)], axis=1)
