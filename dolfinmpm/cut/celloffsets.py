"""Where points are in their cells, for terms with means over cells such as a pressure projection.

Where nodes of ill-filled cells are tied to roots, such a cell and its root carry one polynomial,
and are one cell to means: with means of their own a first undrained step overshoots by 13 %. In one
dimension the projection then lumps what is stored at the ends of both together.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from dolfinx import fem
from dolfinx.la import InsertMode

from dolfinmpm.basis import LatticeBasis, Placement
from dolfinmpm.cut.activation import ActiveField
from dolfinmpm.cut.fractions import fill_fractions

__all__ = ["cell_offsets"]

Array = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]
# Roots that are as near, up to rounding, are no more than those around a corner in space
_EQUAL = 8


def cell_offsets(where: Placement, field: ActiveField) -> Array:
    """From the centres of mass of the cells' points to the points, and sizes. Collective.

    Args:
        where: The points, as the field's stencils see them.
        field: The field.

    Returns:
        Shape (points, gdim + 1): offsets (m), and sizes (m): that of the cell, see `cell_size`,
        times the volume of the points of cells that count as one by that of a cell, from 1 to 2.
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
    else:
        h = field.space.cell_size
        size = (
            h.x.array[where.cell] if isinstance(h, fem.Function) else np.full(len(where.x), h.value)
        )
        _, cell = np.unique(where.cell, return_inverse=True)
        mine = np.stack([np.bincount(cell, m) for m in moments.T], axis=1)[cell]
    return np.hstack([where.x - mine[:, 1:] / mine[:, :1], size[:, None]])


def _summed(basis: LatticeBasis, cell: Ints, values: Array) -> Array:
    """Sums over cells of all ranks, shape (cells, columns). Collective."""
    shared = basis.cells.vector(values.shape[1])
    sums = shared.array.reshape(-1, values.shape[1])
    np.add.at(sums, cell, values)
    if basis.cells.comm.size > 1:
        shared.scatter_reverse(InsertMode.add)
        shared.scatter_forward()
    return sums


def _with_roots(where: Placement, field: ActiveField, sums: Array) -> tuple[Array, Array]:
    """Sums of ill-filled cells and their roots together, and their volumes by a cell's.

    Collective.
    """
    basis = field.basis
    assert isinstance(basis, LatticeBasis)
    assert field.level is not None
    filled = fill_fractions(where, field.full_stencils, basis)
    root = _roots(basis, filled, field.level)
    own = np.arange(basis.cells.owned)
    together = _summed(basis, root, np.column_stack([sums[own], filled[own]]))
    # owners know the roots of their cells, others ask them
    shared = basis.cells.vector(together.shape[1])
    result = shared.array.reshape(-1, together.shape[1])
    result[own] = together[root]
    shared.scatter_forward()
    return result[:, :-1], result[:, -1]


def _roots(basis: LatticeBasis, filled: Array, level: float) -> Ints:
    """The nearest well-filled cell of each own cell, itself if it is one or there is none."""
    from scipy.spatial import cKDTree

    ijk, own = basis.halo.cell_ijk, basis.cells.owned
    root = np.arange(own)
    good = np.flatnonzero(filled >= level - 1e-9)
    ill = np.flatnonzero((filled[:own] > 0) & (filled[:own] < level - 1e-9))
    if not good.size or not ill.size:
        return root
    # among equals that of the lowest position, on any number of ranks
    good = good[np.lexsort(ijk[good].T[::-1])]
    low, high = basis.cell_corners()
    middle, count = 0.5 * (low + high), min(_EQUAL, good.size)
    distance, near = cKDTree(middle[good]).query(middle[ill], k=[*range(1, count + 1)])
    equal = distance <= distance[:, :1] * (1 + 1e-9)
    root[ill] = good[np.where(equal, near, good.size).min(axis=1)]
    return root
