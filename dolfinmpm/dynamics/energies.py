"""Kinetic energy and momenta of the points, and the time of the kinetic energy of explicit steps.

Velocities of explicit steps are half a step behind positions. A step takes velocities from
t − ½ Δt to t + ½ Δt by the forces at t. So the energy that it keeps is
½ v(t − ½ Δt) · M v(t + ½ Δt) and what is stored at t: the kinetic energy of the points' velocities
and ½ Δt f · v, half of what the forces at t would do in the last step. This half-step energy is
the kinetic energy at the time of positions less that of the velocities. With ½ v · M v alone
energies swing by a share of the step times the frequency. (Hairer, Lubich & Wanner 2003, "Geometric
numerical integration illustrated by the Störmer–Verlet method", doi 10.1017/S0962492902000144.)

A run begins with half a step, from velocities at t = 0. There ½ v · M v exceeds this energy by
½ Δv · M Δv, with the change Δv in the half step. The energy of a run includes this number.
"""

from __future__ import annotations

from collections.abc import Sequence

import numba
import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.contact.activerigidcontact import ActiveRigidContact
from dolfinmpm.contact.rigidbodies import RigidBodies
from dolfinmpm.dynamics.passes import FAST
from dolfinmpm.grid.tensors import invert

__all__ = [
    "angular_momentum",
    "by_contact",
    "fastest_point",
    "half_step",
    "kinetic_energy",
    "mapping_loss",
    "momentum_of",
    "stress_volumes",
    "stress_works",
]

Array = npt.NDArray[np.float64]


@numba.njit(cache=True, error_model="numpy", fastmath=FAST)
def _kinetic(density, V0, v):
    """½ Σ m v² (J) of points; the mass is the density times the initial volume."""
    total = 0.0
    for p in range(v.shape[0]):
        square = 0.0
        for i in range(v.shape[1]):
            square += v[p, i] * v[p, i]
        total += density[p] * V0[p] * square
    return 0.5 * total


def kinetic_energy(points: MaterialPoints) -> float:
    """½ Σ m v² of this rank's points (J)."""
    read = points.fields.read
    return float(_kinetic(read("density"), read("V0"), read("velocity")))


def momentum_of(points: MaterialPoints) -> Array:
    """Linear momentum of a body (kg m/s), shape (d,). Collective."""
    read = points.fields.read
    return points.comm.allreduce(read("density") * read("V0") @ read("velocity"), op=MPI.SUM)


def angular_momentum(points: MaterialPoints, moment: Array | None = None) -> Array:
    """Angular momentum about the origin (kg m²/s): shape (1,) in 2D, (3,) in 3D. Collective.

    Args:
        points: Material points with velocities.
        moment: Moments B of the points' affine velocities (m²/s), shape (points, d, d). They add
            Σ m (B₂₁ − B₁₂), and the corresponding components in 3D.
    """
    read = points.fields.read
    m, more = read("density") * read("V0"), (0, 3 - points.gdim)
    x, v = (np.pad(read(name), ((0, 0), more)) for name in ("x", "velocity"))
    own = np.cross(x, v)
    if moment is not None:
        B = np.pad(moment, ((0, 0), more, more))
        own += np.stack([B[:, k, j] - B[:, j, k] for j, k in ((1, 2), (2, 0), (0, 1))], axis=1)
    total = points.comm.allreduce(m @ own, op=MPI.SUM)
    return total[2:] if points.gdim == 2 else total


def fastest_point(points: MaterialPoints) -> str:
    """Number, position and speed of the fastest point of all ranks, as text. Collective."""
    speed, worst = np.linalg.norm(points["velocity"], axis=1), None
    if len(points):
        p = int(np.argmax(np.where(np.isfinite(speed), speed, np.inf)))
        worst = (float(speed[p]), int(points["id"][p]), points["x"][p].tolist())
    found = [w for w in points.comm.allgather(worst) if w is not None]
    fastest = max(found)
    return f"{fastest[1]} at {fastest[2]} m with {fastest[0]:.3g} m/s"


def stress_volumes(points: MaterialPoints, declarations: Sequence, V: Array) -> Array:
    """Volumes on which stresses act (m^d), shape (points,); initial volumes for small strains.

    Args:
        points: Material points.
        declarations: Laws in the form.
        V: Volumes (m^d), shape (points,); not changed.
    """
    found = V.copy()
    for declaration in declarations:
        if declaration.strain == "small":
            found[declaration.rows] = points["V0"][declaration.rows]
    return found


@numba.njit(cache=True, error_model="numpy", fastmath=FAST)
def stress_works(H, linear, before, old, after, new):
    """Works of the stresses before and after a step on the strain of the step (J).

    The strain is the rate of deformation at the middle of the step, H (I + H/2)⁻¹, or H itself in
    the linear theory, which has no rotations. One pass over the points, because the energies are
    part of every step.

    Args:
        H: Gradients of the increment, shape (n, d, d).
        linear: Whether the linear theory holds, shape (n,).
        before, after: Volumes on which the stresses act (m^d), shape (n,).
        old, new: Stresses (Pa), shape (n, 3, 3).
    """
    n, d = H.shape[0], H.shape[1]
    A, inverse = np.empty((d, d)), np.empty((d, d))
    at_start = at_end = 0.0
    for p in range(n):
        for i in range(d):
            for j in range(d):
                A[i, j] = 0.0 if linear[p] else 0.5 * H[p, i, j]
            A[i, i] += 1.0
        invert(A, inverse)
        was = now = 0.0
        for i in range(d):
            for j in range(d):
                rate = 0.0
                for k in range(d):
                    rate += H[p, i, k] * inverse[k, j]
                was += old[p, i, j] * rate
                now += new[p, i, j] * rate
        at_start += before[p] * was
        at_end += after[p] * now
    return at_start, at_end


def half_step(net: float, internal: float, grid: float, stress_first: bool) -> float:
    """Half-step energy: kinetic energy at the time of positions less that of the velocities (J).

    Args:
        net: Work of loads in the last step less the named losses in the step (J).
        internal: Work of the new stresses on the strain of the step (J).
        grid: Change of the nodes' kinetic energy in the step (J).
        stress_first: Whether stress and strain are those before the motion of the points, as in
            "usf". Then velocities are half a step ahead of stress and strain.
    """
    if stress_first:
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


def by_contact(
    bodies: RigidBodies,
    contacts: Sequence[ActiveRigidContact],
    comm: MPI.Intracomm,
    stress_first: bool = False,
) -> tuple[float, float]:
    """Half-step energy of the velocities of points and of free bodies by contact (J). Collective.

    Args:
        bodies: The bodies, at their poses at the end of the step, before `commit`.
        contacts: The contacts, with the forces at the end of the step.
        comm: Communicator of the points.
        stress_first: See `half_step`. Contact has the time of the positions all the same.
    """
    own = sum(float(np.sum(one.forces * (one.x - one.corners.x))) for one in contacts)
    points = (1.5 if stress_first else 0.5) * comm.allreduce(own, op=MPI.SUM)
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
