"""Small helpers for terms of a form."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from ufl.algorithms import extract_coefficients
from ufl.classes import Curl, Div, Grad, NablaDiv, NablaGrad, Sum
from ufl.core.expr import Expr

from dolfinmpm._platform.argumentchecks import Tags, as_tags, check_kind, cut
from dolfinmpm._platform.errors import FormError, ParameterError
from dolfinmpm.forms.operators import PointOperator

__all__ = [
    "PENALTY",
    "SPATIAL_DERIVATIVES",
    "UNIT",
    "brief",
    "check_solved_for",
    "operators_in",
    "penalty_of",
    "share_units",
    "stiffness_per_area",
    "summands",
    "tags_of",
    "term_of",
    "unit_of",
]


# Key in the metadata of a measure: increments of fields without a law's modulus, and the γ of their
# ghost penalty in literal scaling
PENALTY = "ghost_penalty"
# Key in the metadata of a measure: increments of fields whose equation has a unit of its own, and
# the constant by which it is multiplied
UNIT = "unit_of_equation"

SPATIAL_DERIVATIVES = (Grad, Div, Curl, NablaGrad, NablaDiv)


def brief(expression: Expr) -> str:
    """An expression as text for messages, at most 200 characters."""
    return cut(str(expression))


def summands(expression: Expr) -> Iterator[Expr]:
    """The terms of a sum."""
    if isinstance(expression, Sum):
        for operand in expression.ufl_operands:
            yield from summands(operand)
    else:
        yield expression


def depends_on(expression: Expr, increments: Sequence[Any]) -> bool:
    """Whether an expression depends on the increments, directly or by a law."""
    return any(
        isinstance(c, PointOperator) or any(c is u for u in increments)
        for c in extract_coefficients(expression)
    )


def check_solved_for(function: Any, spaces: Sequence[Any]) -> None:
    """Raise FormError if a function is the increment of none of the spaces, but of another one."""
    if hasattr(function, "_dolfinmpm_space") and not any(function is s.increment for s in spaces):
        raise FormError(
            f"'{function}' is the increment of a space that the problem does not solve for; give "
            "this increment to the problem as an unknown"
        )


def term_of(integral) -> Any:
    """The term that an integral stands for, or None; see `dolfinmpm.assembly.term.as_form`."""
    return (integral.metadata() or {}).get("term")


def stiffness_per_area(form: ufl.Form) -> list[tuple[str, npt.NDArray[np.float64]]]:
    """Penalties per area of a form's contacts, weak conditions and walls, as they are now.

    Args:
        form: The form. Penalties that follow from laws are known when a problem has been made of
            the form, those that follow from cut cells after its first step.

    Returns:
        For each term its name and κ (Pa/m): one number, or one per point or marker on this rank.

    Raises:
        ParameterError: It is no form, or no problem has been made of the form.

    Ten times E/h:

    >>> import dolfinmpm as mpm
    >>> from mpi4py import MPI
    >>> grid = mpm.create_lattice(MPI.COMM_WORLD, [range(5), range(5)])
    >>> points = mpm.fill(grid, mpm.Box((0, 0), (4, 2)), per_cell=2, density=2000.0)
    >>> V = mpm.Space(grid, "gimp")
    >>> F = mpm.momentum(mpm.materials.Hencky(1e6, 0.3), points, V.increment, V.test)
    >>> plate = mpm.RigidBody(mpm.Plane((0, 2), (0, -1)), increment=(0.0, -0.01), name="plate")
    >>> F += mpm.contact(plate, points, V.increment, V.test, penalty=10.0)
    >>> problem = mpm.QuasiStatic(F, V.increment, points, mpm.fixed(V, "bottom"))
    >>> [(name, kappa.max().item()) for name, kappa in mpm.stiffness_per_area(F)]
    [("the contact with 'plate'", 10000000.0)]
    """
    check_kind("form", form, ufl.Form, "give the weak form F that the problem is made of")
    marks = [integral.metadata() or {} for integral in form.integrals()]
    terms = [of[kind] for of in marks for kind in ("term", "condition") if kind in of]
    known = [term for term in terms if hasattr(term, "stiffness_per_area")]
    return [(repr(term), np.array(term.stiffness_per_area())) for term in known]


def operators_in(term: Expr) -> list[PointOperator]:
    """The operators (laws) in a term."""
    return [c for c in extract_coefficients(term) if isinstance(c, PointOperator)]


def tags_of(integral) -> Tags:
    """Tags of the points that integrate a term; None means all points.

    Raises:
        FormError: The subdomain of the term's measure is no tag.
    """
    where = integral.subdomain_id()
    try:
        return None if where == "everywhere" else as_tags(where)
    except ParameterError as error:
        raise FormError(
            f"the term '{brief(integral.integrand())}' restricts a measure of points: {error}"
        ) from None


def penalty_of(form: ufl.Form, increment: Any) -> Any:
    """γ for UFL of a field's ghost penalty, or None if no term of the form gives it.

    It is the harmonic mean where terms over several tags give one.

    Args:
        form: Weak form.
        increment: Increment of the field.
    """
    found = [
        gamma
        for integral in form.integrals()
        for known, gamma in ((integral.metadata() or {}).get(PENALTY) or {}).items()
        if known is increment
    ]
    # the harmonic mean is near the smallest one: a larger one would lead water past that soil
    return (
        found[0] if len(found) == 1 else len(found) / sum(1 / g for g in found) if found else None
    )


def unit_of(form: ufl.Form, increment: Any) -> fem.Constant | None:
    """Unit of an equation, or None if it has none.

    Args:
        form: Weak form.
        increment: Increment of the equation's field.
    """
    return next(iter(_units(form).get(increment, [])), None)


def _units(form: ufl.Form) -> dict[Any, list[fem.Constant]]:
    """Units of equations from the metadata `UNIT`, by increment."""
    units: dict[Any, list[fem.Constant]] = {}
    for integral in form.integrals():
        for increment, unit in ((integral.metadata() or {}).get(UNIT) or {}).items():
            units.setdefault(increment, []).append(unit)
    return units


def share_units(form: ufl.Form) -> None:
    """Give an equation that is written for several tags one unit, the largest.

    Nodes between two soils have the sum of both parts, which would not be a balance in two units.

    Args:
        form: Weak form, whose metadata `UNIT` are constants by increment.
    """
    for constants in _units(form).values():
        largest = max(float(unit.value) for unit in constants)
        for unit in constants:
            unit.value = largest
