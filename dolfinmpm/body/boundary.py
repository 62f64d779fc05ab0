"""Boundaries that do not fit the grid: markers with area vectors, wherever they are in cells."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
import ufl
from mpi4py import MPI
from ufl.core.expr import Expr

from dolfinmpm._platform.argumentchecks import number, shown, truth, whole
from dolfinmpm._platform.collective import collective
from dolfinmpm._platform.errors import (
    EmptyShapeError,
    ParameterError,
    UnsupportedGridError,
    call_together,
    raise_together,
)
from dolfinmpm.basis import Placement
from dolfinmpm.basis.conditions import side_of
from dolfinmpm.body.axisymmetry import gradient, in_section
from dolfinmpm.body.contours import along_segments, contour, cut_triangles
from dolfinmpm.body.formarguments import check_displacement, check_points
from dolfinmpm.body.formsigns import acting
from dolfinmpm.body.markergeometry import (
    put_inside,
    revolved,
    rows_of,
    segments_of,
    simplices_of,
    triangles_of,
)
from dolfinmpm.body.orientation import check_outward
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.body.surfaceloads import pressure_of, vector_of
from dolfinmpm.grid.lattice import lattice_of, require_lattice, smallest_height
from dolfinmpm.grid.serialnumbers import next_on
from dolfinmpm.grid.userfunctions import ask

if TYPE_CHECKING:
    from dolfinmpm.body.fields import PointField

__all__ = ["OWN", "Boundary"]

Array = npt.NDArray[np.float64]

# Deformation gradient of markers themselves, where steps need it; `F` is that of the nearest point
OWN = "F_own"


class Boundary:
    """A boundary of a body, or a wall, that need not fit the grid.

    It consists of markers: quadrature points with area vectors. They see the grid by stencils of
    their own, as mere points, so that fields have traces there and the cell's gradients; and the
    cells that they are in are active. Each of them has the state of the nearest material point
    at the start of a step, which laws need.

    Terms over it are integrals over `boundary.ds`, such as `dirichlet` makes. It is the
    configuration at the start of the step that is integrated over.

    Args:
        points: Material points of the body.
        x: Positions (m), shape (n, gdim). Each rank gives some of the markers, or all, or none;
            those that several ranks give alike count once.
        area: Area vectors (m^(d-1)), area times outward unit normal, likewise; of axisymmetric
            bodies the
            whole ones (m²), 2π r times the length of the section. Other constructors find them.
        follows: Whether the markers move with the body; else they stay where they are.
        name: Name in messages and checkpoints.
        activates: Whether the cells that markers are in become active, as those of a body's own
            boundary should. If not, markers take part as long as points are in their cells, as
            those of walls. By default markers that follow the body do so.

    Attributes:
        points: The body.
        markers: The markers as points: their fields `x`, `x0`, `area` (m^(d-1), a vector)
            and `V`, its length, and those that hold the state of the nearest material point.
        follows, name, activates: The arguments.
        late: Whether the body had moved when it was made.
        tiles: Whether each marker is the middle of a segment of its length, which together are it.
        forces: Names of the markers' fields that hold the forces of conditions on the body
            in the last step (N), see `force`.
        ds: Measure over the markers.

    Raises:
        FieldShapeError: An array has another shape.
        ParameterError: A value is not finite, an area is zero, or the normals point into the body.
        EmptyShapeError: There is no marker.
        PointsOutsideGridError: A marker is outside the grid.

    A boundary through the cells, cut at the grid's lines:

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
        activates = (
            truth("follows", follows) if activates is None else truth("activates", activates)
        )
        at, vectors = call_together(points.comm, lambda: rows_of(points.gdim, x, area))
        sizes = np.linalg.norm(vectors, axis=1)
        if points.comm.allreduce(len(at), op=MPI.SUM) == 0:
            axis = " and off the axis, which bounds no body" if points.axisymmetric else ""
            raise EmptyShapeError(
                f"the boundary has no markers; its markers must lie in the grid{axis}"
            )
        at = put_inside(points.grid, at, vectors / sizes[:, None])
        self.points, self.follows, self.activates = points, follows, activates
        self.forces: list[str] = []
        self.tiles = False
        moved = not np.array_equal(points["x"], points["x0"])
        self.late = points.comm.allreduce(moved, op=MPI.LOR)
        self.name = name or f"boundary{next_on(points.grid, 'boundary')}"
        self.markers = markers = MaterialPoints.from_arrays(
            points.grid, at, sizes, 1.0, half_length=0.0,
            fields={"area": vectors, "area0": vectors}, axisymmetric=points.axisymmetric,
        )  # fmt: skip
        check_outward(points, markers["x"], markers["area"], self.name)
        # laws whose parameters vary have fields of the same names on both
        markers.symbols.laws = points.laws
        mark = {**markers.dx.metadata(), "boundary": self}
        self.ds = markers.dx.reconstruct(metadata=mark)

    @property
    def seen(self) -> Array:
        """Positions that its markers see the grid from (m): those now, or at first."""
        return self.markers["x0" if self.markers.configuration == "total" else "x"]

    def placement(self) -> Placement:
        """The markers as a basis sees them: points without a domain, and without volume."""
        x = self.seen
        return Placement(x, np.zeros_like(x), np.zeros(len(x)), self.markers["cell"])

    def deformation(self) -> Array:
        """Deformation gradients that carry gradients by first positions to those by present ones.

        Shape (markers, gdim, gdim): those of the markers, and at a wall those of the body there.
        """
        F = self.markers[OWN if self.follows else "F"]
        return np.ascontiguousarray(in_section(self.markers, F))

    def present(self) -> npt.NDArray[np.bool_]:
        """Which of its markers may see the body at all, shape (markers,)."""
        if "apart" not in self.markers.fields:
            return np.ones(len(self.markers), bool)
        return self.markers["apart"] == 0.0

    def __repr__(self) -> str:
        return f"Boundary '{self.name}'"

    # -- where markers come from ----------------------------------------------

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
        """Along a polygon in the plane, or a chain of segments. Collective.

        Args:
            points: Material points of the body.
            vertices: Its corners (m), shape (n, 2), the same on all ranks; the body is to the left.
            closed: Whether the last corner is joined to the first.
            follows, name, activates: See `Boundary`.
            rule: Gauss points on each piece of a segment in a cell.
            spacing: Longest piece (m); by default those that cells cut, or half a cell where the
                grid is not rectangular. Bodies that move far, or whose grid is laid anew, need
                markers that are dense enough wherever they come.

        Raises:
            UnsupportedGridError: The grid is not in two dimensions.
            FieldShapeError, ParameterError: The corners are not what they may be.
        """
        check_points(points)
        if points.gdim != 2:
            raise UnsupportedGridError(
                f"a polygon bounds bodies in 2D, the grid is of {points.gdim}D; in 3D give "
                "Boundary.from_triangles"
            )
        ends = segments_of(vertices, truth("closed", closed))
        lattice, rule = lattice_of(points.grid), whole("rule", rule, 1)
        if spacing is not None:
            number("spacing", spacing, 0.0, unit="m")
        elif lattice is None:
            spacing = smallest_height(points.grid) / 2
        lines = () if lattice is None else lattice.lines
        x, area = along_segments(ends, lines, np.inf if spacing is None else spacing, rule)
        made = cls(
            points, *revolved(points, x, area), follows=follows, name=name, activates=activates
        )
        made.tiles = rule == 1
        return made

    @classmethod
    @collective
    def from_side(
        cls, points: MaterialPoints, side: str, *, rule: int = 2, name: str | None = None
    ) -> Boundary:
        """A side of a rectangular grid, as a wall: it stays, and activates no cells. Collective.

        Args:
            points: Material points of the body.
            side: A side by its axis or name, "x-" or "left"; see `prescribed`.
            rule: Gauss points of a cell's side in each direction.
            name: Name of the boundary; that of the side by default.

        Raises:
            ParameterError: There is no such side.
            UnsupportedGridError: The grid is not rectangular.
        """
        check_points(points)
        word, axis, end = side_of(side, points.gdim)
        lattice = require_lattice(points.grid, "a boundary at a side of the grid")
        at, weights = np.polynomial.legendre.leggauss(whole("rule", rule, 1))
        places, lengths = [], []
        for d, line in enumerate(lattice.lines):
            middle, half = 0.5 * (line[1:] + line[:-1]), 0.5 * np.diff(line)
            across = d == axis
            places.append(
                line[[-end]] if across else (middle[:, None] + half[:, None] * at).ravel()
            )
            lengths.append(np.ones(1) if across else (half[:, None] * weights).ravel())
        x = np.stack(np.meshgrid(*places, indexing="ij"), axis=-1)
        area = np.prod(np.meshgrid(*lengths, indexing="ij"), axis=0).reshape(-1, 1)
        normal = np.eye(points.gdim)[axis] * (1.0 if end else -1.0)
        x, area = revolved(points, x.reshape(-1, points.gdim), area * normal)
        return cls(points, x, area, follows=False, name=name or word, activates=False)

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
        """On triangles in space. Collective.

        On grids that are not rectangular the triangles are not cut where cells meet: give
        some that are no larger than cells.

        Args:
            points: Material points of the body.
            vertices: Corners (m), shape (n, 3), the same on all ranks.
            triangles: Three of them each, shape (m, 3); the outward normal is that of their
                right-handed turn.
            follows, name, activates: See `Boundary`.

        Raises:
            UnsupportedGridError: The grid is not in three dimensions.
            FieldShapeError, ParameterError: The triangles are not what they may be.
        """
        check_points(points)
        if points.gdim != 3:
            raise UnsupportedGridError(
                f"triangles bound bodies in 3D, the grid is of {points.gdim}D; in 2D give "
                "Boundary.from_polygon"
            )
        corners = triangles_of(vertices, triangles)
        lattice = lattice_of(points.grid)
        x, area = cut_triangles(corners, None if lattice is None else lattice.lines)
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
        """Where a function vanishes, interpolated linearly within parts of the cells. Collective.

        Args:
            points: Material points of the body.
            phi: Function of positions (m), shape (gdim, n), to n values, negative in the
                body; see `dolfinmpm.grid.userfunctions`.
            subdivisions: Parts of a cell in each direction, on rectangular grids. The error of
                the boundary's place is of the square of their size.
            follows, name, activates: See `Boundary`.
            rule: Gauss points on each piece of a line in 2D.

        Raises:
            ParameterError: The function is not what it may be.
            EmptyShapeError: It vanishes nowhere on the grid.
        """
        check_points(points)
        if not callable(phi):
            raise ParameterError(
                f"phi = {shown(phi)} must be a function of positions, such as lambda x: "
                "np.hypot(*x) - 1.0"
            )
        grid, d = points.grid, points.gdim
        if d == 1:
            raise UnsupportedGridError("a level set needs a grid of 2D or 3D; give Boundary(...)")
        whole("subdivisions", subdivisions, 1), whole("rule", rule, 1)
        simplices = simplices_of(grid, subdivisions)
        flat = simplices.reshape(-1, d)
        values = call_together(points.comm, lambda: ask("phi", phi, flat))
        bad = np.flatnonzero(~np.isfinite(values))
        raise_together(
            points.comm,
            ParameterError(f"phi = {values[bad[0]]} at {flat[bad[0]]} m must be finite")
            if bad.size
            else None,
        )
        pieces = contour(simplices, values.reshape(simplices.shape[:2]))
        if d == 2:
            x, area = along_segments(pieces, (), np.inf, rule)
        else:
            x, area = cut_triangles(pieces, None, coarse=True)
        if points.comm.allreduce(len(x), op=MPI.SUM) == 0:
            raise EmptyShapeError(
                "phi changes its sign nowhere on the grid; it has no level 0 there"
            )
        return cls(
            points, *revolved(points, x, area), follows=follows, name=name, activates=activates
        )

    # -- of UFL ---------------------------------------------------------------

    @property
    def x(self) -> PointField:
        """Positions at the start of the step (m)."""
        return self.markers.x

    @property
    def x0(self) -> PointField:
        """Positions at first (m)."""
        return self.markers.x0 if self.follows else self.markers.x

    @property
    def normal(self) -> Expr:
        """Outward unit normal at the start of the step."""
        return self.markers.area / self.markers.V

    def traction(self, t, v) -> ufl.Form:
        """Traction, to be added: −∫ t·v da at the start of the step.

        Args:
            t: Force per area (Pa), a vector of UFL.
            v: Test function, `Space.test`.

        Raises:
            ParameterError: t is no vector of the dimension of space, or v no test function.
        """
        check_displacement(self.points, v=v)
        t = vector_of(self.points, "traction", t)
        return acting(-ufl.dot(t, v), self.ds, f"the traction on '{self.name}'")

    def pressure(self, p, u, v) -> ufl.Form:
        """Pressure that follows the boundary, to be added.

        ∫ p ΔJ ΔF⁻ᵀ n · v da by Nanson's formula, from the start of the step on.

        Args:
            p: Pressure (Pa), positive towards the body: a DOLFINx constant or a scalar of UFL.
            u: Increment of the step, `Space.increment`.
            v: Test function, `Space.test`.

        Raises:
            ParameterError: p is no scalar, or u and v no increment and no test function.
        """
        check_displacement(self.points, u=u, v=v)
        p = pressure_of(self.points, p)
        dF = ufl.Identity(self.markers.strain_dim) + gradient(self.markers, u)
        back = in_section(self.markers, ufl.inv(dF))
        work = p * ufl.det(dF) * ufl.dot(ufl.dot(self.normal, back), v)
        return acting(work, self.ds, f"the pressure on '{self.name}'")

    @collective
    def force(self) -> Array:
        """Force of all conditions on the body in the last step (N), shape (gdim,). Collective.

        Of axisymmetric bodies it is that all around, the first component being the sum of radial
        forces.
        """
        sums = sum((self.markers[name].sum(axis=0) for name in self.forces), np.zeros(self.gdim))
        return self.points.comm.allreduce(np.asarray(sums), op=MPI.SUM)

    @property
    def gdim(self) -> int:
        """Dimension of space."""
        return self.points.gdim

    @property
    @collective
    def total_area(self) -> float:
        """Area now (m^(d-1); of axisymmetric bodies m²), on all ranks. Collective."""
        return self.points.comm.allreduce(float(self.markers["V"].sum()), op=MPI.SUM)
