"""Material points: their arrays, and the fields that a weak form may contain."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from dolfinx.mesh import Mesh

from dolfinmpm._platform.argumentchecks import truth
from dolfinmpm._platform.collective import collective
from dolfinmpm._platform.errors import DolfinMPMError, call_together, raise_together
from dolfinmpm.body import pointchanges, pointfiles, pointinput
from dolfinmpm.body.axisymmetry import require_axis, ring
from dolfinmpm.body.fields import PointField
from dolfinmpm.body.location import Destinations, bounds, destinations
from dolfinmpm.body.migration import migrate
from dolfinmpm.body.pointchanges import PointChange
from dolfinmpm.body.pointchecks import astray, checked_rows, fault, require_grid
from dolfinmpm.body.pointsymbols import ACTIVE_CELLS, GHOST_FACETS, UNSET
from dolfinmpm.body.pointtable import BUILT_IN, PointTable
from dolfinmpm.grid.partition import Partition

__all__ = [
    "ACTIVE_CELLS",
    "GHOST_FACETS",
    "MOTION",
    "UNSET",
    "MaterialPoints",
    "PointChange",
    "PointField",
]

# Those that change as a body moves, and that no law asks for before it does
MOTION = frozenset(("cell", "x", "V", "F", "l", "stress", "velocity", "acceleration"))
_RESERVED = ("id", "cell", "tag", "moved_under", *BUILT_IN)

Density = npt.ArrayLike | Callable[[npt.NDArray[np.float64]], npt.ArrayLike]


class MaterialPoints(PointTable):
    """The material points of a body, each on the rank that owns the cell it is in.

    `points["name"]` is a field's array on this rank, `points.name` the same field
    for UFL. Every field moves with its point when the point changes rank.

    Measures for UFL; those over points may be of some tags alone, `points.dX(2)`:

    ==========  ==========================================================================
    measure     integrates over
    ==========  ==========================================================================
    points.dX   the points, with their first volume V0
    points.dx   the points, with their volume V at the start of the step
    points.dS   the facets of a ghost penalty, between active cells of which one is cut
    points.dC   the whole of the active cells, of which the body fills a part
    ==========  ==========================================================================

    Fields from the start (n points on this rank, d dimensions):

    ===========  ==========  =======  =====================================
    name         shape       unit     meaning
    ===========  ==========  =======  =====================================
    id           (n,)        -        number of the point, unique, constant
    cell         (n,)        -        local index of its cell
    tag          (n,)        -        which part of the body it belongs to, a whole number
    moved_under  (n,)        -        measure of strain that it has moved under, a number; 0: none
    x, x0        (n, d)      m        position, now and at first
    V, V0        (n,)        m^d      volume, now and at first
    density      (n,)        kg/m^d   mass per initial volume
    F            (n, e, e)   -        deformation gradient
    l, l0        (n, d)      m        half-lengths of the GIMP domain
    stress       (n, 3, 3)   Pa       Cauchy stress; set before the first step it is the initial
                                      one of the points' law, and later a result: see `set_stress`
    ===========  ==========  =======  =====================================

    Signs: stresses are positive in tension, wherever they are given or told. Pressures are positive
    in compression: of water, of loads, and of laws' parameters.

    e is `strain_dim`, the dimension of tensors that follow from gradients: d, or 3 where
    `axisymmetric`. Axisymmetric points go around the axis x[0] = 0: their volumes are in m³, 2π r
    times the area of their section, and so are their masses and forces. Gradients at them have a
    hoop term, see `dolfinmpm.body.axisymmetry`.

    Points come from `fill`, from `from_arrays`, `from_csv` and `from_mesh`, and from `a + b`; the
    constructor takes what these have found. Arrays in `fields` get other sizes when
    points are added or removed or change rank: take them anew after each step.

    Args:
        grid: Background grid.
        x: Positions (m), shape (n, d), each in a cell that this rank owns.
        cell: Local indices of those cells, shape (n,).
        volume: Volumes (m^d), shape (n,).
        half_length: Half-lengths of the points' domains (m), shape (n, d).
        density: Mass per volume (kg/m^d), a number or an array of shape (n,).
        tag: Which part of the body the points belong to: a whole number from 0, or an array of
            shape (n,).
        id: Their numbers, different on all ranks, shape (n,); by default in the order of the
            ranks.
        axisymmetric: Whether the body is one of revolution about x[0] = 0; volumes are those
            all around the axis then.

    Attributes:
        strain_dim: Dimension of the gradients' tensors, gdim or 3.
        total: Number of points on all ranks; needs no communication.
        dt: Time that the step's increments take (s), a constant for UFL that `Transient`,
            `Newmark` and `GeneralisedAlpha` set.
        inertia: Derivative of the body's acceleration by the increment (1/s²), a constant that
            these two set; see `mpm.acceleration`.
        revision: How many times the rows of the arrays have changed.
        restored: How many times all of them have been replaced by those of a checkpoint.
        partition: Which rank computes the points in a cell; None for the one that has it in
            DOLFINx's mesh.
        overlapping: Whether points may fill cells more than once, as where two of them are of one
            mixture. If not, which is so at first, bodies that overlap are not joined, nor do points
            that fill a cell more than once make a problem.
        roomy: The revision at which cells were last found not to be overfilled.
        shape_volume: Volume (m^d) of the shape that `fill` put the points into, None if unknown.
        volume_error: Relative error of the points' first volume, or None likewise.

    Raises:
        ParameterError: A density or a volume is not positive and finite, a half-length
            negative, not finite or larger than the grid's, a position not finite.
        FieldShapeError: An array has another shape.
        PointsOutsideGridError: A point is not in its cell.
        UnsupportedGridError: The cells are curved, or coordinates of single precision; the grid of
            axisymmetric points is not two-dimensional, or reaches beyond the axis.

    Fields are arrays, and names of fields are symbols for UFL:

    >>> import dolfinmpm as mpm
    >>> from mpi4py import MPI
    >>> grid = mpm.create_lattice(MPI.COMM_WORLD, [range(5), range(5)])
    >>> points = mpm.fill(grid, mpm.Box((0, 0), (4, 2)), per_cell=2, density=2000.0)
    >>> points.total, points["x"].shape, points.x.ufl_shape
    (32, (32, 2), (2,))
    >>> points["density"][points["x"][:, 1] > 1.0] = 1800.0
    >>> float(points["V"] @ points["density"])
    15200.0
    >>> water = points.add_field("saturation", unit="-", value=1.0)
    >>> points["saturation"].sum().item()
    32.0
    """

    @collective(local=("x", "cell", "volume", "half_length", "density", "tag", "id"))
    def __init__(
        self,
        grid: Mesh,
        x: npt.NDArray[np.float64],
        cell: npt.NDArray[np.int32],
        volume: npt.NDArray[np.float64],
        half_length: npt.NDArray[np.float64],
        density: float | npt.NDArray[np.float64],
        *,
        tag: int | npt.NDArray[np.int32] = 0,
        id: npt.NDArray[np.int64] | None = None,
        axisymmetric: bool = False,
    ):
        require_grid(grid)
        axisymmetric = truth("axisymmetric", axisymmetric)
        if axisymmetric:
            require_axis(grid)
        super().__init__(grid, axisymmetric)
        # which positions their ranks and cells are those of; see `settle`
        self.configuration = "updated"
        self.overlapping = False
        # the revision that is known not to overlap
        self.roomy = -1
        self.shape_volume: float | None = None
        self.volume_error: float | None = None
        self.restored = 0
        self.partition: Partition | None = None
        bounds(grid)  # all ranks ask for them together, once

        given = x, cell, volume, half_length, density, tag, id
        values = call_together(self.comm, lambda: checked_rows(grid, *given, axisymmetric))
        if id is None:
            values["id"] += self.comm.exscan(len(values["id"])) or 0
        self.take_first(values)
        self._located = math.nan
        raise_together(self.comm, self.fault())
        self.recount()

    # -- where points come from -----------------------------------------------

    @classmethod
    @collective(local=("x", "volume", "density", "tag", "half_length", "fields", "id"))
    def from_arrays(
        cls,
        grid: Mesh,
        x: npt.ArrayLike,
        volume: npt.ArrayLike,
        density: Density,
        *,
        tag: npt.ArrayLike = 0,
        half_length: npt.ArrayLike | None = None,
        fields: Mapping[str, npt.ArrayLike] | None = None,
        id: npt.ArrayLike | None = None,
        axisymmetric: bool = False,
    ) -> MaterialPoints:
        """Points at given positions, wherever they are on the grid. Collective.

        Each rank gives some of the points, which may be all, or none. Points that several
        ranks give alike count once, so that a script that makes all of them on every
        rank needs no change.

        Args:
            grid: Background grid.
            x: Positions (m), shape (n, gdim).
            volume: Volumes (m^d), a number or shape (n,); of axisymmetric bodies the whole ones
                (m³).
            density: Mass per volume (kg/m^d): a number, shape (n,), or a function of
                positions in DOLFINx's layout, shape (gdim, n), to n values.
            tag: Which part of the body the points belong to, a number or shape (n,).
            half_length: Half-lengths of the points' domains (m): a number, shape (gdim,) or
                (n, gdim); by default those of a cube of the point's volume, or of a square of the
                area of the ring's section.
            fields: Further fields by name, shape (n, ...); `stress` too, shape (n, 3, 3), which
                the law of a problem takes as its initial stress.
            id: Numbers of the points, shape (n,); by default in the order of their
                coordinates, whatever rank gave them.
            axisymmetric: Whether the body is one of revolution about x[0] = 0.

        Raises:
            FieldShapeError: An array has the wrong shape, or the ranks give different fields.
            ParameterError: A value is impossible, two points of a rank are in the same
                place, ranks give different values for one, or a number is given twice.
            PointsOutsideGridError: Points are outside the grid.
            EmptyShapeError: There is no point.
            UnsupportedGridError: The cells are curved, or coordinates of single precision.
        """
        rows, others = pointinput.located(
            grid, x, volume, density, tag, half_length, fields or {}, id, axisymmetric,
            reserved=tuple(name for name in _RESERVED if name != "stress"),
        )  # fmt: skip
        points = cls(grid, **rows, axisymmetric=axisymmetric)
        for name, values in others.items():
            points.add_field(name, values.shape[1:])
            points[name] = values
        return points

    @classmethod
    @collective
    def from_csv(
        cls,
        grid: Mesh,
        path: str | Path,
        *,
        density: Density | None = None,
        tag: int = 0,
        delimiter: str = ",",
        axisymmetric: bool = False,
    ) -> MaterialPoints:
        """Points from a table of text, one per line, read on rank 0. Collective.

        The first line names the columns: `x`, `y`, `z` as far as the grid has them and
        `volume`; `density`, `tag` and `id` if they are not given otherwise. Every other
        column becomes a scalar field of its name. Numbers are in metres, m^d and kg/m^d.

        Args:
            grid: Background grid.
            path: The file, in UTF-8.
            density: As `from_arrays`, for a file without that column.
            tag: Tag of the points of a file without that column.
            delimiter: What separates columns.
            axisymmetric: As `from_arrays`.

        Raises:
            ParameterError: A column is missing, named twice or has no value that is a
                number; the message has line and column. Or as `from_arrays`.
            OSError: The file cannot be read.
        """
        rows = pointfiles.from_csv(grid, path, density, tag, delimiter)
        return cls.from_arrays(grid, **rows, axisymmetric=axisymmetric)

    @classmethod
    @collective(local=("mesh",))
    def from_mesh(
        cls,
        grid: Mesh,
        mesh: Any,
        density: Density | Mapping[int, float],
        *,
        points: str = "quadrature",
        degree: int = 2,
        tag: int | None = None,
        axisymmetric: bool = False,
    ) -> MaterialPoints:
        """Points in the cells of a mesh of the body, such as Gmsh's. Collective.

        Needs meshio. Cells are intervals, triangles, quadrilaterals, tetrahedra or hexahedra with
        straight edges, those of the grid's dimension; others in the file are passed over.
        The volumes of the points of a cell are its own together.

        Args:
            grid: Background grid; it need not fit the mesh.
            mesh: A file that meshio reads, or a `meshio.Mesh`; what rank 0 has is taken.
            density: As `from_arrays`, or by tag: `{1: 2000.0, 2: 1800.0}`.
            points: "quadrature" puts them at the quadrature points of each cell, "centres" at
                the centroid.
            degree: Degree of the polynomials that the quadrature integrates.
            tag: Tag of all the points; by default the number of the physical group of
                their cell, 0 for cells in none.
            axisymmetric: Whether the mesh is the section of a body of revolution about x[0] = 0.

        Raises:
            ParameterError: `points` or `degree` is not what it may be, a cell has no volume, or
                the density of a tag is missing.
            UnsupportedGridError: The mesh has other cells, or none of the grid's dimension.
            PointsOutsideGridError: Points are outside the grid.
            OSError: The file cannot be read.
        """
        rows = pointfiles.from_mesh(grid, mesh, density, points, degree, tag)
        if truth("axisymmetric", axisymmetric):
            rows["volume"] = ring(rows["x"][:, 0], rows["volume"])
        return cls.from_arrays(grid, **rows, axisymmetric=axisymmetric)

    # -- changes of the body --------------------------------------------------

    @collective
    def __add__(self, other: MaterialPoints) -> MaterialPoints:
        """A body of the points of both, with all their fields. Collective.

        Both stay as they are. Points of a body that lacks a field of the other get the
        value that it had at first; numbers are given anew to the points of the second.

        Raises:
            ParameterError: The other is no set of points of this grid, points of both are in
                the same place, or both fill a cell more than once; see `overlapping`.
            FieldShapeError: A field has another shape in the other body.
        """
        return pointchanges.joined(self, other)

    @collective
    def add(self, other: MaterialPoints) -> PointChange:
        """Take the points of another body in, between steps. Collective.

        Problems that hold these points go on with all of them. The new points get what a
        law keeps at its points as it is at first, and numbers that follow those of these.

        Args:
            other: Points on the same grid; it stays as it is.

        Returns:
            How many points came, and their mass, over all ranks.

        Raises:
            ParameterError, FieldShapeError: As for `a + b`; no point is added then.
        """
        return pointchanges.add(self, other)

    @collective(local=("where",))
    def remove(
        self,
        where: Callable[[npt.NDArray[np.float64]], npt.ArrayLike] | npt.ArrayLike | None = None,
        *,
        tag: int | None = None,
    ) -> PointChange:
        """Take points away, between steps. Collective.

        Problems that hold these points go on with those that are left.

        Args:
            where: Which: a function of present positions (m) in DOLFINx's layout, shape
                (gdim, n), that returns n booleans, or n booleans for the points of this rank.
            tag: Which, instead: those of this tag, which some point must have.

        Returns:
            How many points went, and their mass, over all ranks.

        Raises:
            ParameterError: Neither or both are given, `where` does not give booleans, no
                point has the tag, or none would be left.
            FieldShapeError: Their number is not that of the points.
        """
        return pointchanges.remove(self, where, tag)

    def fault(self) -> DolfinMPMError | None:
        """What is impossible in the fields of this rank's points, or None."""
        error = fault(self)
        updated = self.configuration == "updated"
        if error is None and updated and self._located != (place := self.fields.read("x").sum()):
            # steps find the cells of what they move: x was changed by hand
            error = astray(self)
            self._located = place if error is None else math.nan
        return error

    @collective
    def locate(self) -> int:
        """Find cells and ranks of points whose x was changed by hand. Collective.

        Returns:
            How many points changed rank, over all ranks.

        Raises:
            PointsOutsideGridError: Points are outside the grid.
        """
        x = self.placement(self.configuration).x
        to = destinations(self.grid, x, self["cell"], self.partition)
        raise_together(self.comm, pointinput.outside(x, self["id"], to))
        return self.migrate(to)

    def migrate(self, to: Destinations) -> int:
        """Hand points to the ranks that compute their cells; returns how many moved. Collective."""
        moved = migrate(self, to)
        # where points stay in the cells of their first positions nobody asks for those of now
        self._located = self.fields.read("x").sum()
        self.revision += moved > 0
        return moved
