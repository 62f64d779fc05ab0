"""Stencils at the faces of points: values of the functions there, gradients of the points.

A load on a face does work on the functions at the face. With GIMP, the internal forces of a point
are the work of its stress on the functions at the two ends of its domain, in each direction. A load
at the end of the domain is in balance with this stress if it takes the functions there, too: linear
functions across the face, averages along it. The value and the gradient at the point give the same
only while the domain lies in one cell.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from dolfinmpm.basis.latticebasis import LatticeBasis
from dolfinmpm.basis.leafbasis import LeafBasis
from dolfinmpm.basis.linear import LinearBasis
from dolfinmpm.basis.stencils import Placement, Stencils, running_sum
from dolfinmpm.grid.linecells import FAR

__all__ = ["at_ends", "at_faces", "in_domains"]

Array = npt.NDArray[np.float64]
# Part of a half-length that is rounding
_ROUNDING = 1e-12


def at_faces(
    basis: LatticeBasis | LeafBasis | LinearBasis,
    s: Stencils,
    where: Placement,
    reach: Array,
    within: Array | None = None,
) -> Stencils:
    """Stencils of some points with the values of the functions at their faces.

    Without averages, a face beyond the cell of its point takes the functions at the edge of the
    cell, and the rest of the way by their gradients at the point. Values of linear functions on
    grids that are not rectangular follow from value and gradient at the point.

    Args:
        basis: The basis.
        s: Stencils of points with faces, on all active nodes.
        where: All points.
        reach: Offsets from the centres of all points to their faces (m), shape (points, gdim).
        within: Lower and upper corner of a box (m), shape (2, gdim), or None. Functions are those
            at the part of a face in the box, or at the place in the box that is nearest to it.
    """
    counts = np.diff(s.groups)
    number = np.repeat(np.diff(s.node_start), counts)
    # points of other fields have no nodes
    at = np.flatnonzero(number)
    rows = s.order[at]
    if isinstance(basis, LinearBasis):
        return replace(s, N=s.N + _slopes(s, number, reach[s.order]))
    x, half = where.x[rows], where.half[rows] if basis.averaged else np.zeros((rows.size, 0))
    if basis.averaged:
        to, half = _ends(x, half, reach[rows])
    else:
        low, high = (side[_cells(s, at)] for side in basis.cell_corners())
        to, half = np.clip(x + reach[rows], low, high), np.zeros_like(x)
    rest = np.zeros((s.order.size, x.shape[1]))
    rest[at] = x + reach[rows] - to
    if within is not None:
        uncut, (to, half) = to, _cut(to, half, *within)
        # a way by gradients would reach beyond the box
        rest[at[(to != uncut).any(axis=1)]] = 0.0
    if basis.averaged:
        faces = in_domains(basis, *_on_grid(basis, to, half), x, where.half[rows])
    elif isinstance(basis, LeafBasis):
        faces = basis.in_cells(to, _cells(s, at))
    else:
        first = basis.halo.cell_ijk[_cells(s, at)] - basis.halo.origin
        faces = _on_lattice(basis, to, half, first, np.ones_like(first))
    return replace(s, N=_on_nodes_of(s, number, at, faces) + _slopes(s, number, rest))


def _slopes(s: Stencils, number: npt.NDArray[np.int32], way: Array) -> Array:
    """Products of the gradients with a vector per position, for each entry of the stencils."""
    return np.einsum("vd,vd->v", s.dN, np.repeat(way, number, axis=0))


def _cells(s: Stencils, at: npt.NDArray[np.integer]) -> npt.NDArray[np.int32]:
    """Cells of points without domains, by their positions in `s.order`."""
    group = np.repeat(np.arange(s.groups.size - 1), np.diff(s.groups))[at]
    return s.cells[s.cell_start[group]]


def _ends(x: Array, half: Array, reach: Array) -> tuple[Array, Array]:
    """The ends of the points' domains towards their faces, and their half-lengths (m).

    A face is at the end of the domain along the axis on which it reaches furthest. A face within
    the domain is averaged over what is left up to the end.

    Args:
        x, half: Positions and half-lengths of the domains (m), shape (n, gdim).
        reach: Offsets to the faces (m), shape (n, gdim).
    """
    each = np.arange(len(x))
    # a point may be thin in a direction, without a half-length
    share = np.divide(np.abs(reach), half, out=np.zeros_like(reach), where=half > 0.0)
    axis = np.argmax(share, axis=1) if x.size else np.empty(0, np.intp)
    limit = half[each, axis]
    step = np.clip(reach[each, axis], -limit, limit)
    left = limit - np.abs(step)
    to, at = x.copy(), half.copy()
    to[each, axis] += step
    rounding = np.maximum(_ROUNDING * limit, FAR * np.abs(to[each, axis]))
    at[each, axis] = np.where(left > rounding, left, 0.0)
    return to, at


def _cut(at: Array, half: Array, low: Array, high: Array) -> tuple[Array, Array]:
    """Centres and half-lengths of the parts of faces in a box, or of the places nearest to them."""
    first, last = np.clip(at - half, low, high), np.clip(at + half, low, high)
    cut = np.any((at - half < low) | (at + half > high), axis=1)[:, None]
    part = np.where(last - first > FAR * np.abs(first), 0.5 * (last - first), 0.0)
    return np.where(cut, 0.5 * (first + last), at), np.where(cut, part, half)


def at_ends(
    basis: LatticeBasis | LeafBasis, x: Array, half: Array, reach: Array
) -> tuple[Stencils, Array]:
    """Stencils at the ends of domains towards faces, and the ways from there to the faces (m).

    Args:
        basis: A basis of averages.
        x, half: Positions and half-lengths of the domains (m), shape (n, gdim).
        reach: Offsets to the faces (m), shape (n, gdim).
    """
    to, part = _ends(x, half, reach)
    return in_domains(basis, *_on_grid(basis, to, part), x, half), x + reach - to


def _on_grid(basis: LatticeBasis | LeafBasis, at: Array, half: Array) -> tuple[Array, Array]:
    """Parts of domains; those beyond a side of the grid are at the side, where domains end."""
    low, high = np.array([[line[0], line[-1]] for line in basis.lattice.lines]).T
    beyond = (at + half <= low) | (at - half >= high)
    return np.where(beyond, np.clip(at, low, high), at), np.where(beyond, 0.0, half)


def in_domains(
    basis: LatticeBasis | LeafBasis, at: Array, within: Array, x: Array, half: Array
) -> Stencils:
    """Stencils of parts of domains, from functions of the cells that the domains overlap.

    Args:
        basis: The basis.
        at, within: Positions and half-lengths of the parts (m), shape (n, gdim).
        x, half: Positions and half-lengths of the domains (m), shape (n, gdim).
    """
    if isinstance(basis, LeafBasis):
        return basis.in_domains(at, within, x, half)
    first, number = basis.spans(x, half)
    low, count = basis.spans(at, within)
    # an end on a grid line belongs to the cells of its domain
    low = np.clip(low, first, first + number - 1)
    return _on_lattice(basis, at, within, low, np.minimum(count, first + number - low))


def _on_lattice(
    basis: LatticeBasis, at: Array, within: Array, low: npt.NDArray[np.int32],
    count: npt.NDArray[np.int32],
) -> Stencils:  # fmt: skip
    """Stencils in given cells, which this rank knows because points overlap them."""
    found = basis.stencils_in(at, within, low, count)
    assert found is not None, "the cells of a part of a domain are cells of its point"
    return found


def _on_nodes_of(
    s: Stencils, number: npt.NDArray[np.int32], at: npt.NDArray[np.integer], faces: Stencils
) -> Array:
    """Values of one set of stencils at the nodes of another set.

    Args:
        s: Stencils whose nodes contain those of the faces.
        number: Number of nodes of each position of `s`.
        at: Position in `s.order` of each face, shape (n,).
        faces: Stencils of the faces.
    """
    size = max(int(s.nodes.max(initial=0)), int(faces.nodes.max(initial=0))) + 1
    own = _keys(s, np.arange(s.order.size), size)
    theirs = _keys(faces, at[faces.order], size)
    place = np.minimum(np.searchsorted(own, theirs), max(own.size - 1, 0))
    same = own[place] == theirs
    values = np.zeros(own.size)
    values[place[same]] = faces.N[same]
    return values


def _keys(s: Stencils, position: npt.NDArray[np.integer], size: int) -> npt.NDArray[np.int64]:
    """A number for each entry of stencils, made of a position per point and of the node.

    Args:
        s: The stencils.
        position: The position for each point in `s.order`.
        size: Limit of the nodes' numbers.
    """
    each = np.diff(s.node_start)
    group = np.repeat(np.arange(each.size), np.diff(s.groups))
    number = each[group]
    start = running_sum(number, np.int64)
    within = np.arange(start[-1]) - np.repeat(start[:-1], number)
    node = s.nodes[np.repeat(s.node_start[:-1][group], number) + within]
    return np.repeat(np.asarray(position, np.int64), number) * size + node
