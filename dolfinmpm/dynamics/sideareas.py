"""Areas of the nodes' functions on sides of a rectangular grid."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from dolfinmpm.basis import LatticeBasis
from dolfinmpm.basis.bspline import integrals, middles
from dolfinmpm.basis.lineweights import line_weights, overlapped

__all__ = ["areas", "integrals_within", "line_functions", "radii"]

Array = npt.NDArray[np.float64]


def radii(basis: LatticeBasis, nodes: npt.NDArray[np.intp], axis: int, end: int) -> Array:
    """Radii of the centroids of the nodes' functions on a side (m), of an axisymmetric grid.

    Args:
        basis: The basis.
        nodes: Nodes on the side, shape (n,).
        axis, end: Direction of the side's normal, and 0 for the lower or 1 for the upper end.
    """
    line = basis.lattice.lines[0]
    if axis == 0:
        return np.full(nodes.size, line[-1 if end else 0])
    return middles(line, basis.degree)[basis.halo.node_ijk[nodes, 0]]


def line_functions(line: Array, degree: int, x: Array, half: Array) -> Array:
    """Functions of a direction at places, or averaged over domains, shape (functions, places)."""
    out = np.zeros((line.size - 1 + degree, x.size))
    part, slope = np.empty(degree + 1), np.empty(degree + 1)
    for k, (at, reach) in enumerate(zip(x, half)):
        first, count = overlapped(line, False, at, reach)
        S, dS = np.empty(count + degree), np.empty(count + degree)
        line_weights(line, False, degree, first, count, at, reach, S, dS, part, slope)
        out[first : first + count + degree, k] = S
    return out


def integrals_within(line: Array, degree: int, low: float, high: float) -> Array:
    """Integrals of the functions of a direction over a part of the line (m), shape (functions,)."""
    low, high = max(low, line[0]), min(high, line[-1])
    middle, reach = np.array([0.5 * (low + high)]), np.array([0.5 * (high - low)])
    return (high - low) * line_functions(line, degree, middle, reach)[:, 0]


def areas(
    basis: LatticeBasis,
    nodes: npt.NDArray[np.intp],
    axis: int,
    within: Mapping[int, tuple[float, float]] | None = None,
) -> Array:
    """Integrals of the nodes' functions over a side (m^(d-1)).

    Args:
        basis: The basis.
        nodes: Nodes on the side, shape (n,).
        axis: Direction of the side's normal.
        within: Ends of the part of the side that counts (m), by direction; else the whole side.
    """
    area = np.ones(nodes.size)
    for k, line in enumerate(basis.lattice.lines):
        if k == axis:
            continue
        if within and k in within:
            whole = integrals_within(line, basis.degree, *within[k])
        else:
            whole = integrals(line, basis.degree)
        area *= whole[basis.halo.node_ijk[nodes, k]]
    return area
