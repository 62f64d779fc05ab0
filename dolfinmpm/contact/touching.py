"""Contact of two bodies on an activation: which places face each other, forces and tangent."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt
import scipy
from mpi4py import MPI

from dolfinmpm._platform.errors import ParameterError, raise_together
from dolfinmpm.assembly.stencilsums import Entries
from dolfinmpm.assembly.term import NewState
from dolfinmpm.basis import LatticeBasis
from dolfinmpm.contact.corners import stencil_matrix
from dolfinmpm.contact.cutpieces import pieces_in_cells
from dolfinmpm.contact.declared import DeclaredBetween
from dolfinmpm.contact.entries import add_corners
from dolfinmpm.contact.means import Means, mean_forces
from dolfinmpm.contact.penalty import FREE, SLIPS, forces_on_corners
from dolfinmpm.contact.placestate import ContactPlaces, PlaceForces, PlaceStart
from dolfinmpm.contact.sides import side_of
from dolfinmpm.contact.starts import RUBBED, held_back, stored_by
from dolfinmpm.cut.participants import ActiveField, Participants
from dolfinmpm.cut.unknowns import Unknowns
from dolfinmpm.grid.lattice import lattice_of, smallest_height

__all__ = ["LAYERS", "ActiveBetween", "Facing"]

Array = npt.NDArray[np.float64]
Rows = npt.NDArray[np.integer]

# Pieces of the other boundary that a marker looks at, and how much their normals must be opposed
_NEAREST, _OPPOSED = 8, -0.2
# How far a piece reaches from its marker along the surface, by its length, or root of its area: so
# that pieces of Gauss points and of triangles leave no room between them
_LENGTH, _WIDTH = 0.65, 1.0
# Layers of cells in which the other body may be
LAYERS = 2
# Gap or overlap of bodies, by the size of a cell, that is taken for rounding
_TOUCHES = 1e-6


class Facing:
    """Places of two bodies that face each other at the start of a step. Collective.

    Args:
        contact: The contact.
        here: What is active.

    Attributes:
        contact: The contact.
        rows: Markers of the first boundary whose places face the other one, shape (m,): of
            boundaries that tile each has as many as there are cells that its segment is in.
        shares: Share of its marker's area that each place has, likewise.
        gap: Gaps g (m), shape (m,).
        normal: Normals out of the second body, shape (m, d).
        areas: Areas (m^(d-1)), shape (m,).
        sides: How the first and the second body move them.
        reach: Gap up to which places are looked at (m).

    Raises:
        ParameterError: The bodies overlap before the first step.
    """

    def __init__(self, contact: DeclaredBetween, here: Participants):
        self.contact = contact
        first, second = (b.markers for b in contact.boundaries)
        self.reach = smallest_height(contact.points.grid)
        own = [
            next(k for k, f in enumerate(here.fields) if f.space.increment is u) for u in contact.u
        ]
        begun = contact.begun
        if not begun:
            contact.check_sides()
        x, area = first["x"], first["area"]
        X, A = (np.concatenate(first.comm.allgather(second[name])) for name in ("x", "area"))
        which, gap, normal = self._pieces(x, area, X, A)
        rows = np.flatnonzero(which >= 0)
        lattice = lattice_of(contact.points.grid)
        assert lattice is not None
        of: Rows = np.arange(rows.size)
        at: Array = x[rows]
        self.shares: Array = np.ones(rows.size)
        if contact.boundaries[0].tiles:
            of, at, self.shares = pieces_in_cells(at, area[rows], lattice)
        self.rows = rows = rows[of]
        self.gap, self.normal = gap[rows], normal[rows]
        self.areas = self.shares * np.linalg.norm(area[rows], axis=1)
        raise_together(first.comm, None if begun else self._overlap(x))
        opposite = at - self.gap[:, None] * self.normal
        self.sides = (
            side_of(own[0], _seen(here.fields[own[0]], at, x[rows])),
            side_of(own[1], _seen(here.fields[own[1]], opposite, X[which[rows]])),
        )

    def _pieces(self, x: Array, area: Array, X: Array, A: Array):
        """The piece that each marker faces, -1 for none, the gap there (m) and the normal.

        Args:
            x, area: Positions (m) and area vectors of markers, shape (n, d).
            X, A: Those of the pieces, shape (m, d).
        """
        n, d = x.shape
        which = np.full(n, -1, np.int64)
        if not n:
            return which, np.empty(0), np.empty((0, d))
        sizes = np.linalg.norm(A, axis=1)
        half = _LENGTH * sizes if d == 2 else _WIDTH * np.sqrt(sizes)
        count = min(_NEAREST, len(X))
        distance, near = scipy.spatial.cKDTree(X).query(
            x, count, distance_upper_bound=float(np.hypot(self.reach, half.max()))
        )
        there = np.isfinite(distance.reshape(n, count))
        near = np.where(there, near.reshape(n, count), 0)
        own = area / np.linalg.norm(area, axis=1)[:, None]
        others = (A / sizes[:, None])[near]
        opposed = there & (np.einsum("pi,pci->pc", own, others) < _OPPOSED)
        normal = others - own[:, None]
        normal /= np.maximum(np.linalg.norm(normal, axis=2), 1e-300)[:, :, None]
        apart = x[:, None] - X[near]
        gap = np.einsum("pci,pci->pc", apart, normal)
        along = np.linalg.norm(apart - gap[:, :, None] * normal, axis=2)
        faces = opposed & (along <= half[near]) & (np.abs(gap) < self.reach)
        # of several pieces that in the middle of which it is most
        best = np.argmin(np.where(faces, along / half[near], np.inf), axis=1)
        every = np.arange(n)
        found = faces[every, best]
        which[found] = near[every, best][found]
        return which, gap[every, best], normal[every, best]

    def _overlap(self, x: Array) -> ParameterError | None:
        """What is wrong with bodies that overlap, or None."""
        deep = self.gap < -_TOUCHES * self.reach
        if not deep.any():
            return None
        p = int(np.argmin(self.gap))
        return ParameterError(
            f"the bodies of {self.contact!r} overlap before the first step: "
            f"{np.count_nonzero(deep)} markers are inside the other body, that at "
            f"{x[self.rows[p]]} m by {-self.gap[p]:.4g} m: put the bodies beside each other"
        )

    def lists(self, unknowns: Unknowns) -> tuple[npt.NDArray, npt.NDArray]:
        """Lists of nodes that it couples, numbered with their fields' offsets."""
        parts = [
            scipy.sparse.csr_matrix(
                (side.N.data, side.nodes[side.N.indices], side.N.indptr),
                shape=(len(self.rows), unknowns.fields[side.field].numbering.size),
            )
            for side in self.sides
        ]
        lists = [
            np.concatenate(
                [
                    part.indices[part.indptr[c] : part.indptr[c + 1]]
                    + unknowns.fields[side.field].offset
                    for part, side in zip(parts, self.sides)
                ]
            )
            for c in range(len(self.rows))
        ]
        start = np.zeros(len(lists) + 1, np.int64)
        np.cumsum([len(one) for one in lists], out=start[1:])
        return start, np.concatenate([np.empty(0, np.int32), *lists]).astype(np.int32)


def _seen(field: ActiveField, x: Array, beside: Array) -> scipy.sparse.csr_matrix:
    """What places on a boundary see of a field, behind its ties. Collective at first.

    A place in a cell that is not active, barely beyond the body, sees the functions of the cell
    of the marker beside it, as they go on.

    Args:
        field: The field.
        x: Places (m), shape (n, d).
        beside: Markers of the boundary beside them (m), likewise.
    """
    basis = field.basis
    assert isinstance(basis, LatticeBasis)
    active, table = field.cells, basis.halo.cell_table
    low = basis.lattice.cells_at(x) - basis.halo.origin
    inside = np.all((low >= 0) & (low < table.shape), axis=1)
    at = np.where(inside, table[tuple(np.where(inside[:, None], low, 0).T)], -1)
    known = (at >= 0) & active[at]
    low[~known] = (basis.lattice.cells_at(beside) - basis.halo.origin)[~known]
    s = basis.stencils_in(x, np.zeros_like(x), np.ascontiguousarray(low, np.int32),
                          np.ones(low.shape, np.int32))  # fmt: skip
    # overlap of ranks is as wide as a cell and what is beside it
    assert s is not None
    N = stencil_matrix(s, s.N, (len(x), basis.nodes.size))
    return N if field.C is None else scipy.sparse.csr_matrix(N @ field.C)


class ActiveBetween(ContactPlaces):
    """Forces of two bodies on each other under nodal increments, and what is kept of them.

    Args:
        facing: The places that face each other.
        means: How mean forces over a step enter its balance; None for forces at its end.

    Attributes:
        contact: The contact.
        facing: The first argument.
        clings: See `ActiveContact`.
        start: What the places have at the start of the step.
        found: Forces on the first body there.
    """

    def __init__(self, facing: Facing, means: Means | None = None):
        self.contact, self.facing, self.clings = facing.contact, facing, False
        self._means = means
        contact, rows = facing.contact, facing.rows
        m, d = facing.normal.shape
        self.found, self._slip = PlaceForces.nothing(m, d), np.zeros((m, d))
        markers = contact.boundaries[0].markers
        traction, pressure, *_ = contact.names
        pressed = facing.shares * markers[pressure][rows]
        # bodies that touch without pressing hold each other too as long as nothing moves
        self._touch = (pressed > 0.0) | (facing.gap < _TOUCHES * facing.reach)
        multiplier = np.zeros(m) if contact.penetration is None else pressed
        self.start = PlaceStart(
            facing.gap, facing.shares[:, None] * markers[traction][rows], pressed,
            contact.stiffness * facing.areas, multiplier, facing.areas, np.zeros(m),
        )  # fmt: skip
        if means is not None and contact.penetration is None:
            start = self.start
            q = -start.stiffness * facing.gap
            along = self._stored(np.zeros(m), start.traction)
            kept, spare = (float(markers[name].sum()) for name in contact.names[4:6])
            comm, stored = contact.points.comm, self._stored(q, np.zeros((m, d)))
            start.multiplier = held_back(q, stored, along, kept, spare, comm)

    def touch(self, u: Sequence[Array], scale: float) -> None:
        """See `ActiveTerm`. Mean forces over a step are those of the increments at its end."""
        contact, facing = self.contact, self.facing
        if self._means is not None and self._means.scale != scale:
            u = [self._means.scale / scale * values for values in u]
        if not len(facing.rows):
            return
        start, found = self.start, self.found
        one, other = facing.sides
        moved = one.displacement(u), other.displacement(u)
        self._slip = slip = moved[0] - moved[1]
        n = facing.normal
        self.found.gap = facing.gap + np.einsum("ci,ci->c", slip, n)
        at_rest = not (moved[0].any() or moved[1].any())
        if self._means is not None:
            flat = np.zeros((*n.shape, n.shape[1]))
            mean_forces(
                facing.gap, found.gap, n, n, flat, slip, start.traction, start.multiplier,
                start.stiffness, contact.slip_share * start.stiffness, contact.friction,
                *found.by_law, found.loss, found.states,
            )  # fmt: skip
            return
        holds = self._touch & (self.clings and at_rest)
        flat = np.zeros((*n.shape, n.shape[1]))
        forces_on_corners(
            found.gap, n, flat, slip, np.zeros_like(slip), start.traction, start.multiplier,
            start.stiffness, contact.slip_share * start.stiffness, contact.friction, holds,
            *found.by_law, found.states,
        )  # fmt: skip
        if contact.friction and holds.any():
            # what is about to be pressed will stick
            sticks = np.flatnonzero(holds & (self.pressures <= 0.0))
            along = np.eye(n.shape[1]) - n[sticks, :, None] * n[sticks, None, :]
            slip_stiffness = contact.slip_share * self.start.stiffness[sticks]
            self.found.slope[sticks] -= slip_stiffness[:, None, None] * along

    def internal(self, out: Sequence[Array]) -> bool:
        """See `ActiveTerm`: forces as they were last found, which resist (N)."""
        if self.states.any():
            one, other = self.facing.sides
            weight = 1.0 if self._means is None else self._means.weight
            one.add(-weight * self.forces, out)
            other.add(weight * self.forces, out)
        return True

    def tangent(self, entries: Mapping[tuple[int, int], Entries]) -> None:
        """See `ActiveTerm`."""
        active = np.flatnonzero(self.states != FREE)
        if not active.size:
            return
        K = -self.found.slope[active]
        if self._means is not None:
            K *= self._means.weight * self._means.scale
        for a in self.facing.sides:
            for b in self.facing.sides:
                to = entries[a.field, b.field]
                add_corners(active, a.entries(), b.entries(), K if a is b else -K, to)

    def fault(self, new: NewState) -> str | None:
        """See `ActiveTerm`: places that may have met without being looked at. Collective."""
        sides = [new.moved[boundary.markers.number] for boundary in self.contact.boundaries]
        comm, d = self.contact.points.comm, self.contact.points.gdim
        ends = [-part.min(axis=0, initial=np.inf) for part in sides]
        ends += [part.max(axis=0, initial=-np.inf) for part in sides]
        found = np.array(ends).reshape(4, d)
        comm.Allreduce(MPI.IN_PLACE, found, op=MPI.MAX)
        way = float(np.linalg.norm(np.maximum(found[2] + found[1], found[3] + found[0])))
        if way <= self.facing.reach:
            return None
        return (
            f"the bodies of {self.contact!r} move {way:.3g} m past each other at once, more than a "
            f"cell ({self.facing.reach:.3g} m)"
        )

    def record(self) -> dict[str, dict[str, list[float]]]:
        """See `ActiveTerm`. Collective."""
        return {self.contact.name: {"force": [float(f) for f in self.total()]}}

    def total(self) -> Array:
        """Force on the first body (N), shape (d,), on all ranks. Collective."""
        return self.contact.points.comm.allreduce(self.forces.sum(axis=0), op=MPI.SUM)

    def follow(self, new: NewState, step: int) -> None:
        """Add what the markers of the first boundary keep of it at the end of the step."""
        new.of(self.contact.boundaries[0].markers).update(self._kept())

    def _kept(self) -> dict[str, Array]:
        """What the markers of the first boundary keep of it at the end of the step."""
        markers, rows = self.contact.boundaries[0].markers, self.facing.rows
        traction, pressure, work, steps, stored, spare = self.contact.names
        new: dict[str, Array] = {name: np.zeros_like(markers[name]) for name in self.contact.names}
        new[work][:] = markers[work]
        done = self._dissipated()
        parts = (
            self.found.traction,
            self.pressures,
            done,
            self._stored(self.pressures, self.found.traction),
        )
        for name, values in zip((traction, pressure, work, stored), parts):
            np.add.at(new[name], rows, values)
        new[steps][:] = markers[steps] + 1.0
        if self._means is not None and self.contact.penetration is None:
            q = self.start.multiplier - self.start.stiffness * self.facing.gap
            new[spare][:] = markers[spare] + markers[stored]
            np.add.at(new[spare], rows, RUBBED * done - self._stored(q, self.start.traction))
        return new

    def _stored(self, pressures: Array, t: Array) -> Array:
        """What the penalties store at each place (J), shape (m,), under some forces (N)."""
        slip = self.contact.slip_share if self.contact.friction else 0.0
        return stored_by(pressures, t, self.start.stiffness, slip)

    def _dissipated(self) -> Array:
        """Work that friction takes at each place in this step (J), shape (m,)."""
        if self._means is not None:
            return self.found.loss
        done = np.zeros(len(self.states))
        slips = self.states == SLIPS
        if slips.any():
            t, n = self.found.traction[slips], self.facing.normal[slips]
            stiffness = self.contact.slip_share * self.start.stiffness[slips]
            w = self.start.traction[slips] - stiffness[:, None] * self._slip[slips]
            trial = np.linalg.norm(w - np.sum(w * n, axis=1)[:, None] * n, axis=1)
            size = np.linalg.norm(t, axis=1)
            done[slips] = size * (trial - size) / stiffness
        return done
