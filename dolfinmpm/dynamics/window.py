"""Window of fused loops: nodes of the lattice around a rank's cells, and the cells of points."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numba
import numpy as np
import numpy.typing as npt
from dolfinx.la import InsertMode
from mpi4py import MPI

from dolfinmpm.basis import LatticeBasis
from dolfinmpm.basis.bspline import greville
from dolfinmpm.body.loadbalance import balance
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.cut.cellaverages import numbering
from dolfinmpm.cut.essentialconditions import EssentialConditions
from dolfinmpm.dynamics.clock import set_velocities
from dolfinmpm.dynamics.facesatnodes import Faces, Sides
from dolfinmpm.dynamics.nodes import take_means
from dolfinmpm.dynamics.passes import COLUMNS
from dolfinmpm.dynamics.transfer import collect
from dolfinmpm.grid.halo import Numbering
from dolfinmpm.kinematics.heldsides import held_sides

__all__ = ["MARGIN", "Exchange", "Prescribed", "Window", "WindowMeans"]


@numba.njit(cache=True, error_model="numpy")
def _cells(x, lines, start, scale, origin, table, shape, cell):
    """Find local cells of the points; returns the number of points without a known cell."""
    lost = 0
    d = x.shape[1]
    for p in range(x.shape[0]):
        at = 0
        for k in range(d):
            number = start[k + 1] - start[k] - 1
            i = min(max(int((x[p, k] - lines[start[k]]) * scale[k]), 0), number - 1) - origin[k]
            if i < 0 or i >= shape[k]:
                at = -1
                break
            at = at * shape[k] + i
        found = table[at] if at >= 0 else -1
        cell[p] = found
        if found < 0:
            lost += 1
    return lost


@numba.njit(cache=True, error_model="numpy")
def extent(values):
    """Smallest and largest value of each column, shape (2, columns), of at least one row."""
    found = np.empty((2, values.shape[1]))
    for k in range(values.shape[1]):
        low = high = values[0, k]
        for p in range(values.shape[0]):
            low, high = min(low, values[p, k]), max(high, values[p, k])
        found[0, k], found[1, k] = low, high
    return found


# Steps after which points are sorted by cells again
_SORT = 256


class CellFinder:
    """Cells of points by their positions.

    Args:
        basis: Basis on the lattice. Its overlap of ranks gives the known cells.

    Attributes:
        steps: Steps since the last sorting of the points.
    """

    def __init__(self, basis: LatticeBasis):
        lines, halo = basis.lattice.lines, basis.halo
        self.steps = _SORT
        self._lines, self._origin = lines, halo.origin
        self._flat = np.concatenate(lines)
        self._starts = np.cumsum([0] + [line.size for line in lines])
        self._scale = np.array([(x.size - 1) / (x[-1] - x[0]) for x in lines])
        self._table = halo.cell_table.ravel()
        self._shape = np.array(halo.cell_table.shape, np.int64)
        self._owned = basis.cells.owned

    def sort(self, points: MaterialPoints) -> None:
        """Sort the points by cells, if a sorting is due. Collective."""
        if self.steps < _SORT:
            return
        self.steps = 0
        key = np.zeros(len(points), np.int64)
        for k, line in enumerate(self._lines):
            i = ((points["x"][:, k] - line[0]) * self._scale[k]).astype(np.int64)
            key = key * line.size + i
        # a revision is common to all ranks, because operations after it are collective
        if points.comm.allreduce(bool(np.all(np.diff(key) >= 0)), op=MPI.LAND):
            return
        order = np.argsort(key, kind="stable")
        for name, values in points.fields.items():
            points.fields[name] = values[order]
        points.revision += 1

    def update(self, points: MaterialPoints) -> int:
        """Update cells and ranks of the points; returns how many changed rank. Collective."""
        lost = _cells(
            points["x"], self._flat, self._starts, self._scale, self._origin, self._table,
            self._shape, points["cell"],
        )  # fmt: skip
        if points.comm.size == 1:
            points.note_places()
            return 0
        away = lost > 0 or bool(np.any(points["cell"] >= self._owned))
        if points.partition is not None:
            # these were numbers in the old overlap of ranks
            points["cell"][:] = -1
        if not points.comm.allreduce(away, op=MPI.LOR):
            points.note_places()
            return 0
        points["cell"][points["cell"] < 0] = 0
        return points.locate() + balance(points)


Array = npt.NDArray[np.float64]
Places = npt.NDArray[np.intp]

# Layers of cells around this rank's cells that points may enter before they change rank
MARGIN = 2


class Window:
    """The nodes that points of this rank may reach, with their motion and sums. Collective.

    Args:
        points: Material points.
        basis: Basis of the displacement, on a lattice.
        sides: Sides of the grid that act on the body.

    Attributes:
        basis: The basis, with the overlap of ranks needed by the window.
        nodes, out: Motion of the nodes, and sums over points, shape (nodes, columns), see
            `dolfinmpm.dynamics.passes.Columns`.
        own: Mask of the nodes whose work this rank counts, shape (nodes,).
        place: Number in the window of each node of the basis, or -1, shape (nodes of the basis,).
        grid: Data of lattice and window for the loops over points.
        sides: Friction and dashpots at sides of the grid, see `Faces.by_nodes`.
        cells: Finder of the points' cells.
    """

    def __init__(self, points: MaterialPoints, basis: LatticeBasis, sides: Sides):
        layers, _ = basis.reach(points.placement())
        basis = basis.grown(max(layers, 1) + MARGIN, points.partition)
        halo, lattice = basis.halo, basis.lattice
        self.basis = basis
        self._shape = np.array(halo.node_table.shape, np.int64)
        width = COLUMNS[points.gdim].width
        self.nodes, self.out = (np.zeros((int(np.prod(self._shape)), width)) for _ in range(2))
        self._known, self._at = self.places(halo.node_ijk)
        self.own = np.zeros(len(self.nodes), np.bool_)
        self.own[self._at] = self._known < basis.nodes.owned
        self._exchange = self.exchange(width)
        self._first, self._last = np.zeros(points.gdim, np.int64), self._shape.copy()
        self.grid = (
            tuple(lattice.lines),
            tuple(np.ascontiguousarray(greville(line, basis.degree)) for line in lattice.lines),
            lattice.uniform, halo.origin.astype(np.int64), self._shape, self._first, self._last,
            np.array([1.0 / np.diff(line).min() for line in lattice.lines]),
            np.zeros((points.gdim, 2), np.bool_),
        )  # fmt: skip
        self.place = np.full(basis.nodes.size, -1)
        self.place[self._known] = self._at
        self._faces = sides.on(basis) or Faces((), basis, points.gdim)
        self.sides = self._faces.by_nodes(self.place, len(self.nodes))
        self.cells = CellFinder(basis)

    def on_sides(self) -> list[list[Places]]:
        """Nodes on the two sides of the grid across each axis, by numbers in the window."""
        at, first = np.unravel_index(self._at, tuple(self._shape)), self.basis.halo.origin
        ends = [(0, len(x) - 1) for x in self.grid[1]]
        return [[self._at[i + f == e] for e in pair] for i, f, pair in zip(at, first, ends)]

    def exchange(self, width: int) -> Exchange | None:
        """Exchange of sums at the window's nodes between ranks; None on one rank. Collective.

        Args:
            width: Number of columns of the sums.
        """
        nodes = self.basis.nodes
        if self.basis.grid.comm.size == 1:
            return None
        return Exchange(nodes, self._known, self._at, width)

    def places(self, ijk: npt.NDArray[Any]) -> tuple[Places, Places]:
        """Numbers in the window of positions in the lattice.

        Args:
            ijk: Positions, shape (n, d).

        Returns:
            The positions inside the window, and their numbers in the window.
        """
        ijk = ijk - self.basis.halo.origin
        inside = np.all((ijk >= 0) & (ijk < self._shape), axis=1)
        return np.flatnonzero(inside), np.ravel_multi_index(
            tuple(ijk[inside].T), tuple(self._shape)
        )

    def cover(self, points: MaterialPoints) -> None:
        """Give dashpots to what the body covers of absorbing sides. Collective."""
        if self._faces.cover(points):
            known = self.place >= 0
            assert self._faces.dashpots is not None
            self.sides[2][self.place[known]] = self._faces.dashpots[known]

    def box(self, points: MaterialPoints) -> None:
        """Find the nodes that points may reach before they change rank, see `MARGIN`."""
        basis = self.basis
        if self._exchange is not None:
            # sums of other ranks must be cleared, too, and the work at every node counted
            return
        if not len(points):
            self._first[:], self._last[:] = 0, 0
            return
        origin = basis.halo.origin
        ends = extent(points.fields.read("x"))
        half = extent(points.fields.read("l"))[1] if basis.averaged else np.zeros(points.gdim)
        ends += np.array([-half, half])
        for k, line in enumerate(basis.lattice.lines):
            i = np.searchsorted(line, ends[:, k], side="right") - 1 - origin[k]
            self._first[k] = min(max(i[0] - MARGIN, 0), self._shape[k])
            self._last[k] = min(max(i[1] + basis.degree + 1 + MARGIN, 0), self._shape[k])

    def rows(self) -> tuple[int, ...]:
        """Nodes in use: first and last row, first and last node in a row, and length of a row."""
        row, across = int(self._shape[-1]), 1 if len(self._shape) == 2 else int(self._shape[1])
        rows = int(self._first[0]) * across, int(self._last[0]) * across
        return *rows, int(self._first[-1]), int(self._last[-1]), row

    def add_up(self, begin: int = 0, end: int | None = None) -> None:
        """Add up columns of the sums over ranks; all ranks of a node get the sums. Collective."""
        if self._exchange is not None:
            self._exchange.add_up(self.out, begin, end)

    def from_basis(self, values: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """Values at the window's nodes, from values at the basis's nodes; zeros elsewhere."""
        found = np.zeros((len(self.nodes), *values.shape[1:]), values.dtype)
        found[self._at] = values[self._known]
        return found

    def at_points(self, values: Array, points: MaterialPoints) -> Array:
        """Interpolate values at the window's nodes, shape (nodes, d), at the points."""
        known = np.zeros((self.basis.nodes.size, values.shape[1]))
        known[self._known] = values[self._at]
        return collect(self.basis.stencils(points.placement()), known)


class WindowMeans:
    """Means of volume changes over cells, stored by position in the window. Collective.

    Args:
        window: The window.

    Attributes:
        sums: Volumes and volumes times a change, or the mean change, shape (nodes, 2).
    """

    def __init__(self, window: Window):
        own, ijk = numbering(window.basis)
        known, at = window.places(ijk)
        self.sums = np.zeros((len(window.nodes), 2))
        self._exchange = Exchange(own, known, at, 2) if own.comm.size > 1 else None

    def take(self, rows: tuple[int, ...]) -> None:
        """Replace this rank's sums over points by means. Collective."""
        if self._exchange is not None:
            self._exchange.add_up(self.sums)
        take_means(rows, self.sums)


class Prescribed:
    """Prescribed velocities of the nodes of a window.

    Args:
        conditions: Essential conditions.

    Attributes:
        fixed: Mask of the prescribed components, shape (nodes, d).
        before, after: Prescribed velocities at the start and at the end of a step (m/s), shape
            (nodes, d).
    """

    fixed: npt.NDArray[np.bool_]
    before: Array
    after: Array

    _values: Array
    _window: Window | None
    _rate: float

    def __init__(self, conditions: EssentialConditions):
        self._conditions, self._window = conditions, None
        # last mask, values and rate
        self._known: tuple[Any, ...] = (None, None, math.nan)
        # present values of velocities prescribed as functions of time
        self._driven: Sequence[float] | None = None

    @property
    def driven(self) -> bool:
        """Whether some prescribed velocities are functions of time."""
        return self._driven is not None

    def start(self, window: Window, rate: float) -> None:
        """Set velocities by the present prescribed increments. Collective.

        Args:
            window: The window.
            rate: Prescribed velocities over prescribed increments (1/s).
        """
        if window is not self._window:
            self._window, self._known = window, (None, None, math.nan)
            self._on_sides = window.on_sides()
        self._rate, self._driven = rate, None
        self._take()

    def _take(self) -> None:
        window, (known, old, rate) = self._window, self._known
        assert window is not None
        (fixed,), (values,) = self._conditions.at([window.basis], 1.0)
        # the mask, and values that never change, keep their arrays while they are valid
        if fixed is not known:
            self.fixed = window.from_basis(fixed)
        same = values is old and (rate == self._rate or not self._conditions.changing)
        if not same:
            self._values = self._rate * window.from_basis(values)
        comm = window.basis.grid.comm
        # for the loops: sides that do not move keep the points inside
        window.grid[-1][...] = held_sides(self.fixed, self._values, self._on_sides, comm)
        self.before = self.after = self._values
        self._known = fixed, values, self._rate

    def drive(self, before: float, after: float) -> None:
        """Set velocities that are functions of time. Collective.

        Args:
            before, after: Middle of the last step, and of this step (s).
        """
        conditions = self._conditions.conditions
        driven = [c.velocity for c in conditions if c.velocity is not None]
        if not driven:
            return
        wanted = [v(before) for v in driven], [v(after) for v in driven]
        if self._driven is None or self._driven != wanted[0]:
            set_velocities(conditions, lambda v: v(before) / self._rate)
            self._take()
        self.before = self.after
        if wanted[1] != wanted[0]:
            set_velocities(conditions, lambda v: v(after) / self._rate)
            start = self.before
            self._take()
            self.before = start
        self._driven = wanted[1]


class Exchange:
    """Exchange of sums at a window's nodes between ranks. Collective.

    Ranks exchange only the sums at nodes that they share.

    Args:
        nodes: Numbering of the nodes.
        known, at: The nodes in the window, and their numbers in the window.
        width: Number of columns of the sums.
    """

    def __init__(self, nodes: Numbering, known: Places, at: Places, width: int):
        marks = nodes.vector()
        marks.array[:] = 0.0
        marks.array[nodes.owned :] = 1.0
        marks.scatter_reverse(InsertMode.add)
        shared = marks.array > 0.0
        self._all = np.flatnonzero(shared)
        self._rows, self._at = known[shared[known]], at[shared[known]]
        self._vector = nodes.vector(width)

    def add_up(self, sums: Array, begin: int = 0, end: int | None = None) -> None:
        """Add up columns over ranks; all ranks of a node get the sums. Collective."""
        values = self._vector.array.reshape(-1, sums.shape[1])
        values[self._all] = 0.0
        values[self._rows, begin:end] = sums[self._at, begin:end]
        self._vector.scatter_reverse(InsertMode.add)
        self._vector.scatter_forward()
        sums[self._at, begin:end] = values[self._rows, begin:end]
