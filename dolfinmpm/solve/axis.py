"""What holds a body of revolution on its axis."""

from __future__ import annotations

import numpy as np
from mpi4py import MPI

from dolfinmpm._platform.errors import FreeAxisWarning, warn
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.cut.activation import Activation

__all__ = ["warn_of_free_axis"]

# A domain that ends so close to the axis, by its half-length, reaches it
_TOUCHES = 0.01


def warn_of_free_axis(points: MaterialPoints, here: Activation) -> None:
    """Warn where axisymmetric bodies reach the axis and nodes there may leave it. Collective.

    Args:
        points: Material points.
        here: What takes part; its first field is the displacement.
    """
    if not points.axisymmetric or here.unknowns.fields[0].components != points.gdim:
        return
    x, half, first = points["x"][:, 0], points["l"][:, 0], here.fields[0]
    touches = bool(np.any(x - half < _TOUCHES * half))
    on_axis = first.basis.node_coordinates()[first.nodes, 0] <= 1e-9 * x.max(initial=0.0)
    free = int(np.sum(~here.unknowns.fields[0].fixed[first.nodes[on_axis], 0]))
    touches, free = (points.comm.allreduce(k, op=MPI.MAX) for k in (touches, free))
    if touches and free:
        warn(
            points.comm,
            f"the body reaches the axis x[0] = 0, and {free} nodes there are free to move radially,"
            ' as no material can; hold them with mpm.rollers(space, "left")',
            FreeAxisWarning,
        )
