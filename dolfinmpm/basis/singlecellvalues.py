"""Values of a lattice's functions at positions, each evaluated in one given cell."""

from __future__ import annotations

import functools

import numba
import numpy as np
import numpy.typing as npt

from dolfinmpm.basis.gimp import domain_weights
from dolfinmpm.basis.latticebasis import LatticeBasis
from dolfinmpm.basis.lineweights import line_weights, snapped

__all__ = ["values_in_cells"]


@functools.cache
def _fill(linear: bool):
    """The compiled loop; the loop for linear functions is compiled without the splines' code."""

    @numba.njit(cache=True, error_model="numpy")
    def kernel(x, cell, lines, start, origin, node_table, shape, degree, uniform, nodes, N):
        d, each = x.shape[1], degree + 1
        S, dS = np.empty((d, 64)), np.empty((d, 64))
        part, slope = np.empty(each), np.empty(each)
        known = True
        for p in range(x.shape[0]):
            for i in range(d):
                line = lines[start[i] : start[i + 1]]
                first = origin[i] + cell[p, i]
                if linear:
                    at = snapped(line, first, x[p, i], 0.0)
                    domain_weights(line, first, 1, at, 0.0, S[i], dS[i])
                else:
                    line_weights(
                        line, uniform, degree, first, 1, x[p, i], 0.0, S[i], dS[i], part, slope
                    )
            for a in range(N.shape[1]):
                rest, at_node, size, product = a, 0, 1, 1.0
                for i in range(d - 1, -1, -1):
                    k = rest % each
                    rest //= each
                    at_node += size * (cell[p, i] + k)
                    size *= shape[i]
                    product *= S[i, k]
                nodes[p, a], N[p, a] = node_table[at_node], product
                known = known and nodes[p, a] >= 0
        return known

    return kernel


def values_in_cells(
    basis: LatticeBasis, x: npt.NDArray[np.float64], cell: npt.NDArray[np.integer]
) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.float64]] | None:
    """Nodes and values of the functions, not averaged, in given cells.

    Args:
        basis: The basis.
        x: Positions (m), shape (n, gdim).
        cell: Positions of the cells in the halo's tables, shape (n, gdim).

    Returns:
        Nodes and values (-), both of shape (n, functions per cell), or None if this rank does not
        know one of the nodes.
    """
    halo, lines = basis.halo, basis.lattice.lines
    start = np.cumsum([0, *(line.size for line in lines)])
    shape = len(x), (basis.degree + 1) ** x.shape[1]
    nodes, N = np.empty(shape, np.int32), np.empty(shape)
    known = _fill(basis.degree == 1)(
        x, cell, np.concatenate(lines), start, halo.origin, halo.node_table.ravel(),
        np.array(halo.node_table.shape, np.int64), basis.degree, basis.lattice.uniform, nodes, N,
    )  # fmt: skip
    return (nodes, N) if known else None
