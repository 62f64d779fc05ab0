"""Fields that the points carry from step to step for a term of a weak form.

Building a form does not change the points. The problem that is made from the form adds the fields.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator
from typing import Any

import ufl
from ufl.algorithms import extract_arguments, extract_coefficients
from ufl.core.expr import Expr

from dolfinmpm._platform.argumentchecks import Tags, shown
from dolfinmpm._platform.errors import FormError, ParameterError
from dolfinmpm.basis.space import Space
from dolfinmpm.body.formarguments import check_displacement, check_points
from dolfinmpm.body.points import MaterialPoints, PointField
from dolfinmpm.forms.declarations import in_words
from dolfinmpm.forms.termqueries import tags_of

__all__ = [
    "CARRIED",
    "CarriedField",
    "CellOffset",
    "StartAcceleration",
    "acceleration",
    "carried",
    "carried_in",
]

# Fields that a step sets when it moves the points
_MOVED = ("x", "x0", "V", "V0", "F", "l", "l0")
# Key in the metadata of a measure: fields that its terms carry but do not contain
CARRIED = "carried"


class CarriedField(PointField):
    """Value of an expression at the points, at the end of the last step.

    Attributes:
        update: The expression.
        of: The unknown of the problem, if the expression is this unknown and nothing else; or
            None. The unknown is then a field itself and no increment.
        level: Share of the step at which forces balance, for which the expression was written.
            The unknowns in the expression belong to this level, and its value belongs to the end
            of the step. 1 except for generalised-α methods. None if the expression is that of
            the whole step's unknowns, whatever the level.
        bounds: Limits of the values, which must lie strictly between them, or None.
        gravity: Acceleration (m/s²) whose weight of this density is in the terms, or None.
        surface: Surface at whose faces the unknowns in the expression are taken, or None.
        slope_of: Name of the carried field whose gradient it is, or None. Where it is still zero,
            the values of this field give it before the first step.
        unknown: Name of a field that becomes 0 where `slope_of` gave the gradient, or None.
        pores: Whether the total stress of its points contains this pressure.
        tags: Tags of the points whose terms carry it, None for all points. `carried_in` sets them.
        revision: Revision of the points when zero gradients were last looked for.
    """

    update: Expr
    of: Expr | None = None
    level: float | None = 1.0
    bounds: tuple[float, float] | None = None
    gravity: Expr | None = None
    surface: Any = None
    slope_of: str | None = None
    unknown: str | None = None
    pores: bool = False
    tags: Tags = None
    revision: int = -1


class CellOffset(PointField):
    """Offset of a point in its cell of a field (m), shape (gdim + 1,), set when a step begins.

    The first gdim numbers are the vector from the centre of mass of the cell's points to the
    point. The last number is the size of the cell, or of several cells that count as one; see
    `dolfinmpm.cut.celloffsets`.

    Args:
        points: Material points.
        space: Space of the field.
    """

    def __init__(self, points: MaterialPoints, space: Space):
        super().__init__(points, "cell_offset", (points.gdim + 1,), "m")
        self.space = space


class StartAcceleration(PointField):
    """Part of a step's accelerations that does not depend on the step's increment (m/s²).

    It is set when a step begins.

    Args:
        points: Material points.
    """

    def __init__(self, points: MaterialPoints):
        super().__init__(points, "start_acceleration", (points.gdim,), "m/s²")


def acceleration(points: MaterialPoints, u: Any) -> Expr:
    """Acceleration of the body at the material points, for UFL (m/s²), shape (gdim,).

    The acceleration is interpolated from the nodes, at the level at which a step's forces balance.
    The inertial forces of the problem are then Σ m a·v. The acceleration is `points.inertia` u +
    a₀, so that tangents contain its dependence on the increment u. `Newmark` and
    `GeneralisedAlpha` set `points.inertia` and a₀ by their rules. They have the inertia of
    `density` themselves: a term with the acceleration in the equation of motion is an added mass.
    The first step of such a problem begins with M a = f without the added mass.

    Args:
        points: Material points.
        u: Increment of the displacement, the first field of the problem.

    Raises:
        ParameterError: u is no increment of a displacement of these points.

    Water around the body moves with it, an added mass of 500 kg/m³ that has no weight:

    >>> import dolfinmpm as mpm
    >>> from mpi4py import MPI
    >>> grid = mpm.create_lattice(MPI.COMM_WORLD, [range(5), range(5)])
    >>> points = mpm.fill(grid, mpm.Box((0, 0), (4, 2)), per_cell=2, density=2000.0)
    >>> V = mpm.Space(grid, "gimp")
    >>> import ufl
    >>> a = mpm.acceleration(points, V.increment)
    >>> F = mpm.momentum(mpm.materials.Hencky(1e6, 0.3), points, V.increment, V.test)
    >>> F += 500.0 * ufl.inner(a, V.test) * points.dX
    >>> problem = mpm.Newmark(F, V.increment, points)
    """
    check_points(points)
    check_displacement(points, u=u)
    return points.inertia * u + StartAcceleration(points)


def carried(
    points: MaterialPoints, name: str, expression: Any, *, unit: str = "", first: Any = 0.0
) -> CarriedField:
    """Value of an expression at the material points at the end of the last step, for UFL.

    Terms with rates need it: `(p - mpm.carried(points, "pressure", p, "Pa")) / points.dt`. A
    problem that is made from a form with this value adds a field to the points. A field with the
    same name and shape that exists already is taken. Each converged step sets the field.

    Args:
        points: Material points.
        name: Name of the field. Values of `points[name]` can be set before the first step.
        expression: UFL expression of state and increments, of any shape.
        unit: Unit of the expression.
        first: Value before the first step, see `MaterialPoints.add_field`.

    Raises:
        ParameterError: The name is no identifier, or is the name of a field that steps set; the
            expression is no UFL expression, or contains a test or trial function; or the unit is
            no string.

    A pressure that grows by 5 Pa per second:

    >>> import dolfinmpm as mpm
    >>> from mpi4py import MPI
    >>> grid = mpm.create_lattice(MPI.COMM_WORLD, [range(5), range(5)])
    >>> points = mpm.fill(grid, mpm.Box((0, 0), (4, 2)), per_cell=2, density=2000.0)
    >>> Q = mpm.Space(grid, "gimp", shape=())
    >>> p, q = Q.increment, Q.test
    >>> rate = (p - mpm.carried(points, "pressure", p, unit="Pa")) / points.dt
    >>> problem = mpm.Transient((rate - 5.0) * q * points.dX, p, points)
    >>> record = problem.step(2.0)
    >>> points["pressure"][0].round(6).item()
    10.0
    """
    check_points(points)
    if not isinstance(name, str) or not name.isidentifier():
        raise ParameterError(f"name = {shown(name)} must be an identifier: it names a field")
    if not isinstance(expression, Expr):
        raise ParameterError(
            f"the expression of '{name}' must be a UFL expression, got {shown(expression)}"
        )
    if name in _MOVED:
        raise ParameterError(
            f"name = '{name}' is a field of all points that steps set in another way; give "
            "another name"
        )
    if extract_arguments(expression):
        raise ParameterError(
            f"the expression of '{name}' has a test or trial function, and must have a value: give "
            "the increment, Space.increment"
        )
    if not isinstance(unit, str):
        raise ParameterError(f"unit = {shown(unit)} of '{name}' must be a word, such as 'Pa'")
    field = CarriedField(points, name, expression.ufl_shape, unit, first)
    field.update = expression
    field.of = expression if hasattr(expression, "_dolfinmpm_space") else None
    return field


def _within(expressions: Iterable[Expr]) -> Iterator[PointField]:
    for expression in expressions:
        for c in extract_coefficients(expression):
            if isinstance(c, (CarriedField, CellOffset, StartAcceleration)):
                yield c


def carried_in(form: ufl.Form) -> list[PointField]:
    """Fields that a form's terms carry, or that change when a step begins, each field once.

    Terms over points of different tags may carry different expressions under one name.

    Raises:
        FormError: Two different expressions are carried under one name at the same points.
    """
    found: dict[str, list[tuple[PointField, Tags]]] = {}
    waiting: list[tuple[PointField, Tags]] = []
    for integral in form.integrals():
        tags = tags_of(integral) if "points" in (integral.metadata() or {}) else None
        within = [*_within([integral.integrand()]), *(integral.metadata() or {}).get(CARRIED, ())]
        waiting += [(one, tags) for one in within]
    while waiting:
        one, tags = waiting.pop()
        known = found.setdefault(one.name, [])
        same = next((k for k, (other, _) in enumerate(known) if _agree(one, other)), None)
        if same is None:
            known.append((one, tags))
        else:
            other, covered = known[same]
            joined = None if covered is None or tags is None else tuple({*covered, *tags})
            if joined is covered or (joined and set(joined) == set(covered or ())):
                continue
            known[same] = other, joined
        if isinstance(one, CarriedField):
            waiting += [(c, tags) for c in _within([one.update])]
    for name, fields in found.items():
        for (_, first), (_, second) in itertools.combinations(fields, 2):
            if first is None or second is None or set(first) & set(second):
                raise FormError(
                    f"two expressions are carried under the name '{name}' by the same points "
                    f"({in_words(first)} and {in_words(second)}); give each its own name, or each "
                    "call of mpm.poromechanics its own tag="
                )
        for one, tags in fields:
            if isinstance(one, CarriedField):
                one.tags = tags
    return [one for fields in found.values() for one, _ in fields]


def _agree(one: PointField, other: PointField) -> bool:
    """Whether two fields of one name are set to the same values."""
    if one is other or not isinstance(one, CarriedField):
        return True
    return one.update == getattr(other, "update", None)
