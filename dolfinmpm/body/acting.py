"""Marks of forms that a weak form must contain with one sign.

There is one rule for signs. What acts on the body, a load or the contact of a footing, comes as
its virtual work and is subtracted from the internal forces. What resists its motion, a penalty or
a condition, is added as internal forces are. These forms carry a mark, by which a solver refuses
one of the wrong sign.
"""

from __future__ import annotations

from dataclasses import dataclass

import ufl
from ufl.core.expr import Expr

__all__ = ["FACETS", "MARK", "Acting", "acting", "resisting", "unmarked"]

# Name of the mark in the metadata of a measure
MARK = "acting"
# and of the number of the points whose cells and facets a measure is over
FACETS = "facets"


@dataclass(frozen=True, repr=False)
class Acting:
    """The mark of a form: what it is, its integrand as it was made, and its sign.

    Attributes:
        name: What it is, for messages.
        integrand: Its integrand.
        added: Whether it is added to a weak form; else it is subtracted.
        once: Whether a form may have it once only.
    """

    name: str
    integrand: Expr
    added: bool = False
    once: bool = False

    def __repr__(self) -> str:
        return self.name

    @property
    def ufl_signature(self) -> str:
        """What a compiled form knows of it: nothing."""
        return ""


def acting(integrand: Expr, measure: ufl.Measure, name: str, once: bool = False) -> ufl.Form:
    """The integral of the virtual work of what acts on a body, with its mark.

    Args:
        integrand: Virtual work per volume or area.
        measure: The measure.
        name: What acts, for messages.
        once: Whether a form may have it once only.
    """
    return _marked(integrand, measure, Acting(name, integrand, once=once))


def resisting(integrand: Expr, measure: ufl.Measure, name: str) -> ufl.Form:
    """The integral of what resists the motion of a body, with its mark; see `acting`."""
    return _marked(integrand, measure, Acting(name, integrand, added=True))


def _marked(integrand: Expr, measure: ufl.Measure, mark: Acting) -> ufl.Form:
    return integrand * measure.reconstruct(metadata={**measure.metadata(), MARK: mark})


def unmarked(metadata: dict | None) -> dict:
    """Metadata of a measure without marks, by which integrals of one kind would differ."""
    return {k: value for k, value in (metadata or {}).items() if k not in (MARK, FACETS)}
