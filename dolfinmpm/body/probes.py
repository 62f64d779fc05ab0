"""What a place of a body does: mean values of the material points nearest to it."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm._platform.argumentchecks import shown
from dolfinmpm._platform.collective import collective
from dolfinmpm._platform.errors import (
    FieldShapeError,
    ParameterError,
    UnknownNameError,
    call_together,
)
from dolfinmpm.body.formarguments import check_points
from dolfinmpm.body.markerstate import keys_of
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.grid.lattice import largest_cell

__all__ = ["Probe", "probe"]

Array = npt.NDArray[np.float64]

# Distances are equal to this share, and first positions to this share of a cell
_SAME = 1e-7
# Points are looked at in so many rows a direction, and within so many times the least distance
_MOST, _WIDE = 5, 2.0
# Share of the largest one below which a spread of the points is that of a single row
_ROW = 0.2
# Share of the largest one below which a square of the points' spread counts as none
_FLAT = 1e-12
# Share of the largest distance at which a point is where the place is
_AT = 1e-6


@collective
def probe(points: MaterialPoints, place: npt.ArrayLike) -> Probe:
    """Follow a place of a body, such as the crest of a slope. Collective.

    The material points nearest to the place are chosen now, 2^d of them or more, and keep their
    weights for good: the place is their weighted mean, and a field that is linear in the positions
    has its own value there, also at the edge of the body, beyond the points; at a point the place
    is that point. They are the same on any number of ranks, and are followed wherever they go, from
    rank to rank and over checkpoints.

    `history.record(crest=crest)` records its displacement, see `History`.

    Args:
        points: Material points, those of the problem.
        place: Where it is now (m), shape (gdim,): in the body, or no further from the next point
            than a cell.

    Raises:
        ParameterError: The points are none, the place is no position, no point is near, or the
            ranks give different places.

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
    >>> crest.displacement.round(4).tolist(), round(crest.settlement, 4)
    ([0.0, -0.01], 0.01)
    """
    return Probe(points, place)


class Probe:
    """A place of a body, and what it does; made by `probe`.

    `crest["stress"]` is the mean value of any field of the points, the same on all ranks.

    Attributes:
        points: The material points.
        place: Where it was when the probe was made (m), shape (gdim,).
        weights: Weights of the nearest points, whose sum is 1, shape (k,).
    """

    @collective
    def __init__(self, points: MaterialPoints, place: npt.ArrayLike):
        check_points(points)
        self.points = points
        self.place = _position(points, place)
        self._find()

    def _find(self) -> None:
        """Choose points and weights. Collective."""
        points, comm = self.points, self.points.comm
        fields, cell, most = points.fields, largest_cell(points.grid), _MOST**points.gdim
        distance = np.linalg.norm(fields.read("x") - self.place, axis=1)
        least = comm.allreduce(distance.min(initial=np.inf), op=MPI.MIN)
        last = np.partition(distance, most - 1)[most - 1] if len(distance) > most else np.inf
        rows = np.flatnonzero(distance <= max(last, _WIDE * least) * (1 + _SAME))
        own = [distance[rows], *(fields.read(name)[rows] for name in ("x", "x0", "id"))]
        d, x, x0, number = (np.concatenate(columns) for columns in zip(*comm.allgather(own)))
        if not least <= cell:
            raise ParameterError(
                f"place = {self.place.tolist()} m is {least:.3g} m from the next material point, "
                f"at {x[np.argmin(d)].tolist()} m, and may be no further than a cell ({cell:.3g} "
                "m): give a place in the body, or at its edge"
            )
        chosen = _chosen(d, x, least, 2**points.gdim, most)
        # in an order that does not depend on the ranks
        chosen = chosen[np.argsort(keys_of(x0[chosen]))]
        self.weights = _weights(x[chosen] - self.place)
        self._x0, self._id = x0[chosen], number[chosen]
        self._near = _SAME * cell
        self._seen: tuple[int, int] = -1, points.restored
        self._rows: list[int] = []
        self._slots: list[int] = []

    def _locate(self) -> None:
        """Find which of the points are on this rank."""
        points = self.points
        seen = points.revision, points.restored
        if seen == self._seen:
            return
        # a checkpoint of another number of ranks numbers the points otherwise
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
            ParameterError: Points are gone.
        """
        self._locate()
        comm, k, shape = self.points.comm, len(self._x0), values.shape[1:]
        size = int(np.prod(shape, dtype=int))
        table = np.zeros((k, size + 2))
        table[self._slots, :size] = values[self._rows].reshape(len(self._rows), size)
        table[self._slots, size] = 1.0
        table[self._slots, size + 1] = self.points.fields.read("id")[self._rows]
        # every row is of one rank: no sum depends on how many there are
        comm.Allreduce(MPI.IN_PLACE, table, op=MPI.SUM)
        gone = np.flatnonzero(table[:, size] != 1.0)
        if gone.size:
            raise ParameterError(
                f"{gone.size} of the {k} material points that {self} follows are gone, the first "
                f"was at {self._x0[gone[0]].tolist()} m at first: points have been removed; make a "
                "new probe of those that are left"
            )
        self._id = table[:, size + 1].astype(np.int64)
        self._seen = self._seen[0], self.points.restored
        return np.asarray(np.tensordot(self.weights, table[:, :size], 1).reshape(shape))

    @property
    @collective
    def position(self) -> Array:
        """Where the place is now (m), shape (gdim,). Collective."""
        return self._means(self.points.fields.read("x"))

    @property
    @collective
    def displacement(self) -> Array:
        """How far it has moved since the body was made (m), shape (gdim,). Collective."""
        fields = self.points.fields
        return self._means(fields.read("x") - fields.read("x0"))

    @property
    @collective
    def settlement(self) -> float:
        """How far it has gone down since the body was made, along the last axis (m). Collective."""
        # not −0 of what has not moved
        return 0.0 - float(self.displacement[-1])

    @collective
    def __getitem__(self, name: str) -> Any:
        """Mean value of a field of the points, with the field's shape. Collective.

        Raises:
            UnknownNameError: The points have no such field.
            FieldShapeError: It is of whole numbers, which have no means.
            ParameterError: Points of the place have been removed.
        """
        fields = self.points.fields
        if name not in fields:
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


def _position(points: MaterialPoints, place: Any) -> Array:
    """The place as an array, the same on all ranks. Collective."""

    def checked() -> Array:
        try:
            given = np.asarray(place)
            given = given.astype(float, casting="same_kind")
        except (TypeError, ValueError):
            given = np.empty(0)
        if given.shape != (points.gdim,) or not np.isfinite(given).all():
            raise ParameterError(
                f"place = {shown(place)} must be a position (m), {points.gdim} finite numbers"
            )
        return given

    return call_together(points.comm, checked)


def _chosen(d: Array, x: Array, least: float, count: int, most: int) -> npt.NDArray[np.intp]:
    """Which points tell where the place goes: the nearest ones that do not stand in one row.

    Args:
        d: Distances of the points from the place (m), shape (n,).
        x: The points (m), shape (n, gdim).
        least: The least distance (m): further out more points are taken, or weights were large.
        count: How many points are taken at least.
        most: ... and at most, or `count` if all of them stand in a row.
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
    """Weights whose sum is 1 and whose mean position is the origin, shape (k,).

    Those of least squares over the squares of the distances, so that the value at a point is its
    own. Across directions in which the points do not differ, as those of a single row, the mean
    position is theirs.

    Args:
        r: Positions of the points from the place (m), shape (k, d).
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
