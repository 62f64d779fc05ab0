"""First gradients of fields whose values at the points were given, such as water pressures at rest.

A term that compares the gradient at the end of a step with that at its start needs the gradient
before the first step. The values of the points that share nodes with a point are fitted by a linear
function, weighted by the nodes' functions and the points' volumes. Linear fields are exact.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm.basis.stencils import stencil_matrix
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.cut.activation import ActiveField
from dolfinmpm.cut.unknowns import Nodal
from dolfinmpm.forms.carriedfields import CarriedField

__all__ = ["set_first_gradient"]

Array = npt.NDArray[np.float64]
# There is no gradient in directions in which the squares of distances are this share of the others
_FLAT = 1e-8


def set_first_gradient(points: MaterialPoints, slope: CarriedField, field: ActiveField) -> None:
    """Set the gradients that are still zero from the values of their field. Collective.

    Args:
        points: Material points.
        slope: The gradient, with the name of its field in `slope_of`.
        field: The field of the grid.
    """
    assert slope.slope_of is not None
    if slope.revision == points.revision:
        return
    values, found = points[slope.slope_of], points[slope.name]
    known = found.any(axis=1)
    unset = ~known
    flags = np.array([(values != 0.0).any(), unset.any(), known.any()])
    points.comm.Allreduce(MPI.IN_PLACE, flags, op=MPI.LOR)
    given, missing, stepped = flags
    # values may still be given until a gradient is known
    if stepped or (given and missing):
        slope.revision = points.revision
    if not (given and missing):
        return
    new = _gradient(points, field, values)
    found[unset] = new[unset]
    if slope.unknown is not None:
        points[slope.unknown][unset] = 0.0


def _gradient(points: MaterialPoints, field: ActiveField, values: Array) -> Array:
    """Gradient of a linear function through the values around each point. Collective."""
    d, x, nodes = points.gdim, points["x"], field.basis.nodes
    N = stencil_matrix(field.full_stencils, field.full_stencils.N, (len(points), nodes.size))
    entries = N.tocoo()
    p, a, share = entries.row, entries.col, entries.data[:, None]
    # moments about the nodes, and then about the points, in which little is cancelled
    away = x[p] - field.basis.node_coordinates()[a, :d]
    about = points["V"][p, None] * share * _moments(away, values[p])
    sums = Nodal([nodes], [about.shape[1]])
    for k, column in enumerate(about.T):
        sums.arrays[0][:, k] = np.bincount(a, column, nodes.size)
    sums.add_up()
    sums.spread()
    shifted = share * _shifted(sums.arrays[0][a], -away)
    found = np.zeros((len(points), shifted.shape[1]))
    for k, column in enumerate(shifted.T):
        found[:, k] = np.bincount(p, column, len(points))
    weight, first, value, product, second = _split(found, d)
    # points of other tags than those of the field have no functions there, and no gradient
    first = first / np.where(weight > 0.0, weight, 1.0)
    spread = second - weight[:, :, None] * first[:, :, None] * first[:, None]
    inverse = np.linalg.pinv(spread, rcond=_FLAT, hermitian=True)
    return np.einsum("pij,pj->pi", inverse, product - first * value)


def _moments(away: Array, values: Array) -> Array:
    """1, r, q, q r and r r of distances r and values q, side by side, shape (n, columns)."""
    squares = _rows(away[:, :, None] * away[:, None])
    one, q = np.ones((len(away), 1)), values[:, None]
    return np.hstack([one, away, q, q * away, squares])


def _split(moments: Array, d: int) -> tuple[Array, Array, Array, Array, Array]:
    """The parts of `_moments`."""
    weight, first, value, product, second = np.split(moments, [1, 1 + d, 2 + d, 2 + 2 * d], axis=1)
    return weight, first, value, product, second.reshape(-1, d, d)


def _shifted(moments: Array, way: Array) -> Array:
    """Moments of distances that are longer by a way, shape (n, columns)."""
    weight, first, value, product, second = _split(moments, way.shape[1])
    mixed = first[:, :, None] * way[:, None]
    mixed = mixed + np.swapaxes(mixed, 1, 2) + weight[:, :, None] * way[:, :, None] * way[:, None]
    squares = _rows(second + mixed)
    return np.hstack([weight, first + weight * way, value, product + value * way, squares])


def _rows(tensors: Array) -> Array:
    """Second-order tensors as rows, shape (n, d²); NumPy cannot tell −1 of no tensors."""
    return tensors.reshape(len(tensors), tensors.shape[1] ** 2)
