"""How full the cells of the background grid are."""

from __future__ import annotations

import numba
import numpy as np
import numpy.typing as npt
from dolfinx.la import InsertMode

from dolfinmpm.basis import LatticeBasis, LinearBasis, Stencils
from dolfinmpm.grid import cell_volumes
from dolfinmpm.points import MaterialPoints

__all__ = ["fill_fractions"]

Array = npt.NDArray[np.float64]


@numba.njit(cache=True)
def _spread(order, groups, cell_start, cells, low, high, x, half, volume, out):
    """Add each point's volume to the cells it overlaps, by the shares of its domain."""
    for g in range(groups.size - 1):
        for position in range(groups[g], groups[g + 1]):
            p = order[position]
            for at in range(cell_start[g], cell_start[g + 1]):
                share = 1.0
                if cell_start[g + 1] - cell_start[g] > 1:
                    for d in range(x.shape[1]):
                        left = max(x[p, d] - half[p, d], low[cells[at], d])
                        right = min(x[p, d] + half[p, d], high[cells[at], d])
                        share *= max(right - left, 0.0) / (2.0 * half[p, d])
                out[cells[at]] += share * volume[p]


def fill_fractions(
    points: MaterialPoints, stencils: Stencils, basis: LatticeBasis | LinearBasis
) -> Array:
    """Share of each local cell's volume that material points fill, shape (cells,). Collective.

    The volume of a point is shared out among the cells that its domain overlaps.

    Args:
        points: Material points.
        stencils: Their stencils.
        basis: The basis that these belong to.
    """
    shared = basis.cells.vector()
    x = points["x"]
    if isinstance(basis, LatticeBasis):
        ijk = basis.halo.cell_ijk
        low = np.column_stack([line[ijk[:, d]] for d, line in enumerate(basis.lattice.lines)])
        high = np.column_stack([line[ijk[:, d] + 1] for d, line in enumerate(basis.lattice.lines)])
        volumes = np.prod(high - low, axis=1)
    else:
        low = high = np.empty((0, x.shape[1]))
        volumes = cell_volumes(points.grid)
    _spread(
        stencils.order, stencils.groups, stencils.cell_start, stencils.cells, low, high, x,
        points["l"], points["V"], shared.array,
    )  # fmt: skip
    if basis.cells.comm.size > 1:
        shared.scatter_reverse(InsertMode.add)
        shared.scatter_forward()
    return shared.array / volumes
