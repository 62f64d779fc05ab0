"""Sides that move alike: a part of ground that repeats itself without end in one direction."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm._platform.argumentchecks import check_kind, number, whole
from dolfinmpm._platform.collective import collective
from dolfinmpm._platform.errors import (
    ParameterError,
    UnsupportedGridError,
    raise_together,
)
from dolfinmpm._platform.uncopied import Unchanged
from dolfinmpm.basis import LatticeBasis
from dolfinmpm.basis.space import Space
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.cut.stabilisations import Stabilisation
from dolfinmpm.grid.lattice import lattice_of, require_lattice
from dolfinmpm.grid.linecells import coordinate_rounding

__all__ = ["TiedSides", "tied"]

Array = npt.NDArray[np.float64]
# Share of a period's cells that bodies may fill. Points at cut sides count in the cells of their
# centres, so that a cell may seem to hold half as much again.
_FULL = 1.6


@collective
def tied(space: Space, period: float, *, axis: int = 0) -> TiedSides:
    """Tied sides: nodes one period apart in one direction have the same motion. Collective.

    The body is one period long, and the ground repeats itself without end. So both sides of the
    body move alike, and their cut cells complete each other: the sides are no boundary, wherever
    the body moves in the grid. This is the usual side condition of level ground in an earthquake
    (Zienkiewicz, Bicanic & Shen 1989).

    The grid must have at least one free cell beyond both sides of the body, on quadratic and cubic
    splines two, and one more for each cell that the body moves or begins to move. All ranks know
    all nodes, which limits the size of such problems on many ranks.

    Ghost penalties take the cells beside tied sides for cut cells, and would stiffen them. So the
    ghost penalty of the mass is 0 by default here. Where the surface cuts cells, take a lumped
    mass. Aggregation is refused: its nodes would follow one side of the body, and not the other.

    Args:
        space: Space of the displacement, on a rectangular grid with equal cells along `axis`.
        period: Length of the body along `axis` (m), a whole number of cells.
        axis: Direction in which the ground repeats itself.

    Returns:
        The argument `prolongation` of a problem.

    Raises:
        ParameterError: The period is no whole number of cells, or the axis does not exist.
        UnsupportedGridError: The grid is not rectangular, or the space is refined.

    A column of one cell is level ground; its sides shear:

    >>> import dolfinmpm as mpm
    >>> from mpi4py import MPI
    >>> grid = mpm.create_lattice(MPI.COMM_WORLD, [range(4), range(6)])
    >>> points = mpm.fill(grid, mpm.Box((1, 0), (2, 4)), per_cell=2, density=2000.0)
    >>> V = mpm.Space(grid, "gimp")
    >>> F = mpm.momentum(mpm.materials.Hencky(1e6, 0.3), points, V.increment, V.test)
    >>> sides = mpm.tied(V, period=1.0)
    >>> bcs = mpm.fixed(V, "bottom")
    >>> problem = mpm.Newmark(F, V.increment, points, bcs, prolongation=sides, mass="lumped")
    >>> points["velocity"] = (0.1, 0.0)
    >>> record = problem.step(0.05)
    >>> bool(abs(points["x"][:, 1] - points["x0"][:, 1]).max() < 1e-3)
    True
    """
    check_kind("space", space, Space, "make it with mpm.Space(grid)")
    require_lattice(space.grid, "tied")
    if space.refinement is not None:
        raise UnsupportedGridError(
            "tied sides need cells of one size along them, and the space is refined: leave out "
            "refine=, or give create_lattice smaller cells where they are wanted"
        )
    d = space.grid.geometry.dim
    axis = whole("axis", axis, 0, d - 1)
    basis = space.basis
    assert isinstance(basis, LatticeBasis)
    line = basis.lattice.lines[axis]
    sizes, far = np.diff(line), coordinate_rounding(line[0], line[-1], 0.0)
    h = float(sizes.mean())
    if np.abs(sizes - h).max() > max(1e-9 * h, far):
        raise ParameterError(
            f"tied sides need equal cells along the axis {axis}; they are {sizes.min():g} to "
            f"{sizes.max():g} m long"
        )
    # a period of two grids is refused before the first step
    count = round(min(number("period", period, 0.0, unit="m") / h, 2.0 * sizes.size))
    if count < 1 or abs(count * h - period) > max(1e-9 * period, far):
        raise ParameterError(
            f"period = {period:g} m must be a whole number of cells of {h:g} m: take "
            f"{max(count, 1) * h:g} m"
        )
    return TiedSides(axis, count, sizes.size)


class TiedSides(Unchanged):
    """Constraints between nodes one period apart, see `tied`.

    Args:
        axis: The direction.
        count: Number of cells in a period.
        cells: Number of cells of the grid along the axis.

    Attributes:
        axis, count: The arguments.
        layers: Layers of cells around a rank's own cells that the constraints need.
    """

    def __init__(self, axis: int, count: int, cells: int):
        self.axis, self.count, self.layers = axis, count, cells

    def __call__(self, stencils: Any, nodes: npt.NDArray[np.int32]) -> Any:
        """Not in use: the constraints need the basis, see `of_basis`."""
        raise ParameterError("tied sides are for the argument prolongation of a problem")

    def check(self, points: MaterialPoints, stabilisations: Sequence[Stabilisation]) -> None:
        """Raise ParameterError if a body or a stabilisation does not go with the ties. Collective.

        Args:
            points: Material points.
            stabilisations: The stabilisations of the fields.
        """
        kinds = [each.kind for each in stabilisations if each.constrains_nodes]
        if kinds:
            raise ParameterError(
                f'stabilisation = "{kinds[0]}" makes nodes beside one side of the body follow '
                "those within, and tied sides those of the other side: the ground would not repeat "
                'itself; take "none", or "ghost" with a lumped mass'
            )
        lattice = lattice_of(points.grid)
        assert lattice is not None
        line, axis = lattice.lines[self.axis], self.axis
        h = float(line[-1] - line[0]) / (line.size - 1)
        x, half, period = points["x"], points["l"], self.count * h
        low, high = x[:, axis] - half[:, axis], x[:, axis] + half[:, axis]
        ends = np.array(
            [high.max(initial=-np.inf), -low.min(initial=np.inf), half.max(initial=0.0)]
        )
        points.comm.Allreduce(MPI.IN_PLACE, ends, op=MPI.MAX)
        length, size = float(ends[0] + ends[1]), float(ends[2])
        full = self._most_filled(points, lattice)
        if length < period - 2.0 * size or full > _FULL:
            what = f"{full:.3g} times as much as its cells hold" if full > _FULL else "a gap"
            raise ParameterError(
                f"period = {period:g} m, and the body is {length:.6g} m long along the axis "
                f"{axis}: ground that repeats itself so has {what}; give the length of the body"
            )

    def _most_filled(self, points: MaterialPoints, lattice: Any) -> float:
        """Largest volume of the points in a cell of the period over its own volume. Collective."""
        cell: npt.NDArray[np.int64] = np.zeros(len(points), np.int64)
        volume: Array = np.ones(1)
        for k, line in enumerate(lattice.lines):
            x, sizes = points["x"][:, k], np.diff(line)
            number = np.clip(np.searchsorted(line, x, "right") - 1, 0, sizes.size - 1)
            if k == self.axis:
                number, sizes = number % self.count, sizes[: self.count]
            cell = cell * sizes.size + number
            volume = np.multiply.outer(volume, sizes).ravel()
        filled = np.bincount(cell, points["V"], volume.size).astype(np.float64)
        points.comm.Allreduce(MPI.IN_PLACE, filled, op=MPI.SUM)
        return float((filled / volume).max())

    def of_basis(self, basis: LatticeBasis, nodes: npt.NDArray[np.int32]) -> Any:
        """The matrix C, shape (nodes, nodes): each node follows the first active one of its class.

        Collective.

        Args:
            basis: The basis, in which this rank knows all nodes along the axis.
            nodes: Active nodes.

        Raises:
            ParameterError: The body has no free cell beside it.
        """
        from scipy import sparse

        ijk = basis.halo.node_ijk[nodes].astype(np.int64)
        along = ijk[:, self.axis]
        last = basis.lattice.shape[self.axis] + basis.degree - 1
        free = max(basis.degree - 1, 0)
        error = None
        if nodes.size and (along.min() <= free or along.max() >= last - free):
            error = ParameterError(
                "tied sides need free cells beside the body, two or three where it moves a little: "
                f"the body reaches an end of the grid along the axis {self.axis}; add cells there"
            )
        raise_together(basis.grid.comm, error)
        others = np.delete(ijk, self.axis, axis=1)
        key = np.column_stack([others, along % self.count])
        _, group = np.unique(key, axis=0, return_inverse=True)
        group = group.reshape(-1)
        order = np.lexsort((along, group))
        first = np.full(group.max(initial=-1) + 1, -1)
        # written from the last to the first, the first active node of each class stays
        first[group[order[::-1]]] = nodes[order[::-1]]
        size = basis.nodes.size
        master = np.arange(size)
        master[nodes] = first[group]
        return sparse.csr_matrix((np.ones(size), (np.arange(size), master)), shape=(size, size))
