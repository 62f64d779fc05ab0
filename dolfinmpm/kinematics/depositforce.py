"""The body force of layered ground in the balance of effective stress, as fields of the points."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
import ufl
from mpi4py import MPI
from ufl.core.expr import Expr

from dolfinmpm._platform.errors import ParameterError, call_together
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.kinematics.groundunits import warn_of_weights

if TYPE_CHECKING:
    from dolfinmpm.kinematics.deposits import Deposit

__all__ = ["effective_force"]

Array = npt.NDArray[np.float64]


def effective_force(ground: Deposit, points: MaterialPoints) -> Expr:
    """See `Deposit.body_force`. Collective."""
    values = call_together(points.comm, lambda: ground.effective_weight(points["x"].T))
    weight = points.add_field("effective_weight", (), "N/m^d")
    points["effective_weight"] = values
    warn_of_weights(points, values)
    weight.first = lambda x: _weight_of_fill(ground, x)
    level: list[Expr] = [ufl.as_ufl(0.0)] * (points.gdim - 1)
    if callable(ground.water_table) and level:
        x, half = points["x"].T, points["l"].T
        flow = call_together(points.comm, lambda: _seepage(ground, x, half))
        seepage = points.add_field("seepage_force", (points.gdim - 1,), "N/m^d")
        points["seepage_force"] = flow
        size = points.comm.allreduce(float(half.max(initial=0.0)), MPI.MAX)
        seepage.first = lambda x: _seepage(ground, x, np.full(x.shape, size))
        level = list(seepage)
    return ufl.as_vector([*level, -weight])


def _weight_of_fill(ground: Deposit, x: Array) -> Array:
    """Effective weights (N/m³) of points that come later, at first positions x, shape (n,).

    Raises:
        ParameterError: Points lie above the surface of the ground, which knows no weight there.
    """
    above = np.flatnonzero(ground.vertical_stress(x) >= 0.0)
    if above.size:
        raise ParameterError(
            f"new points lie above the surface of the deposit, the first at {x[:, above[0]]} m. "
            "The load of the form is the weight of the deposit: give the new points their weight, "
            'fill.add_field("effective_weight", (), "N/m^d", 19e3), before points.add(fill)'
        )
    return ground.effective_weight(x)


def _seepage(ground: Deposit, x: Array, half: Array) -> Array:
    """−∂p/∂x in horizontal directions (N/m³), shape (n, gdim − 1), as means over domains.

    Differences over the domains of the points need no derivative of the table, which has kinks.
    """
    force = np.zeros((x.shape[1], len(x) - 1))
    for i in range(len(x) - 1):
        step = np.zeros_like(x)
        step[i] = half[i]
        fall = ground.pore_pressure(x - step) - ground.pore_pressure(x + step)
        force[:, i] = fall / (2 * half[i])
    return force
