"""The penalty for the facet between two cells, from an eigenproblem of these two cells.

Let one cell be full and the other cell almost empty. K_cut is the stiffness that the almost empty
cell would have if it were full. Its energy is bounded by the energy of the full cell and of the
penalty γ J:

    u·K_cut u ≤ C (u·K_full u + γ u·J u)  for all u.

Conditioning, stable steps and unfitted conditions depend on this *local constant* C. With
increasing γ, C falls to the constant C∞ of functions without jumps. The least γ with C ≤ T, for a
target T > C∞, follows from one eigenproblem: T K_full − K_cut + γ T J ≥ 0 on the functions of the
two cells. Functions without jumps are eliminated. The rest is bounded by J.

The penalty is proportional to the modulus M, and otherwise depends only on the ratio G/M. It is
computed at equal intervals of this ratio, where needed, and interpolated.
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
from dolfinmpm.assembly.latticefacets import LatticeFacet, one_dimensional, product
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

# Number of intervals of the ratio G/M. A linear penalty changes by at most 4 % in an interval.
INTERVALS = 32
# Least target, over C∞: near C∞ the penalty goes to infinity.
LEAST_TARGET = 2.0
# Eigenvalues below this share of the largest one are rounding errors of 0.
_NONE = 1e-10


def _parted(A: Array) -> tuple[Array, Array]:
    """Null space of a symmetric matrix, and scaled eigenvectors that turn it into the identity."""
    values, vectors = np.linalg.eigh(A)
    some = values > _NONE * values[-1]
    return vectors[:, ~some], vectors[:, some] / np.sqrt(values[some])


def local_constant(full: Array, cut: Array, penalty: Array) -> float:
    """Local constant C of two cells: the largest eigenvalue of K_cut u = C (K_full + γ J) u.

    Args:
        full, cut, penalty: K_full, K_cut and γ J, shape (n, n).
    """
    _, own = _parted(full + penalty)
    return float(np.linalg.eigvalsh(own.T @ cut @ own)[-1])


def smooth_constant(full: Array, cut: Array, smooth: Array) -> float:
    """Constant C∞ of two cells, with functions without jumps.

    Args:
        full, cut: K_full and K_cut, shape (n, n).
        smooth: The functions without jumps, shape (n, m).
    """
    _, own = _parted(smooth.T @ full @ smooth)
    own = smooth @ own
    return float(np.linalg.eigvalsh(own.T @ cut @ own)[-1])


def least_penalty(full: Array, cut: Array, J: Array, target: float) -> float:
    """The least γ for which the local constant is at most a target.

    A target below 2 C∞ is replaced by 2 C∞.

    Args:
        full, cut: K_full and K_cut, shape (n, n).
        J: The penalty over γ, shape (n, n).
        target: The target T.
    """
    smooth, jumps = _parted(J)
    target = max(target, LEAST_TARGET * smooth_constant(full, cut, smooth))
    A = target * full - cut
    # rigid motions, and motions that neither cell resists, need no penalty
    inner, across = smooth.T @ A @ smooth, smooth.T @ A @ jumps
    values, vectors = np.linalg.eigh(inner)
    some = values > _NONE * values[-1]
    across = vectors[:, some].T @ across
    rest = jumps.T @ A @ jumps - across.T @ (across / values[some, None])
    return max(0.0, -float(np.linalg.eigvalsh(rest)[0])) / target


def isotropic(M: float, G: float, gdim: int) -> Array:
    """Isotropic tangent with the moduli M and G (Pa), shape (gdim, gdim, gdim, gdim)."""
    one = np.eye(gdim)
    shear = np.einsum("ik,jl->ijkl", one, one) + np.einsum("il,jk->ijkl", one, one)
    return (M - 2 * G) * np.einsum("ij,kl->ijkl", one, one) + G * shear


class Pair:
    """Stiffness of two cells, and the penalty between them.

    Args:
        gradients: ∫ ∂_i N_a ∂_k N_b of each cell, shape (2, gdim, functions, gdim, functions).
        J: The penalty over γ, between functions and components, shape (n, n).
    """

    def __init__(self, gradients: Array, J: Array):
        self._gradients, self.J = gradients, J

    def stiffness(self, tangent: Array) -> Array:
        """Stiffness of both cells with a tangent D_ijkl (Pa), shape (2, n, n)."""
        K = np.einsum("risk,ciakb->carbs", tangent, self._gradients)
        return K.reshape(2, *self.J.shape)

    def penalty(self, ratio: float, target: float) -> float:
        """The least γ for a target, whichever of the cells is cut, with M = 1 and G = ratio."""
        first, second = self.stiffness(isotropic(1.0, ratio, self._gradients.shape[1]))
        return max(
            least_penalty(first, second, self.J, target),
            least_penalty(second, first, self.J, target),
        )


def by_ratio(
    kept: Array, ratios: Array, kind: npt.NDArray[np.integer], pairs: Sequence[Callable[[], Pair]],
    target: float,
) -> Array:  # fmt: skip
    """Penalties at facets for M = 1, shape (facets,). Facets of one kind share computations.

    Args:
        kept: Known penalties by kind and ratio, NaN if unknown, shape (kinds, INTERVALS + 1).
            Missing penalties are computed and written to it.
        ratios: G/M of every facet, shape (facets,).
        kind: Kind of every facet, shape (facets,).
        pairs: Function that makes the pair of cells, for every kind.
        target: Target of the local constant.
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


def lattice_pair(place: LatticeFacet, degree: int, tensor: Array) -> Pair:
    """The two cells at a facet of a lattice.

    Args:
        place: The facet.
        degree: Degree of the splines.
        tensor: Tensor of the penalty over γ; see `FacetTensors`.
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
    """The two cells at a facet of any mesh with straight edges, with linear functions.

    The penalty is the penalty of `ghost` on first derivatives, with the sizes of the cells.

    Args:
        space: Space of the increment.
        scaling: Scaling of the penalty; see `ghost`.
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
        """Gradients (1/m), shape (points, functions, gdim), and |det J| at reference points."""
        x = self._coordinates(cell)
        J = np.einsum("jpn,ni->pij", self._shape.tabulate(1, X)[1:, :, :, 0], x)
        own = self._element.tabulate(1, X)[1:, :, :, 0]
        slopes = np.einsum("jpa,pji->pai", own, np.linalg.inv(J))
        return slopes, np.abs(np.linalg.det(J))

    def __call__(self, row: npt.NDArray[np.int32]) -> Pair:
        """The pair of cells at a facet, given as (cell, local facet, cell, local facet)."""
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
        """Quadrature points and weights on a facet with a number of corners."""
        if corners == 1:
            return np.empty((1, 0)), np.ones(1)
        cell = basix.CellType
        kind = {2: cell.interval, 3: cell.triangle, 4: cell.quadrilateral}[corners]
        return self._rule(kind)

    def _rule(self, kind: basix.CellType) -> tuple[Array, Array]:
        points, weights = basix.make_quadrature(kind, self._degree)
        return np.array(points, float), np.array(weights, float)

    def _matched(self, cells: tuple[int, int], facets: tuple[int, int]) -> tuple[Array, Array]:
        """Corners of a facet in the reference cells of its two cells, in the same order."""
        at, x = [], []
        for cell, facet in zip(cells, facets):
            at.append(self._corners[self._facets[facet]])
            x.append(self._coordinates(cell)[self._facets[facet]])
        apart = np.linalg.norm(x[0][:, None] - x[1], axis=2)
        return at[0], at[1][np.argmin(apart, axis=1)]


def _normal(edges: Array) -> tuple[Array, float]:
    """Unit normal of a flat facet, of either sign, and length or area spanned by its edges."""
    if edges.shape[1] == 1:
        return np.ones(1), 1.0
    across = np.array([edges[0, 1], -edges[0, 0]]) if len(edges) == 1 else np.cross(*edges)
    area = float(np.linalg.norm(across))
    return across / area, area
