"""Sums over the points' stencils, straight into the vector and the matrix of the unknowns."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numba
import numpy as np
import numpy.typing as npt
from petsc4py import PETSc

from dolfinmpm._platform.compat import preallocate_coo, set_values_coo
from dolfinmpm.basis import Stencils
from dolfinmpm.cut.unknowns import Unknowns

__all__ = ["Matrix", "Pattern", "add_blocks", "add_stiffness", "add_vector", "multiply_blocks"]

Array = npt.NDArray[np.float64]


@numba.njit(cache=True, error_model="numpy")
def _add_vector(begin, end, groups, node_start, nodes, value_start, N, dN, flux, out):
    components, gdim = out.shape[1], dN.shape[1]
    for g in range(begin, end):
        first = node_start[g]
        m = node_start[g + 1] - first
        for position in range(groups[g], groups[g + 1]):
            p = position - groups[begin]
            at = value_start[g] + (position - groups[g]) * m
            for a in range(m):
                for i in range(components):
                    f = N[at + a] * flux[p, i * (1 + gdim)]
                    for j in range(gdim):
                        f += dN[at + a, j] * flux[p, i * (1 + gdim) + 1 + j]
                    out[nodes[first + a], i] += f


def add_vector(s: Stencils, begin: int, end: int, flux: Array, out: Array) -> None:
    """Add Σ_p (N_a f_p + ∇N_a · q_p) over the points of some groups to nodal forces.

    Args:
        s: Stencils.
        begin: The first of the groups.
        end: The group behind the last.
        flux: f and q of every component one after the other, times the point's
            volume, in the order of the stencils, shape
            (points of the groups, components * (1 + gdim)).
        out: Nodal forces (N), shape (nodes, components).
    """
    _add_vector(begin, end, s.groups, s.node_start, s.nodes, s.value_start, s.N, s.dN, flux, out)


@functools.cache
def _stiffness_kernel(nc: int, ns: int, gradient_only: bool):
    """The loop for nc components and ns slots (gradients, or values and gradients) each."""
    offset = 0 if gradient_only else 1

    @numba.njit(cache=True, fastmath={"contract", "reassoc"})
    def kernel(
        begin, end, groups, node_start, nodes, value_start, N, dN, T, row_of, indptr, indices,
        data, prescribed, lift,
    ):  # fmt: skip
        largest = 0
        for g in range(begin, end):
            largest = max(largest, node_start[g + 1] - node_start[g])
        phi = np.empty((ns, largest))
        K = np.empty((largest, nc, nc, largest))
        t = np.empty((nc, nc, ns))
        for g in range(begin, end):
            first = node_start[g]
            m = node_start[g + 1] - first
            for a in range(m):
                for i in range(nc):
                    for k in range(nc):
                        for b in range(m):
                            K[a, i, k, b] = 0.0
            for position in range(groups[g], groups[g + 1]):
                p = position - groups[begin]
                at = value_start[g] + (position - groups[g]) * m
                for b in range(m):
                    if offset:
                        phi[0, b] = N[at + b]
                    for s in range(ns - offset):
                        phi[offset + s, b] = dN[at + b, s]
                for a in range(m):
                    for i in range(nc):
                        for k in range(nc):
                            for r in range(ns):
                                value = 0.0
                                for s in range(ns):
                                    value += phi[s, a] * T[p, (i * ns + s) * nc * ns + k * ns + r]
                                t[i, k, r] = value
                    for i in range(nc):
                        for k in range(nc):
                            for r in range(ns):
                                weight = t[i, k, r]
                                for b in range(m):
                                    K[a, i, k, b] += weight * phi[r, b]
            # nodes and columns both increase: one walk along each row of the matrix
            for a in range(m):
                for i in range(nc):
                    row = row_of[nodes[first + a], i]
                    if row < 0:
                        continue
                    at = indptr[row]
                    for b in range(m):
                        node = nodes[first + b]
                        for k in range(nc):
                            column = row_of[node, k]
                            if column >= 0:
                                while indices[at] != column:
                                    at += 1
                                data[at] += K[a, i, k, b]
                                at += 1
                            else:
                                lift[nodes[first + a], i] += K[a, i, k, b] * prescribed[node, k]

    return kernel


def add_stiffness(
    s: Stencils, begin: int, end: int, tangent: Array, gradient_only: bool, unknowns: Unknowns,
    pattern: Pattern, data: Array, lift: Array,
) -> None:  # fmt: skip
    """Add Σ_p φ_a · T_p · φ_b over the points of some groups to the matrix.

    Args:
        s: Stencils.
        begin: The first of the groups.
        end: The group behind the last.
        tangent: T times the point's volume, in the order of the stencils; see
            `PointTerms.tangent`.
        gradient_only: Whether φ is ∇N, or N and ∇N.
        unknowns: Rows of the nodes.
        pattern: Where the matrix has entries.
        data: The matrix's entries.
        lift: Its columns of prescribed unknowns, times their values; shape (nodes, components).
    """
    nc = unknowns.components
    ns = s.dN.shape[1] + (0 if gradient_only else 1)
    _stiffness_kernel(nc, ns, gradient_only)(
        begin, end, s.groups, s.node_start, s.nodes, s.value_start, s.N, s.dN, tangent,
        unknowns.row_of, pattern.indptr, pattern.indices, data, unknowns.prescribed, lift,
    )  # fmt: skip


@numba.njit(cache=True, error_model="numpy")
def _add_blocks(rows, columns, blocks, row_of, indptr, indices, data, prescribed, lift):
    for e in range(rows.size):
        for i in range(blocks.shape[1]):
            row = row_of[rows[e], i]
            if row < 0:
                continue
            for k in range(blocks.shape[2]):
                column = row_of[columns[e], k]
                if column >= 0:
                    low, high = indptr[row], indptr[row + 1]
                    while low < high:
                        middle = (low + high) // 2
                        if indices[middle] < column:
                            low = middle + 1
                        else:
                            high = middle
                    data[low] += blocks[e, i, k]
                else:
                    lift[rows[e], i] += blocks[e, i, k] * prescribed[columns[e], k]


def add_blocks(rows, columns, blocks, unknowns: Unknowns, pattern: Pattern, data, lift) -> None:
    """Add blocks (n, components, components) between nodes to the matrix."""
    _add_blocks(
        rows, columns, blocks, unknowns.row_of, pattern.indptr, pattern.indices, data,
        unknowns.prescribed, lift,
    )  # fmt: skip


@numba.njit(cache=True, error_model="numpy")
def multiply_blocks(rows, columns, blocks, u, out):
    """Add A u to nodal forces, A given by blocks; u and out have shape (nodes, components)."""
    for e in range(rows.size):
        for i in range(blocks.shape[1]):
            f = 0.0
            for k in range(blocks.shape[2]):
                f += blocks[e, i, k] * u[columns[e], k]
            out[rows[e], i] += f


@numba.njit(cache=True, error_model="numpy")
def _couple(active, compact, node_start, nodes, extra_rows, extra_columns, start, neighbours):
    """Neighbours of every active node, in increasing order; only counts if the array is empty."""
    n = active.size
    # groups of every node
    group_start = np.zeros(n + 1, np.int64)
    for at in range(nodes.size):
        group_start[compact[nodes[at]] + 1] += 1
    extra_start = np.zeros(n + 1, np.int64)
    for e in range(extra_rows.size):
        extra_start[compact[extra_rows[e]] + 1] += 1
    for a in range(n):
        group_start[a + 1] += group_start[a]
        extra_start[a + 1] += extra_start[a]
    fill = group_start[:-1].copy()
    group_of = np.empty(nodes.size, np.int32)
    for g in range(node_start.size - 1):
        for at in range(node_start[g], node_start[g + 1]):
            a = compact[nodes[at]]
            group_of[fill[a]] = g
            fill[a] += 1
    fill = extra_start[:-1].copy()
    extra_of = np.empty(extra_rows.size, np.int32)
    for e in range(extra_rows.size):
        a = compact[extra_rows[e]]
        extra_of[fill[a]] = compact[extra_columns[e]]
        fill[a] += 1
    seen = np.full(n, -1, np.int32)
    total = 0
    for a in range(n):
        begin = total
        for at in range(group_start[a], group_start[a + 1]):
            g = group_of[at]
            for k in range(node_start[g], node_start[g + 1]):
                b = compact[nodes[k]]
                if seen[b] != a:
                    seen[b] = a
                    if neighbours.size:
                        neighbours[total] = b
                    total += 1
        for at in range(extra_start[a], extra_start[a + 1]):
            b = extra_of[at]
            if seen[b] != a:
                seen[b] = a
                if neighbours.size:
                    neighbours[total] = b
                total += 1
        if neighbours.size:
            neighbours[begin:total].sort()
        start[a + 1] = total


@numba.njit(cache=True, error_model="numpy")
def _covers(start, neighbours, new_start, new_neighbours):
    """Whether every coupling of the second graph is one of the first."""
    for a in range(start.size - 1):
        at, end = start[a], start[a + 1]
        for k in range(new_start[a], new_start[a + 1]):
            while at < end and neighbours[at] < new_neighbours[k]:
                at += 1
            if at == end or neighbours[at] != new_neighbours[k]:
                return False
    return True


@numba.njit(cache=True, error_model="numpy")
def _expand(start, neighbours, rows, indptr, indices):
    """Unknowns of a graph of nodes; rows (active nodes, components) is -1 where there is none."""
    nc = rows.shape[1]
    for a in range(start.size - 1):
        count = 0
        for at in range(start[a], start[a + 1]):
            for k in range(nc):
                if rows[neighbours[at], k] >= 0:
                    count += 1
        for i in range(nc):
            if rows[a, i] >= 0:
                indptr[rows[a, i] + 1] = count
    for row in range(indptr.size - 1):
        indptr[row + 1] += indptr[row]
    if indices.size == 0:
        return
    for a in range(start.size - 1):
        for i in range(nc):
            if rows[a, i] >= 0:
                put = indptr[rows[a, i]]
                for at in range(start[a], start[a + 1]):
                    for k in range(nc):
                        if rows[neighbours[at], k] >= 0:
                            indices[put] = rows[neighbours[at], k]
                            put += 1


@dataclass(frozen=True)
class Pattern:
    """Where the matrix has entries, on this rank, rows of ghosts included.

    Attributes:
        start, neighbours: Graph of the active nodes.
        indptr, indices: Rows and columns of the local unknowns.
    """

    start: npt.NDArray[np.int64]
    neighbours: npt.NDArray[np.int32]
    indptr: npt.NDArray[np.int32]
    indices: npt.NDArray[np.int32]

    @staticmethod
    def build(
        s: Stencils, unknowns: Unknowns, extra_rows, extra_columns, old: Pattern | None
    ) -> Pattern:
        """Pattern of the couplings in the stencils and of the extra ones.

        Args:
            s: Stencils.
            unknowns: The unknowns.
            extra_rows, extra_columns: Coupled nodes, shape (n,) each.
            old: Pattern of the same unknowns, or None. It is returned, to be kept
                with all that was computed for it, if it has all the couplings;
                otherwise the new one has its couplings too, so that points that
                wander about in the same cells soon stop to change it.
        """
        n = unknowns.nodes.size
        unknowns.compact[unknowns.nodes] = np.arange(n, dtype=np.int32)
        start = np.zeros(n + 1, np.int64)
        graph = (
            unknowns.nodes, unknowns.compact, s.node_start, s.nodes, extra_rows, extra_columns,
            start,
        )  # fmt: skip
        _couple(*graph, np.empty(0, np.int32))
        neighbours = np.empty(start[-1], np.int32)
        _couple(*graph, neighbours)
        if old is not None and _covers(old.start, old.neighbours, start, neighbours):
            return old
        if old is not None:
            kept_rows = np.repeat(unknowns.nodes, np.diff(old.start))
            extra_rows = np.concatenate([extra_rows, kept_rows])
            extra_columns = np.concatenate([extra_columns, unknowns.nodes[old.neighbours]])
            return Pattern.build(s, unknowns, extra_rows, extra_columns, None)
        rows = unknowns.row_of[unknowns.nodes]
        indptr = np.zeros(unknowns.local + 1, np.int32)
        _expand(start, neighbours, rows, indptr, np.empty(0, np.int32))
        indices = np.empty(indptr[-1], np.int32)
        indptr[:] = 0
        _expand(start, neighbours, rows, indptr, indices)
        return Pattern(start, neighbours, indptr, indices)


class Matrix:
    """A PETSc matrix and the local entries that are summed into it.

    In serial PETSc works in these very entries; in parallel they are handed over
    and the rows of ghosts are added up at their owners.
    """

    def __init__(self, pattern: Pattern, unknowns: Unknowns):
        self.pattern = pattern
        self.data = np.zeros(pattern.indices.size)
        comm = unknowns.comm
        size = (unknowns.owned, unknowns.total)
        if comm.size == 1:
            self.petsc = PETSc.Mat().createAIJWithArrays(
                (size, size), (pattern.indptr, pattern.indices, self.data), comm=comm
            )
        else:
            self.petsc = PETSc.Mat().create(comm)
            self.petsc.setSizes((size, size))
            self.petsc.setType("aij")
            rows = np.repeat(unknowns.to_global, np.diff(pattern.indptr))
            preallocate_coo(self.petsc, rows, unknowns.to_global[pattern.indices])
        self._serial = comm.size == 1

    def finish(self) -> None:
        """Tell PETSc that the entries changed. Collective."""
        if self._serial:
            self.petsc.assemble()
            self.petsc.stateIncrease()
        else:
            set_values_coo(self.petsc, self.data)
