"""Contact with a rigid body on an activation: corners that may touch, forces, tangent, state."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm.assembly.stencilsums import Entries
from dolfinmpm.assembly.term import NewState
from dolfinmpm.contact.bodymotion import moments
from dolfinmpm.contact.contactlaw import FREE, SLIPS, slip_work
from dolfinmpm.contact.contactpairs import TOUCHES
from dolfinmpm.contact.contactpoints import ActiveContact, ContactForces, ContactStart
from dolfinmpm.contact.contactstencils import add_tangent
from dolfinmpm.contact.contactwarnings import warn_at_start
from dolfinmpm.contact.cornerforces import set_forces_at_end, set_mean_forces
from dolfinmpm.contact.corners import ALL, CornerLayout, Corners, Rows, Which
from dolfinmpm.contact.cornersatedges import normals_at_edges
from dolfinmpm.contact.displacementbasis import DisplacementBasis
from dolfinmpm.contact.followedgaps import FollowedGaps
from dolfinmpm.contact.heldcorners import HeldCorners, growth_of
from dolfinmpm.contact.meanforces import MeanForceWeights, normal_energy, slip_energy
from dolfinmpm.contact.sharedsurface import areas_at_end, areas_at_start, domains_at_start
from dolfinmpm.contact.surfaces import Probe
from dolfinmpm.contact.tunnelling import (
    candidates,
    passed_through,
    unlisted_entered,
)

if TYPE_CHECKING:
    from dolfinmpm.contact.rigidcontact import RigidContact

__all__ = ["ActiveRigidContact"]

Array = npt.NDArray[np.float64]
Chosen = npt.NDArray[np.bool_]

# Paths of corners below this share of their coordinates are rounding
_ROUNDING = 1e-12


class ActiveRigidContact(ActiveContact):
    """Contact with a rigid body, for the points and the body at the start of a step. Collective.

    Args:
        contact: The contact.
        displacement: The basis functions of the displacement.
        field: Number of the field of the displacement.
        listed: The points to search, increasing, if all other points are known to be far away.
        distance: Largest distance from the body of corners that can touch in this step (m).
        mean_weights: Weights of mean forces over a step in its balance; None for forces at its end.

    Attributes:
        contact, field, mean_weights: The arguments.
        clings: True holds corners that touched before, as long as nothing has moved. So the first
            iteration of Newton's method takes these corners along with a body that moves away.
        layout: Where the corners are.
        candidates: The points that may touch, increasing.
        corners: Corners that may touch in this step.
        x: Last computed positions of the corners (m), shape (m, gdim).
        local_start: Positions at the start of the step in the frame of the body (m), shape
            (m, gdim).
        start: State of the corners at the start of the step.
        now: Forces on the corners.
        held: Overlap of corners that a fixed side of the grid holds, or None.
        followed: Gaps that are followed from step to step, or None.
    """

    pushes = True
    held: HeldCorners | None = None
    followed: FollowedGaps | None = None
    corners: Corners

    def __init__(
        self, contact: RigidContact, displacement: DisplacementBasis, field: int = 0,
        listed: Rows | None = None, distance: float = math.inf,
        mean_weights: MeanForceWeights | None = None,
    ):  # fmt: skip
        self.contact, self.clings, self.field = contact, False, field
        self.mean_weights = mean_weights
        self.layout = CornerLayout(contact.points, displacement, contact.surface, contact.material)
        self.candidates = candidates(contact, self.layout, listed, distance)
        self.corners = c = self.layout.corners(
            self.candidates,
            lambda x: self._near_corners(x, distance),
            lambda x, inward: normals_at_edges(contact.body, self._probe, x, inward),
            self._on_faces,
        )
        self.x: Array = c.x.copy()
        self.now = ContactForces.zero(*c.x.shape)
        self.start = self._at_start()
        if contact.body.time == 0.0 and not contact.begun:
            warn_at_start(self)

    @property
    def explicit(self) -> bool:
        """Whether forces act at the start and at the end of a step in time, not in its mean."""
        return self.mean_weights is None and self.layout.in_time

    def _near_corners(self, x: Array, distance: float) -> Which:
        """Choose the corners near the body, and keep the surface's values at these corners.

        Args:
            x: Positions of corners (m), shape (n, gdim).
            distance: See the class.
        """
        body = self.contact.body
        self.local_start = body.start.back(x)
        self._probe = body.surface.probe(self.local_start)
        if math.isinf(distance):
            return ALL
        near = np.flatnonzero(self._probe[0] <= distance)
        self.local_start = self.local_start[near]
        gap, normal, curvature = self._probe
        self._probe = gap[near], normal[near], curvature[near]
        return near

    def _on_faces(self, rows: Rows, which: Rows, x: Array) -> Array | None:
        """Probe the surface at parts of faces, and tell how much they move with their domains.

        Args:
            rows, which: Points of the corners, and numbers of the corners there, shape (m,).
            x: Middles of the parts (m), shape (m, gdim).

        Returns:
            The shares of `FollowedGaps`, shape (m,), or None if gaps are not followed.
        """
        self._near_corners(x, math.inf)
        if not self.contact.follows:
            return None
        self.followed = FollowedGaps.of(self.contact, rows, which, self._probe[0])
        self._probe = self.followed.gaps(self._probe, ALL)
        return self.followed.share

    def _probed(self, c: Rows, at: Array) -> Probe:
        """Values of the surface at some corners, with their gaps.

        Args:
            c: The corners.
            at: Positions of all corners in the frame of the body (m), shape (m, gdim).
        """
        probe = self.contact.body.surface.probe(at[c])
        return probe if self.followed is None else self.followed.gaps(probe, c)

    def _at_start(self) -> ContactStart:
        """State of the corners at the start of the step."""
        contact, points, c = self.contact, self.contact.points, self.corners
        names, own = contact.names, (c.rows, c.which)
        normal_force = self.layout.carried(points[names.normal_force], c)
        normal = contact.body.start.directions(self._probe[1])
        areas = self.layout.areas(c, normal)
        slipping = areas_at_start(self, normal, self._probe[0]) if contact.shares_surface else areas
        k = contact.stiffness_at(c.rows) * areas
        if self.layout.in_time and not self.layout.gauss:
            # the stiffness of a touching corner must not change with the normal: the stored
            # energy would change too
            kept = points[names.stiffness][own]
            k = np.where((normal_force > 0.0) & (kept > 0.0), kept, k)
        no_bound = contact.law.penetration is None
        multiplier = np.zeros(len(c.x)) if no_bound else normal_force
        return ContactStart(
            self._probe[0], self.layout.carried(points[names.tangential_force], c), normal_force,
            k, multiplier, points[names.closing][own], contact.law.largest_slip_forces(slipping),
            contact.water_at(c.rows, c.x) * areas, domains_at_start(self),
        )  # fmt: skip

    def fault(self, new: NewState) -> str | None:
        """See `ActiveContact`: points that passed through the body or entered it. Collective."""
        if not new.moves:
            return None
        points = self.contact.points
        # all ranks have the same answer
        if unlisted_entered(self, new.fields["x"], points["x"]):
            return "material points got into a rigid body from further away than was looked at"
        found = points.comm.allgather(passed_through(self))
        return next((reason for reason in found if reason is not None), None)

    # -- forces ---------------------------------------------------------------

    def touch(self, u: Sequence[Array], scale: float) -> None:
        """See `ActiveContact`. Mean forces over a step are those of the increments at its end."""
        if not len(self.x):
            return
        own = u[self.field]
        if self.mean_weights is not None and self.mean_weights.scale != scale:
            own = self.mean_weights.scale / scale * own
        displacement = self.corners.stencils.displacement(own)
        self.compute(displacement, self.clings and not own.any())

    def compute(self, displacement: Array, clings: bool = False) -> None:
        """Compute the forces on moved corners, at the present pose of the body.

        Args:
            displacement: Displacements of the corners in the step (m), shape (m, gdim).
            clings: Whether corners that touched before cling to the body, and those that only meet
                it, so that the first iteration does not let the points fall through it.
        """
        pose = self.contact.body.pose
        self.x = self.corners.x + displacement
        at = pose.back(self.x)
        # a corner comes no nearer than the length of its path
        self.now.path = np.linalg.norm(at - self.local_start, axis=1)
        near = self.start.gap <= self.now.path
        clinging, meets = np.zeros((2, len(at)), bool)
        if clings:
            rounding = TOUCHES * self.layout.reach(self.corners.rows)
            clinging = self.start.normal_force > 0.0
            meets = (self.start.gap < rounding) & ~clinging
        near |= clinging | meets | (self.start.multiplier > 0.0)
        c = np.flatnonzero(near if self.followed is None else near | self.followed.apart)
        probe = self._probed(c, at)
        if self.held is not None:
            self.held.update(pose.forth(self.local_start) - self.corners.x)
        if meets.any():
            # a body that goes away lets go what it did not press
            meets[c] &= probe[0] < rounding[c]
        moved = self.now.path > _ROUNDING * np.abs(at).max(initial=0.0)
        # at the start of a step the closing of the last step counts
        closing = self.start.closing[c]
        if moved.any():
            closing = self.start.gap[c] - probe[0] - growth_of(self.held, c)
        self._compute(c, at, probe, clinging | meets, closing)
        if self.contact.law.friction and meets.any():
            self._stick(c[meets[c]], probe[1][meets[c]])

    def _stick(self, c: Rows, normal: Array) -> None:
        """Hold corners along the body that are about to be pressed, and will stick.

        Args:
            c: The corners.
            normal: Normal of the surface at each of them, shape (c, gdim).
        """
        free = self.now.normal[c] <= 0.0
        along = np.eye(normal.shape[1]) - normal[:, :, None] * normal[:, None, :]
        k = self.contact.law.slip_share * self.start.stiffness[c]
        self.now.derivative[c[free]] -= (k[:, None, None] * along)[free]

    def compute_at_start(self) -> None:
        """Compute the forces for corners and body at the start of the step."""
        self.x = self.corners.x
        c = np.flatnonzero((self.start.gap <= 0.0) | (self.start.multiplier > 0.0))
        gap, normal, curvature = self._probe
        probe = gap[c], normal[c], curvature[c]
        none = np.zeros(len(self.x), bool)
        self._compute(c, self.local_start, probe, none, self.start.closing[c])

    def _compute(self, c: Rows, at: Array, probe: Probe, clinging: Chosen, closing: Array) -> None:
        """Compute the forces on some corners. All other corners have no forces.

        Args:
            c: The corners.
            at: Positions of all corners in the frame of the body (m), shape (m, gdim).
            probe: Values of the surface at the given corners.
            clinging: Which of all corners cling to the body even outside it, shape (m,).
            closing: Closing of the gaps in a step (m), shape (c,).
        """
        self.now.clear()
        if self.mean_weights is None:
            if c.size:
                set_forces_at_end(self, c, at, probe, clinging, closing)
            return
        had_friction = np.any(self.start.tangential != 0.0, axis=1)
        if had_friction.any():
            c = np.union1d(c, np.flatnonzero(had_friction))
            probe = self._probed(c, at)
        self.now.loss[:] = 0.0
        if c.size:
            self._middle_rotation = set_mean_forces(self, c, at, probe)

    def internal(self, out: Sequence[Array]) -> bool:
        """See `ActiveTerm`: last computed forces, which resist, −f (N)."""
        if self.states.any():
            self.corners.stencils.add(-self.force_weight * self.forces, out[self.field])
        return True

    def add_forces(self, out: Array) -> None:
        """Add the nodal forces (N)."""
        if self.states.any():
            self.corners.stencils.add(self.forces, out)

    def tangent(self, entries: Mapping[tuple[int, int], Entries]) -> None:
        """See `ActiveTerm`."""
        active = np.flatnonzero(self.states != FREE)
        if active.size == 0:
            return
        rows, to = self.corners.stencils.rows(), entries[self.field, self.field]
        add_tangent(active, rows, rows, -self.tangent_weight * self.derivative(active), to)

    def derivative(self, active: Rows) -> Array:
        """Derivative of the forces by the corners' positions (N/m), shape (n, gdim, gdim)."""
        Q = self.contact.body.pose.rotation
        P = Q if self.mean_weights is None else self._middle_rotation
        return np.einsum("ij,cjk,lk->cil", P, self.now.derivative[active], Q)

    # -- resultants, energy and state -------------------------------------------

    def lever(self) -> Array:
        """Lever arms from the body's centre to the forces in the step (m), shape (m, gdim)."""
        body = self.contact.body
        if self.mean_weights is None:
            return np.asarray(self.x - body.pose.centre)
        middle = 0.5 * (self.corners.x + self.x)
        return np.asarray(middle - 0.5 * (body.start.centre + body.pose.centre))

    def totals(self) -> tuple[Array, Array]:
        """Force and moment of the points on the body (N, N m), on all ranks. Collective.

        In axisymmetric problems they act on the whole circumference.
        """
        moment = moments(self.lever(), self.forces)
        both = np.concatenate([self.forces.sum(axis=0), moment.sum(axis=0)])
        both = -self.contact.points.comm.allreduce(both, op=MPI.SUM)
        d = self.forces.shape[1]
        if self.contact.points.axisymmetric:
            # the resultant over the circumference has the direction of the axis
            both[[0, d]] = 0.0
        return both[:d], both[d:]

    def update(self, new: NewState) -> None:
        """See `ActiveTerm`. Collective."""
        points, names = self.contact.points, self.contact.names
        forces = names.tangential_force, names.normal_force, names.stiffness
        for name, values in self.end_state():
            new.fields[name] = self.layout.kept(points[name], self.corners, values, name in forces)

    def end_state(self) -> list[tuple[str, Array]]:
        """State of the corners at the end of the step: names of fields, and values. Collective."""
        names, now = self.contact.names, self.now
        shared = self.contact.shares_surface
        return [
            (names.tangential_force, now.tangential),
            (names.normal_force, now.normal),
            (names.stiffness, np.where(now.normal > 0.0, self.start.stiffness, 0.0)),
            (names.closing, now.closed),
            (names.gap, self._gaps_at_end()),
            *([(names.slip_area, areas_at_end(self))] if shared else ()),
            *(self.held.at_end(names, now) if self.held else ()),
        ]

    def _gaps_at_end(self) -> Array:
        """Gaps that the next step follows; zeros where it finds them anew (m), shape (m,)."""
        if self.followed is None:
            return np.zeros(len(self.x))
        return self.followed.at_end(self.now.gap, self.held)

    def stored(self, before: bool = False) -> float:
        """Energy stored by the penalties (J), on all ranks. Collective.

        Args:
            before: True for the energy at the end of the last step.
        """
        start, now = self.start, self.now
        normal = start.normal_force if before else now.normal
        tangential = start.tangential if before else now.tangential
        own = float(normal_energy(normal, start.stiffness).sum()) + self._slip_energy(tangential)
        return self.contact.points.comm.allreduce(own, op=MPI.SUM)

    def _slip_energy(self, tangential: Array) -> float:
        """Energy of elastic slip on this rank at some tangential forces (J)."""
        law, k = self.contact.law, self.start.stiffness
        return float(slip_energy(tangential, k, law.slip_share).sum()) if law.friction else 0.0

    def overlapping(self) -> float:
        """Energy of the penalties at the start of the step, by the gaps (J). Collective.

        Mean forces over a step can give it back, and no force has stored it if the body was placed
        inside the corners.
        """
        start = self.start
        gap = start.gap if self.held is None else start.gap + self.held.before
        q = start.multiplier - start.stiffness * gap
        own = float(normal_energy(q, start.stiffness).sum())
        return self.contact.points.comm.allreduce(own, op=MPI.SUM)

    def stored_at_start(self) -> float:
        """Energy of the penalties at the start of the step, also of slip (J). Collective."""
        slip = self._slip_energy(self.start.tangential)
        return self.overlapping() + self.contact.points.comm.allreduce(slip, op=MPI.SUM)

    def dissipated_in_step(self) -> float:
        """Work dissipated by friction and held corners in this step (J). Collective."""
        slips = np.flatnonzero(self.states >= SLIPS)
        done = float(self.now.loss.sum())
        if self.held is not None and self.mean_weights is None:
            done += self.held.loss_at_end(self.start.normal_force, self.now.normal)
        if slips.size and self.mean_weights is None:
            at = self.contact.body.pose.back(self.x[slips])
            n = self.contact.body.surface.probe(at)[1]
            stiffness = self.contact.law.slip_share * self.start.stiffness[slips]
            slip = at - self.local_start[slips]
            before = self.start.tangential[slips]
            done += float(slip_work(self.now.tangential[slips], before, slip, n, stiffness).sum())
        return self.contact.points.comm.allreduce(done, op=MPI.SUM)
