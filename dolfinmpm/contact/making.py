"""Surfaces of rigid bodies from shapes and meshes."""

from __future__ import annotations

from typing import Any

from dolfinmpm._platform.checks import shown
from dolfinmpm._platform.errors import ParameterError
from dolfinmpm.body.shapes import Ball
from dolfinmpm.contact.surfaces import HalfSpace, Round, Surface
from dolfinmpm.contact.tools import Plane

__all__ = ["surface_of"]


def surface_of(shape: Any, fillet: float) -> Surface:
    """The surface of a shape; see `RigidBody`.

    Args:
        shape: The shape.
        fillet: Radius by which convex edges are rounded (m).

    Raises:
        ParameterError: It is none that a rigid body can have.
    """
    if isinstance(shape, Plane):
        return HalfSpace(shape.point, shape.normal)
    if isinstance(shape, Ball):
        centre, low = shape.centroid, shape.low
        assert centre is not None
        assert low is not None
        return Round(centre, float(centre[0] - low[0]))
    raise ParameterError(
        f"shape = {shown(shape)} is none of a rigid body: give Plane, Disc, Ball, Box, TurnedBox, "
        "Polygon, Wedge, Cone, or a closed surface mesh of triangles"
    )
