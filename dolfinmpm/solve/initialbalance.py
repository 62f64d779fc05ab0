"""Initial balance: stresses in balance with the loads before any motion."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import ufl
from mpi4py import MPI

from dolfinmpm._platform.argumentchecks import check_kind, number, whole
from dolfinmpm._platform.collective import collective
from dolfinmpm._platform.errors import ConvergenceError, ParameterError
from dolfinmpm.assembly.gridassembler import GridAssembler
from dolfinmpm.body.boundary import OWN
from dolfinmpm.body.points import GHOST_FACETS, MaterialPoints
from dolfinmpm.cut.activation import Activation
from dolfinmpm.cut.pattern import Blocks
from dolfinmpm.cut.stabilisations import Stabilisation
from dolfinmpm.forms.splitting import split
from dolfinmpm.solve.arclength import ArcLength
from dolfinmpm.solve.bordered import Bordered
from dolfinmpm.solve.operator import Operator
from dolfinmpm.solve.quasistatic import QuasiStatic
from dolfinmpm.solve.scheme import Static
from dolfinmpm.solve.step import Step

__all__ = ["equilibrate"]


@collective
def equilibrate(problem: QuasiStatic, *, tolerance: float = 1e-9, most: int = 20) -> int:
    """Bring the stress of a body into balance with its loads, without moving it. Collective.

    The function takes ordinary steps. After each step the points go back to their first positions,
    undeformed, and keep the new stress. The new out-of-balance force is of the order of the
    square of the old one, so that two or three steps are enough. A level deposit with stresses
    that match its weight needs no step, except with splines; see `start_at_rest`.

    The force of a ghost penalty, or of weak aggregation, acts on increments and is not kept.
    Here it only helps to solve the equations, and is not part of the balance. At the edge of
    bodies in splines, the stress of the points may not balance every function of the grid
    without this force. Nodes of ill-filled cells then follow other nodes as in aggregation, and
    the sums of their forces are balanced. The next step then moves the body a little, as far as
    the penalty allows: about a hundredth of the motion in the steps here.

    Contact with rigid bodies that hold ground needs a bound `penetration=`: its multipliers keep
    the pressure, while that of a penalty alone goes with the penetration.

    Internal variables, such as plastic strain, and the records of the steps are kept.

    Args:
        problem: A quasi-static problem with undeformed points.
        tolerance: Remaining out-of-balance force, as a share of external forces and reactions. The
            steps here go on to it, also if the problem has a larger tolerance.
        most: Largest number of steps.

    Returns:
        The number of steps.

    Raises:
        ParameterError: The problem is not quasi-static, the points are deformed, or a number is
            outside its range.
        ConvergenceError: The force is not in balance after `most` steps, or a step failed.

    The weight of a level body gives it stress, and no displacement:

    >>> import dolfinmpm as mpm
    >>> from mpi4py import MPI
    >>> grid = mpm.create_lattice(MPI.COMM_WORLD, [range(5), range(5)])
    >>> points = mpm.fill(grid, mpm.Box((0, 0), (4, 2)), per_cell=2, density=2000.0)
    >>> V = mpm.Space(grid, "gimp")
    >>> F = mpm.momentum(mpm.materials.Hencky(1e6, 0.3), points, V.increment, V.test)
    >>> import ufl
    >>> F -= ufl.inner(points.density * ufl.as_vector((0.0, -9.81)), V.test) * points.dX
    >>> bcs = mpm.fixed(V, "bottom") + mpm.rollers(V, "left", "right")
    >>> number = mpm.equilibrate(mpm.QuasiStatic(F, V.increment, points, bcs))
    >>> (points["x"] == points["x0"]).all().item(), round(points["stress"][0, 1, 1].item(), -2)
    (True, -29400.0)
    """
    check_kind("problem", problem, QuasiStatic, "give an mpm.QuasiStatic")
    if problem.scheme.in_time or isinstance(problem, ArcLength):
        raise ParameterError(
            f"problem = {type(problem).__name__}(...): its steps have a length; bring the points "
            "into balance with an mpm.QuasiStatic of the same form, and go on with this one"
        )
    number("tolerance", tolerance, 0.0, 1.0), whole("most", most, 1)
    points = problem.points
    check_undeformed(points, "bring a body into balance")
    before = len(problem.history)
    out = _out_of_balance(problem)
    if out > tolerance:
        penalties, usual = _Penalties(problem), problem.tolerance
        # steps that may stop before would never come to the balance
        problem.tolerance = min(usual, tolerance)
        try:
            if penalties:
                out = _steps_with_soft_penalties(problem, penalties, tolerance, most)
            else:
                out = _steps(problem, tolerance, most)
        finally:
            problem.tolerance = usual
    if out <= tolerance:
        return len(problem.history) - before
    advice = (
        "the body flows under its loads; take more steps, or give it more strength or less load"
    )
    by_penalty = [c.body.name for c in problem.bodies.contacts if c.law.penetration is None]
    if by_penalty:
        advice = (
            f"the penalty of the contact with '{by_penalty[0]}' has no force once the points are "
            f"back; give mpm.contact(..., penetration=1e-6). If this does not help, {advice}"
        )
    raise ConvergenceError(
        f"after {most} steps the force out of balance is {out:.3g} of external forces and "
        f"reactions (tolerance {tolerance:g}): {advice}"
    )


def check_undeformed(points: MaterialPoints, what: str) -> None:
    """Raise ParameterError if points have been deformed; `what` is for the message. Collective."""
    F = points["F"]
    moved = float(np.abs(F - np.eye(F.shape[1])).max(initial=0.0))
    moved = points.comm.allreduce(moved, op=MPI.MAX)
    if moved > 0:
        raise ParameterError(
            f"the points have been deformed, by F − I of {moved:.3g}; {what} before its first step"
        )


def _steps(problem: QuasiStatic, tolerance: float, most: int) -> float:
    """Take steps until forces balance; returns the relative out-of-balance force. Collective."""
    out = _out_of_balance(problem)
    for _ in range(most):
        if out <= tolerance:
            break
        problem.step()
        _undo_deformation(problem)
        out = _out_of_balance(problem)
    return out


def _steps_with_soft_penalties(
    problem: QuasiStatic, penalties: _Penalties, tolerance: float, most: int
) -> float:
    """As `_steps`, with penalties in the matrix only, not in the forces. Collective."""
    with penalties.soft():
        halvings, problem.max_halvings = problem.max_halvings, 0
        try:
            out = _steps(problem, tolerance, most)
        except ConvergenceError:
            out = np.inf
        finally:
            problem.max_halvings = halvings
    if out <= tolerance:
        return out
    with penalties.soft(tied=True):
        return _steps(problem, tolerance, most)


def _out_of_balance(problem: QuasiStatic) -> float:
    """Relative out-of-balance force in the present state. Collective."""
    operator = problem.operator()
    found = operator.residual(np.zeros(operator.here.unknowns.owned))
    return found.norm / found.reference if found.reference > 0 else 0.0


class _ChangedActivation(Static):
    """Static steps on a changed activation.

    Args:
        change: Function from the activation to the changed activation.
    """

    def __init__(self, change: Callable[[Activation], Activation]):
        self._change = change

    def system(self, problem: Any, step: Step) -> Operator:
        """See `Static`. Collective."""
        problem.bodies.begin(step.dt)
        return Operator(problem.form, self._change(problem.activate(step)))


class _Penalties:
    """Penalties on increments in a problem's equations: on jumps and on distances of nodes.

    Args:
        problem: The problem.
    """

    def __init__(self, problem: QuasiStatic):
        self._problem = problem
        form, points = problem.form, problem.points
        jumps = []
        for integral in form.given.integrals():
            where = integral.subdomain_id()
            if GHOST_FACETS in (where if isinstance(where, tuple) else (where,)):
                jumps.append(integral)
        self._jumps: GridAssembler | None = None
        if jumps:
            own = split(ufl.Form(jumps), form.spaces, points)
            self._jumps = GridAssembler(own.grid, form.spaces)
        # a field other than an increment, such as a pressure, keeps its penalties
        self._moved = [name is None for name in form.values]

    def __bool__(self) -> bool:
        distances = any(
            field.stabilisation.kind == "weak-aggregation" and moved
            for field, moved in zip(self._problem.fields, self._moved)
        )
        # a penalty is linear in the increments
        linear = self._problem.form.parts.grid.linear
        return linear and any(self._moved) and (distances or self._jumps is not None)

    def _blocks(self, here: Activation) -> list[Blocks]:
        """The stiffness of the penalties on an activation. Collective."""
        found = list(here.blocks_of("penalty"))
        if self._jumps is not None:
            self._jumps.attach(here.fields)
            found += self._jumps.tangent(here.fields)
        return [b for b in found if self._moved[b.row_field] and self._moved[b.column_field]]

    def _with_soft_penalties(self, here: Activation) -> Activation:
        """The activation with penalties in the matrix only. Collective."""
        blocks = self._blocks(here)
        less = [replace(b, values=-b.values) for b in blocks]
        found = dict(here.blocks)
        for kind, more in (("stiffness", less), ("soft", blocks)):
            found[kind] = [*here.blocks_of(kind), *more]
        return replace(here, blocks=found)

    @contextlib.contextmanager
    def soft(self, tied: bool = False) -> Iterator[None]:
        """Use the penalties in the matrix only, within a context. Collective.

        Args:
            tied: Whether nodes of ill-filled cells follow other nodes in the meantime.
        """
        problem = self._problem
        solver, fields, scheme = problem.solver, problem.fields, problem.scheme
        newton = problem.newton.anew(softened=True)
        problem.solver = Bordered(newton, solver.border) if isinstance(solver, Bordered) else newton
        problem.use(_ChangedActivation(self._with_soft_penalties))
        if tied:
            follow = Stabilisation("aggregation")
            problem.fields = [
                replace(field, stabilisation=follow) if moved else field
                for field, moved in zip(fields, self._moved)
            ]
            problem.here = None
        try:
            yield
        finally:
            problem.solver, problem.fields, problem.here = solver, fields, None
            problem.use(scheme)


def _undo_deformation(problem: QuasiStatic) -> None:
    """Undo the deformation of points and markers. Collective."""
    points = problem.points
    points["F"] = np.eye(points["F"].shape[1])
    # markers of fixed boundaries have not moved
    boundaries = [of.boundary for of in problem.form.boundaries if of.boundary.follows]
    for sets, names in (
        (points, ("x", "V", "l")),
        *((b.markers, ("x", "area")) for b in boundaries),
    ):
        for name in names:
            sets[name] = sets[f"{name}0"]
        if sets is not points:
            sets["V"] = np.linalg.norm(sets["area"], axis=1)
            if OWN in sets.fields:
                sets[OWN] = np.eye(sets.strain_dim)
        sets.locate()
