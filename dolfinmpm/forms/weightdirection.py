"""The weight in a form: with a wrong sign it lifts the body, and beside another it acts twice."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from ufl.algorithms import extract_arguments, extract_coefficients
from ufl.algorithms.analysis import extract_constants
from ufl.core.expr import Expr

from dolfinmpm._platform.errors import DoubtfulInputWarning, warn
from dolfinmpm.body.fields import PointField
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.forms.carriedfields import CARRIED
from dolfinmpm.forms.termqueries import brief, summands
from dolfinmpm.forms.weightchecks import same_points

__all__ = ["warn_of_weight"]

Array = npt.NDArray[np.float64]

# Field of the body force of a deposit
EFFECTIVE = "effective_weight"
# Acceleration (m/s²) along the last axis that may be that of an earthquake
_NO_WEIGHT = 1.0


def warn_of_weight(form: ufl.Form, points: MaterialPoints) -> None:
    """Warn of a weight, density times a constant vector, that acts upward, or that is there twice.

    Weights are loads, and loads are subtracted: F -= ufl.inner(points.density * gravity, v) * dX.
    The sum over all such terms counts, so that the acceleration of an earthquake may act upward.
    A weight is there twice beside `Deposit.body_force` at the same points.

    Args:
        form: Weak form, as the user wrote it.
        points: Its material points.
    """
    weights: list[tuple[ufl.Integral, Expr, Array]] = []
    effective: list[ufl.Integral] = []
    for integral in form.integrals():
        marks = integral.metadata() or {}
        if any(getattr(field, "gravity", None) is not None for field in marks.get(CARRIED, ())):
            return
        for term in summands(integral.integrand()):
            names = {c.name for c in extract_coefficients(term) if isinstance(c, PointField)}
            if EFFECTIVE in names:
                effective.append(integral)
                found = _acceleration(term, points)
                if found is not None and found.shape == (points.gdim,) and found[-1] < 0.0:
                    _warn_of_direction(points, term)
                    return
            elif names == {"density"}:
                found = _acceleration(term, points)
                if found is None or found.shape != (points.gdim,):
                    return
                weights.append((integral, term, -found))
    if not weights or points.gdim < 2:
        return
    total = np.sum([a for *_, a in weights], axis=0)
    if not effective and total[-1] > np.linalg.norm(total[:-1]):
        _warn_of_direction(points, weights[0][1])
        return
    for integral, term, a in weights:
        if a[-1] < -_NO_WEIGHT and any(same_points(integral, other) for other in effective):
            warn(
                points.comm,
                f"'{brief(term)}' is a weight of the points, and the body force of the deposit has "
                "their weight too: leave one out",
                DoubtfulInputWarning,
            )
            return


def _warn_of_direction(points: MaterialPoints, term: Expr) -> None:
    warn(
        points.comm,
        f"the weight '{brief(term)}' acts upward, along the last axis: loads are subtracted, F -= "
        "ufl.inner(points.density * gravity, v) * points.dX, with gravity = (0, -9.81)",
        DoubtfulInputWarning,
    )


def _acceleration(term: Expr, points: MaterialPoints) -> Array | None:
    """The vector a of a term ρ a · v by numbers and constants, or None for another term.

    The term is linear in v and in ρ, or in the effective weight. With 1 for it, and the unit
    vectors for v, its values are the components of a.
    """
    arguments = extract_arguments(term)
    if len(arguments) != 1:
        return None
    argument = arguments[0]
    values: dict[Any, Any] = dict.fromkeys(extract_coefficients(term), 1.0)
    for constant in extract_constants(term):
        given = np.asarray(constant.value, float)
        values[constant] = given if given.ndim else given.item()
    found = np.zeros(argument.ufl_shape)
    if found.ndim != 1:
        return None
    try:
        for i in range(found.size):
            values[argument] = tuple(float(k == i) for k in range(found.size))
            found[i] = term((0.0,) * points.gdim, values)
    except Exception:
        # UFL evaluates products of numbers, and not all else that a term may contain
        return None
    return found if np.isfinite(found).all() else None
