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
from dolfinmpm.dynamics.passes import COLUMNS, FAST, PASSES, SMALL, Pass

__all__ = ["Fused"]

Array = npt.NDArray[np.float64]

# Layers of cells that points may wander beyond this rank's own before they are handed on
_MARGIN = 2
# Steps after which points are put in the order of cells again
_SORT = 256
# Rows and columns of a symmetric tensor, in the order in which the loops take its components
_PAIRS = {2: ([0, 1, 0], [0, 1, 1]), 3: ([0, 1, 2, 0, 1, 0], [0, 1, 2, 1, 2, 2])}


@numba.njit(cache=True, error_model="numpy", fastmath=FAST)
def _move_nodes(
    box, columns, out, nodes, own, fixed, held, g, dt, scaling, damping, known, last, done
):
    """Accelerate the nodes of a box.

    Args:
        own: Whose work this rank counts.
        known: Whether velocities for the strain have been set before.
        last: Whether the sums are done with, and cleared.
    """
    _, mass, force, _, velocity, strain = columns
    d = fixed.shape[1]
    work = 0.0
    for block in range(box[0], box[1]):
        for k in range(block * box[4] + box[2], block * box[4] + box[3]):
            m = out[k, mass]
            per_mass = 1.0 / m if m > 0.0 else 0.0
            for i in range(d):
                y = out[k, i] * per_mass
                f = out[k, force + i] + m * g[i]
                if damping > 0.0:
                    f -= damping * abs(f) * np.sign(held[k, i] if fixed[k, i] else y)
                end = y + dt * f * per_mass / scaling
                if fixed[k, i]:
                    if own[k]:
                        # what holds the node does work against its forces
                        work -= dt * f * held[k, i]
                    y = end = held[k, i]
                nodes[k, i] = end - y
                nodes[k, velocity + i] = end
                if not known:
                    nodes[k, strain + i] = end
                if own[k]:
                    work += dt * m * g[i] * end
            if last:
                for i in range(out.shape[1]):
                    out[k, i] = 0.0
    done[1] += work


@numba.njit(cache=True, error_model="numpy", fastmath=FAST)
def _divide(box, columns, out, momentum, nodes, fixed, held, last):
    """Velocities for the strain from momenta; the sums are cleared if they are done with."""
    for block in range(box[0], box[1]):
        for k in range(block * box[4] + box[2], block * box[4] + box[3]):
            m = out[k, columns[1]]
            per_mass = 1.0 / m if m > 0.0 else 0.0
            for i in range(fixed.shape[1]):
                y = out[k, momentum + i] * per_mass
                nodes[k, columns[5] + i] = held[k, i] if fixed[k, i] else y
            if last:
                for i in range(out.shape[1]):
                    out[k, i] = 0.0


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
        # and the cells that the fastest point has crossed in a step
        self.done = np.zeros(3)
        self._columns = COLUMNS[points.gdim]
        self._live, self._travelled = False, 0.0
        self._basis = basis
        self._window: Any = None
        self._steps_since_sorted = _SORT
        self._share = {"flip": mapping.share}.get(mapping.kind, 0.0)
        self._affine = {"apic": 1, "tpic": 2}.get(mapping.kind, 0)

    def work(self) -> tuple[float, float]:
        """Work of the stresses, and of loads and prescribed motions, so far (J). Collective."""
        internal, external = self._points.comm.allreduce(self.done[:2], op=MPI.SUM)
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
        self._nodes, self._out = (np.zeros((size, self._columns.width)) for _ in range(2))
        ijk = halo.node_ijk - halo.origin
        inside = np.all((ijk >= 0) & (ijk < shape), axis=1)
        self._known = np.flatnonzero(inside)
        self._at = np.ravel_multi_index(tuple(ijk[inside].T), tuple(shape))
        self._own = np.zeros(size, np.bool_)
        self._own[self._at] = np.flatnonzero(inside) < basis.nodes.owned
        self._vector = basis.nodes.vector(self._columns.width) if points.comm.size > 1 else None
        self._window = basis
        self._first, self._last = np.zeros(d, np.int64), shape.copy()
        self._grid = (
            *lattice.lines,
            *(np.ascontiguousarray(greville(line, basis.degree)) for line in lattice.lines),
            lattice.uniform, halo.origin.astype(np.int64), shape, self._first, self._last,
            np.array([1.0 / np.diff(line).min() for line in lattice.lines]),
        )  # fmt: skip
        self._lines = np.concatenate(lattice.lines)
        self._starts = np.cumsum([0] + [line.size for line in lattice.lines])
        self._scale = np.array([(x.size - 1) / (x[-1] - x[0]) for x in lattice.lines])
        self._table = halo.cell_table.ravel()
        self._table_shape = np.array(halo.cell_table.shape, np.int64)

    def _box(self) -> None:
        """Nodes that points may reach until they are given to ranks again: see `_MARGIN`."""
        points, basis = self._points, self._window
        x, origin = points["x"], basis.halo.origin
        if self._vector is not None:
            # sums of other ranks too must be cleared, and the work at every node counted
            return
        if not len(points):
            self._first[:], self._last[:] = 0, 0
            return
        half = points["l"].max(axis=0) if basis.averaged else np.zeros(points.gdim)
        for k, line in enumerate(basis.lattice.lines):
            low, high = x[:, k].min() - half[k], x[:, k].max() + half[k]
            i = np.searchsorted(line, [low, high], side="right") - 1 - origin[k]
            self._first[k] = min(max(i[0] - _MARGIN, 0), self._shape[k])
            self._last[k] = min(max(i[1] + basis.degree + 1 + _MARGIN, 0), self._shape[k])

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

    def start(self, rate: float) -> None:
        """Take the points as they are now, before steps that follow each other. Collective.

        Args:
            rate: Prescribed velocities over prescribed increments (1/s).
        """
        if self._window is None:
            self._build()
        self._sort()
        self._flags(rate)
        self._live = False

    def run(self, count: int, dt: float, more: bool, set_time) -> tuple[int, int, str | None]:
        """Take equal steps. Collective.

        Args:
            count: How many.
            dt: Their length (s).
            more: Whether others follow without a new start.
            set_time: Tells the form how many of the steps have been taken.

        Returns:
            Steps taken, points that changed rank, and why it ended before the last, or None.
        """
        migrated, reason, taken = 0, None, 0
        *others, main = PASSES[self._scheme]
        begin = Pass(new=2 if self._scheme != "usf" else 1)
        while taken < count and reason is None:
            set_time(taken)
            fresh = not self._live
            if fresh:
                self._box()
                self._prepare()
                self._live, self._travelled = True, 0.0
            elif self._loads.changed():
                # what has been scattered has the loads of before if they differ by points
                fresh = not self._loads.uniform
                self._loads.evaluate()
                fresh = fresh or not self._loads.uniform
            if fresh:
                reason = self._scatter(begin, dt)
            taken += 1
            last = taken == count
            # what scatters in the last step of all would only be scattered again
            ending = last and not more
            if reason is None:
                reason = self._step(others, main._replace(new=0) if ending else main, dt, last)
            self._travelled += self._reach()
            if reason is None and last:
                self._laws.scatter()
            if reason is None and (ending or self._travelled > 0.5 * _MARGIN):
                if not last:
                    self._publish()
                migrated += self._settle()
                self._live = False
        self._live = self._live and reason is None
        self._steps_since_sorted += taken
        return taken, migrated, reason

    def _reach(self) -> float:
        """Cells that the fastest point has crossed in the step, on any rank. Collective."""
        fastest, self.done[2] = float(self.done[2]), 0.0
        comm = self._points.comm
        return fastest if comm.size == 1 else comm.allreduce(fastest, op=MPI.MAX)

    def _prepare(self) -> None:
        """Arrays of the points as the loops take them; anew when points have come or gone."""
        points = self._points
        d = points.gdim
        n = len(points)
        affine = {1: "velocity_moment", 2: "velocity_gradient"}.get(self._affine)
        C = points[affine] if affine else np.empty((n, d, d))
        self._laws.gather()
        state = points[self._laws.state] if self._laws.state else np.ones((n, 6))
        small = self._laws.kind == SMALL
        e_out = state[:, 2].copy() if small else 0.5 * np.log(state[:, 2])
        # Kirchhoff's stresses
        i, j = _PAIRS[d]
        J = np.ones(n) if small else points["V"] / points["V0"]
        tau = np.ascontiguousarray(J[:, None] * points["stress"][:, i, j])
        self._loads.evaluate()
        self._rows_of = np.arange(n, dtype=np.int32), np.empty((2, n), np.int32)
        self._data = (
            points["x"], points["l"], points["l0"], points["velocity"], C, points["F"],
            points["V"], points["V0"], point_masses(points), state, self._laws.internal,
            points["stress"], points["acceleration"], tau, e_out,
        )  # fmt: skip

    def _publish(self) -> None:
        """Give the fields what steps without a record keep for themselves and go on with."""
        points, (tau, e_out) = self._points, self._data[-2:]
        small = self._laws.kind == SMALL
        J = np.linalg.det(points["F"])
        points["V"][:] = J * points["V0"]
        i, j = _PAIRS[points.gdim]
        sigma = tau if small else tau / J[:, None]
        points["stress"][:, i, j] = sigma
        points["stress"][:, j, i] = sigma
        if self._laws.state and points.gdim == 2:
            points[self._laws.state][:, 2] = e_out if small else np.exp(2.0 * e_out)

    def _pass(self, parts: Pass, dt: float, record: bool = False) -> str | None:
        """One pass over the points; why it ended early, or None. Collective."""
        points, basis = self._points, self._window
        general = not basis.lattice.uniform
        bad = -1
        if len(points):
            rows, skipped = self._rows_of
            left = len(points)
            if not general:
                bad, left, behind = self._loop(parts, dt, record, rows, False)
                if bad < 0 and behind:
                    bad, *_ = self._loop(
                        Pass(new=parts.new), dt, record, skipped[1, :behind].copy(), True
                    )
                rows = skipped[0]
            if bad < 0 and left:
                bad, *_ = self._loop(parts, dt, record, rows[:left].copy(), True)
        return self._together(bad)

    def _loop(
        self, parts: Pass, dt: float, record: bool, rows, general: bool
    ) -> tuple[int, int, int]:
        basis, laws = self._window, self._laws
        loop = laws.kernel(self._points.gdim)(
            basis.degree, basis.averaged, laws.kind, self._affine, parts, general
        )
        return loop(
            self._grid, self._nodes, self._out, (*self._data, self._loads.body), laws.table, dt,
            self._share, record, rows, self._rows_of[1], self.done,
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
        self._out[:] = 0.0
        reason = self._pass(parts, dt)
        self._exchange(0, self._out.shape[1])
        return reason

    def _step(self, others, main: Pass, dt: float, record: bool) -> str | None:
        """One step from what has been scattered. Collective."""
        d = self._points.gdim
        columns, box = self._columns, self._rows()
        held, own = (self._fixed, self._speed), self._own
        rest = self._loads.gravity, dt, self._scaling, self._damping
        momenta = range(columns.second, columns.second + d)
        forces = range(columns.force, columns.force + d)
        if self._scheme == "usf":
            _divide(box, columns, self._out, 0, self._nodes, *held, False)
            reason = self._pass(others[0], dt, record)
            self._exchange(forces.start, forces.stop)
            if reason is not None:
                return reason
            _move_nodes(
                box, columns, self._out, self._nodes, own, *held, *rest, True, True, self.done
            )
        else:
            usl = self._scheme == "usl"
            _move_nodes(
                box, columns, self._out, self._nodes, own, *held, *rest, False, usl, self.done
            )
            if not usl:
                reason = self._pass(others[0], dt, record)
                self._exchange(momenta.start, momenta.stop)
                if reason is not None:
                    return reason
                _divide(box, columns, self._out, columns.second, self._nodes, *held, True)
        reason = self._pass(main, dt, record)
        if main.new:
            self._exchange(0, self._out.shape[1])
        return reason

    def _rows(self) -> tuple[int, ...]:
        """Nodes in use: first and last row, first and last node of each, and length of a row."""
        row, across = int(self._shape[-1]), 1 if self._points.gdim == 2 else int(self._shape[1])
        rows = int(self._first[0]) * across, int(self._last[0]) * across
        return *rows, int(self._first[-1]), int(self._last[-1]), row

    def _settle(self) -> int:
        """Cells and ranks of the points where they are now. Collective."""
        points, halo = self._points, self._window.halo
        self._laws.scatter()
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
