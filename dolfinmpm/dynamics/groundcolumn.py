"""The motion of a column of ground over time, and its action on a side of a body.

A free-field side feels what the ground beside it would do alone: the column's stress on the side,
and dashpots on the difference of both velocities (Lysmer & Kuhlemeyer 1969; Zienkiewicz, Bicanic &
Shen 1989; Nielsen 2006, doi 10.1016/j.compgeo.2005.12.002),

    t = σ_c n + ρ c (v_c − v).

Rows of points at one height stand for the column. A node i of the body's grid has the share N_i of
a row, at the place to which the column has moved the side. So the side is no boundary for the
motion of the column itself, and dashpots take only what the body adds to it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm._platform.argumentchecks import number, shown
from dolfinmpm._platform.collective import collective
from dolfinmpm._platform.errors import ParameterError
from dolfinmpm._platform.uncopied import Unchanged
from dolfinmpm.basis.bspline import greville
from dolfinmpm.basis.lineweights import line_weights, overlapped
from dolfinmpm.dynamics.clock import times

__all__ = ["ColumnAtSide", "GroundColumn", "integrals_within"]

Array = npt.NDArray[np.float64]
# Share of a cell's height below which points are in one row
_SAME = 1e-6
# Least share of a node in a side
_LEAST = 1e-3
# Singular values below this share are of functions that rows of points hardly see
_KNOWN = 0.05
# Points of a row move otherwise than their mean by at most this share of the largest motion
_ALIKE = 1e-3


class GroundColumn(Unchanged):
    """The motion of a column of level ground over time, for `free_field`. Collective.

    The problem is that of a column of the ground beside a body: with the same layers, the same
    heights and the same base, and with tied sides. It takes its steps here. Every row of points of
    one height is recorded: its velocity, its displacement and its stress. Between the steps they
    are linear in time.

    Args:
        problem: A problem in time, such as `Newmark`; its last axis is vertical.
        end: End of the record (s).
        dt: Length of the steps (s).

    Attributes:
        time: Times of the record (s), shape (times,).
        height: Heights of the rows at the start (m), shape (rows,), increasing.

    Raises:
        ParameterError: The problem has no time, or a number is out of its range.

    A column of one cell that swings:

    >>> import dolfinmpm as mpm
    >>> from mpi4py import MPI
    >>> grid = mpm.create_lattice(MPI.COMM_WORLD, [range(8), range(5)])
    >>> points = mpm.fill(grid, mpm.Box((3, 0), (4, 4)), per_cell=2, density=1.0)
    >>> V = mpm.Space(grid, "gimp")
    >>> F = mpm.momentum(mpm.materials.Hencky(2.0, 0.0), points, V.increment, V.test)
    >>> velocity = points.add_field("velocity", (2,), "m/s")
    >>> points["velocity"] = (1e-3, 0.0)
    >>> bcs, sides = mpm.fixed(V, "bottom"), mpm.tied(V, period=1.0)
    >>> swings = mpm.Newmark(F, V.increment, points, bcs, prolongation=sides, ghost_mass=0.0)
    >>> ground = mpm.GroundColumn(swings, 1.0, dt=0.5)
    >>> ground.time.tolist(), len(ground.height)
    ([0.0, 0.5, 1.0], 8)
    """

    time: Array
    height: Array

    @collective
    def __init__(self, problem: Any, end: float, *, dt: float):
        points = getattr(problem, "points", None)
        if points is None or not hasattr(problem, "time"):
            raise ParameterError(
                f"problem = {shown(problem)} must be a problem in time, such as mpm.Newmark(...) "
                "of a column with tied sides"
            )
        start = float(problem.time)
        number("end", end, start, unit="s"), number("dt", dt, 0.0, unit="s")
        self.gdim = points.gdim
        self._find_rows(problem)
        found, moments = [self._rows(points)], [start]
        for t in times(end, dt=dt, start=start):
            problem.step(t)
            found.append(self._rows(points))
            moments.append(float(problem.time))
        self._check_alike(points)
        self.time, values = np.array(moments), np.array(found)
        d = self.gdim
        self.height = values[0, :, d - 1].copy()
        # displacements, velocities, stresses
        values[:, :, :d] -= values[0, :, :d].copy()
        self._values = values

    def _check_alike(self, points: Any) -> None:
        """Raise ParameterError if points of a row have moved otherwise: level ground moves by rows.

        A column whose sides are free bends, and swings slower than the ground does. Collective.
        """
        way = points["x"] - points["x0"]
        off = np.abs(way - self._means(points, way)[self._row_of(points)])
        largest = np.array([a.max(initial=0.0) for a in (off, np.abs(way))])
        points.comm.Allreduce(MPI.IN_PLACE, largest, op=MPI.MAX)
        if largest[0] > _ALIKE * largest[1]:
            raise ParameterError(
                f"points of one height of the column have moved by up to {largest[0]:.3g} m "
                f"otherwise than their mean, and the largest motion is {largest[1]:.3g} m: level "
                "ground moves as one at each height. Give the problem of the column tied sides, "
                "prolongation=mpm.tied(V, period), or hold its sides"
            )

    def _find_rows(self, problem: Any) -> None:
        """Find the rows, their shares of the height and their impedances. Collective."""
        points = problem.points
        self._unit = _SAME * points.comm.allreduce(
            float(np.diff(problem.fields[0].space.basis.lattice.lines[-1]).min()), op=MPI.MIN
        )
        own = np.unique(self._keys(points))
        self._known = np.unique(np.concatenate(points.comm.allgather(own)))
        # neighbouring keys are one row that rounding has parted
        self._known = self._known[np.diff(self._known, prepend=-np.inf) > 1]
        problem.form.bind()
        moduli = np.zeros((len(points), 2))
        for declaration in problem.form.parts.declarations:
            moduli[declaration.rows] = declaration.elastic.moduli()
        rates = np.sqrt(points["density"][:, None] * moduli)
        z, half, volume = points["x"][:, -1], points["l"][:, -1], points["V"]
        mean = self._means(points, np.column_stack([half, rates]))
        self.half, self.rates = mean[:, 0], mean[:, 1:]
        ends = np.array([(z + half).max(initial=-np.inf), -(z - half).min(initial=np.inf)])
        points.comm.Allreduce(MPI.IN_PLACE, ends, op=MPI.MAX)
        volumes = np.bincount(self._row_of(points), volume, len(self._known)).astype(np.float64)
        points.comm.Allreduce(MPI.IN_PLACE, volumes, op=MPI.SUM)
        # heights that the rows stand for
        self.share = volumes * ends.sum() / volumes.sum()

    def _keys(self, points: Any) -> Array:
        return np.round(points["x0"][:, -1] / self._unit)

    def _row_of(self, points: Any) -> npt.NDArray[np.intp]:
        """The row of each point of this rank."""
        return np.maximum(np.searchsorted(self._known, self._keys(points) + 0.5) - 1, 0)

    def _means(self, points: Any, values: Array) -> Array:
        """Means of values of points over the rows, shape (rows, columns). Collective."""
        row, n = self._row_of(points), len(self._known)
        columns = [np.ones(len(points)), *values.T]
        # without points NumPy counts in integers
        sums = np.array([np.bincount(row, column, n) for column in columns], np.float64)
        points.comm.Allreduce(MPI.IN_PLACE, sums, op=MPI.SUM)
        return (sums[1:] / sums[0]).T

    def _rows(self, points: Any) -> Array:
        """Positions, velocities and stresses of the rows now. Collective."""
        d, n = self.gdim, len(points)
        stress = points["stress"][:, :d, :d].reshape(n, d * d)
        return self._means(points, np.hstack([points["x"], points["velocity"], stress]))

    @collective
    def check_beside(self, points: Any, face: Any, box: Array) -> None:
        """Raise ParameterError unless a body's side has the heights of the column. Collective.

        Args:
            points: Points of the body.
            face: The side, see `dolfinmpm.dynamics.faces.Face`.
            box: Lower and upper ends of the body (m), shape (2, d).
        """
        x, half = points["x"], points["l"]
        outward = 1.0 if face.end else -1.0
        there = outward * (x + outward * half - box[face.end])[:, face.axis]
        side = there > -half[:, face.axis]
        ends = np.array([x + half, -(x - half)])[:, side, -1].max(axis=1, initial=-np.inf)
        points.comm.Allreduce(MPI.IN_PLACE, ends, op=MPI.MAX)
        high, low = float(ends[0]), -float(ends[1])
        top, bottom = self.height[-1] + self.half[-1], self.height[0] - self.half[0]
        row = 2.0 * float(self.half.max())
        if max(abs(high - top), abs(low - bottom)) > (1.0 + _SAME) * row:
            raise ParameterError(
                f"the body is from {low:.6g} to {high:.6g} m high at the free-field side "
                f"'{face.where}', and the column beside it from {bottom:.6g} to {top:.6g} m, which "
                f"is more than a row of points apart, {row:.3g} m: give both the same heights; "
                "sides of different heights take a column each"
            )

    def at(self, t: float) -> tuple[Array, Array, Array]:
        """Displacements (m), velocities (m/s) and stresses (Pa) of the rows at a time.

        Shapes (rows, d), (rows, d) and (rows, d, d).

        Args:
            t: The time (s).

        Raises:
            ParameterError: The record ends before, or begins later.
        """
        t = number("t", t, unit="s")
        first, last = float(self.time[0]), float(self.time[-1])
        if t < first - 1e-9 * abs(last):
            raise ParameterError(
                f"t = {t:g} s is before the start of the free field's column, {first:g} s: make "
                "mpm.GroundColumn of a problem that has taken no steps, or begin both at one time"
            )
        if t > last + 1e-9 * abs(last):
            raise ParameterError(
                f"t = {t:g} s is after the end of the free field's column, {last:g} s: take a "
                "later end in mpm.GroundColumn"
            )
        k = int(np.clip(np.searchsorted(self.time, t) - 1, 0, len(self.time) - 2))
        share = np.clip((t - self.time[k]) / (self.time[k + 1] - self.time[k]), 0.0, 1.0)
        now, d = (1.0 - share) * self._values[k] + share * self._values[k + 1], self.gdim
        return now[:, :d], now[:, d : 2 * d], now[:, 2 * d :].reshape(-1, d, d)

    def __repr__(self) -> str:
        return f"GroundColumn({len(self.height)} rows, {self.time[0]:g} to {self.time[-1]:g} s)"


class ColumnAtSide:
    """A column of ground at a side of a body, in the numbering of a basis.

    Args:
        column: The column.
        basis: Basis of the body's displacement, on a lattice.
        axis, end: Direction of the side's normal, and 0 for the lower or 1 for the upper end.
        box: Lower and upper ends of the body at the start (m), shape (2, d).

    Raises:
        ParameterError: The column reaches beyond the grid.
    """

    def __init__(self, column: GroundColumn, basis: Any, axis: int, end: int, box: Array):
        self._column, self._axis, self._edge = column, axis, float(box[end, axis])
        self._outward = 1.0 if end else -1.0
        lattice, degree, self._ijk = basis.lattice, basis.degree, basis.halo.node_ijk
        self._line, self._degree = lattice.lines[axis], degree
        upright = lattice.lines[-1]
        low, high = column.height[0], column.height[-1]
        if low < upright[0] or high > upright[-1]:
            raise ParameterError(
                f"the column of the free field has points from {low:g} to {high:g} m, and the grid "
                f"is from {upright[0]:g} to {upright[-1]:g} m: give both the same heights"
            )
        half = column.half if basis.averaged else np.zeros_like(column.half)
        self._upright = line_functions(upright, degree, column.height, half)
        self._across = np.ones(len(self._ijk))
        for k in range(column.gdim - 1):
            if k != axis:
                self._across *= integrals_within(lattice.lines[k], degree, *box[:, k])[
                    self._ijk[:, k]
                ]
        # coefficients of the functions: about values at Greville points, and so that they meet the
        # rows, where rows determine them
        values = _lines(column.height, greville(upright, degree))
        miss = np.eye(len(column.height)) - self._upright.T @ values
        self._by_rows = values + np.linalg.pinv(self._upright.T, rcond=_KNOWN) @ miss
        self._nodes: npt.NDArray[np.intp] = np.empty(0, np.intp)
        self._weights: Array = np.empty((0, len(column.height)))
        self._dashpots: Array = np.empty((0, column.gdim))

    def place(self, t: float) -> tuple[npt.NDArray[np.intp], Array]:
        """Move the side to where the column is, and return its nodes and their dashpots.

        Args:
            t: The time (s).

        Returns:
            The nodes, shape (n,), and coefficients of their dashpots (N s/m), shape (n, d).
        """
        column, line = self._column, self._line
        moved = column.at(t)[0][:, self._axis]
        x = np.clip(self._edge + moved, line[0], line[-1])
        along = line_functions(line, self._degree, x, np.zeros_like(x))
        # a node with next to no share of the side has next to no mass, too
        along[along < _LEAST] = 0.0
        along /= along.sum(axis=0)
        near = along.max(axis=1)[self._ijk[:, self._axis]] > 0.0
        near &= self._upright.max(axis=1)[self._ijk[:, -1]] > 0.0
        nodes = self._nodes = np.flatnonzero(near)
        ijk = self._ijk[nodes]
        weights = along[ijk[:, self._axis]] * self._upright[ijk[:, -1]] * self._across[nodes, None]
        self._weights = weights * column.share
        p, s = (self._weights @ column.rates).T
        self._dashpots = np.repeat(s[:, None], column.gdim, axis=1)
        self._dashpots[:, self._axis] = p
        return nodes, self._dashpots

    def edge(self, t: float) -> float:
        """Where the side is at the bottom of the column at a time (m)."""
        return self._edge + float(self._column.at(t)[0][0, self._axis])

    def forces(self, t: float) -> tuple[npt.NDArray[np.intp], Array]:
        """The nodes, shape (n,), and the column's forces on them at a time (N), shape (n, d).

        Args:
            t: The time (s).
        """
        _, velocity, stress = self._column.at(t)
        at_nodes = (self._by_rows @ velocity)[self._ijk[self._nodes, -1]]
        traction = self._outward * stress[:, :, self._axis]
        return self._nodes, self._weights @ traction + self._dashpots * at_nodes


def _lines(known: Array, at: Array) -> Array:
    """Matrix of linear interpolation, and extrapolation, from known places to others."""
    out = np.zeros((at.size, known.size))
    if known.size == 1:
        return out + 1.0
    k = np.clip(np.searchsorted(known, at) - 1, 0, known.size - 2)
    share = (at - known[k]) / (known[k + 1] - known[k])
    rows = np.arange(at.size)
    out[rows, k], out[rows, k + 1] = 1.0 - share, share
    return out


def line_functions(line: Array, degree: int, x: Array, half: Array) -> Array:
    """Functions of a direction at places, or averaged over domains, shape (functions, places)."""
    out = np.zeros((line.size - 1 + degree, x.size))
    part, slope = np.empty(degree + 1), np.empty(degree + 1)
    for k, (at, reach) in enumerate(zip(x, half)):
        first, count = overlapped(line, False, at, reach)
        S, dS = np.empty(count + degree), np.empty(count + degree)
        line_weights(line, False, degree, first, count, at, reach, S, dS, part, slope)
        out[first : first + count + degree, k] = S
    return out


def integrals_within(line: Array, degree: int, low: float, high: float) -> Array:
    """Integrals of the functions of a direction over a part of the line (m), shape (functions,)."""
    low, high = max(low, line[0]), min(high, line[-1])
    middle, reach = np.array([0.5 * (low + high)]), np.array([0.5 * (high - low)])
    return (high - low) * line_functions(line, degree, middle, reach)[:, 0]
