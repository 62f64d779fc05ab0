"""Faces of the body that something holds at a place, and laws that would shift them."""

from __future__ import annotations

import ufl

from dolfinmpm._platform.errors import ParameterError
from dolfinmpm.body.footing import seats
from dolfinmpm.kinematics.fbar import VOLUMES
from dolfinmpm.solve.weakform import WeakForm

__all__ = ["refuse_held_faces"]


def refuse_held_faces(given: ufl.Form, form: WeakForm) -> None:
    """Raise if a form with fbar="volumes" holds faces of the body at a place.

    Args:
        given: Weak form of the user.
        form: The same, prepared.

    Raises:
        ParameterError: Mean volumes scale F after a step, which moves the faces F R without a
            motion. A stiff footing makes large forces of that.
    """
    kept = next((d for d in form.parts.declarations if d.fbar == VOLUMES), None)
    holders = [f"the footing with the field {name}" for name in seats(given)]
    holders += [str(term) for term in form.terms if term.holds_faces]
    if kept is not None and holders:
        raise ParameterError(
            f'fbar = "{VOLUMES}" of {kept.law!r} and {holders[0]}: mean volumes change F after a '
            "step, which shifts the faces of points, and what holds these faces would resist. "
            "Take fbar=True, or a RigidBody with mpm.contact"
        )
