"""Exact volumes and centres of mass of shapes whose surface cuts the parts of cells.

A part that the surface cuts gets a point at the centroid of what is inside, with
the volume of that. Boxes that a polygon cuts have exact ones, others are sampled. The volumes of
these points are then corrected so that the whole has the volume and the first moments of the shape:
V_i ← V_i exp(λ0 + λ·(x_i − c)), which is the smallest correction in the sense of relative
entropy (the "raking" of survey statistics; Deville & Särndal 1992,
doi 10.1080/01621459.1992.10475217) and keeps every volume positive. What little of the moments
volumes cannot give, as in a body of a few points, is given by shifting them. Pieces of a polygon
that are boxes stay as they are, so that their faces lie on its edges.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm._platform.errors import ParameterError
from dolfinmpm.body.cellparts import LatticeParts, Parts
from dolfinmpm.body.polygonpieces import moments_in_boxes, touched_boxes
from dolfinmpm.body.shapes import Polygon, Shape

__all__ = ["Pieces", "correct", "pieces_inside"]

Array = npt.NDArray[np.float64]

# Samples of a part and direction: to find the parts that are cut, and to measure those.
_FIND = {1: 16, 2: 6, 3: 4}
_MEASURE = {1: 256, 2: 16, 3: 8}
# A sample of this many positions at a time stays in the processor's cache.
_CHUNK = 200_000
# Points of less than this share of a part would weigh next to nothing.
_SLIVER = 0.01
# Share of a part that is rounding, and that of the moments of a box
_WHOLE, _ALIKE = 1e-11, 1e-6
# Cut pieces share the correction alone as long as none changes by more than this factor.
_MODERATE = 1.5
# How far a piece may be shifted at the cost of changing its volume by all of it, in its size.
_SHIFT = 0.05
# How far cut pieces are shifted before all pieces share the correction, in the size of a piece.
# Pieces along one straight edge have their moment across the edge from this shift alone; samples
# miss a centroid by up to half of their distance, 1/32 of a part in 2D.
_MOST = 0.1
_EXACT = 1e-13


@dataclass
class Pieces:
    """What is inside a shape of the parts of cells.

    Attributes:
        rows: Parts that they belong to, shape (n,).
        x: Centroids (m), shape (n, gdim).
        volume: Volumes (m^d), shape (n,).
        spread: Standard deviations of their matter along the axes (m), shape (n, gdim).
        cut: Whether the surface of the shape cuts the part, shape (n,).
    """

    rows: npt.NDArray[np.intp]
    x: Array
    volume: Array
    spread: Array
    cut: npt.NDArray[np.bool_]


def pieces_inside(parts: Parts, shape: Shape) -> Pieces:
    """The pieces of parts that are inside a shape: exact for boxes in a polygon, else by sampling.

    Args:
        parts: Parts of cells.
        shape: The shape that they must lie in.
    """
    if isinstance(parts, LatticeParts) and isinstance(shape, Polygon):
        return _pieces_in_polygon(parts, shape)
    gdim = parts.x.shape[1]
    some, cut = np.empty(len(parts.x), bool), np.empty(len(parts.x), bool)
    for rows in _chunks(np.arange(len(parts.x)), _FIND[gdim] ** gdim):
        x, _ = parts.samples(rows, _FIND[gdim])
        # drawn out to the corners of the part: an edge of the shape may pass close to its faces
        middle = parts.x[rows, None]
        x = middle + 0.999 * _FIND[gdim] / (_FIND[gdim] - 1) * (x - middle)
        inside = shape.contains(x.reshape(-1, gdim)).reshape(x.shape[:2])
        some[rows] = inside.any(axis=1)
        cut[rows] = some[rows] & ~inside.all(axis=1)
    x, volume, spread = parts.x.copy(), parts.volume.copy(), np.empty(parts.x.shape)
    for at in _chunks(np.flatnonzero(some & ~cut), 2**gdim):
        samples, _ = parts.samples(at, 2)
        spread[at] = _spread(samples, np.ones(samples.shape[:2]), samples.mean(axis=1), 2)
    for at in _chunks(np.flatnonzero(cut), _MEASURE[gdim] ** gdim):
        samples, weight = parts.samples(at, _MEASURE[gdim])
        inside = shape.contains(samples.reshape(-1, gdim)).reshape(samples.shape[:2])
        weight = weight * inside
        # what slivers hold goes to their neighbours with the correction
        some[at] = weight.sum(axis=1) > _SLIVER * parts.volume[at]
        at, samples, weight = (a[some[at]] for a in (at, samples, weight))
        volume[at] = weight.sum(axis=1)
        x[at] = np.einsum("rq,rqi->ri", weight, samples) / volume[at, None]
        spread[at] = _spread(samples, weight, x[at], _MEASURE[gdim])
    kept = np.flatnonzero(some)
    return Pieces(kept, x[kept], volume[kept], spread[kept], cut[kept])


def _pieces_in_polygon(parts: LatticeParts, shape: Polygon) -> Pieces:
    """The pieces of boxes in a polygon."""
    low, high, size = parts.low, parts.high, parts.high - parts.low
    cut = touched_boxes(shape.vertices, low, high)
    x, volume, spread = parts.x.copy(), parts.volume.copy(), size / np.sqrt(12.0)
    some = shape.contains(parts.x) | cut
    rows = np.flatnonzero(cut)
    moments = moments_in_boxes(shape.vertices, low[rows], high[rows]) * shape.turn
    area = moments[:, 0]
    # edges along faces of a part, up to rounding, do not cut it
    whole = area >= (1 - _WHOLE) * volume[rows]
    cut[rows[whole]] = False
    # what slivers hold goes to their neighbours with the correction
    held = area > _SLIVER * volume[rows]
    some[rows[~held]] = False
    rows, moments = rows[held & ~whole], moments[held & ~whole]
    first = moments[:, 1:3] / moments[:, :1]
    x[rows] += first
    volume[rows] = moments[:, 0]
    spread[rows] = np.sqrt(moments[:, 3:] / moments[:, :1] - first**2)
    box = np.abs(12.0 * spread[rows].prod(axis=1) / volume[rows] - 1.0) < _ALIKE
    cut[rows[box]] = False
    kept = np.flatnonzero(some)
    return Pieces(kept, x[kept], volume[kept], spread[kept], cut[kept])


def _spread(samples: Array, weight: Array, middle: Array, m: int) -> Array:
    square = np.einsum("rq,rqi->ri", weight, (samples - middle[:, None]) ** 2)
    # a sample stands for a piece that has a spread of its own
    own = np.ptp(samples, axis=1) / (m - 1)
    return np.sqrt(square / weight.sum(axis=1)[:, None] + own**2 / 12)


def _chunks(rows: npt.NDArray[np.intp], samples: int):
    size = max(1, _CHUNK // samples)
    return (rows[k : k + size] for k in range(0, len(rows), size))


def correct(comm: MPI.Comm, pieces: Pieces, shape: Shape) -> None:
    """Give the pieces the volume of the shape and, where it is known, its centroid. Collective.

    Args:
        comm: Communicator.
        pieces: Changed: volumes, and a little the positions, of pieces that are cut; of
            all of them where that is not enough.
        shape: Its `volume` and `centroid` are what the pieces are to have together.

    Raises:
        ParameterError: No moderate correction exists.
    """
    if shape.volume is None:
        return
    for free in (pieces.cut, np.ones(len(pieces.x), bool)):
        found = _corrected(comm, pieces, free, shape)
        if found is not None:
            pieces.x, pieces.volume = found
            return
    whole = comm.allreduce(float(pieces.volume.sum()), op=MPI.SUM)
    raise ParameterError(
        f"the points found in {type(shape).__name__} have the volume {whole:.6g} m^d, the shape "
        f"has {shape.volume:.6g}: too far apart to be made equal; use more points per cell, finer "
        "cells or exact=False"
    )


def _corrected(comm, pieces: Pieces, free, shape: Shape) -> tuple[Array, Array] | None:
    x, volume = pieces.x.copy(), pieces.volume.copy()
    gdim = x.shape[1]
    low = np.min(comm.allgather(x.min(axis=0, initial=np.inf)), axis=0)
    high = np.max(comm.allgather(x.max(axis=0, initial=-np.inf)), axis=0)
    size = max(float((high - low).max()), shape.volume ** (1 / gdim))  # type: ignore[operator]
    centre = 0.5 * (low + high) if shape.centroid is None else shape.centroid
    reach2 = (_SHIFT * volume[free] ** (1 / gdim) / size) ** 2
    wanted = np.zeros(1 + gdim)
    wanted[0] = shape.volume
    known = slice(None) if shape.centroid is not None else slice(0, 1)
    total = np.zeros(1 + gdim)
    for _ in range(12):
        # positions in units of the body's size
        z = np.column_stack([np.ones(len(x)), (x - centre) / size])
        there = comm.allreduce(volume @ z)
        miss = (wanted - there)[known] / wanted[0]
        if np.abs(miss).max() <= _EXACT:
            change = np.abs(total[0] + z[free, 1:] @ total[1:]).max(initial=0.0)
            moved = _SHIFT * np.sqrt(reach2.max(initial=0.0)) * np.abs(total[1:]).max()
            moderate = max(change / np.log(_MODERATE), moved / _MOST)
            return (x, volume) if comm.allreduce(float(moderate), op=MPI.MAX) <= 1 else None
        s, y = volume[free], z[free]
        A = (s[:, None] * y).T @ y
        A[1:, 1:] += (s @ reach2) * np.eye(gdim)
        A = comm.allreduce(A)[known, known] / wanted[0]
        if not A[0, 0] > 0:
            return None
        step = np.zeros(1 + gdim)
        step[known] = np.linalg.solve(A, miss)
        # not the step itself: of pieces along one edge its parts are large, and cancel
        large = comm.allreduce(float(np.abs(y @ step).max(initial=0.0)), op=MPI.MAX)
        if not large < 10:
            return None
        total += step
        volume[free] = s * np.exp(y @ step)
        x[free] += size * reach2[:, None] * step[1:]
    return None
