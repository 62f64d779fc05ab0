"""Aggregation and extension on leaves: roots among leaves of any size."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from dolfinmpm.basis import LeafBasis
from dolfinmpm.basis.bspline import extended

__all__ = ["leaf_constraints"]

Array = npt.NDArray[np.float64]
Rows = npt.NDArray[np.intp]
# Nearest leaves among which the root of a node is chosen, and their largest distance in units of
# the larger cell
_CANDIDATES, _FARTHEST = 64, 5.0


def leaf_constraints(
    basis: LeafBasis, nodes: npt.NDArray[np.int32], filled: Array, threshold: float, every: bool
) -> Iterator[tuple[int, npt.NDArray[np.int32], Array]]:
    """Nodes with too little support, with the nodes of their roots and the weights.

    The root is the nearest leaf, with the distance in units of the larger one of the root and of
    the cells at the node. Among equal leaves the lowest one decides. A node on a side of the grid
    uses only leaves on this side. Hanging nodes follow their leaf and need no root.

    Args:
        basis: The basis.
        nodes: Active nodes known on this rank.
        filled: Fill fraction of every local leaf, shape (cells,); for splines the share of every
            function's integral in the body, shape (nodes,).
        threshold: Fraction from which a leaf is well-filled; for splines see `constraint_matrix`.
        every: Whether every leaf of supported nodes may be a root, not only a well-filled one.
    """
    p = basis.degree
    if p == 1:
        good = filled >= threshold - 1e-9
        inner: npt.NDArray[np.bool_] = np.zeros(basis.nodes.size, bool)
        inner[basis.corner_nodes[good].ravel()] = True
        # the nodes that a supported hanging node follows have its support
        inner |= np.asarray(basis.hanging.T @ inner.astype(float) > 0)
    else:
        inner = filled >= threshold ** (p + 1) / math.factorial(p + 1) * (1 - 1e-9)
    if every or p > 1:
        good = np.asarray(inner[basis.corner_nodes].all(axis=1))
    outer = nodes[~inner[nodes] & ~basis.hangs[nodes]]
    roots: Rows = np.flatnonzero(good)
    if not outer.size or not roots.size:
        return
    roots = roots[np.argsort(basis.leaf[roots], kind="stable")]
    nearest = _nearest(basis, outer, roots)
    outer, nearest = outer[nearest >= 0], nearest[nearest >= 0]
    weights: Array = np.ones((outer.size, 1))
    for d in range(basis.knots.shape[1]):
        along = extended(basis.knots[nearest, d], basis.inner_knots[outer, d])
        weights = (weights[:, :, None] * along[:, None]).reshape(outer.size, -1)
    for k, (a, root) in enumerate(zip(outer, nearest)):
        yield int(a), basis.corner_nodes[root], np.asarray(weights[k])


def _nearest(basis: LeafBasis, outer: npt.NDArray[np.int32], roots: Rows) -> Rows:
    """Root of each node, or -1."""
    from scipy.spatial import cKDTree

    low, high = basis.cell_corners()
    size, x = basis.cell_sizes(), basis.node_coordinates()[outer, : low.shape[1]]
    around: Array = np.zeros(basis.nodes.size)
    np.maximum.at(around, basis.corner_nodes.ravel(), np.repeat(size, basis.corner_nodes.shape[1]))
    count = min(_CANDIDATES, roots.size)
    middles = 0.5 * (low + high)[roots]
    distance, near = cKDTree(middles).query(x, k=[*range(1, count + 1)])
    unit = distance / np.maximum(size[roots][near], around[outer][:, None])
    ends = np.array([[line[0], line[-1]] for line in basis.lattice.lines])
    allowed: npt.NDArray[np.bool_] = np.ones(near.shape, bool)
    for d, (first, last) in enumerate(ends):
        slack = 1e-9 * (last - first)
        for corner, end in ((low, first), (high, last)):
            at_side = np.abs(x[:, d] - end) <= slack
            allowed &= ~at_side[:, None] | (np.abs(corner[roots][near][..., d] - end) <= slack)
    allowed |= ~allowed.any(axis=1, keepdims=True)
    unit = np.where(allowed & (unit <= _FARTHEST), unit, np.inf)
    best = unit.min(axis=1, keepdims=True)
    chosen = np.where(unit <= best * (1 + 1e-9), near, roots.size).min(axis=1)
    known = np.isfinite(best[:, 0])
    return np.where(known, roots[np.minimum(chosen, roots.size - 1)], -1)
