"""What a term says of the ghost penalty of a field that no law gives a modulus."""

from __future__ import annotations

from typing import Any

import ufl

__all__ = ["PENALTY", "penalty_of"]

# Metadata of a measure: γ of a field's ghost penalty in literal scaling, by its increment
PENALTY = "ghost_penalty"


def penalty_of(form: ufl.Form, increment: Any) -> Any:
    """γ for UFL of a field's ghost penalty, if a term of the form has one, or None."""
    for integral in form.integrals():
        for known, gamma in ((integral.metadata() or {}).get(PENALTY) or {}).items():
            if known is increment:
                return gamma
    return None
