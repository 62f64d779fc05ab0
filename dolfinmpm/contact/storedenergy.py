"""Energy that penalties of contact store, and its bound at the start of a step.

Between steps, facing contact points, gaps and areas are found anew. The penalties ½ p²/ε_N would
then store more than before, or less. Energy that they lose is spare. Energy that they would gain
beyond the spare energy is held back: all normal forces q > 0 at the start become √s q, by
multipliers λ = −(1 − √s) q in the step's potential. Then the mean force of
`dolfinmpm.contact.meanforces` gives back only energy that has been stored.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

__all__ = ["SPARE_SHARE", "bounding_multipliers", "normal_energy", "slip_energy"]

Array = npt.NDArray[np.float64]

# Share of the work of friction that is spare too. So the energy held back does not add up where
# bodies slide for long.
SPARE_SHARE = 0.01


def bounding_multipliers(
    normal_force: Array, normal: float, tangential: float, available: float, comm: MPI.Intracomm
) -> Array:
    """Multipliers of a step (N), shape (m,), with the stored energy bounded. Collective.

    Args:
        normal_force: −ε_N g at the start of the step (N), shape (m,).
        normal: Energy that these normal forces store on this rank (J).
        tangential: Energy of the tangential forces at the start of the step on this rank (J).
        available: Energy stored on this rank at the end of the last step, and spare energy (J).
        comm: Communicator of the points.
    """
    q = np.maximum(normal_force, 0.0)
    sums = np.array([normal, tangential, available])
    comm.Allreduce(MPI.IN_PLACE, sums, op=MPI.SUM)
    normal, tangential, available = map(float, sums)
    if normal <= 0.0 or normal + tangential <= available:
        return np.zeros_like(q)
    share = max(available - tangential, 0.0) / normal
    return (math.sqrt(share) - 1.0) * q


def normal_energy(normal_force: Array, stiffness: Array) -> Array:
    """Energy of the normal penalties, ½ p²/ε_N (J), shape (m,); zero for tensile forces.

    Args:
        normal_force: p (N), shape (m,).
        stiffness: ε_N (N/m), shape (m,). Points with zero stiffness store nothing.
    """
    k = np.where(stiffness > 0.0, stiffness, np.inf)
    return np.asarray(0.5 * np.maximum(normal_force, 0.0) ** 2 / k)


def slip_energy(tangential: Array, stiffness: Array, slip_share: float) -> Array:
    """Energy of elastic slip, ½ |t|²/ε_T (J), shape (m,).

    Args:
        tangential: t (N), shape (m, d).
        stiffness: ε_N (N/m), shape (m,). Points with zero stiffness store nothing.
        slip_share: ε_T/ε_N.
    """
    k = np.where(stiffness > 0.0, stiffness, np.inf)
    return np.asarray(0.5 * np.sum(tangential * tangential, axis=1) / (slip_share * k))
