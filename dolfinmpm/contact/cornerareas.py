"""Areas of the corners of domains that touch a rigid surface.

A penalty finds the penetration that balances the stress of the body, whatever the areas of the
corners are. A limit of the shear stress acts on the areas themselves: they must fill the surface.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

__all__ = ["face_areas", "places_on_faces", "slip_areas"]

Array = npt.NDArray[np.float64]

# Part of a half-length by which a corner that only meets the surface is taken to be inside
_MEETS = 1e-9


def face_areas(half: Array, normal: Array) -> Array:
    """Areas by which corners share the faces of their domains (m^(d-1)), shape (m,).

    The faces A_i of a domain have the area A·n = Σ |n_i| A_i towards the normal n. The corners on
    this side share it. This is exact for sides of a body along the grid's axes.

    Args:
        half: Half-lengths (m), shape (m, d).
        normal: Normal of the rigid surface in the frame of the domain, shape (m, d).
    """
    d = half.shape[1]
    faces = np.stack([np.prod(np.delete(half, i, axis=1), axis=1) for i in range(d)], axis=1)
    return np.asarray(np.sum(np.abs(normal) * faces, axis=1))


def slip_areas(half: Array, normal: Array, signs: Array, ahead: Array, gap: Array) -> Array:
    """Areas by which corners share the rigid surface (m^(d-1)), shape (m,).

    Beside an oblique surface points are stairs: one point of each column touches it, along the axis
    on which domains reach furthest towards it. The face A_i of this point covers the part A_i/|n_i|
    of the surface. The corners of this face that touch share it: a corner takes less by as much as
    it is behind another one, and nothing if it is behind by more than the other one is inside.

    Args:
        half, normal: See `face_areas`.
        signs: Place of each corner in its domain, ±1, shape (m, d).
        ahead: Differences of the gaps of neighbouring corners in each direction (m), shape (m, d).
        gap: Gaps of the corners (m), shape (m,).
    """
    each, size = np.arange(len(half)), np.abs(normal)
    main = np.argmax(size * half, axis=1)
    area = np.prod(2.0 * half, axis=1) / (2.0 * half * size)[each, main]
    leads = signs * normal < 0.0
    behind = np.where(leads, 0.0, ahead)
    behind[each, main] = 0.0
    inside = np.maximum(np.sum(behind, axis=1) - gap, _MEETS * half.max(axis=1, initial=0.0))
    part = np.minimum(ahead / inside[:, None], 1.0)
    share = 0.5 + np.where(leads, 0.5, -0.5) * part
    share[each, main] = 1.0
    return np.asarray(area * np.prod(share, axis=1))


def places_on_faces(normal: Array) -> Array:
    """Places of the parts of faces that corners stand for, shape (m, d).

    They lie between the point's centre (0) and the edge of its domain (1), smoothly in the normal.

    Args:
        normal: Normal of the rigid surface in the frame of the domain, of any length, shape (m, d).
    """
    size = np.abs(normal)
    largest = size.max(axis=1, initial=np.finfo(float).tiny, keepdims=True)
    return np.asarray(0.5 + 0.5 * (size / largest) ** 2)
