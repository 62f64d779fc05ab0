"""Terms over cells and facets of the grid, sorted by test field, and their derivatives."""

import functools
from collections.abc import Sequence
from typing import Any

import ufl
from ufl.algorithms import expand_derivatives
from ufl.algorithms.map_integrands import map_integrand_dags
from ufl.classes import Coefficient, Zero
from ufl.corealg.multifunction import MultiFunction

from dolfinmpm.basis.space import Space
from dolfinmpm.body.formsigns import unmarked
from dolfinmpm.forms.termqueries import depends_on, summands

__all__ = ["GridTerms"]


class _WithoutIncrements(MultiFunction):
    """Replaces all increments in an expression by zero."""

    def __init__(self, increments: Sequence[Any]):
        super().__init__()
        self._increments = increments

    expr = MultiFunction.reuse_if_untouched

    def coefficient(self, o):
        return Zero(o.ufl_shape) if any(o is u for u in self._increments) else o

    def restricted(self, o, inner):
        # UFL does not drop restricted zeros itself
        return inner if isinstance(inner, Zero) else self.reuse_if_untouched(o, inner)


class GridTerms:
    """Terms over cells and facets of the grid, for DOLFINx's assemblers.

    Attributes:
        external: Terms that do not depend on the increments: one form per field, or None.
        internal: Terms that depend on the increments: one form per field, or None.

    Args:
        integrals: Integrals over cells and facets of the grid.
        spaces: Spaces of the increments.
    """

    def __init__(self, integrals, spaces: Sequence[Space]):
        self._spaces = list(spaces)
        increments = [space.increment for space in spaces]
        parts: dict[bool, list[Any]] = {False: [], True: []}
        for integral in integrals:
            for varies in parts:
                terms = [
                    t for t in summands(integral.integrand()) if depends_on(t, increments) == varies
                ]
                if terms:
                    total = sum(terms[1:], start=terms[0])
                    metadata = unmarked(integral.metadata())
                    parts[varies].append(integral.reconstruct(total, metadata=metadata))
        self.external = self._by_field(parts[False])
        self.internal = self._by_field(parts[True])
        if self.linear:
            # linear terms are computed by their Jacobian, which lacks constants: c in (u + c)·v
            at_zero = _WithoutIncrements(increments)
            for k, one in enumerate(self.internal):
                constant = None if one is None else _without_zeros(map_integrand_dags(at_zero, one))
                if constant is not None:
                    external = self.external[k]
                    self.external[k] = constant if external is None else external + constant

    def __bool__(self) -> bool:
        return any(form is not None for form in (*self.external, *self.internal))

    def _by_field(self, pieces) -> list[ufl.Form | None]:
        spaces = self._spaces
        if not pieces:
            return [None] * len(spaces)
        whole = ufl.Form(pieces)
        result = []
        for space in spaces:
            others = {s.test: Zero(s.test.ufl_shape) for s in spaces if s is not space}
            # integrals come without derivatives of expressions
            one = expand_derivatives(ufl.replace(whole, others)) if others else whole
            result.append(_without_zeros(one))
        return result

    @functools.cached_property
    def jacobian(self) -> list[list[ufl.Form | None]]:
        """Derivatives of the internal forms, [test field][trial field], or None."""
        jacobian: list[list[ufl.Form | None]] = []
        for one in self.internal:
            row: list[ufl.Form | None] = []
            for space in self._spaces:
                form = None
                if one is not None:
                    trial = ufl.TrialFunction(space.function_space)
                    derivative = ufl.derivative(one, space.increment, trial)
                    form = _without_zeros(expand_derivatives(derivative))
                row.append(form)
            jacobian.append(row)
        return jacobian

    @functools.cached_property
    def linear(self) -> bool:
        """Whether the derivatives do not depend on the increments."""
        increments = [space.increment for space in self._spaces]
        return not any(
            isinstance(c, Coefficient) and any(c is u for u in increments)
            for row in self.jacobian
            for form in row
            if form is not None
            for c in form.coefficients()
        )


def _without_zeros(form: ufl.Form) -> ufl.Form | None:
    """The form without integrals of zero, which UFL keeps; None if nothing is left."""
    kept = []
    for integral in form.integrals():
        terms = [t for t in summands(integral.integrand()) if ufl.algorithms.extract_arguments(t)]
        if terms:
            kept.append(integral.reconstruct(sum(terms[1:], start=terms[0])))
    return ufl.Form(kept) if kept else None
