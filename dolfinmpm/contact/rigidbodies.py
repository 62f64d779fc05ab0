"""The rigid bodies of a problem: their motion, forces and energy in each step."""

from __future__ import annotations

import itertools
import math
import weakref
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from dolfinmpm._platform.errors import FormError, ParameterError
from dolfinmpm.contact.activerigidcontact import ActiveRigidContact
from dolfinmpm.contact.bodyinertia import accelerate
from dolfinmpm.contact.contactwarnings import warn_of_bare_points
from dolfinmpm.contact.rigidbody import RigidBody
from dolfinmpm.contact.rigidcontact import RigidContact
from dolfinmpm.contact.tunnelling import limit_of, too_far

__all__ = ["RigidBodies"]

Array = npt.NDArray[np.float64]

# Motions below this share of a cell are rounding
_STILL = 1e-9


class RigidBodies:
    """The rigid bodies in the contacts of a form.

    In one substep a body may move by at most the smallest cell, and by at most half its own
    thickness. So points in its way are inside the body at the end, on the side from which it came.

    Args:
        contacts: The contacts.

    Attributes:
        contacts: The argument.
        all: The bodies, each once.

    Raises:
        FormError: Points touch a body in two contacts at once.
        ParameterError: A body's motion does not begin at its shape, or two bodies have one name.
    """

    def __init__(self, contacts: Sequence[RigidContact]):
        self.contacts = list(contacts)
        for one, other in itertools.combinations(contacts, 2):
            if _same(one, other):
                raise FormError(
                    f"the form has {one!r} twice for the same points, and its force would act "
                    "twice: leave one out, or give tags or surfaces that divide the points"
                )
        self._token, self._has_moved = object(), False
        # the search for the smallest cell is collective, and only contacts need it
        cells = [contact.u._dolfinmpm_space.finest_cell for contact in contacts]
        self._limit = min(cells, default=0.0)
        self.all: list[RigidBody] = []
        #: Energy stored by the penalties of contact, now and before the first step (J).
        self.stored = 0.0
        self.given: float | None = None
        #: Whether points have come, gone, split or merged since the last step, and whether the user
        #: did it.
        self.changed = self.by_user = False
        self._before = 0.0
        for contact in contacts:
            contact.limit = self._limit
            if not any(contact.body is body for body in self.all):
                contact.body.check_start()
                self.all.append(contact.body)
        _refuse_namesakes(self.all)

    @property
    def free(self) -> list[RigidBody]:
        """The bodies with free components."""
        return [b for b in self.all if b.freedom is not None and b.freedom.free.size]

    def kinetic(self) -> float:
        """Kinetic energy of the free bodies (J)."""
        return sum(body.kinetic() for body in self.free)

    @property
    def friction_work(self) -> float:
        """Work dissipated by friction on the bodies (J)."""
        return sum(contact.dissipated for contact in self.contacts)

    def stored_here(self) -> float:
        """Energy stored by the penalties at this rank's points, by their fields (J)."""
        return sum(contact.stored_here() for contact in self.contacts)

    def check_steps(self, in_time: bool, kind: str) -> None:
        """Raise if a body's motion does not fit the steps of a problem.

        Args:
            in_time: Whether the steps have a length in s.
            kind: The problem's class, for messages.

        Raises:
            ParameterError: An increment is prescribed in time, or a velocity without time.
        """
        for body in self.all:
            free = set() if body.freedom is None else set(body.freedom.free)
            for motion, first in zip(body.prescribed_motions, (0, body.gdim)):
                if in_time and motion.kind == "increment":
                    raise ParameterError(
                        f"{motion.name} is the motion of '{body.name}' per step, and the steps of "
                        f"{kind} have a length in time: give its velocity, or its total motion"
                    )
                # velocities of free components are initial values
                held = not free.issuperset(range(first, first + motion.size))
                if held and not in_time and motion.kind == "velocity":
                    raise ParameterError(
                        f"{motion.name} is the motion of '{body.name}' per second, and {kind} "
                        "has no time: give its increment per step, or its total motion"
                    )

    def take(self) -> None:
        """Reserve the bodies for the steps of this problem.

        A problem may continue with a body that an earlier problem of the same points has moved.

        Raises:
            ParameterError: Two problems move a body alternately. Or a body moved by another
                problem touches other points.
        """
        for body in self.all:
            if body.mover is None or body.mover[0] is self._token or body.time == 0.0:
                continue
            if self._has_moved or body.mover[1]() is not self.contacts[0].points:
                raise ParameterError(
                    f"'{body.name}' has been moved by another problem, to t = {body.time:g}; only "
                    "one problem can move it: make a body per problem, mpm.RigidBody(...)"
                )
        self.own()
        self.follow_constants(-math.inf)

    def follow_constants(self, duration: float) -> None:
        """Let constants that prescribe motions have their values after a duration.

        Args:
            duration: Time from now, of several steps (s); -inf: the end of each step.
        """
        for body in self.all:
            for motion in body.prescribed_motions:
                motion.until = body.time + duration

    def own(self) -> None:
        """Mark the bodies as moved by this problem."""
        self._has_moved = True
        for body in self.all:
            body.mover = self._token, weakref.ref(self.contacts[0].points)

    def begin(self, dt: float) -> None:
        """Begin a step or substep of length dt (s; steps), and move the bodies to its end."""
        for body in self.all:
            body.begin(dt)
            body.put(1.0)

    def put(self, share: float) -> None:
        """Move the bodies to their poses at a share of the step."""
        for body in self.all:
            body.put(share)

    def reset(self) -> None:
        """Move the bodies back to their poses at the end of the last substep."""
        for body in self.all:
            body.pose = body.start

    def too_fast(self, dt: float, inertia: bool = False) -> str | None:
        """Why a step is too long for the motion of the bodies, or None.

        Args:
            dt: Length of the step (s; steps).
            inertia: Whether free bodies continue their motion.
        """
        for body in self.all:
            body.begin(dt)
            if body.freedom is not None:
                body.freedom.go_on(dt if inertia else 0.0)
            fault = too_far(body, body.travel(), self._limit)
            if body.freedom is not None:
                body.freedom.go_on(0.0)
            if fault is not None:
                return fault
        return None

    def driven(self, dt: float) -> str | None:
        """Name of a body whose prescribed motion continues in a step of length dt, or None."""
        for body in self.all:
            body.begin(dt)
            if body.freedom is not None:
                body.freedom.increment = np.zeros_like(body.freedom.increment)
            if body.travel() > _STILL * self._limit:
                return body.name
        return None

    def followed(self, dt: float, count: int) -> int:
        """Number of successive steps that are not too long for the motion of the bodies.

        `too_fast` has already checked the first step.

        Args:
            dt: Length of the steps (s).
            count: Largest number of steps.
        """
        if count > 1:
            for body in self.all:
                count = min(count, body.ahead(dt, count, limit_of(body, self._limit)))
        return count

    def push(self, contacts: Sequence[ActiveRigidContact], kick: float) -> None:
        """Accelerate the free bodies by the forces at the start of an explicit step. Collective.

        Args:
            contacts: The contacts.
            kick: Time during which the forces act (s).
        """
        # a body placed inside the points has stored energy before the first step
        new = [active for active in contacts if active.contact.body.time == 0.0]
        self._before = sum(active.stored() for active in new)
        if self.given is None:
            # steps of another problem may have had another stiffness and other corners
            self.given = sum(active.stored() for active in contacts if active not in new)
        elif self.changed:
            self._begin_anew(sum(active.stored() for active in contacts))
            for body in self.all:
                body.press([active.totals() for active in contacts if active.contact.body is body])
        for body in self.free:
            force = np.concatenate([np.zeros_like(body.force), np.zeros_like(body.moment)])
            for active in contacts:
                if active.contact.body is body:
                    force += np.concatenate(active.totals())
            accelerate(body, force, kick)

    def _begin_anew(self, stored: float) -> None:
        """Count what corners of other points store at the start of a step (J).

        It is given by a user who changes points. What points store that have split or merged in
        the steps is an error of these.
        """
        assert self.given is not None
        if self.by_user:
            self.given += stored - self.stored
        self.stored, self.changed, self.by_user = stored, False, False

    def commit(self, contacts: Sequence[ActiveRigidContact]) -> float:
        """Keep the poses of the bodies, and the forces on them. Collective.

        Returns:
            Work that moves the bodies in the step (J): work of loads on free components, and work
            of mean forces on prescribed components. In the first step in time the energy of an
            initial penetration is added.
        """
        new = [a for a in contacts if a.mean_weights is not None and a.contact.body.time == 0.0]
        before, self._before = self._before + sum(active.overlapping() for active in new), 0.0
        sums: dict[int, list[Array]] = {
            id(b): [np.zeros_like(b.force), np.zeros_like(b.moment)] for b in self.all
        }
        for active in contacts:
            force, moment = active.totals()
            both = sums[id(active.contact.body)]
            both[0] = both[0] + force
            both[1] = both[1] + moment
            active.contact.dissipated += active.dissipated_in_step()
        if self.given is None:
            self.given = sum(active.stored(before=True) for active in contacts)
        elif self.changed and any(active.mean_weights is not None for active in contacts):
            self._begin_anew(sum(active.stored_at_start() for active in contacts))
        self.stored = sum(active.stored() for active in contacts)
        mean = any(active.mean_weights is not None for active in contacts)
        works = [body.commit(*sums[id(body)], mean=mean) for body in self.all]
        return before + sum(works)

    def record(self) -> dict[str, dict[str, list[float]]]:
        """Name of a body → its part of the record of a step. Collective."""
        for contact in self.contacts:
            warn_of_bare_points(contact, self.contacts)
        return {body.name: body.record() for body in self.all}

    def acting(self, operator: Any) -> list[ActiveRigidContact]:
        """The contacts of the bodies in the equations of a step.

        Args:
            operator: The equations.
        """
        return [operator.active(contact) for contact in self.contacts]

    def state(self) -> dict[str, Any]:
        """The state of the bodies and their contacts from step to step."""
        if not self.all:
            return {}
        rows = {f"rigid body {k}": body.state() for k, body in enumerate(self.all)}
        friction_work = np.array([c.dissipated for c in self.contacts])
        given = math.nan if self.given is None else self.given
        stored = np.array([self.stored, given, float(self.changed), float(self.by_user)])
        return {**rows, "friction's work": friction_work, "stored in contact": stored}

    def set_state(self, state: Mapping[str, Any]) -> None:
        """Restore a state returned by `state`."""
        for k, body in enumerate(self.all):
            body.set_state(state[f"rigid body {k}"])
        self.own()
        if self.all:
            for contact, done in zip(self.contacts, state["friction's work"]):
                contact.dissipated = float(done)
            self.stored, given, *changed = (float(value) for value in state["stored in contact"])
            self.given = None if math.isnan(given) else given
            self.changed, self.by_user = any(changed), any(changed[1:])


def _same(one: RigidContact, other: RigidContact) -> bool:
    """Whether two contacts have the same body, and common points or faces of points."""
    if one.body is not other.body or one.points is not other.points:
        return False
    if one.tags is not None and other.tags is not None and not set(one.tags) & set(other.tags):
        return False
    return one.surface is other.surface or one.surface is None or other.surface is None


def _refuse_namesakes(bodies: Sequence[RigidBody]) -> None:
    """Raise ParameterError if two bodies have one name: records of steps would lack one."""
    for one, other in itertools.combinations(bodies, 2):
        if one.name == other.name:
            raise ParameterError(
                f"two rigid bodies have the name '{one.name}', and record.bodies['{one.name}'] "
                "would be of the last one only: give each a name of its own, "
                "mpm.RigidBody(..., name=...)"
            )
