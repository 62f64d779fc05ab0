"""Strength reduction of a body from its present, loaded state."""

from __future__ import annotations

import numpy as np
from petsc4py import PETSc

from dolfinmpm._platform.argumentchecks import number, whole
from dolfinmpm._platform.errors import ConvergenceError, ParameterError, PointsOutsideGridError
from dolfinmpm.assembly.stencilsums import Matrix
from dolfinmpm.dynamics.transient import Transient
from dolfinmpm.forms.declarations import Declaration
from dolfinmpm.kinematics.formulations import FORMULATIONS
from dolfinmpm.solve.arclength import ArcLength
from dolfinmpm.solve.bordered import Bordered
from dolfinmpm.solve.operator import Operator
from dolfinmpm.solve.quasistatic import QuasiStatic
from dolfinmpm.solve.restart import SavedState
from dolfinmpm.study.trial import Trial, come_to_rest, held, largest_norm

__all__ = ["FromState"]

# Field of the points: positions before the reduction of strength (m)
_BEFORE = "x_before_reduction"
# Shortest step of the reduction, relative to the first one; a trial fails below it
_SHORTEST = 1 / 8
# Length of a step at the reduced strength, relative to a step of the reduction: water hardly flows
_LATER = 1e-2


class FromState:
    """Trials of strength reduction from the present state of a problem. Collective.

    Use it as a context: `with FromState(...) as attempt: trial = attempt(1.3)`. At the end the
    problem has its first state again. In a trial, loads stay and prescribed increments are zero.
    The strength of the laws falls in equal steps to the strength over the factor. A factor below 1
    acts in all steps. Stresses outside the yield surface return to it.

    Args:
        problem: The problem, between steps.
        growth: Largest growth of the displacement that counts as standing. The growth is
            1 + d/d_e, with the displacement d in the trial, and the displacement d_e of the elastic
            body under the loads.
        steps: Number of steps from the full strength to the reduced strength.
        over: Time of a trial (s), for a `Transient` problem; else None.

    Raises:
        ParameterError: Trials cannot start from this kind of problem; a rigid body goes on moving;
            no law has a strength; or a number is out of range.
    """

    def __init__(self, problem: QuasiStatic, growth: float, steps: int, over: float | None):
        self._problem, self._growth = problem, growth
        self._steps = whole("steps", steps, 1)
        timed = isinstance(problem, Transient)
        if isinstance(problem, ArcLength) or (problem.scheme.in_time and not timed):
            raise ParameterError(
                f"problem = {type(problem).__name__}(...): strength is reduced in quasi-static "
                "steps; make an mpm.QuasiStatic or mpm.Transient of the same points, laws and loads"
            )
        if timed != (over is not None):
            raise ParameterError(
                "over = None: give the time (s) in which a trial reduces the strength, and water "
                "flows: short for undrained, long for drained" if timed else
                f"over = {over!r} is for mpm.Transient only: steps of {type(problem).__name__} "
                "take no time"
            )  # fmt: skip
        self._over = None if over is None else number("over", over, 0.0, unit="s")
        moving = problem.bodies.driven(1.0 if over is None else over)
        if moving is not None:
            raise ParameterError(
                f"'{moving}' goes on moving, and a factor of safety is of a body whose loads stay: "
                "give it a displacement that has been reached, or weight"
            )
        # of the present trial: steps, iterations, largest displacement (m)
        self._taken, self._iterations, self._moved = 0, 0, 0.0
        if not self._laws():
            raise ParameterError("no law of the problem has a strength to reduce")

    def _laws(self) -> list[Declaration]:
        """Laws with a strength, also at boundaries."""
        form = self._problem.form
        every = [*form.parts.declarations, *(d for of in form.boundaries for d in of.declarations)]
        return [d for d in every if d.weaken is not None]

    def _weaken(self, factor: float | None) -> None:
        for declaration in self._laws():
            assert declaration.weaken is not None
            declaration.weaken(factor)

    def __enter__(self) -> FromState:
        problem = self._problem
        self._saved = SavedState(problem)
        self._before = problem.solver, problem.here, problem.kept, problem.max_halvings
        # trials get their own solver, so that they leave no trace in the problem's solver
        newton, solver = problem.newton.anew(), problem.solver
        problem.solver = Bordered(newton, solver.border) if isinstance(solver, Bordered) else newton
        problem.max_halvings = 0
        try:
            self._elastic = self._elastic_displacement()
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *exception: object) -> None:
        problem = self._problem
        self._weaken(None)
        self._saved.restore()
        problem.solver, problem.here, problem.kept, problem.max_halvings = self._before

    def __call__(self, factor: float) -> Trial:
        """Run a trial from the kept state. Collective.

        Args:
            factor: Factor that divides the strength at the end of the trial.
        """
        points = self._problem.points
        self._weaken(None)
        self._saved.restore()
        points.fields[_BEFORE] = points["x"].copy()
        with held(self._problem):
            return self._reduced(factor)

    def _reduced(self, factor: float) -> Trial:
        points = self._problem.points
        self._taken, self._iterations, self._moved = 0, 0, 0.0
        done, share, reason = 0.0, 1.0 / self._steps, ""
        while done < 1.0 and not reason:
            share = min(share, 1.0 - done)
            # a body that fails at its own strength would flow at strengths between this and a
            # larger one, so that a larger one acts from the first step
            now = 1.0 + (factor - 1.0) * (done + share) if factor > 1.0 else factor
            self._weaken(now)
            try:
                reason = self._step(share, now)
            except (ConvergenceError, PointsOutsideGridError) as error:
                left = isinstance(error, PointsOutsideGridError)
                if left or share * self._steps < _SHORTEST * (1 + 1e-9):
                    reason = f"with strength over {now:.4g}: {error}"
                share *= 0.5
                continue
            self._taken += 1
            done = 1.0 if 1.0 - done - share < 1e-12 else done + share
        if not reason:

            def go_on() -> str:
                try:
                    return self._step(_LATER / self._steps, factor)
                except (ConvergenceError, PointsOutsideGridError) as error:
                    return f"with strength over {factor:.4g}: {error}"

            reason = come_to_rest(go_on, points, self._elastic, self._growth)
        grown = 1.0 + self._moved / self._elastic
        return Trial(factor, not reason, reason, self._taken, self._moved, grown, self._iterations)

    def _step(self, share: float, factor: float) -> str:
        """Take a step with a share of a trial's time; whether the body fails in it. Collective.

        Returns:
            The reason if displacements have grown too much, or an empty string.
        """
        problem, points = self._problem, self._problem.points
        if isinstance(problem, Transient):
            assert self._over is not None
            record = problem.step(problem.time + self._over * share)
        else:
            record = problem.step()
        self._iterations += record.iterations
        self._moved = largest_norm(points.comm, points["x"] - points[_BEFORE])
        grown = 1.0 + self._moved / self._elastic
        if grown <= self._growth:
            return ""
        return (
            f"with strength over {factor:.4g}: 1 + d/d_e = {grown:.3g} is more than "
            f"{self._growth:g}, with the largest displacement since the state, d = "
            f"{self._moved:.4g} m, and the displacement of the elastic body under the loads, "
            f"d_e = {self._elastic:.4g} m"
        )

    def _elastic_displacement(self) -> float:
        """Largest displacement of the elastic body under the loads (m). Collective.

        The loads are all forces in balance with the stress: weight, tractions, pore pressure,
        contact.

        Raises:
            ParameterError: The displacement is zero or not finite.
        """
        problem = self._problem
        self._weaken(0.0)
        for kinematics in FORMULATIONS.values():
            if kinematics.state in problem.points.fields:
                problem.points[kinematics.state] = kinematics.rest
        # the elastic body begins without strain, also if the stress was set by the user
        for declaration in problem.form.parts.declarations:
            declaration.points["moved_under"][declaration.rows] = declaration.mark
        operator = problem.operator()
        here = operator.here
        operator.move(_moved_by(problem, operator))
        found = largest_norm(problem.comm, operator.points.motion(here.movers)[0])
        if not np.isfinite(found):
            raise ParameterError(
                "a law has no stress with an endless strength, by which the displacement of the "
                "elastic body is found: give factor_of_safety a function of the factor that builds "
                "the body anew, with the reduced strength"
            )
        if not found > 0.0:
            raise ParameterError(
                f"the loads of the problem move its elastic body by {found:g} m: a factor of "
                "safety needs a body under loads, such as its weight, that conditions hold"
            )
        return found


def _moved_by(problem: QuasiStatic, operator: Operator) -> np.ndarray:
    """Displacements that balance the forces at the start, shape (owned unknowns,). Collective."""
    here, linear = operator.here, problem.newton.linear
    if here.unknowns.total == 0:
        return np.zeros(here.unknowns.owned)
    linear.attach(operator)
    operator.move_to_start()
    force = here.unknowns.restrict(operator.forces())
    if len(here.movers) == len(here.fields):
        linear.take_tangent(operator)
        return linear.solve(-force)
    # solve for displacements only; pressures stay
    matrix = Matrix(here.pattern, here.unknowns)
    operator.tangent(matrix)
    own = sum(here.unknowns.only(k, np.ones(here.unknowns.owned)) for k in here.movers)
    rows = np.flatnonzero(own)
    first = matrix.petsc.getOwnershipRange()[0]
    moving = PETSc.IS().createGeneral((first + rows).astype(np.int32), comm=problem.comm)
    block = matrix.petsc.createSubMatrix(moving, moving)
    ksp = PETSc.KSP().create(problem.comm)
    ksp.setType("preonly")
    ksp.getPC().setType("lu")
    ksp.getPC().setFactorSolverType("mumps")
    ksp.setOperators(block)
    right, found = block.createVecs()[1], block.createVecs()[0]
    right.getArray()[:] = -force[rows]
    ksp.solve(right, found)
    x = np.zeros(here.unknowns.owned)
    x[rows] = found.getArray(readonly=True)
    return x
