"""The rigid bodies of a problem, step by step."""

from __future__ import annotations

import itertools
import math
import weakref
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from dolfinx.mesh import Mesh

from dolfinmpm._platform.errors import FormError, ParameterError
from dolfinmpm.contact.activecontact import ActiveContact
from dolfinmpm.contact.contactterm import Contact
from dolfinmpm.contact.passing import limit_of, too_far
from dolfinmpm.contact.rigid import RigidBody
from dolfinmpm.grid.lattice import smallest_height

__all__ = ["Bodies"]

Array = npt.NDArray[np.float64]

# Share of a cell below which a motion is rounding
_STILL = 1e-9


class Bodies:
    """The bodies that the contacts of a form are with.

    Args:
        contacts: The contacts.
        grid: The grid; in one part of a step a body may go as far as its smallest cell, and as
            far as half its own thickness: what it goes over must be within it at the end, on the
            side that it came from.

    Attributes:
        contacts: The argument.
        all: The bodies, each once.

    Raises:
        FormError: Points touch a body in two contacts at once.
        ParameterError: A body does not begin where its shape is.
    """

    def __init__(self, contacts: Sequence[Contact], grid: Mesh):
        self.contacts = list(contacts)
        for one, other in itertools.combinations(contacts, 2):
            if _same(one, other):
                raise FormError(
                    f"the form has {one!r} twice for the same points, which would feel its force "
                    "twice: leave one out, or give them tags or surfaces that share the points"
                )
        self._token, self._has_moved = object(), False
        # looking for it is collective, and without contacts nobody asks
        self._limit = smallest_height(grid) if contacts else 0.0
        self.all: list[RigidBody] = []
        #: What the penalties of contact have stored, now and before the first step (J).
        self.stored = 0.0
        self.given: float | None = None
        self._before = 0.0
        for contact in contacts:
            contact.limit = self._limit
            if not any(contact.body is body for body in self.all):
                contact.body.check_start()
                self.all.append(contact.body)

    @property
    def free(self) -> list[RigidBody]:
        """Those that have free components."""
        return [b for b in self.all if b.freedom is not None and b.freedom.free.size]

    def kinetic(self) -> float:
        """Kinetic energy of the free ones (J)."""
        return sum(body.kinetic() for body in self.free)

    @property
    def rubbed(self) -> float:
        """Work that friction on them has taken (J)."""
        return sum(contact.dissipated for contact in self.contacts)

    def check_steps(self, in_time: bool, kind: str) -> None:
        """Raise where a body's motion is not of the steps that a problem takes.

        Args:
            in_time: Whether the steps have a length in s.
            kind: The problem's class, for messages.

        Raises:
            ParameterError: An increment is prescribed in time, or a velocity without time.
        """
        for body in self.all:
            free = set() if body.freedom is None else set(body.freedom.free)
            for course, first in zip(body.courses, (0, body.gdim)):
                if in_time and course.kind == "increment":
                    raise ParameterError(
                        f"{course.name} is the motion of '{body.name}' per step, and the steps of "
                        f"{kind} have a length in time: give its velocity, or its motion in total"
                    )
                # velocities of free components are those at first
                held = not free.issuperset(range(first, first + course.size))
                if held and not in_time and course.kind == "velocity":
                    raise ParameterError(
                        f"{course.name} is the motion of '{body.name}' per second, and {kind} "
                        "knows no time: give its increment per step, or its motion in total"
                    )

    def take(self) -> None:
        """Take the bodies for a step. A body that another problem has moved since is not to be had.

        A problem may go on with the body that another one of the same points has moved before.

        Raises:
            ParameterError: Two problems move a body in turns, or one that has moved touches other
                points.
        """
        for body in self.all:
            if body.mover is None or body.mover[0] is self._token or body.time == 0.0:
                continue
            if self._has_moved or body.mover[1]() is not self.contacts[0].points:
                raise ParameterError(
                    f"'{body.name}' has been moved by another problem, to t = {body.time:g}: a "
                    "rigid body is where the steps of one problem have brought it; make one for "
                    "each problem, mpm.RigidBody(...)"
                )
        self.own()

    def own(self) -> None:
        """Note that the steps of this problem have brought the bodies where they are."""
        self._has_moved = True
        for body in self.all:
            body.mover = self._token, weakref.ref(self.contacts[0].points)

    def begin(self, dt: float) -> None:
        """Begin a step, or a part, of that length (s; steps), and put the bodies to its end."""
        for body in self.all:
            body.begin(dt)
            body.put(1.0)

    def put(self, share: float) -> None:
        """Put them where they are at a share of the step."""
        for body in self.all:
            body.put(share)

    def reset(self) -> None:
        """Put them back to where they were when the last part of a step ended."""
        for body in self.all:
            body.pose = body.start

    def fault(self, dt: float, inertia: bool = False) -> str | None:
        """Why a step of that length (s; steps) is too long for their motion, or None.

        Args:
            dt: The length.
            inertia: Whether free bodies go on as they move.
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
        """A body whose prescribed motion goes on in a step of that length (s; steps), or None."""
        for body in self.all:
            body.begin(dt)
            if body.freedom is not None:
                body.freedom.increment = np.zeros_like(body.freedom.increment)
            if body.travel() > _STILL * self._limit:
                return body.name
        return None

    def followed(self, dt: float, count: int) -> int:
        """How many steps of that length (s) can follow each other before one is too long.

        That the first one is not has been asked `fault`.

        Args:
            dt: The length.
            count: At most so many.
        """
        if count > 1:
            for body in self.all:
                count = min(count, body.ahead(dt, count, limit_of(body, self._limit)))
        return count

    def push(self, contacts: Sequence[ActiveContact], kick: float) -> None:
        """Let forces at the start of an explicit step move the free bodies in it. Collective.

        Args:
            contacts: The contacts.
            kick: For how long the forces act (s).
        """
        # who put a body into the points has done work before the first step
        new = [active for active in contacts if active.contact.body.time == 0.0]
        self._before = sum(active.stored() for active in new)
        if self.given is None:
            # another problem's steps may have had another stiffness, and other corners
            self.given = sum(active.stored() for active in contacts if active not in new)
        for body in self.free:
            force = np.concatenate([np.zeros_like(body.force), np.zeros_like(body.moment)])
            for active in contacts:
                if active.contact.body is body:
                    force += np.concatenate(active.totals())
            body.push(force, kick)

    def commit(self, contacts: Sequence[ActiveContact]) -> float:
        """Take where the bodies are, and what acts on them. Collective.

        Returns:
            Work of what moves them in the step (J): of loads on what is free of them, and by the
            mean forces of what is prescribed. In the first one of explicit steps what they were
            pressed in before counts, too.
        """
        sums: dict[int, list[Array]] = {
            id(b): [np.zeros_like(b.force), np.zeros_like(b.moment)] for b in self.all
        }
        for active in contacts:
            force, moment = active.totals()
            both = sums[id(active.contact.body)]
            both[0] = both[0] + force
            both[1] = both[1] + moment
            active.contact.dissipated += active.dissipated()
        if self.given is None:
            self.given = sum(active.stored(before=True) for active in contacts)
        self.stored = sum(active.stored() for active in contacts)
        before, self._before = self._before, 0.0
        mean = any(active.means is not None for active in contacts)
        works = [body.commit(*sums[id(body)], mean=mean) for body in self.all]
        return before + sum(works)

    def record(self) -> dict[str, dict[str, list[float]]]:
        """What records of steps have of the bodies, by name."""
        return {body.name: body.record() for body in self.all}

    def acting(self, operator: Any) -> list[ActiveContact]:
        """Their contacts in the equations of a step.

        Args:
            operator: The equations.
        """
        return [operator.of(contact) for contact in self.contacts]

    def state(self) -> dict[str, Any]:
        """What they, and their contacts, keep from step to step."""
        if not self.all:
            return {}
        rows = {f"rigid body {k}": body.state() for k, body in enumerate(self.all)}
        rubbed = np.array([c.dissipated for c in self.contacts])
        stored = np.array([self.stored, math.nan if self.given is None else self.given])
        return {**rows, "friction's work": rubbed, "stored in contact": stored}

    def set_state(self, state: Mapping[str, Any]) -> None:
        """Take what `state` returned."""
        for k, body in enumerate(self.all):
            body.set_state(state[f"rigid body {k}"])
        self.own()
        if self.all:
            for contact, done in zip(self.contacts, state["friction's work"]):
                contact.dissipated = float(done)
            self.stored, given = (float(energy) for energy in state["stored in contact"])
            self.given = None if math.isnan(given) else given


def _same(one: Contact, other: Contact) -> bool:
    """Whether two contacts are of one body, and points or faces of points are in both."""
    if one.body is not other.body or one.points is not other.points:
        return False
    if one.tags is not None and other.tags is not None and not set(one.tags) & set(other.tags):
        return False
    return one.surface is other.surface or one.surface is None or other.surface is None
