"""Checks of conditions on boundaries that do not fit the grid, against the body of a problem."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from mpi4py import MPI
from ufl.algorithms import extract_arguments

from dolfinmpm._platform.errors import (
    BuriedLoadWarning,
    FormError,
    HeldLoadWarning,
    IdleConditionWarning,
    warn,
)
from dolfinmpm._platform.plainvalues import plain_value
from dolfinmpm._platform.units import FAR_MODULI
from dolfinmpm.body.axisymmetry import in_section
from dolfinmpm.body.boundary import Boundary
from dolfinmpm.body.formsigns import MARK, PRESSURE
from dolfinmpm.body.markergeometry import WITHIN, share_within, volumes_beside
from dolfinmpm.body.points import PointField
from dolfinmpm.body.surface import Surface
from dolfinmpm.forms.carriedfields import CarriedField
from dolfinmpm.forms.declarations import Declaration, in_words
from dolfinmpm.kinematics.nitsche import WeakCondition, refuse_within
from dolfinmpm.kinematics.walls import Wall
from dolfinmpm.terms.boundaryterm import BoundaryTerm

__all__ = ["check_boundary_conditions"]


Array = npt.NDArray[np.float64]
# Largest distance of a load from the plane of a held face, in sizes of its piece
_NEAR = 1e-3
# Cosines of the angles at which two faces are one, and at which a direction is across a load
_SAME, _ACROSS = 0.99, 0.1


def check_boundary_conditions(
    form: ufl.Form,
    boundaries: Sequence[BoundaryTerm],
    declarations: Sequence[Declaration],
    carried: Sequence[PointField],
) -> None:
    """Raise if a condition on a boundary is given twice, or lacks a part of the body's traction.

    Nitsche's method balances the traction of the body. Figures are wrong if it does so twice, or
    with the traction of another law or without that of water, and nothing else shows the error.
    Collective.

    Args:
        form: Weak form of the user.
        boundaries: Terms over boundaries.
        declarations: Laws of the body.
        carried: Fields that the points carry.

    Raises:
        FormError: There is such a condition.

    Warns:
        HeldLoadWarning: A load acts on a face that Nitsche's method holds.
        BuriedLoadWarning: A load acts on a boundary through the body.
        IdleConditionWarning: A load acts on a boundary beside which there is no point.
    """
    for of in boundaries:
        _warn_within(of, form)
        for one, other in itertools.combinations(of.conditions, 2):
            if _same(one, other):
                what = "wall (mpm.signorini)" if isinstance(one, Wall) else "condition"
                raise FormError(
                    f"the form has a {what} at '{of.boundary.name}' twice for the same components "
                    "and points: leave one out, or give them tags or directions of their own"
                )
        for condition in of.conditions:
            if isinstance(condition, Wall) and condition.declaration is not None:
                _check_modulus(condition, declarations)
            if isinstance(condition, WeakCondition) and condition.exact:
                _check_law(condition, declarations)
                _check_sides(condition, declarations)
                _check_water(condition, carried)
                _warn_of_loads(condition, form)


def _warn_within(of: BoundaryTerm, form: ufl.Form) -> None:
    """Warn if a pressure or traction acts on a boundary through the body, or far off. Collective.

    The body on both sides carries such a load. The wall of a cavity is not within the body: the
    cavity has no points.
    """
    boundary = of.boundary
    marks = [integral.metadata() or {} for integral in form.integrals()]
    own = [m for m in marks if m.get("boundary") is boundary and "condition" not in m]
    loads = [m[MARK] for m in own if MARK in m]
    if not loads:
        return
    points, markers = boundary.points, boundary.markers
    amounts, sizes = volumes_beside(points, markers["x"], markers["area"], of.tags)
    if not amounts.any():
        warn(
            points.comm,
            f"{loads[0]} acts on nothing: no material point is beside '{boundary.name}' now. Give "
            "the line or surface at which the body ends, or leave the load out until the body is "
            "there",
            IdleConditionWarning,
        )
    share = share_within(amounts, sizes)
    if share > WITHIN:
        warn(
            points.comm,
            f"{loads[0]} acts within the body: {100 * share:.0f} % of the boundary have material "
            f"points on both sides, and a face of the body has them on one side, up to "
            f"{100 * WITHIN:.0f} % at its corners. The body on both sides carries the load. Give "
            "the line or surface at which the body ends, or remove the points in front of it. For "
            "a load that is meant within the body, take a body force over points.dX",
            BuriedLoadWarning,
        )


def _tags_of(condition: Any) -> Any:
    return None if condition.declaration is None else condition.declaration.tags


def _overlap(a: Any, b: Any) -> bool:
    return a is None or b is None or bool(set(a) & set(b))


def _same(one: Any, other: Any) -> bool:
    """Whether two conditions hold the same components and points, by more than a penalty."""
    if type(one) is not type(other) or not _overlap(_tags_of(one), _tags_of(other)):
        return False
    first, second = one.declaration, other.declaration
    if first is not None and second is not None and first.u is not second.u:
        return False
    if isinstance(one, Wall):
        return True
    if not (one.exact and other.exact):
        return False
    a, b = one.direction, other.direction
    if a is None or b is None or isinstance(a, str) or isinstance(b, str):
        return a is None or b is None or (isinstance(a, str) and isinstance(b, str))
    return bool(np.linalg.norm(np.cross(np.asarray(a, float), np.asarray(b, float))) == 0.0)


def _check_law(condition: WeakCondition, declarations: Sequence[Declaration]) -> None:
    """Raise FormError unless the law and strain of a condition are those of the body there."""
    own = condition.declaration
    assert own is not None
    near = [d for d in declarations if d.u is own.u and _overlap(d.tags, own.tags)]
    if not near:
        return
    name = condition.boundary.name
    if not any(d.law is own.law or plain_value(d.law) == plain_value(own.law) for d in near):
        raise FormError(
            f"the condition (mpm.dirichlet) at '{name}' has the traction of {own.law!r}, and the "
            f"body there that of {near[0].law!r} ({in_words(near[0].tags)}): give the body's law, "
            'or method="penalty"'
        )
    if not any(d.strain == own.strain for d in near):
        raise FormError(
            f"the condition (mpm.dirichlet) at '{name}' has strain = \"{own.strain}\", and the "
            f'body there strain = "{near[0].strain}": give both the same'
        )


def _modulus(law: Any) -> float | None:
    """Young's modulus of a law (Pa), if it is one number."""
    E = getattr(law, "values", {}).get("E")
    return float(E) if isinstance(E, (int, float)) else None


def _check_modulus(wall: Wall, declarations: Sequence[Declaration]) -> None:
    """Raise FormError if the law of a wall, which scales its penalty, is far from the body's.

    The body would sink into the wall by as much: a block of E = 1e6 Pa by 0.04 m with a law of
    1e3 Pa, and no message would tell it.
    """
    own = wall.declaration
    assert own is not None
    near = [d for d in declarations if d.u is own.u and _overlap(d.tags, own.tags)]
    moduli = [E for E in (_modulus(d.law) for d in near) if E is not None]
    given = _modulus(own.law)
    if given is None or not moduli or len(moduli) < len(near):
        return
    if not min(moduli) / FAR_MODULI <= given <= max(moduli) * FAR_MODULI:
        raise FormError(
            f"the wall (mpm.signorini) at '{wall.boundary.name}' has the penalty of {own.law!r}, "
            f"and the body there the law {near[0].law!r} ({in_words(near[0].tags)}): give the "
            "body's law, or a stiffness_per_area (Pa/m) in its place"
        )


def _check_sides(condition: WeakCondition, declarations: Sequence[Declaration]) -> None:
    """Raise ParameterError if the body that moves with the condition's field is on both sides."""
    own = condition.declaration
    assert own is not None
    tags: set[int] = set()
    for moved in (d.tags for d in declarations if d.u is own.u):
        if moved is None:
            refuse_within(condition.boundary, condition.method)
            return
        tags |= set(moved)
    if tags:
        refuse_within(condition.boundary, condition.method, sorted(tags))


def _check_water(condition: WeakCondition, carried: Sequence[PointField]) -> None:
    """Raise FormError if the body there has a pore pressure, and the condition has none."""
    tags = _tags_of(condition)
    fields = [c for c in carried if isinstance(c, CarriedField) and c.pores]
    wet = [c for c in fields if _overlap(c.tags, tags)]
    if wet and not condition.wet:
        raise FormError(
            f"the condition (mpm.dirichlet) at '{condition.boundary.name}' has the traction of the "
            f"effective stress alone, and the body there has a pore pressure, '{wet[0].name}': the "
            "water would push the body off the boundary; give pore_pressure=p, the pressure of "
            'mpm.poromechanics, or method="penalty"'
        )


def _warn_of_loads(condition: WeakCondition, form: ufl.Form) -> None:
    """Warn if a load acts on a face that a condition holds. Collective.

    The method balances the traction of the body alone, and so the penalty carries such a load.
    """
    held, told = condition.boundary, set()
    for integral in form.integrals():
        mark = integral.metadata() or {}
        face = mark.get("surface") or mark.get("boundary")
        vectors = [v for v in extract_arguments(integral.integrand()) if v.ufl_shape != ()]
        if face is None or "condition" in mark or not vectors or id(face) in told:
            continue
        pressure = getattr(mark.get(MARK), "kind", None) == PRESSURE
        if face.points is held.points and _meet(condition, face, pressure):
            told.add(id(face))
            load = mark.get(MARK, f"a load on '{face.name}'")
            warn(
                held.points.comm,
                f"{load} acts where {condition!r} holds the "
                f'body. method="{condition.method}" balances the traction of the body, and so the '
                "penalty alone carries this load: the face gives way. Leave the load out (the "
                'force of the boundary is then less by as much), or take method="penalty"',
                HeldLoadWarning,
            )


def _meet(condition: WeakCondition, face: Surface | Boundary, pressure: bool) -> bool:
    """Whether a load acts on the face of a condition, along a component that it holds. Collective.

    Of a traction the direction is not known before the steps: conditions of one component are then
    taken to leave it free.
    """
    from scipy.spatial import cKDTree

    along, held, comm = condition.direction, condition.boundary, condition.boundary.points.comm
    meets = False
    if along is None or pressure:
        (x, n, sizes), (at, normal, own) = _pieces(held), _pieces(face)
        if len(x) and len(at):
            _, near = cKDTree(x).query(at)
            size = np.maximum(sizes[near], own)
            apart = at - x[near]
            off = np.abs(np.sum(apart * n[near], axis=1))
            aside = np.sqrt(np.maximum(np.sum(apart**2, axis=1) - off**2, 0.0))
            one = np.sum(normal * n[near], axis=1) > _SAME
            one &= (off < _NEAR * size) & (aside < 0.5 * size)
            if along is not None and not isinstance(along, str):
                axis = np.asarray(along, float) / np.linalg.norm(along)
                one &= np.abs(normal @ axis) > _ACROSS
            meets = bool(one.any())
    return bool(comm.allreduce(meets, op=MPI.LOR))


def _pieces(face: Surface | Boundary) -> tuple[Array, Array, Array]:
    """Middles of a face's pieces (m), their unit normals, and their sizes (m)."""
    if isinstance(face, Boundary):
        x, area = face.markers["x"], face.markers["area"]
    else:
        points = face.points
        rows = np.any(points[face.area.name] != 0.0, axis=1)
        F = in_section(points, points["F"][rows])
        x = points["x"][rows] + np.einsum("pij,pj->pi", F, points[face.offset.name][rows])
        area = np.linalg.solve(np.swapaxes(F, 1, 2), points[face.area.name][rows][:, :, None])
        area = np.linalg.det(F)[:, None] * area[:, :, 0]
    size = np.linalg.norm(area, axis=1)
    normal = area / size[:, None]
    if face.points.axisymmetric:
        size = size / (2 * np.pi * x[:, 0])
    return x, normal, size ** (1 / max(x.shape[1] - 1, 1))
