"""Points of laws that need an initial stress, and begin without one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from mpi4py import MPI

from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.forms.declarations import Declaration
from dolfinmpm.materials.pressureelasticity import PressureElastic

__all__ = ["remark_on_unstressed"]


def remark_on_unstressed(points: MaterialPoints, declarations: Sequence[Declaration]) -> str:
    """Remark for a failed first step on points of Cam-Clay or NorSand without a stress. Collective.

    Without strain these laws have a pressure, the same at all depths. In ground without weight it
    may be meant. In other ground it is not in balance with what lies above.

    Args:
        points: Material points.
        declarations: Laws of the body.

    Returns:
        The remark, or an empty string.
    """
    for declaration in declarations:
        if not isinstance(declaration.law, PressureElastic):
            continue
        rows = declaration.rows
        bare = (points["moved_under"][rows] == 0) & ~points["stress"][rows].any(axis=(1, 2))
        count = points.comm.allreduce(int(np.count_nonzero(bare)), op=MPI.SUM)
        if count:
            return (
                f". {count} points of {type(declaration.law).__name__} begin without a given "
                "stress, under the pressure that the law has without strain (reference_pressure), "
                "the same at all depths: give them the stress of the ground, as by "
                "mpm.set_stress(law, points, deposit.stress)"
            )
    return ""
