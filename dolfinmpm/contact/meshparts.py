"""Parts of a surface mesh that do not hang together: bodies beside each other, and cavities."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from dolfinmpm._platform.errors import ParameterError
from dolfinmpm.contact.facetedsurface import FacetedSurface, facet_normals

__all__ = ["check_parts", "volume_of"]

Array = npt.NDArray[np.float64]
Facets = npt.NDArray[np.int64]

# Corners nearer to another part than this share of the mesh's size lie on it
_ON = 1e-6


def check_parts(x: Array, facets: Facets, name: str) -> None:
    """Raise unless the normals of each part of a closed surface point out of the body.

    The nearest facet tells on which side a position is. So parts must not cross, a part has outward
    normals where it is outside of all others, and a cavity has normals into itself.

    Args:
        x: Corners (m), shape (n, gdim).
        facets: Corners of the facets, shape (m, gdim).
        name: Name of the mesh in messages.

    Raises:
        ParameterError: Parts cross, or a part is inside out, or lies within another one.
    """
    parts = _parts(x, facets)
    if len(parts) == 1:
        return
    size = _ON * float(np.ptp(x, axis=0).max())
    outward = [volume_of(x, part) > 0.0 for part in parts]
    surfaces = [
        FacetedSurface(x, part if out else part[:, ::-1]) for part, out in zip(parts, outward)
    ]
    for k, (part, own) in enumerate(zip(parts, surfaces)):
        corners = x[np.unique(part)]
        depth = 0
        at = np.array2string(corners[0], precision=6)
        where = f"the part at {at} m, of {len(part)} facets"
        for j, other in enumerate(surfaces):
            if j == k or np.any(own.low > other.high) or np.any(own.high < other.low):
                continue
            gap = other.probe(corners)[0]
            inside, outside = np.any(gap < -size), np.any(gap > size)
            if inside and outside:
                raise ParameterError(
                    f"{name} crosses itself: {where}, crosses another part; join both to one "
                    "surface, or make two bodies"
                )
            depth += int(inside) * (1 if outward[j] else -1)
        if outward[k] and depth:
            raise ParameterError(
                f"{name} has a part within another: {where}, is inside the body, and its normals "
                "point out of it; leave it out, or reverse its corners if it is a cavity"
            )
        if not outward[k] and depth != 1:
            raise ParameterError(
                f"{name} is inside out in one part: the normals of {where}, point into it, and it "
                "is no cavity of another; reverse the order of its corners"
            )


def _parts(x: Array, facets: Facets) -> list[Facets]:
    """Facets that hang together by their corners."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    first = np.repeat(facets[:, 0], x.shape[1])
    graph = coo_matrix((np.ones(first.size), (first, facets.ravel())), shape=(len(x),) * 2)
    _, label = connected_components(graph, directed=False)
    of = label[facets[:, 0]]
    return [facets[of == part] for part in np.unique(of)]


def volume_of(x: Array, facets: Facets) -> float:
    """A positive multiple of the volume (m^gdim); negative with normals that point inwards."""
    middle = x[facets].mean(axis=1) - x[facets].mean(axis=(0, 1))
    return float(np.sum(middle * facet_normals(x, facets)))
