"""Surfaces of revolution: cones and what else a profile sweeps out around an axis."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from dolfinmpm.contact.surfaces import Probe, RigidSurface, revolved

__all__ = ["Revolved"]

Array = npt.NDArray[np.float64]


class Revolved:
    """What a profile sweeps out around an axis in 3D.

    Args:
        profile: A surface in the plane of radius and height (m), mirrored at the axis.
        point: Where height is zero on the axis (m), shape (3,).
        axis: Unit vector of the axis, towards greater heights.
    """

    gdim = 3

    def __init__(self, profile: RigidSurface, point: Array, axis: Array):
        self.profile, self.point, self.axis = profile, point, axis
        radius = float(profile.high[0])
        ends = [point + z * axis for z in (profile.low[1], profile.high[1])]
        # of a disc across the axis
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
        # on the axis any direction is as good as another
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
