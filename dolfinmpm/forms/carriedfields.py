"""Fields that the points carry from step to step for a term of a weak form.

To build a form changes no body: the problem that is made of the form adds the fields.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import ufl
from ufl.algorithms import extract_arguments, extract_coefficients
from ufl.core.expr import Expr

from dolfinmpm._platform.checks import shown
from dolfinmpm._platform.errors import FormError, ParameterError
from dolfinmpm.basis.space import Space
from dolfinmpm.body.formarguments import check_displacement, check_points
from dolfinmpm.body.points import MaterialPoints, PointField

__all__ = [
    "CARRIED",
    "CarriedField",
    "CellOffset",
    "StartAcceleration",
    "acceleration",
    "carried",
    "carried_in",
]

# Fields that a step sets as it moves the points
_MOVED = ("x", "x0", "V", "V0", "F", "l", "l0")
# Metadata of a measure: fields that its terms carry without containing them
CARRIED = "carried"


class CarriedField(PointField):
    """What an expression was at the end of the last step, at the points.

    Attributes:
        update: The expression.
        of: The increment that it is the value of, which is then none but the field itself, or None.
        level: Share of a step at whose end forces balance, and increments are those of, where the
            expression gives what is at the end of the step; 1 but for a generalised-α method.
        bounds: Limits between which the values must be, themselves excluded, or None.
    """

    update: Expr
    of: Expr | None = None
    level: float = 1.0
    bounds: tuple[float, float] | None = None


class CellOffset(PointField):
    """Where a point is in its cell of a field, shape (gdim + 1,), set as a step begins.

    From the centre of mass of the cell's points to the point (m); and the size of what counts as
    one cell (m), see `dolfinmpm.cut.celloffsets`.

    Args:
        points: Material points.
        space: Space of the field.
    """

    def __init__(self, points: MaterialPoints, space: Space):
        super().__init__(points, "cell_offset", (points.gdim + 1,), "m")
        self.space = space


class StartAcceleration(PointField):
    """What of a step's accelerations does not depend on its increment (m/s²), set as it begins.

    Args:
        points: Material points.
    """

    def __init__(self, points: MaterialPoints):
        super().__init__(points, "start_acceleration", (points.gdim,), "m/s²")


def acceleration(points: MaterialPoints, u: Any) -> Expr:
    """Acceleration of the body at the material points, for UFL (m/s²), shape (gdim,).

    That of the nodes at the level where a step's forces balance, interpolated, so that the
    inertial forces of the problem are Σ m a·v. It depends on the increment, which a tangent knows:
    `points.inertia` u + a₀ by the rule of `Newmark` or `GeneralisedAlpha`, which set both.

    Args:
        points: Material points.
        u: Increment of the displacement, that of the problem's first field.

    Raises:
        ParameterError: u is no increment of a displacement of these points.
    """
    check_points(points)
    check_displacement(points, u=u)
    return points.inertia * u + StartAcceleration(points)


def carried(
    points: MaterialPoints, name: str, expression: Any, *, unit: str = "", first: Any = 0.0
) -> CarriedField:
    """What an expression was at the end of the last step, at the material points, for UFL.

    For terms with rates: `(p - mpm.carried(points, "pressure", p, "Pa")) / points.dt`. A
    problem made of a form that contains it adds the field to the points, unless they have one of
    that name and shape, and each converged step sets it.

    Args:
        points: Material points.
        name: Name of the field; set `points[name]` for what was before the first step.
        expression: UFL expression of state and increments, of any shape.
        unit: Its unit.
        first: Value before the first step, see `MaterialPoints.add_field`.

    Raises:
        ParameterError: The name cannot be one of a field, or the expression is none of UFL.
    """
    check_points(points)
    if not isinstance(name, str) or not name.isidentifier():
        raise ParameterError(f"name = {shown(name)} must be an identifier: it names a field")
    if not isinstance(expression, Expr):
        raise ParameterError(
            f"what '{name}' carries must be an expression of UFL, got {shown(expression)}"
        )
    if name in _MOVED:
        raise ParameterError(
            f"name = '{name}' is a field that all points have, and steps set it otherwise; give "
            "another name"
        )
    if extract_arguments(expression):
        raise ParameterError(
            f"what '{name}' carries has a test or trial function, and must have a value: give the "
            "increment, Space.increment"
        )
    if not isinstance(unit, str):
        raise ParameterError(f"unit = {shown(unit)} of '{name}' must be a word, such as 'Pa'")
    field = CarriedField(points, name, expression.ufl_shape, unit, first)
    field.update = expression
    field.of = expression if hasattr(expression, "_dolfinmpm_space") else None
    return field


def _within(expressions: Iterable[Expr]) -> Iterator[PointField]:
    for expression in expressions:
        for c in extract_coefficients(expression):
            if isinstance(c, (CarriedField, CellOffset, StartAcceleration)):
                yield c


def carried_in(form: ufl.Form) -> list[PointField]:
    """Fields that a form's terms carry, or that change as a step begins, each once.

    Raises:
        FormError: Two expressions are carried under one name.
    """
    found: dict[str, PointField] = {}
    waiting: list[PointField] = []
    for integral in form.integrals():
        waiting += _within([integral.integrand()])
        waiting += (integral.metadata() or {}).get(CARRIED, ())
    while waiting:
        one = waiting.pop()
        known = found.setdefault(one.name, one)
        if known is one:
            if isinstance(one, CarriedField):
                waiting += [c for c in _within([one.update]) if c.name not in found]
        elif isinstance(one, CarriedField) and one.update != getattr(known, "update", None):
            raise FormError(
                f"two expressions are carried under the name '{one.name}'; give each its own name"
            )
    return list(found.values())
