"""A contact on an activation: which corners may touch, their forces and tangent, what they keep."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm.assembly.stencilsums import Entries
from dolfinmpm.assembly.term import NewState
from dolfinmpm.contact.candidates import candidates
from dolfinmpm.contact.corners import ALL, Rows, Sight, Sites, Which
from dolfinmpm.contact.declared import DeclaredContact
from dolfinmpm.contact.entries import add_corners
from dolfinmpm.contact.means import Means, mean_forces
from dolfinmpm.contact.penalty import FREE, SLIPS, forces_on_corners, lessened
from dolfinmpm.contact.placestate import ContactPlaces, PlaceForces, PlaceStart
from dolfinmpm.contact.surfaces import Probe
from dolfinmpm.contact.unseen import missed, passed
from dolfinmpm.cut.participants import Participants

__all__ = ["ActiveContact"]

Array = npt.NDArray[np.float64]
Chosen = npt.NDArray[np.bool_]

# Ways of corners, by where they are, that are none
_ROUNDING = 1e-12


class ActiveContact(ContactPlaces):
    """A contact where the points and the body are at the start of a step. Collective.

    Args:
        contact: The contact.
        sight: How the points see the displacement.
        field: Number of its field.
        among: The points that are looked at, increasing, where others are known to be far away.
        distance: How near to the body corners are that can touch in this step (m).
        means: How mean forces over a step enter its balance; None for forces at its end.

    Attributes:
        contact, field, means: The arguments.
        clings: Whether corners that touched before are held where nothing has moved yet, so that
            the first iteration of Newton's method takes them along with a body that goes away.
        corners: Corners that may touch in this step.
        x: Where they were moved to last (m), shape (m, gdim).
        start: What they have at the start of the step.
        found: Forces on them there.
    """

    pushes = True

    def __init__(
        self, contact: DeclaredContact, sight: Sight, field: int = 0, among: Rows | None = None,
        distance: float = math.inf, means: Means | None = None,
    ):  # fmt: skip
        self.contact, self.clings, self.field = contact, False, field
        self.means = means
        self.sites = Sites(contact.points, sight, contact.surface, contact.material)
        self.among = candidates(contact, self.sites, among, distance)
        self.corners = c = self.sites.corners(self.among, lambda x: self._kept(x, distance))
        self.x: Array = c.x.copy()
        self.found = PlaceForces.nothing(*c.x.shape)
        self.start = self._at_start(sight.growth is not None)
        self._explicit = means is None and sight.growth is not None

    def _at_start(self, in_time: bool) -> PlaceStart:
        """What corners have at the start of the step."""
        contact, points, c = self.contact, self.contact.points, self.corners
        traction, pressure, _, stiffness, closing = contact.names
        pressed = points[pressure][c.rows, c.which]
        areas = self.sites.areas(c, contact.body.start.directions(self._probe[1]))
        k = contact.stiffness_at(c.rows) * areas
        if in_time:
            # while a corner touches its stiffness does not change with the normal: what is
            # stored would, and the energy with it
            kept = points[stiffness][c.rows, c.which]
            k = np.where((pressed > 0.0) & (kept > 0.0), kept, k)
        multiplier = np.zeros(len(c.x)) if contact.penetration is None else pressed
        return PlaceStart(
            self._probe[0], points[traction][c.rows, c.which], pressed, k, multiplier, areas,
            points[closing][c.rows, c.which],
        )  # fmt: skip

    def _kept(self, x: Array, distance: float) -> Which:
        """Which corners are so near to the body where it is (m); what it is like there."""
        body = self.contact.body
        self.place = body.start.back(x)
        self._probe = body.surface.probe(self.place)
        if math.isinf(distance):
            return ALL
        kept = np.flatnonzero(self._probe[0] <= distance)
        self.place = self.place[kept]
        gap, normal, curvature = self._probe
        self._probe = gap[kept], normal[kept], curvature[kept]
        return kept

    @staticmethod
    def on(contact: DeclaredContact, here: Participants) -> ActiveContact:
        """A contact on what is active in a step. Collective."""
        fields = here.fields
        k = next(k for k, f in enumerate(fields) if f.space.increment is contact.u)
        sight = Sight.of(fields[k], here.total, len(contact.points), contact.in_time)
        return ActiveContact(contact, sight, k, means=contact.means)

    def fault(self, new: NewState) -> str | None:
        """See `ActiveTerm`: points that passed the body, or got into it unseen. Collective."""
        if not new.moves:
            return None
        points = self.contact.points
        # all ranks have the same answer
        if missed(self, new.fields["x"], points["x"]):
            return "material points got into a rigid body from further away than was looked at"
        found = points.comm.allgather(passed(self))
        return next((reason for reason in found if reason is not None), None)

    # -- forces ---------------------------------------------------------------

    def touch(self, u: Sequence[Array], scale: float) -> None:
        """See `ActiveTerm`. Mean forces over a step are those of the increments at its end."""
        if not len(self.x):
            return
        own = u[self.field]
        if self.means is not None and self.means.scale != scale:
            own = self.means.scale / scale * own
        self.shift(self.corners.displacement(own), self.clings and not own.any())

    def shift(self, way: Array, clings: bool = False) -> None:
        """Find the forces on corners that have moved, with the body where it has been put.

        Args:
            way: How far since the start of the step (m), shape (m, gdim).
            clings: Whether corners that touched before are held.
        """
        pose = self.contact.body.pose
        self.x = self.corners.x + way
        at = pose.back(self.x)
        holds = self.start.pressure > 0.0
        if not clings:
            holds[:] = False
        # a corner comes no nearer than it goes
        self.found.way = np.linalg.norm(at - self.place, axis=1)
        far = self.start.gap > self.found.way
        c = np.flatnonzero(~far | holds | (self.start.multiplier > 0.0))
        probe = self.contact.body.surface.probe(at[c])
        # at the start of a step what counts is how gaps have closed in the last one
        moved = self.found.way > _ROUNDING * np.abs(at).max(initial=0.0)
        self._find(
            c,
            at,
            probe,
            holds,
            self.start.gap[c] - probe[0] if moved.any() else self.start.closing[c],
        )

    def rest(self) -> None:
        """Find the forces where corners and body are at the start of the step."""
        self.x = self.corners.x
        c = np.flatnonzero((self.start.gap <= 0.0) | (self.start.multiplier > 0.0))
        gap, normal, curvature = self._probe
        probe = gap[c], normal[c], curvature[c]
        self._find(c, self.place, probe, np.zeros(len(self.x), bool), self.start.closing[c])

    def _find(self, c: Rows, at: Array, probe: Probe, holds: Chosen, closing: Array) -> None:
        """Find the forces on some corners; on the others are none.

        Args:
            c: The corners.
            at: Where all are in the frame of the body (m), shape (m, gdim).
            probe: What the surface is like where they are.
            holds: Which of all are held even where they are outside, shape (m,).
            closing: By how much their gaps have closed in a step (m), shape (c,).
        """
        self.found.clear()
        if self.means is not None:
            self._find_means(c, at, probe)
            return
        if not c.size:
            return
        contact, k = self.contact, self.start.stiffness[c]
        found = [np.empty((c.size, *own.shape[1:])) for own in self.found.by_law]
        state = np.empty(c.size, np.int8)
        forces_on_corners(
            *probe, at[c], self.place[c], self.start.traction[c], self.start.multiplier[c], k,
            contact.slip_share * k, contact.friction, holds[c], *found, state,
        )  # fmt: skip
        for own, values in zip(self.found.by_law, found):
            own[c] = values
        self.found.gap[c], self.states[c] = probe[0], state
        if self._explicit:
            found[0] -= lessened(probe[0], closing, found[2])[:, None] * probe[1]
            self.found.closed[c] = closing
        self.forces[c] = contact.body.pose.directions(found[0])

    def _find_means(self, c: Rows, at: Array, probe: Probe) -> None:
        """Find mean forces over the step; see `_find`."""
        rubbed = np.any(self.start.traction != 0.0, axis=1)
        if rubbed.any():
            c = np.union1d(c, np.flatnonzero(rubbed))
            probe = self.contact.body.surface.probe(at[c])
        self.found.loss[:] = 0.0
        if not c.size:
            return
        body, k, friction = self.contact.body, self.start.stiffness[c], self.contact.friction
        way = at[c] - self.place[c]
        middle = body.surface.probe(self.place[c] + 0.5 * way)[1:]
        found = [np.empty((c.size, *own.shape[1:])) for own in self.found.by_law]
        loss, state = np.empty(c.size), np.empty(c.size, np.int8)
        start = self.start
        mean_forces(
            start.gap[c], *probe[:2], *middle, way, start.traction[c], start.multiplier[c], k,
            self.contact.slip_share * k, friction, *found, loss, state,
        )  # fmt: skip
        for own, values in zip(self.found.by_law, found):
            own[c] = values
        self.found.gap[c], self.states[c], self.found.loss[c] = probe[0], state, loss
        # by the directions in the middle of the body's turn
        Q = 0.5 * (body.start.rotation + body.pose.rotation)
        U, _, Vt = np.linalg.svd(Q)
        self._turned = U @ Vt
        self.forces[c] = found[0] @ self._turned.T

    def internal(self, out: Sequence[Array]) -> bool:
        """See `ActiveTerm`: forces as they were last found, which resist, −f (N)."""
        if self.states.any():
            self.corners.add(-self._weight * self.forces, out[self.field])
        return True

    def add_forces(self, out: Array) -> None:
        """Add the nodal forces (N)."""
        if self.states.any():
            self.corners.add(self.forces, out)

    @property
    def _weight(self) -> float:
        """Weight of the forces in a step's balance."""
        return 1.0 if self.means is None else self.means.weight

    @property
    def slope_weight(self) -> float:
        """Weight of derivatives of forces by the increments in a step's balance."""
        return 1.0 if self.means is None else self.means.weight * self.means.scale

    def lever(self) -> Array:
        """From the body's centre to the corners (m), where forces act in the step."""
        body = self.contact.body
        if self.means is None:
            return np.asarray(self.x - body.pose.centre)
        middle = 0.5 * (self.corners.x + self.x)
        return np.asarray(middle - 0.5 * (body.start.centre + body.pose.centre))

    def tangent(self, entries: Mapping[tuple[int, int], Entries]) -> None:
        """See `ActiveTerm`."""
        active = np.flatnonzero(self.states != FREE)
        if active.size == 0:
            return
        seen, to = self.corners.entries(), entries[self.field, self.field]
        add_corners(active, seen, seen, -self.slope_weight * self.world_slope(active), to)

    # -- multipliers and what is kept -----------------------------------------

    def totals(self) -> tuple[Array, Array]:
        """Force and moment of the points on the body (N, N m), on all ranks. Collective.

        Of axisymmetric bodies they are those all around.
        """
        moment = _cross(self.lever(), self.forces)
        both = np.concatenate([self.forces.sum(axis=0), moment.sum(axis=0)])
        both = -self.contact.points.comm.allreduce(both, op=MPI.SUM)
        d = self.forces.shape[1]
        if self.contact.points.axisymmetric:
            # what acts all around has a resultant along the axis alone
            both[[0, d]] = 0.0
        return both[:d], both[d:]

    def world_slope(self, active) -> Array:
        """Derivative of the forces by the corners' positions (N/m), shape (n, gdim, gdim)."""
        Q = self.contact.body.pose.rotation
        if self.means is not None:
            P = self._turned
            return np.einsum("ij,cjk,lk->cil", P, self.found.slope[active], Q)
        return np.einsum("ij,cjk,lk->cil", Q, self.found.slope[active], Q)

    def update(self, new: NewState) -> None:
        """See `ActiveTerm`."""
        points, c = self.contact.points, self.corners
        for name, values in self.kept():
            new.fields[name] = np.zeros_like(points[name])
            new.fields[name][c.rows, c.which] = values

    def kept(self) -> list[tuple[str, Array]]:
        """What corners keep of it at the end of the step, by the name of the points' field."""
        traction, pressure, _, stiffness, closing = self.contact.names
        held = np.where(self.pressures > 0.0, self.start.stiffness, 0.0)
        return [
            (traction, self.found.traction),
            (pressure, self.pressures),
            (stiffness, held),
            (closing, self.found.closed),
        ]

    def stored(self, before: bool = False) -> float:
        """Energy that the penalties have stored (J), on all ranks. Collective.

        Args:
            before: Whether at the end of the last step.
        """
        k = np.where(self.start.stiffness > 0.0, self.start.stiffness, np.inf)
        p = self.start.pressure if before else self.pressures
        own = 0.5 * float(np.sum(p**2 / k))
        if self.contact.friction:
            t = self.start.traction if before else self.found.traction
            own += 0.5 * float(np.sum(np.sum(t * t, axis=1) / (self.contact.slip_share * k)))
        return self.contact.points.comm.allreduce(own, op=MPI.SUM)

    def dissipated(self) -> float:
        """Work that friction takes in this step (J), on all ranks. Collective."""
        slips = self.states == SLIPS
        done = float(self.found.loss.sum())
        if slips.any() and self.means is None:
            t, size = self.found.traction[slips], np.linalg.norm(self.found.traction[slips], axis=1)
            eT = self.contact.slip_share * self.start.stiffness[slips]
            at = self.contact.body.pose.back(self.x[slips])
            n = self.contact.body.surface.probe(at)[1]
            w = self.start.traction[slips] - eT[:, None] * (at - self.place[slips])
            trial = w - np.sum(w * n, axis=1)[:, None] * n
            done = (
                float(np.sum(size * (np.linalg.norm(trial, axis=1) - size) / eT)) if t.size else 0.0
            )
        return self.contact.points.comm.allreduce(done, op=MPI.SUM)


def _cross(a: Array, b: Array) -> Array:
    """Moments of forces b at arms a, shape (n, 1) in 2D, (n, 3) in 3D."""
    if a.shape[1] == 3:
        return np.asarray(np.cross(a, b), float)
    return (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])[:, None]
