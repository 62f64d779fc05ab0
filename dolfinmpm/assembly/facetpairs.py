"""The penalty that two cells at a facet need, from an eigenproblem of these two alone.

Let one cell be full and the other empty but for next to nothing. The energy that the
empty one would have were it full is bounded by the energy that there is, of the full cell and
of the penalty γ J:

    u·K_cut u ≤ C (u·K_full u + γ u·J u)  for all u.

The *local constant* C is what conditioning, stable steps and unfitted conditions depend on. It
falls with γ to the constant C∞ of functions without jumps. The least γ by which it is no more
than a target T > C∞ follows from one eigenproblem: T K_full − K_cut + γ T J ≥ 0 on functions of the
cells; those without jumps are eliminated, and what remains is bounded by J.

Moduli enter by the ratio of G to M alone, the penalty being proportional to M. It is computed at
equal intervals of the ratio, as far as these are needed, and interpolated.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import basix
import numpy as np
import numpy.typing as npt
from dolfinx import fem
from dolfinx.mesh import Mesh

from dolfinmpm._platform.compat import geometry_dofmap
from dolfinmpm.assembly.facettensors import FacetPlace, one_dimensional, product
from dolfinmpm.basis.space import Space
from dolfinmpm.grid.lattice import cell_size

__all__ = [
    "INTERVALS",
    "MeshPairs",
    "Pair",
    "by_ratio",
    "isotropic",
    "lattice_pair",
    "least_penalty",
    "local_constant",
    "smooth_constant",
]

Array = npt.NDArray[np.float64]

# Intervals of the ratio G/M. A linear penalty changes by 4 % in the widest of them.
INTERVALS = 32
# C∞ times this is the least constant aimed at: next to C∞ itself the penalty goes to infinity.
LEAST_TARGET = 2.0
# Eigenvalues of a matrix that are rounding of 0, by the largest.
_NONE = 1e-10


def _parted(A: Array) -> tuple[Array, Array]:
    """Vectors between which a matrix is zero, and those between which it is the identity."""
    values, vectors = np.linalg.eigh(A)
    some = values > _NONE * values[-1]
    return vectors[:, ~some], vectors[:, some] / np.sqrt(values[some])


def local_constant(full: Array, cut: Array, penalty: Array) -> float:
    """C of two cells, the largest eigenvalue of K_cut u = C (K_full + γ J) u.

    Args:
        full: K_full, shape (n, n).
        cut: K_cut, likewise.
        penalty: γ J, likewise.
    """
    _, own = _parted(full + penalty)
    return float(np.linalg.eigvalsh(own.T @ cut @ own)[-1])


def smooth_constant(full: Array, cut: Array, smooth: Array) -> float:
    """C∞ of two cells, by functions without jumps.

    Args:
        full: K_full, shape (n, n).
        cut: K_cut, likewise.
        smooth: The functions, shape (n, m).
    """
    _, own = _parted(smooth.T @ full @ smooth)
    own = smooth @ own
    return float(np.linalg.eigvalsh(own.T @ cut @ own)[-1])


def least_penalty(full: Array, cut: Array, J: Array, target: float) -> float:
    """The least γ by which the local constant is no more than a target.

    Where the target is less than 2 C∞, that is aimed at.

    Args:
        full: K_full, shape (n, n).
        cut: K_cut, likewise.
        J: The penalty by γ, likewise.
        target: T.
    """
    smooth, jumps = _parted(J)
    target = max(target, LEAST_TARGET * smooth_constant(full, cut, smooth))
    A = target * full - cut
    # rigid motions, and what neither cell resists, are in no need
    inner, across = smooth.T @ A @ smooth, smooth.T @ A @ jumps
    values, vectors = np.linalg.eigh(inner)
    some = values > _NONE * values[-1]
    across = vectors[:, some].T @ across
    rest = jumps.T @ A @ jumps - across.T @ (across / values[some, None])
    return max(0.0, -float(np.linalg.eigvalsh(rest)[0])) / target


def isotropic(M: float, G: float, gdim: int) -> Array:
    """The isotropic tangent of two moduli, shape (gdim,) * 4."""
    one = np.eye(gdim)
    shear = np.einsum("ik,jl->ijkl", one, one) + np.einsum("il,jk->ijkl", one, one)
    return (M - 2 * G) * np.einsum("ij,kl->ijkl", one, one) + G * shear


class Pair:
    """Stiffness of two cells, and the penalty between them.

    Args:
        gradients: ∫ ∂_i N_a ∂_k N_b of each cell, shape (2, gdim, functions, gdim, functions).
        J: The penalty by γ, between functions and components, shape (n, n).
    """

    def __init__(self, gradients: Array, J: Array):
        self._gradients, self.J = gradients, J

    def stiffness(self, tangent: Array) -> Array:
        """Of both cells under a tangent D_ijkl (Pa), shape (2, n, n)."""
        K = np.einsum("risk,ciakb->carbs", tangent, self._gradients)
        return K.reshape(2, *self.J.shape)

    def penalty(self, ratio: float, target: float) -> float:
        """The least γ for a target, whichever cell is cut, for M = 1 and G = ratio."""
        first, second = self.stiffness(isotropic(1.0, ratio, self._gradients.shape[1]))
        return max(
            least_penalty(first, second, self.J, target),
            least_penalty(second, first, self.J, target),
        )


def by_ratio(
    kept: Array, ratios: Array, kind: npt.NDArray[np.integer], pairs: Sequence[Callable[[], Pair]],
    target: float,
) -> Array:  # fmt: skip
    """Penalties at facets for M = 1, alike ones computed once, shape (facets,).

    Args:
        kept: Those known, by kind and place on the line of ratios, not a number where unknown;
            shape (kinds, INTERVALS + 1); completed.
        ratios: G/M of every facet, shape (facets,).
        kind: Kind of every facet, likewise.
        pairs: What makes the pair of cells of a kind.
        target: Constant aimed at.
    """
    at = np.clip(ratios, 0.0, 1.0) * INTERVALS
    low = np.minimum(at.astype(int), INTERVALS - 1)
    for k in np.unique(kind):
        of_kind = low[kind == k]
        missing = [i for i in np.union1d(of_kind, of_kind + 1) if np.isnan(kept[k, i])]
        if missing:
            pair = pairs[k]()
            for i in missing:
                kept[k, i] = pair.penalty(i / INTERVALS, target)
    share = at - low
    return (1 - share) * kept[kind, low] + share * kept[kind, low + 1]


def lattice_pair(place: FacetPlace, degree: int, tensor: Array) -> Pair:
    """The two cells at a facet of a lattice.

    Args:
        place: The facet.
        degree: Degree of the splines.
        tensor: Tensor of the penalty by γ; see `FacetTensors`.
    """
    d, n = len(place.lines), tensor.shape[0]
    gradients = np.empty((2, d, n, d, n))
    for c, side in enumerate("+-"):
        lines = [one_dimensional(place, side, e, degree) for e in range(d)]
        for i in range(d):
            for k in range(d):
                parts = [lines[e][int(e == i)][int(e == k)] for e in range(d)]
                gradients[c, i, :, k] = product(parts)
    J = tensor.reshape(n, n, -1)
    blocks = J[:, :, 0, None, None] * np.eye(d) if J.shape[2] == 1 else J.reshape(n, n, d, d)
    return Pair(gradients, blocks.transpose(0, 2, 1, 3).reshape(n * d, n * d))


class MeshPairs:
    """The two cells at facets of any mesh with straight edges, under linear functions.

    The penalty is the `ghost` one of first derivatives, with the sizes of cells in it.

    Args:
        space: Space of the increment.
        scaling: Of the penalty; see `ghost`.
    """

    def __init__(self, space: Space, scaling: str):
        self._grid: Mesh = space.grid
        self._literal = scaling == "literal"
        self._nodes: npt.NDArray[np.int32] = space.function_space.dofmap.list
        self._geometry = geometry_dofmap(space.grid)
        element: Any = space.function_space.element.basix_element
        kind = element.cell_type
        self._element, self._degree = element, 2 * element.degree
        self._shape: Any = basix.create_element(basix.ElementFamily.P, kind, 1)
        self._corners: Array = np.array(basix.geometry(kind))
        self._facets: list[list[int]] = basix.topology(kind)[-2]
        self._inside = self._rule(kind)

    def _coordinates(self, cell: int) -> Array:
        # vertices come first, in the order of the reference cell
        x = self._grid.geometry.x[self._geometry[cell][: len(self._corners)]]
        return np.asarray(x[:, : self._grid.geometry.dim])

    def _slopes(self, cell: int, X: Array) -> tuple[Array, Array]:
        """Gradients (points, functions, gdim) and |det J| at reference points."""
        x = self._coordinates(cell)
        J = np.einsum("jpn,ni->pij", self._shape.tabulate(1, X)[1:, :, :, 0], x)
        own = self._element.tabulate(1, X)[1:, :, :, 0]
        slopes = np.einsum("jpa,pji->pai", own, np.linalg.inv(J))
        return slopes, np.abs(np.linalg.det(J))

    def __call__(self, row: npt.NDArray[np.int32]) -> Pair:
        """The pair at a facet, given as (cell, local facet, cell, local facet)."""
        cells, d = (int(row[0]), int(row[2])), self._grid.geometry.dim
        nodes = np.concatenate([self._nodes[c] for c in cells])
        number, place = np.unique(nodes, return_inverse=True)
        n, places = number.size, place.reshape(2, -1)
        gradients = np.zeros((2, d, n, d, n))
        X, weights = self._inside
        for c, cell in enumerate(cells):
            slopes, scale = self._slopes(cell, X)
            values = np.einsum("pai,pbk,p->iakb", slopes, slopes, weights * scale)
            gradients[c][np.ix_(range(d), places[c], range(d), places[c])] = values
        corners = self._matched(cells, (int(row[1]), int(row[3])))
        t, weights = self._along(len(corners[0]))
        x = self._shape.tabulate(0, corners[0])[0, :, :, 0] @ self._coordinates(cells[0])
        normal, area = _normal(x[1:d] - x[0])
        jump = np.zeros((len(t), n))
        for c, sign in enumerate((1.0, -1.0)):
            on = corners[c][0] + t @ (corners[c][1:d] - corners[c][0])
            jump[:, places[c]] += sign * self._slopes(cells[c], on)[0] @ normal
        h = cell_size(self._grid)
        size = float(h.x.array[list(cells)].mean() if isinstance(h, fem.Function) else h.value)
        factor = size**3 / 3 if self._literal else size / 3
        J: Array = factor * area * (jump.T * weights) @ jump
        return Pair(gradients, np.asarray(np.kron(J, np.eye(d)), float))

    def _along(self, corners: int) -> tuple[Array, Array]:
        """Coordinates in a facet with so many corners, and weights."""
        if corners == 1:
            return np.empty((1, 0)), np.ones(1)
        cell = basix.CellType
        kind = {2: cell.interval, 3: cell.triangle, 4: cell.quadrilateral}[corners]
        return self._rule(kind)

    def _rule(self, kind: basix.CellType) -> tuple[Array, Array]:
        points, weights = basix.make_quadrature(kind, self._degree)
        return np.array(points, float), np.array(weights, float)

    def _matched(self, cells: tuple[int, int], facets: tuple[int, int]) -> tuple[Array, Array]:
        """Corners of a facet in the reference cells of both its cells, in one order."""
        at, x = [], []
        for cell, facet in zip(cells, facets):
            at.append(self._corners[self._facets[facet]])
            x.append(self._coordinates(cell)[self._facets[facet]])
        apart = np.linalg.norm(x[0][:, None] - x[1], axis=2)
        return at[0], at[1][np.argmin(apart, axis=1)]


def _normal(edges: Array) -> tuple[Array, float]:
    """Normal of a flat facet, of either sign, and the size of the box of its edges."""
    if edges.shape[1] == 1:
        return np.ones(1), 1.0
    across = np.array([edges[0, 1], -edges[0, 0]]) if len(edges) == 1 else np.cross(*edges)
    area = float(np.linalg.norm(across))
    return across / area, area
