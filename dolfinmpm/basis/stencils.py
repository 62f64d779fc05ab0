"""Stencils: for each material point a row of nodes, values N and gradients of N.

Points that see the same nodes form a group. Nodes are stored once per group, in increasing order.
The points of a group follow each other. The stiffness of a group can therefore be summed before it
is scattered.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numba
import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from scipy import sparse

__all__ = [
    "Placement",
    "Stencils",
    "add_weighted",
    "concatenated",
    "gather",
    "joined",
    "pushed_forward",
    "selected",
    "spread",
    "stencil_matrix",
]


@dataclass(frozen=True)
class Placement:
    """Positions and domains of the material points, present or first ones, for a basis.

    Attributes:
        x: Positions (m), shape (n, gdim).
        half: Half-lengths of the points' domains (m), shape (n, gdim).
        volume: Volumes (m^gdim), shape (n,).
        cell: Local cells, shape (n,).
        axisymmetric: Whether the body is axisymmetric. Averages of gradients are then averages
            over a domain that goes around the axis.
    """

    x: npt.NDArray[np.float64]
    half: npt.NDArray[np.float64]
    volume: npt.NDArray[np.float64]
    cell: npt.NDArray[np.int32]
    axisymmetric: bool = False

    def of(self, rows: npt.NDArray[np.integer]) -> Placement:
        """The placement of the points of some rows."""
        return Placement(
            self.x[rows], self.half[rows], self.volume[rows], self.cell[rows], self.axisymmetric
        )


def concatenated(placements: Sequence[Placement]) -> Placement:
    """Several sets of points joined in their order; one set alone is returned as it is."""
    if len(placements) == 1:
        return placements[0]
    x, half, volume, cell = (
        np.concatenate([getattr(p, name) for p in placements])
        for name in ("x", "half", "volume", "cell")
    )
    return Placement(x, half, volume, cell, any(p.axisymmetric for p in placements))


@dataclass(frozen=True)
class Stencils:
    """Stencils of all material points of this rank.

    Attributes:
        order: Point of each position, grouped; shape (points,).
        groups: First position of every group, shape (groups + 1,).
        node_start: First entry of every group in `nodes`, shape (groups + 1,).
        nodes: Local node indices, increasing within a group.
        value_start: First entry of every group in `N` and `dN`, shape (groups + 1,).
        N: Values of the basis functions (-), one row of the group's nodes after
            the other.
        dN: Their gradients (1/m), shape (len(N), gdim).
        cell_start: First entry of every group in `cells`, shape (groups + 1,).
        cells: Local indices of the cells that the group's points overlap.
    """

    order: npt.NDArray[np.int32]
    groups: npt.NDArray[np.int32]
    node_start: npt.NDArray[np.int32]
    nodes: npt.NDArray[np.int32]
    value_start: npt.NDArray[np.int64]
    N: npt.NDArray[np.float64]
    dN: npt.NDArray[np.float64]
    cell_start: npt.NDArray[np.int32]
    cells: npt.NDArray[np.int32]

    def row(self, point: int) -> tuple[npt.NDArray, npt.NDArray, npt.NDArray]:
        """Nodes, N and ∇N of one point, shapes (m,), (m,) and (m, gdim)."""
        position = int(np.flatnonzero(self.order == point)[0])
        g = int(np.searchsorted(self.groups, position, side="right")) - 1
        nodes = self.nodes[self.node_start[g] : self.node_start[g + 1]]
        start = self.value_start[g] + (position - self.groups[g]) * nodes.size
        return nodes, self.N[start : start + nodes.size], self.dN[start : start + nodes.size]


def group_starts(keys: npt.NDArray[np.int64]) -> npt.NDArray[np.int32]:
    """First position of every run of equal keys, then the number of keys, shape (runs + 1,)."""
    starts = np.flatnonzero(np.diff(keys, prepend=-1)) if keys.size else np.empty(0, np.int64)
    return np.append(starts, keys.size).astype(np.int32)


def running_sum(counts: npt.NDArray[np.integer], dtype: npt.DTypeLike) -> npt.NDArray:
    """0, then the sums of the first 1, 2, ... counts, shape (counts + 1,)."""
    total = np.zeros(counts.size + 1, dtype)
    np.cumsum(counts, out=total[1:])
    return total


@numba.njit(cache=True, error_model="numpy")
def add_weighted(order, groups, start, targets, weight_start, weights, values, out):
    """Add Σ_p w_pa m_p, a sum over the points, to every node or every cell a.

    Args:
        order, groups: `order` and `groups` of the stencils.
        start, targets: `node_start` and `nodes` of the stencils, or `cell_start` and `cells`.
        weight_start: First entry of every group in `weights`, shape (groups + 1,).
        weights: w: for each point of a group, one row with a weight per target of the group.
        values: m at the points, shape (points,).
        out: The sums are added to this array, shape (nodes,) or (cells,).
    """
    for g in range(groups.size - 1):
        number = start[g + 1] - start[g]
        for position in range(groups[g], groups[g + 1]):
            at = weight_start[g] + (position - groups[g]) * number
            for k in range(number):
                out[targets[start[g] + k]] += weights[at + k] * values[order[position]]


@numba.njit(cache=True, error_model="numpy")
def _gather(order, groups, node_start, nodes, value_start, N, dN, u, value, gradient):
    components, gdim = gradient.shape[1], gradient.shape[2]
    for g in range(groups.size - 1):
        first = node_start[g]
        m = node_start[g + 1] - first
        for position in range(groups[g], groups[g + 1]):
            p = order[position]
            at = value_start[g] + (position - groups[g]) * m
            for i in range(components):
                value[p, i] = 0.0
                for j in range(gdim):
                    gradient[p, i, j] = 0.0
            for a in range(m):
                node = nodes[first + a]
                for i in range(components):
                    u_ai = u[node, i]
                    value[p, i] += N[at + a] * u_ai
                    for j in range(gdim):
                        gradient[p, i, j] += dN[at + a, j] * u_ai


@numba.njit(cache=True, error_model="numpy")
def _gather_2(order, groups, node_start, nodes, value_start, N, dN, u, value, gradient):
    """`_gather` of a vector in 2D, with sums in registers."""
    for g in range(groups.size - 1):
        first = node_start[g]
        m = node_start[g + 1] - first
        for position in range(groups[g], groups[g + 1]):
            at = value_start[g] + (position - groups[g]) * m
            v0 = v1 = h00 = h01 = h10 = h11 = 0.0
            for a in range(m):
                node = nodes[first + a]
                w, w0, w1 = N[at + a], dN[at + a, 0], dN[at + a, 1]
                u0, u1 = u[node, 0], u[node, 1]
                v0, v1 = v0 + w * u0, v1 + w * u1
                h00, h01 = h00 + w0 * u0, h01 + w1 * u0
                h10, h11 = h10 + w0 * u1, h11 + w1 * u1
            p = order[position]
            value[p, 0], value[p, 1] = v0, v1
            gradient[p, 0, 0], gradient[p, 0, 1] = h00, h01
            gradient[p, 1, 0], gradient[p, 1, 1] = h10, h11


@numba.njit(cache=True, error_model="numpy")
def _gather_3(order, groups, node_start, nodes, value_start, N, dN, u, value, gradient):
    """`_gather` of a vector in 3D, with sums in registers."""
    for g in range(groups.size - 1):
        first = node_start[g]
        m = node_start[g + 1] - first
        for position in range(groups[g], groups[g + 1]):
            at = value_start[g] + (position - groups[g]) * m
            v0 = v1 = v2 = 0.0
            h00 = h01 = h02 = h10 = h11 = h12 = h20 = h21 = h22 = 0.0
            for a in range(m):
                node = nodes[first + a]
                w, w0, w1, w2 = N[at + a], dN[at + a, 0], dN[at + a, 1], dN[at + a, 2]
                u0, u1, u2 = u[node, 0], u[node, 1], u[node, 2]
                v0, v1, v2 = v0 + w * u0, v1 + w * u1, v2 + w * u2
                h00, h01, h02 = h00 + w0 * u0, h01 + w1 * u0, h02 + w2 * u0
                h10, h11, h12 = h10 + w0 * u1, h11 + w1 * u1, h12 + w2 * u1
                h20, h21, h22 = h20 + w0 * u2, h21 + w1 * u2, h22 + w2 * u2
            p = order[position]
            value[p, 0], value[p, 1], value[p, 2] = v0, v1, v2
            gradient[p, 0, 0], gradient[p, 0, 1], gradient[p, 0, 2] = h00, h01, h02
            gradient[p, 1, 0], gradient[p, 1, 1], gradient[p, 1, 2] = h10, h11, h12
            gradient[p, 2, 0], gradient[p, 2, 1], gradient[p, 2, 2] = h20, h21, h22


def gather(s: Stencils, u: npt.NDArray, value: npt.NDArray, gradient: npt.NDArray) -> None:
    """Evaluate a nodal field and its gradient at the points.

    Args:
        s: Stencils.
        u: Nodal values, shape (nodes, components).
        value: Written: Σ N_a u_a, shape (points, components).
        gradient: Written: Σ u_a ⊗ ∇N_a, shape (points, components, gdim).
    """
    shape = gradient.shape[1:]
    kernel = _gather_2 if shape == (2, 2) else _gather_3 if shape == (3, 3) else _gather
    kernel(s.order, s.groups, s.node_start, s.nodes, s.value_start, s.N, s.dN, u, value, gradient)


def _pieces(start, number):
    """Indices of all pieces; piece i has the number[i] indices from start[i] on."""
    ends = np.cumsum(number)
    total = int(ends[-1]) if ends.size else 0
    return np.arange(total) + np.repeat(start - (ends - number), number)


def _regrouped(s: Stencils, order, groups) -> Stencils:
    """The stencils of the points of `order`, in new groups whose points see the same nodes."""
    position = np.empty(int(s.order.max(initial=-1)) + 1, np.int64)
    position[s.order] = np.arange(s.order.size)
    old = position[order]
    group_of = np.repeat(np.arange(s.groups.size - 1), np.diff(s.groups))
    first = group_of[old[groups[:-1]]]
    m = np.diff(s.node_start)
    cells = np.diff(s.cell_start)
    start = s.value_start[group_of] + (np.arange(s.order.size) - s.groups[group_of]) * m[group_of]
    values = _pieces(start[old], m[group_of[old]])
    return Stencils(
        np.asarray(order, np.int32),
        np.asarray(groups, np.int32),
        running_sum(m[first], np.int32),
        s.nodes[_pieces(s.node_start[first].astype(np.int64), m[first])],
        running_sum(m[first].astype(np.int64) * np.diff(groups), np.int64),
        s.N[values],
        s.dN[values],
        running_sum(cells[first], np.int32),
        s.cells[_pieces(s.cell_start[first].astype(np.int64), cells[first])],
    )


def selected(s: Stencils, chosen: npt.NDArray[np.bool_]) -> Stencils:
    """The stencils of some of the points.

    Args:
        s: Stencils.
        chosen: Whether each point is chosen, shape (points,).
    """
    if chosen.all():
        return s
    keep = chosen[s.order]
    group_of = np.repeat(np.arange(s.groups.size - 1), np.diff(s.groups))[keep]
    return _regrouped(s, s.order[keep], group_starts(group_of.astype(np.int64)))


def spread(s: Stencils, rows: npt.NDArray[np.integer], count: int) -> Stencils:
    """Extend stencils of some points to all points.

    The other points form a group without nodes.

    Args:
        s: Stencils of the points of `rows`.
        rows: Numbers of the points of `s` among all points, shape (n,).
        count: Number of all points.
    """
    rest = np.ones(count, bool)
    rest[rows] = False
    others = np.flatnonzero(rest).astype(np.int32)
    order = np.concatenate([np.asarray(rows, np.int32)[s.order], others])
    if not others.size:
        return replace(s, order=order)
    ends = [np.append(start, start[-1]) for start in (s.node_start, s.value_start, s.cell_start)]
    return replace(
        s, order=order, groups=np.append(s.groups, np.int32(count)), node_start=ends[0],
        value_start=ends[1], cell_start=ends[2],
    )  # fmt: skip


def joined(stencils: Sequence[Stencils]) -> list[Stencils]:
    """Stencils of the same points in several bases, regrouped into common groups.

    Args:
        stencils: Stencils of each basis. Two bases that share one object share the result.
    """
    first = stencils[0]
    if all(
        s is first
        or (np.array_equal(s.groups, first.groups) and np.array_equal(s.order, first.order))
        for s in stencils
    ):
        return list(stencils)
    key = np.zeros(int(first.order.max(initial=-1)) + 1, np.int64)
    for s in {id(s): s for s in stencils}.values():
        group_of = np.repeat(np.arange(s.groups.size - 1), np.diff(s.groups))
        key[s.order] = key[s.order] * max(s.groups.size - 1, 1) + group_of
    rows = np.sort(first.order)
    order = rows[np.argsort(key[rows], kind="stable")]
    groups = group_starts(key[order])
    made = {id(s): _regrouped(s, order, groups) for s in stencils}
    return [made[id(s)] for s in stencils]


@numba.njit(cache=True, error_model="numpy")
def _push_forward(order, groups, node_start, value_start, dN, inverse, out):
    gdim = dN.shape[1]
    for g in range(groups.size - 1):
        m = node_start[g + 1] - node_start[g]
        for position in range(groups[g], groups[g + 1]):
            p = order[position]
            at = value_start[g] + (position - groups[g]) * m
            for a in range(at, at + m):
                for i in range(gdim):
                    out[a, i] = 0.0
                    for j in range(gdim):
                        out[a, i] += dN[a, j] * inverse[p, j, i]


def pushed_forward(s: Stencils, F: npt.NDArray[np.float64]) -> Stencils:
    """Stencils with gradients by present positions from gradients by first ones: ∇N = F⁻ᵀ ∇₀N.

    Args:
        s: Stencils with gradients ∇₀N by first positions (1/m).
        F: Deformation gradients of the points (-), shape (points, gdim, gdim).
    """
    dN = np.empty_like(s.dN)
    inverse = np.linalg.inv(F)
    _push_forward(s.order, s.groups, s.node_start, s.value_start, s.dN, inverse, dN)
    return replace(s, dN=dN)


def all_pushed_forward(stencils: Sequence[Stencils], F: npt.NDArray[np.float64]) -> list[Stencils]:
    """Stencils with gradients by present positions. Common objects stay common."""
    now = {id(s): pushed_forward(s, F) for s in stencils}
    return [now[id(s)] for s in stencils]


def stencil_matrix(
    s: Stencils, values: npt.NDArray[np.float64], shape: tuple[int, int]
) -> sparse.csr_matrix:
    """Stencils of material points as a matrix.

    Args:
        s: The stencils.
        values: N, or one direction of ∇N.
        shape: Number of points and of nodes.
    """
    from scipy import sparse

    lengths = np.diff(s.node_start).astype(np.int64)
    number = np.diff(s.groups).astype(np.int64)
    group = np.repeat(np.arange(lengths.size), number)
    length = lengths[group]
    rows = np.repeat(s.order, length)
    first = np.repeat(s.node_start[:-1][group].astype(np.int64), length)
    begin = np.cumsum(length) - length
    at = first + np.arange(rows.size) - np.repeat(begin, length)
    return sparse.csr_matrix((values, (rows, s.nodes[at])), shape=shape)
