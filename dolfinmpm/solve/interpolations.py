"""Interpolations between levels of nodes, for geometric multigrid.

A level is a set of nodes with lattice integers, and with their parents on the next coarser level.
On a lattice, a table per direction tells the parents of an integer, with weights. The weight of a
parent node is the product of the weights of its integers. A level needs no cells. So nodes may come
from a lattice or from leaves of several sizes.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numba
import numpy as np
import numpy.typing as npt
from mpi4py import MPI
from petsc4py import PETSc

from dolfinmpm.basis.knotinsertion import Parents

__all__ = [
    "Family",
    "LatticeLevel",
    "interpolations",
    "lattice_family",
    "next_level",
]

Array = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int32]


@dataclass(frozen=True)
class Family:
    """Parents of the nodes of a level on the next coarser level.

    Attributes:
        start: First entry of each node, shape (nodes + 1,).
        keys: Numbers of the parents in the coarse lattice, with the last direction fastest.
        weights: Their weights (-).
        shape: Number of integers of the coarse lattice per direction.
    """

    start: Ints
    keys: npt.NDArray[np.int64]
    weights: Array
    shape: tuple[int, ...]


@dataclass(frozen=True)
class LatticeLevel:
    """Nodes of a level whose rows this rank owns, in the order of the rows.

    Attributes:
        nodes: Lattice integers of the nodes, shape (n, gdim).
        free: Mask of the components that are unknowns, shape (n, components).
        every: Whether all components have rows, or only unknowns.
        family: Parents of the nodes, None on the coarsest level.
    """

    nodes: Ints
    free: npt.NDArray[np.bool_]
    every: bool
    family: Family | None = None

    @property
    def rows(self) -> npt.NDArray[np.int32]:
        """Own row of each unknown or -1, shape (n, components)."""
        numbered = np.ones_like(self.free) if self.every else self.free
        row = np.cumsum(numbered.ravel(), dtype=np.int32).reshape(self.free.shape) - 1
        return np.where(self.free, row, np.int32(-1))

    @property
    def size(self) -> int:
        """Number of own rows."""
        return self.free.size if self.every else int(np.count_nonzero(self.free))


@numba.njit(cache=True, error_model="numpy")
def _parents_of(nodes, start, parent, weight, at, keys, weights, shape):
    """Keys and weights of the parents of all nodes; only counts them if `keys` is empty.

    `start`, `parent` and `weight` have one row per direction. A key is the number of a node in the
    coarse lattice of the shape, with the last direction fastest.
    """
    gdim, total = nodes.shape[1], 0
    for a in range(nodes.shape[0]):
        first = total
        for d in range(gdim):
            low, high = start[d, nodes[a, d]], start[d, nodes[a, d] + 1]
            count = high - low
            if d == 0:
                size = 1
            if keys.size:
                # the last direction is fastest: old entries spread, from the last one on
                for b in range(size - 1, -1, -1):
                    key = keys[first + b] if d else 0
                    value = weights[first + b] if d else 1.0
                    for k in range(count - 1, -1, -1):
                        put = first + b * count + k
                        keys[put] = key * shape[d] + parent[d, low + k]
                        weights[put] = value * weight[d, low + k]
            size *= count
        total += size
        at[a + 1] = total


def _table(parents: Sequence[Parents]):
    """The tables of all directions, one row per direction."""
    columns = []
    for name in ("start", "parent", "weight"):
        arrays = [getattr(p, name) for p in parents]
        joined = np.zeros((len(arrays), max(a.size for a in arrays)), arrays[0].dtype)
        for row, array in zip(joined, arrays):
            row[: array.size] = array
        columns.append(joined)
    return columns


def lattice_family(nodes: Ints, parents: Sequence[Parents]) -> Family:
    """Parents of nodes of a lattice.

    Args:
        nodes: Lattice integers of the nodes, shape (n, gdim).
        parents: Parents of the integers per direction.
    """
    table = _table(parents)
    shape = tuple(p.size for p in parents)
    start = np.zeros(len(nodes) + 1, np.int32)
    keys, weights = np.empty(0, np.int64), np.empty(0)
    for _ in range(2):  # first count, then fill
        keys, weights = np.empty(start[-1], np.int64), np.empty(start[-1])
        _parents_of(nodes, *table, start, keys, weights, np.array(shape, np.int64))
    return Family(start, keys, weights, shape)


@numba.njit(cache=True, error_model="numpy")
def _heaviest(at, place, weights, free, of_all, of_free):
    """Largest weight of all children of each parent, and of its children that are unknowns."""
    for a in range(at.size - 1):
        for k in range(at[a], at[a + 1]):
            b, w = place[k], weights[k]
            for c in range(free.shape[1]):
                of_all[b, c] = max(of_all[b, c], w)
                if free[a, c]:
                    of_free[b, c] = max(of_free[b, c], w)


def next_level(comm: MPI.Intracomm, level: LatticeLevel) -> LatticeLevel:
    """The next coarser level: all parents of a level's nodes. Collective.

    A component of a parent is an unknown if a child with the largest weight is an unknown there. So
    a parent at a prescribed node is prescribed too. The rank with the heaviest child owns a parent.

    Args:
        comm: Communicator.
        level: The level.
    """
    family = level.family
    assert family is not None
    own, place = np.unique(family.keys, return_inverse=True)
    of_all, of_free = (np.zeros((own.size, level.free.shape[1])) for _ in range(2))
    children = family.start, place.astype(np.int32), family.weights
    _heaviest(*children, level.free, of_all, of_free)
    mine = np.ones(own.size, bool)
    if comm.size > 1:
        # all ranks know the nodes of all ranks here: an eighth of the finer level in 3D
        pieces = comm.allgather((own, of_all, of_free))
        every, place = np.unique(np.concatenate([p[0] for p in pieces]), return_inverse=True)
        owner, most = np.zeros(every.size, np.int32), np.zeros(every.size)
        whole, free = (np.zeros((every.size, level.free.shape[1])) for _ in range(2))
        first = 0
        for rank, (own_keys, all_here, free_here) in enumerate(pieces):
            there = place[first : first + own_keys.size]
            first += own_keys.size
            heavier = all_here[:, 0] > most[there]
            owner[there[heavier]] = rank
            most[there[heavier]] = all_here[heavier, 0]
            whole[there] = np.maximum(whole[there], all_here)
            free[there] = np.maximum(free[there], free_here)
        mine = owner == comm.rank
        own, of_all, of_free = every, whole, free
    unknown = (of_free == of_all) & (of_all > 0.0)
    mine &= unknown.any(axis=1)
    nodes = np.column_stack(np.unravel_index(own[mine], family.shape))
    return LatticeLevel(nodes.astype(np.int32), unknown[mine], False)


@numba.njit(cache=True, error_model="numpy")
def _rows_of(at, place, weights, rows, columns, size, indptr, indices, values):
    """Rows of P; only counts them if `indices` is empty."""
    for a in range(at.size - 1):
        for c in range(rows.shape[1]):
            row = rows[a, c]
            if row < 0:
                continue
            put = indptr[row]
            for k in range(at[a], at[a + 1]):
                b = place[k]
                if b >= 0 and columns[b, c] >= 0:
                    if indices.size:
                        indices[put], values[put] = columns[b, c], weights[k]
                    put += 1
            if not indices.size:
                indptr[row + 1] = put - indptr[row]
    if not indices.size:
        for row in range(size):
            indptr[row + 1] += indptr[row]


def interpolations(comm: MPI.Intracomm, levels: Sequence[LatticeLevel]) -> list[PETSc.Mat]:
    """Matrices from the unknowns of each coarser level to those of the finer one. Collective.

    Rows of prescribed components are zero. Prescribed components of coarse nodes have no columns.

    Args:
        comm: Communicator.
        levels: Levels from the finest one to the coarsest one.

    Returns:
        One matrix per pair of neighbouring levels, the finest pair first.
    """
    return [_interpolation(comm, *pair) for pair in itertools.pairwise(levels)]


def _interpolation(comm: MPI.Intracomm, fine: LatticeLevel, coarse: LatticeLevel) -> PETSc.Mat:
    family = fine.family
    assert family is not None
    known = np.asarray(np.ravel_multi_index(tuple(coarse.nodes.T), family.shape), np.int64)
    columns, first = coarse.rows, int(comm.exscan(coarse.size) or 0)
    columns[columns >= 0] += first
    if comm.size > 1:
        pieces = comm.allgather((known, columns))
        known, columns = (np.concatenate([p[k] for p in pieces]) for k in range(2))
    order = np.argsort(known, kind="stable")
    place = np.searchsorted(known[order], family.keys)
    place[place == known.size] = 0
    place = order[place]
    place[known[place] != family.keys] = -1
    indptr = np.zeros(fine.size + 1, np.int32)
    indices, values = np.empty(0, np.int32), np.empty(0)
    for _ in range(2):  # first count, then fill
        indices, values = np.empty(indptr[-1], np.int32), np.empty(indptr[-1])
        _rows_of(
            family.start, place.astype(np.int32), family.weights, fine.rows, columns, fine.size,
            indptr, indices, values,
        )  # fmt: skip
    size = (fine.size, PETSc.DETERMINE), (coarse.size, PETSc.DETERMINE)
    return PETSc.Mat().createAIJ(size, csr=(indptr, indices, values), comm=comm)
