"""Sums of works over the steps of a moving body; see `dolfinmpm.dynamics.ledger`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm.body.axisymmetry import full_gradient
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.dynamics.energies import stress_volumes, stress_works
from dolfinmpm.solve.operator import Operator

__all__ = ["LOSSES", "Work"]

Array = npt.NDArray[np.float64]

# Losses summed up by steps, and by points that follow the leaves; other losses are differences
LOSSES = (
    "ghost stiffness", "ghost mass", "damping", "viscosity", "friction", "collision", "merging",
)  # fmt: skip


@dataclass
class Work:
    """Sums over steps (J; per metre of thickness in 2D, of the whole body in axisymmetry).

    Attributes:
        external: Work of loads, prescribed motions and driven rigid bodies.
        internal: Work of stresses on strains.
        grid: Change of the kinetic energy of the nodes within steps.
        projected: Energy lost by the mapping in explicit steps: the points' kinetic energy if
            forces only changed their velocities, less the kinetic energy after the mapping.
        start: ½ Σ m Δv² of the nodes in the half step in which a run begins, with one Δv by forces
            alone, see `dolfinmpm.dynamics.energies`. It counts as kinetic energy.
        losses: Losses by the names of `LOSSES`.
        length: Not a sum: length of the last step (s), 0 before the first step.
        half_step, of_bodies: Not sums: half-step energy of points and of rigid bodies, see
            `dolfinmpm.dynamics.energies`.
        stress_work: Not a sum: work of the stresses at the end of the last step on its strains.
        pending: Not a sum: work of boundaries that counts in the next step, in "usf".
    """

    external: float = 0.0
    internal: float = 0.0
    grid: float = 0.0
    projected: float = 0.0
    start: float = 0.0
    losses: dict[str, float] = field(default_factory=lambda: dict.fromkeys(LOSSES, 0.0))
    length: float = 0.0
    half_step: float = 0.0
    of_bodies: float = 0.0
    stress_work: float = 0.0
    pending: float = 0.0

    @property
    def net(self) -> float:
        """External work less the losses."""
        return self.external - sum(self.losses.values())

    def add(self, other: Work) -> None:
        """Add sums of further steps."""
        self.external += other.external
        self.internal += other.internal
        self.grid += other.grid
        self.projected += other.projected
        self.start += other.start
        for name, loss in other.losses.items():
            self.losses[name] += loss
        self.half_step, self.of_bodies = other.half_step, other.of_bodies
        self.pending = other.pending

    def add_stresses(
        self, points: MaterialPoints, new: Mapping[str, Array], operator: Operator
    ) -> None:
        """Add the work of the stresses in a step, before the points get the new state. Collective.

        The stress is the mean of the states before and after the step: second order.

        Args:
            points: The points before the step.
            new: Fields of the points after the step.
            operator: The step's equations, at the increments.
        """
        H = full_gradient(points, *operator.points.motion(operator.here.movers))
        declarations = operator.form.parts.declarations
        before = stress_volumes(points, declarations, points["V"])
        after = stress_volumes(points, declarations, new["V"])
        linear = np.zeros(len(points), bool)
        for declaration in declarations:
            if declaration.strain == "small":
                linear[declaration.rows] = True
        old = points["stress"]
        both = np.array(stress_works(H, linear, before, old, after, new.get("stress", old)))
        points.comm.Allreduce(MPI.IN_PLACE, both, op=MPI.SUM)
        self.internal += 0.5 * float(both[0] + both[1])
        self.stress_work = float(both[1])

    def values(self) -> Array:
        """The sums as a row of numbers."""
        sums = self.external, self.internal, self.grid, self.projected, *self.losses.values()
        return np.array([*sums, self.start, self.length, self.half_step, self.of_bodies])

    def take(self, values: Array) -> None:
        """Restore sums returned by `values`."""
        self.external, self.internal, self.grid, self.projected = map(float, values[:4])
        self.losses = dict(zip(LOSSES, map(float, values[4:-4])))
        self.start, self.length, self.half_step, self.of_bodies = map(float, values[-4:])
