"""Conditions on boundaries that contradict each other, or the laws of the body."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np

from dolfinmpm._platform.errors import FormError
from dolfinmpm._platform.plainvalues import plain_value
from dolfinmpm.forms.declarations import Declaration, in_words
from dolfinmpm.kinematics.nitsche import WeakCondition
from dolfinmpm.kinematics.walls import Wall
from dolfinmpm.terms.boundaryterm import BoundaryTerm

__all__ = ["check_boundaries_of"]


def check_boundaries_of(
    boundaries: Sequence[BoundaryTerm], declarations: Sequence[Declaration]
) -> None:
    """Refuse conditions that are there twice, and such with another law than the body's.

    Nitsche's method balances the traction of the body: there twice, or with the traction of
    another law, its figures are wrong, and nothing else tells so.

    Args:
        boundaries: Terms over boundaries.
        declarations: Laws of the body.

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


def _tags_of(condition: Any) -> Any:
    return None if condition.declaration is None else condition.declaration.tags


def _overlap(a: Any, b: Any) -> bool:
    return a is None or b is None or bool(set(a) & set(b))


def _same(one: Any, other: Any) -> bool:
    """Whether two conditions hold the same, by more than a penalty."""
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
