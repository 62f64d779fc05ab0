"""Kinetic energy and momenta of the points."""

from __future__ import annotations

from collections.abc import Sequence

import numba
import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.dynamics.passes import FAST

__all__ = ["angular_momentum", "fastest_point", "kinetic_energy", "momentum_of", "stress_volumes"]

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
