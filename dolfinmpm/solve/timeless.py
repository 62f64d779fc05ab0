"""Rates in a form of a problem that knows no time."""

from __future__ import annotations

from typing import Any

import numpy as np
import ufl
from ufl.algorithms.analysis import extract_constants
from ufl.constantvalue import zero

from dolfinmpm._platform.argumentchecks import shown
from dolfinmpm._platform.errors import FormError, ParameterError
from dolfinmpm.body.points import UNSET, MaterialPoints
from dolfinmpm.grid.constants import is_own

__all__ = ["check_timeless", "refuse_time"]


def check_timeless(form: ufl.Form, points: MaterialPoints, problem: str) -> None:
    """Refuse rates over a length of the step that nobody has set.

    Args:
        form: Weak form.
        points: Its material points.
        problem: What solves it, for the message.

    Raises:
        FormError: There are such.
    """
    if float(points.dt.value) != UNSET or points.dt not in extract_constants(form):
        return
    # nothing flows where the library's own constant, a permeability, is zero
    own = [c for c in extract_constants(form) if is_own(c) and c is not points.inertia]
    absent = {c: zero(c.ufl_shape) for c in own if not np.any(c.value)}
    if points.dt in extract_constants(ufl.replace(form, absent)):
        raise FormError(
            "the form has rates over points.dt, the length of a step, as mpm.poromechanics has, "
            f"and {problem} knows no time: take Transient, Newmark or GeneralisedAlpha, or set "
            "points.dt.value (s) before the step"
        )


def refuse_time(t: Any, problem: str) -> None:
    """Raise ParameterError if a step is given a time that its problem does not know.

    Args:
        t: What a step was given.
        problem: The problem's name.
    """
    if t is not None:
        raise ParameterError(
            f"step({shown(t)}): {problem} knows no time, and a step goes to the load that the "
            "form's constants hold: set their values and call step(); steps in time are those of "
            "mpm.Transient, mpm.Newmark and mpm.Explicit"
        )
