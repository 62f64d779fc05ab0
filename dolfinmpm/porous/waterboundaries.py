"""Conditions for water at the surfaces of a saturated body: pressures, seepage, inflow.

The water's balance has the terms Σ V0 q w, with the volume w of water that leaves through the face
of a point in a step, per initial volume of the point.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from ufl.core.expr import Expr

from dolfinmpm._platform.argumentchecks import Tags, number, shown
from dolfinmpm._platform.errors import DoubtfulInputWarning, ParameterError, raise_together, warn
from dolfinmpm.body.axisymmetry import in_section
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.body.surface import Surface
from dolfinmpm.forms.carriedfields import CarriedField, carried
from dolfinmpm.forms.declarations import in_words
from dolfinmpm.grid.constants import own_constant
from dolfinmpm.porous.mixturestep import Kinematics
from dolfinmpm.porous.projection import largest, size_of

__all__ = [
    "Flow",
    "outflow",
    "prescribed_inflow",
    "prescribed_pressure",
    "refuse_two_pressures",
    "seepage_face",
    "surfaces",
    "warn_of_levels",
]

# Factor of the penalty of a drained surface, relative to flow through a cell and storage in a cell
_DRAINED = 100.0
# Height (m) above the highest mountain, by more than the depth of the deepest sea
_HIGHEST = 2e4


@dataclass(frozen=True)
class Flow:
    """Flow of water in a step, for terms at surfaces.

    Attributes:
        points: Material points.
        u, p, q: Increment of the displacement (m), pressure (Pa), and its test function times M/h.
        at: Volume change and spatial gradients after the step's increment.
        M: P-wave modulus (Pa).
        K: Permeability k/γ_w (m²/(Pa s)).
        drive: Gradient that drives the flow, ∇p − ρ_w (b − a) (Pa/m), shape (gdim,).
    """

    points: MaterialPoints
    u: Any
    p: Any
    q: Any
    at: Kinematics
    M: Expr
    K: Expr
    drive: Expr

    @property
    def rate(self) -> Expr:
        """(k/γ_w)(∇p − ρ_w (b − a)) (m/s), against the direction of the flow."""
        K, drive = self.K, self.drive
        return K * drive if K.ufl_shape == () else ufl.dot(K, drive)

    @property
    def stiffness(self) -> Expr:
        """Penalty of a prescribed pressure, per area and step (m/Pa)."""
        h = size_of(self.p)
        return _DRAINED * (self.points.dt * largest(self.K) / h + h / self.M)

    def area(self, surface: Surface) -> Expr:
        """Area vectors of a surface at the end of the step (m²), by Nanson's formula."""
        points, inverse, area = self.points, self.at.inverse, surface.area
        if inverse is None:
            return area
        F = ufl.dot(ufl.inv(in_section(points, inverse)), in_section(points, points.F))
        area = ufl.det(F) * ufl.dot(area, ufl.inv(F))
        if points.axisymmetric:
            area *= surface.position(self.u)[0] / (points.x0 + surface.offset)[0]
        return area


def surfaces(
    what: str,
    given: Any,
    points: MaterialPoints,
    tags: Tags,
    unit: str,
    otherwise: float | None = None,
) -> list[tuple[Surface, Any]]:
    """Surfaces of an argument, each with its value for UFL.

    Args:
        what: Name of the argument, for messages.
        given: The argument: a surface, a pair of a surface and a value, or several of these.
        points: Material points.
        tags: Tags of the soil's points, None for all points.
        unit: Unit of the values.
        otherwise: Value for surfaces without a value, or None if all surfaces need a value.

    Raises:
        ParameterError: The argument is something else, or has a surface of other points.
    """
    if isinstance(given, Surface):
        given = [given]
    elif isinstance(given, (tuple, list)) and len(given) == 2 and isinstance(given[0], Surface):
        given = [given] if not isinstance(given[1], (Surface, tuple, list)) else given
    elif not isinstance(given, (tuple, list)):
        given = [given]
    found = []
    for one in given:
        pair = one if isinstance(one, (tuple, list)) and len(one) == 2 else (one, otherwise)
        surface, value = pair
        if not isinstance(surface, Surface) or surface.points is not points or value is None:
            alone = "" if otherwise is None else "a dolfinmpm.Surface of these points must be, or "
            raise ParameterError(
                f"{what} has {shown(one)} where {alone}a pair of a dolfinmpm.Surface of these "
                f"points and a value ({unit}) must be"
            )
        if not isinstance(value, Expr):
            value = own_constant(points.grid, number(f"value of {what}", value, unit=unit))
        if tags is not None:
            raise_together(points.comm, _of_other_soil(what, surface, tags))
        found.append((surface, value))
    return found


def warn_of_levels(points: MaterialPoints, weight: Any, ponded: list[tuple[Surface, Any]]) -> None:
    """Warn of a level of water above all mountains and seas: it may be a pressure.

    Args:
        points: Material points.
        weight: Unit weight of the water (N/m³), a constant.
        ponded: Surfaces and levels (m). A level that is no constant may be anything.
    """
    for surface, level in ponded:
        # in other units than N and m, such as N and mm, water has a far smaller number
        metres = float(weight.value) > 1e3
        if metres and isinstance(level, fem.Constant) and float(level.value) > _HIGHEST:
            warn(
                points.comm,
                f"the water that is ponded on '{surface.name}' has its level at "
                f"{float(level.value):g} m: a level is a height along the last axis; if this is a "
                f"pressure (Pa), give the height of the surface plus "
                f"{float(level.value) / float(weight.value):.4g} m",
                DoubtfulInputWarning,
            )


def refuse_two_pressures(held: dict[str, list[tuple[Surface, Any]]]) -> None:
    """Refuse a surface with two conditions on the pressure, whose penalties would both act.

    Args:
        held: Surfaces of conditions on the pressure, by the name of the argument.

    Raises:
        ParameterError: A surface is there twice.
    """
    first: dict[Surface, str] = {}
    for what, found in held.items():
        for surface, _ in found:
            if surface in first:
                raise ParameterError(
                    f"the surface '{surface.name}' is in {first[surface]}= and in {what}= of "
                    "mpm.poromechanics, and a surface has one condition on the pressure: leave one "
                    "out. ponded= lets water leave above its level already; for two parts of a "
                    "face make two surfaces"
                )
            first[surface] = what


def _of_other_soil(what: str, surface: Surface, tags: tuple[int, ...]) -> ParameterError | None:
    """The error for a surface with points of other tags, whose permeability is another, or None."""
    points = surface.points
    faces = np.any(points[surface.area.name], axis=1)
    bad = np.flatnonzero(faces & ~np.isin(points["tag"], tags))
    if not bad.size:
        return None
    p = bad[0]
    return ParameterError(
        f"{what} of mpm.poromechanics({in_words(tags)}) has the surface '{surface.name}', to which "
        f"the point of tag {points['tag'][p]} at {points['x'][p]} m belongs, too: make a Surface "
        "for the part of each soil"
    )


def prescribed_pressure(flow: Flow, surface: Surface, value: Expr) -> Expr:
    """Water that leaves at a prescribed pressure, by Nitsche's method without the adjoint term.

    Args:
        flow: Flow of water in the step.
        surface: The surface.
        value: The pressure (Pa).

    Returns:
        Volume of water that leaves in the step per initial volume of a point: flow, and a penalty.
    """
    points = flow.points
    through = ufl.dot(flow.rate, flow.area(surface)) / points.V0
    return surface.density * flow.stiffness * (flow.p - value) - points.dt * through


def seepage_face(flow: Flow, surface: Surface, value: Expr) -> Expr:
    """Water that leaves where the pressure is above a value, by a penalty; no water enters.

    Args, Returns: See `prescribed_pressure`.
    """
    return surface.density * flow.stiffness * ufl.max_value(flow.p - value, 0.0)


def prescribed_inflow(flow: Flow, surface: Surface, rate: Expr) -> Expr:
    """Water that leaves where an inflow is prescribed: less than nothing.

    Args:
        flow: Flow of water in the step.
        surface: The surface.
        rate: Volume of water that enters per initial area and time (m/s).

    Returns: See `prescribed_pressure`.
    """
    return -flow.points.dt * rate * surface.density


def outflow(points: MaterialPoints, surface: Surface, leaving: Expr) -> CarriedField:
    """Water that left through a surface in the last step, see `Surface.outflow` (m/s).

    Args:
        points: Material points.
        surface: The surface.
        leaving: Volume of water that leaves in the step per initial volume of a point.
    """
    rate = leaving / (points.dt * surface.density)
    at_faces = ufl.conditional(ufl.gt(surface.density, 0.0), rate, 0.0)
    field = carried(points, surface.outflow_name, at_faces, unit="m/s")
    field.surface = surface
    return field
