"""`ufl.derivative` of terms with laws: the chain rule with the tangents of the operators."""

from __future__ import annotations

import ufl
from ufl.algorithms import expand_derivatives, extract_coefficients
from ufl.algorithms.map_integrands import map_integrands
from ufl.classes import CoefficientDerivative, ExprList
from ufl.core.expr import Expr
from ufl.corealg.map_dag import map_expr_dag
from ufl.corealg.multifunction import MultiFunction

from dolfinmpm.forms.operators import PointOperator

__all__ = ["differentiate_through_laws"]


class _ThroughLaws(MultiFunction):
    """Adds a direction for each operator to the derivatives of expressions with operators.

    D[f(u, P)] v = ∂f/∂u v + ∂f/∂P (∂P/∂a : D[a] v), where a is the operand of the operator P. For
    UFL, P is one more coefficient with a given direction.
    """

    # handlers: UFL calls them by the names of its types

    def expr(self, o, *operands):
        return self.reuse_if_untouched(o, *operands)

    def coefficient_derivative(self, o, integrand, w, v, given):
        found = [c for c in extract_coefficients(integrand) if isinstance(c, PointOperator)]
        found = [c for c in found if c not in w.ufl_operands]
        if not found:
            return self.reuse_if_untouched(o, integrand, w, v, given)
        directions = []
        for operator in found:
            inner = CoefficientDerivative(operator.operand, w, v, given)
            change = expand_derivatives(self.apply(inner))
            i = ufl.indices(len(operator.ufl_shape))
            k = ufl.indices(len(operator.operand.ufl_shape))
            term = operator.slope[(*i, *k)] * (change[k] if k else change)
            directions.append(ufl.as_tensor(term, i) if i else term)
        return CoefficientDerivative(
            integrand,
            ExprList(*w.ufl_operands, *found),
            ExprList(*v.ufl_operands, *directions),
            given,
        )

    def apply(self, expression: Expr) -> Expr:
        """The expression with the additional directions."""
        return map_expr_dag(self, expression)


def differentiate_through_laws(form: ufl.Form) -> ufl.Form:
    """The form with explicit derivatives of its laws.

    Args:
        form: Weak form, derivatives not expanded.

    Raises:
        FormError: A differentiated law takes means over cells, or a law is differentiated twice.
    """
    rule = _ThroughLaws()
    return map_integrands(rule.apply, form)
