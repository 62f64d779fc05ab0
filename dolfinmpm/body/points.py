"""Material points: their arrays, and the fields that a weak form may contain."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any
from weakref import WeakSet

import numpy as np
import numpy.typing as npt
from dolfinx.mesh import Mesh

from dolfinmpm._platform.argumentchecks import shown, truth
from dolfinmpm._platform.collective import collective
from dolfinmpm._platform.errors import ParameterError, call_together, raise_together
from dolfinmpm.body import pointchanges, pointfiles, pointinput
from dolfinmpm.body.axisymmetry import require_axis
from dolfinmpm.body.fields import PointField
from dolfinmpm.body.location import bounds
from dolfinmpm.body.pointchanges import PointChange
from dolfinmpm.body.pointchecks import checked_rows, require_grid
from dolfinmpm.body.pointsymbols import ACTIVE_CELLS, GHOST_FACETS, UNSET
from dolfinmpm.body.pointtable import PointTable
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

# Fields that change as the body moves, and that no law needs before the first step
MOTION = frozenset(("cell", "x", "V", "F", "l", "stress", "velocity", "acceleration"))

Density = npt.ArrayLike | Callable[[npt.NDArray[np.float64]], npt.ArrayLike]


class MaterialPoints(PointTable):
    """The material points of a body, each on the rank that computes its cell.

    `points["name"]` is the array of a field on this rank. `points.name` is the same field for UFL.
    When a point changes rank, all its fields move with it.

    Measures for UFL; a measure over points may be for some tags only, `points.dX(2)`:

    ==========  ==========================================================================
    measure     integrates over
    ==========  ==========================================================================
    points.dX   the points, with their first volume V0
    points.dx   the points, with their volume V at the start of the step
    points.dS   the facets of a ghost penalty, between two active cells, one of them cut
    points.dC   the whole active cells, whether the body fills them or not
    ==========  ==========================================================================

    Fields from the start (n points on this rank, d dimensions):

    ===========  ==========  =======  =====================================
    name         shape       unit     meaning
    ===========  ==========  =======  =====================================
    id           (n,)        -        number of the point, unique, constant
    cell         (n,)        -        local index of the point's cell
    tag          (n,)        -        part of the body, a whole number
    moved_under  (n,)        -        strain formulation of the last step, as a number; 0: none
    x, x0        (n, d)      m        present position, first position
    V, V0        (n,)        m^d      present volume, first volume
    density      (n,)        kg/m^d   mass per initial volume
    F            (n, e, e)   -        deformation gradient
    l, l0        (n, d)      m        half-lengths of the GIMP domain, present and first
    stress       (n, 3, 3)   Pa       Cauchy stress; before the first step the initial stress for
                                      the law, later a result: see `set_stress`
    ===========  ==========  =======  =====================================

    Signs: all stresses are positive in tension. All pressures are positive in compression: of
    water, of loads, and in parameters of laws.

    e is `strain_dim`, the dimension of deformation gradients: d, or 3 if `axisymmetric`.
    Axisymmetric points go around the axis x[0] = 0. Their volumes are in m³, 2π r times the area
    of their section. Masses and forces also go around the axis, and gradients have a hoop term, see
    `dolfinmpm.body.axisymmetry`.

    Points are made by `fill`, `from_arrays`, `from_csv`, `from_mesh`, and `a + b`, which call the
    constructor. Arrays in `fields` change their sizes when points are added or removed, or change
    rank, and explicit steps sort their rows by cells: read them again after each step. What must
    stay with its point is a field (`add_field`); `id` tells which point a row is.

    Args:
        grid: Background grid.
        x: Positions (m), shape (n, d), each in a cell of this rank.
        cell: Local indices of the points' cells, shape (n,).
        volume: Volumes (m^d), shape (n,).
        half_length: Half-lengths of the points' domains (m), shape (n, d).
        density: Mass per volume (kg/m^d), a number or shape (n,).
        tag: Part of the body: a whole number from 0, or shape (n,).
        id: Numbers of the points, different on all ranks, shape (n,); by default by the ranks.
        axisymmetric: Whether the body is axisymmetric about x[0] = 0; volumes then go around it.

    Attributes:
        strain_dim: Dimension of deformation gradients, gdim or 3.
        total: Number of points on all ranks; reading it needs no communication.
        dt: Time of the step's increments (s), a constant for UFL that `Transient`, `Newmark` and
            `GeneralisedAlpha` set.
        inertia: Derivative of the body's acceleration by the increment (1/s²), a constant for UFL
            that `Newmark` and `GeneralisedAlpha` set; see `mpm.acceleration`.
        revision: Number of changes of the rows of the arrays.
        interval: Start and length of the present step (s), or shares of a step, for laws of time.
        restored: Number of replacements of all rows by the rows of a checkpoint.
        followers: Boundaries that follow the body; `remove` tells them what it took.
        partition: Rank that computes the points in a cell; None for the owner in DOLFINx's mesh.
        overlapping: Whether points may fill cells more than once, such as two phases of a mixture.
            False at first: then bodies that overlap cannot be joined, and points that overfill a
            cell cannot make a problem.
        roomy: The revision at which a check last found no overfilled cell.
        shape_volume: Volume of the shape that `fill` has filled (m^d), or None if not known.
        volume_error: Relative error of the points' first volume, or None if not known.

    Raises:
        ParameterError: A density or a volume is not positive and finite; a half-length is
            negative, not finite, or larger than the grid; or a position is not finite.
        FieldShapeError: An array has another shape.
        PointsOutsideGridError: A point is not in its cell.
        UnsupportedGridError: The cells are curved, or coordinates have single precision. For
            axisymmetric points: the grid is not two-dimensional, or reaches beyond the axis.

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
        self.overlapping = False
        self.roomy = -1
        self.shape_volume: float | None = None
        self.volume_error: float | None = None
        self.restored = 0
        self.followers: WeakSet[Any] = WeakSet()
        self.interval = 0.0, 1.0
        self.partition: Partition | None = None
        bounds(grid)  # the first call is collective

        given = x, cell, volume, half_length, density, tag, id
        values = call_together(self.comm, lambda: checked_rows(grid, *given, axisymmetric))
        if id is None:
            values["id"] += self.comm.exscan(len(values["id"])) or 0
        self.take_first(values)
        raise_together(self.comm, self.error_in_fields())
        self.recount()

    # -- constructors ---------------------------------------------------------

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
        """Points at given positions, anywhere on the grid. Collective.

        Each rank gives some points, all points or none. A point that several ranks give with the
        same values counts once. A script that makes all points on every rank needs no change.

        Args:
            grid: Background grid.
            x: Positions (m), shape (n, gdim).
            volume: Volumes (m^d), a number or shape (n,). For axisymmetric bodies, volumes around
                the axis (m³).
            density: Mass per volume (kg/m^d): a number, shape (n,), or a function of positions,
                shape (gdim, n), that returns n values.
            tag: Part of the body, a whole number or shape (n,).
            half_length: Half-lengths of the points' domains (m): a number, shape (gdim,) or
                (n, gdim). The default is a cube of the point's volume, or a square of the area of
                the section.
            fields: Further fields by name, shape (n, ...). `stress`, shape (n, 3, 3), is the
                initial stress for the law.
            id: Numbers of the points, shape (n,); by default in the order of the coordinates.
            axisymmetric: Whether the body is axisymmetric about x[0] = 0.

        Raises:
            FieldShapeError: An array has another shape, or ranks give different fields.
            ParameterError: A value is impossible, two points of a rank have the same position,
                ranks give different values for a point, or a number is given twice.
            PointsOutsideGridError: Points are outside the grid.
            EmptyShapeError: There is no point.
            UnsupportedGridError: The cells are curved, or coordinates have single precision.
        """
        rows, others = pointinput.located(
            grid, x, volume, density, tag, half_length, fields, id, axisymmetric
        )
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
        """Points from a text table with one point per line. Rank 0 reads the file. Collective.

        The first line names the columns: the coordinates `x`, `y`, `z` of the grid's dimension,
        `volume`, and optionally `density`, `tag` and `id`. Every other column becomes a scalar
        field with the column's name. Units are m, m^d and kg/m^d.

        Args:
            grid: Background grid.
            path: The file, in UTF-8.
            density: See `from_arrays`; for a file without the column `density`.
            tag: Tag of the points; for a file without the column `tag`.
            delimiter: Character between columns.
            axisymmetric: See `from_arrays`.

        Raises:
            ParameterError: A column is missing or named twice, or a value is no number; the
                message has line and column. See also `from_arrays`.
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
        """Points in the cells of a mesh of the body, such as a mesh of Gmsh. Collective.

        This needs meshio. Cells of the grid's dimension count: intervals, triangles,
        quadrilaterals, tetrahedra or hexahedra with straight edges. Other cells in the file are
        left out. The volumes of the points in a cell add up to the volume of the cell.

        Args:
            grid: Background grid; it need not fit the mesh.
            mesh: A file that meshio reads, or a `meshio.Mesh`, on rank 0.
            density: See `from_arrays`; or a dictionary by tag, `{1: 2000.0, 2: 1800.0}`.
            points: "quadrature" for points at the quadrature points of each cell, "centres" for
                one point at the centroid.
            degree: Degree of the polynomials that the quadrature integrates exactly.
            tag: Tag of all points. By default the number of the physical group of the cell, and 0
                without a group.
            axisymmetric: Whether the mesh is the section of an axisymmetric body about x[0] = 0.

        Raises:
            ParameterError: `points` or `degree` is not valid, a cell has no volume, or the density
                of a tag is missing.
            UnsupportedGridError: The mesh has other cells, or no cells of the grid's dimension.
            PointsOutsideGridError: Points are outside the grid.
            OSError: The file cannot be read.
        """
        rows = pointfiles.from_mesh(grid, mesh, density, points, degree, tag, axisymmetric)
        return cls.from_arrays(grid, **rows, axisymmetric=axisymmetric)

    # -- changes of the body --------------------------------------------------

    @collective
    def __add__(self, other: MaterialPoints) -> MaterialPoints:
        """A new body with the points of both bodies, and with all fields. Collective.

        Both bodies stay unchanged. If a body lacks a field of the other body, its points get the
        first value of the field. The points of the second body get new numbers.

        Raises:
            ParameterError: `other` is no set of points on this grid, points of both bodies have
                the same position, or the bodies overfill a cell; see `overlapping`.
            FieldShapeError: A field has another shape in the other body.
        """
        return pointchanges.joined(self, other)

    def __radd__(self, other: Any) -> MaterialPoints:
        """The body itself for 0, so that `sum` joins bodies.

        Raises:
            ParameterError: `other` is something else.
        """
        if isinstance(other, int) and other == 0:
            return self
        raise ParameterError(f"points are joined with points only, got {shown(other)}")

    @collective
    def add(self, other: MaterialPoints) -> PointChange:
        """Add the points of another body, between steps. Collective.

        Problems with these points continue with all points. The new points get the first values
        of a law's fields, and the next free numbers.

        Args:
            other: Points on the same grid; they stay unchanged.

        Returns:
            Number and mass of the added points, over all ranks.

        Raises:
            ParameterError, FieldShapeError: See `a + b`; no point is added then.
        """
        return pointchanges.add(self, other)

    @collective(local=("where",))
    def remove(
        self,
        where: Callable[[npt.NDArray[np.float64]], npt.ArrayLike] | npt.ArrayLike | None = None,
        *,
        tag: int | Sequence[int] | None = None,
    ) -> PointChange:
        """Remove points, between steps. Collective.

        Problems continue with the other points. IdleConditionWarning tells of lost surfaces.

        Args:
            where: Points to remove: a function of present positions (m), shape (gdim, n), that
                returns n booleans; or n booleans for the points of this rank.
            tag: Tag of the points to remove, or several tags, instead of `where`.

        Returns:
            Number and mass of the removed points, over all ranks.

        Raises:
            ParameterError: Neither or both arguments are given, `where` gives no booleans, no
                point has the tag, or no point would remain.
            FieldShapeError: The number of booleans is not the number of points.
        """
        return pointchanges.remove(self, where, tag)

    @collective
    def locate(self) -> int:
        """Find the cells and ranks of points after the user has changed `x`. Collective.

        Returns:
            Number of points that changed rank, over all ranks.

        Raises:
            PointsOutsideGridError: Points are outside the grid.
        """
        return self.migrate(pointinput.destinations_of(self))
