"""What is said of a field that points do not have: who makes it, and which they have."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from typing import Any

from dolfinmpm._platform.argumentchecks import shown

__all__ = ["no_field"]

_IN_TIME = "mpm.Newmark, mpm.GeneralisedAlpha or mpm.Explicit gives it to them when it is made"
_OF_LAW = "a law gives it to them when the problem is made"
_OF_WATER = "mpm.poromechanics gives it to them when it is called"
_MAKERS = {
    "velocity": _IN_TIME,
    "acceleration": _IN_TIME,
    "velocity_moment": 'the mapping "apic" gives it to them when the problem is made',
    "velocity_gradient": 'the mapping "tpic" gives it to them when the problem is made',
    "plastic_strain": _OF_LAW,
    "preconsolidation_pressure": _OF_LAW,
    "pressure": _OF_WATER,
    "porosity": _OF_WATER,
    "J_bar": "mpm.momentum(..., fbar=True) gives it to them when the problem is made",
    "arc_increment": "mpm.ArcLength gives it to them when it is made",
    "effective_weight": "the body_force of an mpm.Deposit gives it to them",
}


def no_field(name: Any, known: Iterable[str]) -> str:
    """The message.

    Args:
        name: Name that was asked for.
        known: Names that exist.
    """
    listed = list(known)
    text = f"material points have no field {shown(name)}; they have {', '.join(listed)}"
    if name == "displacement":
        return f"{text}. The displacement is points['x'] - points['x0']"
    if name in _MAKERS:
        return f"{text}. {_MAKERS[name]}; or add it before that with points.add_field"
    near = difflib.get_close_matches(name, listed, 1) if isinstance(name, str) else []
    return f"{text}; did you mean '{near[0]}'?" if near else text
