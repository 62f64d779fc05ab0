"""What contact of two bodies has stored as a step starts: no more than at the end of the last.

Between steps places of the bodies that face each other, gaps, and areas are found anew. The
penalties ½ p²/ε_N would then store more than before, or less. What they lose so is spare. What they
would make beyond that is held back: all pressures q > 0 at the start are those of √s q, by
multipliers λ = −(1 − √s) q in the step's potential, so that the mean force of
`dolfinmpm.contact.means` gives back what has been stored.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

__all__ = ["RUBBED", "held_back", "stored_by"]

Array = npt.NDArray[np.float64]

# Share of friction's work that is spare, too: so what has been held back does not add up where
# bodies slide for long
RUBBED = 0.01


def held_back(
    pressures: Array, stored: Array, along: Array, kept: float, spare: float, comm: MPI.Intracomm
) -> Array:
    """Multipliers of a step (N), shape (m,). Collective.

    Args:
        pressures: −ε_N g at its start (N), shape (m,).
        stored: What penalties store with these (J), likewise.
        along: What friction stores with the tractions at the start (J), likewise.
        kept: What this rank's markers had stored at the end of the last step (J).
        spare: What its places have lost at the starts of steps so far, and not made since (J).
        comm: Communicator of the points.
    """
    q = np.maximum(pressures, 0.0)
    sums = np.array([float(stored.sum()), float(along.sum()), kept + spare])
    comm.Allreduce(MPI.IN_PLACE, sums, op=MPI.SUM)
    normal, rubbed, most = map(float, sums)
    if normal <= 0.0 or normal + rubbed <= most:
        return np.zeros_like(q)
    share = max(most - rubbed, 0.0) / normal
    return (math.sqrt(share) - 1.0) * q


def stored_by(pressures: Array, t: Array, stiffness: Array, slip: float) -> Array:
    """Energy that penalties store at each place (J), shape (m,).

    Args:
        pressures: Normal forces (N), shape (m,); those that would pull store nothing.
        t: Forces along the surface (N), shape (m, d).
        stiffness: ε_N (N/m), shape (m,).
        slip: ε_T/ε_N, or 0 where there is no friction.
    """
    k = np.where(stiffness > 0.0, stiffness, np.inf)
    stored = 0.5 * np.maximum(pressures, 0.0) ** 2 / k
    if slip:
        stored += 0.5 * np.sum(t * t, axis=1) / (slip * k)
    return np.asarray(stored)
