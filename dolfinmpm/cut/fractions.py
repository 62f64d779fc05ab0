"""Fill fractions of cells, shares of points in cells, and shares of splines in the body."""

from __future__ import annotations

import numba
import numpy as np
import numpy.typing as npt
from dolfinx.la import InsertMode, Vector

from dolfinmpm.basis import LatticeBasis, LeafBasis, LinearBasis, Placement, Stencils
from dolfinmpm.basis.bspline import integrals
from dolfinmpm.basis.leafsplinestencils import leaf_integrals
from dolfinmpm.basis.lineweights import INNER
from dolfinmpm.basis.stencils import add_weighted, running_sum
from dolfinmpm.grid.halo import Numbering
from dolfinmpm.grid.lattice import cell_volumes
from dolfinmpm.grid.linecells import coordinate_rounding

__all__ = ["cell_sums", "domain_shares", "fill_fractions", "support_shares"]

Array = npt.NDArray[np.float64]


@numba.njit(cache=True, error_model="numpy")
def _share(low, high, cell, x, half, p, part):
    """Share in a cell of the inner part of a domain. A point without a domain is in one cell."""
    share = 1.0
    for d in range(x.shape[1]):
        if half[p, d] == 0.0:
            if not low[cell, d] <= x[p, d] < high[cell, d]:
                return 0.0
            continue
        inner = part * half[p, d]
        left = max(x[p, d] - inner, low[cell, d])
        right = min(x[p, d] + inner, high[cell, d])
        share *= max(right - left, 0.0) / (2.0 * inner)
    return share


@numba.njit(cache=True, error_model="numpy")
def _spread(order, groups, cell_start, cells, low, high, x, half, volume, wanted, out):
    """Add each point's volume to the cells it overlaps, by the shares of its domain.

    Groups of points without a wanted cell are left out, unless all cells are wanted (no mask).
    """
    for g in range(groups.size - 1):
        needed = wanted.size == 0
        for at in range(cell_start[g], cell_start[g + 1]):
            needed = needed or wanted[cells[at]]
        if not needed:
            continue
        single = cell_start[g + 1] - cell_start[g] == 1
        for position in range(groups[g], groups[g + 1]):
            p = order[position]
            for at in range(cell_start[g], cell_start[g + 1]):
                share = 1.0 if single else _share(low, high, cells[at], x, half, p, 1.0)
                out[cells[at]] += share * volume[p]


@numba.njit(cache=True, error_model="numpy")
def _fill_shares(order, groups, cell_start, cells, low, high, x, half, share_start, shares):
    for g in range(groups.size - 1):
        number = cell_start[g + 1] - cell_start[g]
        for position in range(groups[g], groups[g + 1]):
            p = order[position]
            start = share_start[g] + (position - groups[g]) * number
            if number == 1:
                shares[start] = 1.0
                continue
            total = 0.0
            for k in range(number):
                shares[start + k] = _share(low, high, cells[cell_start[g] + k], x, half, p, INNER)
                total += shares[start + k]
            for k in range(number):
                shares[start + k] /= total


def _boxes(basis: LatticeBasis | LinearBasis | LeafBasis) -> tuple[Array, Array]:
    """Lower and upper corners of the local cells (m); empty if points are in one cell only."""
    if isinstance(basis, LinearBasis):
        return (np.empty((0, basis.grid.geometry.dim)),) * 2
    return basis.cell_corners()


def domain_shares(
    where: Placement, stencils: Stencils, basis: LatticeBasis | LinearBasis | LeafBasis
) -> tuple[npt.NDArray[np.int64], Array]:
    """Shares of the points' domains in cells. The shares of a point sum to 1.

    Parts of a domain outside the grid do not count. A point without a domain is entirely in its
    cell. A domain that reaches into a cell by less than 0.1 % of its length has no share there, see
    `dolfinmpm.basis.lineweights.INNER`.

    Returns:
        First entry of every group, shape (groups + 1,), and the shares: per point of a group one
        row with the group's cells.
    """
    counts = np.diff(stencils.cell_start).astype(np.int64) * np.diff(stencils.groups)
    start = running_sum(counts, np.int64)
    shares = np.empty(start[-1])
    _fill_shares(
        stencils.order, stencils.groups, stencils.cell_start, stencils.cells, *_boxes(basis),
        where.x, where.half, start, shares,
    )  # fmt: skip
    return start, shares


def cell_sums(
    where: Placement,
    stencils: Stencils,
    basis: LatticeBasis | LinearBasis | LeafBasis,
    amounts: Array,
    wanted: npt.NDArray[np.bool_] | None = None,
) -> Array:
    """Sum of amounts at the points over each local cell, shape (cells,). Collective.

    The amount of a point is divided among the cells of its domain.

    Args:
        where: Positions, half-lengths and volumes of the points.
        stencils: Their stencils.
        basis: The basis of the stencils.
        amounts: Amounts at the points, shape (points,).
        wanted: Mask of the cells whose sums are needed, on any rank, shape (cells,); None for all.
            The sums of other cells are then not complete.
    """
    shared = basis.cells.vector()
    _spread(
        stencils.order, stencils.groups, stencils.cell_start, stencils.cells, *_boxes(basis),
        where.x, where.half, np.ascontiguousarray(amounts),
        np.empty(0, bool) if wanted is None else wanted, shared.array,
    )  # fmt: skip
    if basis.cells.comm.size > 1:
        shared.scatter_reverse(InsertMode.add)
        shared.scatter_forward()
    return shared.array


def fill_fractions(
    where: Placement,
    stencils: Stencils,
    basis: LatticeBasis | LinearBasis | LeafBasis,
    wanted: npt.NDArray[np.bool_] | None = None,
) -> Array:
    """Share of each local cell's volume that material points fill, shape (cells,). Collective.

    Args:
        where: Positions, half-lengths and volumes of the points.
        stencils: Their stencils.
        basis: The basis of the stencils.
        wanted: Mask of the cells whose shares are needed, see `cell_sums`.
    """
    low, high = _boxes(basis)
    boxes = not isinstance(basis, LinearBasis)
    volumes = np.prod(high - low, axis=1) if boxes else cell_volumes(basis.grid)
    return cell_sums(where, stencils, basis, where.volume, wanted) / volumes


def _add_up(shared: Vector, nodes: Numbering) -> None:
    """Add up what ranks know of their shared nodes. Collective."""
    if nodes.comm.size > 1:
        shared.scatter_reverse(InsertMode.add)
        shared.scatter_forward()


def _integrals_on_leaves(basis: LeafBasis) -> Array:
    """Integral of each function over the leaves (m^d), shape (nodes,). Collective."""
    own, (gdim, width) = basis.cells.owned, basis.knots.shape[1:]
    lines = np.empty((own, gdim, width // 2 + 1))
    leaf_integrals(basis.knots[:own], lines)
    each = np.ones((own, 1))
    for d in range(gdim):
        each = (each[:, :, None] * lines[:, d, None]).reshape(own, each.shape[1] * lines.shape[2])
    shared = basis.nodes.vector()
    np.add.at(shared.array, basis.corner_nodes[:own].ravel(), each.ravel())
    _add_up(shared, basis.nodes)
    return shared.array


def _met_sides(where: Placement, stencils: Stencils, basis: LatticeBasis | LeafBasis) -> Array:
    """Whether the body fills the cells of a function to a side, 1 or 0, shape (nodes, gdim, 2).

    A cell at a side is filled to it if a point is in the half of the cell that is beside the side.
    The sides are the lower and the upper one of each axis. Ranks do not share what they know.

    Args:
        where, stencils, basis: See `support_shares`.
    """
    s, x = stencils, where.x[stencils.order]
    low, high = basis.cell_corners()
    met = np.zeros((basis.nodes.size, low.shape[1], 2))
    # points of other fields have neither cells nor nodes, see `stencils.spread`
    inside = np.diff(s.cell_start) > 0
    if not inside.any():
        return met
    first, nodes_each = s.cell_start[:-1][inside], np.diff(s.node_start)
    of_group = np.empty(inside.size)
    for d, line in enumerate(basis.lattice.lines):
        size, close = high[:, d] - low[:, d], coordinate_rounding(line[0], line[-1])
        for k, (corner, end) in enumerate(((low, line[0]), (high, line[-1]))):
            half = np.where(np.abs(corner[:, d] - end) <= close, 0.5 * size, -1.0)
            of_group[:] = -1.0
            of_group[inside] = np.maximum.reduceat(half[s.cells], first)
            near = np.abs(x[:, d] - end) <= np.repeat(of_group, np.diff(s.groups))
            groups = np.logical_or.reduceat(near, s.groups[:-1])
            met[s.nodes[np.repeat(groups, nodes_each)], d, k] = 1.0
    return met


def _support_inside(line: Array, inner: Array, met: Array) -> Array:
    """Share of a function's support that is not beyond sides that the body does not fill.

    Args:
        line: Lattice lines (m).
        inner: Inner knots of the functions (m), shape (functions, degree). A knot at an end of the
            line stands for a cell of the support that is beyond the end.
        met: Whether the body fills the cells to the ends, more than 0 or 0, shape (functions, 2).

    Returns:
        The shares, shape (functions,).
    """
    close = coordinate_rounding(line[0], line[-1])
    beyond = np.stack([np.abs(inner - end) <= close for end in (line[0], line[-1])], axis=1)
    cells = np.where(met > 0, 0, beyond.sum(axis=2)).sum(axis=1)
    return np.asarray(1.0 - cells / (inner.shape[1] + 1))


def _knots_of(line: Array, degree: int) -> Array:
    """Inner knots of the functions on a line (m), shape (functions, degree)."""
    knots = np.concatenate([[line[0]] * (degree - 1), line, [line[-1]] * (degree - 1)])
    return np.lib.stride_tricks.sliding_window_view(knots, degree)


def support_shares(where: Placement, stencils: Stencils, basis: LatticeBasis | LeafBasis) -> Array:
    """Share of each function's integral in the body, shape (nodes,). Collective.

    At a side of the grid, a function has fewer cells, and a smaller integral. Where the body does
    not fill the cells to the side, the share is of the integral that the function would have with
    all its cells. Then it counts what the function feels of the body, as elsewhere.

    A function on leaves that does not hang has a part in each hanging function that follows it. A
    hanging function has the least share of those that it follows.

    Args:
        where: Positions, half-lengths and volumes of the points.
        stencils: Their stencils.
        basis: The basis of the stencils.
    """
    nodes, s, lines = basis.nodes, stencils, basis.lattice.lines
    shared = nodes.vector(1 + 2 * len(lines))
    sums, part = shared.array.reshape(-1, 1 + 2 * len(lines)), np.zeros(nodes.size)
    add_weighted(s.order, s.groups, s.node_start, s.nodes, s.value_start, s.N, where.volume, part)
    sums[:, 0] = part
    sums[:, 1:] = _met_sides(where, s, basis).reshape(-1, 2 * len(lines))
    _add_up(shared, nodes)
    if isinstance(basis, LeafBasis):
        return _shares_on_leaves(basis, sums)
    whole, met = np.ones(nodes.size), sums[:, 1:].reshape(-1, len(lines), 2)
    for d, line in enumerate(lines):
        ijk = basis.halo.node_ijk[:, d]
        inside = _support_inside(line, _knots_of(line, basis.degree)[ijk], met[:, d])
        whole *= integrals(line, basis.degree)[ijk] / inside
    return sums[:, 0] / whole


def _shares_on_leaves(basis: LeafBasis, known: Array) -> Array:
    """See `support_shares`. Collective.

    Args:
        basis: The basis.
        known: Integrals of the functions in the body (m^d), then what `_met_sides` returns, shape
            (nodes, 1 + 2 gdim).
    """
    H, owned, nodes = basis.hanging, basis.hanging[: basis.nodes.owned], basis.nodes
    shared = nodes.vector(known.shape[1] + 1)
    sums = shared.array.reshape(-1, known.shape[1] + 1)
    own = np.column_stack([_integrals_on_leaves(basis), known])[: nodes.owned]
    sums[:] = owned.T @ own
    _add_up(shared, nodes)
    wholes, parts = sums[:, 0] + basis.integrals_outside(), sums[:, 1].copy()
    met = sums[:, 2:].reshape(-1, len(basis.lattice.lines), 2)
    for d, line in enumerate(basis.lattice.lines):
        parts *= _support_inside(line, basis.inner_knots[:, d], met[:, d])
    shares = np.divide(parts, wholes, out=np.zeros(nodes.size), where=~basis.hangs)
    return np.asarray(np.minimum.reduceat(shares[H.indices], H.indptr[:-1]))
