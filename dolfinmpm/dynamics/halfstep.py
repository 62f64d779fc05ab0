"""Kinetic energy at the time of positions in explicit steps: velocities are half a step behind.

A step takes velocities from t − ½ Δt to t + ½ Δt by the forces at t. So the energy that it keeps is
½ v(t − ½ Δt) · M v(t + ½ Δt) and what is stored at t: the kinetic energy of the points' velocities
and ½ Δt f · v, half of what the forces at t would do in the last step. With ½ v · M v alone
energies swing by a share of the step times the frequency. (Hairer, Lubich & Wanner 2003, "Geometric
numerical integration illustrated by the Störmer–Verlet method", doi 10.1017/S0962492902000144.)

A run begins with half a step, from velocities at t = 0. There ½ v · M v exceeds this energy by
½ Δv · M Δv, with the change Δv in the half step. The energy of a run includes this number.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm.contact.activerigidcontact import ActiveRigidContact
from dolfinmpm.contact.rigidbodies import RigidBodies

__all__ = ["lateness", "lateness_by_contact", "mapping_loss"]

Array = npt.NDArray[np.float64]


def lateness(net: float, internal: float, grid: float, stress_is_late: bool) -> float:
    """Lateness: kinetic energy at the time of positions less that of the velocities (J).

    Args:
        net: Work of loads in the last step less the named losses in the step (J).
        internal: Work of the new stresses on the strain of the step (J).
        grid: Change of the nodes' kinetic energy in the step (J).
        stress_is_late: Whether stress and strain are those before the motion of the points, as in
            "usf". Then velocities are half a step ahead of stress and strain.
    """
    if stress_is_late:
        return 1.5 * net - grid - 0.5 * internal
    return 0.5 * (net - internal)


def mapping_loss(old: Array, change: Array, new: Array, mass: Array, filtered: bool) -> float:
    """Kinetic energy that a mapping takes from the points of this rank in a step (J).

    A mapping may slow the points. If strains follow the new velocities, the strains then also lose
    half a step's work of the forces. So the loss of energy at the time of positions uses the mean
    of new and old velocities. It does not use the mean of new velocities and velocities by forces
    alone.

    Args:
        old, new: Velocities before and after the step (m/s), shape (points, d).
        change: Change of velocities by forces alone (m/s), shape (points, d).
        mass: Masses of the points (kg), shape (points,).
        filtered: Whether strains follow the new velocities, as in "musl" and "usf".
    """
    lost = old + change - new
    mean = old + new if filtered else old + change + new
    return 0.5 * float(mass @ np.sum(lost * mean, axis=1))


def lateness_by_contact(
    bodies: RigidBodies, contacts: Sequence[ActiveRigidContact], comm: MPI.Intracomm
) -> tuple[float, float]:
    """Lateness of the velocities of points and of free bodies by contact (J). Collective.

    Args:
        bodies: The bodies, at their poses at the end of the step, before `commit`.
        contacts: The contacts, with the forces at the end of the step.
        comm: Communicator of the points.
    """
    own = sum(float(np.sum(one.forces * (one.x - one.corners.x))) for one in contacts)
    points = 0.5 * comm.allreduce(own, op=MPI.SUM)
    moved = 0.0
    for body in bodies.free:
        assert body.freedom is not None
        force = body.freedom.external(body.time + body.dt)
        for one in contacts:
            if one.contact.body is body:
                force = force + np.concatenate(one.totals())
        free = body.freedom.free
        moved += 0.5 * float(force[free] @ body.freedom.increment[free])
    return points, moved
