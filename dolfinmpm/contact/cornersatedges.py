"""Corners of domains that meet an edge of a rigid body exactly, as where both are on a grid line.

There the nearest side of the body is not unique. The corner of a domain below the body, and that of
its neighbour beside it, are at the same place. The first one must touch the lower side, and the
second one must not touch at all. A step that began with both held by the upright side had forces
along the surface, and lost the load of the first one. So the sides are those towards the domains:
normals are taken at places slightly within the domains, and a corner that is at an edge is moved
by as much towards its point. A corner is beside the body if a move along either axis alone takes it
away from the body by its whole length.

In later steps the corner of the domain below is inside the body by its penetration, or a little
beyond the edge, as where soil bulges. The upright side may then be the nearest one. Yet it faces
away from this domain, n·r < 0 with the way r from the corner to its point, and cannot hold it. The
side is then the nearest one to a place further within, halfway to the point along n.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import numpy.typing as npt

from dolfinmpm.contact.surfaces import Probe

if TYPE_CHECKING:
    from dolfinmpm.contact.rigidbody import RigidBody

__all__ = ["AtEdges", "normals_at_edges", "pulled"]

Array = npt.NDArray[np.float64]
Chosen = npt.NDArray[np.bool_]

# Share of a half-length by which places are within the domains: ten times that within which a
# corner counts as touching in the first iteration of a step
_WITHIN = 1e-5
# Share of a half-length that is rounding, for places in line
_IN_LINE = 1e-7
# Largest difference of two normals of one side
_ALIKE = 1e-3
# Share of a move by which a corner is beside the body
_BESIDE = 0.999
# Largest distance of a corner from a side that faces away, as a share of the way from there to the
# point. The middle of the part of the face, halfway to the point, is then still below the body
_BEHIND = 0.25
# Share of this way by which the nearest side is then looked for further within the body
_FURTHER = 0.5
# Share of a half-length at which a corner is at the end of the domain
_END = 1.0 - 1e-9


class AtEdges(NamedTuple):
    """Corners beside a rigid body.

    Attributes:
        normal: Normals of the body towards the domains, shape (m, d).
        at_edge: Which corners are at an edge of the body, shape (m,).
        beside: Which of them belong to domains beside the body, shape (m,).
    """

    normal: Array
    at_edge: Chosen
    beside: Chosen

    def chosen(self, kept: Chosen) -> AtEdges:
        """Those of some corners, shape (m,)."""
        return AtEdges(self.normal[kept], self.at_edge[kept], self.beside[kept])


def normals_at_edges(body: RigidBody, probe: Probe, x: Array, inward: Array) -> AtEdges:
    """Normals of a rigid body at corners, and which corners are at an edge of it.

    Args:
        body: The body, at the start of a step.
        probe: Values of its surface at the corners.
        x: Positions of the corners (m), shape (m, d).
        inward: Ways from the corners to their points (m), shape (m, d).
    """
    normal = body.start.directions(probe[1])
    at_edge, beside = np.zeros((2, len(x)), bool)
    near = np.flatnonzero(np.abs(probe[0]) < _IN_LINE * np.linalg.norm(inward, axis=1))
    if not near.size:
        return AtEdges(_facing(body, probe[0], normal, x, inward), at_edge, beside)
    way = _WITHIN * inward[near]

    def moved(by: Array) -> tuple[Array, Array]:
        gap, n, _ = body.surface.probe(body.start.back(x[near] + by))
        return gap, body.start.directions(n)

    along = [moved(way * axis) for axis in np.eye(x.shape[1])]
    within = moved(way)[1]
    found = np.array([within, normal[near], *(n for _, n in along)])
    at_edge[near] = np.ptp(found, axis=0).max(axis=1) > _ALIKE
    gaps = np.array([gap for gap, _ in along]).T
    beside[near] = at_edge[near] & (np.sum(gaps > _BESIDE * np.abs(way), axis=1) >= 2)
    normal[at_edge] = within[at_edge[near]]
    return AtEdges(_facing(body, probe[0], normal, x, inward), at_edge, beside)


def _facing(body: RigidBody, gap: Array, normal: Array, x: Array, inward: Array) -> Array:
    """Normals of the nearest sides that do not face away from the domains; see the module.

    Args:
        body: The body, at the start of a step.
        gap: Gaps of the corners (m), shape (m,).
        normal: Normals of the nearest sides, shape (m, d).
        x, inward: See `normals_at_edges`.
    """
    along = np.sum(normal * inward, axis=1)
    size = np.linalg.norm(inward, axis=1)
    away = np.flatnonzero((along < -_ALIKE * size) & (np.abs(gap) < -_BEHIND * along))
    place, side, way = x[away], normal[away], inward[away]
    for _ in range(x.shape[1] - 1):
        if not away.size:
            break
        behind = np.minimum(np.sum(side * way, axis=1), 0.0)
        place = place + _FURTHER * behind[:, None] * side
        side = body.start.directions(body.surface.probe(body.start.back(place))[1])
    faces = np.sum(side * way, axis=1) > 0.0
    result = normal.copy()
    result[away[faces]] = side[faces]
    return result


def pulled(signs: Array, share: Array, at_edge: Chosen) -> Array:
    """Moves of corners at edges towards their points, by half-lengths, shape (m, d).

    A corner at one side of its domain stays on this side.

    Args:
        signs: Place of each corner in its domain, ±1, shape (m, d).
        share: Places of the parts, see `dolfinmpm.contact.cornerareas.places_on_faces`.
        at_edge: Which corners are at an edge, shape (m,).
    """
    ends = share > _END
    single = np.sum(ends, axis=1, keepdims=True) == 1
    return np.where(at_edge[:, None] & ~(ends & single), -_WITHIN * signs, 0.0)
