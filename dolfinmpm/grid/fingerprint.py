"""Fingerprints that tell background grids, and their distributions over ranks, apart."""

from __future__ import annotations

import hashlib
import math
from typing import Any

import numpy as np
import numpy.typing as npt
from dolfinx.mesh import Mesh
from mpi4py import MPI

from dolfinmpm._platform.compat import geometry_dofmap
from dolfinmpm.grid.lattice import once_per_grid

__all__ = ["differs", "fingerprint", "owned_corners", "partition"]

# Bound of rounding errors of coordinates, as a share of the grid's size. A mesh generator may
# round differently on other numbers of ranks.
_ROUNDING = 1e-12
_WAVES = 4


def owned_corners(grid: Mesh) -> npt.NDArray[np.float64]:
    """Corners (m) of the cells that this rank owns, shape (cells, corners per cell, gdim)."""
    owned = grid.topology.index_map(grid.topology.dim).size_local
    x = np.asarray(grid.geometry.x, float)
    return x[geometry_dofmap(grid)[:owned], : grid.geometry.dim]


@once_per_grid
def fingerprint(grid: Mesh) -> dict[str, Any]:
    """A few numbers that describe the grid, on any distribution over ranks. Collective.

    The numbers are: number and type of cells, dimension, corners of the bounding box (m), and mean
    values over the cells of some cosine waves at corners and midpoints. The mean values change with
    every coordinate and with the connectivity of the cells. They do not change with the order of
    cells or vertices.
    """
    comm, gdim = grid.comm, grid.geometry.dim
    corners = owned_corners(grid)
    cells = comm.allreduce(len(corners), op=MPI.SUM)
    flat = corners.reshape(-1, gdim)
    low, high = np.empty(gdim), np.empty(gdim)
    comm.Allreduce(flat.min(axis=0, initial=math.inf), low, op=MPI.MIN)
    comm.Allreduce(flat.max(axis=0, initial=-math.inf), high, op=MPI.MAX)
    scaled = (corners - low) / (high - low).max()
    middles = scaled.mean(axis=1)
    # wave lengths with irrational ratios, so that no two coordinates can compensate each other
    waves = np.sqrt(np.arange(2.0, 2.0 + _WAVES * gdim)).reshape(_WAVES, gdim) * 2 * math.pi
    at_corners = [np.cos(scaled @ wave).mean(axis=1).sum() for wave in waves]
    sums = np.array(at_corners + [np.cos(middles @ wave).sum() for wave in waves])
    totals = np.empty_like(sums)
    comm.Allreduce(sums, totals, op=MPI.SUM)
    return {
        "cells": cells,
        "type": grid.topology.cell_type.name,
        "dimension": gdim,
        "low": low.tolist(),
        "high": high.tolist(),
        "waves": (totals / max(cells, 1)).tolist(),
    }


def differs(one: dict[str, Any], other: dict[str, Any]) -> str | None:
    """The difference of two fingerprints in words, such as "4 in place of 8 cells", or None."""
    for key, unit in (("cells", "cells"), ("type", "as type of cell"), ("dimension", "dimensions")):
        if one[key] != other[key]:
            return f"{one[key]} in place of {other[key]} {unit}"
    size = np.ptp([other["low"], other["high"]], axis=0).max()
    for key in ("low", "high"):
        if np.abs(np.subtract(one[key], other[key])).max() > 1e-9 * size:
            return f"its {key}est corner at {one[key]} m in place of {other[key]} m"
    if np.abs(np.subtract(one["waves"], other["waves"])).max() > _ROUNDING:
        return "its vertices or cells lie elsewhere in the same box"
    return None


@once_per_grid
def partition(grid: Mesh) -> list[str]:
    """One hash per rank of its cells, with all bits, their order, and ghosts. Collective."""
    cell_map = grid.topology.index_map(grid.topology.dim)
    digest = hashlib.sha256(np.ascontiguousarray(owned_corners(grid)).tobytes())
    for values in (cell_map.local_range, cell_map.ghosts, cell_map.owners):
        digest.update(np.asarray(values, np.int64).tobytes())
    return grid.comm.allgather(digest.hexdigest())
