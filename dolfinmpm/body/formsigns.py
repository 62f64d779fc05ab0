"""Marks of forms that a weak form must contain with one sign.

There is one rule for signs: all forms that the package makes are added, F += .... A load, the
contact of a footing, a penalty and a condition come as internal forces do. These forms carry a
mark, by which a solver refuses a form that was subtracted. A body force in UFL has the sign of
the weak form, F -= ufl.inner(points.density * g, v) * points.dX.
"""

from __future__ import annotations

from dataclasses import dataclass

import ufl
from ufl.core.expr import Expr

__all__ = ["FACETS", "MARK", "Acting", "acting", "unmarked"]

# Name of the mark in the metadata of a measure
MARK = "acting"
# and of the number of the points whose cells and facets a measure is over
FACETS = "facets"


@dataclass(frozen=True, repr=False)
class Acting:
    """The mark of a form: what it is, and its integrand as it was made.

    Attributes:
        name: What it is, for messages.
        integrand: Its integrand.
        once: Whether a form may have it once only.
    """

    name: str
    integrand: Expr
    once: bool = False

    def __repr__(self) -> str:
        return self.name

    @property
    def ufl_signature(self) -> str:
        """What a compiled form knows of it: nothing."""
        return ""


def acting(integrand: Expr, measure: ufl.Measure, name: str, once: bool = False) -> ufl.Form:
    """The integral of what acts on a body, to be added, with its mark.

    Args:
        integrand: Virtual work of the internal force that stands for it, per volume or area.
        measure: The measure.
        name: What acts, for messages.
        once: Whether a form may have it once only.
    """
    mark = Acting(name, integrand, once)
    return integrand * measure.reconstruct(metadata={**measure.metadata(), MARK: mark})


def unmarked(metadata: dict | None) -> dict:
    """Metadata of a measure without marks, by which integrals of one kind would differ."""
    return {k: value for k, value in (metadata or {}).items() if k not in (MARK, FACETS)}
