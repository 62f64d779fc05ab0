"""Free rigid bodies that nothing holds in a quasi-static step, which has no inertia."""

from __future__ import annotations

from collections.abc import Sequence

from mpi4py import MPI

from dolfinmpm.contact.activerigidcontact import ActiveRigidContact
from dolfinmpm.contact.rigidbody import RigidBody

__all__ = ["unsupported"]


def unsupported(
    bodies: Sequence[RigidBody], contacts: Sequence[ActiveRigidContact], reason: str, comm: MPI.Comm
) -> str:
    """What to do about a step that failed because a free body has no support. Collective.

    Args:
        bodies: The free bodies.
        contacts: The contacts, as they were looked at last.
        reason: Why the step failed.
        comm: The ranks.

    Returns:
        The advice, or an empty string where free bodies are supported.
    """
    for body in bodies:
        own = [contact for contact in contacts if contact.contact.body is body]
        touching = any(bool(contact.now.normal.any()) for contact in own)
        touches = comm.allreduce(touching, op=MPI.LOR)
        if touches and "singular" not in reason:
            continue
        what = "nothing touches it" if not touches else "contact does not hold it in all of them"
        assert body.freedom is not None
        free = ", ".join(str(c) for c in body.freedom.free)
        return (
            f"'{body.name}' is free in the components {free} of its motion, {what}, and without "
            "inertia nothing else carries its load: begin where it rests on the points, give the "
            "contact friction, prescribe the components that are not to move, "
            "free=(False, True, ...), or take Newmark and give it a mass"
        )
    return ""
