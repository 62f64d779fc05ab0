"""Terms that material points integrate: fluxes, and their tangents with the tangents of laws.

At a point, the integrand is a function of the values and gradients of increments and test
functions. The flux is the derivative of the integrand by the test function's value and gradient.
The tangent is the derivative of the flux by the increment's value and gradient.
"""

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import ufl
from ufl.algorithms import expand_derivatives
from ufl.algorithms.apply_algebra_lowering import apply_algebra_lowering
from ufl.algorithms.apply_derivatives import apply_derivatives
from ufl.classes import Zero
from ufl.constantvalue import zero
from ufl.core.expr import Expr
from ufl.corealg.traversal import unique_pre_traversal

from dolfinmpm._platform.argumentchecks import Tags
from dolfinmpm._platform.errors import FormError
from dolfinmpm.basis.space import Space
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.forms.declarations import Declaration
from dolfinmpm.forms.operators import AveragingLaw, PointOperator
from dolfinmpm.forms.placeholders import Placeholders
from dolfinmpm.forms.pointwise import Program, compile_program
from dolfinmpm.forms.termqueries import brief, depends_on, operators_in, summands, tags_of

__all__ = ["PointTerms", "TangentBlock", "component", "derive"]


@dataclass(frozen=True)
class TangentBlock:
    """Compiled derivative of one field's flux (row) by one field's increment (column).

    Attributes:
        program: Program that writes a matrix per point: one row per placeholder of the row field,
            one column per placeholder of the column field. Placeholders of a component are its
            value, then its gradient.
        row_value, value: Whether the row field and the column field have placeholders for values;
            if not, only gradients have placeholders.
    """

    program: Program
    row_value: bool
    value: bool


class PointTerms:
    """Terms that some of the material points integrate. Programs are compiled at their first use.

    The fluxes are multiplied by the points' volumes and have shape (points, c, 1 + d). c counts
    the components of all fields. The first entry of the last axis multiplies the test function's
    value, the other d entries multiply its gradient.

    Without tags, the terms of tagged measures are zero at points with other tags.

    Args:
        integrals: Integrals over these points.
        spaces: Spaces of the increments.
        points: Material points.
        tags: Tags of the points, or None for all points.
        but: True to take the points that have none of the tags.
        declarations: Declarations of the laws in the form.
        mixed: Whether a term or a law may be for only some of the tags.

    Attributes:
        placeholders: Operators, functions and constants in the terms.
        operators: Operators (laws) in the integrands.
        everywhere: Whether all points integrate the terms.
    """

    def __init__(
        self,
        integrals,
        spaces: Sequence[Space],
        points: MaterialPoints,
        tags: frozenset[int] | None = None,
        but: bool = False,
        declarations: Sequence[Declaration] = (),
        mixed: bool = False,
    ):
        self._tags, self._but, self._mixed = tags, but, mixed
        self.everywhere = tags is None
        self.placeholders = placeholders = Placeholders(spaces, points)
        self.operators: list[PointOperator] = placeholders.operators
        increments = [space.increment for space in spaces]
        parts: dict[bool, list[Expr]] = {False: [], True: []}
        for integral in integrals:
            volume: Expr = placeholders.placeholder(("field", integral.metadata()["volume"]), ())
            where = tags_of(integral)
            if where is not None and (tags is None or mixed):
                volume = volume * placeholders.placeholder(("tagged", where), ())
            for term in summands(integral.integrand()):
                arguments = {a for a in ufl.algorithms.extract_arguments(term) if a.number() == 0}
                if len(arguments) != 1:
                    raise FormError(
                        f"the term '{brief(term)}' must be linear in one test function, it has "
                        f"{len(arguments)}; an energy needs ufl.derivative(energy, u, v)"
                    )
                strange = [o for o in operators_in(term) if not self._has(o.tags)]
                own = ufl.replace(term, {o: zero(o.ufl_shape) for o in strange})
                if not isinstance(own, Zero):
                    parts[depends_on(own, increments)].append(volume * placeholders.map(own))
        for declaration in declarations:
            # a law's fields are written even if the form contains only its derivative
            if declaration.operator is not None and self._has(declaration.tags):
                placeholders.map(declaration.operator)
        self._fluxes = {varies: self._flux(terms) for varies, terms in parts.items()}
        self._operands = [
            placeholders.map(expand_derivatives(o.operand)) for o in placeholders.operators
        ]
        for k, operator in enumerate(placeholders.operators):
            if isinstance(operator.law, AveragingLaw) and self.field_of(k) is None:
                raise FormError(
                    f"'{operator}' averages over cells and takes the gradient of one increment, "
                    f"but its operand is '{brief(operator.operand)}'"
                )

    def _has(self, tags: Tags) -> bool:
        """Whether a law for these tags is called at the points of the terms, or at some of them."""
        if tags is None or self._tags is None:
            return True
        if self._mixed:
            return bool(self._tags & set(tags))
        return not self._but and self._tags <= set(tags)

    def chosen(self, tags: npt.NDArray[np.int32]) -> npt.NDArray[np.bool_] | None:
        """Whether each point integrates the terms, shape (points,); None if all points do.

        Args:
            tags: Tag of each point, shape (points,).
        """
        if self._tags is None:
            return None
        return np.isin(tags, list(self._tags), invert=self._but)

    def integrates(self, tags: Tags) -> bool:
        """Whether all points of the terms integrate a term for the given tags."""
        if tags is None:
            return True
        return not self._but and self._tags is not None and self._tags <= set(tags)

    def strains(self, k: int) -> bool:
        """Whether a term contains the gradient of the k-th field's test function."""
        fluxes = [flux[k] for flux in self._fluxes.values() if flux]
        return any(not isinstance(gradient, Zero) for _, gradient in fluxes)

    def ruled(self, laws: Sequence[Declaration]) -> bool:
        """Whether some points of the terms have one of the laws."""
        return any(self._has(law.tags) for law in laws)

    @property
    def tags(self) -> frozenset[int] | None:
        """Tags of the points; None for all points, and for all points without some tags."""
        return None if self._but else self._tags

    @functools.cached_property
    def averages(self) -> bool:
        """Whether a law takes means over cells."""
        return any(isinstance(operator.law, AveragingLaw) for operator in self.operators)

    @property
    def by_centres(self) -> bool:
        """Whether each point counts in the means only in the cell of its centre.

        Raises:
            FormError: Laws of these points differ in this.
        """
        laws = [o.law for o in self.operators if isinstance(o.law, AveragingLaw)]
        kinds = {bool(getattr(law, "by_centres", False)) for law in laws}
        if len(kinds) > 1:
            raise FormError(
                'laws with fbar=True and with fbar="centres" meet at the same points; take one of '
                "the two for all laws"
            )
        return kinds == {True}

    def _flux(self, terms: list[Expr]) -> list[list[Expr]]:
        """For every field, derivatives by the test function's value and by its gradient."""
        if not terms:
            return []
        placeholders, total = self.placeholders, sum(terms[1:], start=terms[0])
        fluxes = [
            [
                derive(total, placeholders.test_value[k]),
                derive(total, placeholders.test_gradient[k]),
            ]
            for k in range(len(placeholders.spaces))
        ]
        tests = {
            c for pair in zip(placeholders.test_value, placeholders.test_gradient) for c in pair
        }
        for flux in (f for pair in fluxes for f in pair):
            if any(node in tests for node in unique_pre_traversal(flux)):
                raise FormError(
                    f"'{brief(total)}' is not linear in the test function; an energy needs "
                    "ufl.derivative(energy, u, v)"
                )
        return fluxes

    @functools.cached_property
    def external(self) -> Program | None:
        """Flux that does not depend on the increments, or None. The first use is collective."""
        return (
            _flux_program(self._fluxes[False], self.placeholders) if self._fluxes[False] else None
        )

    @functools.cached_property
    def internal(self) -> Program | None:
        """Flux that depends on the increments, or None. The first use is collective."""
        return _flux_program(self._fluxes[True], self.placeholders) if self._fluxes[True] else None

    def _direct(self, k: int) -> int | None:
        """The field whose gradient is the operand of the k-th operator, or None."""
        direct = [f for f, g in enumerate(self.placeholders.gradient) if self._operands[k] is g]
        return direct[0] if direct else None

    def field_of(self, k: int) -> int | None:
        """The only field whose value or gradient is in the k-th operator's operand, or None."""
        direct = self._direct(k)
        if direct is not None:
            return direct
        nodes = set(unique_pre_traversal(self._operands[k]))
        both = zip(self.placeholders.value, self.placeholders.gradient)
        found = [f for f, variables in enumerate(both) if nodes & set(variables)]
        return found[0] if len(found) == 1 else None

    @functools.cached_property
    def operands(self) -> list[Program | tuple]:
        """For every operator, the program of its operand; or the key of a gradient's data."""
        made: list[Program | tuple] = []
        for k, expression in enumerate(self._operands):
            field = self._direct(k)
            if field is not None:
                made.append(("gradient", field))
                continue
            parts = [component(expression, i) for i in np.ndindex(*expression.ufl_shape)]
            made.append(
                compile_program(self.placeholders.points.grid, parts, self.placeholders.sources)
            )
        return made

    @functools.cached_property
    def tangent(self) -> dict[tuple[int, int], TangentBlock]:
        """Derivatives of the internal flux by (row field, column field).

        The first use is collective.
        """
        fields = range(len(self._fluxes[True]))
        blocks = {(i, j): self._block(i, j) for i in fields for j in fields}
        return {pair: block for pair, block in blocks.items() if block is not None}

    @functools.cached_property
    def by_mean(self) -> dict[int, Program]:
        """Derivatives of the internal flux by the mean of each operator that averages over cells.

        Keys are numbers of operators. The results have the shape of the flux. The first use is
        collective.
        """
        return {
            k: _flux_program(self._by_mean(k), self.placeholders)
            for k, operator in enumerate(self.operators)
            if isinstance(operator.law, AveragingLaw) and self._fluxes[True]
        }

    @functools.cached_property
    def mean_flux(self) -> dict[int, Program]:
        """Derivatives of averaged scalars by value and gradient of the field, by operator.

        Only for operators whose law averages over cells and whose operand is not just a gradient.
        The placeholder ("mean slope", k) is the derivative of the averaged scalar by the operand.
        The results have the shape of the field's flux. The first use is collective.
        """
        return {
            k: self._mean_flux(k)
            for k, operator in enumerate(self.operators)
            if isinstance(operator.law, AveragingLaw) and self._direct(k) is None
        }

    def _mean_flux(self, k: int) -> Program:
        placeholders, operand, field = self.placeholders, self._operands[k], self.field_of(k)
        assert field is not None
        slope = placeholders.placeholder(("mean slope", k), operand.ufl_shape)
        total = ufl.inner(slope, operand)
        flux = [
            derive(total, placeholders.value[field]),
            derive(total, placeholders.gradient[field]),
        ]
        return _flux_program([flux], placeholders, [field])

    def _by_mean(self, k: int) -> list[list[Expr]]:
        placeholders = self.placeholders
        shape = placeholders.operators[k].ufl_shape
        slope = placeholders.placeholder(("operator by mean", k), shape)

        def through(flux: Expr) -> Expr:
            i, o = ufl.indices(len(flux.ufl_shape)), ufl.indices(len(shape))
            by_operator = derive(flux, placeholders.operator_value[k])
            if isinstance(by_operator, Zero):
                return Zero(flux.ufl_shape)
            term = by_operator[(*i, *o)] * slope[o] if o else by_operator * slope
            return apply_algebra_lowering(ufl.as_tensor(term, i) if i else term)

        return [[through(flux) for flux in pair] for pair in self._fluxes[True]]

    def _through(self, flux: Expr, variable: Expr) -> Expr:
        """Derivative of a flux by an increment's value or gradient, with the tangents of laws."""
        placeholders = self.placeholders
        total = derive(flux, variable)
        for k, operator in enumerate(placeholders.operators):
            by_operator = derive(flux, placeholders.operator_value[k])
            by_variable = derive(self._operands[k], variable)
            if isinstance(by_operator, Zero) or isinstance(by_variable, Zero):
                continue
            shape, inner = operator.ufl_shape, self._operands[k].ufl_shape
            slope = placeholders.placeholder(("operator tangent", k), (*shape, *inner))
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
        placeholders, fluxes = self.placeholders, self._fluxes[True][row]
        variables = placeholders.value[column], placeholders.gradient[column]
        parts = [[self._through(flux, variable) for variable in variables] for flux in fluxes]
        empty = [[isinstance(part, Zero) for part in both] for both in parts]
        if all(e for both in empty for e in both):
            return None
        row_value = not all(empty[0])
        value = not (empty[0][0] and empty[1][0])
        gdim = placeholders.points.gdim

        def places(space: Space, with_value: bool):
            for i in np.ndindex(*space.increment.ufl_shape):
                if with_value:
                    yield 0, i
                for j in range(gdim):
                    yield 1, (*i, j)

        components = [
            component(parts[s][r], (*i, *j))
            for s, i in places(placeholders.spaces[row], row_value)
            for r, j in places(placeholders.spaces[column], value)
        ]
        program = compile_program(placeholders.points.grid, components, placeholders.sources)
        return TangentBlock(program, row_value, value)


def _flux_program(
    fluxes, placeholders: Placeholders, fields: Sequence[int] | None = None
) -> Program:
    components = []
    spaces = placeholders.spaces if fields is None else [placeholders.spaces[f] for f in fields]
    for (value, gradient), space in zip(fluxes, spaces):
        for i in np.ndindex(*space.increment.ufl_shape):
            components.append(component(value, i))
            components += [component(gradient, (*i, j)) for j in range(placeholders.points.gdim)]
    return compile_program(placeholders.points.grid, components, placeholders.sources)


def derive(expression: Expr, variable: Expr) -> Expr:
    """Derivative of an expression of placeholders by one placeholder."""
    return apply_derivatives(apply_algebra_lowering(ufl.diff(expression, variable)))


def component(expression: Expr, index: tuple[int, ...]) -> Expr:
    """Component of a tensor; a scalar is returned as it is."""
    return expression[index] if index else expression
