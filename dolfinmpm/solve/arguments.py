"""Checks of a solver's arguments. Each check raises one named error, or returns the value.

The functions have no state and depend on their arguments only. Every solver calls them before it
builds anything.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI
from petsc4py import PETSc
from ufl.algorithms import extract_arguments
from ufl.core.expr import Expr

from dolfinmpm._platform.argumentchecks import (
    check_dictionary,
    check_function,
    check_kind,
    choice,
    number,
    shown,
    whole,
)
from dolfinmpm._platform.errors import FormError, ParameterError, UnknownNameError
from dolfinmpm.basis.conditions import Condition
from dolfinmpm.basis.space import Space
from dolfinmpm.body.formarguments import check_points
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.cut.stabilisations import KINDS, Stabilisation
from dolfinmpm.cut.tiedsides import TiedSides
from dolfinmpm.solve.scheme import Scheme

__all__ = [
    "ELSEWHERE",
    "as_read",
    "check_bcs_and_loads",
    "check_conditions",
    "check_limits",
    "check_path",
    "check_petsc_options",
    "check_prolongation",
    "check_spaces",
    "check_updates",
    "increments_of",
    "scheme_of",
    "stabilisation_of",
    "stabilisations_of",
]

# Fields set by the solver itself at the end of a step, or never
_KEPT = ("id", "cell", "tag", "x", "x0", "V", "V0", "F", "l", "l0")

# Messages about arguments of other problems, or of other functions
ELSEWHERE = {
    "collision": "mpm.Collision is of mpm.Explicit; rigid bodies touch by mpm.contact in the form, "
    "bodies with fields of their own by mpm.contact_between",
    "dt": "step(t) is told where a step ends, see mpm.times",
    "solver": 'petsc_options= of the problem chooses a solver, such as {"ksp_type": "cg"}',
    "gravity": "it is a term of the form, F -= ufl.inner(points.density * g, v) * points.dX",
}


def scheme_of(scheme: Any) -> Any:
    """The scheme of a problem.

    Raises:
        ParameterError: It is something else, such as a name.
    """
    check_kind("scheme", scheme, Scheme, "leave it out, for each kind of problem has its own")
    return scheme


def increments_of(increment: Any, points: MaterialPoints) -> list[fem.Function]:
    """The unknown functions as a list.

    Raises:
        FormError: A function is not the increment of a `Space`, or is given twice.
        ParameterError: There is no function, or a function lives on another grid than the points.
    """
    check_points(points)
    several = isinstance(increment, Sequence) and not isinstance(increment, str)
    given = list(increment) if several else [increment]
    if not given:
        raise ParameterError("increment = [] names no function to solve for; give Space.increment")
    for u in given:
        if isinstance(u, Space):
            raise FormError("increment is a Space; give its function, Space.increment")
        if isinstance(u, ufl.Argument):
            raise FormError(
                f"increment is the test or trial function '{u}'; give the function that is solved "
                "for, Space.increment"
            )
        space = getattr(u, "_dolfinmpm_space", None)
        if space is None:
            raise FormError(
                f"increment = {shown(u)} is not the increment of a dolfinmpm.Space; a function of "
                "DOLFINx's own has no basis for the points: give Space.increment"
            )
        if space.grid is not points.grid:
            raise ParameterError(
                "the material points live on another grid than the increment; make the Space on "
                "points.grid"
            )
    for k, u in enumerate(given):
        if any(u is other for other in given[:k]):
            raise FormError(
                f"increment {k + 1} of {len(given)} is there twice; each field needs a Space of "
                "its own"
            )
    return given


def check_conditions(bcs: Any, spaces: Sequence[Space]) -> list[Condition]:
    """The essential conditions as a list.

    Raises:
        ParameterError: The argument is not a list of conditions, or a condition is on a field that
            is not an unknown.
    """
    made = "make it with mpm.fixed, mpm.rollers and mpm.prescribed and join them with +"
    several = isinstance(bcs, Iterable) and getattr(bcs, "ndim", 1) > 0
    if isinstance(bcs, (Condition, str)) or not several:
        raise ParameterError(f"bcs = {shown(bcs)} must be a list of conditions: {made}")
    given = list(bcs)
    for condition in given:
        if isinstance(condition, fem.DirichletBC):
            raise ParameterError(
                "bcs holds a dolfinx.fem.DirichletBC, which knows nothing of active nodes and "
                "increments; use mpm.fixed, mpm.rollers or mpm.prescribed"
            )
        if hasattr(condition, "impedance"):
            raise ParameterError(
                f"the absorbing, frictional or free-field side at '{condition.where}' acts by "
                "velocities, and this problem has none: take mpm.Newmark, mpm.GeneralisedAlpha or "
                "mpm.Explicit, or hold the side with mpm.rollers or mpm.fixed"
            )
        if not isinstance(condition, Condition):
            raise ParameterError(f"bcs holds {shown(condition)}: {made}")
        if not any(condition.space is space for space in spaces):
            raise ParameterError(
                f"the condition at '{condition.where}' is on a space that the problem does not "
                "solve for; make it on the Space of the increment"
            )
    return given


def as_read(bcs: Any) -> tuple[list[Any], tuple[Any, ...]]:
    """The user's list of conditions, and its present entries, for `check_loads`."""
    given = bcs if isinstance(bcs, list) else []
    return given, tuple(given)


def check_bcs_and_loads(bcs: Sequence[Condition], loads: Sequence[Any], configuration: str) -> None:
    """Raise ParameterError if conditions do not fit the configuration, or are loads, too.

    Args:
        bcs: The conditions.
        loads: Constants and functions of the form that carry loads.
        configuration: Configuration of stencils and gradients.
    """
    if configuration == "total" and any(condition.place is not None for condition in bcs):
        raise ParameterError(
            'conditions with follows=True need Space(..., configuration="updated"), got '
            '"total": what is active at first positions stays'
        )
    for condition in bcs:
        if any(condition.value is load for load in loads):
            raise ParameterError(
                f"a constant is both a load of the form and the increment prescribed at "
                f"'{condition.where}'; a substep would scale it twice: use two constants"
            )


def check_limits(tolerance: Any, max_iterations: Any, max_halvings: Any) -> None:
    """Raise ParameterError unless these numbers are valid limits of Newton's method."""
    number("tolerance", tolerance, 0.0, 1.0)
    whole("max_iterations", max_iterations, 1)
    whole("max_halvings", max_halvings, 0)


def checked_share(share: Any) -> float:
    """The first substep's share of a step, which a script may have set.

    Raises:
        ParameterError: It is not above 0, or it is above 1.
    """
    if number("share", share, 0.0) > 1.0:
        raise ParameterError(
            f"share = {share:g} is the first substep's share of a step, and must be at most 1"
        )
    return float(share)


# -- options ------------------------------------------------------------------


def stabilisation_of(stabilisation: Any) -> Stabilisation:
    """The stabilisation given by its name or as a `Stabilisation`.

    Raises:
        ParameterError: The argument is neither a name nor a `Stabilisation`.
    """
    if isinstance(stabilisation, str):
        return Stabilisation(choice("stabilisation", stabilisation, KINDS))
    if stabilisation is None:
        raise ParameterError('stabilisation = None must be a word; "none" is no stabilisation')
    if isinstance(stabilisation, ufl.Form):
        raise ParameterError(
            "stabilisation is a form; add it to the weak form, or name a stabilisation as in "
            'stabilisation="ghost"'
        )
    check_kind(
        "stabilisation", stabilisation, Stabilisation,
        'give a word such as "ghost", or mpm.Stabilisation("ghost", ...)',
    )  # fmt: skip
    return stabilisation


def stabilisations_of(stabilisation: Any, number_of_fields: int) -> list[Stabilisation]:
    """One stabilisation per field; a single stabilisation holds for all fields.

    Raises:
        ParameterError: An entry is not a stabilisation, or their number differs from the number of
            fields.
    """
    if isinstance(stabilisation, (list, tuple)):
        if len(stabilisation) != number_of_fields:
            raise ParameterError(
                f"stabilisation has {len(stabilisation)} entries for {number_of_fields} fields; "
                "give one for each, or one for all"
            )
        return [stabilisation_of(one) for one in stabilisation]
    return [stabilisation_of(stabilisation)] * number_of_fields


def check_spaces(spaces: Sequence[Space]) -> None:
    """Raise ParameterError unless all fields have the same configuration."""
    if len({space.configuration for space in spaces}) > 1:
        raise ParameterError(
            "the fields' spaces are of several configurations; give all of them the same one"
        )


def check_prolongation(
    given: Any, points: MaterialPoints, stabilisations: Sequence[Stabilisation]
) -> None:
    """Raise ParameterError unless a prolongation goes with the body. Collective."""
    if given is not None:
        check_function("prolongation", given)
    if isinstance(given, TiedSides):
        given.check(points, stabilisations)


def check_updates(updates: Any, points: MaterialPoints) -> dict[str, Expr]:
    """Name of a field → expression that a step assigns to the field.

    Raises:
        ParameterError: The argument is not a dictionary, or a value is not a UFL expression.
        UnknownNameError: The points have no field of a given name.
        FormError: The solver itself sets the field, or the expression has a test function.
    """
    if updates is None:
        return {}
    check_dictionary("updates", updates, ", field name → UFL expression")
    for name, expression in updates.items():
        if not isinstance(name, str) or name not in points.fields:
            raise UnknownNameError(
                f"updates sets {shown(name)}, which is no field of the points; they have "
                f"{', '.join(points.fields)}: add it with points.add_field"
            )
        if name in _KEPT:
            raise FormError(
                f"updates sets '{name}', which the solver itself keeps; choose another field, "
                "added with points.add_field"
            )
        if not isinstance(expression, Expr):
            raise ParameterError(
                f"updates sets '{name}' to {shown(expression)}, which must be a UFL expression of "
                "the points' fields and the increment; set numbers by points[name] = ..."
            )
        if extract_arguments(expression):
            raise FormError(
                f"updates sets '{name}' to an expression with the test function "
                f"'{extract_arguments(expression)[0]}'; use Space.increment"
            )
    return dict(updates)


def check_petsc_options(options: Any, prefix: Any, comm: MPI.Comm) -> dict[str, Any]:
    """PETSc options without their prefix, tested on a temporary solver. Collective.

    Raises:
        ParameterError: The argument is not a dictionary of words and numbers, a name has a dash or
            the prefix, or PETSc does not know a type.
    """
    if not isinstance(prefix, str):
        raise ParameterError(f"options_prefix = {shown(prefix)} must be a word, such as 'mpm_'")
    if options is None:
        return {}
    check_dictionary("petsc_options", options, ', such as {"ksp_type": "cg", "pc_type": "gamg"}')
    for name, value in options.items():
        if not isinstance(name, str) or not name or name.startswith("-"):
            raise ParameterError(
                f"petsc_options names {shown(name)}; give names without a dash, such as 'ksp_type'"
            )
        if prefix and name.startswith(prefix):
            raise ParameterError(
                f"petsc_options names {name!r}; leave the prefix out: {name[len(prefix) :]!r}"
            )
        if value is not None and not isinstance(value, (str, bool, int, float, np.generic)):
            raise ParameterError(
                f"petsc_options gives {name} = {shown(value)}; values are words, numbers, truth "
                "values, or None for a switch"
            )
        if name == "pc_factor_mat_solver_type" and not _has_package(str(value)):
            raise ParameterError(
                f"petsc_options gives {name} = {value!r}, which this PETSc was built without; "
                '"mumps" and "petsc" are there'
            )
    if options and not _accepted(options, comm):
        wrong = [(k, v) for k, v in options.items() if not _accepted({k: v}, comm)]
        name, value = wrong[0] if wrong else next(iter(options.items()))
        raise ParameterError(
            f"petsc_options gives {name} = {value!r}, which PETSc does not accept; "
            "its manual pages list the types"
        )
    return dict(options)


def _has_package(name: str) -> bool:
    return name in ("petsc", "bas") or PETSc.Sys.hasExternalPackage(name)


def _accepted(options: Mapping[str, Any], comm: MPI.Comm) -> bool:
    """Whether a solver accepts the options. The database of options is restored. Collective."""
    database, prefix = PETSc.Options(), "dolfinmpm_try_"
    for name, value in options.items():
        database[prefix + name] = value
    snes = PETSc.SNES().create(comm)
    try:
        snes.setOptionsPrefix(prefix)
        snes.setFromOptions()
    except PETSc.Error:
        return False
    finally:
        for name in options:
            database.delValue(prefix + name)
        snes.destroy()
    return True


def check_path(
    points: MaterialPoints,
    u: fem.Function,
    bcs: Sequence[Condition],
    length: Any,
    first: Any,
    factor: Any,
    max_length: Any,
    target_iterations: Any,
) -> None:
    """Raise ParameterError unless these are valid arguments of `ArcLength`."""
    if u.ufl_shape != (points.gdim,):
        raise ParameterError(
            f"the first increment must be a displacement of {points.gdim} components, got "
            f"shape {u.ufl_shape}"
        )
    for condition in bcs:
        if condition.changes:
            raise ParameterError(
                f"the condition at '{condition.where}' prescribes an increment; under a load "
                "factor only zero ones may be: press by the load or by a RigidFooting"
            )
    for name, value in (("length", length), ("first", first)):
        if value is not None and number(name, value) == 0:
            raise ParameterError(f"{name} = 0 must be finite and not zero")
    number("factor", factor)
    number("max_length", max_length, 0.0, math.inf, "m", closed=True)
    if not max_length > 0:
        raise ParameterError(f"max_length = {max_length} m must be above 0")
    whole("target_iterations", target_iterations, 1)
