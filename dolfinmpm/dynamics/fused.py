"""Explicit steps on rectangular grids by fused loops, for the forms that they know.

A form of momentum terms and loads on a lattice needs no stencils, no activation and no form
assembly: one loop takes the nodes' motion to each point, strains and moves it, and scatters its
mass, momentum and forces to the nodes where it is then. Nodes are kept in a window of the lattice
around this rank's cells, by their position.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numba
import numpy as np
import numpy.typing as npt
from dolfinx.la import InsertMode
from mpi4py import MPI

from dolfinmpm.basis import LatticeBasis
from dolfinmpm.basis.bspline import greville
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.cut.cellmeans import numbering
from dolfinmpm.cut.held import Held
from dolfinmpm.dynamics.faces import Faces, Sides, set_velocities
from dolfinmpm.dynamics.fusable import Laws, Loads
from dolfinmpm.dynamics.mappings import Mapping
from dolfinmpm.dynamics.mass import point_masses
from dolfinmpm.dynamics.passes import (
    COLUMNS,
    FAST,
    GROWTH,
    LAW,
    MEANS,
    PASSES,
    SMALL,
    Pass,
)
from dolfinmpm.dynamics.transfer import collect
from dolfinmpm.solve.step import Step

__all__ = ["Fused"]

Array = npt.NDArray[np.float64]

# Layers of cells that points may wander beyond this rank's own before they are handed on
_MARGIN = 2
# Steps after which points are put in the order of cells again
_SORT = 256
# Rows and columns of a symmetric tensor, in the order in which the loops take its components
_PAIRS = {2: ([0, 1, 0], [0, 1, 1]), 3: ([0, 1, 2, 0, 1, 0], [0, 1, 2, 1, 2, 2])}


@numba.njit(cache=True, error_model="numpy")
def _rub(mark, rubbing, velocity):
    """Stop a node that would move out of sides of the grid, and let friction act on its slip."""
    for face in range(rubbing.shape[0]):
        if (mark >> np.uint64(face)) & np.uint64(1) == 0:
            continue
        axis, outward, mu = int(rubbing[face, 0]), rubbing[face, 1], rubbing[face, 2]
        out = outward * velocity[axis]
        if not out > 0.0:
            continue
        velocity[axis] = 0.0
        slip = 0.0
        for i in range(velocity.size):
            slip += velocity[i] ** 2
        left = max(0.0, 1.0 - mu * out / max(math.sqrt(slip), 1e-300))
        for i in range(velocity.size):
            velocity[i] *= left


@numba.njit(cache=True, error_model="numpy", fastmath=FAST)
def _move_nodes(
    box, columns, out, nodes, own, fixed, before, held, faces, pushed, g, dt, scaling, damping,
    known, last, done,
):  # fmt: skip
    """Accelerate the nodes of a box.

    Args:
        own: Whose work this rank counts.
        before, held: Velocities of fixed components at the start and the end of the step.
        faces: What acts at sides of the grid, see `Faces.by_nodes`.
        pushed: Written unless empty, changes of velocity by forces alone.
        known: Whether velocities for the strain have been set before.
        last: Whether the sums are done with, and cleared.
    """
    _, mass, force, _, velocity, strain = columns
    d = fixed.shape[1]
    marks, rubbing, dashpots = faces
    ends, forces = np.empty(d), np.empty(d)
    work = 0.0
    for block in range(box[0], box[1]):
        for k in range(block * box[4] + box[2], block * box[4] + box[3]):
            m = out[k, mass]
            per_mass = 1.0 / m if m > 0.0 else 0.0
            for i in range(d):
                y = out[k, i] * per_mass
                f = out[k, force + i] + m * g[i]
                if damping > 0.0:
                    f -= damping * abs(f) * np.sign(before[k, i] if fixed[k, i] else y)
                forces[i] = f
                ends[i] = before[k, i] if fixed[k, i] else y + dt * f * per_mass / scaling
            if dashpots.shape[0] > 0 and m > 0.0:
                for i in range(d):
                    ends[i] /= 1.0 + dt * dashpots[k, i] / (m * scaling)
            if marks.shape[0] > 0 and marks[k] != 0:
                _rub(marks[k], rubbing, ends)
            for i in range(d):
                y, f, end = out[k, i] * per_mass, forces[i], ends[i]
                change = dt * f * per_mass / scaling
                if fixed[k, i]:
                    y, end, change = before[k, i], held[k, i], 0.0
                    if own[k]:
                        # what moves the node does work against its forces and its inertia
                        work += (m * scaling * (end - y) - dt * f) * end
                nodes[k, i] = end - y
                nodes[k, velocity + i] = end
                if not known:
                    nodes[k, strain + i] = end
                if pushed.shape[0] > 0:
                    pushed[k, i] = change
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
def _take_means(box, sums):
    """Means from sums of volumes and of volumes times a change, in their place."""
    for block in range(box[0], box[1]):
        for k in range(block * box[4] + box[2], block * box[4] + box[3]):
            if sums[k, 0] > 0.0:
                sums[k, 1] /= sums[k, 0]


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


def _add_up(vector, known, sums: Array, at, begin: int, end: int) -> None:
    """Add up columns of sums over ranks, for all that know the places. Collective.

    Args:
        vector: A distributed array of as many columns.
        known, at: Places in it, and in the sums.
        sums: Changed.
        begin, end: The columns.
    """
    values = vector.array.reshape(-1, sums.shape[1])
    values[:] = 0.0
    values[known, begin:end] = sums[at, begin:end]
    vector.scatter_reverse(InsertMode.add)
    vector.scatter_forward()
    sums[at, begin:end] = values[known, begin:end]


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
        sides: Sides of the grid that act on the body.
        domains: How the points' domains grow.

    Attributes:
        done: Work of the stresses, and of loads and prescribed motions, since last asked (J).
        at_once: Steps that one call may take.
        instead: Why other steps are taken: they are not.
    """

    at_once, instead = 20, ""

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
        sides: Sides,
        domains: str = "stretch",
    ):
        self._points, self._held, self._laws, self._loads = points, held, laws, loads
        self._scheme, self._mapping = scheme, mapping
        self._scaling, self._damping, self._acting = scaling, damping, sides
        # and the cells that the fastest point has crossed in a step
        self.done = np.zeros(3)
        self._columns = COLUMNS[points.gdim]
        self._live, self._travelled = False, 0.0
        # velocities prescribed in time, as nodes have them now
        self._driven: list[float] | None = None
        self._basis = basis
        self._growth = GROWTH[domains] if basis.averaged else 0
        self._window: Any = None
        self._steps_since_sorted = _SORT
        self._share = {"flip": mapping.share}.get(mapping.kind, 0.0)
        self._affine = {"apic": 1, "tpic": 2}.get(mapping.kind, 0)

    def work(self) -> tuple[float, float]:
        """Work (J) of the stresses, and of loads and prescribed motions, since last asked.

        Collective.
        """
        internal, external = self._points.comm.allreduce(self.done[:2], op=MPI.SUM)
        self.done[:2] = 0.0
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
        if self._laws.fbar:
            self._build_means()
        place = np.full(basis.nodes.size, -1)
        place[self._known] = self._at
        acting = self._acting.on(basis) or Faces((), basis, d)
        self._sides = acting.by_nodes(place, size)
        self._table = halo.cell_table.ravel()
        self._table_shape = np.array(halo.cell_table.shape, np.int64)

    def _build_means(self) -> None:
        """Where means of F-bar are taken: at the window's places of their cells. Collective."""
        own, ijk = numbering(self._window)
        ijk = ijk - self._window.halo.origin
        inside = np.all((ijk >= 0) & (ijk < self._shape), axis=1)
        self._sums = np.zeros((len(self._nodes), 2))
        self._averaging = np.flatnonzero(inside)
        self._averaging_at = np.ravel_multi_index(tuple(ijk[inside].T), tuple(self._shape))
        self._sums_vector = own.vector(2) if own.comm.size > 1 else None

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
        self._before, self._rate = self._speed, rate

    def _drive(self, t: float, dt: float) -> None:
        """Take velocities prescribed in time for a step from t on. Collective."""
        conditions = self._held.conditions
        driven = [c.velocity for c in conditions if c.velocity is not None]
        if not driven:
            return
        wanted = [v(t) for v in driven], [v(t + dt) for v in driven]
        if self._driven is None or self._driven != wanted[0]:
            set_velocities(conditions, lambda v: v(t) / self._rate)
            self._flags(self._rate)
        self._before = self._speed
        if wanted[1] != wanted[0]:
            set_velocities(conditions, lambda v: v(t + dt) / self._rate)
            start = self._before
            self._flags(self._rate)
            self._before = start
        self._driven = wanted[1]

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
        self._driven = None
        self._live = False

    def run(
        self, count: int, dt: float, more: bool, begin: Callable[[int], Step]
    ) -> tuple[int, int, str | None]:
        """Take equal steps. Collective.

        Args:
            count: How many.
            dt: Their length (s).
            more: Whether others follow without a new start.
            begin: Tells form and conditions how many of the steps have been taken, and
                returns the next.

        Returns:
            Steps taken, points that changed rank, and why it ended before the last, or None.
        """
        migrated, reason, taken = 0, None, 0
        *others, main = PASSES[self._scheme]
        first = Pass(new=2 if self._scheme != "usf" else 1)
        while taken < count and reason is None:
            self._drive(begin(taken).t - dt, dt)
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
                reason = self._scatter(first, dt)
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
        small, logarithmic = self._laws.kind == SMALL, self._laws.kind == LAW
        e_out = 0.5 * np.log(state[:, 2]) if logarithmic else state[:, 2].copy()
        # Kirchhoff's stresses; by columns, since fancy indices are ten times slower
        stress, J = points["stress"], 1.0 if small else points["V"] / points["V0"]
        tau = np.empty((n, len(_PAIRS[d][0])))
        for k, (i, j) in enumerate(zip(*_PAIRS[d])):
            tau[:, k] = J * stress[:, i, j]
        self._loads.evaluate()
        self._rows_of = np.arange(n, dtype=np.int32), np.empty((2, n), np.int32)
        # the product of the means of all steps
        self._J_bar = points["J_bar"] if self._laws.fbar and self._laws.kind == LAW else np.empty(0)
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
            logarithmic = self._laws.kind == LAW
            points[self._laws.state][:, 2] = np.exp(2.0 * e_out) if logarithmic else e_out

    def _pass(self, parts: Pass, dt: float, record: bool = False) -> str | None:
        """One pass over the points; why it ended early, or None. Collective."""
        if not (parts.strain and self._laws.fbar):
            return self._once(parts, dt, record)
        taken, used = MEANS[self._laws.fbar]
        self._sums[:] = 0.0
        reason = self._once(Pass(strain=True), dt, False, taken)
        if self._sums_vector is not None:
            _add_up(self._sums_vector, self._averaging, self._sums, self._averaging_at, 0, 2)
        _take_means(self._rows(), self._sums)
        return reason or self._once(parts, dt, record, used)

    def _once(self, parts: Pass, dt: float, record: bool, means: int = 0) -> str | None:
        points, basis = self._points, self._window
        general = not basis.lattice.uniform
        bad = -1
        if len(points):
            rows, skipped = self._rows_of
            left = len(points)
            if not general:
                bad, left, behind = self._loop(parts, dt, record, rows, False, means)
                if bad < 0 and behind:
                    bad, *_ = self._loop(
                        Pass(new=parts.new), dt, record, skipped[1, :behind].copy(), True
                    )
                rows = skipped[0]
            if bad < 0 and left:
                bad, *_ = self._loop(parts, dt, record, rows[:left].copy(), True, means)
        return self._together(bad)

    def _loop(
        self, parts: Pass, dt: float, record: bool, rows, general: bool, means: int = 0
    ) -> tuple[int, int, int]:
        laws = self._laws
        data: tuple[Array, ...] = (*self._data, self._loads.body)
        kind: tuple[Any, ...]
        kind = self._window.degree, self._growth, laws.kind, self._affine, parts, general
        if means:
            kind, data = (*kind, means), (*data, self._sums, self._J_bar)
        loop = laws.kernel(self._points.gdim)(*kind)
        return loop(
            self._grid, self._nodes, self._out, data, laws.table, dt, self._share, record, rows,
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
        _add_up(self._vector, self._known, self._out, self._at, begin, end)

    def _scatter(self, parts: Pass, dt: float) -> str | None:
        self._out[:] = 0.0
        reason = self._pass(parts, dt)
        self._exchange(0, self._out.shape[1])
        return reason

    def _step(self, others, main: Pass, dt: float, record: bool) -> str | None:
        """One step from what has been scattered. Collective."""
        d = self._points.gdim
        columns, box = self._columns, self._rows()
        out, nodes, fixed = self._out, self._nodes, self._fixed
        usf, usl = self._scheme == "usf", self._scheme == "usl"
        # forces alone make the points' acceleration, not what moves or stops nodes
        apart = record and (self._driven is not None or len(self._acting) > 0)
        pushed = np.zeros((len(nodes), d)) if apart else np.empty((0, d))
        if usf:
            _divide(box, columns, out, 0, nodes, fixed, self._before, False)
            reason = self._pass(others[0], dt, record)
            self._exchange(columns.force, columns.force + d)
            if reason is not None:
                return reason
        _move_nodes(
            box, columns, out, nodes, self._own, fixed, self._before, self._speed, self._sides,
            pushed, self._loads.gravity, dt, self._scaling, self._damping, usf, usf or usl,
            self.done,
        )  # fmt: skip
        changes = self._at_points(pushed) if apart else None
        if not (usf or usl):
            reason = self._pass(others[0], dt, record)
            self._exchange(columns.second, columns.second + d)
            if reason is not None:
                return reason
            _divide(box, columns, out, columns.second, nodes, fixed, self._speed, True)
        reason = self._pass(main, dt, record)
        if main.new:
            self._exchange(0, out.shape[1])
        if changes is not None:
            self._points["acceleration"][:] = changes / dt
        return reason

    def _at_points(self, values: Array) -> Array:
        """Values at the window's nodes, shape (nodes, d), at the points where they are."""
        basis, points = self._window, self._points
        known = np.zeros((basis.nodes.size, points.gdim))
        known[self._known] = values[self._at]
        return collect(basis.stencils(points.placement()), known)

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
