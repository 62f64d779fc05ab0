"""Unit weights of ground beside the densities of its points: another unit, or another quantity."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm._platform.errors import DoubtfulInputWarning, warn
from dolfinmpm.body.points import MaterialPoints

__all__ = ["warn_of_weights"]

# Accelerations γ/ρ (m/s²) that a wrong number makes. Buoyant ground has 1 to 6, and a centrifuge
# any multiple of g. A weight in kN/m³ beside a density in kg/m³ has a thousandth of these.
_KILO = 1e-4, 0.05
_SAME = 0.9999, 1.0001
_TWICE = 95.5, 96.5


def warn_of_weights(
    points: MaterialPoints, weights: npt.ArrayLike, rows: Any = slice(None)
) -> None:
    """Warn if unit weights are no weights of the points' densities. Collective.

    Args:
        points: Material points.
        weights: Unit weights at the points (N/m³), shape (rows,), or one number.
        rows: The points, all by default.
    """
    density = points["density"][rows]
    known = np.broadcast_to(np.asarray(weights, float), density.shape)
    sums = np.array([known.sum(), density.sum(), float(density.size)])
    points.comm.Allreduce(MPI.IN_PLACE, sums, op=MPI.SUM)
    if not sums[1] > 0.0:
        return
    g = sums[0] / sums[1]
    if _KILO[0] < g < _KILO[1]:
        what = "it may be in kN/m³: give it in N/m³, times 1000, or the densities in t/m³"
    elif _SAME[0] < g < _SAME[1]:
        what = "it is the density: give the density times the acceleration of gravity"
    elif _TWICE[0] < g < _TWICE[1]:
        what = "it has the acceleration of gravity twice"
    else:
        return
    warn(
        points.comm,
        f"the unit weight of the ground is {sums[0] / sums[2]:.4g} N/m³ in the mean, and the "
        f"density of its points {sums[1] / sums[2]:.4g} kg/m³, so that the weight is {g:.3g} m/s² "
        f"times the density: {what}",
        DoubtfulInputWarning,
    )
