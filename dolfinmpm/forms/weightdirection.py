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
        own = [getattr(field, "gravity", None) for field in marks.get(CARRIED, ())]
        mixture = next((g for g in own if g is not None), None)
        if mixture is not None:
            a = _values(mixture, points)
            if a is not None and points.gdim > 1 and a[-1] > np.linalg.norm(a[:-1]):
                _warn_of_direction(points, "gravity of mpm.poromechanics")
            return
        for term in summands(integral.integrand()):
            names = {c.name for c in extract_coefficients(term) if isinstance(c, PointField)}
            if EFFECTIVE in names:
                effective.append(integral)
                found = _acceleration(term, points)
                if found is not None and found.shape == (points.gdim,) and found[-1] < 0.0:
                    _warn_of_direction(points, brief(term))
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
        _warn_of_direction(points, brief(weights[0][1]))
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


def _warn_of_direction(points: MaterialPoints, what: str) -> None:
    warn(
        points.comm,
        f"the weight '{what}' acts upward, along the last axis: loads are subtracted, F -= "
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
    argument, coefficients = arguments[0], extract_coefficients(term)
    if not all(isinstance(c, PointField) for c in coefficients):
        # values of a function of positions may have either sign
        return None
    values: dict[Any, Any] = dict.fromkeys(coefficients, 1.0)
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


def _values(vector: Expr, points: MaterialPoints) -> Array | None:
    """Components of a vector of numbers and constants, or None for another one."""
    given = {c: np.asarray(c.value, float) for c in extract_constants(vector)}
    values: dict[Any, Any] = {c: v if v.ndim else v.item() for c, v in given.items()}
    try:
        found = [vector[i]((0.0,) * points.gdim, values) for i in range(points.gdim)]
    except Exception:
        return None
    return np.array(found, float)
