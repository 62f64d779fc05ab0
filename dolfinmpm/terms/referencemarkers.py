"""Boundaries in total Lagrangian bases: initial positions of markers.

Markers that follow the body keep their initial positions X, like the points. Their stencils are
those at X, with gradients by present positions, ∇N = F⁻ᵀ ∇₀N. F is the deformation gradient of the
markers, a product over the steps. Laws use F of the nearest point.

A wall that stays in space meets changing material. A marker at x with the nearest point x_p meets
the material at

    X = X_p + F_p⁻¹ (x − x_p).

This is exact if F is uniform around the point. A wall may not have reached the body yet. Then it
uses the edge of the body in front of it: x moves back along the normal to the domain of the point.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from mpi4py import MPI

from dolfinmpm._platform.errors import ParameterError
from dolfinmpm.body.axisymmetry import in_section
from dolfinmpm.body.boundary import OWN, Boundary
from dolfinmpm.body.location import bounds, use_configuration
from dolfinmpm.body.markerdistance import APART
from dolfinmpm.grid.lattice import largest_cell
from dolfinmpm.kinematics.walldistance import look_ahead

__all__ = ["reference_wall", "require_reference"]

# Beyond this distance from the nearest point, in cells, a wall meets no material
_REACH = 2.0
# The edge of a domain may be a grid line: markers move inwards by this share of its half-length
_INWARD = 1e-6


def require_reference(boundaries: Sequence[Any], contacts: Sequence[Any]) -> None:
    """Prepare boundaries for stencils at initial positions. Collective.

    Args:
        boundaries: Terms over boundaries.
        contacts: Contacts of two deformable bodies.

    Raises:
        ParameterError: The initial position of a boundary is unknown, or the kind of boundary is
            not supported in this configuration.
    """
    total = 'Space(..., configuration="total")'
    for contact in contacts:
        raise ParameterError(
            f"{contact!r} searches facing points in space, and {total} keeps the cells of the "
            'initial positions; give configuration="updated"'
        )
    for of in boundaries:
        boundary, markers = of.boundary, of.boundary.markers
        if not boundary.follows:
            if boundary.activates:
                raise ParameterError(
                    f"{boundary} stays in space and makes cells active, which {total} cannot "
                    "follow; leave activates=True out, or give follows=True"
                )
            look_ahead(boundary)
            markers.add_field("body_x0", (boundary.gdim,), "m")
            markers.add_field(APART)
        elif OWN not in markers.fields:
            moved = not np.array_equal(markers["x"], markers["x0"])
            if boundary.late or markers.comm.allreduce(moved, op=MPI.LOR):
                raise ParameterError(
                    f"the initial position of {boundary}, which {total} needs, is unknown: the "
                    "body had moved before; make the boundary and the problem before the first step"
                )
            e = markers.strain_dim
            markers.add_field(OWN, (e, e), "", np.eye(e))
        use_configuration(markers, "total")


def reference_wall(boundary: Boundary) -> None:
    """Find the initial positions of the material at a wall. Collective.

    The markers of the wall get the state of the nearest point, and move to the ranks of the cells
    at the initial positions.

    Args:
        boundary: A boundary that stays in space.
    """
    markers, grid = boundary.markers, boundary.markers.grid
    n = markers["area"] / markers["V"][:, None]
    away, half = markers["x"] - markers["body_x"], markers["body_l"]
    reach = np.sum(np.abs(n) * half, axis=1)
    before = np.sum(away * n, axis=1) - (1 - _INWARD) * reach
    onto = away - np.maximum(before, 0.0)[:, None] * n
    way = np.linalg.solve(in_section(markers, markers["F"]), onto[:, :, None])[:, :, 0]
    apart = np.abs(way).max(axis=1, initial=0.0) > _REACH * largest_cell(grid)
    way[apart] = 0.0
    low, high = bounds(grid)
    if markers.axisymmetric:
        # a marker must not lie on the axis
        low = np.maximum(low, [_INWARD * largest_cell(grid), -np.inf])
    markers["x0"] = np.clip(markers["body_x0"] + way, low, high)
    markers[APART] = apart.astype(float)
    markers.locate()
