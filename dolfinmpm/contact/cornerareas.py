"""Areas of the corners of domains that touch a rigid surface.

A penalty finds the penetration that balances the stress of the body, whatever the areas of the
corners are. A limit of the shear stress acts on the areas themselves: they must fill the surface.
Corners that begin to touch have the parts of the surface below; those that touched in the last step
share the surface between them, see `dolfinmpm.contact.sharedsurface`.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

__all__ = ["edges_of_faces", "face_areas", "part_areas", "places_on_faces", "slip_parts"]

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


def edges_of_faces(area: Array, half: Array) -> Array:
    """Half edges of faces that have an area vector (m), shape (n, d - 1, d).

    In 2D they follow from the area. In 3D a face is taken for a rectangle, as long and wide as the
    domain of its point is in these directions.

    Args:
        area: Area vectors (m^(d-1)), shape (n, d).
        half: Half-lengths of the points' domains (m), shape (n, d).
    """
    if area.shape[1] == 2:
        return np.asarray(0.5 * np.stack([-area[:, 1], area[:, 0]], axis=1)[:, None])
    size = np.linalg.norm(area, axis=1)
    normal = np.divide(area, size[:, None], out=np.zeros_like(area), where=size[:, None] > 0.0)
    # the axis that is most along the face gives the direction of an edge
    first = np.eye(3)[np.argmin(np.abs(normal), axis=1)]
    first -= np.sum(first * normal, axis=1)[:, None] * normal
    first /= np.linalg.norm(first, axis=1)[:, None]
    edges = np.stack([first, np.cross(normal, first)], axis=1)
    widths = np.einsum("nki,ni->nk", np.abs(edges), half)
    whole = 4.0 * np.prod(widths, axis=1)
    scale = np.sqrt(np.divide(size, whole, out=np.zeros_like(size), where=whole > 0.0))
    return np.asarray(edges * (scale[:, None] * widths)[:, :, None])


def slip_parts(
    edges: Array, normal: Array, signs: Array, at: Array, gap: Array
) -> tuple[Array, Array]:
    """Parts of the rigid surface that corners cover.

    Beside an oblique surface points are stairs: one point of each column touches it, along the axis
    on which domains reach furthest towards it. The face A_i of this point covers the part A_i/|n_i|
    of the surface. The corners of this face that touch share it: a corner takes less by as much as
    it is behind another one, and nothing if it is behind by more than the other one is inside.

    Args:
        edges: Half edges of the domains, as columns (m), shape (m, d, d).
        normal: Normal of the rigid surface, shape (m, d).
        signs: Place of each corner in its domain, ±1, shape (m, d).
        at: Distances of the contact points from the middle of their domain, by half edges, shape
            (m, d): 1 at a corner.
        gap: Gaps of the contact points (m), shape (m,).

    Returns:
        Middles of the parts from the contact points (m), shape (m, d); half edges of the parts,
        as rows (m), shape (m, d-1, d).
    """
    each, d = np.arange(len(edges)), edges.shape[2]
    towards = np.einsum("mi,mij->mj", normal, edges)
    main = np.argmax(np.abs(towards), axis=1)
    leads = signs * towards < 0.0
    ahead = 2.0 * np.abs(towards) * at
    behind = np.where(leads, 0.0, ahead)
    behind[each, main] = 0.0
    least = _MEETS * np.linalg.norm(edges, axis=1).max(axis=1, initial=0.0)
    inside = np.maximum(np.sum(behind, axis=1) - gap, least)
    share = 0.5 + np.where(leads, 0.5, -0.5) * np.minimum(ahead / inside[:, None], 1.0)
    # edges along the surface: they meet it on lines in the direction of the main edge
    along = (
        edges - (towards / towards[each, main][:, None])[:, None] * edges[each, :, main][:, :, None]
    )
    along = np.swapaxes(along, 1, 2)
    middle = np.einsum("mj,mji->mi", signs * (1.0 - share - at), along)
    others = np.array([np.delete(np.arange(d), k) for k in range(d)])[main]
    parts = share[:, :, None] * along
    return middle, np.take_along_axis(parts, others[:, :, None], axis=1)


def part_areas(parts: Array) -> Array:
    """Areas of parts of a surface with these half edges (m^(d-1)), shape (m,); see `slip_parts`."""
    square = np.einsum("mai,mbi->mab", parts, parts)
    return np.asarray(2.0 ** parts.shape[1] * np.sqrt(np.maximum(np.linalg.det(square), 0.0)))


def places_on_faces(normal: Array) -> Array:
    """Places of the parts of faces that corners stand for, shape (m, d).

    They lie between the point's centre (0) and the edge of its domain (1), smoothly in the normal.

    Args:
        normal: Normal of the rigid surface in the frame of the domain, of any length, shape (m, d).
    """
    size = np.abs(normal)
    largest = size.max(axis=1, initial=np.finfo(float).tiny, keepdims=True)
    return np.asarray(0.5 + 0.5 * (size / largest) ** 2)
