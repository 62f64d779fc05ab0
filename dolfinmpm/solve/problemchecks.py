"""Checks of a problem as a whole: its fields, conditions, laws and boundaries together."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np
import ufl
from mpi4py import MPI
from ufl.algorithms.analysis import extract_constants
from ufl.constantvalue import zero

from dolfinmpm._platform.argumentchecks import shown
from dolfinmpm._platform.errors import (
    FormError,
    FreeAxisWarning,
    FreeMotionWarning,
    ParameterError,
    UndeterminedFieldError,
    raise_together,
    warn,
)
from dolfinmpm.assembly.stencilsums import Matrix
from dolfinmpm.basis import LeafBasis
from dolfinmpm.basis.conditionchecks import free_motions, idle, warn_idle
from dolfinmpm.basis.conditions import Condition
from dolfinmpm.basis.space import Space
from dolfinmpm.body.points import UNSET, MaterialPoints, PointField
from dolfinmpm.cut.activation import Activation, ActiveField, Field, movers
from dolfinmpm.cut.activecells import active_nodes, active_on_grid
from dolfinmpm.cut.conditionsonleaves import on_leaves
from dolfinmpm.forms.carriedfields import CarriedField
from dolfinmpm.forms.formchecks import check_moving
from dolfinmpm.forms.termqueries import depends_on
from dolfinmpm.forms.weightdirection import warn_of_weight
from dolfinmpm.grid.constants import is_own
from dolfinmpm.solve.operator import Operator
from dolfinmpm.solve.weakform import WeakForm

__all__ = [
    "check_field_tags",
    "check_kinds_of_conditions",
    "check_pressure_conditions",
    "check_pressure_level",
    "check_times",
    "refuse_field_tags",
    "refuse_rates",
    "refuse_time",
    "warn_at_start",
]

# A domain reaches the axis if it ends within this share of its half-length from the axis
_TOUCHES = 0.01
# A constant pressure makes no forces if they are below this share of those of a random pressure
_ROUNDING = 1e-12


# -- time ---------------------------------------------------------------------


def check_times(
    problem: str,
    inertia: bool,
    in_time: bool,
    form: ufl.Form,
    points: MaterialPoints,
    bcs: Sequence[Condition],
) -> None:
    """Raise if a form or a condition needs time or inertia, and the steps have none.

    Args:
        problem: Name of the problem, for the message.
        inertia, in_time: Whether its steps have inertial forces, and a length in time.
        form: Weak form.
        points: Its material points.
        bcs: The conditions.

    Raises:
        FormError: The form has the acceleration of the body, and steps have no inertia.
        ParameterError: A condition prescribes a velocity, and steps have no length in time.
    """
    if not inertia and points.inertia in extract_constants(form):
        raise FormError(
            f"the form has the acceleration of the body, and {problem} has no "
            "inertial forces at the end of a step that would tell it: take Newmark or "
            "GeneralisedAlpha, or leave it out, mpm.poromechanics(..., inertia=False)"
        )
    for condition in bcs:
        if condition.velocity is not None and not in_time:
            raise ParameterError(
                f"the condition at '{condition.where}' prescribes a velocity, and "
                f"{problem} knows no time; prescribe increments with "
                "mpm.prescribed, or take Newmark, GeneralisedAlpha or Explicit"
            )


def refuse_rates(form: ufl.Form, points: MaterialPoints, problem: str) -> None:
    """Raise if a form in a problem without time has rates over an unset length of the step.

    Args:
        form: Weak form.
        points: Its material points.
        problem: Name of the problem, for the message.

    Raises:
        FormError: The form has such rates.
    """
    if float(points.dt.value) != UNSET or points.dt not in extract_constants(form):
        return
    # nothing flows where the library's own constant, such as a permeability, is zero
    own = [c for c in extract_constants(form) if is_own(c) and c is not points.inertia]
    absent = {c: zero(c.ufl_shape) for c in own if not np.any(c.value)}
    if points.dt in extract_constants(ufl.replace(form, absent)):
        raise FormError(
            "the form has rates over points.dt, the length of a step, as mpm.poromechanics has, "
            f"and {problem} knows no time: take Transient, Newmark or GeneralisedAlpha, or set "
            "points.dt.value (s) before the step"
        )


def refuse_time(t: Any, problem: str) -> None:
    """Raise ParameterError because a step of a problem without time is given a time.

    Args:
        t: Argument of the step.
        problem: Name of the problem.
    """
    raise ParameterError(
        f"step({shown(t)}): {problem} knows no time, and a step goes to the load that the "
        "form's constants hold: set their values and call step(); steps in time are those of "
        "mpm.Transient, mpm.Newmark and mpm.Explicit"
    )


# -- fields of the points of tags ---------------------------------------------


def check_field_tags(fields: Sequence[Field], form: WeakForm) -> None:
    """Raise unless one field moves each point, and laws are of such fields. Collective.

    Args:
        fields: Fields of a problem.
        form: Its weak form.

    Raises:
        ParameterError: Two displacements share a tag, no field moves a point, or a displacement
            without tags would move points of another displacement.
        FormError: A law is of a field that moves no points.
    """
    spaces = [field.space for field in fields]
    check_moving(form.parts.declarations, [spaces[k].increment for k in movers(spaces)])
    if all(space.tags is None for space in spaces):
        return
    points = form.points
    shape = (points.gdim,)
    if spaces[0].tags is None and spaces[0].increment.ufl_shape == shape:
        return
    own = [(k, spaces[k].tags or ()) for k in movers(spaces)]
    for k, space in enumerate(spaces):
        if space.tags is None and space.increment.ufl_shape == shape:
            raise ParameterError(
                f"field {k + 1} is a displacement of all points, and others are of those of tags: "
                "give each a Space with the tags of its own points"
            )
    for (j, others), (k, tags) in itertools.combinations(own, 2):
        if set(tags) & set(others):
            raise ParameterError(
                f"fields {j + 1} and {k + 1} both move the points of tag "
                f"{min(set(tags) & set(others))}; give their Spaces tags that share the points"
            )
    every = [tag for _, tags in own for tag in tags]
    stray = np.flatnonzero(~np.isin(points["tag"], every))
    error = None
    if stray.size and own:
        p = stray[0]
        error = ParameterError(
            f"{stray.size} points, such as that of tag {points['tag'][p]} at {points['x'][p]} m, "
            f"are moved by no field; the fields' tags are {tuple(every)}: give one of the Spaces "
            "their tag too"
        )
    raise_together(points.comm, error)


def refuse_field_tags(fields: Sequence[Field], what: str, instead: str) -> None:
    """Raise ParameterError if a field has tags.

    Args:
        fields: Fields of a problem.
        what: Feature that needs one field for all points.
        instead: Advice, for the message.
    """
    for k, field in enumerate(fields):
        if field.space.tags is not None:
            raise ParameterError(
                f"field {k + 1} is of points of the tags {field.space.tags}, and {what} has one "
                f"field for all points; {instead}"
            )


# -- essential conditions -----------------------------------------------------


def check_kinds_of_conditions(
    bcs: Sequence[Condition], spaces: Sequence[Space], carried: Sequence[PointField]
) -> None:
    """Raise if a condition prescribes a value of an increment, or an increment of a value.

    A substep would otherwise take a share of a value, or a whole increment.

    Args:
        bcs: The conditions.
        spaces: Spaces of the problem's fields.
        carried: Fields of the points that the form carries from step to step.

    Raises:
        ParameterError: There is such a condition.
    """
    values = [f.of for f in carried if isinstance(f, CarriedField)]
    moving = [spaces[k].increment for k in movers(spaces)]
    for condition in bcs:
        u, where = condition.space.increment, condition.where
        is_value = any(one is u for one in values)
        if condition.kind == "increment" and is_value:
            raise ParameterError(
                f"the condition at '{where}' prescribes an increment, and the form carries the "
                "field's values from step to step: give mpm.prescribed(..., value=...)"
            )
        if condition.kind == "value" and not is_value and any(one is u for one in moving):
            raise ParameterError(
                f"the condition at '{where}' prescribes a value, and the field is the increment "
                "of a step, which moves points: give mpm.prescribed(..., increment=...)"
            )


def check_pressure_conditions(conditions: Sequence[Condition], here: Activation) -> None:
    """Raise if a condition on a scalar field holds no active node. Collective.

    A displacement may be held where the body arrives later. But a drained boundary away from the
    body would leave the body sealed, without any message.

    Raises:
        ParameterError: There is such a condition.
    """
    scalar = [c for c in conditions if c.space.increment.ufl_shape == ()]
    names = _idle(scalar, here.fields)
    if names:
        places = ", ".join(f"'{name}'" for name in names)
        raise ParameterError(
            f"the conditions on the pressure at {places} hold no node of the body, which is away "
            "from there: hold the pressure where the body is, by a function of positions, or on "
            "its own surface, mpm.poromechanics(..., drained=surface)"
        )


def warn_at_start(problem: Any, steps: bool) -> None:
    """Warnings of a problem at its first activation; see `warn_of_conditions`. Collective."""
    warn_of_free_axis(problem.points, problem.here)
    # a body that moves in time may reach a side later
    if not problem.scheme.in_time:
        warn_of_conditions(problem, steps)
    if steps:
        warn_of_weight(problem.form.given, problem.points)


def warn_of_conditions(problem: Any, steps: bool) -> None:
    """Warn of conditions that constrain no active node, and of motions that are free. Collective.

    Args:
        problem: A problem without time, at its first activation.
        steps: Whether the activation is for a step, which moves the body.
    """
    warn_idle(problem.comm, _idle(problem.bcs, problem.here.fields))
    if steps:
        _warn_of_free_motions(problem)


def _idle(conditions: Sequence[Condition], fields: Sequence[ActiveField]) -> list[str]:
    """Places whose conditions constrain no active node, also on leaves. Collective."""
    active = [active_on_grid(field) for field in fields]
    names = idle(conditions, [field.space for field in fields], active)
    own = [c for c in conditions if c.place is None and c.space.refinement is not None]
    acts = np.zeros(len(own), np.int32)
    for field in fields:
        mine = [k for k, condition in enumerate(own) if condition.space is field.space]
        if mine and isinstance(field.basis, LeafBasis):
            reached = active_nodes(field.full_stencils, field.basis)
            for k in mine:
                acts[k] = np.isin(on_leaves(own[k], field.basis).nodes, reached).any()
    if own:
        fields[0].space.grid.comm.Allreduce(MPI.IN_PLACE, acts, op=MPI.MAX)
    names += [c.where for c, acting in zip(own, acts) if not acting]
    return list(dict.fromkeys(names))


def check_pressure_level(operator: Operator) -> None:
    """Raise if the equations determine a scalar field only up to a constant. Collective.

    Raises:
        UndeterminedFieldError: There is such a field.
    """
    here = operator.here
    unknowns = here.unknowns
    scalar = [k for k, f in enumerate(here.fields) if f.space.increment.ufl_shape == ()]
    if not scalar or unknowns.total == 0:
        return
    matrix = Matrix(here.pattern, unknowns)
    operator.move_to_zero()
    operator.tangent(matrix)
    x, y = matrix.petsc.createVecs()
    random = np.random.default_rng(unknowns.comm.rank)
    for k in scalar:
        norms = []
        for values in (np.ones(unknowns.owned), random.choice([-1.0, 1.0], unknowns.owned)):
            x.getArray()[:] = unknowns.only(k, values)
            matrix.petsc.mult(x, y)
            norms.append(y.norm())
        if norms[0] <= _ROUNDING * norms[1]:
            matrix.petsc.destroy()
            raise UndeterminedFieldError(
                f"field {k + 1} of {len(here.fields)}, a pressure, is determined up to a "
                "constant: the body is held all around, sealed, and what fills its pores cannot "
                "be compressed. Hold the pressure somewhere, drain a surface, leave a part of the "
                "body free to move, or give the fluid a bulk modulus"
            )
    matrix.petsc.destroy()


def warn_of_free_axis(points: MaterialPoints, here: Activation) -> None:
    """Warn if an axisymmetric body reaches the axis and nodes may leave the axis. Collective.

    Args:
        points: Material points.
        here: The activation; its first field is the displacement.
    """
    if not points.axisymmetric or here.unknowns.fields[0].components != points.gdim:
        return
    x, half, first = points["x"][:, 0], points["l"][:, 0], here.fields[0]
    touches = bool(np.any(x - half < _TOUCHES * half))
    on_axis = first.basis.node_coordinates()[first.nodes, 0] <= 1e-9 * x.max(initial=0.0)
    free = int(np.sum(~here.unknowns.fields[0].fixed[first.nodes[on_axis], 0]))
    touches, free = (points.comm.allreduce(k, op=MPI.MAX) for k in (touches, free))
    if touches and free:
        warn(
            points.comm,
            f"the body reaches the axis x[0] = 0, and {free} nodes there are free to move radially,"
            ' as no material can; hold them with mpm.rollers(space, "left")',
            FreeAxisWarning,
        )


def _warn_of_free_motions(problem: Any) -> None:
    """Warn if nothing holds a rigid motion of a body without inertia. Collective.

    If no load drives the motion, the step converges, and rounding decides where the body lies: a
    block on rollers moved sideways by three times its settlement on one rank, and not on two.
    Bodies without conditions, refined spaces, and terms that may hold a motion, are not looked at.

    Args:
        problem: The problem, at its first activation.
    """
    points, first = problem.points, problem.here.fields[0]
    u = first.space.increment
    if not problem.bcs or len(problem.fields) > 1 or u.ufl_shape != (points.gdim,):
        return
    # nodes of leaves, and constraints of the user, may hold what nodes of the grid do not
    if problem.fields[0].prolongate is not None or first.space.refinement is not None:
        return
    for integral in problem.form.given.integrals():
        marks = integral.metadata() or {}
        # neither stresses nor ghost penalties hold a rigid motion
        if not {"law", "facets"} & set(marks) and depends_on(integral.integrand(), [u]):
            return
    free = free_motions(problem.bcs, first.space, active_on_grid(first), points.axisymmetric)
    if free:
        warn(
            points.comm,
            f"no condition holds the body's rigid motions {', '.join(free)}, and without inertia "
            "rounding decides where it lies along them: hold one side or one node, as by "
            'mpm.rollers(space, "left")',
            FreeMotionWarning,
        )
