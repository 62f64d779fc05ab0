"""Explicit steps on rectangular grids by fused loops, for the forms that they know.

A form of momentum terms and loads on a lattice needs no stencils, no activation and no form
assembly: one loop takes the nodes' motion to each point, strains and moves it, and scatters its
mass, momentum and forces to the nodes where it is then. Nodes are kept in a window of the lattice
around this rank's cells, by their position.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
import numpy.typing as npt
from dolfinx.la import InsertMode
from mpi4py import MPI

from dolfinmpm.basis import LatticeBasis
from dolfinmpm.basis.bspline import greville
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.cut.held import Held
from dolfinmpm.dynamics.fusable import Laws, Loads
from dolfinmpm.dynamics.mappings import Mapping
from dolfinmpm.dynamics.mass import point_masses
from dolfinmpm.dynamics.passes import PASSES, Pass

__all__ = ["Fused"]

Array = npt.NDArray[np.float64]

# Layers of cells that points may wander beyond this rank's own before they are handed on
_MARGIN = 2
# Steps after which points are put in the order of cells again
_SORT = 256


@numba.njit(cache=True, error_model="numpy")
def _move_nodes(first, last, row, out, nodes, fixed, held, g, dt, scaling, damping, known, done):
    """Accelerate the nodes of a box; known tells whether velocities have been set before."""
    d = fixed.shape[1]
    for block in range(first[0], last[0]):
        for at in range(first[1], last[1]):
            k = block * row + at
            m = out[k, 0]
            for i in range(d):
                y = 0.0
                a = 0.0
                if m > 0.0:
                    y = out[k, 1 + i] / m
                    f = out[k, 1 + d + i]
                    if damping > 0.0:
                        f -= damping * abs(f) * np.sign(y)
                    a = f / (scaling * m)
                end = y + dt * a
                if fixed[k, i]:
                    # what holds the node does work on it
                    done[1] += scaling * m * (held[k, i] - end) * held[k, i]
                    y = end = held[k, i]
                nodes[k, i] = end
                nodes[k, d + i] = end - y
                if not known:
                    nodes[k, 2 * d + i] = end
                done[1] += dt * m * g[i] * end


@numba.njit(cache=True, error_model="numpy")
def _divide(first, last, row, out, column, nodes, fixed, held):
    """Velocities for the strain from momenta."""
    d = fixed.shape[1]
    for block in range(first[0], last[0]):
        for at in range(first[1], last[1]):
            k = block * row + at
            m = out[k, 0]
            for i in range(d):
                y = out[k, column + i] / m if m > 0.0 else 0.0
                nodes[k, 2 * d + i] = held[k, i] if fixed[k, i] else y


@numba.njit(cache=True, error_model="numpy")
def _clear(first, last, row, out, begin, end):
    for block in range(first[0], last[0]):
        for at in range(first[1], last[1]):
            for i in range(begin, end):
                out[block * row + at, i] = 0.0


@numba.njit(cache=True, error_model="numpy")
def _cells(x, lines, start, scale, origin, table, shape, cell):
    """Local cells of the points; the number of those whose cell is not known here."""
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


class Fused:
    """The fused loops of a problem.

    Args:
        points: Material points.
        basis: Basis of the displacement, on a lattice.
        held: Essential conditions.
        laws: The laws of the form.
        loads: Its loads.
        scheme: "usl", "usf" or "musl".
        mapping: "flip", "pic", "apic" or "tpic".
        scaling: Factor of the mass in the inertia.
        damping: Share of local damping.

    Attributes:
        done: Work of the stresses, and of loads and prescribed motions, so far (J).
    """

    def __init__(
        self,
        points: MaterialPoints,
        basis: LatticeBasis,
        held: Held,
        laws: Laws,
        loads: Loads,
        scheme: str,
        mapping: Mapping,
        scaling: float,
        damping: float,
    ):
        self._points, self._held, self._laws, self._loads = points, held, laws, loads
        self._scheme, self._mapping = scheme, mapping
        self._scaling, self._damping = scaling, damping
        self.done = np.zeros(2)
        self._basis = basis
        self._window: Any = None
        self._steps_since_sorted = _SORT
        self._share = {"flip": mapping.share}.get(mapping.kind, 0.0)
        self._affine = {"apic": 1, "tpic": 2}.get(mapping.kind, 0)

    def work(self) -> tuple[float, float]:
        """Work of the stresses, and of loads and prescribed motions, so far (J). Collective."""
        internal, external = self._points.comm.allreduce(self.done, op=MPI.SUM)
        return float(internal), float(external)

    # -- the window -------------------------------------------------------------

    def _build(self) -> None:
        """The window of nodes around this rank's cells. Collective."""
        points, d = self._points, self._points.gdim
        layers, _ = self._basis.reach(points.placement())
        basis = self._basis.grown(max(layers, 1) + _MARGIN)
        halo, lattice = basis.halo, basis.lattice
        shape = np.array(halo.node_table.shape, np.int64)
        self._shape = shape
        size = int(np.prod(shape))
        self._nodes, self._out = np.zeros((size, 3 * d)), np.zeros((size, 1 + 3 * d))
        ijk = halo.node_ijk - halo.origin
        inside = np.all((ijk >= 0) & (ijk < shape), axis=1)
        self._known = np.flatnonzero(inside)
        self._at = np.ravel_multi_index(tuple(ijk[inside].T), tuple(shape))
        self._vector = basis.nodes.vector(1 + 3 * d) if points.comm.size > 1 else None
        self._window = basis
        self._grid = (
            *lattice.lines,
            *(np.ascontiguousarray(greville(line, basis.degree)) for line in lattice.lines),
            lattice.uniform, halo.origin.astype(np.int64), shape,
        )  # fmt: skip
        self._lines = np.concatenate(lattice.lines)
        self._starts = np.cumsum([0] + [line.size for line in lattice.lines])
        self._scale = np.array([(x.size - 1) / (x[-1] - x[0]) for x in lattice.lines])
        self._table = halo.cell_table.ravel()
        self._table_shape = np.array(halo.cell_table.shape, np.int64)
        self._first, self._last = np.zeros(d, np.int64), shape.copy()

    def _box(self) -> None:
        """Nodes that points may reach now and until they are sorted again."""
        points, basis = self._points, self._window
        x, origin = points["x"], basis.halo.origin
        if not len(points):
            self._first[:], self._last[:] = 0, 0
            return
        half = points["l"].max(axis=0) if basis.averaged else np.zeros(points.gdim)
        for k, line in enumerate(basis.lattice.lines):
            low, high = x[:, k].min() - half[k], x[:, k].max() + half[k]
            i = np.searchsorted(line, [low, high], side="right") - 1 - origin[k]
            self._first[k] = min(max(i[0] - 1, 0), self._shape[k])
            self._last[k] = min(max(i[1] + basis.degree + 2, 0), self._shape[k])

    def _flags(self, rate: float) -> None:
        """What is held, and at which velocities, in the window. Collective."""
        fixed, values = self._held.at([self._window], 1.0)
        d = self._points.gdim
        self._fixed = np.zeros((len(self._nodes), d), np.bool_)
        self._speed = np.zeros((len(self._nodes), d))
        self._fixed[self._at] = fixed[0][self._known]
        self._speed[self._at] = rate * values[0][self._known]

    def _sort(self) -> None:
        """Put the points in the order of the cells. Collective."""
        points = self._points
        if self._steps_since_sorted < _SORT:
            return
        self._steps_since_sorted = 0
        scale, lines = self._scale, self._window.lattice.lines
        key = np.zeros(len(points), np.int64)
        for k, line in enumerate(lines):
            i = ((points["x"][:, k] - line[0]) * scale[k]).astype(np.int64)
            key = key * line.size + i
        # a revision is of all ranks: what follows from it is collective
        if points.comm.allreduce(bool(np.all(np.diff(key) >= 0)), op=MPI.LAND):
            return
        order = np.argsort(key, kind="stable")
        for name, values in points.fields.items():
            points.fields[name] = values[order]
        points.revision += 1

    # -- steps ------------------------------------------------------------------

    def run(self, count: int, dt: float, rate: float, set_time) -> tuple[int, int, str | None]:
        """Take equal steps. Collective.

        Args:
            count: How many.
            dt: Their length (s).
            rate: Prescribed velocities over prescribed increments (1/s).
            set_time: Tells the form how many of the steps have been taken.

        Returns:
            Steps taken, points that changed rank, and why it ended before the last, or None.
        """
        if self._window is None:
            self._build()
        self._sort()
        self._flags(rate)
        migrated, reason, taken = 0, None, 0
        passes = [*PASSES[self._scheme]]
        # the first scatter of a call stands alone, and so do the last steps of each point
        *others, main = passes
        ending = main._replace(new=0)
        begin = Pass(new=2 if self._scheme != "usf" else 1)
        fresh, travelled = True, 0.0
        while taken < count and reason is None:
            if fresh:
                self._box()
                self._prepare()
                reason = self._scatter(begin, dt)
                fresh = False
            set_time(taken)
            # what scatters in the last step of a call would only be scattered again
            travelled += self._reach(dt)
            last = taken == count - 1 or travelled > 0.5 * _MARGIN
            if reason is None:
                reason = self._step(others, ending if last else main, dt, taken == count - 1)
            taken += 1
            if last and reason is None:
                migrated += self._settle()
                fresh, travelled = True, 0.0
        self._steps_since_sorted += taken
        return taken, migrated, reason

    def _reach(self, dt: float) -> float:
        """Cells that the fastest node crosses in a step, at most, on any rank. Collective."""
        if self._points.comm.size == 1:
            d = self._points.gdim
            speed = self._nodes[:, :d]
            return float(np.abs(speed * self._scale).max(initial=0.0)) * dt
        d = self._points.gdim
        local = float(np.abs(self._nodes[:, :d] * self._scale).max(initial=0.0)) * dt
        return self._points.comm.allreduce(local, op=MPI.MAX)

    def _prepare(self) -> None:
        """Arrays of the points as the loops take them; anew when points have come or gone."""
        points = self._points
        d = points.gdim
        n = len(points)
        C = points["velocity_gradient"] if self._affine else np.empty((n, d, d))
        self._laws.gather()
        state = points[self._laws.state] if self._laws.state else np.empty((n, 6))
        self._loads.evaluate()
        self._rows_of = np.arange(n, dtype=np.int32), np.empty((2, n), np.int32)
        body = self._loads.body
        self._data = (
            points["x"], points["l"], points["l0"], points["velocity"], C, points["F"],
            points["V"], points["V0"], point_masses(points), state, self._laws.internal,
            points["stress"], body, points["acceleration"],
        )  # fmt: skip

    def _pass(self, parts: Pass, dt: float) -> str | None:
        """One pass over the points; why it ended early, or None. Collective."""
        points, basis = self._points, self._window
        general = not basis.lattice.uniform or (basis.averaged and basis.degree > 1)
        bad = -1
        if len(points):
            rows, skipped = self._rows_of
            left = len(points)
            if not general:
                bad, left, behind = self._loop(parts, dt, rows, False)
                if bad < 0 and behind:
                    bad, *_ = self._loop(Pass(new=parts.new), dt, skipped[1, :behind].copy(), True)
                rows = skipped[0]
            if bad < 0 and left:
                bad, *_ = self._loop(parts, dt, rows[:left].copy(), True)
        return self._together(bad)

    def _loop(self, parts: Pass, dt: float, rows, general: bool) -> tuple[int, int, int]:
        basis, laws = self._window, self._laws
        loop = laws.kernel(self._points.gdim)(
            basis.degree, basis.averaged, laws.kind, self._affine, parts, general
        )
        return loop(
            self._grid, self._nodes, self._out, self._data, laws.table, dt, self._share, rows,
            self._rows_of[1], self.done,
        )  # fmt: skip

    def _together(self, bad: int) -> str | None:
        points = self._points
        found = None
        if bad >= 0:
            found = (
                f"point {points['id'][bad]} at {points['x'][bad]} m has no stress, no volume or "
                f"has left the grid (det F = {np.linalg.det(points['F'][bad]):.4g})"
            )
        if points.comm.size == 1:
            return found
        all_found = [text for text in points.comm.allgather(found) if text is not None]
        return all_found[0] if all_found else None

    def _exchange(self, begin: int, end: int) -> None:
        """Add up columns of the sums over ranks, for all that know the nodes. Collective."""
        if self._vector is None:
            return
        vector, width = self._vector, self._out.shape[1]
        values = vector.array.reshape(-1, width)
        values[:] = 0.0
        values[self._known, begin:end] = self._out[self._at, begin:end]
        vector.scatter_reverse(InsertMode.add)
        vector.scatter_forward()
        self._out[self._at, begin:end] = values[self._known, begin:end]

    def _scatter(self, parts: Pass, dt: float) -> str | None:
        self._wipe(0, self._out.shape[1])
        reason = self._pass(parts, dt)
        self._exchange(0, self._out.shape[1])
        return reason

    def _wipe(self, begin: int, end: int) -> None:
        self._out[:, begin:end] = 0.0

    def _step(self, others, main: Pass, dt: float, record: bool) -> str | None:
        """One step from what has been scattered. Collective."""
        d = self._points.gdim
        first, last, row = np.zeros(2, np.int64), np.ones(2, np.int64), 0
        # the window as rows of its last direction
        first[0], last[0], row = self._rows()
        first[1], last[1] = self._first[-1], self._last[-1]
        box = first, last, row
        held = self._fixed, self._speed
        g = self._loads.gravity
        rest = self._scaling, self._damping
        if self._scheme == "usf":
            _divide(*box, self._out, 1, self._nodes, *held)
            reason = self._pass(others[0], dt)
            self._exchange(1 + d, 1 + 2 * d)
            if reason is not None:
                return reason
            _move_nodes(*box, self._out, self._nodes, *held, g, dt, *rest, True, self.done)
        else:
            _move_nodes(*box, self._out, self._nodes, *held, g, dt, *rest, False, self.done)
            if self._scheme == "musl":
                reason = self._pass(others[0]._replace(record=record), dt)
                self._exchange(1 + 2 * d, 1 + 3 * d)
                if reason is not None:
                    return reason
                _divide(*box, self._out, 1 + 2 * d, self._nodes, *held)
        self._wipe(0, self._out.shape[1])
        if main.velocity:
            main = main._replace(record=record)
        reason = self._pass(main, dt)
        if main.new:
            self._exchange(0, self._out.shape[1])
        return reason

    def _rows(self) -> tuple[int, int, int]:
        """First and last row of nodes in use, and the length of a row."""
        row = int(self._shape[-1])
        if self._points.gdim == 2:
            return int(self._first[0]), int(self._last[0]), row
        plane = int(self._shape[1])
        return int(self._first[0]) * plane, int(self._last[0]) * plane, row

    def _settle(self) -> int:
        """Cells and ranks of the points where they are now. Collective."""
        points = self._points
        self._laws.scatter()
        halo = self._window.halo
        lost = _cells(
            points["x"], self._lines, self._starts, self._scale, halo.origin, self._table,
            self._table_shape, points["cell"],
        )  # fmt: skip
        if points.comm.size == 1:
            points._located = points["x"].sum()
            return 0
        owned = points.grid.topology.index_map(points.gdim).size_local
        away = lost > 0 or bool(np.any(points["cell"] >= owned))
        if not points.comm.allreduce(away, op=MPI.LOR):
            points._located = points["x"].sum()
            return 0
        points["cell"][points["cell"] < 0] = 0
        return points.locate()
