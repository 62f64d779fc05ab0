"""Equilibrium paths past limit points: the load factor is an unknown beside the increment."""

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
from dolfinmpm._platform.collective import collective
from dolfinmpm._platform.errors import ConvergenceError, ParameterError, raise_together
from dolfinmpm._platform.uncopied import FOUND, unchanged
from dolfinmpm.basis.conditions import Condition
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.forms.formchecks import check_form
from dolfinmpm.solve.agreement import of_step
from dolfinmpm.solve.arguments import (
    as_read,
    check_conditions,
    check_path,
    check_updates,
    increments_of,
)
from dolfinmpm.solve.bordered import Bordered
from dolfinmpm.solve.failures import advice_on
from dolfinmpm.solve.loadfactor import Constraint, LoadFactor
from dolfinmpm.solve.path import PathBorder
from dolfinmpm.solve.problemchecks import refuse_field_tags, refuse_time
from dolfinmpm.solve.quasistatic import QuasiStatic
from dolfinmpm.solve.scheme import Static
from dolfinmpm.solve.step import Failed, Step, StepRecord

__all__ = ["ArcLength", "ArcRecord"]


@unchanged(FOUND)
@dataclass
class ArcRecord(StepRecord):
    """Report of one step along the path.

    Attributes:
        factor: Load factor λ at the end of the step.
        displacement: Under displacement control: the controlled displacement since the first
            step (m). Else: the root mean square of the points' displacements, weighted by
            volume (m).
        length: Length of the step (m).
    """

    factor: float = 0.0
    displacement: float = 0.0
    length: float = 0.0


class Pace:
    """Rule for the length of the next step along a path.

    Ramm's rule is ℓ √(n*/n) (1981, doi 10.1007/978-3-642-81589-8_5). Here n is the number of
    iterations of a step, and n* is the target.

    In yielding bodies even short steps may take more than n* iterations. Ramm's rule alone would
    then shorten the steps for ever. So n* becomes one more than the smallest n of the last steps.
    A step with at most that number of iterations is followed by a longer step. So the lengths
    recover after a failure.

    Args:
        target: Target number of iterations, where it can be reached.
        longest: Largest length (m).

    Attributes:
        counts: Numbers of iterations of the last steps.
    """

    remembered = 8
    growth = 1.25

    def __init__(self, target: int, longest: float):
        self._target, self._longest = target, longest
        self.counts: list[int] = []

    def next(self, length: float, iterations: int) -> float:
        """The next length (m).

        Args:
            length: Length of the last step (m).
            iterations: Iterations of the last step.
        """
        self.counts = [*self.counts, iterations][-self.remembered :]
        least = min(self.counts)
        # not beyond twice the target: slowly growing lengths would end in failures
        aim = max(self._target, min(least + 1, 2 * self._target))
        ratio = math.sqrt(aim / iterations)
        if iterations <= least:
            ratio = max(ratio, self.growth)
        size = abs(length) * min(2.0, max(0.5, ratio))
        return math.copysign(min(size, self._longest), length)


class AlongPath(Static):
    """Scheme of static steps with an unknown load factor. It keeps the path and the step length.

    Attributes:
        path: The load factor, its equation and the length of the next step.
        pace: The rule for the length of the next step.
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
    """Quasi-static problem with an unknown load factor λ: it follows rising and falling loads.

    λ multiplies one or several constants of the form. A step goes a given length along the
    equilibrium path; see `Constraint` for the definition of the length.

    The predictor follows the tangent of the path. Its sign is chosen so that the path does not
    turn back on the last increment. The material points carry the last increment from grid to
    grid. The next length aims at a target number of iterations, see `Pace`. A step that does not
    converge leaves the state unchanged, and is halved.

    Constants of the form other than the load keep their values. Prescribed increments must be
    zero.

    Args:
        form: Weak form; see `QuasiStatic`.
        increment: The unknown function, or functions. The first is the displacement.
        points: Material points. They get the field `arc_increment` (m), shape (gdim,).
        bcs: Essential conditions, with zero increments.
        load: Constants that λ multiplies. Their present values are the load at λ = 1. Later they
            hold λ times these values.
        length: Length of the first step (m). May be left out if `control` is a name.
        first: Change of λ aimed at by the first step, if no length is given. Its sign is the
            direction in which the path starts, in any case. In a state under load, the mean
            flexibility so far converts it to a length. So a path may start at a limit point.
        control: "spherical", "cylindrical", or a form that is linear in the test function. The
            value of the form for the increment is the length, such as
            `surface.mean((0, -1), v)`: displacement control. This length may be negative.
        factor: First λ, for a state that carries a share of the load already.
        target_iterations: Target number of iterations per step; see `Pace`.
        max_length: Largest length of a step (m).
        options: Options of `QuasiStatic`; `max_halvings` bounds the halvings of a step.

    Attributes:
        path: The load factor, its equation and the length of the next step.
        history: One record per step, with λ and displacement.

    Raises:
        ParameterError: An argument has the wrong type or a value outside its range.
        FormError: The load is not in the form, or the control is not a form over the points.

    The first step aims at a tenth of the load:

    >>> import dolfinmpm as mpm
    >>> from mpi4py import MPI
    >>> grid = mpm.create_lattice(MPI.COMM_WORLD, [range(5), range(5)])
    >>> points = mpm.fill(grid, mpm.Box((0, 0), (4, 2)), per_cell=2, density=2000.0)
    >>> V = mpm.Space(grid, "gimp")
    >>> from dolfinx import fem
    >>> load = fem.Constant(grid, (0.0, -1e4))
    >>> F = mpm.momentum(mpm.materials.Hencky(E=1e6, nu=0.0), points, V.increment, V.test)
    >>> F += mpm.Surface(points, lambda x: x[1] > 1.9, (0, 1)).traction(load, V.test)
    >>> problem = mpm.ArcLength(F, V.increment, points, mpm.fixed(V, "bottom"), load=load)
    >>> record = problem.step()
    >>> round(record.factor, 3), load.value.round(0).tolist()
    (0.1, [0.0, -1001.0])
    """

    history: list[ArcRecord]  # type: ignore[assignment]
    scheme: AlongPath
    _takes_scheme = False

    @collective
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
        given, bcs = as_read(bcs), check_conditions(bcs, spaces)
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
        # each point carries its last increment from grid to grid and from rank to rank
        trail = points.add_field("arc_increment", (points.gdim,), "m")
        updates["arc_increment"] = u
        scheme = AlongPath()
        super().__init__(form, increment, points, bcs, updates=updates, scheme=scheme, **options)
        self.essential_conditions.read = given
        refuse_field_tags(self.fields, "ArcLength", "take QuasiStatic")
        if self.bodies.free:
            raise ParameterError(
                f"'{self.bodies.free[0].name}' is free: an arc length finds a load factor and no "
                "rigid motion; prescribe its motion, or take QuasiStatic"
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
        self.loads.accept()
        self.path.factor = float(factor)

    @property
    def factor(self) -> float:
        """Load factor λ in the present state."""
        return self.path.factor

    @collective(compared=of_step)
    def step(self, t: float | None = None) -> ArcRecord:
        """Take one step along the path. Collective.

        Args:
            t: None; this problem has no time.

        Raises:
            ParameterError: A time is given, or the load was set by hand.
            ConvergenceError: The step did not converge after all halvings.
            PointsOutsideGridError: Points would leave the grid.

        After an error the state and the load are those of the last step.
        """
        if t is not None:
            refuse_time(t, type(self).__name__)
        raise_together(self.comm, self.path.load.error_in_constants())
        started, watch = time.perf_counter(), stages.Watch()
        self._record = record = ArcRecord()
        self._follow_leaves()
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
            self.loads.accept()
        assert path.length is not None
        # the predictor and the corrections of the successful attempt alone
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
        """Message about a step that failed after all halvings. Collective."""
        return (
            f"step {len(self.history) + 1} of the path failed at the load factor {self.factor:.6g} "
            f"with a length of {self.path.length or math.nan:.3g} m: {failed.reason}; the relative "
            f"out-of-balance force is {self.last_residual} (tolerance {self.tolerance:g}), the "
            f"worst is {failed.worst}. The state is that before the step: choose another control, "
            f"or {advice_on(self)}"
        )
