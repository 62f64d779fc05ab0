"""Offsets of points in their cells, for terms with averages over cells (pressure projections).

If the nodes of an ill-filled cell are constrained to a root cell, both cells have one polynomial.
Then both count as one cell for averages. With separate averages, a first undrained step overshoots
by 13 %. In one dimension the projection then lumps the storage at the ends of both cells together.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from dolfinx import fem
from dolfinx.la import InsertMode

from dolfinmpm.basis import LatticeBasis, LeafBasis, Placement
from dolfinmpm.cut.activation import ActiveField
from dolfinmpm.cut.fractions import fill_fractions
from dolfinmpm.grid.linecells import relative_rounding

__all__ = ["cell_offsets"]

Array = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]
# Largest number of roots at equal distance: the cells around a corner in space
_EQUAL = 8


def cell_offsets(where: Placement, field: ActiveField) -> Array:
    """Offsets of points from the centres of mass of their cells, and sizes. Collective.

    Args:
        where: Positions, half-lengths and volumes of the points.
        field: The field.

    Returns:
        Shape (points, gdim + 1): offsets (m), and sizes (m). A size is the cell size, see
        `cell_size`, times a factor from 1 to 2: the volume of the points in a cell with its
        constrained cells, divided by the volume of the cell.
    """
    basis = field.basis
    moments = np.column_stack([where.volume, where.volume[:, None] * where.x])
    if isinstance(basis, LatticeBasis):
        ijk = basis.lattice.cells_at(where.x)
        position = ijk - basis.halo.origin
        cell = basis.halo.cell_table[tuple(position.T)].astype(np.int64)
        edges = [np.diff(line)[i] for line, i in zip(basis.lattice.lines, ijk.T)]
        size = np.prod(edges, axis=0) ** (1 / len(edges))
        sums = _summed(basis, cell, moments)
        if field.level is not None:
            sums, volume = _with_roots(where, field, sums)
            size *= np.clip(volume[cell], 1.0, 2.0)
        mine = sums[cell]
    elif isinstance(basis, LeafBasis):
        cell = basis.cells_at(where.x).astype(np.int64)
        size = basis.cell_sizes()[cell]
        mine = _summed(basis, cell, moments)[cell]
    else:
        h = field.space.cell_size
        size = (
            h.x.array[where.cell] if isinstance(h, fem.Function) else np.full(len(where.x), h.value)
        )
        _, cell = np.unique(where.cell, return_inverse=True)
        mine = np.stack([np.bincount(cell, m) for m in moments.T], axis=1)[cell]
    return np.hstack([where.x - mine[:, 1:] / mine[:, :1], size[:, None]])


def _summed(basis: LatticeBasis | LeafBasis, cell: Ints, values: Array) -> Array:
    """Sums over cells of all ranks, shape (cells, columns). Collective."""
    shared = basis.cells.vector(values.shape[1])
    sums = shared.array.reshape(-1, values.shape[1])
    np.add.at(sums, cell, values)
    if basis.cells.comm.size > 1:
        shared.scatter_reverse(InsertMode.add)
        shared.scatter_forward()
    return sums


def _with_roots(where: Placement, field: ActiveField, sums: Array) -> tuple[Array, Array]:
    """Common sums of ill-filled cells and their roots, and their fill fractions. Collective."""
    basis = field.basis
    assert isinstance(basis, LatticeBasis)
    assert field.level is not None
    filled = fill_fractions(where, field.full_stencils, basis)
    root = _roots(basis, filled, field.level)
    own = np.arange(basis.cells.owned)
    of_roots = _summed(basis, root, np.column_stack([sums[own], filled[own]]))
    # only the owner of a cell knows its root
    shared = basis.cells.vector(of_roots.shape[1])
    result = shared.array.reshape(-1, of_roots.shape[1])
    result[own] = of_roots[root]
    shared.scatter_forward()
    return result[:, :-1], result[:, -1]


def _roots(basis: LatticeBasis, filled: Array, level: float) -> Ints:
    """The nearest well-filled cell of each own cell, or the cell itself if there is none."""
    from scipy.spatial import cKDTree

    ijk, own = basis.halo.cell_ijk, basis.cells.owned
    root = np.arange(own)
    close = relative_rounding(basis.lattice.lines)
    good = np.flatnonzero(filled >= level - close)
    ill = np.flatnonzero((filled[:own] > 0) & (filled[:own] < level - close))
    if not good.size or not ill.size:
        return root
    # among equal cells the lowest position decides, on any number of ranks
    good = good[np.lexsort(ijk[good].T[::-1])]
    low, high = basis.cell_corners()
    middle, count = 0.5 * (low + high), min(_EQUAL, good.size)
    distance, near = cKDTree(middle[good]).query(middle[ill], k=[*range(1, count + 1)])
    equal = distance <= distance[:, :1] * (1 + close)
    root[ill] = good[np.where(equal, near, good.size).min(axis=1)]
    return root
