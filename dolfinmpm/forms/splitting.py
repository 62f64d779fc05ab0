"""Split a weak form into what the points integrate and what DOLFINx integrates.

At the points, the integrand is a function of the increments' values and
gradients there. Its derivatives by the test function's value and gradient are
the flux; the flux's derivatives by the increment's are the tangent.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from ufl.algorithms import expand_derivatives, extract_coefficients
from ufl.algorithms.apply_algebra_lowering import apply_algebra_lowering
from ufl.algorithms.apply_derivatives import apply_derivatives
from ufl.algorithms.map_integrands import map_integrand_dags
from ufl.classes import (
    Coefficient,
    CoefficientDerivative,
    Curl,
    Div,
    Grad,
    NablaDiv,
    NablaGrad,
    Sum,
    Zero,
)
from ufl.core.expr import Expr
from ufl.corealg.multifunction import MultiFunction
from ufl.corealg.traversal import unique_pre_traversal

from dolfinmpm._platform.errors import FormError
from dolfinmpm.basis.space import Space
from dolfinmpm.body.points import MaterialPoints, PointField
from dolfinmpm.forms.operators import AveragingLaw, PointOperator
from dolfinmpm.forms.pointwise import Program, compile_program
from dolfinmpm.forms.slots import Slots

SpatialDerivative = (Grad, Div, Curl, NablaGrad, NablaDiv)

__all__ = ["OrdinaryTerms", "PointTerms", "SplitForm", "split"]


@dataclass(frozen=True)
class OrdinaryTerms:
    """Terms over cells and facets of the grid, for DOLFINx's assemblers.

    Attributes:
        external: Part that does not depend on the increments, one form a field, or None.
        internal: Part that does, likewise.
        jacobian: Derivative of the internal part, [test field][trial field], or None.
        linear: Whether the derivative does not depend on the increments.
    """

    external: list[ufl.Form | None]
    internal: list[ufl.Form | None]
    jacobian: list[list[ufl.Form | None]]
    linear: bool


@dataclass(frozen=True)
class PointTerms:
    """Terms that the material points integrate, compiled.

    The fluxes are multiplied by the points' volumes and have shape
    (points, c, 1 + d): c stacked components of all fields, first what goes with
    the test function's value, then what goes with its gradient.

    Attributes:
        external: Flux that does not depend on the increments, or None.
        internal: Flux that does, or None.
        tangent: Its derivative, shape (points, c, d, c, d) if `gradient_only`,
            else (points, c, 1 + d, c, 1 + d); or None.
        gradient_only: Whether only gradients enter the tangent.
        operators: Operators in the integrand.
        operands: For each the program of its operand, or the key of its data.
        functions: DOLFINx functions in the integrand, and whether their gradient.
        constants: DOLFINx constants in the integrand.
        by_mean: For every operator whose law averages over cells, the derivative of the
            internal flux by that mean at the point, of the flux's shape.
    """

    external: Program | None
    internal: Program | None
    tangent: Program | None
    gradient_only: bool
    operators: list[PointOperator]
    operands: list[Program | tuple]
    functions: list[tuple[fem.Function, bool]]
    constants: list[fem.Constant]
    by_mean: dict[int, Program]


@dataclass(frozen=True)
class SplitForm:
    """A weak form, split and compiled."""

    points: PointTerms
    ordinary: OrdinaryTerms
    has_ordinary: bool


def split(form: ufl.Form, spaces: Sequence[Space], points: MaterialPoints) -> SplitForm:
    """Split a weak form and compile its pointwise part. Collective.

    Args:
        form: Weak form, linear in the spaces' test functions.
        spaces: Spaces of the increments that are solved for.
        points: Material points whose measures the form may contain.

    Raises:
        FormError: A term cannot be evaluated where it stands; the message names it.
    """
    if not isinstance(form, ufl.Form):
        raise FormError(f"the weak form must be a UFL form, got {type(form).__name__}")
    for integral in form.integrals():
        for node in unique_pre_traversal(integral.integrand()):
            if isinstance(node, SpatialDerivative):
                # UFL takes a field of the points for constant and would drop the term
                inside = extract_coefficients(node)
                for c in inside:
                    if isinstance(c, (PointField, PointOperator)):
                        raise FormError(
                            f"'{_short(node)}' differentiates '{c}', which has values at the "
                            "points only and no gradient"
                        )
            if isinstance(node, CoefficientDerivative):
                inside = [c for c in extract_coefficients(node) if isinstance(c, PointOperator)]
                if inside:
                    raise FormError(
                        f"ufl.derivative cannot see through the law '{inside[0]}'; add its term "
                        "to the form itself, the solver derives the tangent"
                    )
    form = expand_derivatives(form)
    at_points: list[Any] = []
    ordinary: list[Any] = []
    for integral in form.integrals():
        if integral.integral_type() == "custom":
            if integral.subdomain_id() != "everywhere":
                raise FormError(
                    f"the term '{_short(integral.integrand())}' restricts a measure of points to "
                    f"subdomain {integral.subdomain_id()}; multiply with a field of the points "
                    "that is 0 or 1 instead"
                )
            if "points" not in integral.metadata():
                raise FormError(
                    f"the term '{_short(integral.integrand())}' gives a measure of points metadata "
                    "of its own; points take no quadrature degree"
                )
            if integral.metadata()["points"] != points.number:
                raise FormError(
                    f"the term '{_short(integral.integrand())}' is integrated over material points "
                    "that the problem does not move"
                )
            at_points.append(integral)
        else:
            _check_ordinary(integral, spaces)
            ordinary.append(integral)
    _check_tags(ordinary)
    return SplitForm(
        _point_terms(at_points, spaces, points), _ordinary_terms(ordinary, spaces), bool(ordinary)
    )


def _short(expression: Expr) -> str:
    text = str(expression)
    return text if len(text) <= 200 else text[:197] + "..."


def _summands(expression: Expr) -> Iterator[Expr]:
    if isinstance(expression, Sum):
        for operand in expression.ufl_operands:
            yield from _summands(operand)
    else:
        yield expression


def _varies(expression: Expr, increments: Sequence[Any]) -> bool:
    return any(
        isinstance(c, PointOperator) or any(c is u for u in increments)
        for c in extract_coefficients(expression)
    )


def _check_tags(integrals) -> None:
    """DOLFINx takes one tagging for each kind of integral."""
    seen: dict[str, Any] = {}
    for integral in integrals:
        data, kind = integral.subdomain_data(), integral.integral_type()
        if data is None:
            continue
        if seen.setdefault(kind, data) is not data:
            raise FormError(
                f"the term '{_short(integral.integrand())}' has other subdomain data than another "
                f"{kind} term of the form; put all tags of a kind into one MeshTags"
            )


def _check_ordinary(integral, spaces: Sequence[Space]) -> None:
    term, kind = integral.integrand(), integral.integral_type()
    if kind not in ("cell", "exterior_facet", "interior_facet"):
        raise FormError(
            f"'{_short(term)}' is integrated over '{kind}'; use dx, ds, dS or a points'"
        )
    if integral.ufl_domain() != spaces[0].grid.ufl_domain():
        raise FormError(f"'{_short(term)}' is integrated over another mesh than the grid")
    for a in ufl.algorithms.extract_arguments(term):
        if not any(a == space.test for space in spaces):
            raise FormError(
                f"'{a}' in '{_short(term)}' is not the test function of a space that the problem "
                "solves for; use Space.test"
            )
    for c in extract_coefficients(term):
        if isinstance(c, fem.Function) and c.function_space.mesh is not spaces[0].grid:
            raise FormError(f"the function '{c}' in '{_short(term)}' lives on another mesh")
        if isinstance(c, (PointField, PointOperator)):
            raise FormError(
                f"'{c}' lives at the material points, but '{_short(integral.integrand())}' is "
                f"integrated over the grid ({integral.integral_type()}); use points.dX or points.dx"
            )
        if not isinstance(c, fem.Function):
            raise FormError(f"the coefficient '{c}' has no values; use dolfinx.fem.Function")


def _point_terms(integrals, spaces, points: MaterialPoints) -> PointTerms:
    slots = Slots(spaces, points)
    increments = [space.increment for space in spaces]
    parts: dict[bool, list[Expr]] = {False: [], True: []}
    for integral in integrals:
        volume = slots.slot(("field", integral.metadata()["volume"]), ())
        for term in _summands(integral.integrand()):
            arguments = {a for a in ufl.algorithms.extract_arguments(term) if a.number() == 0}
            if len(arguments) != 1:
                raise FormError(
                    f"the term '{_short(term)}' must be linear in one test function, it has "
                    f"{len(arguments)}; an energy needs ufl.derivative(energy, u, v)"
                )
            parts[_varies(term, increments)].append(volume * slots.map(term))

    def program(terms: list[Expr]) -> tuple[Program | None, list[list[Expr]]]:
        if not terms:
            return None, []
        total = sum(terms[1:], start=terms[0])
        fluxes = [
            [_derive(total, slots.test_value[k]), _derive(total, slots.test_gradient[k])]
            for k in range(len(spaces))
        ]
        tests = {c for pair in zip(slots.test_value, slots.test_gradient) for c in pair}
        for flux in (f for pair in fluxes for f in pair):
            if any(node in tests for node in unique_pre_traversal(flux)):
                raise FormError(
                    f"'{_short(total)}' is not linear in the test function; an energy needs "
                    "ufl.derivative(energy, u, v)"
                )
        return _flux_program(fluxes, slots), fluxes

    external, _ = program(parts[False])
    internal, fluxes = program(parts[True])
    operands: list[Program | tuple] = []
    mapped = []
    for operator in slots.operators:
        expression = slots.map(expand_derivatives(operator.operand))
        mapped.append(expression)
        direct = [k for k in range(len(spaces)) if expression is slots.gradient[k]]
        operands.append(
            ("gradient", direct[0])
            if direct
            else compile_program(
                points.grid,
                [_at(expression, i) for i in np.ndindex(*expression.ufl_shape)],
                slots.sources,
            )
        )
    tangent, gradient_only = _tangent(fluxes, slots, mapped) if internal else (None, True)
    by_mean = {}
    for k, operator in enumerate(slots.operators):
        if isinstance(operator.law, AveragingLaw):
            if isinstance(operands[k], Program):
                raise FormError(
                    f"'{operator}' averages over cells and takes the gradient of an increment, not "
                    f"'{_short(operator.operand)}'"
                )
            by_mean[k] = _flux_program(_by_mean(fluxes, slots, k), slots)
    return PointTerms(
        external, internal, tangent, gradient_only, slots.operators, operands, slots.functions,
        slots.constants, by_mean,
    )  # fmt: skip


def _flux_program(fluxes, slots: Slots) -> Program:
    components = []
    for (value, gradient), space in zip(fluxes, slots.spaces):
        for i in np.ndindex(*space.increment.ufl_shape):
            components.append(_at(value, i))
            components += [_at(gradient, (*i, j)) for j in range(slots.points.gdim)]
    return compile_program(slots.points.grid, components, slots.sources)


def _by_mean(fluxes, slots: Slots, k: int) -> list[list[Expr]]:
    """Derivative of the fluxes by the mean that the k-th operator takes over cells."""
    shape = slots.operators[k].ufl_shape
    slope = slots.slot(("operator by mean", k), shape)

    def through(flux: Expr) -> Expr:
        i, o = ufl.indices(len(flux.ufl_shape)), ufl.indices(len(shape))
        by_operator = _derive(flux, slots.operator_value[k])
        if isinstance(by_operator, Zero):
            return Zero(flux.ufl_shape)
        term = by_operator[(*i, *o)] * slope[o] if o else by_operator * slope
        return apply_algebra_lowering(ufl.as_tensor(term, i) if i else term)

    return [[through(flux) for flux in pair] for pair in fluxes]


def _derive(expression: Expr, variable: Expr) -> Expr:
    return apply_derivatives(apply_algebra_lowering(ufl.diff(expression, variable)))


def _at(expression: Expr, index: tuple[int, ...]) -> Expr:
    return expression[index] if index else expression


def _tangent(fluxes, slots: Slots, operands: Sequence[Expr]) -> tuple[Program, bool]:
    """Derivative of the fluxes by the increments' values and gradients."""
    points = slots.points

    def block(flux: Expr, variable: Expr) -> Expr:
        total = _derive(flux, variable)
        for k, operator in enumerate(slots.operators):
            by_operator = _derive(flux, slots.operator_value[k])
            by_variable = _derive(operands[k], variable)
            if isinstance(by_operator, Zero) or isinstance(by_variable, Zero):
                continue
            shape, inner = operator.ufl_shape, operands[k].ufl_shape
            slope = slots.slot(("operator tangent", k), (*shape, *inner))
            i = ufl.indices(len(flux.ufl_shape))
            o = ufl.indices(len(shape))
            q = ufl.indices(len(inner))
            w = ufl.indices(len(variable.ufl_shape))
            term = slope[(*o, *q)]
            term = (by_operator[(*i, *o)] if i or o else by_operator) * term
            term = term * (by_variable[(*q, *w)] if q or w else by_variable)
            total = total + (ufl.as_tensor(term, (*i, *w)) if i or w else term)
        return apply_algebra_lowering(total)

    tests = [(k, s) for k in range(len(fluxes)) for s in (0, 1)]
    variables = {(k, 0): slots.value[k] for k in range(len(fluxes))}
    variables |= {(k, 1): slots.gradient[k] for k in range(len(fluxes))}
    blocks = {(t, w): block(fluxes[t[0]][t[1]], variables[w]) for t in tests for w in tests}
    gradient_only = all(
        isinstance(blocks[t, w], Zero) for t in tests for w in tests if t[1] == 0 or w[1] == 0
    )
    rows = []
    for k, space in enumerate(slots.spaces):
        for i in np.ndindex(*space.increment.ufl_shape):
            if not gradient_only:
                rows.append((k, 0, i))
            rows += [(k, 1, (*i, j)) for j in range(points.gdim)]
    components = [_at(blocks[(k, s), (m, r)], (*i, *j)) for k, s, i in rows for m, r, j in rows]
    return compile_program(points.grid, components, slots.sources), gradient_only


def _without_zeros(form: ufl.Form) -> ufl.Form | None:
    """The form less the integrals of zero that UFL keeps; None if nothing is left."""
    kept = []
    for integral in expand_derivatives(form).integrals():
        terms = [t for t in _summands(integral.integrand()) if ufl.algorithms.extract_arguments(t)]
        if terms:
            kept.append(integral.reconstruct(sum(terms[1:], start=terms[0])))
    return ufl.Form(kept) if kept else None


class _AtRest(MultiFunction):
    """An expression where all increments are zero."""

    def __init__(self, increments: Sequence[Any]):
        super().__init__()
        self._increments = increments

    expr = MultiFunction.reuse_if_untouched

    def coefficient(self, o):
        return Zero(o.ufl_shape) if any(o is u for u in self._increments) else o

    def restricted(self, o, inner):
        # UFL keeps zeros of either side
        return inner if isinstance(inner, Zero) else self.reuse_if_untouched(o, inner)


def _ordinary_terms(integrals, spaces: Sequence[Space]) -> OrdinaryTerms:
    increments = [space.increment for space in spaces]
    parts: dict[bool, list[Any]] = {False: [], True: []}
    for integral in integrals:
        for varies in parts:
            terms = [t for t in _summands(integral.integrand()) if _varies(t, increments) == varies]
            if terms:
                parts[varies].append(integral.reconstruct(sum(terms[1:], start=terms[0])))

    def by_field(pieces) -> list[ufl.Form | None]:
        if not pieces:
            return [None] * len(spaces)
        whole = ufl.Form(pieces)
        result = []
        for space in spaces:
            others = {s.test: Zero(s.test.ufl_shape) for s in spaces if s is not space}
            one = ufl.replace(whole, others) if others else whole
            result.append(_without_zeros(expand_derivatives(one)))
        return result

    internal = by_field(parts[True])
    jacobian: list[list[ufl.Form | None]] = []
    for one in internal:
        row: list[ufl.Form | None] = []
        for space in spaces:
            form = None
            if one is not None:
                trial = ufl.TrialFunction(space.function_space)
                form = _without_zeros(ufl.derivative(one, space.increment, trial))
            row.append(form)
        jacobian.append(row)
    linear = not any(
        isinstance(c, Coefficient) and any(c is u for u in increments)
        for row in jacobian
        for form in row
        if form is not None
        for c in form.coefficients()
    )
    external = by_field(parts[False])
    if linear:
        # the Jacobian does not know what is there without increments, as c is in (u + c)·v
        rest = _AtRest(increments)
        for k, one in enumerate(internal):
            constant = None if one is None else _without_zeros(map_integrand_dags(rest, one))
            if constant is not None:
                external[k] = constant if external[k] is None else external[k] + constant
    return OrdinaryTerms(external, internal, jacobian, linear)
