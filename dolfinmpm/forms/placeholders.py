"""Placeholders: constants in an expression that stand for values that vary from point to point."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field

import ufl
from dolfinx import fem
from ufl.algorithms.apply_algebra_lowering import apply_algebra_lowering
from ufl.algorithms.remove_complex_nodes import remove_complex_nodes
from ufl.classes import Argument
from ufl.core.expr import Expr
from ufl.corealg.map_dag import map_expr_dag
from ufl.corealg.multifunction import MultiFunction

from dolfinmpm._platform.errors import FormError
from dolfinmpm.basis.space import Space
from dolfinmpm.body.points import MaterialPoints, PointField
from dolfinmpm.forms.operators import PointOperator
from dolfinmpm.forms.termqueries import check_solved_for

__all__ = ["Placeholders"]

# UFL sorts constants by their number as text, and FFCx compiles again if the order changes. All
# numbers of placeholders therefore have the same number of digits. The same expression gets the
# same numbers.
_FIRST = 1_000_000_000


@dataclass
class Placeholders(MultiFunction):
    """Replaces all values that vary from point to point by constants (placeholders).

    Attributes:
        spaces: Spaces of the increments.
        points: Material points.
        sources: Key of the data of each placeholder. Keys are ("value", k) and ("gradient", k) for
            the increment of field k; ("field", name); ("operator", k), ("operator tangent", k),
            ("operator by mean", k) and ("mean slope", k) for operator k; ("function", k) for
            entry k of `functions`; and ("constant", k) for entry k of `constants`.
        functions: DOLFINx functions in the expressions, and whether their gradient is meant.
        constants: DOLFINx constants in the expressions.
        operators: Operators (laws) in the expressions.
        value, gradient: Placeholders of each field's increment and its gradient, as UFL variables.
        test_value, test_gradient: Placeholders of each field's test function and its gradient.
        operator_value: Placeholders of the operators' values, as UFL variables.
    """

    spaces: Sequence[Space]
    points: MaterialPoints
    sources: dict[ufl.Constant, tuple] = field(default_factory=dict)
    functions: list[tuple[fem.Function, bool]] = field(default_factory=list)
    constants: list[fem.Constant] = field(default_factory=list)
    operators: list[PointOperator] = field(default_factory=list)

    def __post_init__(self):
        MultiFunction.__init__(self)
        self.domain = self.points.grid.ufl_domain()
        gdim = self.points.gdim
        self._kept: dict[tuple, ufl.Constant] = {}
        self._number = itertools.count(_FIRST)
        self.value, self.gradient, self.test_value, self.test_gradient = [], [], [], []
        for k, space in enumerate(self.spaces):
            shape = space.increment.ufl_shape
            self.value.append(ufl.variable(self.placeholder(("value", k), shape)))
            self.gradient.append(ufl.variable(self.placeholder(("gradient", k), (*shape, gdim))))
            self.test_value.append(ufl.variable(self._constant(shape)))
            self.test_gradient.append(ufl.variable(self._constant((*shape, gdim))))
        self.operator_value: list[Expr] = []

    def _constant(self, shape: tuple[int, ...]) -> ufl.Constant:
        return ufl.Constant(self.domain, shape=shape, count=next(self._number))

    def placeholder(self, key: tuple, shape: tuple[int, ...]) -> ufl.Constant:
        """The placeholder for the data with this key; it is made at the first use.

        Args:
            key: Key of the data.
            shape: Shape of the data at a point.
        """
        if key not in self._kept:
            self._kept[key] = self._constant(shape)
            self.sources[self._kept[key]] = key
        return self._kept[key]

    def map(self, expression: Expr) -> Expr:
        """The expression with placeholders in place of data.

        Args:
            expression: UFL expression, derivatives expanded.

        Raises:
            FormError: A part of the expression has no value at material points.
        """
        return map_expr_dag(self, remove_complex_nodes(apply_algebra_lowering(expression)))

    def _field_of(self, o) -> int | None:
        for k, space in enumerate(self.spaces):
            if o is space.increment:
                return k
        return None

    def _test_of(self, o) -> int:
        for k, space in enumerate(self.spaces):
            if o == space.test:
                return k
        raise FormError(
            f"'{o}' is not the test function of a space that the problem solves for; use Space.test"
        )

    def _check_points(self, o) -> None:
        if o.points is not self.points:
            raise FormError(f"'{o}' belongs to other material points than the measure of its term")

    # handlers: UFL calls them by the names of its types

    def expr(self, o, *operands):
        return self.reuse_if_untouched(o, *operands)

    def grad(self, o):
        (inner,) = o.ufl_operands
        if isinstance(inner, Argument):
            return self.test_gradient[self._test_of(inner)]
        k = self._field_of(inner)
        if k is not None:
            return self.gradient[k]
        if isinstance(inner, fem.Function):
            return self._function(inner, True)
        raise FormError(
            f"'{o}' cannot be evaluated at material points: only increments, test functions and "
            "DOLFINx functions have a gradient there, and only a first gradient"
        )

    def argument(self, o):
        return self.test_value[self._test_of(o)]

    def coefficient(self, o):
        k = self._field_of(o)
        if k is not None:
            return self.value[k]
        if isinstance(o, PointField):
            self._check_points(o)
            return self.placeholder(("field", o.name), o.ufl_shape)
        if isinstance(o, PointOperator):
            self._check_points(o)
            if o not in self.operators:
                self.operators.append(o)
                key = ("operator", len(self.operators) - 1)
                self.operator_value.append(ufl.variable(self.placeholder(key, o.ufl_shape)))
            return self.operator_value[self.operators.index(o)]
        if isinstance(o, fem.Function):
            return self._function(o, False)
        raise FormError(f"'{o}' has no values at material points")

    def _function(self, o, gradient: bool):
        check_solved_for(o, self.spaces)
        if o.function_space.mesh is not self.points.grid:
            raise FormError(f"the function '{o}' lives on another mesh than the material points")
        if o.function_space.ufl_element().element_family is None:
            raise FormError(
                f"the function '{o}' of a mixed or quadrature element has no values at material "
                "points: interpolate it, or a part of it, into a Lagrange or DG space"
            )
        if (o, gradient) not in self.functions:
            self.functions.append((o, gradient))
        shape = (*o.ufl_shape, self.points.gdim) if gradient else o.ufl_shape
        return self.placeholder(("function", self.functions.index((o, gradient))), shape)

    def constant(self, o):
        if o in self.sources:
            return o
        if not isinstance(o, fem.Constant):
            raise FormError(f"the constant '{o}' has no value; use dolfinx.fem.Constant")
        if o not in self.constants:
            self.constants.append(o)
        return self.placeholder(("constant", self.constants.index(o)), o.ufl_shape)

    def spatial_coordinate(self, o):
        return self.placeholder(("field", "x"), o.ufl_shape)

    def geometric_quantity(self, o):
        raise FormError(
            f"'{o}' ({type(o).__name__}) has no value at material points; of the grid's geometry "
            "only the spatial coordinate has a value there"
        )

    def restricted(self, o):
        raise FormError(f"'{o}' restricts to one side of a facet, but its measure is over points")

    facet_avg = cell_avg = restricted
