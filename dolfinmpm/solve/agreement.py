"""Data of problems and steps that ranks compare; see `dolfinmpm._platform.collective`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.mesh import Mesh
from ufl.algorithms import extract_coefficients
from ufl.algorithms.analysis import extract_constants
from ufl.classes import FixedIndex, MultiIndex, ScalarValue
from ufl.core.expr import Expr
from ufl.corealg.traversal import unique_pre_traversal

from dolfinmpm._platform.plainvalues import PlainValues, plain_value
from dolfinmpm.basis.conditions import Condition
from dolfinmpm.basis.space import Space
from dolfinmpm.body.boundary import Boundary
from dolfinmpm.body.fields import PointField
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.body.shapes import Polygon, Shape
from dolfinmpm.body.surface import Surface
from dolfinmpm.contact.contactlaw import ContactLaw
from dolfinmpm.contact.rigidbody import RigidBody
from dolfinmpm.forms.carriedfields import CARRIED, CarriedField
from dolfinmpm.materials.parametrised import Parametrised

if TYPE_CHECKING:
    from dolfinmpm.solve.problem import Problem

__all__ = ["of_step"]


def of_step(problem: Problem, t: Any = None) -> PlainValues:
    """Data that must be equal on all ranks in a step: time, loads, conditions and motions.

    Args:
        problem: The problem.
        t: End of the step (s), or None in problems without time.
    """
    end = getattr(t, "end", t)
    found: PlainValues = [("the number of the points' fields", len(problem.points.fields))]
    found += [("t", _at_once(t)), ("the last time", _at_once(end))]
    # arguments that a script may set between steps
    found += [(name, _at_once(getattr(problem, name))) for name in sorted(problem._live)]
    constants = [c for c in problem.loads.items if isinstance(c, fem.Constant)]
    found += [(_name_of(c, k), _at_once(c.value)) for k, c in enumerate(constants)]
    for k, condition in enumerate(problem.bcs):
        if condition.velocity is not None:
            name = f"velocity of condition {k + 1} at '{condition.where}'"
            found.append((name, _asked(condition.velocity, end)))
        elif isinstance(condition.value, fem.Constant):
            name = f"{condition.kind} of condition {k + 1} at '{condition.where}'"
            found.append((name, _at_once(condition.value.value)))
    for body in problem.bodies.all:
        at = body.time + 1.0 if t is None else end
        found.append((f"motion of '{body.name}'", _asked(body.prescribed, at)))
        if body.freedom is not None and body.freedom.loads_by_functions:
            found.append((f"load of '{body.name}'", _asked(body.freedom.external, at)))
    found += [(name, _asked(wave, end)) for name, wave in problem.scheme.waves]
    return found


def _at_once(value: Any) -> Any:
    """Fast `plain_value` for common types, because `plain_value` would double the time."""
    kind = type(value)
    if kind is np.ndarray and value.ndim < 2:
        return value.item() if value.ndim == 0 else tuple(value.tolist())
    return value if kind is float or value is None else plain_value(value)


def _asked(function: Any, t: Any) -> Any:
    """Result of a user's function at a time. Its next caller reports an error of the function."""
    try:
        return plain_value(function(t))
    except Exception as error:
        return f"a {type(error).__name__}"


def _name_of(constant: fem.Constant, k: int) -> str:
    name = getattr(constant, "name", None)
    return f"constant {k + 1}" if name is None else f"constant '{name}'"


# -- kinds of arguments -----------------------------------------------------------


@plain_value.register(Mesh)
def _mesh(grid: Mesh) -> Any:
    cells = grid.topology.index_map(grid.topology.dim).size_global
    return ("cells", cells), ("kind", grid.topology.cell_name()), ("gdim", grid.geometry.dim)


@plain_value.register(fem.Constant)
def _constant(constant: fem.Constant) -> Any:
    return plain_value(constant.value)


@plain_value.register(fem.Function)
def _function(function: fem.Function) -> Any:
    space = getattr(function, "_dolfinmpm_space", None)
    return "a function of the grid" if space is None else plain_value(space)


@plain_value.register(Space)
def _space(space: Space) -> Any:
    basis = space.basis
    parts = {
        "basis": type(basis).__name__, "degree": basis.degree, "averaged": basis.averaged,
        "shape": space.increment.ufl_shape, "configuration": space.configuration,
        "domains": space.domains, "coarsen": space.coarsen, "tag": space.tags,
        "order among the spaces of its grid": space.number,
    }  # fmt: skip
    return plain_value(parts)


@plain_value.register(MaterialPoints)
def _points(points: MaterialPoints) -> Any:
    # the order of forms gives the order of the laws of a set of points
    parts = {
        "number": points.total,
        "fields": list(points.symbols.fields),
        "axisymmetric": points.axisymmetric,
        "order among the points of its grid": points.symbols.order,
    }
    return plain_value(parts)


@plain_value.register(Shape)
def _shape(shape: Shape) -> Any:
    kept = {"low": shape.low, "high": shape.high, "volume": shape.volume}
    kept |= {name: vars(shape)[name] for name in ("point", "normal") if name in vars(shape)}
    if isinstance(shape, Polygon):
        kept["vertices"] = shape.vertices
    return plain_value({"kind": type(shape).__name__, **kept})


@plain_value.register(Surface)
def _surface(surface: Surface) -> Any:
    return plain_value({"name": surface.name, "total_area": surface.total_area})


@plain_value.register(Boundary)
def _boundary(boundary: Boundary) -> Any:
    return plain_value({"name": boundary.name, "markers": boundary.markers.total})


@plain_value.register(Condition)
def _condition(condition: Condition) -> Any:
    value: Any = condition.value
    if condition.velocity is not None:
        value = _asked(condition.velocity, 0.0)
    elif not isinstance(value, fem.Constant) and condition.values.ndim:
        value = "numbers"
    return f"component {condition.component} at '{condition.where}'", plain_value(value)


@plain_value.register(Parametrised)
def _law(law: Parametrised) -> Any:
    values = law.__dict__.get("values", {}).items()
    kept = {name: value if isinstance(value, float) else "varying" for name, value in values}
    return plain_value({"kind": type(law).__name__, **kept})


@plain_value.register(RigidBody)
def _body(body: RigidBody) -> Any:
    surface, free = body.surface, body.freedom
    kept = {
        "name": body.name, "kind": type(surface).__name__, "low": surface.low,
        "high": surface.high, "centre": body.position, "motion": _asked(body.prescribed, body.time),
        "free": None if free is None else free.free, "mass": None if free is None else free.mass,
    }  # fmt: skip
    return plain_value(kept)


def _mark(mark: Any) -> Any:
    """Data of a contact or a weak condition: its numbers, words, bodies and boundaries."""
    kinds = bool, int, float, str, tuple, type(None), RigidBody, Boundary, Surface
    values = dict(vars(mark))
    if isinstance(values.get("law"), ContactLaw):
        values |= vars(values["law"])
    kept = {name: value for name, value in values.items() if isinstance(value, kinds)}
    return plain_value({"kind": type(mark).__name__, **kept})


@plain_value.register(ufl.Form)
def _form(form: ufl.Form) -> Any:
    parts: list[tuple[str, Any]] = [("number of terms", len(form.integrals()))]
    for k, integral in enumerate(form.integrals()):
        marks = integral.metadata() or {}
        carried = [*marks.get(CARRIED, ()), *extract_coefficients(integral.integrand())]
        parts += _carried(carried)
        for mark in ("term", "condition"):
            if mark in marks:
                kind = marks[mark].kind if mark == "term" else mark
                parts.append((f"{kind} of term {k + 1}", _mark(marks[mark])))
        if "boundary" in marks:
            parts.append((f"boundary of term {k + 1}", plain_value(marks["boundary"])))
        parts.append((f"measure of term {k + 1}", integral.integral_type()))
        parts += [
            (f"{name} of term {k + 1}", value) for name, value in plain_value(integral.integrand())
        ]
        where = plain_value(integral.subdomain_id()), integral.subdomain_data() is None
        parts.append((f"subdomain of term {k + 1}", where))
    return tuple(parts)


def _carried(fields: Iterable[Any]) -> list[tuple[str, Any]]:
    """Expressions of carried fields, also of carried fields within these expressions."""
    parts, seen, left = [], set(), list(fields)
    while left:
        field = left.pop(0)
        if not isinstance(field, CarriedField) or id(field) in seen:
            continue
        # the expression of a field often contains the field itself
        seen.add(id(field))
        found = plain_value(field.update)
        # a constant or a function of the grid alone is a value, and no list of parts
        alone = isinstance(field.update, fem.Constant) or not isinstance(found, tuple)
        pairs = [("value", found)] if alone else found
        parts += [(f"{n} of what '{field.name}' carries", what) for n, what in pairs]
        if isinstance(field.update, Expr):
            left += extract_coefficients(field.update)
    return parts


@plain_value.register(Expr)
def _expression(expression: Expr) -> Any:
    """Laws, constants, fields and numbers of an expression, and the count of each operation.

    Their order does not count, because UFL sorts operands by numbers that may differ between ranks.
    """
    coefficients, constants = extract_coefficients(expression), extract_constants(expression)
    found = [getattr(c, "declaration", None) for c in (*coefficients, *constants)]
    declared = {id(d): d for d in found if d is not None}.values()
    parts: list[tuple[str, Any]] = []
    for d in declared:
        marks = ("strain", d.strain), ("tag", plain_value(d.tags)), ("fbar", d.fbar)
        parts.append((type(d.law).__name__, (*plain_value(d.law), *marks)))
    numbers_of = [c for c in constants if isinstance(c, fem.Constant)]
    numbers_of = [c for c in numbers_of if getattr(c, "declaration", None) is None]
    parts += [(_name_of(c, k), plain_value(c)) for k, c in enumerate(numbers_of)]
    fields = sorted(c.name for c in coefficients if isinstance(c, PointField))
    numbers, places, operations = [], [], Counter[str]()
    for node in unique_pre_traversal(expression):
        if isinstance(node, ScalarValue):
            value = complex(node)
            numbers += [value.real, value.imag] if value.imag else [value.real]
        elif isinstance(node, MultiIndex):
            # numbers of free indices differ between ranks
            places += [int(index) for index in node if isinstance(index, FixedIndex)]
        operations[type(node).__name__] += 1
    parts += [("fields", plain_value(fields)), ("numbers", plain_value(sorted(numbers)))]
    parts.append(("indices", plain_value(sorted(places))))
    return (*parts, ("operations", plain_value(sorted(operations.items()))))
