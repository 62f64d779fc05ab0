"""Contact with rigid bodies in fused steps.

Few points are near a body. They are listed once for many steps; in each of these the corners of
those on the list feel what they feel in general steps, see `dolfinmpm.contact.active`, and their
forces are added to what the loops have summed up at the nodes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm._platform import stages
from dolfinmpm.basis.stencils import Stencils
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.contact.active import MARGIN, ActiveContact
from dolfinmpm.contact.bodies import Bodies
from dolfinmpm.contact.corners import Rows, Sight, Sites
from dolfinmpm.contact.nearby import Nearby
from dolfinmpm.contact.terms import Contact
from dolfinmpm.dynamics.nodes import fastest
from dolfinmpm.dynamics.passes import COLUMNS
from dolfinmpm.dynamics.window import Exchange, Window

__all__ = ["RigidContacts"]

Array = npt.NDArray[np.float64]

# How much more than what corners and bodies went in a step they may go in the next one before
# corners are looked for anew, and how far at least, in cells
_SPARE, _LEAST = 2.0, 0.04


class RigidContacts:
    """The contacts of a form in the steps of fused loops.

    In a step `begin`, `press`, `follow` and `end` are called in this order.

    Args:
        contacts: The contacts, at least one.
        bodies: The bodies that they are with.
        points: Material points.

    Attributes:
        work: Work that the bodies have done since it was last set (J), on all ranks.
    """

    _window: Window
    _sight: Sight
    _exchange: Exchange | None
    _sums: Array

    def __init__(self, contacts: Sequence[Contact], bodies: Bodies, points: MaterialPoints):
        self._bodies, self._points, self.work = bodies, points, 0.0
        self._near = [Nearby(contact) for contact in contacts]
        self._active: list[ActiveContact] = []
        # whether corners go no further than nodes, and how near are those looked at (m), by contact
        self._bounded, self._distances = [False] * len(contacts), [math.inf] * len(contacts)
        # how far nodes went in the last step at most (m), and each body
        self._nodes_go, self._ways = 0.0, [0.0] * len(contacts)
        self._known: Window | None = None

    def surround(self, window: Window) -> None:
        """Take the nodes of a window; points have come or gone. Collective."""
        if window is not self._known:
            self._known = self._window = window
            self._exchange = window.exchange(self._points.gdim)
            self._sums = np.zeros((len(window.nodes), self._points.gdim))
            self._sight = Sight(window.basis, False, None, self._stencils, window.place)
        points = self._points
        cell = np.array([np.diff(line).min() for line in window.basis.lattice.lines])
        for k, near in enumerate(self._near):
            near.forget(self._sight, cell)
            contact = near.contact
            self._bounded[k] = Sites(points, self._sight, contact.surface, contact.material).boxes
        margin = MARGIN * float(points["l0"].max(axis=1, initial=0.0).min(initial=math.inf))
        self._margin = points.comm.allreduce(margin, op=MPI.MIN)

    def _stencils(self, rows: Rows) -> Stencils:
        """Stencils of some points as the loops have them: on a grid line of its upper cell."""
        points, basis = self._points, self._window.basis
        x, half = points["x"][rows], points["l"][rows]
        if not basis.averaged:
            half = np.zeros_like(x)
        found = basis.stencils_in(x, half, *basis.spans(x, half))
        # points are given to other ranks before they get to the window's edge
        assert found is not None
        return found

    @stages.activate
    def begin(self, dt: float, all_corners: bool) -> None:
        """Begin a step of that length (s): find corners that may touch in it. Collective.

        Args:
            dt: The length.
            all_corners: Whether all corners of points near the bodies are to be looked at, since
                the points' fields change before it is known how far they go.

        Raises:
            ParameterError: Points are inside a body before the first step.
        """
        self._bodies.begin(dt)
        self._dt = dt
        self._active = [self._made(k, all_corners) for k in range(len(self._near))]

    def _made(self, k: int, all_corners: bool = False) -> ActiveContact:
        """A contact of the corners that may touch. Collective before the first step."""
        near, contact = self._near[k], self._near[k].contact
        distance = _SPARE * (near.way() + self._nodes_go) + _LEAST * near.cell
        # multipliers act at any distance
        known = self._bounded[k] and contact.penetration is None and contact.body.time > 0.0
        if all_corners or not known:
            distance = math.inf
        self._distances[k] = distance
        return ActiveContact(contact, self._sight, 0, near.rows(distance), distance)

    @stages.assemble
    def press(self, out: Array, moved: bool) -> None:
        """Add forces on the nodes at the start of the step, and push free bodies. Collective.

        Args:
            out: Sums at the window's nodes, summed over ranks.
            moved: Whether corners have moved by the velocities that strain.
        """
        self._bodies.put(0.0)
        for active in self._active:
            if moved:
                active.shift(self._way(active))
            else:
                active.rest()
        d = self._points.gdim
        force = out[:, COLUMNS[d].force : COLUMNS[d].force + d]
        if self._exchange is None:
            for active in self._active:
                active.add_forces(force)
        else:
            self._sums[:] = 0.0
            for active in self._active:
                active.add_forces(self._sums)
            self._exchange.add_up(self._sums)
            force += self._sums
        self._bodies.push(self._active)

    def _way(self, active: ActiveContact) -> Array:
        """How far corners go in the step by the velocities that strain (m), shape (m, d)."""
        d, corners = self._points.gdim, active.corners
        first = COLUMNS[d].strain
        velocities = self._window.nodes[corners.nodes, first : first + d]
        return np.asarray(corners.N @ (self._dt * velocities))

    @stages.assemble
    def follow(self) -> None:
        """Find the forces at the end of the step."""
        self._bodies.put(1.0)
        d = self._points.gdim
        speed = fastest(self._window.rows(), self._window.nodes, COLUMNS[d].strain, d)
        # corners of domains are between the nodes that they see, and go no further than these
        self._nodes_go = self._dt * speed
        self._ways = [near.way() for near in self._near]
        for k, way in enumerate(self._ways):
            if way + self._nodes_go > self._distances[k]:
                self._active[k] = self._made(k)
            self._active[k].shift(self._way(self._active[k]))

    @stages.commit
    def end(self, way: float) -> str | None:
        """Take where the bodies are, and what the points keep of the contacts. Collective.

        Args:
            way: Cells that the fastest point has crossed in the step, on any rank.

        Returns:
            What is wrong with where points have got to, or None.
        """
        missed = False
        for near, active, of_body in zip(self._near, self._active, self._ways):
            gone = way * near.cell + of_body
            sure = near.travelled(gone)
            # what has gone less cannot have got there
            if gone >= self._margin or not sure:
                missed = active.missed(self._points["x"]) or missed
        if missed:
            return "material points got into a rigid body from further away than was looked at"
        for near, active in zip(self._near, self._active):
            near.keep(active)
        self.work += self._bodies.commit(self._active)
        return None
