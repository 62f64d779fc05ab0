"""Surfaces of rigid bodies: signed distance, outward normal and curvature at any position.

A surface stays at the initial position of its body. For given positions `probe` returns the signed
distance g (m), positive outside, the outward normal n = ∇g and its derivative H = ∇∇g (1/m). The
consistent tangent of contact needs H.
"""

from __future__ import annotations

import math
from typing import Protocol

import numpy as np
import numpy.typing as npt

__all__ = ["HalfSpace", "Probe", "Revolved", "RigidSurface", "Round", "Rounded", "middle_of"]

Array = npt.NDArray[np.float64]
Probe = tuple[Array, Array, Array]


class RigidSurface(Protocol):
    """Interface of a surface for contact.

    Attributes:
        gdim: Dimension of space.
        low, high: Corners of a bounding box (m), shape (gdim,); infinite for an infinite surface.
    """

    gdim: int
    low: Array
    high: Array

    def probe(self, x: Array) -> Probe:
        """Values of g (m), shape (n,), n, shape (n, gdim), and H (1/m), shape (n, gdim, gdim).

        Args:
            x: Positions (m), shape (n, gdim).
        """

    def outline(self, low: Array, high: Array) -> Array:
        """Facets of its picture; for an infinite surface the facets within a box.

        Args:
            low, high: Corners of the box (m), shape (gdim,).

        Returns:
            Corners, shape (facets, gdim, gdim): segments in 2D, triangles in 3D.
        """


class HalfSpace:
    """The half-space behind a plane, or in 2D behind a line.

    Args:
        point: A point of the plane (m), shape (gdim,).
        normal: Its unit normal, out of the body, likewise.
    """

    def __init__(self, point: Array, normal: Array):
        self.point, self.normal = point, normal
        self.gdim = len(point)
        self.low: Array = np.full(self.gdim, -math.inf)
        self.high: Array = np.full(self.gdim, math.inf)

    def probe(self, x: Array) -> Probe:
        """See `RigidSurface`."""
        d = self.gdim
        return (
            (x - self.point) @ self.normal,
            np.tile(self.normal, (len(x), 1)),
            np.zeros((len(x), d, d)),
        )

    def outline(self, low: Array, high: Array) -> Array:
        """See `RigidSurface`."""
        # a basis of the plane, from the axis with the smallest component of the normal
        n, middle = self.normal, 0.5 * (low + high)
        middle = middle - ((middle - self.point) @ n) * n
        reach = float(np.linalg.norm(high - low))
        a = np.eye(self.gdim)[int(np.argmin(np.abs(n)))]
        a -= (a @ n) * n
        a *= reach / np.linalg.norm(a)
        if self.gdim == 2:
            return np.array([[middle - a, middle + a]])
        b = np.cross(n, a)
        p, q, r, s = middle - a - b, middle + a - b, middle + a + b, middle - a + b
        return np.array([[p, q, r], [p, r, s]])


class Round:
    """A disc, or in 3D a ball.

    Args:
        centre: Its centre (m), shape (gdim,).
        radius: Its radius (m).
    """

    def __init__(self, centre: Array, radius: float):
        self.centre, self.radius = centre, radius
        self.gdim = len(centre)
        self.low, self.high = centre - radius, centre + radius

    def probe(self, x: Array) -> Probe:
        """See `RigidSurface`."""
        r = x - self.centre
        size = np.linalg.norm(r, axis=1)
        # the centre itself has no normal
        r[size == 0.0, -1] = 1.0
        safe = np.where(size > 0.0, size, 1.0)[:, None]
        n = r / safe
        H = (np.eye(self.gdim) - n[:, :, None] * n[:, None, :]) / safe[:, :, None]
        return size - self.radius, n, H

    def outline(self, low: Array, high: Array) -> Array:
        """See `RigidSurface`."""
        if self.gdim == 2:
            at = np.linspace(0.0, 2 * np.pi, 97)
            x = self.centre + self.radius * np.column_stack([np.cos(at), np.sin(at)])
            return np.stack([x[:-1], x[1:]], axis=1)
        z = np.linspace(-math.pi / 2, math.pi / 2, 17)
        profile = self.radius * np.column_stack([np.cos(z), np.sin(z)])
        return self.centre + revolved(profile)


class Rounded:
    """The surface at a given distance around a core.

    Convex edges and corners of the core become cylinders and balls. So sharp edges are rounded.

    Args:
        core: The core.
        radius: The radius (m).
    """

    def __init__(self, core: RigidSurface, radius: float):
        self.core, self.radius = core, radius
        self.gdim = core.gdim
        self.low, self.high = core.low - radius, core.high + radius

    def probe(self, x: Array) -> Probe:
        """See `RigidSurface`."""
        g, n, H = self.core.probe(x)
        return g - self.radius, n, H

    def outline(self, low: Array, high: Array) -> Array:
        """See `RigidSurface`."""
        facets = self.core.outline(low, high)
        if self.gdim == 3:
            middle = facets.mean(axis=1)
            n = self.core.probe(middle)[1]
            return facets + self.radius * n[:, None]
        a, b = facets[:, 0], facets[:, 1]
        along = (b - a) / np.linalg.norm(b - a, axis=1)[:, None]
        out = self.radius * np.column_stack([along[:, 1], -along[:, 0]])
        pieces = [np.stack([a + out, b + out], axis=1)]
        for k in range(len(b)):
            corner, first, last = b[k], out[k], out[(k + 1) % len(b)]
            turn = math.atan2(first[0] * last[1] - first[1] * last[0], first @ last)
            if turn <= 0.0:
                continue
            at = np.linspace(0.0, turn, 12)
            c, s = np.cos(at), np.sin(at)
            arc = np.column_stack([c * first[0] - s * first[1], s * first[0] + c * first[1]])
            pieces.append(corner + np.stack([arc[:-1], arc[1:]], axis=1))
        return np.concatenate(pieces)


class Revolved:
    """The surface that a profile sweeps out around an axis in 3D.

    Args:
        profile: A surface in the plane of radius and height (m), mirrored at the axis.
        point: The point of zero height on the axis (m), shape (3,).
        axis: Unit vector of the axis, towards greater heights.
    """

    gdim = 3

    def __init__(self, profile: RigidSurface, point: Array, axis: Array):
        self.profile, self.point, self.axis = profile, point, axis
        radius = float(profile.high[0])
        ends = [point + z * axis for z in (profile.low[1], profile.high[1])]
        # extent of a disc across the axis
        across = radius * np.sqrt(np.maximum(1.0 - axis**2, 0.0))
        self.low = np.minimum(*ends) - across
        self.high = np.maximum(*ends) + across

    def probe(self, x: Array) -> Probe:
        """See `RigidSurface`."""
        arm = x - self.point
        z = arm @ self.axis
        out = arm - z[:, None] * self.axis
        r = np.linalg.norm(out, axis=1)
        on = r <= 1e-14 * max(float(self.profile.high[0]), 1e-300)
        # on the axis, any radial direction will do
        some = np.eye(3)[int(np.argmin(np.abs(self.axis)))]
        some = some - (some @ self.axis) * self.axis
        out[on] = some / np.linalg.norm(some)
        e = np.where(on[:, None], out, out / np.where(on, 1.0, r)[:, None])
        g, n2, H2 = self.profile.probe(np.column_stack([r, z]))
        n = n2[:, :1] * e + n2[:, 1:] * self.axis
        both = np.stack([e, np.broadcast_to(self.axis, e.shape)], axis=1)
        H = np.einsum("nab,nai,nbj->nij", H2, both, both)
        turn = np.cross(self.axis, e)
        hoop = np.where(on, 0.0, n2[:, 0] / np.where(on, 1.0, r))
        H += hoop[:, None, None] * turn[:, :, None] * turn[:, None, :]
        return g, n, H

    def outline(self, low: Array, high: Array) -> Array:
        """See `RigidSurface`."""
        segments = self.profile.outline(low[:2], high[:2])
        half = segments[np.all(segments[:, :, 0] >= -1e-12, axis=1)]
        triangles = np.concatenate([revolved(np.maximum(s, [0.0, -np.inf])) for s in half])
        some = np.eye(3)[int(np.argmin(np.abs(self.axis)))]
        first = some - (some @ self.axis) * self.axis
        first /= np.linalg.norm(first)
        frame = np.stack([first, np.cross(self.axis, first), self.axis])
        return np.asarray(self.point + triangles @ frame)


def revolved(profile: Array, sectors: int = 32) -> Array:
    """Triangles of a surface of revolution about the z-axis, shape (n, 3, 3).

    Args:
        profile: Radius and height of the profile's points in order (m), shape (m, 2).
        sectors: Number of sectors.
    """
    at = np.linspace(0.0, 2 * np.pi, sectors + 1)
    r, z = profile[:, 0, None], np.repeat(profile[:, 1, None], at.size, axis=1)
    x = np.stack([r * np.cos(at), r * np.sin(at), z], axis=2)
    a, b, c, d = x[:-1, :-1], x[:-1, 1:], x[1:, 1:], x[1:, :-1]
    both = np.concatenate([np.stack([a, b, c], axis=2), np.stack([a, c, d], axis=2)])
    triangles = both.reshape(-1, 3, 3)
    sides = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    # at the axis two corners coincide
    return triangles[np.linalg.norm(np.cross(*sides), axis=1) > 0]


def middle_of(surface: RigidSurface) -> Array:
    """The middle of the bounding box (m), or of a plane its point nearest to the origin."""
    if np.isfinite(surface.low).all():
        return np.asarray(0.5 * (surface.low + surface.high))
    g, n, _ = surface.probe(np.zeros((1, surface.gdim)))
    return np.asarray(-g[0] * n[0])
