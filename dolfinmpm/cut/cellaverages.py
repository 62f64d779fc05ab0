"""Averages of point values over cells or splines.

A scalar m at the points has in cell c the average M_c = Σ_q s_qc V_q m_q / W_c with
W_c = Σ_q s_qc V_q. The sums are over the points of all ranks whose domains lie in the cell with the
shares s_qc. The average at point p is m̄_p = Σ_c s_pc M_c.

Splines of degree 2 and more can alternate from cell to cell without an average over any cell. There
would be no stiffness against such a change of volume. So their averages are taken over the splines
one degree lower on the same cells, as in the B-bar and F-bar projections of Elguedj, Bazilevs, Calo
& Hughes (2008, doi 10.1016/j.cma.2008.01.012), with a lumped mass matrix: s_pc is the value at the
point of the lower spline c, averaged over the point's domain like the basis. All shares are not
negative and sum to 1 at a point. Below, "cell" means a lower spline too.
"""

from __future__ import annotations

import weakref
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numba
import numpy as np
import numpy.typing as npt
from dolfinx.la import InsertMode
from mpi4py import MPI

from dolfinmpm.basis import LatticeBasis, LeafBasis, LinearBasis, Placement, Stencils
from dolfinmpm.basis.space import lattice_basis
from dolfinmpm.basis.stencils import add_weighted
from dolfinmpm.body.location import bounds
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.cut.fractions import domain_shares
from dolfinmpm.cut.prolongation import Prolongation
from dolfinmpm.forms.pointterms import PointTerms
from dolfinmpm.grid.halo import Numbering
from dolfinmpm.grid.lattice import once_per_grid

if TYPE_CHECKING:
    from dolfinmpm.cut.activation import ActiveDomain, ActiveField

__all__ = [
    "CellAverages",
    "Shares",
    "averages_of",
    "averaging_field",
    "layers_needed",
    "numbering",
    "sharing_stencils",
]

Array = npt.NDArray[np.float64]
Basis = LatticeBasis | LeafBasis | LinearBasis


@numba.njit(cache=True, error_model="numpy")
def _to_points(order, groups, cell_start, cells, share_start, shares, values, out):
    for g in range(groups.size - 1):
        number = cell_start[g + 1] - cell_start[g]
        for position in range(groups[g], groups[g + 1]):
            start = share_start[g] + (position - groups[g]) * number
            value = 0.0
            for k in range(number):
                value += shares[start + k] * values[cells[cell_start[g] + k]]
            out[order[position]] = value


@numba.njit(cache=True, error_model="numpy")
def _largest_shares(groups, cell_start, share_start, shares, out):
    for g in range(groups.size - 1):
        number = cell_start[g + 1] - cell_start[g]
        for row in range(groups[g + 1] - groups[g]):
            for k in range(number):
                share = shares[share_start[g] + row * number + k]
                out[cell_start[g] + k] = max(out[cell_start[g] + k], share)


@dataclass(frozen=True)
class Shares:
    """Shares of the points in cells or lower splines; those of a point sum to 1.

    Attributes:
        cells: Numbering of the cells, or of the splines.
        cell_start: First entry of every group of the stencils in `of`, shape (groups + 1,).
        of: Local indices of the cells in which the group's points have shares.
        start: First entry of every group in `values`, shape (groups + 1,).
        values: The shares (-): per point of a group one row with the group's cells.
    """

    cells: Numbering
    cell_start: npt.NDArray[np.int32]
    of: npt.NDArray[np.int32]
    start: npt.NDArray[np.int64]
    values: Array

    def pairs(self, groups: npt.NDArray[np.int32]) -> npt.NDArray[np.intp]:
        """Positions in `of` of the cells in which a point of the group has a share.

        Args:
            groups: First point of every group of the stencils, shape (groups + 1,).
        """
        largest = np.zeros(self.of.size)
        _largest_shares(groups, self.cell_start, self.start, self.values, largest)
        return np.flatnonzero(largest)


@once_per_grid
def _lower_splines(grid, degree: int, averaged: bool, coarsen: int) -> LatticeBasis:
    """Splines for averages only, with the overlap of the field's basis. Collective.

    They are no basis of a field: the numbering of another field must not change with this overlap.
    """
    return lattice_basis(grid, degree, averaged, coarsen)


def _over_splines(basis: Basis) -> bool:
    """Whether averages are taken over splines one degree lower, instead of cells."""
    return basis.degree > 1


def sharing_stencils(where: Placement, stencils: Stencils, basis: Basis) -> Stencils:
    """Stencils with the cells, or the splines one degree lower, of the points. Collective.

    Args:
        where: Positions, half-lengths and volumes of the points.
        stencils: Their stencils in the basis.
        basis: The basis of the field.
    """
    if not _over_splines(basis):
        return stencils
    lower = _lower(basis)
    found = lower.stencils(where)
    if isinstance(lower, LeafBasis):
        return Prolongation(lower.hanging).stencils(found)
    return found


# lower splines on leaves, by the basis of the field
_ON_LEAVES: weakref.WeakKeyDictionary[LeafBasis, LeafBasis] = weakref.WeakKeyDictionary()


def _lower(basis: Basis) -> LatticeBasis | LeafBasis:
    """Splines one degree lower, with the same overlap of ranks. Collective."""
    assert isinstance(basis, LatticeBasis | LeafBasis)
    lower = _lower_splines(basis.grid, basis.degree - 1, basis.averaged, basis.coarsen)
    if isinstance(basis, LatticeBasis):
        return lower.grown(basis.halo.layers, basis.partition)
    if basis not in _ON_LEAVES:
        _ON_LEAVES[basis] = LeafBasis(lower, basis.leaves, basis.layers, basis.partition)
    return _ON_LEAVES[basis]


def shares_of(where: Placement, stencils: Stencils, basis: Basis) -> Shares:
    """Shares of the points in cells, or in splines one degree lower. Collective.

    Args:
        where: Positions, half-lengths and volumes of the points.
        stencils: Result of `sharing_stencils`, in any groups.
        basis: The basis of the field.
    """
    s = stencils
    if _over_splines(basis):
        return Shares(_lower(basis).nodes, s.node_start, s.nodes, s.value_start, s.N)
    start, values = domain_shares(where, s, basis)
    return Shares(basis.cells, s.cell_start, s.cells, start, values)


def numbering(basis: LatticeBasis) -> tuple[Numbering, npt.NDArray[np.int32]]:
    """Numbering of the cells, or splines one degree lower, of averages. Collective.

    Args:
        basis: The basis of the field, with the overlap for averages.

    Returns:
        The numbering, and lattice positions, shape (size, gdim).
    """
    if not _over_splines(basis):
        return basis.cells, basis.halo.cell_ijk
    lower = _lower(basis)
    assert isinstance(lower, LatticeBasis)
    return lower.nodes, lower.halo.node_ijk


def layers_needed(span: int, basis: Basis) -> int:
    """Layers of cells around the cells of a rank that couplings by averages need.

    The rank that owns a cell, or a lower spline, must know all nodes of the points in the cell.
    The domains of the points reach as far as they span cells. The support of a spline of degree 1
    or 2 reaches to the neighbours of its own cell. A prolongation adds the distance of roots.

    Args:
        span: Largest number of cells that a point's domain spans in one direction.
        basis: The basis of the field.
    """
    return span - 1 + int(_over_splines(basis))


def averaging_field(region: PointTerms, here: ActiveDomain) -> ActiveField:
    """The field whose cells the means of a region belong to."""
    found = here.fields[0]
    for field in (here.fields[k] for k in here.movers):
        if field.space.tags is not None and (region.tags or set()) <= set(field.space.tags):
            found = field
    return found


def averages_of(
    region: PointTerms, points: MaterialPoints, where: Placement, shared: Stencils, basis: Basis
) -> CellAverages:
    """The means over cells of a region. Collective.

    Args:
        region: The region.
        points: Material points.
        where: Their positions and domains for the stencils.
        shared: Result of `sharing_stencils`, in any groups.
        basis: The basis of the field.
    """
    if region.by_centres:
        # a point on the grid's upper edge is in the last cell
        inside = np.nextafter(bounds(points.grid)[1], -np.inf)
        x = np.minimum(where.x, inside)
        where = replace(where, x=x, half=np.zeros_like(where.half))
    return CellAverages(points["V"], where, shared, basis)


class CellAverages:
    """Averages over cells, weighted by the present volumes of the points. Collective.

    Args:
        volume: Present volumes of the points (m^d), shape (points,).
        where: Positions, half-lengths and volumes of the points.
        stencils: Result of `sharing_stencils`, in any groups.
        basis: The basis of the field.

    Attributes:
        shares: Shares of the points in the cells.
        volume: W_c, the volume of the points in every local cell (m^d), shape (cells,).
        weight: V, the volumes of the points (m^d), shape (points,).
        exchanges: Whether points of a rank have shares in cells of another rank.
    """

    def __init__(
        self,
        volume: Array,
        where: Placement,
        stencils: Stencils,
        basis: Basis,
    ):
        self.shares = shares = shares_of(where, stencils, basis)
        cells, of = shares.cells, shares.of
        self._graph = (
            stencils.order, stencils.groups, shares.cell_start, of, shares.start, shares.values
        )  # fmt: skip
        self._shared = cells.vector()
        # with linear functions, points have shares in cells of their own rank only
        beyond = cells.comm.size > 1 and of.size > 0 and int(of.max()) >= cells.owned
        self.exchanges = cells.comm.size > 1 and cells.comm.allreduce(bool(beyond), op=MPI.LOR)
        self.weight = volume.copy()
        self.volume = self._sums(self.weight).copy()

    def _sums(self, values: Array) -> Array:
        out = self._shared.array
        out[:] = 0.0
        add_weighted(*self._graph, values, out)
        if self.exchanges:
            self._shared.scatter_reverse(InsertMode.add)
            self._shared.scatter_forward()
        return out

    def mean(self, values: Array) -> Array:
        """Averages m̄ at the points of a scalar m at the points, shape (points,). Collective."""
        sums = self._sums(self.weight * values)
        of_cell = np.divide(sums, self.volume, out=np.zeros_like(sums), where=self.volume > 0)
        # points without shares have no average
        out = np.zeros(len(values))
        _to_points(*self._graph, of_cell, out)
        return out
