"""Probes: values at a place of a body, as weighted means of the nearest material points."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt
from dolfinx.mesh import Mesh
from mpi4py import MPI

from dolfinmpm._platform.argumentchecks import shown, vector
from dolfinmpm._platform.collective import collective
from dolfinmpm._platform.errors import (
    FieldShapeError,
    ParameterError,
    UnknownNameError,
    call_together,
)
from dolfinmpm._platform.uncopied import Unchanged
from dolfinmpm.body.formarguments import check_points
from dolfinmpm.body.markerstate import keys_of
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.grid.lattice import cell_edges, largest_cell

__all__ = ["Probe", "probe"]

Array = npt.NDArray[np.float64]

# Relative difference of equal distances; equal first positions differ by this share of a cell
_SAME = 1e-7
# Rows of candidate points per direction, and radius of the candidates over the least distance
_MOST, _WIDE = 5, 2.0
# Ratio of the least to the largest spread of points below which the points form a single row
_ROW = 0.2
# Ratio of squared spreads below which the points have no spread in a direction
_FLAT = 1e-12
# Ratio of edges up to which a circle about a place reaches two cells across, and is a circle
_LONG = 4.0
# Share of the largest distance below which a point is at the place
_AT = 1e-6


@collective
def probe(points: MaterialPoints, place: npt.ArrayLike) -> Probe:
    """Follow a place of a body, such as the crest of a slope. Collective.

    The probe chooses the nearest material points, 2^d points or more, and keeps their weights. In
    cells longer than 4:1 distances along the long edge count less. The place is the weighted mean
    of the points' positions. Fields that are linear in the positions have their exact value at the
    place, also at the edge of the body beyond the points. The points do not depend on the number
    of ranks. The probe follows them from rank to rank, and over checkpoints.

    `history.record(crest=crest)` records the displacement of the place, see `History`.

    Args:
        points: Material points of the problem.
        place: Present position (m), shape (gdim,): in the body, or within one cell of a point.

    Raises:
        ParameterError: `points` are no material points, the place is no position, no point is
            near, or the ranks give different places.

    A place between the points:

    >>> import dolfinmpm as mpm
    >>> from mpi4py import MPI
    >>> grid = mpm.create_lattice(MPI.COMM_WORLD, [range(5), range(5)])
    >>> points = mpm.fill(grid, mpm.Box((0, 0), (4, 2)), per_cell=2, density=2000.0)
    >>> V = mpm.Space(grid, "gimp")
    >>> F = mpm.momentum(mpm.materials.Hencky(1e6, 0.3), points, V.increment, V.test)
    >>> crest = mpm.probe(points, (2.0, 2.0))
    >>> down = mpm.fixed(V, "bottom") + mpm.prescribed(V, lambda x: x[1] > 1.5, 1, increment=-0.01)
    >>> record = mpm.QuasiStatic(F, V.increment, points, down).step()
    >>> (crest.displacement.round(4) + 0.0).tolist(), round(crest.settlement, 4)
    ([0.0, -0.01], 0.01)
    """
    return Probe(points, place)


class Probe(Unchanged):
    """A place of a body, and values at the place; made by `probe`.

    `crest["stress"]` is the weighted mean of a field of the points, the same on all ranks.

    Attributes:
        points: The material points.
        place: Position at which the probe was made (m), shape (gdim,).
        weights: Weights of the nearest points, with the sum 1, shape (k,).
    """

    @collective
    def __init__(self, points: MaterialPoints, place: npt.ArrayLike):
        check_points(points)
        self.points = points
        self.place = call_together(points.comm, lambda: vector("place", place, points.gdim, "m"))
        self._find()

    def _find(self) -> None:
        """Choose points and weights. Collective."""
        points, comm = self.points, self.points.comm
        fields, cell, most = points.fields, _longest_edge(points.grid), _MOST**points.gdim
        away = np.linalg.norm(fields.read("x") - self.place, axis=1)
        nearest = comm.allreduce(away.min(initial=np.inf), op=MPI.MIN)
        shape = self._shape(away, nearest)
        distance = np.linalg.norm((fields.read("x") - self.place) / shape, axis=1)
        least = comm.allreduce(distance.min(initial=np.inf), op=MPI.MIN)
        last = np.partition(distance, most - 1)[most - 1] if len(distance) > most else np.inf
        rows = np.flatnonzero(distance <= max(last, _WIDE * least) * (1 + _SAME))
        own = [distance[rows], *(fields.read(name)[rows] for name in ("x", "x0", "id"))]
        d, x, x0, number = (np.concatenate(columns) for columns in zip(*comm.allgather(own)))
        if not nearest <= cell:
            raise ParameterError(
                f"place = {self.place.tolist()} m is {nearest:.3g} m from the next material point, "
                f"at {x[np.argmin(d)].tolist()} m, and may be no further than a cell ({cell:.3g} "
                "m): give a place in the body, or at its edge"
            )
        chosen = _chosen(d, x / shape, least, 2**points.gdim, most)
        # the order must not depend on the number of ranks
        chosen = chosen[np.argsort(keys_of(x0[chosen]))]
        self.weights = _weights((x[chosen] - self.place) / shape)
        self._x0, self._id = x0[chosen], number[chosen]
        self._near = _SAME * cell
        self._seen: tuple[int, int] = -1, points.restored
        self._rows: list[int] = []
        self._slots: list[int] = []

    def _shape(self, away: Array, nearest: float) -> Array:
        """Units of distance that differ by direction in long cells, shape (d,). Collective.

        A circle about the place would take in points of many thin cells, whose fields are not
        linear over so far a way. The units follow the edges of the nearest point's domain.

        Args:
            away: Distances of this rank's points from the place (m).
            nearest: The least distance on all ranks (m).
        """
        fields, comm = self.points.fields, self.points.comm
        rows = np.flatnonzero(away <= nearest * (1 + _SAME))
        own = fields.read("x0")[rows], fields.read("l")[rows]
        x0, half = (np.concatenate(columns) for columns in zip(*comm.allgather(own)))
        if not half.size:
            return np.ones(self.points.gdim)
        # of several equally near points the same on any number of ranks
        one = half[np.argmin(keys_of(x0))]
        if not one.min() > 0.0:
            return np.ones(self.points.gdim)
        return np.asarray(np.minimum(1.0, _LONG * one / one.max()), np.float64)

    def _locate(self) -> None:
        """Find the probe's points on this rank."""
        points = self.points
        seen = points.revision, points.restored
        if seen == self._seen:
            return
        # a checkpoint from another number of ranks has other numbers of points
        by_place = points.restored != self._seen[1]
        ids, x0 = points.fields.read("id"), points.fields.read("x0")
        slots: list[int] = []
        rows: list[int] = []
        for slot, (number, place) in enumerate(zip(self._id, self._x0)):
            if by_place:
                near = np.abs(x0[:, 0] - place[0]) <= self._near
                found = np.flatnonzero(near)
                found = found[(np.abs(x0[found] - place) <= self._near).all(axis=1)]
            else:
                found = np.flatnonzero(ids == number)
            if found.size:
                slots.append(slot)
                rows.append(int(found[0]))
        self._rows, self._slots = rows, slots
        self._seen = points.revision, self._seen[1]

    def _means(self, values: Array) -> Array:
        """Weighted mean of values at this rank's points. Collective.

        Args:
            values: Shape (points on this rank, ...).

        Raises:
            ParameterError: Points of the probe have been removed.
        """
        self._locate()
        comm, k, shape = self.points.comm, len(self._x0), values.shape[1:]
        size = int(np.prod(shape, dtype=int))
        table = np.zeros((k, size + 2))
        table[self._slots, :size] = values[self._rows].reshape(len(self._rows), size)
        table[self._slots, size] = 1.0
        table[self._slots, size + 1] = self.points.fields.read("id")[self._rows]
        # only one rank adds to a row: the sum does not depend on the number of ranks
        comm.Allreduce(MPI.IN_PLACE, table, op=MPI.SUM)
        gone = np.flatnonzero(table[:, size] != 1.0)
        if gone.size:
            raise ParameterError(
                f"{gone.size} of the {k} material points that {self} follows are gone; the first "
                f"of them has the first position {self._x0[gone[0]].tolist()} m. Points have "
                "split or merged, or have been removed: make a new probe"
            )
        self._id = table[:, size + 1].astype(np.int64)
        self._seen = self._seen[0], self.points.restored
        return np.asarray(np.tensordot(self.weights, table[:, :size], 1).reshape(shape))

    @property
    @collective
    def position(self) -> Array:
        """Present position of the place (m), shape (gdim,). Collective."""
        return self._means(self.points.fields.read("x"))

    @property
    @collective
    def displacement(self) -> Array:
        """Total displacement of the place (m), shape (gdim,). Collective."""
        fields = self.points.fields
        return self._means(fields.read("x") - fields.read("x0"))

    @property
    @collective
    def settlement(self) -> float:
        """Total displacement against the last axis (m), positive downwards. Collective."""
        # 0 and not −0 without a displacement
        return 0.0 - float(self.displacement[-1])

    def __iter__(self) -> Iterator[str]:  # `in` and list() would count numbers from 0 without it
        return iter(self.points.fields)

    @collective
    def __getitem__(self, name: str) -> Any:
        """Mean value of a field of the points, with the field's shape. Collective.

        Raises:
            UnknownNameError: The points have no such field.
            FieldShapeError: The field has whole numbers, which have no means.
            ParameterError: Points of the probe have been removed.
        """
        fields = self.points.fields
        if not isinstance(name, str) or name not in fields:
            raise UnknownNameError(
                f"the material points have no field {shown(name)}; they have {', '.join(fields)}"
            )
        values = fields.read(name)
        if values.dtype.kind != "f":
            raise FieldShapeError(f"field '{name}' is of whole numbers, which have no mean value")
        found = self._means(values)
        return found if found.ndim else float(found)

    def __repr__(self) -> str:
        return f"the probe at {self.place.tolist()} m"


@collective
def _longest_edge(grid: Mesh) -> float:
    """Size of the largest cell, or the longest edge on a rectangular grid (m). Collective."""
    edges = cell_edges(grid)
    own = 0.0 if edges is None else edges.x.array.max(initial=0.0)
    return max(largest_cell(grid), grid.comm.allreduce(float(own), op=MPI.MAX))


def _chosen(d: Array, x: Array, least: float, count: int, most: int) -> npt.NDArray[np.intp]:
    """The nearest points that do not form a single row.

    Args:
        d: Distances of the points from the place (m), shape (n,).
        x: Positions of the points in the same units, shape (n, gdim).
        least: The least distance (m). A distant place takes more points, so that weights stay
            small.
        count: Least number of points.
        most: Largest number of points; `count` is used if all points form a row.
    """
    ordered = np.sort(d)
    first: npt.NDArray[np.intp] | None = None
    for k in range(min(count, len(d)), min(most, len(d)) + 1):
        radius = max(ordered[k - 1], _WIDE * least)
        near = np.asarray(np.flatnonzero(d <= radius * (1 + _SAME)), np.intp)
        first = near if first is None else first
        spread = np.linalg.svd(x[near] - x[near].mean(axis=0), compute_uv=False)
        if spread.min(initial=np.inf) > _ROW * spread.max(initial=0.0):
            return near
    assert first is not None
    return first


def _weights(r: Array) -> Array:
    """Weights with the sum 1 and the mean position 0, shape (k,).

    The weights are from least squares, weighted by the inverse square of the distance. At a point,
    the result is therefore the value of the point. In a direction without spread, as across a
    single row, the mean position is the position of the points.

    Args:
        r: Positions of the points relative to the place (m), shape (k, d).
    """
    square = np.sum(r**2, axis=1)
    near = 1.0 / (square / square.max(initial=0.0) + _AT**2) if square.any() else np.ones(len(r))
    share = near / near.sum()
    middle = share @ r
    apart = r - middle
    values, axes = np.linalg.eigh(apart.T @ (share[:, None] * apart))
    kept = values > _FLAT * values.max(initial=0.0)
    slope = axes[:, kept] @ ((axes.T @ -middle)[kept] / values[kept])
    return np.asarray(share * (1.0 + apart @ slope), np.float64)
