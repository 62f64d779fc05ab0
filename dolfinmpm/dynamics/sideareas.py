"""Areas of sides of the grid at nodes: of whole sides, and of the part that a body covers.

A dashpot of an absorbing side acts on the body, not on the grid beside it. So a function of the
grid has the part of its integral over the side that the body covers. The domains of the points
beside the side tell this part cell by cell.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numba
import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm._platform.errors import IdleConditionWarning, ParameterError, warn
from dolfinmpm.basis import LatticeBasis
from dolfinmpm.basis.bspline import integrals, middles
from dolfinmpm.body.location import bounds
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.cut.unknowns import Nodal
from dolfinmpm.dynamics.groundcolumn import integrals_within
from dolfinmpm.grid.lattice import largest_cell

if TYPE_CHECKING:
    from scipy import sparse

    from dolfinmpm.forms.declarations import Declaration

__all__ = ["CoveredSide", "areas", "at_independent", "check_beyond", "radii"]

Array = npt.NDArray[np.float64]
# Domains that turn and shear leave small gaps, and those of a mesh do not tile it. A cell with the
# share _FULL is full, and so is a cell between others with at least the share _SOME.
_FULL, _SOME = 0.95, 1e-6
# Density beyond a side over that of the body: a unit weight in kN/m³ is a hundredth of a density
_LIGHT = 0.05
# Speeds of waves beyond a side over those of the body: km/s are a thousandth of m/s
_SLOW = 0.05


def check_beyond(
    faces: Sequence[Any], points: MaterialPoints, declarations: Sequence[Declaration]
) -> None:
    """Raise ParameterError if ground beyond a side is far lighter or softer. Collective.

    Args:
        faces: The sides of the problem.
        points: The material points.
        declarations: Laws of the body; the slowest elastic waves of all points count.
    """
    given = [face for face in faces if face.density is not None]
    if given:
        _refuse_light(given, points)
        _refuse_slow(given, points, declarations)
        _warn_of_untouched(given, points)


def _warn_of_untouched(given: Sequence[Any], points: MaterialPoints) -> None:
    """Warn of absorbing sides further than a cell from the body, which do nothing. Collective."""
    low, high = bounds(points.grid)
    x, half = points["x"], points["l"]
    gaps = np.array([(x - half).min(axis=0, initial=np.inf) - low,
                     high - (x + half).max(axis=0, initial=-np.inf)])  # fmt: skip
    points.comm.Allreduce(MPI.IN_PLACE, gaps, op=MPI.MIN)
    for face in given:
        gap = gaps[1 if face.end else 0, face.axis]
        if gap > largest_cell(points.grid):
            warn(
                points.comm,
                f"the absorbing side '{face.where}' of the grid is {gap:.4g} m from the body and "
                "does nothing: names of sides mean sides of the grid; let the grid end at the "
                "body, or hold the body elsewhere by a function of positions",
                IdleConditionWarning,
            )


def _refuse_light(given: Sequence[Any], points: MaterialPoints) -> None:
    """Raise ParameterError if ground beyond a side is far lighter than the body. Collective."""
    sums = np.array([points["density"] @ points["V0"], points["V0"].sum()])
    points.comm.Allreduce(MPI.IN_PLACE, sums, op=MPI.SUM)
    mean = float(sums[0] / sums[1])
    for face in given:
        if face.density < _LIGHT * mean:
            raise ParameterError(
                f"density = {face.density:g} kg/m³ of the ground beyond the absorbing side "
                f"'{face.where}' is less than a twentieth of the {mean:.4g} kg/m³ of the body: "
                "give a density in kg/m³, not a unit weight in kN/m³"
            )


def _refuse_slow(
    given: Sequence[Any], points: MaterialPoints, declarations: Sequence[Declaration]
) -> None:
    """Raise ParameterError if waves beyond a side are far slower than in the body. Collective."""
    least = np.full(2, np.inf)
    for declaration in declarations:
        moduli, rho = declaration.elastic.moduli(), points["density"][declaration.rows]
        if len(rho):
            speeds = np.sqrt(np.maximum(moduli, 0.0) / rho[:, None])
            least = np.minimum(least, speeds.min(axis=0))
    points.comm.Allreduce(MPI.IN_PLACE, least, op=MPI.MIN)
    for face in given:
        for name, rate, own in zip(("p_speed", "s_speed"), face.impedance, least):
            speed = rate / face.density
            if 0.0 < speed < _SLOW * own < np.inf:
                raise ParameterError(
                    f"{name} = {speed:g} m/s of the ground beyond the absorbing side "
                    f"'{face.where}' is less than a twentieth of the {own:.4g} m/s of such waves "
                    "in the body: give it in m/s, not in km/s; in elastic ground it is √(M/ρ) for "
                    "p_speed and √(G/ρ) for s_speed"
                )


@numba.njit(cache=True, error_model="numpy")
def _beside(x, half, axis, low, high):
    """Rows of the domains that reach into a layer. Few do, and each step asks."""
    rows, count = np.empty(len(x), np.intp), 0
    for p in range(len(x)):
        if x[p, axis] + half[p, axis] > low and x[p, axis] - half[p, axis] < high:
            rows[count] = p
            count += 1
    return rows[:count].copy()


def _overlapping(
    low: Array, high: Array, weight: Array, lines: Sequence[Array], count: Sequence[int]
) -> Array:
    """Sums over boxes of a weight times the box's volume in each cell, shape (cells, ...).

    Args:
        low, high: Corners of the boxes (m), shape (boxes, directions).
        weight: Weight of each box, shape (boxes,).
        lines: Lines of the grid (m), per direction.
        count: Number of cells, per direction.
    """
    out = np.zeros(tuple(count))
    first = np.empty(low.shape, np.intp)
    most = []
    for k, line in enumerate(lines):
        first[:, k] = np.clip(np.searchsorted(line, low[:, k], "right") - 1, 0, count[k] - 1)
        last = np.clip(np.searchsorted(line, high[:, k], "left") - 1, 0, count[k] - 1)
        most.append(int((last - first[:, k]).max(initial=0)) + 1)
    for shift in itertools.product(*map(range, most)):
        at, part = [], weight
        for k, line in enumerate(lines):
            i = np.minimum(first[:, k] + shift[k], count[k] - 1)
            length = np.minimum(high[:, k], line[i + 1]) - np.maximum(low[:, k], line[i])
            part = part * np.where(first[:, k] + shift[k] == i, np.maximum(length, 0.0), 0.0)
            at.append(i)
        np.add.at(out, tuple(at), part)
    return out


def _between(covered: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
    """Mask of the covered cells whose neighbours in all directions are covered, too."""
    out = covered.copy()
    for k in range(covered.ndim):
        beyond = np.pad(covered, [(int(i == k),) * 2 for i in range(covered.ndim)])
        n = covered.shape[k]
        out &= beyond.take(range(n), axis=k) & beyond.take(range(2, n + 2), axis=k)
    return out


class CoveredSide:
    """A side of a rectangular grid, and integrals of functions over what a body covers of it.

    Args:
        basis: The basis.
        axis, end: Direction of the side's normal, and 0 for the lower or 1 for the upper end.
        repeated: Cells in a period of the body, by direction in which it repeats itself.
    """

    def __init__(self, basis: LatticeBasis, axis: int, end: int, repeated: Mapping[int, int]):
        lines = basis.lattice.lines
        self._axis, self._ijk, line = axis, basis.halo.node_ijk, lines[axis]
        self._layer = (line[-2], line[-1]) if end else (line[0], line[1])
        self._along = [k for k in range(len(lines)) if k != axis]
        self._lines = [lines[k] for k in self._along]
        self._repeated = {self._along.index(k): n for k, n in repeated.items() if k != axis}
        self._parts = [_by_cells(line, basis.degree) for line in self._lines]

    def shares(self, points: MaterialPoints) -> Array | None:
        """Shares of the side's cells that the body covers, shape (cells, ...). Collective.

        Args:
            points: Material points.

        Returns:
            The shares, or None if no point is beside the side.
        """
        read, (low, high) = points.fields.read, self._layer
        x, half, axis = read("x"), read("l"), self._axis
        near = _beside(x, half, axis, low, high)
        x, half, full, V0 = x[near], half[near], read("l0")[near], read("V0")[near]
        if points.axisymmetric:
            V0 = V0 / (2 * np.pi * read("x0")[near, 0])
        # a body may end within the cells beside the side
        ends = np.array([np.minimum(half - x, -low).T[axis], np.minimum(x + half, high).T[axis]])
        reach = ends.max(axis=1, initial=-np.inf)
        points.comm.Allreduce(MPI.IN_PLACE, reach, op=MPI.MAX)
        depth = reach.sum()
        if not depth > 0.0:
            return None
        # points need not have domains: a cube of their volume then
        cube = 0.5 * V0 ** (1 / points.gdim)
        half = np.where(full > 0.0, half, cube[:, None])
        full = np.where(full > 0.0, full, cube[:, None])
        weight = V0 / (2 * full).prod(axis=1) * (ends.sum(axis=0) / depth)
        count = [line.size - 1 for line in self._lines]
        edges = (x - half)[:, self._along], (x + half)[:, self._along]
        found = _overlapping(*edges, weight, self._lines, count)
        points.comm.Allreduce(MPI.IN_PLACE, found, op=MPI.SUM)
        for k, line in enumerate(self._lines):
            found /= np.diff(line).reshape([-1 if i == k else 1 for i in range(found.ndim)])
        for k, cells in self._repeated.items():
            # wherever its period is, it covers the whole side
            found = np.broadcast_to(found.sum(axis=k, keepdims=True) / cells, found.shape)
        return np.where((found > _FULL) | _between(found > _SOME), 1.0, found)

    def areas(self, shares: Array, nodes: npt.NDArray[np.intp]) -> Array:
        """Integrals of the nodes' functions over the covered part of the side (m^(d-1)).

        Args:
            shares: See `shares`.
            nodes: Nodes on the side, shape (n,).
        """
        table = shares
        for parts in self._parts:
            # each product moves a direction to the end, so that all come back in their order
            table = np.moveaxis(table, 0, -1)
            rows = parts @ table.reshape(-1, table.shape[-1]).T
            table = rows.T.reshape(*table.shape[:-1], -1)
        return np.asarray(table[tuple(self._ijk[nodes, k] for k in self._along)], np.float64)


def _by_cells(line: Array, degree: int) -> sparse.csr_matrix:
    """Integrals of the functions of a direction over each cell (m), shape (functions, cells)."""
    # most runs have no absorbing side, and need not load it
    from scipy import sparse

    columns = [integrals_within(line, degree, a, b) for a, b in itertools.pairwise(line)]
    return sparse.csr_matrix(np.column_stack(columns))


def at_independent(values: Array, basis: LatticeBasis, C: sparse.csr_matrix) -> Array:
    """Sums Cᵀ c at independent nodes, where other nodes follow them. Collective.

    As a lumped mass: the dashpots together stay the same. Nodes follow by extrapolation, so that a
    sum may be negative. Such a dashpot would make energy, and is left out.

    Args:
        values: Coefficients of the dashpots (N s/m), shape (nodes, d).
        basis: The basis.
        C: Matrix from the independent nodes to all nodes.
    """
    own, out = np.zeros_like(values), Nodal([basis.nodes], [values.shape[1]])
    own[: basis.nodes.owned] = values[: basis.nodes.owned]
    out.arrays[0][:] = C.T @ own
    out.add_up()
    out.spread()
    return np.maximum(out.arrays[0], 0.0)


def radii(basis: LatticeBasis, nodes: npt.NDArray[np.intp], axis: int, end: int) -> Array:
    """Radii of the centroids of the nodes' functions on a side (m), of an axisymmetric grid.

    Args:
        basis: The basis.
        nodes: Nodes on the side, shape (n,).
        axis, end: Direction of the side's normal, and 0 for the lower or 1 for the upper end.
    """
    line = basis.lattice.lines[0]
    if axis == 0:
        return np.full(nodes.size, line[-1 if end else 0])
    return middles(line, basis.degree)[basis.halo.node_ijk[nodes, 0]]


def areas(
    basis: LatticeBasis,
    nodes: npt.NDArray[np.intp],
    axis: int,
    within: Mapping[int, tuple[float, float]] | None = None,
) -> Array:
    """Integrals of the nodes' functions over a side (m^(d-1)).

    Args:
        basis: The basis.
        nodes: Nodes on the side, shape (n,).
        axis: Direction of the side's normal.
        within: Ends of the part of the side that counts (m), by direction; else the whole side.
    """
    area = np.ones(nodes.size)
    for k, line in enumerate(basis.lattice.lines):
        if k == axis:
            continue
        if within and k in within:
            whole = integrals_within(line, basis.degree, *within[k])
        else:
            whole = integrals(line, basis.degree)
        area *= whole[basis.halo.node_ijk[nodes, k]]
    return area
