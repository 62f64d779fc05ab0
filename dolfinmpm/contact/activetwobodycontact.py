"""Contact of two bodies on an activation: forces, tangent, and the state of the markers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm.assembly.stencilsums import Entries
from dolfinmpm.assembly.term import NewState
from dolfinmpm.contact.contactlaw import FREE, SLIPS, contact_forces, slip_work
from dolfinmpm.contact.contactpairs import TOUCHES, ContactPairs
from dolfinmpm.contact.contactpoints import ActiveContact, ContactForces, ContactStart
from dolfinmpm.contact.contactstencils import add_tangent
from dolfinmpm.contact.meanforces import (
    SPARE_SHARE,
    MeanForceWeights,
    bounding_multipliers,
    mean_forces,
    normal_energy,
    slip_energy,
)

__all__ = ["ActiveTwoBodyContact"]

Array = npt.NDArray[np.float64]


class ActiveTwoBodyContact(ActiveContact):
    """Forces of two bodies on each other under nodal increments.

    Args:
        pairs: Pairs of facing contact points.
        mean_weights: Weights of mean forces over a step in its balance; None for forces at its end.

    Attributes:
        contact: The contact.
        pairs, mean_weights: The arguments.
        clings: See `ActiveRigidContact`.
        start: State of the pairs at the start of the step.
        now: Forces on the first body at the pairs.
    """

    def __init__(self, pairs: ContactPairs, mean_weights: MeanForceWeights | None = None):
        self.contact, self.pairs, self.clings = pairs.contact, pairs, False
        self.mean_weights = mean_weights
        contact, rows = pairs.contact, pairs.rows
        m, d = pairs.normal.shape
        self.now, self._slip = ContactForces.zero(m, d), np.zeros((m, d))
        markers, names = contact.boundaries[0].markers, contact.names
        normal_force = pairs.shares * markers[names.normal_force][rows]
        # bodies that touch without pressing hold each other too as long as nothing moves
        self._touch = (normal_force > 0.0) | (pairs.gap < TOUCHES * pairs.reach)
        no_bound = contact.law.penetration is None
        self.start = start = ContactStart(
            pairs.gap, pairs.shares[:, None] * markers[names.tangential_force][rows],
            normal_force, pairs.stiffness * pairs.areas,
            np.zeros(m) if no_bound else normal_force, np.zeros(m),
            contact.law.largest_slip_forces(pairs.areas), np.zeros(m),
        )  # fmt: skip
        if mean_weights is not None and no_bound:
            q, none = -start.stiffness * pairs.gap, np.zeros(m)
            normal = float(self._stored(q, np.zeros((m, d))).sum())
            tangential = float(self._stored(none, start.tangential).sum())
            available = float(markers[names.stored].sum()) + float(markers[names.spare].sum())
            comm = contact.points.comm
            start.multiplier = bounding_multipliers(q, normal, tangential, available, comm)

    def touch(self, u: Sequence[Array], scale: float) -> None:
        """See `ActiveContact`. Mean forces over a step are those of the increments at its end."""
        pairs, start, now, law = self.pairs, self.start, self.now, self.contact.law
        if self.mean_weights is not None and self.mean_weights.scale != scale:
            u = [self.mean_weights.scale / scale * values for values in u]
        if not len(pairs.rows):
            return
        first, second = (side.stencils.displacement(u[side.field]) for side in pairs.sides)
        self._slip = slip = first - second
        n = pairs.normal
        now.gap = pairs.gap + np.einsum("ci,ci->c", slip, n)
        flat = np.zeros((*n.shape, n.shape[1]))
        slip_stiffness = law.slip_share * start.stiffness
        if self.mean_weights is not None:
            mean_forces(
                pairs.gap, now.gap, n, n, flat, slip, start.tangential, start.multiplier,
                start.stiffness, slip_stiffness, law.friction, start.limit, start.water,
                *now.by_law, now.loss, now.states,
            )  # fmt: skip
            return
        at_rest = not (first.any() or second.any())
        holds = self._touch & (self.clings and at_rest)
        contact_forces(
            now.gap, n, flat, slip, np.zeros_like(slip), start.tangential, start.multiplier,
            start.stiffness, slip_stiffness, law.friction, start.limit, start.water, holds,
            *now.by_law, now.states,
        )  # fmt: skip
        if law.friction and holds.any():
            # points that are about to be pressed will stick
            sticks = np.flatnonzero(holds & (now.normal <= 0.0))
            along = np.eye(n.shape[1]) - n[sticks, :, None] * n[sticks, None, :]
            now.derivative[sticks] -= slip_stiffness[sticks][:, None, None] * along

    def internal(self, out: Sequence[Array]) -> bool:
        """See `ActiveTerm`: last computed forces, which resist (N)."""
        if self.states.any():
            for side, sign in zip(self.pairs.sides, (-1.0, 1.0)):
                side.stencils.add(sign * self.force_weight * self.forces, out[side.field])
        return True

    def tangent(self, entries: Mapping[tuple[int, int], Entries]) -> None:
        """See `ActiveTerm`."""
        active = np.flatnonzero(self.states != FREE)
        if not active.size:
            return
        K = -self.now.derivative[active]
        if self.mean_weights is not None:
            K *= self.tangent_weight
        rows = [side.stencils.rows() for side in self.pairs.sides]
        for i, a in enumerate(self.pairs.sides):
            for j, b in enumerate(self.pairs.sides):
                to = entries[a.field, b.field]
                add_tangent(active, rows[i], rows[j], K if i == j else -K, to)

    def fault(self, new: NewState) -> str | None:
        """See `ActiveContact`: the bodies may have met at points without a pair. Collective."""
        sides = [new.moved[boundary.markers.number] for boundary in self.contact.boundaries]
        comm, d = self.contact.points.comm, self.contact.points.gdim
        ends = [-part.min(axis=0, initial=np.inf) for part in sides]
        ends += [part.max(axis=0, initial=-np.inf) for part in sides]
        found = np.array(ends).reshape(4, d)
        comm.Allreduce(MPI.IN_PLACE, found, op=MPI.MAX)
        path = float(np.linalg.norm(np.maximum(found[2] + found[1], found[3] + found[0])))
        if path <= self.pairs.reach:
            return None
        return (
            f"the bodies of {self.contact!r} move {path:.3g} m past each other at once, more than "
            f"a cell ({self.pairs.reach:.3g} m)"
        )

    def record(self) -> dict[str, dict[str, list[float]]]:
        """See `ActiveContact`. Collective."""
        return {self.contact.name: {"force": [float(f) for f in self.total()]}}

    def total(self) -> Array:
        """Force on the first body (N), shape (d,), on all ranks. Collective."""
        return self.contact.points.comm.allreduce(self.forces.sum(axis=0), op=MPI.SUM)

    def follow(self, new: NewState, step: int) -> None:
        """Add the contact state of the first boundary's markers at the end of the step."""
        markers, names, now = self.contact.boundaries[0].markers, self.contact.names, self.now
        rows = self.pairs.rows
        end: dict[str, Array] = {name: np.zeros_like(markers[name]) for name in names}
        end[names.work][:] = markers[names.work]
        end[names.steps][:] = markers[names.steps] + 1.0
        done = self._dissipated()
        np.add.at(end[names.tangential_force], rows, now.tangential)
        np.add.at(end[names.normal_force], rows, now.normal)
        np.add.at(end[names.work], rows, done)
        np.add.at(end[names.force], rows, self.forces)
        np.add.at(end[names.stored], rows, self._stored(now.normal, now.tangential))
        if self.mean_weights is not None and self.contact.law.penetration is None:
            q = self.start.multiplier - self.start.stiffness * self.pairs.gap
            end[names.spare][:] = markers[names.spare] + markers[names.stored]
            gained = SPARE_SHARE * done - self._stored(q, self.start.tangential)
            np.add.at(end[names.spare], rows, gained)
        new.of(markers).update(end)

    def _stored(self, normal_force: Array, tangential: Array) -> Array:
        """Energy that the penalties store at each pair (J), shape (m,), under given forces (N)."""
        stored = normal_energy(normal_force, self.start.stiffness)
        law = self.contact.law
        if law.friction:
            stored += slip_energy(tangential, self.start.stiffness, law.slip_share)
        return stored

    def _dissipated(self) -> Array:
        """Work dissipated by friction at each pair in this step (J), shape (m,)."""
        if self.mean_weights is not None:
            return self.now.loss
        done = np.zeros(len(self.states))
        slips = np.flatnonzero(self.states >= SLIPS)
        if slips.size:
            done[slips] = slip_work(
                self.now.tangential[slips], self.start.tangential[slips], self._slip[slips],
                self.pairs.normal[slips], self.contact.law.slip_share * self.start.stiffness[slips],
            )  # fmt: skip
        return done
