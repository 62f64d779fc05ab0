"""Marks for the sign of forms: a weak form adds all forms that the package makes.

Loads, contact, penalties and conditions have the sign of internal forces: F += .... Such a form
carries a mark. A solver refuses a weak form that subtracts the form. A body force that the user
writes in UFL is subtracted: F -= ufl.inner(points.density * g, v) * points.dX.
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass

import ufl
from ufl.core.expr import Expr

__all__ = ["FACETS", "MARK", "PRESSURE", "SignMark", "signed_form", "unmarked"]

# Name of the mark in the metadata of a measure
MARK = "acting"
# Name of the number of the points in the metadata of measures over their cells and facets
FACETS = "facets"
# Kind of the mark of a load along the normal of its face
PRESSURE = "pressure"


@dataclass(frozen=True, repr=False)
class SignMark:
    """The mark of a form.

    Attributes:
        name: Name of the form in messages.
        integrand: Integrand with its original sign.
        once: Whether a weak form may contain the form only once.
        kind: What must differ between forms of the same name, if a form may have several; or
            PRESSURE.
    """

    name: str
    integrand: Expr
    once: bool = False
    kind: Hashable = None

    def __repr__(self) -> str:
        return self.name

    @property
    def ufl_signature(self) -> str:
        """Signature in a compiled form: empty, because marks compile nothing."""
        return ""


def signed_form(
    integrand: Expr,
    measure: ufl.Measure,
    name: str,
    once: bool = False,
    kind: Hashable = None,
) -> ufl.Form:
    """A form with a mark, to be added to the weak form.

    Args:
        integrand: Virtual work per volume or area, with the sign of internal forces.
        measure: The measure.
        name: Name of the form in messages.
        once: Whether a weak form may contain the form only once.
        kind: See `SignMark`.
    """
    mark = SignMark(name, integrand, once, kind)
    return integrand * measure.reconstruct(metadata={**measure.metadata(), MARK: mark})


def unmarked(metadata: dict | None) -> dict:
    """Metadata of a measure without marks, so that integrals of one kind are equal."""
    return {k: value for k, value in (metadata or {}).items() if k not in (MARK, FACETS)}
