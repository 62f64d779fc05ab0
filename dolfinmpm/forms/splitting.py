"""Split a weak form into what the points integrate and what DOLFINx integrates.

At the points, the integrand is a function of the increments' values and
gradients there. Its derivatives by the test function's value and gradient are
the flux; the flux's derivatives by the increment's are the tangent.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from ufl.algorithms import expand_derivatives, extract_coefficients
from ufl.algorithms.apply_algebra_lowering import apply_algebra_lowering
from ufl.algorithms.apply_derivatives import apply_derivatives
from ufl.algorithms.map_integrands import map_integrand_dags
from ufl.classes import (
    Coefficient,
    Curl,
    Div,
    Grad,
    NablaDiv,
    NablaGrad,
    Sum,
    Zero,
)
from ufl.constantvalue import zero
from ufl.core.expr import Expr
from ufl.corealg.multifunction import MultiFunction
from ufl.corealg.traversal import unique_pre_traversal

from dolfinmpm._platform.errors import FormError, ParameterError
from dolfinmpm.basis.space import Space
from dolfinmpm.body.points import MaterialPoints, PointField
from dolfinmpm.forms.declarations import Declaration, Tags, as_tags, declared
from dolfinmpm.forms.operators import AveragingLaw, PointOperator
from dolfinmpm.forms.pointwise import Program, compile_program
from dolfinmpm.forms.slots import Slots
from dolfinmpm.forms.throughlaws import through_laws

SpatialDerivative = (Grad, Div, Curl, NablaGrad, NablaDiv)

__all__ = ["GridTerms", "PointTerms", "SplitForm", "TangentBlock", "split"]


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


class GridTerms:
    """Terms over cells and facets of the grid, for DOLFINx's assemblers.

    Attributes:
        external: Part that does not depend on the increments, one form a field, or None.
        internal: Part that does, likewise.
    """

    def __init__(self, integrals, spaces: Sequence[Space]):
        self._spaces = list(spaces)
        increments = [space.increment for space in spaces]
        parts: dict[bool, list[Any]] = {False: [], True: []}
        for integral in integrals:
            for varies in parts:
                terms = [
                    t for t in _summands(integral.integrand()) if _varies(t, increments) == varies
                ]
                if terms:
                    total = sum(terms[1:], start=terms[0])
                    parts[varies].append(integral.reconstruct(total))
        self.external = self._by_field(parts[False])
        self.internal = self._by_field(parts[True])
        if self.linear:
            # the Jacobian does not know what is there without increments, as c is in (u + c)·v
            rest = _AtRest(increments)
            for k, one in enumerate(self.internal):
                constant = None if one is None else _without_zeros(map_integrand_dags(rest, one))
                if constant is not None:
                    here = self.external[k]
                    self.external[k] = constant if here is None else here + constant

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
            one = ufl.replace(whole, others) if others else whole
            result.append(_without_zeros(expand_derivatives(one)))
        return result

    @functools.cached_property
    def jacobian(self) -> list[list[ufl.Form | None]]:
        """Derivative of the internal part, [test field][trial field], or None."""
        jacobian: list[list[ufl.Form | None]] = []
        for one in self.internal:
            row: list[ufl.Form | None] = []
            for space in self._spaces:
                form = None
                if one is not None:
                    trial = ufl.TrialFunction(space.function_space)
                    form = _without_zeros(ufl.derivative(one, space.increment, trial))
                row.append(form)
            jacobian.append(row)
        return jacobian

    @functools.cached_property
    def linear(self) -> bool:
        """Whether the derivative does not depend on the increments."""
        increments = [space.increment for space in self._spaces]
        return not any(
            isinstance(c, Coefficient) and any(c is u for u in increments)
            for row in self.jacobian
            for form in row
            if form is not None
            for c in form.coefficients()
        )


@dataclass(frozen=True)
class TangentBlock:
    """Derivative of one field's flux by one field's increment, compiled.

    Attributes:
        program: Writes (components and slots of the row field, those of the column field).
        row_value, value: Whether the row's and the column field's values have slots, before
            those of their gradients, or gradients only.
    """

    program: Program
    row_value: bool
    value: bool


class PointTerms:
    """Terms that some of the material points integrate; programs are compiled when asked for.

    The fluxes are multiplied by the points' volumes and have shape
    (points, c, 1 + d): c stacked components of all fields, first what goes with
    the test function's value, then what goes with its gradient.

    Without tags the terms of tagged measures are zero at points that do not have them.

    Args:
        integrals: Integrals over these points.
        spaces: Spaces of the increments.
        points: Material points.
        tags: Tags of the points, or None for all of them.
        but: Whether the points are those that have none of the tags instead.
        declarations: What the laws in the form keep at the points.

    Attributes:
        slots: What the terms are made of: operators, functions and constants.
    """

    def __init__(
        self,
        integrals,
        spaces: Sequence[Space],
        points: MaterialPoints,
        tags: frozenset[int] | None = None,
        but: bool = False,
        declarations: Sequence[Declaration] = (),
    ):
        self._tags, self._but = tags, but
        self.slots = slots = Slots(spaces, points)
        increments = [space.increment for space in spaces]
        self._parts: dict[bool, list[Expr]] = {False: [], True: []}
        for integral in integrals:
            volume: Expr = slots.slot(("field", integral.metadata()["volume"]), ())
            where = _tags_of(integral)
            if tags is None and where is not None:
                volume = volume * slots.slot(("tagged", where), ())
            for term in _summands(integral.integrand()):
                arguments = {a for a in ufl.algorithms.extract_arguments(term) if a.number() == 0}
                if len(arguments) != 1:
                    raise FormError(
                        f"the term '{_short(term)}' must be linear in one test function, it has "
                        f"{len(arguments)}; an energy needs ufl.derivative(energy, u, v)"
                    )
                strange = [o for o in _operators(term) if not self._has(o.tags)]
                own = ufl.replace(term, {o: zero(o.ufl_shape) for o in strange})
                if not isinstance(own, Zero):
                    self._parts[_varies(own, increments)].append(volume * slots.map(own))
        for declaration in declarations:
            # what a law keeps is written even where only a slope of it stands in the form
            if declaration.operator is not None and self._has(declaration.tags):
                slots.map(declaration.operator)
        self._fluxes = {varies: self._flux(terms) for varies, terms in self._parts.items()}
        self._operands = [slots.map(expand_derivatives(o.operand)) for o in slots.operators]
        for k, operator in enumerate(slots.operators):
            if isinstance(operator.law, AveragingLaw) and self.field_of(k) is None:
                raise FormError(
                    f"'{operator}' averages over cells and takes the gradient of an increment, not "
                    f"'{_short(operator.operand)}'"
                )

    def _has(self, tags: Tags) -> bool:
        """Whether a law for points of these tags is asked at these points; it is zero at others."""
        if tags is None or self._tags is None:
            return True
        return not self._but and self._tags <= set(tags)

    def chosen(self, tags: npt.NDArray[np.int32]) -> npt.NDArray[np.bool_] | None:
        """Which points integrate the terms, or None if all do.

        Args:
            tags: Tags of the points.
        """
        if self._tags is None:
            return None
        return np.isin(tags, list(self._tags), invert=self._but)

    @property
    def operators(self) -> list[PointOperator]:
        """Operators in the integrand."""
        return self.slots.operators

    @property
    def averages(self) -> bool:
        """Whether a law takes means over cells."""
        return any(isinstance(operator.law, AveragingLaw) for operator in self.operators)

    def _flux(self, terms: list[Expr]) -> list[list[Expr]]:
        """For every field what goes with the test function's value and with its gradient."""
        if not terms:
            return []
        slots, total = self.slots, sum(terms[1:], start=terms[0])
        fluxes = [
            [_derive(total, slots.test_value[k]), _derive(total, slots.test_gradient[k])]
            for k in range(len(slots.spaces))
        ]
        tests = {c for pair in zip(slots.test_value, slots.test_gradient) for c in pair}
        for flux in (f for pair in fluxes for f in pair):
            if any(node in tests for node in unique_pre_traversal(flux)):
                raise FormError(
                    f"'{_short(total)}' is not linear in the test function; an energy needs "
                    "ufl.derivative(energy, u, v)"
                )
        return fluxes

    @functools.cached_property
    def external(self) -> Program | None:
        """Flux that does not depend on the increments, or None. Collective at first."""
        return _flux_program(self._fluxes[False], self.slots) if self._fluxes[False] else None

    @functools.cached_property
    def internal(self) -> Program | None:
        """Flux that does, or None. Collective at first."""
        return _flux_program(self._fluxes[True], self.slots) if self._fluxes[True] else None

    def field_of(self, k: int) -> int | None:
        """The field whose gradient is the k-th operator's operand, or None."""
        direct = [f for f, g in enumerate(self.slots.gradient) if self._operands[k] is g]
        return direct[0] if direct else None

    @functools.cached_property
    def operands(self) -> list[Program | tuple]:
        """For every operator the program of its operand, or the key of its data."""
        made: list[Program | tuple] = []
        for k, expression in enumerate(self._operands):
            field = self.field_of(k)
            if field is not None:
                made.append(("gradient", field))
                continue
            parts = [_at(expression, i) for i in np.ndindex(*expression.ufl_shape)]
            made.append(compile_program(self.slots.points.grid, parts, self.slots.sources))
        return made

    @functools.cached_property
    def tangent(self) -> dict[tuple[int, int], TangentBlock]:
        """Derivatives of the internal flux, by row and column field. Collective at first."""
        fields = range(len(self._fluxes[True]))
        blocks = {(i, j): self._block(i, j) for i in fields for j in fields}
        return {pair: block for pair, block in blocks.items() if block is not None}

    @functools.cached_property
    def by_mean(self) -> dict[int, Program]:
        """For every operator whose law averages over cells, the derivative of the internal
        flux by that mean at the point, of the flux's shape. Collective at first."""
        return {
            k: _flux_program(self._by_mean(k), self.slots)
            for k, operator in enumerate(self.operators)
            if isinstance(operator.law, AveragingLaw) and self._fluxes[True]
        }

    def _by_mean(self, k: int) -> list[list[Expr]]:
        slots = self.slots
        shape = slots.operators[k].ufl_shape
        slope = slots.slot(("operator by mean", k), shape)

        def through(flux: Expr) -> Expr:
            i, o = ufl.indices(len(flux.ufl_shape)), ufl.indices(len(shape))
            by_operator = _derive(flux, slots.operator_value[k])
            if isinstance(by_operator, Zero):
                return Zero(flux.ufl_shape)
            term = by_operator[(*i, *o)] * slope[o] if o else by_operator * slope
            return apply_algebra_lowering(ufl.as_tensor(term, i) if i else term)

        return [[through(flux) for flux in pair] for pair in self._fluxes[True]]

    def _through(self, flux: Expr, variable: Expr) -> Expr:
        """Derivative of a flux by the value or the gradient of an increment, through laws too."""
        slots = self.slots
        total = _derive(flux, variable)
        for k, operator in enumerate(slots.operators):
            by_operator = _derive(flux, slots.operator_value[k])
            by_variable = _derive(self._operands[k], variable)
            if isinstance(by_operator, Zero) or isinstance(by_variable, Zero):
                continue
            shape, inner = operator.ufl_shape, self._operands[k].ufl_shape
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

    def _block(self, row: int, column: int) -> TangentBlock | None:
        slots, fluxes = self.slots, self._fluxes[True][row]
        variables = slots.value[column], slots.gradient[column]
        parts = [[self._through(flux, variable) for variable in variables] for flux in fluxes]
        empty = [[isinstance(part, Zero) for part in both] for both in parts]
        if all(e for both in empty for e in both):
            return None
        row_value = not all(empty[0])
        value = not (empty[0][0] and empty[1][0])
        gdim = slots.points.gdim

        def places(space: Space, with_value: bool):
            for i in np.ndindex(*space.increment.ufl_shape):
                if with_value:
                    yield 0, i
                for j in range(gdim):
                    yield 1, (*i, j)

        components = [
            _at(parts[s][r], (*i, *j))
            for s, i in places(slots.spaces[row], row_value)
            for r, j in places(slots.spaces[column], value)
        ]
        program = compile_program(slots.points.grid, components, slots.sources)
        return TangentBlock(program, row_value, value)


@dataclass(frozen=True)
class SplitForm:
    """A weak form, split.

    Attributes:
        regions: Terms of the points, one entry for every part of the body with terms of
            its own.
        grid: Terms over the grid.
        declarations: What the laws in the form keep at the points.
    """

    regions: list[PointTerms]
    grid: GridTerms
    declarations: list[Declaration]


def split(form: ufl.Form, spaces: Sequence[Space], points: MaterialPoints) -> SplitForm:
    """Split a weak form. Collective.

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
    declarations = declared(form, points)
    for declaration in declarations:
        declaration.bind()
    form = expand_derivatives(through_laws(form))
    at_points: list[Any] = []
    ordinary: list[Any] = []
    for integral in form.integrals():
        if integral.integral_type() == "custom":
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
        _regions(at_points, spaces, points, declarations),
        GridTerms(ordinary, spaces),
        declarations,
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


def _operators(term: Expr) -> list[PointOperator]:
    return [c for c in extract_coefficients(term) if isinstance(c, PointOperator)]


def _tags_of(integral) -> Tags:
    where = integral.subdomain_id()
    try:
        return None if where == "everywhere" else as_tags(where)
    except ParameterError as error:
        raise FormError(
            f"the term '{_short(integral.integrand())}' restricts a measure of points: {error}"
        ) from None


def _regions(
    integrals, spaces: Sequence[Space], points: MaterialPoints, declarations: list[Declaration]
) -> list[PointTerms]:
    """The points' terms, for each set of tags that has terms and laws of its own. Collective."""
    where = [_tags_of(i) for i in integrals]
    laws = sorted(
        {o.tags for i in integrals for o in _operators(i.integrand()) if o.tags is not None}
    )
    mentioned = sorted({tag for tags in (*where, *laws) for tag in tags or ()})
    # points of several laws in one cell share its mean: they must be seen together
    means = any(
        isinstance(o.law, AveragingLaw) for i in integrals for o in _operators(i.integrand())
    )
    if not mentioned or means:
        return [PointTerms(integrals, spaces, points, declarations=declarations)]
    alike: dict[tuple, set[int]] = {}
    for tag in mentioned:
        here = tuple(k for k, tags in enumerate(where) if tags is None or tag in tags)
        alike.setdefault((here, tuple(tag in tags for tags in laws)), set()).add(tag)
    regions = [
        PointTerms(
            [integrals[k] for k in here], spaces, points, frozenset(tags), False, declarations
        )
        for (here, _), tags in alike.items()
    ]
    rest = [i for i, tags in zip(integrals, where) if tags is None]
    return [
        *regions, PointTerms(rest, spaces, points, frozenset(mentioned), True, declarations)
    ]  # fmt: skip


def _flux_program(fluxes, slots: Slots) -> Program:
    components = []
    for (value, gradient), space in zip(fluxes, slots.spaces):
        for i in np.ndindex(*space.increment.ufl_shape):
            components.append(_at(value, i))
            components += [_at(gradient, (*i, j)) for j in range(slots.points.gdim)]
    return compile_program(slots.points.grid, components, slots.sources)


def _derive(expression: Expr, variable: Expr) -> Expr:
    return apply_derivatives(apply_algebra_lowering(ufl.diff(expression, variable)))


def _at(expression: Expr, index: tuple[int, ...]) -> Expr:
    return expression[index] if index else expression


def _without_zeros(form: ufl.Form) -> ufl.Form | None:
    """The form less the integrals of zero that UFL keeps; None if nothing is left."""
    kept = []
    for integral in expand_derivatives(form).integrals():
        terms = [t for t in _summands(integral.integrand()) if ufl.algorithms.extract_arguments(t)]
        if terms:
            kept.append(integral.reconstruct(sum(terms[1:], start=terms[0])))
    return ufl.Form(kept) if kept else None
