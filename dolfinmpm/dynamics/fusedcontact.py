"""Contact with rigid bodies in fused steps.

Only a few points are near a body. A list of these points serves many steps. In each step the
corners of the listed points get the same contact forces as in general steps, see
`dolfinmpm.contact.activerigidcontact`. These forces are added to the nodal sums of the loops.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm._platform import stages
from dolfinmpm.basis.stencils import Stencils
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.contact.activerigidcontact import ActiveRigidContact
from dolfinmpm.contact.corners import CornerLayout, Rows, longest
from dolfinmpm.contact.displacementbasis import DisplacementBasis
from dolfinmpm.contact.heldcorners import HeldCorners, held_components
from dolfinmpm.contact.rigidbodies import RigidBodies
from dolfinmpm.contact.rigidcontact import RigidContact
from dolfinmpm.contact.tunnelling import MARGIN, passed_through, travelled, unlisted_entered, within
from dolfinmpm.dynamics.energies import by_contact
from dolfinmpm.dynamics.explicitbase import ExplicitStep
from dolfinmpm.dynamics.nodes import fastest
from dolfinmpm.dynamics.passes import COLUMNS
from dolfinmpm.dynamics.window import Exchange, Prescribed, Window

__all__ = ["RigidContacts"]

Array = npt.NDArray[np.float64]


# Corners are searched within this multiple of the last motion of nodes and body, and within this
# many cells in addition
_SPARE, _LEAST = 2.0, 0.04


class HeldNodes:
    """Nodes of a window that are held along sides of the grid.

    Args:
        prescribed: Prescribed velocities of the nodes.
    """

    _mask: npt.NDArray[np.bool_] | None = None
    _of: npt.NDArray[np.bool_] | None = None

    def __init__(self, prescribed: Prescribed):
        self._prescribed = prescribed

    def find(self, window: Window, points: MaterialPoints) -> None:
        """Find them in a window, unless the conditions' nodes are the same. Collective."""
        fixed, x = self._prescribed.fixed, window.basis.node_coordinates
        if fixed is not self._of:
            d = points.gdim
            found = held_components(points.grid, fixed, lambda: window.from_basis(x()[:, :d]))
            self._mask, self._of = found, fixed

    def corners(self, active: ActiveRigidContact, dt: float) -> HeldCorners | None:
        """The corners that they hold in a step of the length dt (s)."""
        nodes, given = active.corners.stencils.nodes, self._prescribed.after
        held = None if self._mask is None else self._mask[nodes]
        return HeldCorners.of(active, held, dt * given[nodes])


class NeighbourList:
    """Points that may touch a body until points and body have moved by a cell.

    The candidates of `ActiveRigidContact` in each of these steps are in the list.

    Args:
        contact: The contact.
        held: Nodes that are held along sides of the grid.

    Attributes:
        contact, held: The arguments.
        distance: Largest distance from the body of corners that can touch in this step (m);
            infinite if it is unknown.
        cell: Largest motion of a point across a cell in one direction (m).
    """

    _rows: Rows | None = None
    _left = 0.0

    def __init__(self, contact: RigidContact, held: HeldNodes):
        self.contact, self.held = contact, held

    def forget(self, displacement: DisplacementBasis, cell: Array) -> None:
        """List the points anew before the next step: points have changed, or their order.

        Args:
            displacement: The basis functions of the displacement.
            cell: Size of the smallest cell (m), shape (gdim,).
        """
        self._displacement, self._rows = displacement, None
        self.cell, self.distance = float(np.linalg.norm(cell)), math.inf
        self._bounded = self._layout().boxes
        # points that touched keep their forces until the end of the next step
        points, names = self.contact.points, self.contact.names
        kept = [points[name] != 0.0 for name in (names.normal_force, names.overlap, names.gap)]
        self._touched = np.flatnonzero(np.any(kept, axis=(0, 2)))

    def rows(self, path: float) -> Rows:
        """The points, increasing, with the body at the end of the step.

        Args:
            path: Expected largest path of nodes in the step (m).
        """
        body, contact = self.contact.body, self.contact
        of_body = self.body_path()
        if self._rows is None or self._left < of_body:
            self._rows, self._room = self._listed()
            self._left = self.cell
        self.distance = _SPARE * (of_body + path) + _LEAST * self.cell
        # only corners of domains move no further than nodes, and multipliers act at any distance
        if not self._bounded or contact.law.penetration is not None or body.time == 0.0:
            self.distance = math.inf
        if math.isinf(self.distance):
            return self._rows
        # since the points were listed they have come nearer by no more than the largest path
        return self._rows[self._room - (self.cell - self._left) <= self.distance]

    def travelled(self, path: float) -> bool:
        """Record the largest path of points and body in a step.

        Args:
            path: Largest path of a point plus that of the body (m).

        Returns:
            Whether no point outside the list can have reached the body.
        """
        self._left -= path
        return self._left >= 0.0

    def body_path(self) -> float:
        """Largest motion of the body in the step, at its present pose (m)."""
        body = self.contact.body
        endless = not np.isfinite(body.surface.low).all()
        if endless and np.any(body.pose.turn != body.start.turn):
            # the motion of an infinite surface that turns has no bound
            return math.inf
        return travelled(body.surface, body.start, body.pose)

    def keep(self, active: ActiveRigidContact) -> None:
        """Write the state of the contact at the end of a step to the points."""
        points, c = self.contact.points, active.corners
        for name, values in active.end_state():
            points[name][self._touched] = 0.0
            points[name][c.rows, c.which] = values
        touch = (active.now.normal != 0.0) | np.isfinite(active.now.gap)
        if active.held is not None:
            # corners without a force may keep an overlap
            touch |= active.held.now > 0.0
        self._touched = c.rows[touch]

    def _layout(self) -> CornerLayout:
        contact = self.contact
        return CornerLayout(contact.points, self._displacement, contact.surface, contact.material)

    def _listed(self) -> tuple[Rows, Array]:
        """The points, and lower bounds of the distances of their corners from the body (m)."""
        points, body = self.contact.points, self.contact.body
        x, reach = points["x"], self._layout().reach()
        # corners that follow the material move away from their points as it is stretched
        limit = 2 * reach + MARGIN * longest(points["l0"]) + self.cell
        poses = [body.start, body.pose]
        rows = np.flatnonzero(within(poses, body.surface, x, limit[:, None]))
        first, last = (body.surface.probe(pose.back(x[rows]))[0] for pose in poses)
        near = np.minimum(first, last) < limit[rows]
        return rows[near], first[near] - reach[rows[near]]


class RigidContacts:
    """The contacts of a form in the steps of fused loops.

    A step calls `begin`, `press`, `follow` and `end` in this order.

    Args:
        bodies: The rigid bodies, with at least one contact.
        points: Material points.
        prescribed: Prescribed velocities of the nodes.

    Attributes:
        work: Work done by the bodies since this attribute was last set (J), on all ranks.
        half_step: Half-step energies of points and bodies by contact (J), see `Work`.
    """

    _displacement: DisplacementBasis
    _exchange: Exchange | None
    _sums: Array

    def __init__(self, bodies: RigidBodies, points: MaterialPoints, prescribed: Prescribed):
        self._bodies, self._points, self.work = bodies, points, 0.0
        self.half_step = 0.0, 0.0
        held = HeldNodes(prescribed)
        self._near = [NeighbourList(contact, held) for contact in bodies.contacts]
        self._active: list[ActiveRigidContact] = []
        # largest motion of nodes in the last step (m)
        self._nodes_go = 0.0
        self._window: Any = None

    def surround(self, window: Window) -> None:
        """Use the nodes of a new window, after points have come or gone. Collective."""
        if window is not self._window:
            self._window = window
            self._exchange = window.exchange(self._points.gdim)
            self._sums = np.zeros((len(window.nodes), self._points.gdim))
            place = window.place.astype(np.int32)
            one = self._near[0].contact
            self._displacement = DisplacementBasis(
                window.basis, False, None, self._stencils, place, one.u._dolfinmpm_space.domains,
                bool(one.follows),
            )  # fmt: skip
        points = self._points
        cell = np.array([np.diff(line).min() for line in window.basis.lattice.lines])
        for near in self._near:
            near.forget(self._displacement, cell)
            near.held.find(window, points)
        margin = MARGIN * float(longest(points["l0"]).min(initial=math.inf))
        self._margin = points.comm.allreduce(margin, op=MPI.MIN)

    def _stencils(self, rows: Rows) -> Stencils:
        """Stencils of points as in the loops: a point on a grid line uses the upper cell."""
        points, basis = self._points, self._window.basis
        x, half = points["x"][rows], points["l"][rows]
        if not basis.averaged:
            half = np.zeros_like(x)
        found = basis.stencils_in(x, half, *basis.spans(x, half), points.axisymmetric)
        # points move to other ranks before they reach the window's edge
        assert found is not None
        return found

    @stages.activate
    def begin(self, step: ExplicitStep, before: bool) -> None:
        """Begin a step: find the corners that may touch in the step. Collective.

        Args:
            step: The step.
            before: Whether points strain before the forces, as in "usf". All corners of points
                near the bodies are then checked, because fields change before the motion is known.

        Raises:
            ParameterError: Points are inside a body before the first step.
        """
        self._bodies.begin(step.dt)
        self._dt, self._kick = step.dt, step.kick
        self._stress_first = before
        self._active = [self._made(near, before) for near in self._near]

    def _made(self, near: NeighbourList, all_corners: bool = False) -> ActiveRigidContact:
        """A contact of the corners that may touch. Collective before the first step."""
        rows = near.rows(math.inf if all_corners else self._nodes_go)
        active = ActiveRigidContact(near.contact, self._displacement, 0, rows, near.distance)
        active.held = near.held.corners(active, self._dt)
        return active

    @stages.assemble
    def press(self, out: Array) -> None:
        """Add forces on the nodes at the start of the step, and push free bodies. Collective.

        Args:
            out: Sums at the window's nodes, summed over ranks.
        """
        self._bodies.put(0.0)
        for active in self._active:
            active.compute_at_start()
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
        self._bodies.push(self._active, self._kick)

    @property
    def _moving(self) -> int:
        """Column of the velocities that move: in "usf" others strain, those of the last motion."""
        return 0 if self._stress_first else COLUMNS[self._points.gdim].second

    def _way(self, active: ActiveRigidContact) -> Array:
        """Displacements of corners in the step, as the points move (m), shape (m, d)."""
        d, stencils, first = self._points.gdim, active.corners.stencils, self._moving
        velocities = self._window.nodes[stencils.nodes, first : first + d]
        return stencils.of_nodes(self._dt * velocities)

    @stages.assemble
    def follow(self) -> None:
        """Find the forces at the end of the step."""
        self._bodies.put(1.0)
        d = self._points.gdim
        speed = fastest(self._window.rows(), self._window.nodes, self._moving, d)
        # corners go on by their points' gradients, up to half a cell from these
        self._nodes_go = 2.0 * self._dt * speed
        for k, near in enumerate(self._near):
            if near.body_path() + self._nodes_go > near.distance:
                self._active[k] = self._made(near)
            self._active[k].compute(self._way(self._active[k]))

    @stages.commit
    def end(self, way: float, record: bool) -> str | None:
        """Keep the poses of the bodies and the contact state of the points. Collective.

        Args:
            way: Path of the fastest point in the step on all ranks, in cells.
            record: Whether to find the half-step energy of velocities.

        Returns:
            Message about wrong positions of points, or None.
        """
        # one more entry: whether points and bodies have passed each other
        look = np.zeros(len(self._near) + 1, np.uint8)
        faults = (passed_through(active) for active in self._active)
        through = next((fault for fault in faults if fault is not None), None)
        look[-1] = through is not None
        for k, near in enumerate(self._near):
            gone = way * near.cell + near.body_path()
            sure = near.travelled(gone)
            # points with a shorter way cannot have reached the body
            look[k] = gone >= self._margin or not sure
        if self._points.comm.size > 1:
            # ranks that listed points anew within the step are surer than others
            self._points.comm.Allreduce(MPI.IN_PLACE, look, op=MPI.MAX)
        if look[-1]:
            found = self._points.comm.allgather(through)
            return next(reason for reason in found if reason is not None)
        unseen = False
        for k in np.flatnonzero(look[:-1]):
            unseen = unlisted_entered(self._active[k], self._points["x"]) or unseen
        if unseen:
            return "material points got into a rigid body from further away than was looked at"
        for near, active in zip(self._near, self._active):
            near.keep(active)
        if record:
            self.half_step = by_contact(
                self._bodies, self._active, self._points.comm, self._stress_first
            )
        self.work += self._bodies.commit(self._active)
        return None
