"""Surfaces of rigid bodies from shapes and meshes."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
import numpy.typing as npt

from dolfinmpm._platform.argumentchecks import refuse_idle, shown
from dolfinmpm._platform.errors import ParameterError
from dolfinmpm.body.shapes import Ball, Box, Polygon, TurnedBox
from dolfinmpm.contact.facetedsurface import FacetedSurface
from dolfinmpm.contact.fillets import filleted
from dolfinmpm.contact.rigidshapes import Cone, Plane
from dolfinmpm.contact.surfacemesh import is_mesh, mesh_surface
from dolfinmpm.contact.surfaces import HalfSpace, Revolved, RigidSurface, Round, Rounded

__all__ = ["surface_of"]

Array = npt.NDArray[np.float64]

# Sides of a box: its corners in binary order, anticlockwise as seen from outside
_SIDES = np.array(
    [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
)
_TRIANGLES = np.concatenate([_SIDES[:, [0, 1, 2]], _SIDES[:, [0, 2, 3]]])


def surface_of(shape: Any, fillet: float) -> RigidSurface:
    """The surface of a shape; see `RigidBody`.

    Args:
        shape: The shape.
        fillet: Radius by which convex edges are rounded (m).

    Raises:
        ParameterError: A rigid body cannot have this shape, a mesh has a fault, or the fillet is
            too large.
        OSError: A file cannot be read.
    """
    if isinstance(shape, (Plane, Ball)):
        refuse_idle("fillet", fillet, 0.0, "this shape has no edges")
    if isinstance(shape, Plane):
        return HalfSpace(shape.point, shape.normal)
    if isinstance(shape, Ball):
        centre, low = shape.centroid, shape.low
        assert centre is not None
        assert low is not None
        return Round(centre, float(centre[0] - low[0]))
    if isinstance(shape, Polygon):
        return _polygon(shape.vertices, fillet)
    if isinstance(shape, (Box, TurnedBox)):
        return _box(shape, fillet)
    if isinstance(shape, Cone):
        return Revolved(_polygon(shape.profile, fillet), shape.tip, shape.axis)
    if isinstance(shape, str) and not os.path.splitext(shape)[1]:
        raise ParameterError(
            f"shape = {shown(shape)} is no shape, and no file of a mesh, whose name has an ending: "
            "give a shape such as mpm.Disc((0, 1), 0.5)"
        )
    if is_mesh(shape):
        surface = mesh_surface(shape)
        return filleted(surface, fillet) if fillet else surface
    raise ParameterError(
        f"shape = {shown(shape)} is none of a rigid body: give Plane, Disc, Ball, Box, TurnedBox, "
        "Polygon, Wedge, Cone, or a closed surface mesh of triangles"
    )


def _closed(corners: Array) -> FacetedSurface:
    """The surface of a polygon whose corners go anticlockwise."""
    at = np.arange(len(corners))
    return FacetedSurface(corners, np.column_stack([at, np.roll(at, -1)]))


def _polygon(vertices: Array, fillet: float) -> RigidSurface:
    x = np.asarray(vertices, float)
    y = np.roll(x, -1, axis=0)
    if np.sum(x[:, 0] * y[:, 1] - x[:, 1] * y[:, 0]) < 0:
        x = x[::-1]
    if fillet == 0.0:
        return _closed(x)
    before, after = x - np.roll(x, 1, axis=0), np.roll(x, -1, axis=0) - x
    before /= np.linalg.norm(before, axis=1)[:, None]
    after /= np.linalg.norm(after, axis=1)[:, None]
    # edges that move inwards meet on the bisectors
    inward = [np.column_stack([-e[:, 1], e[:, 0]]) for e in (before, after)]
    half = 1.0 + np.sum(inward[0] * inward[1], axis=1)
    core = x + fillet * (inward[0] + inward[1]) / half[:, None]
    kept = np.sum((np.roll(core, -1, axis=0) - core) * after, axis=1)
    if not np.all(half > 1e-9) or not np.all(kept > 0.0):
        shortest = np.linalg.norm(np.roll(x, -1, axis=0) - x, axis=1).min()
        raise ParameterError(
            f"fillet = {fillet:g} m is too large: it removes a whole edge of the shape, whose "
            f"shortest edge has {shortest:.4g} m; give a smaller fillet"
        )
    return Rounded(_closed(core), fillet)


def _box(shape: Box | TurnedBox, fillet: float) -> RigidSurface:
    box = shape.box if isinstance(shape, TurnedBox) else shape
    low, high = box.low, box.high
    assert low is not None
    assert high is not None
    if not 2 <= low.size <= 3:
        raise ParameterError("a rigid box has two or three coordinates")
    if not np.all(high - low > 2 * fillet):
        raise ParameterError(
            f"fillet = {fillet:g} m must be less than half of the box's sides, {high - low} m"
        )
    low, high = low + fillet, high - fillet
    if low.size == 2:
        x = np.array([low, (high[0], low[1]), high, (low[0], high[1])])
    else:
        bits = np.array([[k >> 2 & 1, k >> 1 & 1, k & 1] for k in range(8)])
        x = np.where(bits, high, low)
    if isinstance(shape, TurnedBox):
        x = shape.turn(x)
    core = _closed(x) if low.size == 2 else FacetedSurface(x, _TRIANGLES)
    return Rounded(core, fillet) if fillet else core
