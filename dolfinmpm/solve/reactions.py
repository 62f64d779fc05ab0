"""Forces of supports, and flows of water, where conditions prescribe a field."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm._platform.argumentchecks import check_kind, shown
from dolfinmpm._platform.collective import collective
from dolfinmpm._platform.errors import ParameterError, raise_together
from dolfinmpm.basis.conditions import Condition
from dolfinmpm.cut.activation import movers
from dolfinmpm.forms.termqueries import unit_of
from dolfinmpm.porous.projection import size_of
from dolfinmpm.solve.problem import Problem
from dolfinmpm.solve.quasistatic import QuasiStatic

__all__ = ["reaction"]

Array = npt.NDArray[np.float64]


@collective
def reaction(problem: Problem, conditions: Sequence[Condition]) -> Array:
    """Force of supports on the body in the last step, summed over their nodes. Collective.

    Conditions of a pore pressure, see `poromechanics`, have a flow in place of a force: the water
    that enters the body at their nodes.

    Together with loads, inertia and all other forces it is in balance. With `GeneralisedAlpha`, it
    is the force at the level of the step at which forces balance. In parts of a halved step, the
    last part counts. Boundaries that do not fit the grid have `Boundary.force()`, rigid bodies
    `RigidBody.force`.

    Args:
        problem: The problem, after a step. Explicit steps keep no reactions.
        conditions: Conditions of this problem for displacements, such as from `mpm.fixed`, or for
            one other field. Where several of them prescribe the same component of a node, this
            component counts once.

    Returns:
        The force (N; N/m of thickness for plane bodies), shape (gdim,). For axisymmetric bodies,
        it is that of the whole circumference, and its first component is the sum of the radial
        forces. For a pore pressure, it is the flow into the body (m³/s; m²/s for plane bodies),
        shape (1,), negative where water leaves. For another field, it is what its equation sums.

    Raises:
        ParameterError: The problem is an explicit one or has taken no step, or a condition belongs
            to another problem, or the conditions are of different kinds of fields.

    A block rests on the bottom of the grid, where 2 m · 1 m · 2000 kg/m³ · 10 m/s² press:

    >>> import dolfinmpm as mpm, ufl
    >>> from dolfinx import mesh
    >>> from mpi4py import MPI
    >>> grid = mesh.create_unit_square(MPI.COMM_WORLD, 4, 4, mesh.CellType.quadrilateral)
    >>> grid.geometry.x[:] *= 4
    >>> points = mpm.fill(grid, mpm.Box((0, 0), (2, 1)), per_cell=2, density=2000.0)
    >>> V = mpm.Space(grid, "gimp")
    >>> F = mpm.momentum(mpm.materials.Hencky(1e6, 0.3), points, V.increment, V.test)
    >>> F -= ufl.inner(points.density * ufl.as_vector([0.0, -10.0]), V.test) * points.dX
    >>> bottom = mpm.fixed(V, "bottom")
    >>> problem = mpm.QuasiStatic(F, V.increment, points, bottom)
    >>> record = problem.step()
    >>> mpm.reaction(problem, bottom).round(3).tolist()[1]
    40000.0
    """
    check_kind("problem", problem, Problem, "give an mpm.QuasiStatic")
    if not isinstance(problem, QuasiStatic):
        raise ParameterError(
            f"{type(problem).__name__} keeps no reactions; take mpm.Newmark, or read the force of "
            "an mpm.Boundary"
        )
    if isinstance(conditions, (list, tuple)) and not conditions:
        raise ParameterError(
            "conditions = [] are none, and have no reaction: give those of the problem, such as "
            'mpm.fixed(V, "bottom")'
        )
    held = problem.essential_conditions
    missing = ParameterError("there are no reactions yet: take a step first, also after `load`")
    raise_together(problem.comm, None if held.has_forces else missing)
    raise_together(problem.comm, _fault(problem, conditions))
    fields = _fields(problem, conditions)
    total = np.sum([held.force_at(k, conditions) for k in fields], axis=0)
    return np.asarray(problem.comm.allreduce(total, op=MPI.SUM)) / _unit(problem, fields[0])


def _fields(problem: Problem, conditions: Sequence[Condition]) -> Sequence[int]:
    """Numbers of the fields of some conditions: all that move points, or a single other field."""
    spaces = problem.form.spaces
    moving = movers(spaces)
    found = {k for k, space in enumerate(spaces) if any(space is one.space for one in conditions)}
    return moving if found <= set(moving) else sorted(found)


def _unit(problem: Problem, k: int) -> float:
    """What a field's equation has for a unit of flow (N s/m³), 1 for forces and own equations."""
    increment = problem.form.spaces[k].increment
    unit = unit_of(problem.form.given, increment)
    if unit is None:
        return 1.0
    # the balance of the water's volume in a step, times M/h
    return float(unit.value) / float(size_of(increment).value) * float(problem.points.dt.value)


def _fault(problem: Problem, conditions: Sequence[Condition]) -> ParameterError | None:
    """An error for conditions that have no reaction in a problem, or None."""
    if not isinstance(conditions, Sequence) or isinstance(conditions, str):
        return ParameterError(
            f"conditions = {shown(conditions)} must be a list of conditions, such as from mpm.fixed"
        )
    for condition in conditions:
        if not any(condition is one for one in problem.essential_conditions.given):
            return ParameterError(
                f"the condition at '{getattr(condition, 'where', shown(condition))}' is no "
                "condition of this problem: give the same object as to the problem, bottom = "
                'mpm.fixed(V, "bottom") made once for both, or conditions from `problem.bcs`'
            )
    fields = _fields(problem, conditions)
    if set(fields) - set(movers(problem.form.spaces)) and len(fields) > 1:
        return ParameterError(
            f"conditions are of {len(fields)} fields, whose forces and flows have no sum: give "
            "those of one field at a time"
        )
    return None
