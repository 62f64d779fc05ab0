"""Cells at the outer edge of the grid that need a ghost penalty though no cell beside is inactive.

The edge of the grid makes no cell a boundary cell, because no function ends there in a cut. Two
kinds of cells need the penalty all the same:

- The body fills less than half of the cell. All its neighbours may be active, and no node beyond
  the body would be held by a penalty.
- With cubic splines, the points of the cell lie in a row along the edge. Beside a side there are
  two functions more than elsewhere. One row of points, such as that of soil that slides along the
  side and is stretched across it, leaves a combination of them nearly free, and more so with F-bar.
  The ghost penalty continues the cubic of the next cell.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from dolfinmpm.basis import LatticeBasis, LeafBasis, LinearBasis, Placement, Stencils
from dolfinmpm.cut.fractions import cell_sums, fill_fractions
from dolfinmpm.grid.linecells import coordinate_rounding

__all__ = ["at_edges", "ill_at_edges"]

Mask = npt.NDArray[np.bool_]

# Cells with less of the body need the penalty
_ILL_FILLED = 0.5
# Standard deviation of the points across the edge, as a share of the cell, below which they lie in
# a row; two even rows have a quarter
_ROW = 0.2
# Lines and corners of cells agree to this share of the grid's length
_ROUNDING = 1e-9


def at_edges(basis: LatticeBasis | LeafBasis) -> Mask:
    """Mask of the cells at the sides of the grid across each axis, shape (gdim, cells)."""
    low, high = basis.cell_corners()
    found = []
    for d, line in enumerate(basis.lattice.lines):
        close = coordinate_rounding(line[0], line[-1], _ROUNDING)
        found.append((low[:, d] - line[0] <= close) | (line[-1] - high[:, d] <= close))
    return np.array(found)


def ill_at_edges(
    where: Placement, seen: Stencils, basis: LatticeBasis | LinearBasis | LeafBasis, edges: Mask
) -> Mask:
    """Mask of the cells at the outer edge of the grid that need a ghost penalty. Collective.

    Args:
        where: Points and markers; markers have no volume.
        seen: Their stencils on all active nodes.
        basis: The basis of the field.
        edges: Active cells at the edge, across each axis or all, shape (1 or gdim, cells).
    """
    outer = np.any(edges, axis=0)
    ill = outer & (fill_fractions(where, seen, basis, outer) < _ILL_FILLED)
    if isinstance(basis, LinearBasis) or basis.degree < 3:
        return ill
    return ill | _in_rows(where, seen, basis, edges)


def _in_rows(
    where: Placement, seen: Stencils, basis: LatticeBasis | LeafBasis, edges: Mask
) -> Mask:
    """Mask of the cells whose points lie in a row along the edge of the grid. Collective.

    Args:
        where, seen, basis, edges: See `ill_at_edges`.
    """
    centres = replace(where, half=np.zeros_like(where.half))
    low, high = basis.cell_corners()
    found = np.zeros(edges.shape[1], bool)
    for d, line in enumerate(basis.lattice.lines):
        place = where.x[:, d] - line[0]
        volume, first, second = (
            cell_sums(centres, seen, basis, where.volume * place**n, edges[d]).copy()
            for n in range(3)
        )
        row = _ROW * (high - low)[:, d] * volume
        found |= edges[d] & (second * volume - first**2 < row**2)
    return found
