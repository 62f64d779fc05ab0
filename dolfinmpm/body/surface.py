"""Loads on faces of a body: tractions, follower pressures and rigid footings at material points.

Material points are inside the body, its faces are not: a load that acts at the
points instead of the face has the right force but a wrong moment. A point at a face
therefore keeps the offset R of the face from its centre and the face's area vector
A0 (area times outward normal), both as they are at first. Its own stencil then gives
the motion of the face to first order, u(x_s) = u + ∇ũ·r with r = F_n R, which is
also how far the point's own material reaches there.

Every form here is the virtual work of what acts on the body and is subtracted from the
internal forces: F = momentum(...) − surface.traction(t, v).
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from mpi4py import MPI
from scipy.spatial import cKDTree
from ufl.core.expr import Expr

from dolfinmpm._platform.errors import (
    EmptyShapeError,
    FieldShapeError,
    ParameterError,
    UnsupportedGridError,
    call_together,
    raise_together,
)
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.grid.lattice import cell_size, lattice_of

__all__ = ["RigidFooting", "Surface"]

Array = npt.NDArray[np.float64]
Where = Callable[[Array], npt.ArrayLike]

_numbers = itertools.count(1)
# The default penalty in units of E/h: ten times more changes the reaction by less than a thousandth
# (cubic splines, which bend sharply at a footing's edge: by some per cent on few cells), and
# the first out-of-balance force, which a step's tolerance is relative to, is not yet all penalty.
_STIFFNESS = 1e4


class Surface:
    """Material points at a loaded face of a body, with the offset and the area of their faces.

    Adds to the points, and so moves with them, the fields `<name>_offset` (m), from
    the centre of a point to its face, and `<name>_area` (m^(d-1)), the area vector;
    both as they were at first, and zero for points that are not at the face. A
    point at an edge of the body may belong to several surfaces.

    Args:
        points: Material points.
        where: Function of the centres of the points' faces as they were at first (m), in
            DOLFINx's layout, shape (gdim, n), that returns n booleans. The faces are
            those of the points' domains, x0 + l0·n.
        normal: Outward unit normal of the face: an axis of the grid, such as (0, 1).
        name: Name of the fields; `surface1`, `surface2`, ... by default.

    Attributes:
        points: The material points.
        name: Name of the surface.
        normal: Its outward normal, shape (gdim,), or None where arrays were given.
        total_area: Area at first (m^(d-1)), on all ranks.
        offset, area: The fields, for UFL.

    Raises:
        ParameterError: The normal is not a unit axis, the name is taken, or some of the
            faces lie inside the body.
        EmptyShapeError: No face lies there.
        UnsupportedGridError: The grid is not rectangular.
    """

    def __init__(
        self,
        points: MaterialPoints,
        where: Where,
        normal: Sequence[float],
        name: str | None = None,
    ):
        n = np.asarray(normal, float)
        if n.shape != (points.gdim,) or not np.array_equal(
            np.sort(np.abs(n)), [0.0] * (points.gdim - 1) + [1.0]
        ):
            raise ParameterError(
                f"normal = {normal} must be an axis of {points.gdim}D with a sign, such as "
                f"{(0,) * (points.gdim - 1) + (1,)}; give other faces by Surface.from_arrays"
            )
        if lattice_of(points.grid) is None:
            raise UnsupportedGridError(
                "points have domains with faces along the axes on rectangular grids only; give "
                "offsets and areas of faces by Surface.from_arrays"
            )
        offset = points["l0"] * n
        faces = points["x0"] + offset

        def choose() -> npt.NDArray[np.bool_]:
            if not len(points):
                return np.zeros(0, bool)
            chosen = np.asarray(where(np.ascontiguousarray(faces.T)))
            if chosen.shape != (len(points),) or chosen.dtype != bool:
                raise ParameterError(
                    f"where should return {len(points)} booleans here, got {chosen.dtype} of shape "
                    f"{chosen.shape}"
                )
            return chosen

        chosen = call_together(points.comm, choose)
        axis = int(np.argmax(np.abs(n)))
        if points.comm.allreduce(int(chosen.sum()), op=MPI.SUM) == 0:
            low = points.comm.allreduce(faces[:, axis].min(initial=np.inf), op=MPI.MIN)
            high = points.comm.allreduce(faces[:, axis].max(initial=-np.inf), op=MPI.MAX)
            raise EmptyShapeError(
                f"no point has its face towards {tuple(normal)} where `where` says; the centres of "
                f"these faces lie between {low:.6g} and {high:.6g} m on that axis: compare with "
                "np.isclose"
            )
        _check_exposed(points, chosen, n)
        across = np.delete(points["l0"], axis, axis=1)
        area = np.prod(2 * across, axis=1)[:, None] * n
        self._set(points, np.where(chosen[:, None], offset, 0.0),
                  np.where(chosen[:, None], area, 0.0), name, n)  # fmt: skip

    @classmethod
    def from_arrays(
        cls,
        points: MaterialPoints,
        offset: npt.ArrayLike,
        area: npt.ArrayLike,
        name: str | None = None,
    ) -> Surface:
        """A surface of any shape, its offsets and areas given point by point. Collective.

        Args:
            points: Material points.
            offset: From the points' centres to their faces, as at first (m), shape
                (points on this rank, gdim).
            area: Area times outward unit normal, as at first (m^(d-1)), likewise; zero
                for points that are not at the face.
            name: Name of the fields.

        Raises:
            FieldShapeError: An array has another shape.
            ParameterError: A value is not finite, or the name is taken.
            EmptyShapeError: All areas are zero.
        """
        R, A = (np.asarray(values, float) for values in (offset, area))
        error: Exception | None = None
        for what, values in (("offset", R), ("area", A)):
            if values.shape != (len(points), points.gdim):
                error = FieldShapeError(
                    f"{what} should have shape {(len(points), points.gdim)} (this rank's points "
                    f"first), got {values.shape}"
                )
            elif not np.isfinite(values).all():
                p = int(np.flatnonzero(~np.isfinite(values).all(axis=1))[0])
                error = ParameterError(
                    f"{what} = {values[p]} of the point at {points['x'][p]} m must be finite"
                )
        raise_together(points.comm, error)
        if not points.comm.allreduce(bool(np.any(A)), op=MPI.LOR):
            raise EmptyShapeError("all areas of the surface are zero; give some point an area")
        surface = cls.__new__(cls)
        surface._set(points, R, A, name, None)
        return surface

    def _set(self, points: MaterialPoints, R: Array, A: Array, name, normal) -> None:
        if name is None:
            name = f"surface{next(_numbers)}"
        if f"{name}_area" in points.fields:
            raise ParameterError(f"the points have a surface '{name}' already; choose another name")
        self.points, self.name, self.normal = points, name, normal
        self.offset = points.add_field(f"{name}_offset", (points.gdim,), "m")
        self.area = points.add_field(f"{name}_area", (points.gdim,), "m^(d-1)")
        points[self.offset.name], points[self.area.name] = R, A
        self.total_area = points.comm.allreduce(float(self._sizes().sum()), op=MPI.SUM)

    def _sizes(self) -> Array:
        return np.linalg.norm(self.points[self.area.name], axis=1)

    # -- of UFL ---------------------------------------------------------------

    @property
    def density(self) -> Expr:
        """Area of the face per initial volume of its point (1/m), a field for UFL.

        Its integral over `points.dX` is the area of the surface at first.
        """
        return ufl.sqrt(ufl.dot(self.area, self.area)) / self.points.V0

    def at(self, w) -> Expr:
        """An increment or a test function at the face: w + ∇w·F_n R."""
        return w + ufl.dot(ufl.grad(w), ufl.dot(self.points.F, self.offset))

    def position(self, u=None) -> Expr:
        """Position of the face (m) at the start of the step, or under the increment u."""
        start = self.points.x + ufl.dot(self.points.F, self.offset)
        return start if u is None else start + self.at(u)

    def traction(self, t, v) -> ufl.Form:
        """Virtual work of a dead traction, to be subtracted: ∫ t·v(x_s) dA0.

        Args:
            t: Force per area at first (Pa), a vector: a DOLFINx constant, or any UFL
                expression that has values at the points.
            v: Test function, `Space.test`.
        """
        return self.density * ufl.dot(_vector(t), self.at(v)) * self.points.dX

    def force(self, P, v) -> ufl.Form:
        """Virtual work of a dead force that is spread evenly, to be subtracted.

        Args:
            P: Force (N; N/m in plane strain), a vector like that of `traction`.
            v: Test function, `Space.test`.
        """
        return self.traction(_vector(P) / self.total_area, v)

    def pressure(self, p, u, v) -> ufl.Form:
        """Virtual work of a pressure that follows the face, to be subtracted.

        −∫ p J F⁻ᵀ A0 · v(x_s) with F = (I + ∇ũ) F_n, by Nanson's formula. The tangent is
        derived from it, that of the load included.

        Args:
            p: Pressure on the face as it is now (Pa), positive towards the body: a DOLFINx
                constant or a scalar UFL expression, which `position` may enter.
            u: Increment of the step, `Space.increment`.
            v: Test function, `Space.test`.
        """
        points = self.points
        F = ufl.dot(ufl.Identity(points.gdim) + ufl.grad(u), points.F)
        face = ufl.det(F) * ufl.dot(self.area, ufl.inv(F))
        return -p * ufl.dot(face, self.at(v)) / points.V0 * points.dX

    def mean(self, direction, w) -> ufl.Form:
        """Mean over the initial area of w(x_s) · direction, a form linear in w.

        With a test function it is what `ArcLength` takes as control.

        Args:
            direction: A vector: numbers, or a UFL expression.
            w: Test function, `Space.test`.
        """
        return self.traction(_vector(direction) / self.total_area, w)

    def mean_normal(self, w) -> ufl.Form:
        """Mean over the initial area of w(x_s) along the outward normal; see `mean`."""
        return ufl.dot(self.area, self.at(w)) / (self.total_area * self.points.V0) * self.points.dX

    # -- of numbers -----------------------------------------------------------

    def displacements(self) -> Array:
        """Displacements of the faces since the first (m), shape (points on this rank, gdim)."""
        points, R = self.points, self.points[self.offset.name]
        moved = np.einsum("pij,pj->pi", points["F"], R) - R
        return points["x"] - points["x0"] + moved

    def mean_displacement(self) -> Array:
        """Mean displacement over the initial area (m), shape (gdim,). Collective."""
        return self.points.comm.allreduce(self._sizes() @ self.displacements()) / self.total_area


class RigidFooting:
    """A rigid footing that is pressed into a face of the body by a given settlement.

    The faces of the surface's points are held to the footing's motion by a penalty on
    their *total* gap, g = n·(x_s − X_s) + s, where X_s is where the face was when the
    footing was made: a gap that a step leaves is seen by the next one, so that nothing
    accumulates. A rough footing holds the faces sideways as well, a smooth one does not.
    Both keep hold of what they touch: they pull when they are lifted.

    Adds to the points the field `<surface>_seat` (m), where the faces were; with a number
    behind it if the surface had a footing before.

    Args:
        surface: What is under the footing, with an axis as its normal.
        settlement: How far the footing has moved into the body (m) since it was made,
            against the outward normal: a scalar DOLFINx constant. In parts of a step
            the solver scales it like any load.
        rough: Whether the faces are held sideways too.
        E: Young's modulus of the body (Pa), for the default stiffness 10⁴ E/h, h being
            the size of the largest cell.
        stiffness: Penalty (Pa/m), instead.

    Raises:
        ParameterError: The surface has no axis for its normal, the settlement is not a
            scalar constant, or neither E nor the stiffness is positive and finite.
    """

    def __init__(
        self,
        surface: Surface,
        settlement: fem.Constant,
        rough: bool = True,
        E: float | None = None,
        stiffness: float | None = None,
    ):
        points = surface.points
        if surface.normal is None:
            raise ParameterError(
                f"the surface '{surface.name}' was made from arrays and has no single normal; make "
                "it with Surface(points, where, normal)"
            )
        if not isinstance(settlement, fem.Constant) or settlement.ufl_shape != ():
            raise ParameterError(
                f"settlement = {settlement!r} must be a scalar dolfinx.fem.Constant (m)"
            )
        if stiffness is None:
            if E is None or not 0 < E < np.inf:
                raise ParameterError(
                    f"E = {E} Pa must be positive and finite; it is the body's, for the stiffness "
                    f"{_STIFFNESS:g} E/h by default"
                )
            stiffness = _STIFFNESS * E / _largest_cell(points)
        if not 0 < stiffness < np.inf:
            raise ParameterError(f"stiffness = {stiffness} Pa/m must be positive and finite")
        self.surface, self.settlement, self.rough = surface, settlement, rough
        self.stiffness = float(stiffness)
        # a constant of the form, for a number would be compiled into it
        self._k = fem.Constant(points.grid, np.float64(self.stiffness))
        self._first = float(settlement.value)
        names = (f"{surface.name}_seat{k or ''}" for k in itertools.count())
        seat = next(name for name in names if name not in points.fields)
        self._seat = points.add_field(seat, (points.gdim,), "m")
        points[self._seat.name] = self._faces()

    def _faces(self) -> Array:
        points, R = self.surface.points, self.surface.points[self.surface.offset.name]
        return points["x"] + np.einsum("pij,pj->pi", points["F"], R)

    def contact(self, u, v) -> ufl.Form:
        """Virtual work of the footing on the body, to be subtracted: −∫ k g·v(x_s) dA0.

        Args:
            u: Increment of the step, `Space.increment`.
            v: Test function, `Space.test`.
        """
        surface = self.surface
        n = ufl.as_vector([float(c) for c in surface.normal])
        gap = surface.position(u) - self._seat + (self.settlement - self._first) * n
        if not self.rough:
            gap = ufl.dot(gap, n) * n
        return surface.traction(-self._k * gap, v)

    def gaps(self) -> Array:
        """What the penalty leaves of the gaps (m), shape (points on this rank, gdim)."""
        n = self.surface.normal
        gap = self._faces() - self.surface.points[self._seat.name]
        gap += (float(self.settlement.value) - self._first) * n
        gap = gap if self.rough else np.outer(gap @ n, n)
        return np.where(self.surface._sizes()[:, None] > 0, gap, 0.0)

    def reaction(self) -> Array:
        """Force of the footing on the body (N; N/m in plane strain), shape (gdim,). Collective."""
        force = -self.stiffness * (self.surface._sizes() @ self.gaps())
        return self.surface.points.comm.allreduce(force, op=MPI.SUM)

    def load(self) -> float:
        """Force that presses the footing into the body (N; N/m in plane strain). Collective."""
        return float(-self.reaction() @ self.surface.normal)


def _vector(t) -> Any:
    return t if isinstance(t, Expr) else ufl.as_vector([float(c) for c in t])


def _largest_cell(points: MaterialPoints) -> float:
    h = cell_size(points.grid)
    sizes = h.x.array if isinstance(h, fem.Function) else np.array([h.value])
    return points.comm.allreduce(float(sizes.max(initial=0.0)), op=MPI.MAX)


def _check_exposed(points: MaterialPoints, chosen, n: Array) -> None:
    """No chosen face may have another point in front of it: it would be inside the body."""
    x, half = points["x0"], points["l0"]
    mine = x[chosen] + 1.02 * half[chosen] * n
    probes = np.concatenate(points.comm.allgather(mine))
    hidden = np.zeros(len(probes), bool)
    if len(points) and len(probes):
        near = cKDTree(x).query_ball_point(probes, half.max(), p=np.inf)
        owner = np.repeat(np.arange(len(probes)), [len(found) for found in near])
        others = np.concatenate([np.asarray(found, np.int64) for found in near])
        # domains of points that are not on one lattice overlap a little at their sides
        covered = np.all(np.abs(probes[owner] - x[others]) < 0.99 * half[others], axis=1)
        hidden[owner[covered]] = True
    total = np.flatnonzero(points.comm.allreduce(hidden.astype(np.int32), op=MPI.SUM))
    if total.size:
        raise ParameterError(
            f"{total.size} of {len(probes)} chosen faces are inside the body, with another point "
            f"right in front of them, such as the one at {probes[total[0]]} m; let `where` choose "
            "the body's own faces"
        )
