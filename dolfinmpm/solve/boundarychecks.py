"""Checks of conditions on boundaries that do not fit the grid, against the body of a problem."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np

from dolfinmpm._platform.errors import FormError
from dolfinmpm._platform.plainvalues import plain_value
from dolfinmpm.body.points import PointField
from dolfinmpm.forms.carriedfields import CarriedField
from dolfinmpm.forms.declarations import Declaration, in_words
from dolfinmpm.kinematics.nitsche import WeakCondition
from dolfinmpm.kinematics.walls import Wall
from dolfinmpm.terms.boundaryterm import BoundaryTerm

__all__ = ["check_boundary_conditions"]


def check_boundary_conditions(
    boundaries: Sequence[BoundaryTerm],
    declarations: Sequence[Declaration],
    carried: Sequence[PointField],
) -> None:
    """Raise if a condition on a boundary is given twice, or lacks a part of the body's traction.

    Nitsche's method balances the traction of the body. Figures are wrong if it does so twice, or
    with the traction of another law or without that of water, and nothing else shows the error.

    Args:
        boundaries: Terms over boundaries.
        declarations: Laws of the body.
        carried: Fields that the points carry.

    Raises:
        FormError: There is such a condition.
    """
    for of in boundaries:
        for one, other in itertools.combinations(of.conditions, 2):
            if _same(one, other):
                what = "wall (mpm.signorini)" if isinstance(one, Wall) else "condition"
                raise FormError(
                    f"the form has a {what} at '{of.boundary.name}' twice for the same components "
                    "and points: leave one out, or give them tags or directions of their own"
                )
        for condition in of.conditions:
            if isinstance(condition, WeakCondition) and condition.exact:
                _check_law(condition, declarations)
                _check_water(condition, carried)


def _tags_of(condition: Any) -> Any:
    return None if condition.declaration is None else condition.declaration.tags


def _overlap(a: Any, b: Any) -> bool:
    return a is None or b is None or bool(set(a) & set(b))


def _same(one: Any, other: Any) -> bool:
    """Whether two conditions hold the same components and points, by more than a penalty."""
    if type(one) is not type(other) or not _overlap(_tags_of(one), _tags_of(other)):
        return False
    first, second = one.declaration, other.declaration
    if first is not None and second is not None and first.u is not second.u:
        return False
    if isinstance(one, Wall):
        return True
    if not (one.exact and other.exact):
        return False
    a, b = one.direction, other.direction
    if a is None or b is None or isinstance(a, str) or isinstance(b, str):
        return a is None or b is None or (isinstance(a, str) and isinstance(b, str))
    return bool(np.linalg.norm(np.cross(np.asarray(a, float), np.asarray(b, float))) == 0.0)


def _check_law(condition: WeakCondition, declarations: Sequence[Declaration]) -> None:
    """Raise FormError unless the law and strain of a condition are those of the body there."""
    own = condition.declaration
    assert own is not None
    near = [d for d in declarations if d.u is own.u and _overlap(d.tags, own.tags)]
    if not near:
        return
    name = condition.boundary.name
    if not any(d.law is own.law or plain_value(d.law) == plain_value(own.law) for d in near):
        raise FormError(
            f"the condition (mpm.dirichlet) at '{name}' has the traction of {own.law!r}, and the "
            f"body there that of {near[0].law!r} ({in_words(near[0].tags)}): give the body's law, "
            'or method="penalty"'
        )
    if not any(d.strain == own.strain for d in near):
        raise FormError(
            f"the condition (mpm.dirichlet) at '{name}' has strain = \"{own.strain}\", and the "
            f'body there strain = "{near[0].strain}": give both the same'
        )


def _check_water(condition: WeakCondition, carried: Sequence[PointField]) -> None:
    """Raise FormError if the body there has a pore pressure, and the condition has none."""
    tags = _tags_of(condition)
    fields = [c for c in carried if isinstance(c, CarriedField) and c.pores is not False]
    wet = [c for c in fields if _overlap(c.pores, tags)]
    if wet and not condition.wet:
        raise FormError(
            f"the condition (mpm.dirichlet) at '{condition.boundary.name}' has the traction of the "
            f"effective stress alone, and the body there has a pore pressure, '{wet[0].name}': the "
            "water would push the body off the boundary; give pore_pressure=p, the pressure of "
            'mpm.poromechanics, or method="penalty"'
        )
