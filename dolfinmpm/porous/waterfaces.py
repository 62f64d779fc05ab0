"""What water does at the surfaces of a body that it fills: held pressures, seepage, inflow."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import ufl
from ufl.core.expr import Expr

from dolfinmpm._platform.checks import number, shown
from dolfinmpm._platform.errors import ParameterError
from dolfinmpm.body.axisymmetry import in_section
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.body.surface import Surface
from dolfinmpm.grid.constants import own_constant
from dolfinmpm.porous.kinematics import Kinematics
from dolfinmpm.porous.projection import largest, size_of

__all__ = ["Flow", "entering", "held", "seeping", "surfaces"]

# Penalty of a drained surface, by what flows through a cell and what a cell stores
_DRAINED = 100.0


@dataclass(frozen=True)
class Flow:
    """Flow of water in a step, for terms at surfaces.

    Attributes:
        points: Material points.
        u, p, q: Increment of the displacement, pressure, and its test function times M/h.
        at: What the step does to volumes.
        M: P-wave modulus (Pa).
        K: k/γ_w (m²/(Pa s)).
        drive: What drives the flow (Pa/m).
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
    def stiffness(self) -> Expr:
        """Penalty of a pressure that is held, per area and step (m/Pa)."""
        h = size_of(self.p)
        return _DRAINED * (self.points.dt * largest(self.K) / h + h / self.M)

    def area(self, surface: Surface) -> Expr:
        """Area vectors of a surface at the end of the step, by Nanson's formula (m²)."""
        points, inverse, area = self.points, self.at.inverse, surface.area
        if inverse is None:
            return area
        F = ufl.dot(ufl.inv(in_section(points, inverse)), in_section(points, points.F))
        area = ufl.det(F) * ufl.dot(area, ufl.inv(F))
        if points.axisymmetric:
            area *= surface.position(self.u)[0] / (points.x0 + surface.offset)[0]
        return area


def surfaces(
    what: str, given: Any, points: MaterialPoints, unit: str, otherwise: float | None = None
) -> list[tuple[Surface, Any]]:
    """Surfaces, each with its value for UFL.

    Args:
        what: What it is called in messages.
        given: A surface, a pair of one and a value, or several of these.
        points: Material points.
        unit: Unit of the values.
        otherwise: Value of a surface without one, or None where it must have one.

    Raises:
        ParameterError: It is something else.
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
        found.append((surface, value))
    return found


def held(flow: Flow, surface: Surface, value: Expr) -> ufl.Form:
    """Nitsche's condition without its adjoint: what flows through the face, and a penalty."""
    points = flow.points
    gap = surface.at(flow.p) - value
    form = surface.density * flow.stiffness * gap * surface.at(flow.q) * points.dX
    out = flow.K * flow.drive if flow.K.ufl_shape == () else ufl.dot(flow.K, flow.drive)
    through = ufl.dot(out, flow.area(surface)) / points.V0
    return form - points.dt * through * surface.at(flow.q) * points.dX


def seeping(flow: Flow, surface: Surface, value: Expr) -> ufl.Form:
    """What leaves where the pressure is above a value, by a penalty; nothing enters."""
    out = ufl.max_value(surface.at(flow.p) - value, 0.0)
    return surface.density * flow.stiffness * out * surface.at(flow.q) * flow.points.dX


def entering(flow: Flow, surface: Surface, rate: Expr) -> ufl.Form:
    """A volume of water that enters per first area and time."""
    points = flow.points
    return -points.dt * rate * surface.density * surface.at(flow.q) * points.dX
