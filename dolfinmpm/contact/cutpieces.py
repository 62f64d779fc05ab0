"""Segments of boundaries cut where cells meet, as these are in this step."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from dolfinmpm.grid.lattice import Lattice

__all__ = ["pieces_in_cells"]

Array = npt.NDArray[np.float64]

# Parts of a piece that are rounding, by its length
_NONE = 1e-9


def pieces_in_cells(
    x: Array, area: Array, lattice: Lattice
) -> tuple[npt.NDArray[np.intp], Array, Array]:
    """Parts of the markers' segments in each cell, on which the grid's functions have no kinks.

    Args:
        x, area: Middles (m) and area vectors (m) of segments in the plane, shape (n, 2).
        lattice: The grid.

    Returns:
        Marker of each part, shape (m,), middle of the part (m), shape (m, 2), and its share of the
        marker's area, shape (m,).
    """
    of, at, shares = np.arange(len(x)), x, np.ones(len(x))
    if not len(x):
        return of, at, shares
    along = np.column_stack([-area[:, 1], area[:, 0]])
    ends = [lattice.cells_at(x + side * along) for side in (-0.5, 0.5)]
    cut = np.flatnonzero(np.any(ends[0] != ends[1], axis=1))
    if not cut.size:
        return of, at, shares
    whole = np.setdiff1d(of, cut)
    rows, middles, parts = [whole], [x[whole]], [shares[whole]]
    for p in cut:
        first = x[p] - 0.5 * along[p]
        t = [np.array([0.0, 1.0])]
        t += [
            (line - first[d]) / along[p, d] for d, line in enumerate(lattice.lines) if along[p, d]
        ]
        places = np.unique(np.clip(np.concatenate(t), 0.0, 1.0))
        lengths = np.diff(places)
        keep = lengths > _NONE
        middle = 0.5 * (places[1:] + places[:-1])[keep]
        rows.append(np.full(middle.size, p))
        middles.append(first + middle[:, None] * along[p])
        parts.append(lengths[keep] / lengths[keep].sum())
    of = np.concatenate(rows)
    order = np.argsort(of, kind="stable")
    return of[order], np.concatenate(middles)[order], np.concatenate(parts)[order]
