"""The two leaves at a ghost facet, for penalties that depend on their stiffness."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from dolfinmpm.assembly.facetpenalties import Pair
from dolfinmpm.assembly.latticefacets import gauss_rule, product

__all__ = ["leaf_pair", "linear_functions"]

Array = npt.NDArray[np.float64]
Box = tuple[Array, Array]


def linear_functions(box: Box, d: int, x: Array, order: int) -> Array:
    """Derivatives of the two linear functions of a leaf in a direction, shape (x, 2)."""
    low, high = box[0][d], box[1][d]
    if order == 0:
        return np.column_stack([(high - x) / (high - low), (x - low) / (high - low)])
    slope = 1.0 / (high - low) if order == 1 else 0.0
    return np.column_stack([np.full(x.size, -slope), np.full(x.size, slope)])


def leaf_pair(boxes: tuple[Box, Box], direction: int, tensor: Array) -> Pair:
    """The pair of leaves at a facet, with the functions that are continuous across it.

    Args:
        boxes: Lower and upper corners of the leaves (m).
        direction: Direction across the facet.
        tensor: Tensor of the penalty over γ between the functions of both leaves, those of the
            first leaf first; see `FacetTensors`.
    """
    d = boxes[0][0].size
    T = _continuous(boxes, direction)
    each, n = 2**d, T.shape[1]
    gradients = np.empty((2, d, n, d, n))
    for c, box in enumerate(boxes):
        own = T[c * each : (c + 1) * each]
        for i in range(d):
            for k in range(d):
                lines = [_moment(box, e, int(e == i), int(e == k)) for e in range(d)]
                gradients[c, i, :, k] = own.T @ product(lines) @ own
    pairs: Array = np.asarray(tensor.reshape(2 * each, 2 * each, -1))
    if pairs.shape[2] == 1:
        pairs = np.asarray(pairs * np.eye(d).ravel())
    whole = np.kron(T, np.eye(d))
    J = np.transpose(pairs.reshape(2 * each, 2 * each, d, d), (0, 2, 1, 3))
    return Pair(gradients, whole.T @ J.reshape(len(whole), len(whole)) @ whole)


def _moment(box: Box, d: int, first: int, second: int) -> Array:
    """∫ of the products of derivatives of two orders along an edge of a leaf, shape (2, 2)."""
    points, weights = gauss_rule(2)
    length = box[1][d] - box[0][d]
    x = box[0][d] + 0.5 * length * (points + 1)
    A, B = (linear_functions(box, d, x, order) for order in (first, second))
    return np.asarray((0.5 * length * weights[:, None] * A).T @ B)


def _continuous(boxes: tuple[Box, Box], direction: int) -> Array:
    """Functions of both leaves in terms of the continuous ones, shape (2 2^d, 2^d + 2^(d-1)).

    On the facet, the smaller leaf takes the values of the larger one.
    """
    low = np.array([box[0] for box in boxes])
    high = np.array([box[1] for box in boxes])
    d = low.shape[1]
    along = np.arange(d) != direction
    master = int(np.prod((high - low)[1, along]) > np.prod((high - low)[0, along]))
    # which end of the other leaf is at the facet
    other = 1 - master
    near = int(low[other, direction] < low[master, direction])
    each, half = 2**d, 2 ** (d - 1)
    T = np.zeros((2 * each, each + half))
    T[master * each : (master + 1) * each, :each] = np.eye(each)
    far = each
    for row, corner in enumerate(np.ndindex(*(2,) * d)):
        at = other * each + row
        if corner[direction] != near:
            T[at, far] = 1.0
            far += 1
            continue
        x = np.where(corner, high[other], low[other])
        values = [linear_functions(boxes[master], e, x[e : e + 1], 0) for e in range(d)]
        T[at, :each] = product(values)[0]
    return T
