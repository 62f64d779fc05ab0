"""Quasi-static steps in time: no inertia, but rates, such as those of pore water flow."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from mpi4py import MPI

from dolfinmpm._platform.argumentchecks import number
from dolfinmpm._platform.collective import collective
from dolfinmpm._platform.errors import ParameterError
from dolfinmpm.assembly.term import NewState
from dolfinmpm.basis.conditions import Condition
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.dynamics.clock import (
    MotionRecord,
    check_clock,
    mean_increment,
    set_velocities,
)
from dolfinmpm.dynamics.faces import split_conditions
from dolfinmpm.dynamics.timescheme import TimedScheme
from dolfinmpm.solve.arguments import as_read, check_points
from dolfinmpm.solve.newstate import new_state
from dolfinmpm.solve.operator import Operator
from dolfinmpm.solve.problemchecks import check_pressure_conditions, check_pressure_level
from dolfinmpm.solve.quasistatic import QuasiStatic
from dolfinmpm.solve.step import Step

__all__ = ["Transient"]

Array = npt.NDArray[np.float64]

# Field of the points: rate of displacement of the last step (m/s)
_RATE = "rate"


class Rates(TimedScheme):
    """Scheme of quasi-static steps in time. A rate is an increment over the length of the step.

    Args:
        points: Material points.
        error, constant: See `TimedScheme`.
    """

    def __init__(self, points: MaterialPoints, error: float | None, constant: fem.Constant | None):
        super().__init__(error, constant)
        self._points, self._tried = points, 0.0

    def begin(self, problem: Any, t: float | None) -> None:
        """See `TimedScheme`. Collective."""
        super().begin(problem, t)
        self._tried = 0.0

    def system(self, problem: Any, step: Step) -> Operator:
        """See `Static`. Collective."""
        self._points.dt.value = step.dt
        self.set_time(step.t)
        set_velocities(problem.bcs, lambda v: mean_increment(v, step))
        first = problem.here is None
        operator = super().system(problem, step)
        if first:
            check_pressure_conditions(problem.bcs, operator.here)
            check_pressure_level(operator)
        return operator

    def finish(self, problem: Any, operator: Operator, x: Array, step: Step) -> NewState | str:
        """See `Static`. Collective."""
        state = new_state(problem, operator)
        if isinstance(state, str):
            return state
        if self.error is not None:
            reason = self._judge(operator, state, step.dt)
            if reason is not None:
                return reason
        self.clock.time, self.clock.last = step.t, step.dt
        return state

    def _judge(self, operator: Operator, state: NewState, dt: float) -> str | None:
        """Check the error ½ Δt |u/Δt − rate| of a step, and choose the next length. Collective."""
        assert self.error is not None
        u, clock = operator.points.motion(operator.here.movers)[0], self.clock
        rate = u / dt
        change = rate - self._points[_RATE] if clock.begun else np.zeros_like(rate)
        both = np.array([np.abs(change).max(initial=0.0), np.abs(u).max(initial=0.0)])
        self._points.comm.Allreduce(MPI.IN_PLACE, both, op=MPI.MAX)
        # After a time at rest the change of the rate is the whole rate in substeps of any length.
        # Substeps have a part of the load, so that the displacement of the whole step is a measure.
        self._tried = max(self._tried, float(both[1]))
        allowed = self.error * max(clock.largest, self._tried)
        reason = clock.judge(dt, 0.5 * dt * both[0], allowed, 2)
        if reason is None:
            clock.largest, clock.begun = max(clock.largest, float(both[1])), True
            state.fields[_RATE] = np.asarray(rate, np.float64)
        return reason


class Transient(QuasiStatic):
    """Quasi-static steps in time: forces balance at the end of each step.

    It is for weak forms with rates and without inertia, such as consolidation; see
    `poromechanics`. A rate is an increment over `points.dt`. Each step and each substep sets the
    constant `points.dt` to its length (s).

    Args:
        form, increment, points, bcs, options: See `QuasiStatic`.
        error: Largest error of a step's displacement, as a share of the largest displacement of a
            step so far, this one included before it is halved. The error is that of backward
            Euler's rule: half the length of the step times the change of the rate. A step with a
            larger error is halved. None for no bound.
        time: DOLFINx constant that holds the time (s), for forms that depend on the time.

    The first step raises an error if a pressure is determined only up to a constant. It also does
    if a condition prescribes a pressure outside the body.

    Raises:
        ParameterError: An argument has the wrong type or a value outside its range.

    One hour of consolidation under a settlement of 1 cm:

    >>> import dolfinmpm as mpm
    >>> from mpi4py import MPI
    >>> grid = mpm.create_lattice(MPI.COMM_WORLD, [range(2), range(5)])
    >>> points = mpm.fill(grid, mpm.Box((0, 0), (1, 4)), per_cell=2, density=1800.0)
    >>> V, Q = mpm.Space(grid, "gimp"), mpm.Space(grid, "gimp", shape=())
    >>> u, v, p, q = V.increment, V.test, Q.increment, Q.test
    >>> soil = mpm.materials.Hencky(E=1e6, nu=0.0)
    >>> F = mpm.poromechanics(soil, points, (u, p), (v, q), permeability=1e-7, porosity=0.4)
    >>> bcs = mpm.fixed(V, "bottom") + mpm.fixed(Q, "top")
    >>> bcs += mpm.prescribed(V, "top", 1, increment=-0.01)
    >>> problem = mpm.Transient(F, [u, p], points, bcs)
    >>> record = problem.step(3600.0)
    >>> problem.time, points["pressure"].max().round(0).item()
    (3600.0, 3283.0)
    """

    history: list[MotionRecord]  # type: ignore[assignment]
    scheme: Rates
    _takes_scheme = False

    @collective
    def __init__(
        self,
        form: ufl.Form,
        increment: fem.Function | Sequence[fem.Function],
        points: MaterialPoints,
        bcs: Sequence[Condition] = (),
        *,
        error: float | None = None,
        time: fem.Constant | None = None,
        **options: Any,
    ):
        if error is not None:
            number("error", error, 0.0)
        conditions, faces = split_conditions(bcs)
        if faces:
            raise ParameterError(
                f"the face at '{faces[0].where}' acts on velocities, and Transient has no inertia: "
                "hold the side with mpm.rollers or mpm.fixed, or take Newmark"
            )
        check_points(points)
        check_clock(time, points.grid)
        scheme = Rates(points, error, time)
        super().__init__(form, increment, points, conditions, scheme=scheme, **options)
        self.essential_conditions.read = as_read(bcs)
        if error is not None:
            points.add_field(_RATE, (points.gdim,), "m/s")

    @property
    def time(self) -> float:
        """Time of the present state (s)."""
        return self.scheme.clock.time
