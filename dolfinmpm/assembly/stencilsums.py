"""Sums over the points' stencils, directly into nodal forces and into the matrix."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import numba
import numpy as np
import numpy.typing as npt
from petsc4py import PETSc

from dolfinmpm.assembly.ownedrows import OwnedRows
from dolfinmpm.assembly.stiffness import stiffness_kernel
from dolfinmpm.basis import Stencils
from dolfinmpm.cut.pattern import Blocks, Pattern
from dolfinmpm.cut.unknowns import FieldUnknowns, Unknowns

__all__ = [
    "Entries",
    "Matrix",
    "Slope",
    "add_blocks",
    "add_product",
    "add_stiffness",
    "add_vector",
]

Array = npt.NDArray[np.float64]


@numba.njit(cache=True, error_model="numpy")
def _add_vector(begin, end, groups, node_start, nodes, value_start, N, dN, flux, column, out):
    components, gdim = out.shape[1], dN.shape[1]
    for g in range(begin, end):
        first = node_start[g]
        m = node_start[g + 1] - first
        for position in range(groups[g], groups[g + 1]):
            p = position - groups[begin]
            at = value_start[g] + (position - groups[g]) * m
            for a in range(m):
                for i in range(components):
                    k = column + i * (1 + gdim)
                    f = N[at + a] * flux[p, k]
                    for j in range(gdim):
                        f += dN[at + a, j] * flux[p, k + 1 + j]
                    out[nodes[first + a], i] += f


@numba.njit(cache=True, error_model="numpy")
def _add_vector_2(begin, end, groups, node_start, nodes, value_start, N, dN, flux, column, out):
    """`_add_vector` of a vector in 2D, with the flux in registers."""
    for g in range(begin, end):
        first = node_start[g]
        m = node_start[g + 1] - first
        for position in range(groups[g], groups[g + 1]):
            p = position - groups[begin]
            at = value_start[g] + (position - groups[g]) * m
            f0, q00, q01 = flux[p, column], flux[p, column + 1], flux[p, column + 2]
            f1, q10, q11 = flux[p, column + 3], flux[p, column + 4], flux[p, column + 5]
            for a in range(m):
                w, w0, w1 = N[at + a], dN[at + a, 0], dN[at + a, 1]
                node = nodes[first + a]
                out[node, 0] += w * f0 + w0 * q00 + w1 * q01
                out[node, 1] += w * f1 + w0 * q10 + w1 * q11


@numba.njit(cache=True, error_model="numpy")
def _add_vector_3(begin, end, groups, node_start, nodes, value_start, N, dN, flux, column, out):
    """`_add_vector` of a vector in 3D, with the flux in registers."""
    for g in range(begin, end):
        first = node_start[g]
        m = node_start[g + 1] - first
        for position in range(groups[g], groups[g + 1]):
            p, c = position - groups[begin], column
            at = value_start[g] + (position - groups[g]) * m
            f0, q00, q01, q02 = flux[p, c], flux[p, c + 1], flux[p, c + 2], flux[p, c + 3]
            f1, q10, q11, q12 = flux[p, c + 4], flux[p, c + 5], flux[p, c + 6], flux[p, c + 7]
            f2, q20, q21, q22 = flux[p, c + 8], flux[p, c + 9], flux[p, c + 10], flux[p, c + 11]
            for a in range(m):
                w, w0, w1, w2 = N[at + a], dN[at + a, 0], dN[at + a, 1], dN[at + a, 2]
                node = nodes[first + a]
                out[node, 0] += w * f0 + w0 * q00 + w1 * q01 + w2 * q02
                out[node, 1] += w * f1 + w0 * q10 + w1 * q11 + w2 * q12
                out[node, 2] += w * f2 + w0 * q20 + w1 * q21 + w2 * q22


def add_vector(s: Stencils, begin: int, end: int, flux: Array, column: int, out: Array) -> None:
    """Add Σ_p (N_a f_p + ∇N_a · q_p) over the points of some groups to nodal forces.

    Args:
        s: Stencils.
        begin, end: First group, and the group behind the last one.
        flux: f and q times the point's volume, component by component, in the order of the
            stencils, shape (points of the groups, at least column + components * (1 + gdim)).
        column: First column of the field in the flux.
        out: Nodal forces (N), shape (nodes, components).
    """
    vector = out.shape[1] if out.shape[1] == s.dN.shape[1] else 0
    kernel = {2: _add_vector_2, 3: _add_vector_3}.get(vector, _add_vector)
    kernel(begin, end, s.groups, s.node_start, s.nodes, s.value_start, s.N, s.dN, flux, column, out)


@functools.cache
def _coupling_kernel(rows_nc: int, rows_ns: int, rows_value: bool, nc: int, ns: int, value: bool):
    """The loop between two fields with their components and slots; see `stiffness_kernel`."""
    rows_offset, offset = int(rows_value), int(value)

    @numba.njit(cache=True, fastmath={"contract", "reassoc"})
    def kernel(
        begin, end, groups, a_start, a_nodes, a_value, a_N, a_dN, b_start, b_nodes, b_value, b_N,
        b_dN, T, row_of, column_of, indptr, indices, data, prescribed, lift,
    ):  # fmt: skip
        largest = 0
        for g in range(begin, end):
            largest = max(largest, b_start[g + 1] - b_start[g])
        t = np.empty((rows_nc, nc, ns))
        K = np.empty((rows_nc, nc, largest))
        for g in range(begin, end):
            m, n = a_start[g + 1] - a_start[g], b_start[g + 1] - b_start[g]
            for a in range(m):
                K[:] = 0.0
                for position in range(groups[g], groups[g + 1]):
                    p = position - groups[begin]
                    at_a = a_value[g] + (position - groups[g]) * m + a
                    at_b = b_value[g] + (position - groups[g]) * n
                    for i in range(rows_nc):
                        for k in range(nc):
                            for r in range(ns):
                                total = 0.0
                                for s in range(rows_ns):
                                    phi = a_N[at_a]
                                    if s >= rows_offset:
                                        phi = a_dN[at_a, s - rows_offset]
                                    total += phi * T[p, (i * rows_ns + s) * nc * ns + k * ns + r]
                                t[i, k, r] = total
                    for i in range(rows_nc):
                        for k in range(nc):
                            for r in range(ns):
                                weight = t[i, k, r]
                                for b in range(n):
                                    psi = b_N[at_b + b]
                                    if r >= offset:
                                        psi = b_dN[at_b + b, r - offset]
                                    K[i, k, b] += weight * psi
                node_a = a_nodes[a_start[g] + a]
                for i in range(rows_nc):
                    row = row_of[node_a, i]
                    if row < 0:
                        continue
                    at = indptr[row]
                    for b in range(n):
                        node = b_nodes[b_start[g] + b]
                        for k in range(nc):
                            column = column_of[node, k]
                            if column >= 0:
                                while indices[at] != column:
                                    at += 1
                                data[at] += K[i, k, b]
                                at += 1
                            else:
                                lift[node_a, i] += K[i, k, b] * prescribed[node, k]

    return kernel


@dataclass(frozen=True)
class Slope:
    """Tangent at the points between a row field and a column field.

    Attributes:
        values: The tangent times the point's volume, in the order of the stencils, shape
            (points of the groups, m n), with m and n the numbers of components times slots of the
            row field and of the column field.
        row_value, value: Whether the row field and the column field have slots for values; if
            not, only gradients have slots.
    """

    values: Array
    row_value: bool
    value: bool


@dataclass(frozen=True)
class Entries:
    """A matrix under assembly between a row field and a column field.

    Attributes:
        rows, columns: Unknowns of the row field and of the column field.
        pattern: Pattern of the matrix.
        data: Entries of the matrix.
        prescribed: Values of the column field's prescribed components, shape (nodes, components).
        lift: Columns of prescribed components times their values are added to this array, shape
            (nodes, components) of the row field.
    """

    rows: FieldUnknowns
    columns: FieldUnknowns
    pattern: Pattern
    data: Array
    prescribed: Array
    lift: Array


def add_stiffness(
    a: Stencils, b: Stencils, begin: int, end: int, tangent: Slope, to: Entries
) -> None:
    """Add Σ_p φ_a · T_p · φ_b over the points of some groups to the matrix.

    Args:
        a, b: Stencils of the row field and of the column field, in common groups.
        begin, end: First group, and the group behind the last one.
        tangent: The tangents T.
        to: The matrix between the two fields.
    """
    gdim = a.dN.shape[1]
    place = to.pattern.indptr, to.pattern.indices, to.data, to.prescribed, to.lift
    if a is b and to.rows is to.columns and tangent.row_value == tangent.value:
        nc, ns = to.rows.components, gdim + int(tangent.value)
        stiffness_kernel(nc, ns, not tangent.value)(
            begin, end, a.groups, a.node_start, a.nodes, a.value_start, a.N, a.dN, tangent.values,
            to.rows.row_of, *place,
        )  # fmt: skip
        return
    kernel = _coupling_kernel(
        to.rows.components, gdim + int(tangent.row_value), tangent.row_value,
        to.columns.components, gdim + int(tangent.value), tangent.value,
    )  # fmt: skip
    kernel(
        begin, end, a.groups, a.node_start, a.nodes, a.value_start, a.N, a.dN, b.node_start,
        b.nodes, b.value_start, b.N, b.dN, tangent.values, to.rows.row_of, to.columns.row_of,
        *place,
    )  # fmt: skip


@numba.njit(cache=True, error_model="numpy")
def _add_blocks(rows, columns, blocks, row_of, column_of, indptr, indices, data, prescribed, lift):
    nc = blocks.shape[1]
    # position behind the last column found in a row: the next column is mostly there
    last, after = np.full(nc, -1, np.int64), np.zeros(nc, np.int64)
    for e in range(rows.size):
        for i in range(nc):
            row = row_of[rows[e], i]
            if row < 0:
                continue
            begin, end = indptr[row], indptr[row + 1]
            if last[i] != row:
                last[i], after[i] = row, begin
            for k in range(blocks.shape[2]):
                # masses and penalties do not couple components
                if blocks[e, i, k] == 0.0:
                    continue
                column = column_of[columns[e], k]
                if column >= 0:
                    low, high = after[i], end
                    if low > begin and indices[low - 1] >= column:
                        low, high = begin, low
                    elif low < end and indices[low] == column:
                        high = low
                    while low < high:
                        middle = (low + high) // 2
                        if indices[middle] < column:
                            low = middle + 1
                        else:
                            high = middle
                    data[low] += blocks[e, i, k]
                    after[i] = low + 1
                else:
                    lift[rows[e], i] += blocks[e, i, k] * prescribed[columns[e], k]


def add_blocks(blocks: Blocks, to: Entries) -> None:
    """Add blocks to a matrix.

    Args:
        blocks: The blocks.
        to: The matrix between the two fields of the blocks.
    """
    _add_blocks(
        blocks.rows, blocks.columns, blocks.values, to.rows.row_of, to.columns.row_of,
        to.pattern.indptr, to.pattern.indices, to.data, to.prescribed, to.lift,
    )  # fmt: skip


@numba.njit(cache=True, error_model="numpy")
def _multiply_blocks(rows, columns, blocks, u, out):
    for e in range(rows.size):
        for i in range(blocks.shape[1]):
            f = 0.0
            for k in range(blocks.shape[2]):
                f += blocks[e, i, k] * u[columns[e], k]
            out[rows[e], i] += f


def add_product(blocks: Blocks, u: Sequence[Array], out: Sequence[Array]) -> None:
    """Add the product of blocks with nodal values to nodal forces.

    Args:
        blocks: Part of a matrix.
        u: Nodal values of each field, shape (nodes, components).
        out: The product is added to these nodal forces of each field, shape (nodes, components).
    """
    _multiply_blocks(
        blocks.rows, blocks.columns, blocks.values, u[blocks.column_field], out[blocks.row_field]
    )


class Matrix:
    """A PETSc matrix, and the local entries that are summed into it.

    On one rank PETSc works on the array of local entries. On several ranks, `finish` sends the
    entries of ghost rows to their owners, which add them.

    Args:
        pattern: Pattern of the local entries.
        unknowns: Numbering of the unknowns.

    Attributes:
        pattern: The argument.
        data: Local entries, shape (entries,).
        petsc: The PETSc matrix.
    """

    def __init__(self, pattern: Pattern, unknowns: Unknowns):
        self.pattern = pattern
        self.data = np.zeros(pattern.indices.size)
        comm, self._rows = unknowns.comm, None
        if comm.size == 1:
            size = (unknowns.owned, unknowns.rows)
            self.petsc = PETSc.Mat().createAIJWithArrays(
                (size, size), (pattern.indptr, pattern.indices, self.data), comm=comm
            )
        else:
            self._rows = OwnedRows(
                comm, pattern.indptr, pattern.indices, unknowns.to_global, unknowns.owned,
                unknowns.rows,
            )  # fmt: skip
            self.petsc = self._rows.petsc
        self.petsc.setBlockSize(unknowns.block)

    def finish(self) -> None:
        """Tell PETSc that the entries changed. Collective."""
        if self.pattern.still.size:
            # diagonal entries of the same size as the others, so that smoothers ignore them
            self.data[self.pattern.still] = max(self.data.max(), -self.data.min()) or 1.0
        if self._rows is None:
            self.petsc.assemble()
            self.petsc.stateIncrease()
        else:
            self._rows.put(self.data)
