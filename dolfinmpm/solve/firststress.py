"""Points of laws that need an initial stress, and begin without one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from mpi4py import MPI

from dolfinmpm._platform.errors import DoubtfulInputWarning, warn
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.forms.declarations import Declaration
from dolfinmpm.materials.pressureelasticity import PressureElastic

__all__ = ["warn_of_unstressed"]


def warn_of_unstressed(points: MaterialPoints, declarations: Sequence[Declaration]) -> None:
    """Warn if points of Cam-Clay or NorSand begin their first step without a stress. Collective.

    Without strain these laws have a pressure, the same at all depths. It is seldom in balance with
    what lies above, and either the step fails, or the body swells at its surface.

    Args:
        points: Material points.
        declarations: Laws of the body.
    """
    for declaration in declarations:
        if not isinstance(declaration.law, PressureElastic):
            continue
        rows = declaration.rows
        bare = (points["moved_under"][rows] == 0) & ~points["stress"][rows].any(axis=(1, 2))
        count = points.comm.allreduce(int(np.count_nonzero(bare)), op=MPI.SUM)
        if count:
            warn(
                points.comm,
                f"{count} points of {type(declaration.law).__name__} begin without a given stress, "
                "under the pressure that the law has without strain (reference_pressure), the same "
                "at all depths. Give them the stress of the ground, as by mpm.set_stress(law, "
                "points, deposit.stress); if that pressure is meant, by mpm.set_stress(law, "
                "points, -pressure * np.eye(3))",
                DoubtfulInputWarning,
            )
