"""Ghost penalty factors of fields without a law's modulus, from the metadata of terms."""

from __future__ import annotations

from typing import Any

import ufl

__all__ = ["PENALTY", "penalty_of"]

# Key in the metadata of a measure: increments of fields, and their γ in literal scaling
PENALTY = "ghost_penalty"


def penalty_of(form: ufl.Form, increment: Any) -> Any:
    """γ for UFL of a field's ghost penalty, or None if no term of the form gives it.

    Args:
        form: Weak form.
        increment: Increment of the field.
    """
    for integral in form.integrals():
        for known, gamma in ((integral.metadata() or {}).get(PENALTY) or {}).items():
            if known is increment:
                return gamma
    return None
