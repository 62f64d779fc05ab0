"""Areas of the nodes' functions on sides of a rectangular grid."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from dolfinmpm.basis import LatticeBasis
from dolfinmpm.basis.bspline import integrals, middles

__all__ = ["areas", "radii"]

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


def areas(basis: LatticeBasis, nodes: npt.NDArray[np.intp], axis: int) -> Array:
    """Integrals of the nodes' functions over a side (m^(d-1)).

    Args:
        basis: The basis.
        nodes: Nodes on the side, shape (n,).
        axis: Direction of the side's normal.
    """
    area = np.ones(nodes.size)
    for k, line in enumerate(basis.lattice.lines):
        if k == axis:
            continue
        whole = integrals(line, basis.degree)
        area *= whole[basis.halo.node_ijk[nodes, k]]
    return area
