"""Boundaries that do not fit the grid: markers with area vectors, anywhere in the cells."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import ufl
from mpi4py import MPI
from ufl.core.expr import Expr

from dolfinmpm._platform.argumentchecks import check_function, shown, truth, whole
from dolfinmpm._platform.collective import collective
from dolfinmpm._platform.errors import (
    EmptyShapeError,
    ParameterError,
    UnsupportedGridError,
    call_together,
)
from dolfinmpm._platform.uncopied import Settled
from dolfinmpm.basis import Placement
from dolfinmpm.body.axisymmetry import in_section
from dolfinmpm.body.formarguments import check_displacement, check_points
from dolfinmpm.body.formsigns import PRESSURE, signed_form
from dolfinmpm.body.markerdistance import APART, mark_far
from dolfinmpm.body.markergeometry import (
    check_outward,
    level_set_markers,
    put_inside,
    revolved,
    rows_of,
    segment_markers,
    segments_of,
    side_markers,
    triangle_markers,
    triangles_of,
)
from dolfinmpm.body.points import MaterialPoints, PointField
from dolfinmpm.body.surfaceloads import area_at_end, pressure_of, vector_of
from dolfinmpm.grid.lattice import require_lattice
from dolfinmpm.grid.serialnumbers import next_number
from dolfinmpm.grid.sides import side_of

__all__ = ["OWN", "Boundary"]

Array = npt.NDArray[np.float64]

# Field of the markers' own deformation gradient; the field `F` is taken from the nearest point
OWN = "F_own"


class Boundary(Settled):
    """A boundary of a body, or a wall, that need not fit the grid.

    A boundary consists of markers: quadrature points with area vectors and stencils of their own.
    At the start of a step, each marker gets the state of the nearest material point for the laws.

    Terms such as the terms of `dirichlet` are integrals over `boundary.ds`, in the configuration
    at the start of the step.

    Args:
        points: Material points of the body.
        x: Positions (m), shape (n, gdim). Each rank gives some markers, all markers or none. A
            marker that several ranks give counts once.
        area: Area vectors, area times outward unit normal (m^(d-1)), shape (n, gdim). For
            axisymmetric bodies the area goes around the axis: 2π r times the length of the
            section (m²). Other constructors compute the vectors.
        follows: Whether the markers move with the body, and go with points that are removed.
        name: Name in messages and checkpoints.
        activates: Whether the cells of the markers become active, as for the boundary of a body.
            Otherwise a marker acts while material points are in its cell, as for a wall. By
            default the same as `follows`.

    Attributes:
        markers: The markers as points, with the fields `x`, `x0`, `area` (m^(d-1), a vector), `V`
            (the length of `area`), and fields for the state of the nearest material point.
        points, follows, name, activates: The arguments.
        late: Whether the body had moved before the boundary was made.
        longest: Greatest length of the pieces beside the cells that cut them (m); 0 if not known.
        tiles: Whether markers are middles of segments with their lengths that cover the boundary.
        removed: Positions of points removed since the last step; see `leave_with_removed`.
        forces: Names of the markers' fields with forces on the body in the last step (N).
        against: Markers of touching bodies, and names of the forces on those bodies.
        ds: Measure over the markers.

    Raises:
        FieldShapeError: An array has another shape.
        ParameterError: A value is not finite, an area is zero, the normals point into the body, or
            a boundary that follows its body is away from it.
        EmptyShapeError: There is no marker.
        PointsOutsideGridError: A marker is outside the grid.

    A boundary that is cut at the grid's lines:

    >>> import dolfinmpm as mpm
    >>> from mpi4py import MPI
    >>> grid = mpm.create_lattice(MPI.COMM_WORLD, [range(5), range(5)])
    >>> corners = [(0.3, 0.3), (3.3, 0.3), (3.3, 2.3), (0.3, 2.3)]
    >>> points = mpm.fill(grid, mpm.Polygon(corners), per_cell=2, density=2000.0, exact=True)
    >>> edge = mpm.Boundary.from_polygon(points, corners)
    >>> round(edge.total_area, 12)
    10.0
    """

    @collective(local=("x", "area"))
    def __init__(
        self,
        points: MaterialPoints,
        x: npt.ArrayLike,
        area: npt.ArrayLike,
        *,
        follows: bool = True,
        name: str | None = None,
        activates: bool | None = None,
    ):
        check_points(points)
        if name is not None and (not isinstance(name, str) or not name):
            raise ParameterError(f"name = {shown(name)} must be a word, such as 'wall'")
        truth("follows", follows)
        activates = follows if activates is None else truth("activates", activates)
        at, vectors = call_together(points.comm, lambda: rows_of(points.gdim, x, area))
        sizes = np.linalg.norm(vectors, axis=1)
        if points.comm.allreduce(len(at), op=MPI.SUM) == 0:
            off = ", and not on the axis" * points.axisymmetric
            raise EmptyShapeError(f"the boundary has no markers; give some within the grid{off}")
        at = put_inside(points.grid, at, vectors / sizes[:, None])
        self.points, self.follows, self.activates = points, follows, activates
        self.tiles, self.longest, self.removed = False, 0.0, list[Array]()
        self.forces, self.against = list[str](), list[tuple[MaterialPoints, str]]()
        moved = not np.array_equal(points["x"], points["x0"])
        self.late = points.comm.allreduce(moved, op=MPI.LOR)
        self.name = name or f"boundary{next_number(points.grid, 'boundary')}"
        self.markers = markers = MaterialPoints.from_arrays(
            points.grid, at, sizes, 1.0, half_length=0.0,
            fields={"area": vectors, "area0": vectors}, axisymmetric=points.axisymmetric,
        )  # fmt: skip
        check_outward(points, markers["x"], markers["area"], self.name)
        if follows:
            points.followers.add(self)
            mark_far(points, markers, self.name)
        # laws with varying parameters have fields of the same names at points and markers
        markers.symbols.laws = points.laws
        self.ds = markers.dx.reconstruct(metadata={**markers.dx.metadata(), "boundary": self})

    @property
    def seen(self) -> Array:
        """Positions for the markers' stencils (m): present positions, or first positions."""
        return self.markers["x0" if self.markers.configuration == "total" else "x"]

    def placement(self) -> Placement:
        """The markers for a basis: points without domain and volume."""
        x = self.seen
        return Placement(x, np.zeros_like(x), np.zeros(len(x)), self.markers["cell"])

    def deformation(self) -> Array:
        """Deformation gradients from first to present positions, shape (markers, gdim, gdim).

        A marker of a wall has the deformation gradient of the nearest point.
        """
        F = self.markers[OWN if self.follows else "F"]
        return np.ascontiguousarray(in_section(self.markers, F))

    def present(self) -> npt.NDArray[np.bool_]:
        """Which markers are near the body, shape (markers,)."""
        apart = self.markers.fields.get(APART)
        return np.ones(len(self.markers), bool) if apart is None else apart == 0.0

    def __repr__(self) -> str:
        return f"Boundary '{self.name}'"

    # -- constructors ---------------------------------------------------------

    @classmethod
    @collective
    def from_polygon(
        cls,
        points: MaterialPoints,
        vertices: npt.ArrayLike,
        *,
        closed: bool = True,
        follows: bool = True,
        rule: int = 2,
        name: str | None = None,
        activates: bool | None = None,
        spacing: float | None = None,
    ) -> Boundary:
        """Boundary along a polygon in the plane, or along a chain of segments. Collective.

        Args:
            points: Material points of the body.
            vertices: Corners (m), shape (n, 2), the same on all ranks. The body is to the left.
            closed: Whether a segment joins the last corner to the first.
            follows, name, activates: See `Boundary`.
            rule: Gauss points per piece of a segment in a cell.
            spacing: Greatest length of a piece (m). The cells of a rectangular grid, in equal parts
                that are no longer, cut the pieces; half a cell is the limit on other grids. Give it
                for bodies that move far, moving fine zones, and leaves: the size of one or less.

        Raises:
            UnsupportedGridError: The grid is not in two dimensions.
            FieldShapeError: The corners have another shape.
            ParameterError: There are too few corners, one comes twice in a row, or segments cross.
        """
        check_points(points)
        if points.gdim != 2:
            raise UnsupportedGridError(
                f"a polygon bounds bodies in 2D, the grid is of {points.gdim}D; in 3D give "
                "Boundary.from_triangles"
            )
        ends = segments_of(vertices, truth("closed", closed))
        x, area = segment_markers(points.grid, ends, spacing, whole("rule", rule, 1))
        x, area = revolved(points, x, area)
        made = cls(points, x, area, follows=follows, name=name, activates=activates)
        made.tiles, made.longest = rule == 1, spacing or np.inf
        return made

    @classmethod
    @collective
    def from_side(
        cls,
        points: MaterialPoints,
        side: str,
        *,
        rule: int = 2,
        name: str | None = None,
        spacing: float | None = None,
    ) -> Boundary:
        """Side of a rectangular grid as a wall that stays and activates no cells. Collective.

        Args:
            points: Material points of the body.
            side: A side by its axis or name, "x-" or "left"; see `prescribed`.
            rule: Gauss points per piece and direction. The cells cut the side into pieces.
            name: Name of the boundary; the name of the side by default.
            spacing: Greatest length of a piece (m). Give that of the leaves for refined spaces.

        Raises:
            ParameterError: There is no such side.
            UnsupportedGridError: The grid is not rectangular.
        """
        check_points(points)
        word, axis, end = side_of(side, points.gdim)
        lattice = require_lattice(points.grid, "a boundary at a side of the grid")
        made = revolved(points, *side_markers(lattice, axis, end, whole("rule", rule, 1), spacing))
        wall = cls(points, *made, follows=False, name=word if name is None else name)
        wall.longest = spacing or np.inf
        return wall

    @classmethod
    @collective
    def from_triangles(
        cls,
        points: MaterialPoints,
        vertices: npt.ArrayLike,
        triangles: npt.ArrayLike,
        *,
        follows: bool = True,
        name: str | None = None,
        activates: bool | None = None,
    ) -> Boundary:
        """Boundary of triangles in space. Collective.

        On rectangular grids, triangles are cut where cells meet. On other grids they are cut into
        equal parts no longer than half a cell.

        Args:
            points: Material points of the body.
            vertices: Corners (m), shape (n, 3), the same on all ranks.
            triangles: Three corners per triangle, shape (m, 3). The outward normal follows from
                the order of the corners by the right-hand rule.
            follows, name, activates: See `Boundary`.

        Raises:
            UnsupportedGridError: The grid is not in three dimensions.
            FieldShapeError: An array has another shape.
            ParameterError: A corner does not exist, or normals of neighbours disagree.
        """
        check_points(points)
        if points.gdim != 3:
            raise UnsupportedGridError(
                f"triangles bound bodies in 3D, the grid is of {points.gdim}D; in 2D give "
                "Boundary.from_polygon"
            )
        x, area = triangle_markers(points.grid, triangles_of(vertices, triangles))
        return cls(points, x, area, follows=follows, name=name, activates=activates)

    @classmethod
    @collective
    def from_level_set(
        cls,
        points: MaterialPoints,
        phi: Callable[[Array], npt.ArrayLike],
        *,
        subdivisions: int = 2,
        follows: bool = True,
        rule: int = 2,
        name: str | None = None,
        activates: bool | None = None,
    ) -> Boundary:
        """Boundary where a function is zero. Collective.

        The function is interpolated linearly in parts of the cells.

        Args:
            points: Material points of the body.
            phi: Function of positions (m), shape (gdim, n), that returns n values, negative in
                the body; see `dolfinmpm.grid.userfunctions`.
            subdivisions: Parts per cell and direction, on rectangular grids. The error of the
                boundary's position is proportional to the square of the size of a part.
            follows, name, activates: See `Boundary`.
            rule: Gauss points per piece of a line in 2D.

        Raises:
            ParameterError: The argument is no function, or a value is not finite.
            EmptyShapeError: The function is zero nowhere on the grid.
            UnsupportedGridError: The grid is in one dimension, or its cells are not supported.
        """
        check_points(points)
        check_function("phi", phi, "of positions, such as lambda x: np.hypot(*x) - 1.0")
        if points.gdim == 1:
            raise UnsupportedGridError("a level set needs a grid of 2D or 3D; give Boundary(...)")
        whole("subdivisions", subdivisions, 1, 100), whole("rule", rule, 1)
        x, area = level_set_markers(points.grid, phi, subdivisions, rule)
        return cls(
            points, *revolved(points, x, area), follows=follows, name=name, activates=activates
        )

    # -- UFL ------------------------------------------------------------------

    @property
    def x(self) -> PointField:
        """Positions at the start of the step (m)."""
        return self.markers.x

    @property
    def x0(self) -> PointField:
        """First positions (m)."""
        return self.markers.x0 if self.follows else self.markers.x

    @property
    def normal(self) -> Expr:
        """Outward unit normal at the start of the step."""
        return self.markers.area / self.markers.V

    def traction(self, t, v) -> ufl.Form:
        """Form of a traction, −∫ t·v da at the start of the step; add it to the weak form.

        Args:
            t: Force per area (Pa), a vector for UFL, shape (gdim,).
            v: Test function, `Space.test`.

        Raises:
            ParameterError: t is no such vector, or v is no test function.
        """
        check_displacement(self.points, v=v)
        t = vector_of(self.points, "traction", t)
        return signed_form(-ufl.dot(t, v), self.ds, f"the traction on '{self.name}'")

    def pressure(self, p, u, v) -> ufl.Form:
        """Form of a pressure that follows the boundary; add it to the weak form.

        The form is ∫ p ΔJ ΔF⁻ᵀ n · v da, by Nanson's formula from the start of the step.

        Args:
            p: Pressure (Pa), positive towards the body: a DOLFINx constant or a scalar for UFL.
            u: Increment of the step, `Space.increment`.
            v: Test function, `Space.test`.

        Raises:
            ParameterError: p is no scalar, u is no increment, or v is no test function.
        """
        check_displacement(self.points, u=u, v=v)
        p = pressure_of(self.points, p)
        work = p * ufl.dot(area_at_end(self.markers, self.normal, u), v)
        return signed_form(work, self.ds, f"the pressure on '{self.name}'", kind=PRESSURE)

    @collective
    def force(self) -> Array:
        """Force of conditions and touching bodies in the last step (N), shape (gdim,). Collective.

        For axisymmetric bodies, the force goes around the axis. Its first component is the sum of
        the radial forces.
        """
        own = [self.markers[name] for name in self.forces]
        own += [-markers[name] for markers, name in self.against]
        sums = sum((one.sum(axis=0) for one in own), np.zeros(self.gdim))
        return self.points.comm.allreduce(np.asarray(sums), op=MPI.SUM)

    @property
    def gdim(self) -> int:
        """Dimension of space."""
        return self.points.gdim

    @property
    @collective
    def total_area(self) -> float:
        """Present area on all ranks (m^(d-1); m² for axisymmetric bodies). Collective."""
        return self.points.comm.allreduce(float(self.markers["V"].sum()), op=MPI.SUM)
