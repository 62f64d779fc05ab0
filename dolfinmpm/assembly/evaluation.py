"""Point terms evaluated: nodal increments in, fluxes and tangents at the points out."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from ufl.algorithms import expand_derivatives, extract_coefficients
from ufl.core.expr import Expr

from dolfinmpm._platform.errors import FieldShapeError, FormError
from dolfinmpm.assembly.cellmeans import CellCouplings
from dolfinmpm.assembly.points import Pattern, add_stiffness, add_vector
from dolfinmpm.basis import Stencils
from dolfinmpm.basis.space import Space
from dolfinmpm.basis.stencils import gather
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.cut.unknowns import Unknowns
from dolfinmpm.forms.declarations import Tags, rows_within
from dolfinmpm.forms.operators import AveragingLaw, PointOperator
from dolfinmpm.forms.pointwise import Program, compile_program
from dolfinmpm.forms.slots import Slots
from dolfinmpm.forms.splitting import PointTerms

__all__ = ["PointEvaluator", "PointUpdates"]

Array = npt.NDArray[np.float64]

# Points that laws and programs work on at a time: their tangents fit into the cache.
_CHUNK = 4096


def _function_values(function: fem.Function, gradient: bool, points: MaterialPoints) -> Array:
    """A DOLFINx function, or its gradient, at the points."""
    if gradient:
        shape = (*function.ufl_shape, points.gdim)
        degree = max(function.function_space.ufl_element().embedded_superdegree, 1)
        space = fem.functionspace(points.grid, ("DG", degree, shape))
        slope = fem.Function(space)
        expression = fem.Expression(ufl.grad(function), space.element.interpolation_points())
        slope.interpolate(expression)
        function = slope
    if len(points) == 0:
        return np.empty((0, *function.ufl_shape))
    x = np.zeros((len(points), 3))
    x[:, : points.gdim] = points["x"]
    return np.ascontiguousarray(function.eval(x, points["cell"])).reshape(len(points), -1)


class PointEvaluator:
    """Fluxes and tangents of compiled point terms.

    Residual and tangent are pure functions of the points' state and the nodal
    increments.

    Args:
        terms: Compiled terms.
        spaces: Spaces of the fields, stacked.
        points: Material points.
    """

    def __init__(self, terms: PointTerms, spaces: Sequence[Space], points: MaterialPoints):
        self._terms = terms
        self._points = points
        self._components = sum(space.components for space in spaces)
        self._starts = np.cumsum([0] + [space.components for space in spaces])
        self._data: dict[tuple, Array] = {}
        self.failed_point = -1
        self._failed: tuple[int, PointOperator, Array] | None = None

    @property
    def gradient_only(self) -> bool:
        """Whether only gradients enter the tangent."""
        return self._terms.gradient_only

    @property
    def averages(self) -> bool:
        """Whether a law takes means over cells; it needs couplings then."""
        return bool(self._terms.by_mean)

    def start_step(self, stencils: Stencils, couplings: CellCouplings | None = None) -> None:
        """Take the points' fields and stencils as they are now. Collective.

        Args:
            stencils: Stencils on the solver's nodes.
            couplings: Means over cells and what they couple, if a law takes any.
        """
        self._couplings = couplings
        points, n, d, nc = self._points, len(self._points), self._points.gdim, self._components
        self._stencils = stencils
        self._value = np.zeros((n, nc))
        self._gradient = np.zeros((n, nc, d))
        self._data.clear()
        given = {
            c.name
            for declaration in self._terms.declarations
            for expression in declaration.given.values()
            for c in extract_coefficients(expression)
        }
        for name, values in points.fields.items():
            if values.dtype == np.float64:
                # parameters are not numbers at points of other laws, where nobody asks for them
                self._data["field", name] = np.nan_to_num(values) if name in given else values
        for k, (first, last) in enumerate(zip(self._starts[:-1], self._starts[1:])):
            whole = last - first == nc
            self._data["value", k] = self._value if whole else np.empty((n, last - first))
            self._data["gradient", k] = (
                self._gradient.reshape(n, nc * d) if whole else np.empty((n, (last - first) * d))
            )
        for k, (function, gradient) in enumerate(self._terms.functions):
            self._data["function", k] = _function_values(function, gradient, points)
        for program in (self._terms.external, self._terms.internal):
            for kind, tags in (key for key in (program.inputs if program else ())):
                if kind == "tagged":
                    self._data[kind, tags] = np.isin(points["tag"], tags).astype(float)
        self._rows = [rows_within(points, operator.tags) for operator in self._terms.operators]
        self.update_constants()

    def update_constants(self) -> None:
        """Take the values of the DOLFINx constants as they are now."""
        for k, constant in enumerate(self._terms.constants):
            self._data["constant", k] = np.array(constant.value, float).reshape(1, -1)

    def interpolate(self, u: Array) -> None:
        """Values and gradients at the points of nodal increments, shape (nodes, components).

        Collective if a law takes means over cells.
        """
        gather(self._stencils, u, self._value, self._gradient)
        if len(self._starts) > 2:
            n = len(self._value)
            for k, (first, last) in enumerate(zip(self._starts[:-1], self._starts[1:])):
                self._data["value", k][:] = self._value[:, first:last]
                self._data["gradient", k][:] = self._gradient[:, first:last].reshape(
                    n, (last - first) * self._gradient.shape[2]
                )
        for k in self._terms.by_mean:
            assert self._couplings is not None
            self._averaging(k).prepare(self.operand(k), self._couplings.means.mean)

    def _averaging(self, k: int) -> AveragingLaw:
        law = self._terms.operators[k].law
        assert isinstance(law, AveragingLaw)
        return law

    @property
    def value(self) -> Array:
        """Increments at the points, shape (points, components)."""
        return self._value

    @property
    def gradient(self) -> Array:
        """Their gradients, shape (points, components, gdim)."""
        return self._gradient

    def operand(self, k: int) -> Array:
        """Operand of the k-th operator, shape (points, size)."""
        source = self._terms.operands[k]
        if isinstance(source, Program):
            values = np.empty((len(self._points), source.size))
            source.run(self._data, values)
            return values
        return self._data[source]

    def _chunks(self) -> Iterator[tuple[int, int]]:
        """Ranges of groups of some thousand points each."""
        groups, first = self._stencils.groups, 0
        while first < groups.size - 1:
            last = int(np.searchsorted(groups, groups[first] + _CHUNK, side="right")) - 1
            last = max(last, first + 1)
            yield first, last
            first = last

    def _run(
        self, programs: Sequence[Program], tangent: bool
    ) -> Iterator[tuple[int, int, list[Array]]]:
        """Operators and programs, some thousand points at a time, in the order of the stencils.

        Yields the range of groups and the programs' values at their points; ends
        early, with the point in `failed_point`, where a law finds no stress.
        """
        self.failed_point, self._failed = -1, None
        inputs = {key for program in programs for key in program.inputs}
        # dead loads, say, do not ask a law for its stress
        asked = {key[1] for key in inputs if key[0].startswith("operator")}
        operators = {k: self._terms.operators[k] for k in sorted(asked)}
        whole = {k: self.operand(k) for k in operators}
        varying = {key for key in inputs if not key[0].startswith("operator")}
        varying = {key for key in varying if key[0] != "constant"}
        for first, last in self._chunks():
            s = self._stencils
            rows = s.order[s.groups[first] : s.groups[last]]
            data = {key: self._data[key] for key in inputs if key[0] == "constant"}
            for key in varying:
                data[key] = self._data[key].take(rows, axis=0)
            for k, operator in operators.items():
                operand = whole[k].take(rows, axis=0)
                value = np.empty((rows.size, int(np.prod(operator.ufl_shape))))
                slope = np.empty((*value.shape, operand.shape[1])) if tangent else None
                by_mean = None
                if slope is not None and k in self._terms.by_mean:
                    data["operator by mean", k] = by_mean = np.empty_like(value)
                bad = self._ask(k, operand, value, slope, rows, by_mean)
                if bad >= 0:
                    self.failed_point = int(rows[bad])
                    self._failed = self.failed_point, operator, operand[bad]
                    return
                data["operator", k] = value
                if slope is not None:
                    data["operator tangent", k] = slope
            out: list[Array] = [np.empty((rows.size, program.size)) for program in programs]
            for program, values in zip(programs, out):
                program.run(data, values)
            yield first, last, out

    def _ask(self, k: int, operand, value, slope, rows, by_mean) -> int:
        """The k-th operator at some points; zero at those that are not its own."""
        operator = self._terms.operators[k]
        if operator.tags is None:
            if by_mean is None:
                return operator.law.evaluate(operand, value, slope, rows)
            return self._averaging(k).evaluate(operand, value, slope, rows, by_mean)
        mine = np.flatnonzero(np.isin(rows, self._rows[k], assume_unique=True))
        whole = [a for a in (value, slope, by_mean) if a is not None]
        part = [np.empty((mine.size, *a.shape[1:])) for a in whole]
        here = operand[mine], part[0], part[1] if slope is not None else None, rows[mine]
        if by_mean is None:
            bad = operator.law.evaluate(*here)
        else:
            bad = self._averaging(k).evaluate(*here, part[2])
        for a, values in zip(whole, part):
            a[:] = 0.0
            a[mine] = values
        return int(mine[bad]) if bad >= 0 else -1

    def failure(self) -> str:
        """Why a law found no stress at `failed_point`, in the law's own words; may be empty."""
        if self._failed is None or self._failed[0] != self.failed_point:
            return ""
        _, operator, operand = self._failed
        describe = getattr(operator.law, "describe", None)
        return "" if describe is None else describe(operand, self.failed_point)

    def add_internal(self, out: Array) -> bool:
        """Add the nodal forces of the internal terms; returns whether every law found a stress.

        Args:
            out: Nodal forces (N), shape (nodes, components).
        """
        self.failed_point = -1
        if self._terms.internal is not None:
            for first, last, (flux,) in self._run([self._terms.internal], False):
                add_vector(self._stencils, first, last, flux, out)
        return self.failed_point < 0

    def add_external(self, out: Array) -> None:
        """Add the nodal forces of the terms that do not depend on the increments."""
        if self._terms.external is not None:
            for first, last, (flux,) in self._run([self._terms.external], False):
                add_vector(self._stencils, first, last, flux, out)

    def add_tangent(self, unknowns: Unknowns, pattern: Pattern, data: Array, lift: Array) -> None:
        """Add the tangent of the internal terms to the matrix; see `add_stiffness`.

        Collective if a law takes means over cells.
        """
        terms, couplings = self._terms, self._couplings
        if terms.tangent is None:
            return
        left = [couplings.forces(self._components) for _ in terms.by_mean] if couplings else []
        programs = [terms.tangent, *terms.by_mean.values()]
        for first, last, (tangent, *fluxes) in self._run(programs, True):
            add_stiffness(
                self._stencils, first, last, tangent, terms.gradient_only, unknowns, pattern, data,
                lift,
            )  # fmt: skip
            for flux, out in zip(fluxes, left):
                assert couplings is not None
                couplings.add_forces(first, last, flux, out)
        for k, out in zip(terms.by_mean, left):
            assert couplings is not None
            couplings.add_outer(out, self._mean_slope(k), unknowns, pattern, data, lift)

    def _mean_slope(self, k: int) -> Array:
        """How the k-th operator's sums over cells change with the nodal increments."""
        s, couplings, d = self._stencils, self._couplings, self._points.gdim
        assert couplings is not None
        slopes = self._averaging(k).measure_slope(self.operand(k))
        slopes *= couplings.means.weight[:, None]
        flux = np.zeros((len(slopes), self._components, 1 + d))
        (_, field) = self._terms.operands[k]  # type: ignore[misc]
        part = flux[:, self._starts[field] : self._starts[field + 1], 1:]
        part[:] = slopes[s.order].reshape(part.shape)
        out = couplings.forces(self._components)
        couplings.add_forces(
            0, s.groups.size - 1, flux.reshape(len(flux), self._components * (1 + d)), out
        )
        return out

    def commit(self) -> dict[str, Array]:
        """What the laws' fields are at the end of the step; not numbers from `failed_point` on."""
        new: dict[str, Array] = {}
        self.failed_point, self._failed = -1, None

        def write(name: str, rows, values) -> None:
            if name not in new:
                new[name] = self._points[name].copy()
            new[name][rows] = values

        for operator, rows, k in zip(self._terms.operators, self._rows, itertools.count()):
            operand = self.operand(k).take(rows, axis=0)
            for name, values in operator.law.commit(operand, rows).items():
                write(name, rows, values)
                if self.failed_point < 0 and not np.isfinite(values).all():
                    finite = np.isfinite(values.reshape(len(values), -1)).all(axis=1)
                    bad = int(np.argmin(finite))
                    self.failed_point = int(rows[bad])
                    self._failed = self.failed_point, operator, operand[bad]
        for declaration in self._terms.declarations:
            write("moved_under", declaration.rows, declaration.mark)
        return new

    def data_for(self, slots: Slots) -> dict[tuple, Array]:
        """Data for a program compiled from other slots than the terms'."""
        data = {key: a for key, a in self._data.items() if key[0] in ("field", "value", "gradient")}
        for k, constant in enumerate(slots.constants):
            data["constant", k] = np.array(constant.value, float).reshape(1, -1)
        for k, (function, gradient) in enumerate(slots.functions):
            data["function", k] = _function_values(function, gradient, self._points)
        every = np.arange(len(self._points), dtype=np.int32)
        for k, operator in enumerate(slots.operators):
            own = self._terms.operators.index(operator)
            operand = self.operand(own)
            value = np.empty((every.size, int(np.prod(operator.ufl_shape))))
            if self._ask(own, operand, value, None, every, None) >= 0:
                value[:] = np.nan
            data["operator", k] = value
        return data


class PointUpdates:
    """Fields that a converged step sets to UFL expressions of state and increment.

    Args:
        updates: Field name → expression, at all points.
        terms: Terms of the problem; the updates of their laws go before, at the laws' points.
        spaces: Spaces of the increments.
        points: Material points.

    Raises:
        FieldShapeError: An expression has another shape than its field.
        FormError: An expression cannot be evaluated at the points.
    """

    def __init__(
        self,
        updates: dict[str, Expr],
        terms: PointTerms,
        spaces: Sequence[Space],
        points: MaterialPoints,
    ):
        self._slots = Slots(spaces, points)
        self._programs: list[tuple[str, Tags, Program]] = []
        self._points = points
        wanted = [(*one, d.tags) for d in terms.declarations for one in d.updates.items()]
        wanted += [(*one, None) for one in updates.items()]
        for name, expression, tags in wanted:
            shape = points[name].shape[1:]
            if expression.ufl_shape != shape:
                raise FieldShapeError(
                    f"field '{name}' has shape {shape} at a point, the expression that updates it "
                    f"{expression.ufl_shape}"
                )
            mapped = self._slots.map(expand_derivatives(expression))
            parts = [mapped[i] if i else mapped for i in np.ndindex(*shape)]
            program = compile_program(points.grid, parts, self._slots.sources)
            self._programs.append((name, tags, program))
        for operator in self._slots.operators:
            if operator not in terms.operators:
                raise FormError(
                    f"the updates name the stress of '{operator}', which is not in the form; give "
                    "mpm.stress the same law, strain, fbar and tag as mpm.momentum"
                )

    def run(self, evaluator: PointEvaluator, new: dict[str, Array]) -> None:
        """Write the fields' new values into those of the laws."""
        if not self._programs:
            return
        data = evaluator.data_for(self._slots)
        for name, tags, program in self._programs:
            values = np.empty_like(self._points[name])
            program.run(data, values.reshape(len(self._points), program.size))
            if tags is None:
                new[name] = values
                continue
            rows = rows_within(self._points, tags)
            new.setdefault(name, self._points[name].copy())[rows] = values[rows]
