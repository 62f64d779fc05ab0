"""Aggregation and extension on leaves: roots among leaves of any size."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from dolfinmpm.basis import LeafBasis
from dolfinmpm.basis.bspline import extended
from dolfinmpm.grid.linecells import coordinate_rounding, relative_rounding

__all__ = ["leaf_constraints"]

Array = npt.NDArray[np.float64]
Rows = npt.NDArray[np.intp]
# Nearest leaves among which the root of a node is chosen, and their largest distance in units of
# the larger cell
_CANDIDATES, _FARTHEST = 64, 5.0
# The same of each size, for splines
_OF_SIZE = 24


def leaf_constraints(
    basis: LeafBasis, nodes: npt.NDArray[np.int32], filled: Array, threshold: float, every: bool
) -> Iterator[tuple[int, npt.NDArray[np.int32], Array]]:
    """Nodes with too little support, with the nodes of their roots and the weights.

    The root is the nearest leaf, with the distance in units of the larger one of the root and of
    the cells at the node. For splines it is the leaf with the least weights. Among equal leaves
    the lowest one decides. A node on a side of the grid uses only leaves on this side. Hanging
    nodes follow their leaf and need no root.

    Args:
        basis: The basis.
        nodes: Active nodes known on this rank.
        filled: Fill fraction of every local leaf, shape (cells,); for splines the share of every
            function's integral in the body, shape (nodes,).
        threshold: Fraction from which a leaf is well-filled; for splines see `constraint_matrix`.
        every: Whether every leaf of supported nodes may be a root, not only a well-filled one.
    """
    p, close = basis.degree, _rounding(basis)
    if p == 1:
        good = filled >= threshold - close
        inner: npt.NDArray[np.bool_] = np.zeros(basis.nodes.size, bool)
        inner[basis.corner_nodes[good].ravel()] = True
        # the nodes that a supported hanging node follows have its support
        inner |= np.asarray(basis.hanging.T @ inner.astype(float) > 0)
    else:
        inner = filled >= threshold ** (p + 1) / math.factorial(p + 1) * (1 - close)
    if every or p > 1:
        good = np.asarray(inner[basis.corner_nodes].all(axis=1))
    outer = nodes[~inner[nodes] & ~basis.hangs[nodes]]
    roots: Rows = np.flatnonzero(good)
    if not outer.size or not roots.size:
        return
    roots = roots[np.argsort(basis.leaf[roots], kind="stable")]
    nearest = _nearest(basis, outer, roots)
    outer, nearest = outer[nearest >= 0], nearest[nearest >= 0]
    if not outer.size:
        return
    weights: Array = np.ones((outer.size, 1))
    for d in range(basis.knots.shape[1]):
        along = extended(basis.knots[nearest, d], basis.inner_knots[outer, d])
        weights = (weights[:, :, None] * along[:, None]).reshape(outer.size, -1)
    for k, (a, root) in enumerate(zip(outer, nearest)):
        yield int(a), basis.corner_nodes[root], np.asarray(weights[k])


def _nearest(basis: LeafBasis, outer: npt.NDArray[np.int32], roots: Rows) -> Rows:
    """Root of each node, or -1."""
    low, high = basis.cell_corners()
    size, x = basis.cell_sizes(), basis.node_coordinates()[outer, : low.shape[1]]
    around: Array = np.zeros(basis.nodes.size)
    np.maximum.at(around, basis.corner_nodes.ravel(), np.repeat(size, basis.corner_nodes.shape[1]))
    middles, far = 0.5 * (low + high)[roots], _FARTHEST
    if basis.degree == 1:
        distance, near = _candidates(x, middles, np.arange(roots.size), _CANDIDATES)
        unit = distance / np.maximum(size[roots][near], around[outer][:, None])
    else:
        # a far large leaf may serve better than near small ones
        level = np.round(np.log2(size[roots] / size.min()))
        each = [np.flatnonzero(level == k) for k in np.unique(level)]
        near = np.hstack([_candidates(x, middles, rows, _OF_SIZE)[1] for rows in each])
        unit, far = _growth(basis, outer, roots[near]), np.inf
    ends = np.array([[line[0], line[-1]] for line in basis.lattice.lines])
    allowed: npt.NDArray[np.bool_] = np.ones(near.shape, bool)
    for d, (first, last) in enumerate(ends):
        slack = coordinate_rounding(first, last)
        for corner, end in ((low, first), (high, last)):
            at_side = np.abs(x[:, d] - end) <= slack
            allowed &= ~at_side[:, None] | (np.abs(corner[roots][near][..., d] - end) <= slack)
    allowed |= ~allowed.any(axis=1, keepdims=True)
    unit = np.where(allowed & (unit <= far), unit, np.inf)
    best = unit.min(axis=1, keepdims=True)
    chosen = np.where(unit <= best * (1 + _rounding(basis)), near, roots.size).min(axis=1)
    known = np.isfinite(best[:, 0])
    return np.where(known, roots[np.minimum(chosen, roots.size - 1)], -1)


def _rounding(basis: LeafBasis) -> float:
    """Relative rounding error of lengths in leaves."""
    return relative_rounding(basis.lattice.lines, 2.0**-basis.leaves.tree.levels)


def _candidates(x: Array, middles: Array, rows: Rows, most: int) -> tuple[Array, Rows]:
    """Distances of the nearest of some leaves, and their rows, shape (x, candidates)."""
    from scipy.spatial import cKDTree

    found = cKDTree(middles[rows]).query(x, k=[*range(1, min(most, rows.size) + 1)])
    return np.asarray(found[0]), rows[found[1]]


def _growth(basis: LeafBasis, outer: npt.NDArray[np.int32], roots: Rows) -> Array:
    """Norm of the weights that continue splines of roots to outer ones, shape (outer, roots)."""
    norm: Array = np.ones(roots.shape)
    each = np.repeat(outer, roots.shape[1])
    for d in range(basis.knots.shape[1]):
        weights = extended(basis.knots[roots.ravel(), d], basis.inner_knots[each, d])
        norm *= np.linalg.norm(weights, axis=1).reshape(roots.shape)
    return norm
