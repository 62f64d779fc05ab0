"""Contact points of a body of material points: corners of the points' domains or of marked faces.

A corner is a quadrature point of contact, with its own stencil. There are two kinds of corners.
Corners of domains are at x ± l, where l grows as `Space(domains=...)` says. Corners of the material
are at x + F R with R = ±l0, and turn and shear with the points. Then neighbours share their corners
when a body bends, and a bent surface has no steps. In large shear a corner of the material is far
from its point. Bases without domains have corners of the material, unless `Space(domains=...)` is
the rule for flow, "volume" or "fixed", in static steps.

If the basis has domains, a corner stands for its part of the domain's face. It lies in the middle
of this part, and uses the averages of the functions over it: as the load of a `Surface`, contact
with a plane along the grid's axes is then in balance with a uniform stress. Towards an oblique
plane the part is smaller. It vanishes at 45°, where only the corner itself touches. Its nodes are
nodes of its point. So contact makes no further nodes active and adds no couplings. With other bases
a corner at x + r moves by u + ∇u·r, as in `dolfinmpm.body.surface`. In steps in time gaps of parts
of faces are followed from step to step, see `dolfinmpm.contact.followedgaps`, and corners of the
material touch where they are, see `dolfinmpm.contact.facefunctions`. Other corners move with the
new states of their points, see `dolfinmpm.contact.contactstencils`.

If the normal of a marked face is an axis, only the corners on this face touch. A face from arrays
touches with its middle, whose functions are those of a load on this face, so that it is in balance
with a uniform stress, too. In steps in time it touches with its two Gauss points (four in 3D):
middles alone let a body tip about a place within its edge. Without time, two places per face would
stiffen coarse functions under small contacts.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy

from dolfinmpm.basis.gimp import update_domains
from dolfinmpm.body.axisymmetry import in_section, ring
from dolfinmpm.body.familyids import side_signs
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.body.surface import Surface
from dolfinmpm.contact.contactstencils import ContactStencils
from dolfinmpm.contact.cornerareas import edges_of_faces, face_areas, places_on_faces, slip_parts
from dolfinmpm.contact.cornermatrices import CornerMatrices
from dolfinmpm.contact.cornersatedges import AtEdges, pulled
from dolfinmpm.contact.displacementbasis import DisplacementBasis
from dolfinmpm.contact.facefunctions import FaceFunctions

__all__ = ["ALL", "CornerLayout", "Corners", "corner_count", "longest"]

Array = npt.NDArray[np.float64]
Rows = npt.NDArray[np.integer]
Which = Rows | slice
# Places of the two Gauss points on a face, from its middle (0) to its end (1)
_GAUSS_POINT = 3.0**-0.5
# All points, as rows that copy nothing
ALL = slice(None)


def corner_count(gdim: int, surface: Surface | None) -> int:
    """Number of corners per point."""
    return 2 ** (gdim - 1) if surface is not None and surface.normal is None else 2**gdim


@dataclass(frozen=True)
class Corners:
    """Corners of some points on an activation.

    Attributes:
        rows: Point of each corner, shape (m,).
        which: Number of each corner at its point, shape (m,).
        x: Positions at the start of the step (m), shape (m, gdim).
        stencils: Stencils of the corners.
    """

    rows: Rows
    which: Rows
    x: Array
    stencils: ContactStencils


class CornerLayout:
    """Where the corners of a body are, and how they move.

    Args:
        points: Material points.
        displacement: The basis functions of the displacement.
        surface: Marked faces, or None for all corners.
        material: True if corners follow the points' material, False if they follow the domains.

    Attributes:
        which: Numbers of the corners with which a point touches, shape (corners,).
        boxes: Whether corners belong to domains and lie between the nodes of their stencils.
        on_faces: Whether corners stand for parts of faces, and lie in their middles.
        at_corners: Whether such corners lie at the ends of the parts, not in their middles.
        gauss: Whether faces from arrays touch with their Gauss points, not with their middles.
    """

    def __init__(
        self, points: MaterialPoints, displacement: DisplacementBasis, surface: Surface | None,
        material: bool,
    ):  # fmt: skip
        self._points, self._displacement = points, displacement
        self._surface = surface
        self._F: Array = in_section(points, points["F"])
        self._matrices = CornerMatrices(points, displacement, self._F)
        self._by_middle = surface is not None and surface.normal is None
        # whether corners use the functions at their positions, and whether domains give positions
        averaged = displacement.basis.averaged and not displacement.total
        placed, static = averaged and not self._by_middle, displacement.growth is None
        self.boxes = placed and not material
        self.on_faces = placed and (static or displacement.followed)
        # corners of material turn with it, unless only a marked face touches
        self.at_corners = self.on_faces and material and surface is None
        # whether middles of faces take the functions at the ends of domains
        self._by_ends = averaged and self._by_middle and (static or displacement.followed)
        if averaged:
            self._faces = FaceFunctions(points, displacement, self._matrices, self.boxes, self._F)
        # corners of material that shears without bound move away from its volume
        own = surface is None and not (
            material or displacement.total or displacement.basis.averaged
        )
        flows = displacement.domains != "stretch"
        self._keeps_axes = own and flows and displacement.growth is None
        signs = side_signs(points.gdim)
        self.gauss = self._by_middle and not static
        self.which: Rows = np.arange(corner_count(points.gdim, surface))
        if self._by_middle and not self.gauss:
            self.which = self.which[:1]
        if surface is not None and surface.normal is not None:
            self.which = np.flatnonzero(signs @ surface.normal > 0)

    @property
    def in_time(self) -> bool:
        """Whether steps have inertia."""
        return self._displacement.growth is not None

    def reach(self, rows: Which = ALL) -> Array:
        """Largest distance of a point's corners from its centre (m), shape (points,)."""
        points = self._points
        if self.boxes:
            return _length(points["l"][rows])
        F = self._F[rows]
        size = np.sqrt(np.einsum("pij,pij->p", F, F))
        if self._by_middle:
            offset, edges = self._marked_faces(rows)
            return size * (_length(offset) + _GAUSS_POINT * np.sqrt(np.sum(edges**2, axis=(1, 2))))
        return size * _length(points["l0"][rows])

    def marked(self, rows: Which = ALL) -> npt.NDArray[np.bool_] | None:
        """Which points have corners, or None if all do."""
        if self._surface is None:
            return None
        return np.any(self._points[self._surface.area.name][rows] != 0.0, axis=1)

    def areas(self, corners: Corners, normal: Array) -> Array:
        """Area of the body's face per corner (m^(d-1)), shape (m,); see `cornerareas`.

        Corners of a marked face share its initial area, other corners those of their domain's
        initial faces. In axisymmetric problems the area is that all around, at the radius of the
        point, like the volume: then a uniform pressure balances a uniform stress.

        Args:
            corners: The corners.
            normal: Normal of the rigid surface at each corner, shape (m, gdim).
        """
        points, rows = self._points, corners.rows
        if self._surface is not None:
            area = np.linalg.norm(points[self._surface.area.name][rows], axis=1)
            return np.asarray(area / self.which.size)
        if not (self.boxes or self._keeps_axes):
            normal = self._in_material(rows, normal)
            normal = normal / np.linalg.norm(normal, axis=1)[:, None]
        areas = face_areas(points["l0"][rows], normal)
        return ring(points["x"][rows, 0], areas) if points.axisymmetric else areas

    def half_edges(self, rows: Rows) -> Array:
        """Half edges of the domains of points at this moment (m), shape (m, gdim, gdim).

        The column k is the half edge along the axis k of the domain.

        Args:
            rows: The points, shape (m,).
        """
        points = self._points
        axes = np.eye(points.gdim)[None]
        if self.boxes:
            half = points["l"][rows]
        elif self._keeps_axes:
            half = update_domains(self._F[rows], points["l0"][rows], self._displacement.domains)
        else:
            half, axes = points["l0"][rows], self._F[rows]
        return np.asarray(axes * half[:, None, :])

    @property
    def _one_for_all(self) -> bool:
        """Whether a face touches with its middle, and steps in time take its Gauss points."""
        return self._by_middle and not self.gauss

    def carried(self, state: Array, corners: Corners) -> Array:
        """Forces of the last step, or stiffnesses, at some corners, shape (m,) or (m, gdim).

        The middle of a face carries what its Gauss points carried in a step in time.

        Args:
            state: Values of all corners of the points, shape (points, corners) or more.
            corners: The corners.
        """
        if self._one_for_all:
            return np.asarray(state[corners.rows].sum(axis=1))
        return np.asarray(state[corners.rows, corners.which])

    def kept(self, state: Array, corners: Corners, values: Array, forces: bool) -> Array:
        """Values of some corners for the next step; those of all other corners are zero.

        The Gauss points of a face share the force at its middle, for steps in time that follow.

        Args:
            state, corners: See `carried`.
            values: Values at the corners, shape (m,) or (m, gdim).
            forces: Whether they are forces, or stiffnesses, and not lengths.
        """
        result = np.zeros_like(state)
        if self._one_for_all:
            result[corners.rows] = values[:, None] / (state.shape[1] if forces else 1)
        else:
            result[corners.rows, corners.which] = values
        return result

    def surface_parts(
        self, rows: Rows, which: Rows, normal: Array, gap: Array, edges: Array | None = None
    ) -> tuple[Array, Array]:
        """Parts of the rigid surface that corners cover; see `slip_parts`. Not of marked faces.

        Args:
            rows, which: Point of each corner, and number at its point, shape (m,).
            normal: Normal of the rigid surface at each corner, shape (m, gdim).
            gap: Gaps of the corners (m), shape (m,).
            edges: The half edges of each corner's domain, see `half_edges`; those of this moment
                by default.
        """
        edges = self.half_edges(rows) if edges is None else edges
        at = np.ones_like(normal)
        if self.on_faces and not self.at_corners:
            along = normal
            if not (self.boxes or self._keeps_axes):
                along = self._in_material(rows, normal)
            at = places_on_faces(along)
        return slip_parts(edges, normal, side_signs(self._points.gdim)[which], at, gap)

    def _marked_faces(self, rows: Which) -> tuple[Array, Array]:
        """Initial offsets of marked faces, (n, gdim), and half edges, (n, gdim - 1, gdim) (m)."""
        points, surface = self._points, self._surface
        assert surface is not None
        offset, area = points[surface.offset.name][rows], points[surface.area.name][rows]
        if points.axisymmetric:
            around = ring(points["x0"][rows, :1] + offset[:, :1], 1.0)
            area = np.divide(area, around, out=np.zeros_like(area), where=around > 0.0)
        return offset, edges_of_faces(area, points["l0"][rows])

    def _in_material(self, rows: Rows, normal: Array) -> Array:
        """Normals in the frame of the points' material, of any length."""
        return np.asarray(np.einsum("pij,pi->pj", self._F[rows], normal))

    def corners(
        self, rows: Rows, kept: Callable[[Array], Which],
        normals: Callable[[Array, Array], AtEdges],
        follow: Callable[[Rows, Rows, Array], Array | None],
    ) -> Corners:  # fmt: skip
        """The corners of some points.

        Args:
            rows: The points, increasing, shape (n,).
            kept: Function from positions of corners to the corners to keep, increasing.
            normals: Function of the kept corners' positions and of the ways to their points (m),
                that returns the normals of the rigid surface there; see
                `dolfinmpm.contact.cornersatedges`.
            follow: Function of points, numbers and positions of the corners on faces: shares by
                which they move with their domains, see `dolfinmpm.contact.followedgaps`, or None.
        """
        points = self._points
        which = np.tile(self.which, rows.size)
        each = np.repeat(rows, self.which.size)
        if self.boxes:
            how = side_signs(points.gdim)[which]
            x = points["x"][each] + how * points["l"][each]
        else:
            x, how = self._material_positions(each, which)
        k = kept(x)
        each, which, x, how = each[k], which[k], x[k], how[k]
        M: Any
        if self.on_faces or self._by_ends:
            if self.on_faces:
                found = normals(x, points["x"][each] - x)
                if found.beside.any():
                    touches = ~found.beside
                    each, which, found = each[touches], which[touches], found.chosen(touches)
                x, M = self._on_faces(each, which, found)
            else:
                offset = self._marked_faces(each)[0]
                middle = np.einsum("cij,cj->ci", self._F[each], offset)
                M = self._faces.at_ends(each, middle, how - middle)
            M = self._followed(M, each, x, follow(each, which, x))
        elif self.boxes:
            M = self._matrices.of_growth(each, how)
        else:
            M = self._matrices.by_gradient(each, how)
        stencils = ContactStencils.of(M, self._displacement.columns)
        place = self._displacement.place
        if place is not None:
            stencils = replace(stencils, nodes=place[stencils.nodes])
        return Corners(each, which, x, stencils)

    def _followed(self, M: Any, each: Rows, x: Array, share: Array | None) -> Any:
        """Stencils of faces at x that move with their domains or points by a share, or None."""
        if share is None or not share.any():
            return M
        if self.boxes:
            return self._matrices.with_domains(M, each, x, share)
        own = self._matrices.by_gradient(each, x - self._points["x"][each])
        rest, part = (scipy.sparse.diags(values) for values in (1.0 - share, share))
        return scipy.sparse.csr_matrix(rest @ M + part @ own)

    def _on_faces(
        self, each: Rows, which: Rows, found: AtEdges
    ) -> tuple[Array, scipy.sparse.csr_matrix]:
        """Places of the corners on their faces (m), and the functions there.

        Args:
            each: Point of each corner, shape (m,).
            which: Number of each corner at its point, shape (m,).
            found: Normals of the rigid surface at the corners, and those at an edge of it.
        """
        normal = found.normal
        if self._surface is not None:
            normal = np.broadcast_to(self._surface.normal, normal.shape)
        elif not self.boxes:
            normal = self._in_material(each, normal)
        signs, share = side_signs(self._points.gdim)[which], places_on_faces(normal)
        of = self._faces.at_corners if self.at_corners else self._faces.parts
        r, M = of(each, signs, share)
        if found.at_edge.any():
            r += self._faces.within(each, pulled(signs, share, found.at_edge))
        return self._points["x"][each] + r, M

    def _material_positions(self, each: Rows, which: Rows) -> tuple[Array, Array]:
        """Positions of corners, and offsets from their points for motion by the gradients."""
        points = self._points
        if self._keeps_axes:
            half = update_domains(self._F[each], points["l0"][each], self._displacement.domains)
            r = side_signs(points.gdim)[which] * half
            return points["x"][each] + r, r
        if self._by_middle:
            offset, edges = self._marked_faces(each)
            R = offset
            if self.gauss:
                signs = side_signs(points.gdim - 1)[which]
                R = R + _GAUSS_POINT * np.einsum("ck,cki->ci", signs, edges)
        else:
            R = side_signs(points.gdim)[which] * points["l0"][each]
        r = np.einsum("cij,cj->ci", self._F[each], R)
        # gradients at initial positions need initial offsets
        return points["x"][each] + r, R if self._displacement.total else r


def longest(half: Array) -> Array:
    """Largest half-length of each point, shape (n,), from (n, d)."""
    # by columns: NumPy's reductions of short rows are ten times slower
    return np.asarray(functools.reduce(np.maximum, half.T))


def _length(v: Array) -> Array:
    """Length of each row, shape (n,), from (n, d)."""
    return np.sqrt(functools.reduce(np.add, (v * v).T))
