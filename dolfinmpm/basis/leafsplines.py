"""Splines on leaves: truncated hierarchical B-splines.

Every leaf has the B-splines of the lattice of its own level. A spline is independent unless its
support overlaps a larger leaf. Otherwise it *hangs*: its coefficient is that of the functions of
the next coarser level after knot insertion, whose coefficients may hang in turn. These are the
truncated hierarchical B-splines of Giannelli, Jüttler & Speleers (2012, doi
10.1016/j.cagd.2012.03.025). They sum to 1, contain the polynomials of their degree, and are as
smooth across leaves of two sizes as within a leaf.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numba
import numpy as np
import numpy.typing as npt

from dolfinmpm.basis.knotinsertion import Parents, knot_insertion
from dolfinmpm.basis.leafsplinestencils import leaf_integrals
from dolfinmpm.grid.leafsearch import node_at
from dolfinmpm.grid.leaves import Leaves, Tree

if TYPE_CHECKING:
    from scipy import sparse

__all__ = ["LeafSplines", "knots_around"]

Array = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int32]


@numba.njit(cache=True, error_model="numpy")
def _overlap_larger(level, index, degree, search, number, hangs):
    """Mark the splines whose support overlaps a leaf of a coarser level."""
    levels, shape, low, size, child = search
    d = index.shape[1]
    k = np.empty(d, np.int64)
    for a in range(level.size):
        width = 1 << (levels - level[a])
        hangs[a] = False
        for c in range((degree + 1) ** d):
            rest, inside = c, True
            for j in range(d - 1, -1, -1):
                cell = index[a, j] - rest % (degree + 1)
                rest //= degree + 1
                inside = inside and 0 <= cell < shape[j] << level[a]
                k[j] = cell * width
            if not inside:
                continue
            node = node_at(k, levels, shape, low, size, child)
            hangs[a] = hangs[a] or (number[node] >= 0 and size[node] > width)


def knots_around(tree: Tree, degree: int, low: Ints, size: Ints) -> Array:
    """Knots around leaves, shape (leaves, gdim, 2 degree); a leaf is between the middle two.

    Args:
        tree: The tree.
        degree: Degree of the splines.
        low: Numbers of the lowest lines of the leaves on the finest level, shape (leaves, gdim).
        size: Number of the finest cells per direction, shape (leaves,).
    """
    last = np.array(tree.lattice.shape, np.int64) << tree.levels
    fine = low[..., None] + size[:, None, None] * np.arange(1 - degree, degree + 1)
    fine = np.clip(fine, 0, last[:, None])
    columns = [tree.coordinates(fine[..., k].astype(np.int32)) for k in range(2 * degree)]
    return np.ascontiguousarray(np.stack(columns, axis=2))


@dataclass(frozen=True, eq=False)
class LeafSplines:
    """Splines of all leaves, the same on all ranks, in the order of their places.

    Attributes:
        level: Number of times that the roots are halved in the lattice of each spline, shape (n,).
        index: Position in this lattice, shape (n, gdim).
        corners: Splines of each leaf, the last direction fastest, shape (leaves, (degree+1)^gdim).
        first: Lowest leaf of each spline, shape (n,).
        hanging: Mask of the splines that hang, shape (n,).
        matrix: Coefficients of all splines from those of independent splines, shape (n, n).
    """

    level: Ints
    index: Ints
    corners: Ints
    first: Ints
    hanging: npt.NDArray[np.bool_]
    matrix: sparse.csr_matrix

    @classmethod
    def of(cls, leaves: Leaves, degree: int) -> LeafSplines:
        """The splines of some leaves."""
        tree, size = leaves.tree, leaves.size
        gdim = leaves.low.shape[1]
        of_leaf = (tree.levels - np.log2(np.maximum(size, 1)).round()).astype(np.int32)
        offsets = np.array(list(np.ndindex(*(degree + 1,) * gdim)), np.int32)
        index = (leaves.low // size[:, None])[:, None] + offsets
        level = np.repeat(of_leaf, len(offsets))
        every = np.column_stack([level, index.reshape(-1, gdim)]).astype(np.int64)
        most = (tree.levels + 1, *_numbers(tree, degree, tree.levels))
        keys = np.ravel_multi_index(tuple(every.T), most) if len(every) else every[:, 0]
        _, at, corner = np.unique(keys, return_index=True, return_inverse=True)
        # the matrix has a narrow band if neighbours stand together
        chosen = every[at]
        place = (2 * chosen[:, 1:] + 1 - degree) << (tree.levels - chosen[:, :1])
        order = np.lexsort([chosen[:, 0], *place.T[::-1]])
        number = np.empty(order.size, np.int32)
        number[order] = np.arange(order.size, dtype=np.int32)
        of, at_lines = chosen[order, 0].astype(np.int32), chosen[order, 1:].astype(np.int32)
        corners = number[corner.ravel()].reshape(-1, len(offsets))
        first = (at[order] // len(offsets)).astype(np.int32)
        hanging, matrix = _coefficients(leaves, degree, (of, at_lines), of, at_lines)
        return cls(of, at_lines, corners, first, hanging, matrix)

    def at(self, leaves: Leaves, level: Ints, index: Ints) -> sparse.csr_matrix:
        """Coefficients of splines of any level from those of these splines, shape (n, splines).

        Args:
            leaves: The leaves of these splines.
            level, index: Levels and positions of the splines asked for, which must be finer than
                the leaves or splines of them.
        """
        own = self.level, self.index
        return _coefficients(leaves, self._degree, own, level, index)[1]

    @property
    def _degree(self) -> int:
        return round(self.corners.shape[1] ** (1 / self.index.shape[1])) - 1

    def inner_knots(self, tree: Tree) -> Array:
        """Inner knots of the splines (m), shape (n, gdim, degree)."""
        degree, width = self._degree, 1 << (tree.levels - self.level)
        low = np.asarray(self.index * width[:, None], np.int32)
        return knots_around(tree, degree, low, width)[..., :degree]

    def integrals_outside(self, leaves: Leaves) -> Array:
        """Integral of each spline over what no leaf covers of its support (m^d), shape (n,).

        A cell of the spline's level counts by its volume that no leaf covers. Hanging splines have
        the integral 0.
        """
        tree, gdim, degree = leaves.tree, self.index.shape[1], self._degree
        found: Array = np.zeros(self.level.size)
        low, high = tree.corners(leaves.node)
        volume = np.prod(high - low, axis=1)
        for level in np.unique(self.level):
            width, rows = 1 << (tree.levels - level), np.flatnonzero(self.level == level)
            rows = rows[~self.hanging[rows]]
            extent = tuple(n << int(level) for n in tree.lattice.shape)
            small = leaves.size <= width
            inside = _keys(leaves.low[small] // width, extent)
            keys, of = np.unique(inside, return_inverse=True)
            covered = np.append(np.bincount(of.ravel(), volume[small], minlength=keys.size), 0.0)
            for offset in np.ndindex(*(degree + 1,) * gdim):
                cells = self.index[rows] - np.array(offset, np.int32)
                own = np.all((cells >= 0) & (cells < extent), axis=1)
                cells, of_rows = cells[own], rows[own]
                fine, size = (cells * width).astype(np.int32), np.full(len(cells), width)
                along = np.empty((len(cells), gdim, degree + 1))
                leaf_integrals(knots_around(tree, degree, fine, size), along)
                whole = np.prod(tree.coordinates(fine + width) - tree.coordinates(fine), axis=1)
                number = _keys(cells, extent)
                at = np.searchsorted(keys, number)
                at[(at == keys.size) | (np.append(keys, -1)[at] != number)] = keys.size
                found[of_rows] += (1 - covered[at] / whole) * np.prod(
                    along[:, np.arange(gdim), offset], axis=1
                )
        return found


def _numbers(tree: Tree, degree: int, level: int) -> tuple[int, ...]:
    """Number of splines of a level per direction."""
    return tuple((cells << level) + degree for cells in tree.lattice.shape)


def _parents(table: list[Parents], index: Ints) -> tuple[npt.NDArray[np.intp], Ints, Array]:
    """Row, position and weight of the parents of splines on the next coarser level."""
    rows = np.asarray(np.arange(len(index)), np.intp)
    parents: Ints = np.empty((len(index), 0), np.int32)
    weights: Array = np.ones(len(index))
    for d, one in enumerate(table):
        count = np.diff(one.start)[index[rows, d]]
        begin = one.start[index[rows, d]]
        each = np.repeat(np.arange(rows.size), count)
        entry = begin[each] + np.arange(each.size) - np.repeat(np.cumsum(count) - count, count)
        parents = np.column_stack([parents[each], one.parent[entry]])
        weights, rows = weights[each] * one.weight[entry], rows[each]
    return rows, parents, weights


def _coefficients(
    leaves: Leaves, degree: int, own: tuple[Ints, Ints], level: Ints, index: Ints
) -> tuple[npt.NDArray[np.bool_], sparse.csr_matrix]:
    """Coefficients of splines of any level and position.

    Args:
        leaves: The leaves.
        degree: Degree of the splines.
        own: Levels and positions of all splines of the leaves.
        level, index: Those of the splines asked for.
    """
    from scipy import sparse

    tree, n = leaves.tree, own[0].size
    asked = [np.flatnonzero(level == k) for k in range(tree.levels + 1)]
    wanted, masks, tables = _ancestors(leaves, degree, [index[rows] for rows in asked])
    hanging: npt.NDArray[np.bool_] = np.zeros(level.size, bool)
    before: npt.NDArray[np.int64] = np.empty(0, np.int64)
    coarser = sparse.csr_matrix((0, n))
    pieces = []
    for k in range(tree.levels + 1):
        extent = _numbers(tree, degree, k)
        keys: npt.NDArray[np.int64] = _keys(wanted[k], extent)
        free, hangs = np.flatnonzero(~masks[k]), np.flatnonzero(masks[k])
        at = np.flatnonzero(own[0] == k)
        known = _keys(own[1][at], extent)
        order = np.argsort(known)
        # an independent spline is one of the leaves
        column = at[order[np.searchsorted(known[order], keys[free])]]
        data = np.ones(free.size), (free, column)
        rows = sparse.csr_matrix(data, shape=(keys.size, n))
        if hangs.size:
            row, parents, weights = _parents(tables[k - 1], wanted[k][hangs])
            column = np.searchsorted(before, _keys(parents, _numbers(tree, degree, k - 1)))
            shape = keys.size, before.size
            rows = rows + sparse.csr_matrix((weights, (hangs[row], column)), shape) @ coarser
        mine = np.searchsorted(keys, _keys(index[asked[k]], extent))
        hanging[asked[k]] = masks[k][mine]
        pieces.append(rows[mine])
        coarser, before = rows.tocsr(), keys
    matrix = sparse.vstack(pieces).tocsr()[np.argsort(np.concatenate(asked), kind="stable")]
    matrix.sort_indices()
    return hanging, matrix


def _ancestors(
    leaves: Leaves, degree: int, wanted: list[Ints]
) -> tuple[list[Ints], list[npt.NDArray[np.bool_]], list[list[Parents]]]:
    """Splines of each level with all that they follow, masks of those that hang, and parents.

    Args:
        leaves: The leaves.
        degree: Degree of the splines.
        wanted: Positions of splines of each level.
    """
    tree = leaves.tree
    _, _, levels, *search = tree.search
    lines: list[Array] = [
        tree.coordinates(_along(tree, d))[:, d] for d in range(leaves.low.shape[1])
    ]
    masks: list[npt.NDArray[np.bool_]] = []
    tables: list[list[Parents]] = []
    for k in range(levels, -1, -1):
        wanted[k] = np.unique(wanted[k], axis=0)
        hangs = np.zeros(len(wanted[k]), bool)
        at = np.full(hangs.size, k, np.int64)
        _overlap_larger(at, wanted[k], degree, (levels, *search), leaves.number, hangs)
        masks.insert(0, hangs)
        if k:
            made = [knot_insertion(line, degree) for line in lines]
            lines = [np.asarray(line) for line, _ in made]
            tables.insert(0, [table for _, table in made])
            parents = _parents(tables[0], wanted[k][hangs])[1]
            wanted[k - 1] = np.vstack([wanted[k - 1], parents]).astype(np.int32)
    return wanted, masks, tables


def _keys(index: Ints, extent: tuple[int, ...]) -> npt.NDArray[np.int64]:
    """Numbers of positions in a lattice, the last direction fastest."""
    return np.asarray(np.ravel_multi_index(tuple(index.T), extent), np.int64)


def _along(tree: Tree, d: int) -> Ints:
    """Numbers of all lines of the finest level in one direction, zero in the others."""
    fine = np.zeros(((tree.lattice.shape[d] << tree.levels) + 1, len(tree.lattice.shape)), np.int32)
    fine[:, d] = np.arange(len(fine))
    return fine
