"""Paths of equilibrium past limit points: the load factor is found with the increment."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI

from dolfinmpm._platform.errors import ConvergenceError, ParameterError
from dolfinmpm.basis.conditions import Condition
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.solve.bordered import BorderedSystem, Constraint, LoadFactor
from dolfinmpm.solve.newton import NewtonSystem
from dolfinmpm.solve.quasistatic import QuasiStatic, StepRecord, _space_of

__all__ = ["ArcLength", "ArcRecord"]


@dataclass
class ArcRecord(StepRecord):
    """What one step along the path did.

    Attributes:
        factor: Load factor λ at its end.
        displacement: Under displacement control the controlled displacement since the
            beginning, else the root mean square of the points' displacements, by volume (m).
        length: Length of the step (m).
    """

    factor: float = 0.0
    displacement: float = 0.0
    length: float = 0.0


class ArcLength(QuasiStatic):
    """Quasi-static problem whose load factor λ is unknown: it follows rising and falling loads.

    λ multiplies one or several constants of the form. A step goes a given length
    along the path of equilibrium; see `Constraint` for what length means. The
    predictor follows the tangent in the direction that does not turn back on the last
    increment of the material points, which they carry along from grid to grid. The
    next length is ℓ √(n*/n), n being the iterations of this step; a step that does not
    converge leaves the state as it was and is halved.

    Constants of the form other than the load keep the values that they are given;
    prescribed increments must be zero.

    Args:
        form: Weak form; see `QuasiStatic`.
        increment: The function, or the functions, solved for; the first is the displacement.
        points: Material points. They get the field `arc_increment` (m), (gdim,).
        bcs: Essential conditions, of zero increments.
        load: Constants that λ multiplies. What they hold now is the load at λ = 1; from now
            on they hold λ times that.
        length: Length of the first step (m). May be left out if `control` is a name.
        first: Change of λ that the first step aims at where no length is given; its sign
            says where the path starts to in any case.
        control: "spherical", "cylindrical", or a form that is linear in the test
            function, whose value for the increment is the length, such as
            `surface.mean((0, -1), v)`: displacement control. Its length may be negative.
        factor: λ at first, for a state that carries a share of the load already.
        target_iterations: n*.
        max_length: Bound of the lengths (m).
        options: Options of `QuasiStatic`; `max_halvings` bounds the halvings of a step.

    Attributes:
        factor: λ of the present state.
        history: One record a step, with λ and displacement.

    Raises:
        ParameterError: An argument is not what it may be.
        FormError: The load is not in the form, or the control is no form of the points.
    """

    history: list[ArcRecord]  # type: ignore[assignment]
    system: BorderedSystem
    _of_step = ArcRecord

    def __init__(
        self,
        form: ufl.Form,
        increment: fem.Function | Sequence[fem.Function],
        points: MaterialPoints,
        bcs: Sequence[Condition] = (),
        *,
        load: fem.Constant | Sequence[fem.Constant],
        length: float | None = None,
        first: float = 0.1,
        control: str | ufl.Form = "spherical",
        factor: float = 0.0,
        target_iterations: int = 5,
        max_length: float = math.inf,
        **options: Any,
    ):
        u = increment[0] if isinstance(increment, Sequence) else increment
        space = _space_of(u)
        if u.ufl_shape != (points.gdim,):
            raise ParameterError(
                f"the first increment must be a displacement of {points.gdim} components, got "
                f"shape {u.ufl_shape}"
            )
        for condition in bcs:
            if isinstance(condition, Condition) and condition.changes:
                raise ParameterError(
                    f"the condition at '{condition.where}' prescribes an increment; under a load "
                    "factor only zero ones may be: press by the load or by a RigidFooting"
                )
        lengths = [length] if length is not None else []
        if not all(math.isfinite(s) and s != 0 for s in lengths) or not max_length > 0:
            raise ParameterError(
                f"length = {length} must be finite and not zero, max_length = {max_length} positive"
            )
        if first == 0 or not math.isfinite(first) or target_iterations < 1:
            raise ParameterError(
                f"first = {first} must be finite and not zero, target_iterations = "
                f"{target_iterations} at least 1"
            )
        self._constraint = Constraint(control, u, space.test, points)
        if self._constraint.linear and length is None:
            raise ParameterError("displacement control needs the length of its first step (m)")
        if not self._constraint.linear and length is not None and length < 0:
            raise ParameterError(f"length = {length} m of an arc must be positive; see `first`")
        constants = list(load) if isinstance(load, Sequence) else [load]
        self._factor = LoadFactor(form, points.grid, constants, factor)
        # what a point did last goes with it from grid to grid and from rank to rank
        self._trail = points.add_field("arc_increment", (points.gdim,), "m")
        updates = {**(options.pop("updates", None) or {}), "arc_increment": u}
        super().__init__(form, increment, points, bcs, updates=updates, **options)
        self._factor.set(factor)
        self._loads.release()
        self.factor = float(factor)
        self.system.length, self.system.first = length, first
        self._target, self._longest = target_iterations, max_length
        self._travelled = 0.0

    def _system_of(self, *arguments: Any) -> NewtonSystem:
        return BorderedSystem(arguments, self._factor, self._constraint, self._trail)

    def step(self) -> ArcRecord:
        """Take one step along the path. Collective.

        Raises:
            ConvergenceError: It did not converge, however short it was made.
            PointsOutsideGridError: Points would leave the grid.

        After an error state and load are those of the last step.
        """
        started = time.perf_counter()
        self._record = record = ArcRecord()
        system = self.system
        wanted = system.length
        try:
            while True:
                self._factor.set(self.factor)
                reason = self._attempt(1.0)
                if reason is None:
                    break
                if record.halvings == self.max_halvings or system.length is None:
                    raise ConvergenceError(self._lost(reason))
                record.halvings += 1
                system.length *= 0.5
        except BaseException:
            self._factor.set(self.factor)
            system.length = wanted
            raise
        finally:
            self._loads.release()
        assert system.length is not None
        system.last_change = self._factor.value - self.factor
        self.factor = record.factor = self._factor.value
        record.parts, record.length = 1, system.length
        self._travelled += system.length if self._constraint.linear else 0.0
        record.displacement = self._travelled if self._constraint.linear else self._moved()
        ratio = min(2.0, max(0.5, math.sqrt(self._target / system.iterations)))
        size = min(abs(system.length) * ratio, self._longest)
        system.length = math.copysign(size, system.length)
        record.seconds = time.perf_counter() - started
        self.history.append(record)
        return record

    def _memory(self) -> tuple[dict[str, Any], dict[str, Any], dict[str, Any]]:
        state, local, cells = super()._memory()
        state |= {
            "factor": self.factor,
            "length": self.system.length,
            "last_change": self.system.last_change,
            "psi": self._constraint.psi,
            "travelled": self._travelled,
        }
        return state, local, cells

    def _remember(self, state, local, cells) -> None:
        super()._remember(state, local, cells)
        self.factor, self._travelled = state["factor"], state["travelled"]
        self.system.length, self.system.last_change = state["length"], state["last_change"]
        self._constraint.psi = state["psi"]
        self._factor.set(self.factor)
        self._loads.release()

    def _problem(self) -> dict[str, Any]:
        return {
            **super()._problem(),
            "load at factor 1": self._factor.describe(),
            "control": self._constraint.kind,
        }

    def _moved(self) -> float:
        """Root mean square of the points' displacements (m). Collective."""
        points = self.points
        square = np.sum((points["x"] - points["x0"]) ** 2, axis=1) @ points["V0"]
        total = self.comm.allreduce(np.array([square, points["V0"].sum()]), op=MPI.SUM)
        return math.sqrt(total[0] / total[1])

    def _lost(self, reason: str) -> str:
        last = f"{self.system.residuals[-1]:.3g}" if self.system.residuals else "none"
        return (
            f"step {len(self.history) + 1} of the path failed at the load factor {self.factor:.6g} "
            f"with a length of {self.system.length:.3g} m: {reason}; the relative out-of-balance "
            f"force is {last} (tolerance {self._tolerance:g}), the worst is {self._worst()}. The "
            "state is that before the step: add stabilisation, or choose another control"
        )
