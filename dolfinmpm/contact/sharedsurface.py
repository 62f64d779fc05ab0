"""Areas of a rigid surface by which the corners that touch it share a limit of the shear stress.

A limit of the shear stress τ gives corners the largest tangential forces τ A. The areas A must
fill the surface, whatever corners touch it: domains cut by the surface are smaller than others,
and beside an oblique surface some columns of points do not reach it. So each corner covers the
surface up to the middle between it and its neighbours (a Voronoi cell, bounded by the corner's own
part of a domain's face on sides without a neighbour). Within some columns of points the corners
then share these areas in proportion to their normal forces,

    A_i = S_i(p w/V),    S_i(q) = Σ_j V_j q_i φ_ij / Σ_k q_k φ_kj,
    φ_ij = max(0, 1 − |x_i − x_j|/r).

V_j is the area that a corner covers. The sum of A is that of V. If all of the surface within a
radius r is pressed by more than τ/μ in the mean, then the shear force is τ times this area, even if
single corners carry it. The weights w have S_i(w) = V_i, so that A = V under a uniform pressure,
also at an edge.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numba
import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm.body.axisymmetry import ring
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.contact.cornerareas import part_areas
from dolfinmpm.contact.corners import longest

__all__ = [
    "TouchingCorners",
    "areas_at_end",
    "areas_at_start",
    "domains_at_start",
    "shared_areas",
]

Array = npt.NDArray[np.float64]

# Radius r in lengths of the longest side of a domain: a surface at 45° cuts points to triangles
# that are two such lengths apart, and some of them may not touch
_RADIUS = 4.0
# Neighbours are on the same side of an edge: least cosine of the angle between their normals
_SAME_SIDE = 0.5
# The corner's own part bounds the area in directions more than 48° from all neighbours, measured as
# if this part were a square: four neighbours are enough all around
_BESIDE = 0.67
_RAYS = 32
# Length of a ray by the distance of its line above which the area is that of a sector of a circle
_OBLIQUE = 2.0
# Least area of a corner by the largest one
_LEAST = 1e-6
# Area of a part by its squared edges below which it is a strip, thrice as long as wide
_STRIP = 0.3
# Iterations of the weights: A/V is within 1e-3 of 1 at an edge under a uniform pressure
_ROUNDS = 10
# Part of the radius by which places are the same
_SAME = 1e-9


@dataclass(frozen=True)
class TouchingCorners:
    """Corners of this rank that touch the rigid surface.

    Attributes:
        places: Middles of their parts of the surface (m), shape (m, d).
        normals: Normals of the surface, shape (m, d).
        parts: Half edges of these parts (m), shape (m, d-1, d).
        sides: Longest sides of the points' domains (m), shape (m,).
        forces: Normal forces, positive (N), shape (m,).
    """

    places: Array
    normals: Array
    parts: Array
    sides: Array
    forces: Array

    def gathered(self, comm: MPI.Comm) -> tuple[TouchingCorners, slice]:
        """Those of all ranks, and which of them are those of this rank. Collective."""
        if comm.size == 1:
            return self, slice(None)
        every = comm.allgather(self)
        first = sum(len(one.sides) for one in every[: comm.rank])
        joined = [np.concatenate(values) for values in zip(*(vars(one).values() for one in every))]
        return TouchingCorners(*joined), slice(first, first + len(self.sides))


def domains_at_start(active: Any) -> tuple[Array, Array] | None:
    """Domains of the corners' points, for `areas_at_end`; None where corners share no surface.

    Fused steps change the domains before the areas are found, other steps do so after it.

    Args:
        active: The contact, an `ActiveRigidContact`.

    Returns:
        Half edges (m), shape (m, d, d), and longest sides of the points' domains (m), shape (m,).
    """
    contact, rows = active.contact, active.corners.rows
    if not contact.shares_surface:
        return None
    return active.layout.half_edges(rows), 2.0 * longest(contact.points["l"][rows])


def areas_at_start(active: Any, normal: Array, gap: Array) -> Array:
    """Areas A of the corners of an `ActiveRigidContact` in a step (m^(d-1)), shape (m,).

    Corners that begin to touch have their own parts of the surface: they take the places of others
    that cease to touch.

    Args:
        active: The contact.
        normal, gap: Normals of the surface at the corners, shape (m, d), and gaps (m), shape (m,).
    """
    contact, c = active.contact, active.corners
    area = contact.points[contact.names.slip_area][c.rows, c.which]
    new = np.flatnonzero(area <= 0.0)
    parts = active.layout.surface_parts(c.rows[new], c.which[new], normal[new], gap[new])[1]
    area[new] = _around(contact.points, c.x[new], part_areas(parts))
    return np.asarray(area)


def areas_at_end(active: Any) -> Array:
    """Areas by which the corners share the surface after a step (m^(d-1)), shape (m,). Collective.

    Args:
        active: The contact, an `ActiveRigidContact`.
    """
    contact, forces = active.contact, active.now.normal
    points, pose, area = contact.points, contact.body.pose, np.zeros(len(forces))
    c = np.flatnonzero((forces > 0.0) & np.isfinite(active.x).all(axis=1))
    x, rows, which = active.x[c], active.corners.rows[c], active.corners.which[c]
    gap, normal, _ = contact.body.surface.probe(pose.back(x))
    normal = pose.directions(normal)
    edges, sides = active.start.domains
    places = x - gap[:, None] * normal
    if active.followed is not None:
        gap = gap + active.followed.beyond[c]
    middles, parts = active.layout.surface_parts(rows, which, normal, gap, edges[c])
    places = places + middles
    touching = TouchingCorners(places, normal, parts, sides[c], forces[c])
    area[c] = shared_areas(touching, points)
    return area


def _around(points: MaterialPoints, x: Array, area: Array) -> Array:
    """Areas all around the axis in axisymmetric problems, else the areas (m^(d-1)), shape (m,)."""
    return ring(np.maximum(x[:, 0], 0.0), area) if points.axisymmetric else area


def shared_areas(own: TouchingCorners, points: MaterialPoints) -> Array:
    """Areas A of the corners of this rank (m^(d-1)), shape (m,). Collective.

    Args:
        own: The corners.
        points: Material points.
    """
    # loaded where it is used: it takes a tenth of a second
    from scipy.spatial import cKDTree

    all_, mine = own.gathered(points.comm)
    if not len(all_.sides):
        return np.empty(0)
    pairs = cKDTree(all_.places).query_pairs(_RADIUS * all_.sides.max(), output_type="ndarray")
    i, j = pairs.T
    away = np.linalg.norm(all_.places[j] - all_.places[i], axis=1)
    radius = _RADIUS * all_.sides
    reach = np.maximum(radius[i], radius[j])
    # domains that the surface has cut are small: the largest one nearby gives the radius
    near = away < reach
    for one in (i, j):
        np.maximum.at(radius, one[near], reach[near])
    reach = np.maximum(radius[i], radius[j])
    cosine = np.sum(all_.normals[i] * all_.normals[j], axis=1)
    near = (away < reach) & (cosine > _SAME_SIDE)
    i, j, away, reach, cosine = i[near], j[near], away[near], reach[near], cosine[near]
    # the arc on a circle between two places, from the chord
    half = 0.5 * np.arccos(np.minimum(cosine, 1.0))
    arc = away / np.sinc(half / math.pi)
    same = away < _SAME * reach
    covered = _covered(all_.places, all_.normals, all_.parts, i[~same], j[~same], arc[~same])
    number = np.ones(len(covered))
    for ends in (i[same], j[same]):
        np.add.at(number, ends, 1.0)
    covered /= number
    covered = _around(points, all_.places, covered)
    if not covered.any():
        return covered[mine]
    # a corner that is behind others may cover nothing
    some = np.maximum(covered, _LEAST * covered.max())
    return _by_force(all_.forces / some, some, i, j, 1.0 - away / reach)[mine]


@numba.njit(cache=True, error_model="numpy")
def _by_force(pressure, covered, i, j, phi):
    """Areas A of corners with these mean pressures and areas V (m^(d-1)); see above.

    Args:
        pressure, covered: p/V (Pa) and V (m^(d-1)), shape (m,).
        i, j, phi: Pairs of neighbours, and φ, shape (n,).
    """
    weights = covered.copy()
    for _ in range(_ROUNDS):
        weights *= covered / _shared(weights, covered, i, j, phi)
    return _shared(pressure * weights, covered, i, j, phi)


@numba.njit(cache=True, error_model="numpy")
def _shared(by, covered, i, j, phi):
    """S(q), shape (m,); see above."""
    total = by.copy()
    for k in range(i.size):
        total[i[k]] += phi[k] * by[j[k]]
        total[j[k]] += phi[k] * by[i[k]]
    share = covered / total
    area = share.copy()
    for k in range(i.size):
        area[i[k]] += phi[k] * share[j[k]]
        area[j[k]] += phi[k] * share[i[k]]
    return by * area


@numba.njit(cache=True, error_model="numpy")
def _covered(places, normals, parts, first, second, arc):
    """Areas that corners cover: star-shaped about them, by rays (m^(d-1)), shape (m,).

    Args:
        places, normals, parts: See `TouchingCorners`.
        first, second: Pairs of neighbours, shape (n,).
        arc: Distances of the neighbours along the surface (m), shape (n,).
    """
    m, d = places.shape
    rays = 2 if d == 2 else _RAYS
    frame = np.empty((m, 2, d))
    # of the line that bounds a ray: distance, angle, and length of the ray up to it
    line, angle, length = np.zeros((m, rays)), np.zeros((m, rays)), np.full((m, rays), np.inf)
    beside = np.zeros((m, rays), np.bool_)
    to_square = np.empty((m, 2, 2))
    for c in range(m):
        _frame(normals[c], parts[c], frame[c])
        _to_square(frame[c], parts[c], to_square[c])
    for k in range(first.size):
        for c, other in ((first[k], second[k]), (second[k], first[k])):
            along, across = 0.0, 0.0
            for a in range(d):
                along += frame[c, 0, a] * (places[other, a] - places[c, a])
                across += frame[c, 1, a] * (places[other, a] - places[c, a])
            towards = math.atan2(across, along)
            _bound(towards, 0.5 * arc[k], line[c], angle[c], length[c])
            u, v = _in_square(to_square[c], towards)
            for r in range(rays):
                a, b = _in_square(to_square[c], _direction(r, rays))
                beside[c, r] |= a * u + b * v > _BESIDE
    area = np.zeros(m)
    own = np.empty((3, rays))
    for c in range(m):
        own[2] = np.inf
        for a in range(d - 1):
            # the side of the part beyond its half edge a is parallel to the other half edge
            along, across = 0.0, 0.0
            to = parts[c, a]
            if d == 2:
                along = math.sqrt(to[0] * to[0] + to[1] * to[1])
            else:
                side = parts[c, 1 - a]
                size = math.sqrt(np.sum(side * side))
                if size > 0.0:
                    u, v = np.sum(frame[c, 0] * side) / size, np.sum(frame[c, 1] * side) / size
                    high = -v * np.sum(frame[c, 0] * to) + u * np.sum(frame[c, 1] * to)
                    along, across = -v * high, u * high
            towards, distance = math.atan2(across, along), math.hypot(along, across)
            for to_side in (towards, towards + math.pi):
                _bound(to_side, distance, own[0], own[1], own[2])
        for k in range(rays):
            b, to, size = line[c, k], angle[c, k], length[c, k]
            if not beside[c, k] and own[2, k] < size:
                b, to, size = own[0, k], own[1, k], own[2, k]
            if d == 2:
                area[c] += b
            elif size > _OBLIQUE * b:
                area[c] += size * size * math.pi / rays
            else:
                low, high = (2.0 * k) * math.pi / rays - to, (2.0 * k + 2.0) * math.pi / rays - to
                area[c] += 0.5 * b * b * (math.tan(high) - math.tan(low))
    return area


@numba.njit(cache=True, error_model="numpy")
def _frame(normal, parts, frame):
    """Two directions along a surface; in 2D one, and zeros."""
    d = normal.size
    frame[:] = 0.0
    if d == 2:
        frame[0, 0], frame[0, 1] = -normal[1], normal[0]
        return
    size = 0.0
    for one in parts:
        size = math.sqrt(np.sum(one * one))
        if size > 0.0:
            frame[0] = one / size
            break
    if size == 0.0:
        least = np.argmin(np.abs(normal))
        frame[0] = -normal[least] * normal
        frame[0, least] += 1.0
        frame[0] /= math.sqrt(np.sum(frame[0] * frame[0]))
    frame[1] = np.cross(normal, frame[0])


@numba.njit(cache=True, error_model="numpy")
def _to_square(frame, parts, out):
    """Matrix that makes a part of the surface a square, shape (2, 2); 1 for strips."""
    out[:] = np.eye(2)
    if len(parts) < 2:
        return
    a, b = np.sum(frame[0] * parts[0]), np.sum(frame[0] * parts[1])
    c, d = np.sum(frame[1] * parts[0]), np.sum(frame[1] * parts[1])
    area = a * d - b * c
    if abs(area) > _STRIP * (a * a + b * b + c * c + d * d):
        out[0, 0], out[0, 1], out[1, 0], out[1, 1] = d, -b, -c, a
        out /= area


@numba.njit(cache=True, error_model="numpy")
def _in_square(to_square, angle):
    """Direction in this square of a direction along the surface."""
    u, v = math.cos(angle), math.sin(angle)
    a = to_square[0, 0] * u + to_square[0, 1] * v
    b = to_square[1, 0] * u + to_square[1, 1] * v
    size = math.hypot(a, b)
    return a / size, b / size


@numba.njit(cache=True, error_model="numpy")
def _direction(ray, rays):
    """Angle of a ray (rad)."""
    return (ray + (0.0 if rays == 2 else 0.5)) * 2.0 * math.pi / rays


@numba.njit(cache=True, error_model="numpy")
def _bound(towards, distance, line, angle, length):
    """Let a line bound the rays that are shorter up to it.

    Args:
        towards, distance: Direction of the line from the corner (rad), and its distance (m).
        line, angle, length: Distance, direction and length up to the line, of each ray; changed.
    """
    rays = line.size
    for k in range(rays):
        cosine = math.cos(_direction(k, rays) - towards)
        if cosine > 0.0 and distance < cosine * length[k]:
            line[k], angle[k], length[k] = distance, towards, distance / cosine
