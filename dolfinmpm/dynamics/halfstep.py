"""Kinetic energy at the time of positions in explicit steps: velocities are half a step behind.

A step takes velocities from t − ½ Δt to t + ½ Δt by the forces at t. So the energy that it keeps is
½ v(t − ½ Δt) · M v(t + ½ Δt) and what is stored at t: the kinetic energy of the points' velocities
and ½ Δt f · v, half of what the forces at t would do in the last step. With ½ v · M v alone
energies swing by a share of the step times the frequency. (Hairer, Lubich & Wanner 2003, "Geometric
numerical integration illustrated by the Störmer–Verlet method", doi 10.1017/S0962492902000144.)
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm.contact.activecontact import ActiveContact
from dolfinmpm.contact.bodies import Bodies

__all__ = ["late_by_contact", "lateness", "taken"]

Array = npt.NDArray[np.float64]


def lateness(net: float, internal: float, grid: float, stress_is_late: bool) -> float:
    """What the points' kinetic energy lacks of that at the time of their positions (J).

    Args:
        net: Work of loads in the last step less what was lost in it by name (J).
        internal: Work of the new stresses on the strain of the step (J).
        grid: Change of the nodes' kinetic energy in it (J).
        stress_is_late: Whether stress and strain are those before the points moved, as in "usf":
            then velocities are half a step ahead of them.
    """
    if stress_is_late:
        return 1.5 * net - grid - 0.5 * internal
    return 0.5 * (net - internal)


def taken(old: Array, change: Array, new: Array, mass: Array, filtered: bool) -> float:
    """Kinetic energy that a mapping takes from the points of this rank in a step (J).

    Where strains follow the new velocities, a mapping that slows the points takes half a step's
    work of the forces from the strains, too: energies at the time of the positions lose by the mean
    of new and old velocities, not of new ones and those that forces alone would make.

    Args:
        old, new: Velocities before and after (m/s), shape (points, d).
        change: What forces make of them (m/s), likewise.
        mass: Masses of the points (kg), shape (points,).
        filtered: Whether strains follow the new velocities, as in "musl" and "usf".
    """
    lost = old + change - new
    mean = old + new if filtered else old + change + new
    return 0.5 * float(mass @ np.sum(lost * mean, axis=1))


def late_by_contact(
    bodies: Bodies, contacts: Sequence[ActiveContact], comm: MPI.Intracomm
) -> tuple[float, float]:
    """What velocities of points and of free bodies are late by for contact (J). Collective.

    Args:
        bodies: The bodies, put to the end of the step, before they take it.
        contacts: The contacts, with the forces there.
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
