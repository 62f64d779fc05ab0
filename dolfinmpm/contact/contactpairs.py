"""Pairs of facing contact points on the boundaries of two bodies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
import scipy

from dolfinmpm._platform.errors import ParameterError, raise_together
from dolfinmpm.basis import LatticeBasis, LeafBasis
from dolfinmpm.basis.stencils import Stencils, stencil_matrix
from dolfinmpm.contact.contactstencils import ContactStencils
from dolfinmpm.cut.activation import ActiveDomain, ActiveField
from dolfinmpm.cut.unknowns import Unknowns
from dolfinmpm.grid.lattice import Lattice, lattice_of, smallest_height

if TYPE_CHECKING:
    from dolfinmpm.contact.twobodycontact import TwoBodyContact

__all__ = ["LAYERS", "TOUCHES", "ContactPairs"]

Array = npt.NDArray[np.float64]
Rows = npt.NDArray[np.integer]

# Number of pieces of the other boundary that are checked per marker, and the largest cosine of the
# angle between facing normals
_NEAREST, _OPPOSED = 8, -0.2
# Reach of a piece from its marker along the surface, in lengths of the piece, or roots of its area.
# So pieces of Gauss points and of triangles leave no room between them.
_LENGTH, _WIDTH = 0.65, 1.0
# Parts of a piece below this share of its length are rounding
_NO_LENGTH = 1e-9
# Layers of cells in which the other body may be
LAYERS = 2
# Gaps and overlaps of bodies below this share of a cell are rounding
TOUCHES = 1e-6


@dataclass(frozen=True)
class Side:
    """Contact points on one of the bodies.

    Attributes:
        field: Number of the body's field.
        stencils: Stencils of the points in the basis of the field.
        finer: Size of the grid's cells over that of the leaf of each point, shape (n,).
    """

    field: int
    stencils: ContactStencils
    finer: Array


class ContactPairs:
    """Facing contact points of two bodies at the start of a step. Collective.

    Args:
        contact: The contact.
        here: Fields and points that take part in the step.

    Attributes:
        contact: The contact.
        rows: Marker of the first boundary of each pair, shape (m,). On boundaries that tile, a
            marker has one pair per cell that its segment crosses.
        shares: Share of each pair in the area of its marker, shape (m,).
        gap: Gaps g (m), shape (m,).
        normal: Normals out of the second body, shape (m, d).
        areas: Areas (m^(d-1)), shape (m,).
        sides: Contact points on the first and on the second body.
        stiffness: κ of each pair (Pa/m), shape (m,).
        reach: Largest gap of a pair (m).

    Raises:
        ParameterError: The bodies overlap before the first step.
    """

    def __init__(self, contact: TwoBodyContact, here: ActiveDomain):
        self.contact = contact
        first, second = (b.markers for b in contact.boundaries)
        self.reach = smallest_height(contact.points.grid)
        fields = [
            next(k for k, f in enumerate(here.fields) if f.space.increment is u) for u in contact.u
        ]
        begun = contact.begun
        if not begun:
            contact.check_sides()
        x, area = first["x"], first["area"]
        X, A = (np.concatenate(first.comm.allgather(second[name])) for name in ("x", "area"))
        piece, gap, normal = self._facing_pieces(x, area, X, A)
        rows = np.flatnonzero(piece >= 0)
        lattice = lattice_of(contact.points.grid)
        assert lattice is not None
        part: Rows = np.arange(rows.size)
        at: Array = x[rows]
        self.shares: Array = np.ones(rows.size)
        if contact.boundaries[0].tiles:
            lines = _finest_lines([here.fields[k] for k in fields], lattice)
            part, at, self.shares = _parts_in_cells(at, area[rows], lines)
        self.rows = rows = rows[part]
        self.gap, self.normal = gap[rows], normal[rows]
        self.areas = self.shares * np.linalg.norm(area[rows], axis=1)
        raise_together(first.comm, None if begun else self._overlap(x))
        opposite = at - self.gap[:, None] * self.normal
        self.sides = (
            _side(fields[0], here.fields[fields[0]], at, x[rows]),
            _side(fields[1], here.fields[fields[1]], opposite, X[piece[rows]]),
        )
        self.stiffness = np.full(rows.size, contact.stiffness)
        if contact.law.stiffness is None:
            self.stiffness *= np.maximum(*(side.finer for side in self.sides))

    def _facing_pieces(self, x: Array, area: Array, X: Array, A: Array):
        """The piece that each marker faces, -1 for none, the gap (m) and the normal.

        Args:
            x, area: Positions (m) and area vectors of the markers, shape (n, d).
            X, A: Positions (m) and area vectors of the pieces, shape (m, d).
        """
        n, d = x.shape
        piece = np.full(n, -1, np.int64)
        if not n:
            return piece, np.empty(0), np.empty((0, d))
        sizes = np.linalg.norm(A, axis=1)
        half = _LENGTH * sizes if d == 2 else _WIDTH * np.sqrt(sizes)
        count = min(_NEAREST, len(X))
        distance, near = scipy.spatial.cKDTree(X).query(
            x, count, distance_upper_bound=float(np.hypot(self.reach, half.max()))
        )
        known = np.isfinite(distance.reshape(n, count))
        near = np.where(known, near.reshape(n, count), 0)
        own = area / np.linalg.norm(area, axis=1)[:, None]
        others = (A / sizes[:, None])[near]
        opposed = known & (np.einsum("pi,pci->pc", own, others) < _OPPOSED)
        normal = others - own[:, None]
        normal /= np.maximum(np.linalg.norm(normal, axis=2), 1e-300)[:, :, None]
        apart = x[:, None] - X[near]
        gap = np.einsum("pci,pci->pc", apart, normal)
        along = np.linalg.norm(apart - gap[:, :, None] * normal, axis=2)
        faces = opposed & (along <= half[near]) & (np.abs(gap) < self.reach)
        # several pieces may face a marker: it takes the piece whose middle is relatively nearest
        best = np.argmin(np.where(faces, along / half[near], np.inf), axis=1)
        every = np.arange(n)
        found = faces[every, best]
        piece[found] = near[every, best][found]
        return piece, gap[every, best], normal[every, best]

    def _overlap(self, x: Array) -> ParameterError | None:
        """The error for bodies that overlap, or None."""
        deep = self.gap < -TOUCHES * self.reach
        if not deep.any():
            return None
        p = int(np.argmin(self.gap))
        return ParameterError(
            f"the bodies of {self.contact!r} overlap before the first step: "
            f"{np.count_nonzero(deep)} markers are inside the other body, the marker at "
            f"{x[self.rows[p]]} m by {-self.gap[p]:.4g} m: put the bodies beside each other"
        )

    def lists(self, unknowns: Unknowns) -> tuple[npt.NDArray, npt.NDArray]:
        """Lists of nodes that each pair couples, numbered with the offsets of their fields."""
        parts = []
        for side in self.sides:
            first, nodes, _ = side.stencils.rows()
            parts.append((first, nodes + unknowns.fields[side.field].offset))
        lists = [
            np.concatenate([nodes[first[c] : first[c + 1]] for first, nodes in parts])
            for c in range(len(self.rows))
        ]
        start = np.zeros(len(lists) + 1, np.int64)
        np.cumsum([len(one) for one in lists], out=start[1:])
        return start, np.concatenate([np.empty(0, np.int32), *lists]).astype(np.int32)


def _side(number: int, field: ActiveField, x: Array, markers: Array) -> Side:
    """Contact points on the boundary of a body. Collective at first.

    A point barely beyond the body may be in a cell that is not active. Then the functions of the
    cell of the marker beside the point are continued to the point.

    Args:
        number: Number of the field.
        field: The field of the body.
        x: Positions of the points (m), shape (n, d).
        markers: Positions of the markers beside the points (m), shape (n, d).
    """
    basis, finer = field.basis, np.ones(len(x))
    if isinstance(basis, LeafBasis):
        cells = basis.cells_at(x)
        known = (cells >= 0) & field.cells[cells]
        cells[~known] = basis.cells_at(markers)[~known]
        s = basis.in_cells(x, cells)
        low, high = basis.cell_corners()
        finer = smallest_height(basis.grid) / (high - low)[cells].min(axis=1)
    else:
        assert isinstance(basis, LatticeBasis)
        s = _lattice_stencils(basis, field.cells, x, markers)
    N = stencil_matrix(s, s.N, (len(x), basis.nodes.size))
    if field.C is not None:
        N = scipy.sparse.csr_matrix(N @ field.C)
    N.eliminate_zeros()
    return Side(number, ContactStencils.of(N, N.shape[1]), finer)


def _lattice_stencils(
    basis: LatticeBasis, active: npt.NDArray[np.bool_], x: Array, markers: Array
) -> Stencils:
    """Stencils of points on the boundary of a body, see `_side`."""
    table = basis.halo.cell_table
    low = basis.lattice.cells_at(x) - basis.halo.origin
    inside = np.all((low >= 0) & (low < table.shape), axis=1)
    at = np.where(inside, table[tuple(np.where(inside[:, None], low, 0).T)], -1)
    known = (at >= 0) & active[at]
    low[~known] = (basis.lattice.cells_at(markers) - basis.halo.origin)[~known]
    s = basis.stencils_in(x, np.zeros_like(x), np.ascontiguousarray(low, np.int32),
                          np.ones(low.shape, np.int32))  # fmt: skip
    # overlap of ranks is as wide as a cell and its neighbours
    assert s is not None
    return s


def _finest_lines(fields: Sequence[ActiveField], lattice: Lattice) -> list[Array]:
    """Lines of the smallest leaves that two fields can have (m), per direction."""
    depths = [f.space.refinement.depth for f in fields if f.space.refinement is not None]
    halvings = 2 ** max(depths, default=0)
    return [
        np.interp(np.arange(halvings * (line.size - 1) + 1) / halvings, np.arange(line.size), line)
        for line in lattice.lines
    ]


def _parts_in_cells(
    x: Array, area: Array, lines: Sequence[Array]
) -> tuple[npt.NDArray[np.intp], Array, Array]:
    """Parts of the markers' segments per cell. The basis functions are smooth on each part.

    Args:
        x, area: Middles (m) and area vectors (m) of segments in the plane, shape (n, 2).
        lines: Lines between the cells in each direction (m).

    Returns:
        Segment of each part, shape (m,), middle of the part (m), shape (m, 2), and its share of
        the segment's area, shape (m,).
    """
    segment, middles, shares = np.arange(len(x)), x, np.ones(len(x))
    if not len(x):
        return segment, middles, shares
    along = np.column_stack([-area[:, 1], area[:, 0]])
    ends = [
        np.column_stack([np.searchsorted(line, e[:, d], "right") for d, line in enumerate(lines)])
        for e in (x - 0.5 * along, x + 0.5 * along)
    ]
    cut = np.flatnonzero(np.any(ends[0] != ends[1], axis=1))
    if not cut.size:
        return segment, middles, shares
    whole = np.setdiff1d(segment, cut)
    found = [(whole, x[whole], shares[whole])]
    for p in cut:
        first = x[p] - 0.5 * along[p]
        t = [np.array([0.0, 1.0])]
        t += [
            (line[min(a, b) : max(a, b)] - first[d]) / along[p, d]
            for d, (line, a, b) in enumerate(zip(lines, ends[0][p], ends[1][p]))
            if along[p, d]
        ]
        places = np.unique(np.clip(np.concatenate(t), 0.0, 1.0))
        lengths = np.diff(places)
        keep = lengths > _NO_LENGTH
        middle = 0.5 * (places[1:] + places[:-1])[keep]
        part = first + middle[:, None] * along[p]
        found.append((np.full(middle.size, p), part, lengths[keep] / lengths[keep].sum()))
    segment, middles, shares = (np.concatenate(parts) for parts in zip(*found))
    order = np.argsort(segment, kind="stable")
    return segment[order], middles[order], shares[order]
