"""Functions at the parts of faces that contact points stand for, as matrices from the nodes.

A corner of material that turns must touch where it is, or a body that tips turns about a place
inside of it. Yet its forces must be in balance with a uniform stress, or those beside it are wrong.
Averages N_1 over its own part of the face and N_2 over the neighbour's part do both:

    N = w_1 N_1 + w_2 N_2,   w_1 = (1 + 1/s)/2,   w_2 = (1 − 1/s)/2,

with the middles of the parts at ±s from the middle of the face, where its corners are at ±1. The
corner moves as the motion of the two parts, continued by a straight line. Both corners of a face
together have N_1 + N_2, and a corner alone has its force at its place. In 3D these are products
over both directions. The weights are dual functions of a mortar method, constant on each part:
B. Wohlmuth, SIAM J. Numer. Anal. 38 (2000) 989–1012.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt
import scipy

from dolfinmpm.basis import LatticeBasis, LinearBasis
from dolfinmpm.basis.facestencils import at_ends, in_domains
from dolfinmpm.basis.stencils import Stencils, stencil_matrix
from dolfinmpm.body.familyids import side_signs
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.contact.cornermatrices import CornerMatrices
from dolfinmpm.contact.displacementbasis import DisplacementBasis

__all__ = ["FaceFunctions", "parts_of_corners"]

Array = npt.NDArray[np.float64]
Rows = npt.NDArray[np.integer]
# Part of a half-length that is rounding
_ROUNDING = 1e-12
# Part of a half-length by which sheared material is beyond its domain
_SHEARED = 1e-6


class FaceFunctions:
    """Functions at parts of the faces of some points.

    Args:
        points: Material points.
        displacement: The basis functions of the displacement; they are averages over domains.
        matrices: Matrices of its points.
        in_boxes: Whether the parts lie in the domains; else they turn and shear with the points.
        F: Deformation gradients in the section, shape (points, gdim, gdim).
    """

    def __init__(
        self, points: MaterialPoints, displacement: DisplacementBasis, matrices: CornerMatrices,
        in_boxes: bool, F: Array,
    ):  # fmt: skip
        basis = displacement.basis
        assert not isinstance(basis, LinearBasis), "linear functions have no averages"
        self._points, self._basis, self._C = points, basis, displacement.C
        self._matrices = matrices
        self._in_boxes, self._F = in_boxes, F

    def parts(
        self, each: Rows, signs: Array, share: Array, stay: bool = False
    ) -> tuple[Array, scipy.sparse.csr_matrix]:
        """Middles of the parts of faces that corners stand for, and the averages over them.

        A part of sheared material may be beyond the cells of its domain. Then the corner stands for
        itself: it takes the functions of the nearest of these cells, continued.

        Args:
            each: Point of each corner, shape (m,).
            signs: Place of each corner in its domain, ±1, shape (m, gdim).
            share: Places of the parts, see `dolfinmpm.contact.cornerareas.places_on_faces`.
            stay: Whether a part beyond these cells keeps its middle, in place of its corner.

        Returns:
            Offsets from the points (m), shape (m, gdim), and the matrix, shape (m, nodes).
        """
        points, basis = self._points, self._basis
        half = points["l"][each]
        within = np.where(1.0 - share > _ROUNDING, (1.0 - share) * half, 0.0)
        r = self.within(each, signs * share)
        if self._in_boxes or not isinstance(basis, LatticeBasis):
            # beyond the domain the functions are continued by the gradients at the point
            inside = np.clip(r, within - half, half - within)
        else:
            outside = self._outside(basis, each, r, within)[:, None]
            if not stay:
                r = np.where(outside, self.within(each, signs), r)
            inside, within = r, np.where(outside, 0.0, within)
        x = points["x"][each]
        return r, self._continued(in_domains(basis, x + inside, within, x, half), r - inside, each)

    def at_corners(
        self, each: Rows, signs: Array, share: Array
    ) -> tuple[Array, scipy.sparse.csr_matrix]:
        """Corners of faces, and averages over all parts of their faces; see the module.

        Args:
            each, signs, share: See `parts`.

        Returns:
            As `parts`.
        """
        place, matrix = np.zeros(signs.shape), None
        for flips, weight in parts_of_corners(share):
            k = np.flatnonzero(weight)
            r, M = self.parts(each[k], signs[k] * flips, share[k], stay=True)
            place[k] += weight[k, None] * r
            own = (weight[k], (k, np.arange(k.size)))
            part = scipy.sparse.csr_matrix(own, shape=(each.size, k.size)) @ M
            matrix = part if matrix is None else matrix + part
        return place, scipy.sparse.csr_matrix(matrix)

    def at_ends(self, each: Rows, reach: Array, along: Array) -> scipy.sparse.csr_matrix:
        """Functions at places on marked faces, continued from those of `Surface.dX` for loads.

        Value and gradient at the point are in balance with a uniform stress only while its domain
        lies in one cell, see `dolfinmpm.basis.facestencils`.

        Args:
            each: Point of each face, shape (m,).
            reach: Offset of the middle of each face from its point (m), shape (m, gdim).
            along: Way from there to the place on the face (m), shape (m, gdim).
        """
        x, half = self._points["x"][each], self._points["l"][each]
        s, rest = at_ends(self._basis, x, half, reach)
        return self._continued(s, rest + along, each)

    def _continued(self, s: Stencils, rest: Array, each: Rows) -> scipy.sparse.csr_matrix:
        """Functions at some places, continued by the gradients at their points.

        Args:
            s: The functions.
            rest: Ways by which they are continued (m), shape (m, gdim).
            each: Point of each place, shape (m,).
        """
        M = stencil_matrix(s, s.N, (len(each), self._basis.nodes.size))
        M = M if self._C is None else scipy.sparse.csr_matrix(M @ self._C)
        if np.any(np.abs(rest) > _ROUNDING * self._points["l"][each]):
            M = M + self._matrices.by_gradient(each, rest, value=False)
        return M

    def within(self, each: Rows, at: Array) -> Array:
        """Offsets of places from their points (m), shape (m, gdim).

        Args:
            each: Point of each place, shape (m,).
            at: Places by half-lengths of the domains, or of the material, shape (m, gdim).
        """
        if self._in_boxes:
            return np.asarray(at * self._points["l"][each])
        return np.asarray(np.einsum("cij,cj->ci", self._F[each], at * self._points["l0"][each]))

    def _outside(
        self, basis: LatticeBasis, each: Rows, r: Array, within: Array
    ) -> npt.NDArray[np.bool_]:
        """Which parts of sheared material are beyond the cells of the domains of their points.

        Args:
            basis: The basis.
            each: Point of each corner, shape (m,).
            r, within: Offsets from the points, and half-lengths of the parts (m), shape (m, gdim).
        """
        x, half = self._points["x"][each], self._points["l"][each]
        first, number = basis.spans(x, half)
        # ends of domains may be beyond these cells by a sliver, which has no share there
        beyond = np.abs(r) + within > (1.0 + _SHEARED) * half
        outside = np.zeros(len(x), bool)
        for d, line in enumerate(basis.lattice.lines):
            at, to = first[:, d] + basis.halo.origin[d], x[:, d] + r[:, d]
            low, high = line[at], line[at + number[:, d]]
            out = (to - within[:, d] < low) | (to + within[:, d] > high)
            outside |= out & beyond[:, d]
        return outside


def parts_of_corners(share: Array) -> Iterator[tuple[Array, Array]]:
    """Weights of the parts of faces in the functions of their corners; see the module.

    Args:
        share: Places of the parts, see `dolfinmpm.contact.cornerareas.places_on_faces`, shape
            (m, d).

    Yields:
        Signs that lead from a corner to that of the part, shape (d,), and the weights of the part,
        shape (m,).
    """
    sides = 1.0 - share > _ROUNDING
    own = np.where(sides, 0.5 + 0.5 / share, 1.0)
    for flips in side_signs(share.shape[1]):
        yield flips, np.prod(np.where(flips > 0, own, 1.0 - own), axis=1)
