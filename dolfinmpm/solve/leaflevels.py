"""Levels of multigrid on leaves: siblings are joined, with hanging nodes on each level.

Functions that are continuous on the joined leaves are continuous on the leaves, too. So the spaces
are nested, as those of a lattice. The same holds for hierarchical splines: from the roots on, their
levels are those of the lattice.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable, Iterator

import numpy as np
import numpy.typing as npt

from dolfinmpm.basis.leafsplines import LeafSplines
from dolfinmpm.grid.lattice import Lattice
from dolfinmpm.grid.leafnodes import LeafNodes
from dolfinmpm.grid.leaves import Leaves
from dolfinmpm.solve.interpolations import Family

__all__ = ["FamilyOf", "joined", "leaf_families", "spline_families"]

Ints = npt.NDArray[np.int32]
FamilyOf = Callable[[Ints], Family]


def joined(leaves: Leaves) -> tuple[Leaves, Ints]:
    """Leaves whose siblings are joined where no sibling is split, and the new leaf of each leaf.

    Args:
        leaves: The leaves.
    """
    tree, size = leaves.tree, leaves.size
    whole = 1 << tree.levels
    extent = np.array(tree.lattice.shape) * whole
    stays = size == whole
    for t in 2 ** np.arange(1, tree.levels + 1):
        parent = np.ravel_multi_index(tuple((leaves.low // t).T), tuple(extent // t))
        mine = np.flatnonzero(2 * size == t)
        stays[mine] = np.isin(parent[mine], parent[2 * size < t])
    size = np.where(stays, size, 2 * size).astype(np.int32)
    low = leaves.low // size[:, None] * size[:, None]
    keys = np.ravel_multi_index(tuple(low.T), tuple(extent))
    _, first, into = np.unique(keys, return_index=True, return_inverse=True)
    made = Leaves.restored(tree.lattice, tree.levels, low[first], size[first])
    return made, into.astype(np.int32)


def _with_roots_of_many_cells(leaves: Leaves) -> Leaves:
    """The same leaves in a tree whose roots are as large as the grid, so that its cells join too.

    Roots may reach beyond the grid. Only numbers of lines count, and no coordinates.
    """
    tree = leaves.tree
    more = max(tree.lattice.shape).bit_length() - 1
    lines = tuple(np.arange(1.0 - (-n >> more), dtype=np.float64) for n in tree.lattice.shape)
    lattice = Lattice(lines, np.empty((0, len(lines)), np.int32), True)
    return Leaves.restored(lattice, tree.levels + more, leaves.low, leaves.size)


def leaf_families(leaves: Leaves) -> Iterator[FamilyOf]:
    """Functions from the nodes of each level of leaves to their parents.

    Args:
        leaves: The leaves of the finest level.
    """
    leaves = _with_roots_of_many_cells(leaves)
    nodes, whole = LeafNodes.of(leaves), 1 << leaves.tree.levels
    while leaves.size.min(initial=whole) < whole:
        coarse, into = joined(leaves)
        of_coarse = LeafNodes.of(coarse)
        yield functools.partial(_family, nodes, coarse, of_coarse, into)
        leaves, nodes = coarse, of_coarse


def _family(
    fine: LeafNodes, coarse: Leaves, of_coarse: LeafNodes, into: Ints, nodes: Ints
) -> Family:
    """Parents of some nodes of leaves, which are independent nodes of coarser leaves."""
    tree = coarse.tree
    shape = tuple((n << tree.levels) + 1 for n in tree.lattice.shape)

    def numbers(lines: Ints) -> npt.NDArray[np.int64]:
        return np.asarray(np.ravel_multi_index(tuple(lines.T), shape), np.int64)

    leaf = into[fine.first[np.searchsorted(numbers(fine.fine), numbers(nodes))]]
    values = (of_coarse.at(coarse, nodes, leaf) @ of_coarse.matrix).tocsr()
    keys = numbers(of_coarse.fine)[values.indices]
    return Family(values.indptr.astype(np.int32), keys, values.data, shape)


def spline_families(leaves: Leaves, degree: int, lattice: Iterable[FamilyOf]) -> Iterator[FamilyOf]:
    """Functions from the splines of each level of leaves to their parents.

    The integers of a spline on leaves are its level and its position, shape (n, 1 + gdim).

    Args:
        leaves: The leaves of the finest level.
        degree: Degree of the splines.
        lattice: Functions from the splines of the roots, and so on.
    """
    whole = 1 << leaves.tree.levels
    while leaves.size.min(initial=whole) < whole:
        leaves, _ = joined(leaves)
        yield functools.partial(_spline_family, leaves, LeafSplines.of(leaves, degree), degree)
    for k, family_of in enumerate(lattice):
        yield family_of if k else functools.partial(_of_roots, family_of)


def _of_roots(family_of: FamilyOf, nodes: Ints) -> Family:
    """Parents of splines of the roots, which are splines of a lattice."""
    return family_of(np.ascontiguousarray(nodes[:, 1:]))


def _spline_family(coarse: Leaves, of_coarse: LeafSplines, degree: int, nodes: Ints) -> Family:
    """Parents of some splines of leaves, which are independent splines of coarser leaves."""
    tree = coarse.tree
    values = of_coarse.at(coarse, nodes[:, 0], nodes[:, 1:])
    shape = tree.levels + 1, *((n << tree.levels) + degree for n in tree.lattice.shape)
    every = np.column_stack([of_coarse.level, of_coarse.index]).astype(np.int64)
    keys = np.asarray(np.ravel_multi_index(tuple(every.T), shape), np.int64)[values.indices]
    return Family(values.indptr.astype(np.int32), keys, values.data, shape)
