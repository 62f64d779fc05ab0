"""Element tensors of facets for splines of any degree, from one-dimensional matrices.

No kernel is compiled. On a facet of a rectangular grid, a bilinear form is a sum of products of
derivatives of splines. Each derivative is a product of one-dimensional derivatives. Normal to the
facet, the factors are values at the facet from both sides. Along the facet, the factors are
integrals over the edges of a cell.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from ufl import classes
from ufl.algorithms.apply_algebra_lowering import apply_algebra_lowering
from ufl.algorithms.apply_derivatives import apply_derivatives
from ufl.algorithms.expand_indices import expand_indices
from ufl.algorithms.remove_complex_nodes import remove_complex_nodes
from ufl.classes import Argument, FacetArea, FacetNormal, Grad, Indexed, Restricted
from ufl.core.expr import Expr
from ufl.corealg.map_dag import map_expr_dag
from ufl.corealg.multifunction import MultiFunction
from ufl.corealg.traversal import unique_pre_traversal

from dolfinmpm._platform.compat import geometric_dimension, restrict
from dolfinmpm.assembly.latticefacets import LatticeFacet, gauss_rule, product, splines
from dolfinmpm.basis.space import Space
from dolfinmpm.cut.facetmoduli import FacetModulus

__all__ = ["FacetTensors", "facet_moduli", "readable"]

Array = npt.NDArray[np.float64]
# terminals with one value on each side, and operators on such values
# fmt: off
_TERMINALS = (
    Argument, classes.CellVolume, classes.ConstantValue, FacetArea, FacetModulus, FacetNormal,
    classes.MultiIndex, fem.Constant,
)
_OPERATORS = (
    Grad, Indexed, Restricted, classes.Abs, classes.ComponentTensor, classes.Division,
    classes.IndexSum, classes.ListTensor, classes.MathFunction, classes.Power, classes.Product,
    classes.Sum,
)
# fmt: on


class _Facing(MultiFunction):
    """Replaces the normal of a facet by numbers; most terms then vanish."""

    def __init__(self, place: LatticeFacet):
        super().__init__()
        outwards = -1 if place.swapped else 1
        along = [outwards * (d == place.direction) for d in range(len(place.lines))]
        self._normal = ufl.as_vector(along)

    expr = MultiFunction.reuse_if_untouched

    def restricted(self, o):
        # the normal of the second side has been replaced by the first side's normal before
        return self._normal if isinstance(o.ufl_operands[0], FacetNormal) else o


def _restricted(form: ufl.Form) -> ufl.Form:
    """The form with restricted terminals, as in FFCx."""
    form = apply_derivatives(remove_complex_nodes(apply_algebra_lowering(form)))
    return restrict(form)


def facet_moduli(form: ufl.Form) -> list[FacetModulus]:
    """The moduli of facets in a form."""
    return [c for c in form.coefficients() if isinstance(c, FacetModulus)]


def readable(form: ufl.Form, space: Space) -> bool:
    """Whether `FacetTensors` can evaluate a form over ghost facets.

    In such a form only arguments, sizes of cells and moduli of facets vary in space. Its metadata
    contain at most a quadrature degree.

    Args:
        form: The form.
        space: Space of the arguments; its `cell_size` and `cell_edges` may occur.
    """
    if any(integral.metadata().keys() - {"quadrature_degree"} for integral in form.integrals()):
        return False
    try:
        integrals = _restricted(form).integrals()
    except ValueError:
        # a restriction is missing: FFCx reports it
        return False
    sizes = space.cell_size, space.cell_edges
    return all(
        any(node is size for size in sizes)
        or isinstance(node, _TERMINALS if node._ufl_is_terminal_ else _OPERATORS)
        for integral in integrals
        for node in unique_pre_traversal(integral.integrand())
    )


@dataclass(frozen=True)
class _Factor:
    """A component of a derivative of an argument on one side of a facet.

    Attributes:
        number: 0 for the test function, 1 for the increment.
        component: Component of the argument's value.
        side: "+" or "-".
        powers: Order of the derivative in each direction.
    """

    number: int
    component: int
    side: str
    powers: tuple[int, ...]


def _split(o: Expr) -> tuple[Expr, tuple[int, ...], str, int]:
    """Split a term into its terminal, index, side and order of derivatives."""
    side, order = "+", 0
    index: tuple[int, ...] = ()
    while isinstance(o, (Restricted, Indexed, Grad)):
        if isinstance(o, Restricted):
            side = o.side()
        elif isinstance(o, Indexed):
            index = tuple(int(i) for i in o.ufl_operands[1])
        else:
            order += 1
        o = o.ufl_operands[0]
    return o, index, side, order


def _leaves(o: Expr) -> Iterator[Expr]:
    """Terminals of an expression, with index and side."""
    if isinstance(o, (Restricted, Indexed)) or o._ufl_is_terminal_:
        yield o
    else:
        for operand in o.ufl_operands:
            yield from _leaves(operand)


def _factor(o: Expr) -> _Factor | None:
    """The factor of an indexed or restricted argument, or None for other terminals."""
    argument, index, side, order = _split(o)
    if not isinstance(argument, Argument):
        return None
    shape = argument.ufl_shape
    along = index[len(shape) :]
    assert len(along) == order
    component = int(np.ravel_multi_index(index[: len(shape)], shape)) if shape else 0
    gdim = geometric_dimension(argument.ufl_function_space().ufl_domain())
    powers = tuple(along.count(d) for d in range(gdim))
    return _Factor(argument.number(), component, side, powers)


class _Numbers(MultiFunction):
    """Evaluates an integrand at a facet, with given values of its factors."""

    def __init__(
        self, place: LatticeFacet, factors: dict[_Factor, Array], one: FacetModulus | None
    ):
        super().__init__()
        self._place = place
        self._factors = factors
        self._one = one

    def _value(self, o):
        factor = _factor(o)
        if factor is not None:
            return self._factors[factor]
        place = self._place
        terminal, index, side, _ = _split(o)
        if isinstance(terminal, fem.Constant):
            return float(terminal.value[index])
        if isinstance(terminal, FacetModulus):
            return float(terminal is self._one)
        sizes = place.sizes(side)
        if isinstance(terminal, fem.Function) and index:
            return sizes[index[0]]
        if isinstance(terminal, fem.Function):
            return math.prod(sizes) ** (1 / len(sizes))
        if isinstance(terminal, FacetArea):
            sizes = tuple(h for d, h in enumerate(sizes) if d != place.direction)
        return math.prod(sizes)

    # handlers: UFL calls them by the names of its types; without operands as arguments it stops

    terminal = indexed = restricted = _value

    def zero(self, o):
        return 0.0

    def scalar_value(self, o):
        return float(o)

    def sum(self, o, a, b):
        return a + b

    def product(self, o, a, b):
        return a * b

    def division(self, o, a, b):
        return a / b

    def power(self, o, a, b):
        return a**b

    def abs(self, o, a):
        return abs(a)

    def math_function(self, o, a):
        # UFL evaluates functions of numbers itself
        return float(type(o)(ufl.as_ufl(a)))


class _Integral:
    """One integral of a form over facets with one normal, and its factors."""

    def __init__(self, integral: ufl.Integral, facing: _Facing):
        self.integrand = expand_indices(map_expr_dag(facing, integral.integrand()))
        degree = integral.metadata().get("quadrature_degree")
        self.gauss = None if degree is None else max(1, (int(degree) + 2) // 2)
        found = {_factor(o) for o in _leaves(self.integrand)}
        factors = sorted((f for f in found if f), key=lambda f: (f.side, f.powers, f.component))
        # factors that differ only in the component share their matrices
        self.keys = [
            list(dict.fromkeys((f.side, f.powers) for f in factors if f.number == n))
            for n in (0, 1)
        ]
        self.factors = [f for f in factors if f]

    def weights(self, place: LatticeFacet, components: int, one: FacetModulus | None) -> Array:
        """Weights of all products of a test function's factor and an increment's factor.

        Args:
            place: The facet.
            components: Number of components of the arguments.
            one: The modulus that is 1; other moduli are 0.

        Returns:
            Weights, shape (sides and derivatives of the test function, components, sides and
            derivatives of the increment, components).
        """
        sizes = [len(keys) * components for keys in self.keys]
        values: dict[_Factor, Array] = {}
        for f in self.factors:
            at = self.keys[f.number].index((f.side, f.powers)) * components + f.component
            unit = np.zeros(sizes[f.number])
            unit[at] = 1.0
            values[f] = unit[:, None] if f.number == 0 else unit
        numbers = _Numbers(place, values, one)
        result = map_expr_dag(numbers, self.integrand, compress=False)
        shape = len(self.keys[0]), components, len(self.keys[1]), components
        return np.broadcast_to(result, sizes).reshape(shape)


class FacetTensors:
    """Element tensors of a bilinear form over facets, between splines.

    Args:
        form: The form; `readable` must be true for it.
        degree: Degree of the splines.
        components: Number of components of the arguments.
    """

    def __init__(self, form: ufl.Form, degree: int, components: int):
        self._degree = degree
        self._components = components
        self._given = form
        # by direction of the facet, and whether its first cell is the upper cell
        self._facing: dict[tuple[int, bool], list[_Integral]] = {}

    @functools.cached_property
    def _form(self) -> ufl.Form:
        """The form with restricted terminals; other problems may know all tensors already."""
        return _restricted(self._given)

    def __call__(self, place: Any, one: FacetModulus | None = None) -> Array:
        """The tensor of one facet, with the present values of the form's constants.

        Args:
            place: The facet, a `LatticeFacet` or one with the same attributes.
            one: The modulus that is 1; other moduli are 0.

        Returns:
            The tensor, shape (splines, splines, n), between the splines of the two cells, with the
            last direction fastest. n is the number of pairs of components. n is 1 if components
            are not coupled and have the same tensor, as in a ghost penalty.
        """
        c = self._components
        facing = place.direction, place.swapped
        if facing not in self._facing:
            integrals = self._form.integrals()
            self._facing[facing] = [_Integral(i, _Facing(place)) for i in integrals]
        parts = [(part, part.weights(place, c, one)) for part in self._facing[facing]]
        diagonal = [weights[:, 0, :, 0] for _, weights in parts]
        single = all(
            np.array_equal(weights, scale[:, None, :, None] * np.eye(c)[:, None, :])
            for (_, weights), scale in zip(parts, diagonal)
        )
        total = self._zeros(place, 1 if single else c**2)
        for (part, weights), scale in zip(parts, diagonal):
            blocks = scale[:, :, None] if single else weights.transpose(0, 2, 1, 3)
            blocks = blocks.reshape(*scale.shape, -1)
            for r, s in np.argwhere(blocks.any(axis=2)):
                first, second = part.keys[0][r], part.keys[1][s]
                self._add(total, place, first, second, part.gauss, blocks[r, s])
        return total

    def parts(self, place: Any, moduli: Sequence[FacetModulus]) -> Array:
        """Tensors of a facet: without moduli, and per modulus, shape (1 + moduli, m, m, n)."""
        base = self(place)
        slopes = [self(place, one) for one in moduli]
        most = max(t.shape[2] for t in (base, *slopes))
        one = np.eye(self._components).ravel()
        tensors = [t * one if t.shape[2] < most else t for t in (base, *slopes)]
        return np.array([tensors[0], *(t - tensors[0] for t in tensors[1:])])

    def _zeros(self, place: Any, pairs: int) -> Array:
        functions = [self._degree + 1 + (d == place.direction) for d in range(len(place.lines))]
        return np.zeros((math.prod(functions),) * 2 + (pairs,))

    def _add(self, total: Array, place: Any, first, second, gauss, block: Array) -> None:
        """Add the product of two derivatives on their sides, times a block of components."""
        total += product(self._lines(place, first, second, gauss))[:, :, None] * block

    def _lines(self, place: LatticeFacet, first, second, gauss: int | None) -> list[Array]:
        """Matrices of two derivatives on their sides, one matrix per direction."""
        matrices: list[Array] = []
        for d, line in enumerate(place.lines):
            low = place.low[d]
            if d == place.direction:
                a, b = (self._across(place, side, powers[d]) for side, powers in (first, second))
                matrices.append(a[:, None] * b)
                continue
            points, weights = gauss_rule(gauss or self._degree + 1)
            h = line[low + 1] - line[low]
            x = line[low] + 0.5 * h * (points + 1)
            a, b = (splines(line, self._degree, low, x, powers[d]) for _, powers in (first, second))
            matrices.append((0.5 * h * weights * a.T) @ b)
        return matrices

    def _across(self, place: LatticeFacet, side: str, order: int) -> Array:
        """Derivatives at the facet of the splines normal to it, from the cell on a side.

        The spline that does not reach this cell has the value 0.
        """
        line, cell = place.lines[place.direction], place.cell(side)[place.direction]
        low = place.low[place.direction]
        values = np.zeros(self._degree + 2)
        at = line[low + 1 : low + 2]
        own = slice(cell - low, cell - low + self._degree + 1)
        values[own] = splines(line, self._degree, cell, at, order)[0]
        return values
