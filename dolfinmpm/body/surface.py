"""Loads on faces of a body: tractions and follower pressures at material points.

Material points are inside the body, and the faces of the body are not. A load at the points instead
of the face would have the right force and a wrong moment. A point at a face therefore keeps the
initial offset R of the face from its centre, and the initial area vector A0 of the face (area times
outward normal). The measure `Surface.dX` takes increments and test functions at the faces, see
`dolfinmpm.basis.facestencils`. Elsewhere the point's stencil gives the motion of the face to first
order, u(x_s) = u + ∇ũ·r with r = F_n R.

Loads are added to the internal forces, as is the contact of a `RigidFooting`:
F = momentum(...) + surface.traction(t, v) + footing.contact(u, v); see `dolfinmpm.body.formsigns`.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt
import ufl
from mpi4py import MPI
from ufl.core.expr import Expr

from dolfinmpm._platform.argumentchecks import check_function, check_kind, shown
from dolfinmpm._platform.collective import collective
from dolfinmpm._platform.errors import (
    EmptyShapeError,
    ParameterError,
    UnsupportedGridError,
    call_together,
    raise_together,
)
from dolfinmpm._platform.uncopied import Settled
from dolfinmpm.body.axisymmetry import gradient, in_section, ring
from dolfinmpm.body.boundary import Boundary
from dolfinmpm.body.facesofboundary import faces_of
from dolfinmpm.body.facestates import displaced_faces
from dolfinmpm.body.formarguments import check_displacement, check_points
from dolfinmpm.body.formsigns import PRESSURE, signed_form
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.body.surfacechecks import axis_of, check_exposed, error_on_axis, offsets_and_areas
from dolfinmpm.body.surfaceloads import pressure_of, vector_of
from dolfinmpm.grid.constants import own_constant
from dolfinmpm.grid.lattice import lattice_of
from dolfinmpm.grid.userfunctions import choose

__all__ = ["Surface"]

Array = npt.NDArray[np.float64]
Where = Callable[[Array], npt.ArrayLike]


class Surface(Settled):
    """Material points at a loaded face of a body, with the offset and the area of their faces.

    A surface adds two fields to the points: `<name>_offset` (m), from the centre of a point to its
    face, and `<name>_area` (m^(d-1)), the area vector. Both have their initial values, and are zero
    for points that are not at the face. A point at an edge of the body may belong to several
    surfaces.

    Faces of axisymmetric bodies go around the axis. Their area is 2π r times the length of their
    section, with the radius r of the centre of the face. Forces are on the whole body.

    Args:
        points: Material points.
        where: Function of the initial centres of the points' faces, x0 + l0·n (m), shape
            (gdim, n), that returns n booleans; see `dolfinmpm.grid.userfunctions`.
        normal: Outward unit normal of the face: an axis of the grid, such as (0, 1).
        name: Name of the fields; `surface1`, `surface2`, ... by default.

    Attributes:
        points: The material points.
        name: Name of the surface.
        normal: Outward normal, shape (gdim,), or None for a surface from arrays.
        total_area: Initial area on all ranks (m^(d-1)).
        offset, area: The fields, for UFL.
        within: Box of the footing that holds the faces (m), shape (2, gdim), or None.

    Raises:
        ParameterError: An argument is not valid, the name is taken, or the normal is no unit axis;
            or faces lie inside the body, or on the axis of an axisymmetric body.
        EmptyShapeError: No face is at the given position.
        UnsupportedGridError: The grid is not rectangular.

    A pressure of 10 kPa on the top of a block:

    >>> import dolfinmpm as mpm
    >>> from mpi4py import MPI
    >>> grid = mpm.create_lattice(MPI.COMM_WORLD, [range(5), range(5)])
    >>> points = mpm.fill(grid, mpm.Box((0, 0), (4, 2)), per_cell=2, density=2000.0)
    >>> V = mpm.Space(grid, "gimp")
    >>> F = mpm.momentum(mpm.materials.Hencky(1e6, 0.3), points, V.increment, V.test)
    >>> top = mpm.Surface(points, lambda x: x[1] > 1.9, normal=(0, 1))
    >>> F += top.pressure(10e3, V.increment, V.test)
    >>> bcs = mpm.fixed(V, "bottom") + mpm.rollers(V, "left", "right")
    >>> record = mpm.QuasiStatic(F, V.increment, points, bcs).step()
    >>> top.total_area, top.mean_displacement().round(4).tolist()
    (4.0, [0.0, -0.0147])
    """

    within: Array | None = None

    @collective
    def __init__(
        self,
        points: MaterialPoints,
        where: Where,
        normal: Sequence[float],
        *,
        name: str | None = None,
    ):
        check_points(points)
        kind = "of the positions of faces, such as lambda x: np.isclose(x[-1], 1.0)"
        check_function("where", where, kind)
        n = axis_of(normal, points.gdim)
        if lattice_of(points.grid) is None:
            raise UnsupportedGridError(
                "points have domains with faces along the axes on rectangular grids only; give "
                "the faces by Surface.from_boundary or Surface.from_arrays"
            )
        offset = points["l0"] * n
        faces = points["x0"] + offset

        chosen = call_together(points.comm, lambda: choose("where", where, faces))
        axis = int(np.argmax(np.abs(n)))
        if points.comm.allreduce(int(chosen.sum()), op=MPI.SUM) == 0:
            low = points.comm.allreduce(faces[:, axis].min(initial=np.inf), op=MPI.MIN)
            high = points.comm.allreduce(faces[:, axis].max(initial=-np.inf), op=MPI.MAX)
            raise EmptyShapeError(
                f"no point has its face towards {tuple(normal)} where `where` says; the centres of "
                f"these faces lie between {low:.6g} and {high:.6g} m on that axis: compare with "
                "np.isclose"
            )
        check_exposed(points, chosen, n)
        across = np.delete(points["l0"], axis, axis=1)
        area = np.prod(2 * across, axis=1)[:, None] * n
        if points.axisymmetric:
            raise_together(points.comm, error_on_axis(points, faces, chosen))
            area = ring(faces[:, :1], area)
        self._set(points, np.where(chosen[:, None], offset, 0.0),
                  np.where(chosen[:, None], area, 0.0), name, n)  # fmt: skip

    @classmethod
    @collective(local=("offset", "area"))
    def from_arrays(
        cls,
        points: MaterialPoints,
        offset: npt.ArrayLike,
        area: npt.ArrayLike,
        *,
        name: str | None = None,
    ) -> Surface:
        """A surface of any shape, from offsets and areas at the points. Collective.

        Args:
            points: Material points.
            offset: Initial offset from each point's centre to its face (m), shape (points on this
                rank, gdim).
            area: Initial area times outward unit normal (m^(d-1)), shape (points on this rank,
                gdim); zero for points that are not at the face. For axisymmetric bodies, the area
                around the axis (m²).
            name: Name of the fields.

        Raises:
            FieldShapeError: An array has another shape.
            ParameterError: A value is not finite, or the name is taken.
            EmptyShapeError: All areas are zero.
        """
        check_points(points)
        R, A = offsets_and_areas(points, offset, area)
        if not points.comm.allreduce(bool(np.any(A)), op=MPI.LOR):
            raise EmptyShapeError("all areas of the surface are zero; give some point an area")
        surface = cls.__new__(cls)
        surface._set(points, R, A, name, None)
        return surface

    @classmethod
    @collective
    def from_boundary(cls, boundary: Boundary, *, name: str | None = None) -> Surface:
        """A surface along a boundary that follows its body, of any shape. Collective.

        Args:
            boundary: The boundary, see `faces_of`. Its markers do not act.
            name: Name of the fields.

        Raises:
            ParameterError: The boundary is a wall, or the body has moved.
        """
        check_kind("boundary", boundary, Boundary, "make it with mpm.Boundary.from_polygon")
        return cls.from_arrays(boundary.points, *faces_of(boundary), name=name)

    def _set(self, points: MaterialPoints, R: Array, A: Array, name, normal) -> None:
        if name is None:
            # numbers give the same fields if the same problem is built again
            names = (f"surface{k}" for k in itertools.count(1))
            name = next(one for one in names if f"{one}_area" not in points.fields)
        if not isinstance(name, str) or not name.isidentifier():
            raise ParameterError(
                f"name = {shown(name)} must be an identifier, for it names fields of the points"
            )
        if f"{name}_area" in points.fields:
            raise ParameterError(f"the points have a surface '{name}' already; choose another name")
        self.points, self.name, self.normal = points, name, normal
        self.offset = points.add_field(f"{name}_offset", (points.gdim,), "m")
        self.area = points.add_field(f"{name}_area", (points.gdim,), "m^(d-1)")
        points[self.offset.name], points[self.area.name] = R, A
        self.total_area = points.comm.allreduce(float(self._sizes().sum()), op=MPI.SUM)
        # a number would be compiled into the forms
        self._total = own_constant(points.grid, self.total_area)
        self._apart = own_constant(points.grid, 1.0)

    def _sizes(self) -> Array:
        return np.linalg.norm(self.points[self.area.name], axis=1)

    # -- UFL ------------------------------------------------------------------

    def _cut(self, within: Array) -> Surface:
        """The same faces, of which only the parts in a box count.

        Args:
            within: Lower and upper corner of the box (m), shape (2, gdim).
        """
        one = type(self).__new__(type(self))
        one.__dict__ |= self.__dict__ | {"within": within}
        return one

    @property
    def dX(self) -> ufl.Measure:
        """Measure `points.dX` of the surface's points, with increments at their faces.

        Values of increments and test functions are those at the faces. Gradients and fields are
        those at the points. `density` times the measure is the initial area.
        """
        measure = self.points.dX
        return measure.reconstruct(metadata={**measure.metadata(), "surface": self})

    def without_way(self, integrand: Expr) -> Expr:
        """An integrand of `dX`, in which `at` and `position` have no way from the centres."""
        return ufl.replace(integrand, {self._apart: ufl.as_ufl(0.0)})

    @property
    def density(self) -> Expr:
        """Area of the face per initial volume of its point (1/m), a field for UFL.

        Its integral over `dX` or `points.dX` is the initial area of the surface.
        """
        return ufl.sqrt(ufl.dot(self.area, self.area)) / self.points.V0

    @property
    def _reach(self) -> Expr:
        """Offset from the points' centres to their faces at the start of the step, F_n R (m)."""
        return ufl.dot(in_section(self.points, self.points.F), self.offset)

    def at(self, w) -> Expr:
        """An increment or a test function at the face: w on `dX`, and w + ∇w·F_n R on `points.dX`.

        Raises:
            ParameterError: w is no UFL expression.
        """
        if not isinstance(w, Expr):
            raise ParameterError(
                f"w = {shown(w)} must be a field of UFL, such as Space.increment or Space.test"
            )
        return w + self._apart * ufl.dot(ufl.grad(w), self._reach)

    def position(self, u=None) -> Expr:
        """Position of the face (m) at the start of the step, or after the increment u."""
        start = self.points.x + self._reach
        return start if u is None else start + self.at(u)

    def traction(self, t, v) -> ufl.Form:
        """Form of a dead traction, −∫ t·v(x_s) dA0; add it to the weak form.

        Args:
            t: Force per initial area (Pa), a vector, shape (gdim,): a DOLFINx constant, or a UFL
                expression with values at the points.
            v: Test function, `Space.test`.

        Raises:
            ParameterError: t is no such vector, or v is no test function.
        """
        t = vector_of(self.points, "traction", t)
        return self.term(t, v, f"the traction on '{self.name}'")

    def term(self, t: Expr, v, name: str, once: bool = False) -> ufl.Form:
        """Form of a traction with a name for messages; see `traction`.

        Args:
            t: Force per initial area (Pa), a vector for UFL.
            v: Test function, `Space.test`.
            name: Name of the load.
            once: Whether a weak form may contain the form only once.
        """
        check_displacement(self.points, v=v)
        t = vector_of(self.points, name, t)
        return signed_form(-self.density * ufl.dot(t, v), self.dX, name, once)

    def force(self, P, v) -> ufl.Form:
        """Form of a dead force, spread evenly over the surface; add it to the weak form.

        Points that are removed take the share of their faces with them.

        Args:
            P: Force (N; N/m in plane strain), a vector as for `traction`.
            v: Test function, `Space.test`.
        """
        t = vector_of(self.points, "force", P) / self._total
        return self.term(t, v, f"the force on '{self.name}'")

    def pressure(self, p, u, v) -> ufl.Form:
        """Form of a pressure that follows the face; add it to the weak form.

        The form is ∫ p J F⁻ᵀ A0 · v(x_s) with F = (I + ∇ũ) F_n, by Nanson's formula. UFL derives
        its consistent tangent. For axisymmetric bodies, the hoop stretch is the stretch of the
        face.

        Args:
            p: Pressure per present area (Pa), positive towards the body: a DOLFINx constant or a
                scalar UFL expression, which may contain `position`.
            u: Increment of the step, `Space.increment`.
            v: Test function, `Space.test`.
        """
        points = self.points
        p = pressure_of(points, p)
        check_displacement(points, u=u, v=v)
        F = ufl.Identity(points.strain_dim) + gradient(points, u)
        F = in_section(points, ufl.dot(F, points.F))
        face = ufl.det(F) * ufl.dot(self.area, ufl.inv(F))
        if points.axisymmetric:
            face *= self.position(u)[0] / (points.x0 + self.offset)[0]
        work = p * ufl.dot(face, v) / points.V0
        return signed_form(work, self.dX, f"the pressure on '{self.name}'", kind=PRESSURE)

    def mean(self, direction, w) -> ufl.Form:
        """Mean over the initial area of w(x_s) · direction, a form linear in w.

        With a test function, `ArcLength` takes the form as its control.

        Args:
            direction: Vector, shape (gdim,): numbers, or a UFL expression.
            w: Test function, `Space.test`.
        """
        along = ufl.dot(vector_of(self.points, "direction", direction), self.at(w))
        return self.density / self._total * along * self.points.dX

    def mean_normal(self, w) -> ufl.Form:
        """Mean over the initial area of w(x_s) along the outward normal; see `mean`."""
        return ufl.dot(self.area, self.at(w)) / (self._total * self.points.V0) * self.points.dX

    # -- results --------------------------------------------------------------

    def displacements(self) -> Array:
        """Total displacements of the faces (m), shape (points on this rank, gdim)."""
        return self.displacements_of(self.points["x"], self.points["F"])

    def displacements_of(self, x: Array, F: Array) -> Array:
        """Total displacements of the faces in a state of the points (m), shape (points, gdim).

        Args:
            x: Positions (m), shape (points, gdim).
            F: Deformation gradients, with the shape of points["F"].
        """
        return displaced_faces(self.points, self.points[self.offset.name], x, F)

    @collective
    def mean_displacement(self) -> Array:
        """Mean displacement over the initial area that is left (m), shape (gdim,). Collective.

        Raises:
            ParameterError: All its points have been removed.
        """
        A = self._sizes()
        *total, area = self.points.comm.allreduce(np.append(A @ self.displacements(), A.sum()))
        if not area:
            raise ParameterError(f"no point of the surface '{self.name}' is left: make a new one")
        return np.array(total) / area

    @property
    def outflow_name(self) -> str:
        """Name of the points' field of the water that leaves per initial area and time (m/s)."""
        return f"{self.name}_outflow"

    @collective
    def outflow(self) -> float:
        """Water that leaves through the surface in the last step (m³/s; m²/s if plane). Collective.

        It is negative where water enters. In parts of a halved step, the last part counts.

        Raises:
            ParameterError: No condition for water acts there, see `poromechanics`.
        """
        if self.outflow_name not in self.points.fields:
            raise ParameterError(
                f"no problem has a condition for water at the surface '{self.name}': give it to "
                "mpm.poromechanics as drained=, seepage=, inflow= or ponded="
            )
        total = float(self._sizes() @ self.points[self.outflow_name])
        return self.points.comm.allreduce(total, op=MPI.SUM)
