"""Energies and momenta of a moving body, and the work that is done on it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numba
import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm.body.axisymmetry import full_gradient
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.dynamics.passes import FAST
from dolfinmpm.solve.operator import Operator

__all__ = ["Balance", "Energies", "Work", "angular_momentum", "momentum_of", "stress_volumes"]

Array = npt.NDArray[np.float64]


@numba.njit(cache=True, error_model="numpy", fastmath=FAST)
def _kinetic(density, V0, v):
    """½ Σ m v² (J) of points, whose mass is that of their first volume."""
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
        moment: Moments B of the points' affine velocities (m²/s), shape (points, d, d), which add
            Σ m (B₂₁ − B₁₂) and its like in 3D.
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


def stress_volumes(points: MaterialPoints, declarations: Sequence, V: Array) -> Array:
    """Volumes on which stresses act (m^d), shape (points,): in the linear theory the first ones.

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


@dataclass
class Work:
    """Work done since the first step (J; a metre across in 2D, the whole of rings).

    Attributes:
        external: By loads, prescribed motions and rigid bodies.
        internal: By stresses on strains.
    """

    external: float = 0.0
    internal: float = 0.0

    def add(
        self,
        points: MaterialPoints,
        new: dict[str, Array],
        operator: Operator,
        external: float,
    ) -> None:
        """Add the work of a step, whose new state is not yet the points'. Collective.

        Stress is taken as the mean of the states before and after, which is second order.

        Args:
            points: The points before the step.
            new: Their fields after it.
            operator: The step's equations, moved to the increments.
            external: Work of loads, prescribed motions and rigid bodies (J).
        """
        d, at = points.strain_dim, operator.points
        H = full_gradient(points, *at.motion(operator.here.movers))
        # rate of deformation at the middle of the step
        rate = H @ np.linalg.inv(np.eye(d) + 0.5 * H)
        declarations = operator.form.parts.declarations
        before = stress_volumes(points, declarations, points["V"])
        after = stress_volumes(points, declarations, new["V"])
        for declaration in declarations:
            if declaration.strain == "small":
                # in the linear theory nothing turns
                rate[declaration.rows] = H[declaration.rows]
        sigma = new["stress"] if "stress" in new else points["stress"]
        old = before[:, None, None] * points["stress"][:, :d, :d]
        later = after[:, None, None] * sigma[:, :d, :d]
        internal = 0.5 * float(np.sum((old + later) * rate))
        self.internal += points.comm.allreduce(internal, op=MPI.SUM)
        self.external += external


@dataclass(frozen=True)
class Energies:
    """Energies of a body (J; a metre across in 2D, the whole of rings).

    Attributes:
        kinetic: ½ Σ m v².
        strain: Elastic energy that the laws store; not a number if one does not know its own.
        dissipated: Work of the stresses less what is stored.
        external: Work of loads, prescribed motions and rigid bodies.
    """

    kinetic: float
    strain: float
    dissipated: float
    external: float

    @staticmethod
    def of(points: MaterialPoints, declarations: Sequence[Any], work: Work) -> Energies:
        """Those of the present state. Collective."""
        kinetic = kinetic_energy(points)
        strain = 0.0
        for declaration in declarations:
            stored = declaration.energy()
            strain += (
                math.nan
                if stored is None
                else float(stored @ points.fields.read("V0")[declaration.rows])
            )
        both = points.comm.allreduce(np.array([kinetic, strain]), op=MPI.SUM)
        return Energies(
            float(both[0]), float(both[1]), work.internal - float(both[1]), work.external
        )


class Balance:
    """What energy there was and is in explicit steps, and whether more comes than is brought.

    Args:
        points: Material points.
        scaling: Factor of their mass in the inertia.
        declarations: Laws in the form.

    Attributes:
        work: Work done since the first step.
    """

    def __init__(self, points: MaterialPoints, scaling: float, declarations: Sequence[Any]):
        self.work = Work()
        self._points, self._scaling, self._laws = points, scaling, declarations
        self._first: float | None = None
        self._last = self._most = 0.0

    def fault(self, begins: bool = False) -> str | None:
        """What is wrong if energy comes from nowhere, or None. Collective.

        What moves may lose energy to the grid and gain a little in "usf"; more than half of all
        that there ever was in any form comes from a step that is too long.

        Args:
            begins: Whether a call of `step` begins: what the user gave the points before it
                does not come from nowhere.
        """
        points, work = self._points, self.work
        kinetic = self._scaling * kinetic_energy(points)
        kinetic = points.comm.allreduce(kinetic, op=MPI.SUM)
        total = kinetic + work.internal - work.external
        if self._first is None:
            self._first = self._last = total
            # of a body under stress: its work in an increment is that of a large stress
            stored = Energies.of(points, self._laws, work).strain
            self._most = abs(stored) if math.isfinite(stored) else 0.0
        if begins:
            self._first += total - self._last
        self._last = total
        self._most = max(self._most, abs(self._first), abs(work.external))
        gained = total - self._first
        if math.isfinite(total) and not gained > 0.5 * self._most > 0.0:
            return None
        return (
            f"{gained:.4g} J have come from nowhere beside {self._most:.4g} J of first energy "
            "and work of loads"
        )

    def forget(self) -> None:
        """Begin anew from the next state, as the first one."""
        self._first, self._last, self._most = None, 0.0, 0.0
