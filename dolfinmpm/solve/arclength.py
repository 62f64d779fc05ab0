"""Paths of equilibrium past limit points: the load factor is found with the increment."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI

from dolfinmpm._platform import stages
from dolfinmpm._platform.errors import ConvergenceError, ParameterError
from dolfinmpm._platform.together import together
from dolfinmpm.basis.conditions import Condition
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.forms.formchecks import check_form
from dolfinmpm.solve.agreement import of_step
from dolfinmpm.solve.arguments import (
    check_conditions,
    check_path,
    check_updates,
    increments_of,
)
from dolfinmpm.solve.bodyfields import refuse_bodies
from dolfinmpm.solve.bordered import Bordered
from dolfinmpm.solve.loadfactor import Constraint, LoadFactor
from dolfinmpm.solve.path import PathBorder
from dolfinmpm.solve.quasistatic import QuasiStatic
from dolfinmpm.solve.scheme import Static
from dolfinmpm.solve.step import Failed, Step, StepRecord
from dolfinmpm.solve.timeless import refuse_time

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


class Pace:
    """How long the next step along a path is to be.

    Ramm's rule ℓ √(n*/n) (1981, doi 10.1007/978-3-642-81589-8_5), n being a step's
    iterations. Where even short steps take more than n* of them, as those of yielding
    bodies do, the rule alone shortens them for ever: n* is then what the best of the last
    steps took, and one more; and a step that took no more than that is followed by a longer
    one, so that lengths come back after a failure.

    Args:
        target: Iterations aimed at, where they are enough.
        longest: Bound of the lengths (m).

    Attributes:
        counts: Iterations of the last steps.
    """

    remembered = 8
    growth = 1.25

    def __init__(self, target: int, longest: float):
        self._target, self._longest = target, longest
        self.counts: list[int] = []

    def next(self, length: float, iterations: int) -> float:
        """The next length (m).

        Args:
            length: Length of the step (m).
            iterations: Iterations that it took.
        """
        self.counts = [*self.counts, iterations][-self.remembered :]
        least = min(self.counts)
        # not beyond twice the target: lengths that creep up would end in failures
        aim = max(self._target, min(least + 1, 2 * self._target))
        ratio = math.sqrt(aim / iterations)
        if iterations <= least:
            ratio = max(ratio, self.growth)
        size = abs(length) * min(2.0, max(0.5, ratio))
        return math.copysign(min(size, self._longest), length)


class AlongPath(Static):
    """Static steps whose load factor is found; it keeps the path, and the length of a step.

    Attributes:
        path: The load factor, its equation and the length of the next step.
        pace: How long the next step is to be.
    """

    record = ArcRecord
    path: PathBorder
    pace: Pace

    def identity(self) -> dict[str, Any]:
        """See `Scheme`."""
        load, kind = self.path.load.describe(), self.path.constraint.kind
        return {"load at factor 1": load, "control": kind}

    def state(self) -> dict[str, Any]:
        """See `Scheme`."""
        path = self.path
        return {
            "factor": path.factor,
            "length": path.length,
            "last_change": path.last_change,
            "psi": path.constraint.psi,
            "travelled": path.travelled,
            "counts": np.array(self.pace.counts, np.int64),
        }

    def set_state(self, values: Mapping[str, Any]) -> None:
        """See `Scheme`."""
        path = self.path
        path.factor, path.travelled = values["factor"], values["travelled"]
        self.pace.counts = values["counts"].tolist()
        path.length, path.last_change = values["length"], values["last_change"]
        path.constraint.psi = values["psi"]
        path.load.set(path.factor)


class ArcLength(QuasiStatic):
    """Quasi-static problem whose load factor λ is unknown: it follows rising and falling loads.

    λ multiplies one or several constants of the form. A step goes a given length
    along the path of equilibrium; see `Constraint` for what length means. The
    predictor follows the tangent in the direction that does not turn back on the last
    increment of the material points, which they carry along from grid to grid. The
    next length is such that it takes about as many iterations as are aimed at, see `Pace`; a
    step that does not converge leaves the state as it was and is halved.

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
            says where the path starts to in any case. In a state that carries load already it
            is measured by the mean flexibility so far, so that a path may start at a limit.
        control: "spherical", "cylindrical", or a form that is linear in the test
            function, whose value for the increment is the length, such as
            `surface.mean((0, -1), v)`: displacement control. Its length may be negative.
        factor: λ at first, for a state that carries a share of the load already.
        target_iterations: Iterations that a step is to take; see `Pace`.
        max_length: Bound of the lengths (m).
        options: Options of `QuasiStatic`; `max_halvings` bounds the halvings of a step.

    Attributes:
        path: The load factor, its equation and the length of the next step.
        history: One record per step, with λ and displacement.

    Raises:
        ParameterError: An argument is not what it may be.
        FormError: The load is not in the form, or the control is no form of the points.
    """

    history: list[ArcRecord]  # type: ignore[assignment]
    scheme: AlongPath
    _takes_scheme = False

    @together
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
        increments = increments_of(increment, points)
        u, spaces = increments[0], [v._dolfinmpm_space for v in increments]
        bcs = check_conditions(bcs, spaces)
        check_form(form)
        updates = check_updates(options.pop("updates", None), points)
        check_path(points, u, bcs, length, first, factor, max_length, target_iterations)
        constraint = Constraint(control, u, spaces[0].test, points)
        if constraint.linear and length is None:
            raise ParameterError("displacement control needs the length of its first step (m)")
        if not constraint.linear and length is not None and length < 0:
            raise ParameterError(f"length = {length} m of an arc must be positive; see `first`")
        constants = list(load) if isinstance(load, Sequence) else [load]
        load_factor = LoadFactor(form, points.grid, constants, factor)
        # what a point did last goes with it from grid to grid and from rank to rank
        trail = points.add_field("arc_increment", (points.gdim,), "m")
        updates["arc_increment"] = u
        scheme = AlongPath()
        super().__init__(form, increment, points, bcs, updates=updates, scheme=scheme, **options)
        refuse_bodies(self.fields, "ArcLength", "take QuasiStatic")
        if self.bodies.free:
            raise ParameterError(
                f"'{self.bodies.free[0].name}' is free: an arc length finds a load factor and no "
                "rigid motion; prescribe it, or take QuasiStatic"
            )
        self.path = PathBorder(load_factor, constraint, trail, self.form.spaces, points)
        self.form.also |= self.path.moving
        self.path.length, self.path.first = length, first
        moved = self._moved()
        if factor and moved:
            self.path.speed = moved / abs(factor)
        self.solver = Bordered(self.newton, self.path)
        scheme.path, scheme.pace = self.path, Pace(target_iterations, max_length)
        load_factor.set(factor)
        self.loads.release()
        self.path.factor = float(factor)

    @property
    def factor(self) -> float:
        """Load factor λ of the present state."""
        return self.path.factor

    @together(given=of_step)
    def step(self, t: float | None = None) -> ArcRecord:
        """Take one step along the path. Collective.

        Args:
            t: None; time is of other problems.

        Raises:
            ParameterError: A time is given.
            ConvergenceError: It did not converge, however short it was made.
            PointsOutsideGridError: Points would leave the grid.

        After an error state and load are those of the last step.
        """
        refuse_time(t, type(self).__name__)
        started, watch = time.perf_counter(), stages.Watch()
        self._record = record = ArcRecord()
        path = self.path
        wanted = path.length
        try:
            while True:
                path.load.set(self.factor)
                failed = self._attempt(Step())
                if failed is None:
                    break
                if record.halvings == self.max_halvings or path.length is None:
                    raise ConvergenceError(self._lost(failed))
                record.halvings += 1
                path.length *= 0.5
        except BaseException:
            path.load.set(self.factor)
            path.length = wanted
            raise
        finally:
            self.loads.release()
        assert path.length is not None
        # of the attempt that succeeded alone: the predictor and the corrections
        last = len(record.residuals)
        path.last_change = path.load.value - self.factor
        path.factor = record.factor = path.load.value
        record.parts, record.length = 1, path.length
        path.travelled += path.length if path.constraint.linear else 0.0
        record.displacement = path.travelled if path.constraint.linear else self._moved()
        path.length = self.scheme.pace.next(path.length, last)
        record.seconds, record.stages = time.perf_counter() - started, watch.stop()
        self.history.append(record)
        return record

    def _moved(self) -> float:
        """Root mean square of the points' displacements (m). Collective."""
        points = self.points
        square = np.sum((points["x"] - points["x0"]) ** 2, axis=1) @ points["V0"]
        total = self.comm.allreduce(np.array([square, points["V0"].sum()]), op=MPI.SUM)
        return math.sqrt(total[0] / total[1])

    def _lost(self, failed: Failed) -> str:
        residuals = self._record.residuals
        last = f"{residuals[-1]:.3g}" if residuals else "none"
        return (
            f"step {len(self.history) + 1} of the path failed at the load factor {self.factor:.6g} "
            f"with a length of {self.path.length or math.nan:.3g} m: {failed.reason}; the relative "
            f"out-of-balance force is {last} (tolerance {self.newton.tolerance:g}), the worst is "
            f"{failed.worst}. The state is that before the step: choose another control, or "
            f"{self._advice()}"
        )
