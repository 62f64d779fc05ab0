"""The two leaves at a ghost facet, for penalties that depend on their stiffness."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from dolfinmpm.assembly.facetpenalties import Pair
from dolfinmpm.assembly.latticefacets import gauss_rule, product, splines_between

__all__ = ["leaf_pair"]

Array = npt.NDArray[np.float64]


def leaf_pair(knots: Array, direction: int, tensor: Array) -> Pair:
    """The pair of leaves at a facet, with the functions that are as smooth across it as in a leaf.

    Args:
        knots: Knots around both leaves (m), shape (2, gdim, 2 p).
        direction: Direction across the facet.
        tensor: Tensor of the penalty over γ between the functions of both leaves, those of the
            first leaf first; see `FacetTensors`.
    """
    d, p = knots.shape[1], knots.shape[2] // 2
    T = _smooth(knots, direction)
    each, n = (p + 1) ** d, T.shape[1]
    gradients = np.empty((2, d, n, d, n))
    for c in range(2):
        own = T[c * each : (c + 1) * each]
        for i in range(d):
            for k in range(d):
                lines = [_moment(knots[c, e], int(e == i), int(e == k)) for e in range(d)]
                gradients[c, i, :, k] = own.T @ product(lines) @ own
    pairs: Array = np.asarray(tensor.reshape(2 * each, 2 * each, -1))
    if pairs.shape[2] == 1:
        pairs = np.asarray(pairs * np.eye(d).ravel())
    whole = np.kron(T, np.eye(d))
    J = np.transpose(pairs.reshape(2 * each, 2 * each, d, d), (0, 2, 1, 3))
    return Pair(gradients, whole.T @ J.reshape(len(whole), len(whole)) @ whole)


def _moment(knots: Array, first: int, second: int) -> Array:
    """∫ of the products of derivatives of two orders along an edge, shape (p + 1, p + 1)."""
    p = knots.size // 2
    points, weights = gauss_rule(p + 1)
    low, high = knots[p - 1 : p + 1]
    x = low + 0.5 * (high - low) * (points + 1)
    A, B = (splines_between(knots, x, order) for order in (first, second))
    return np.asarray((0.5 * (high - low) * weights[:, None] * A).T @ B)


def _smooth(knots: Array, direction: int) -> Array:
    """Functions of both leaves in terms of smooth ones, shape (2 (p+1)^d, (p+1)^d + (p+1)^(d-1)).

    They are the polynomials of the larger leaf, continued, and those of the smaller leaf that begin
    at the facet with the power p of the distance.
    """
    d, p = knots.shape[1], knots.shape[2] // 2
    low, high = np.asarray(knots[:, :, p - 1]), np.asarray(knots[:, :, p])
    along = np.arange(d) != direction
    master = int(np.prod((high - low)[1, along]) > np.prod((high - low)[0, along]))
    other = 1 - master
    facet = high if low[other, direction] < low[master, direction] else low
    each = (p + 1) ** d
    continued: list[Array] = []
    beginning: list[Array] = []
    for e in range(d):
        own = knots[other, e]
        x = np.linspace(low[other, e], high[other, e], p + 1)
        values = splines_between(own, x, 0)
        larger = splines_between(knots[master, e], x, 0)
        continued.append(np.asarray(np.linalg.solve(values, larger), np.float64))
        if e == direction:
            size = high[other, e] - low[other, e]
            power = np.linalg.solve(values, (np.abs(x - facet[other, e]) / size) ** p)
            beginning.append(np.asarray(power[:, None], np.float64))
        else:
            beginning.append(np.eye(p + 1))
    T = np.zeros((2 * each, each + (p + 1) ** (d - 1)))
    T[master * each : (master + 1) * each, :each] = np.eye(each)
    T[other * each : (other + 1) * each] = np.hstack([product(continued), product(beginning)])
    return T
