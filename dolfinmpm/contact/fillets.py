"""Fillets: round convex edges of closed surface meshes.

The rounded body contains all positions within the radius r of a core. The faces of the core lie r
behind the faces of the body. So each corner of the mesh moves by δ, with n·δ = −r for the normals n
of its facets. Concave edges stay sharp.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from dolfinmpm._platform.argumentchecks import shown
from dolfinmpm._platform.errors import ParameterError
from dolfinmpm.contact.facetedsurface import FacetedSurface, facet_normals
from dolfinmpm.contact.surfaces import Rounded

__all__ = ["filleted"]

Array = npt.NDArray[np.float64]

# Largest distance between the moved planes of a corner, as a share of the radius
_MISS = 0.05


def filleted(mesh: FacetedSurface, radius: float) -> Rounded:
    """A mesh with rounded convex edges, inside the shape of the mesh.

    Args:
        mesh: The closed surface.
        radius: Radius (m).

    Raises:
        ParameterError: The radius is too large for an edge or a wall of the body. Or the moved
            planes of more than three faces at a corner have no common point.
    """
    normals = facet_normals(mesh.x, mesh.facets)
    size = np.linalg.norm(normals, axis=1)
    unit = normals / size[:, None]
    corner = mesh.facets.ravel()
    of = np.repeat(np.arange(len(mesh.facets)), mesh.gdim)
    order = np.argsort(corner, kind="stable")
    places, first = np.unique(corner[order], return_index=True)
    core = mesh.x.copy()
    for place, rows in zip(places, np.split(of[order], first[1:])):
        n = unit[rows]
        # planes with almost equal normals count as one plane: small angles are rounding
        shift = np.linalg.lstsq(n, np.full(len(n), -radius), rcond=1e-6)[0]
        miss = float(np.abs(n @ shift + radius).max())
        if miss > _MISS * radius:
            raise ParameterError(
                f"fillet = {radius:g} m: {len(n)} facets meet at the corner at "
                f"{shown(mesh.x[place])} m, and moved inwards their planes miss each other by "
                f"{miss:.3g} m; round this corner in the mesh, and give fillet=0"
            )
        core[place] += shift
    moved = facet_normals(core, mesh.facets)
    turned = np.sum(moved * unit, axis=1) <= 1e-6 * size
    # a facet that turned twice has an outward normal again, but reversed edges
    for k in range(mesh.gdim):
        before, now = (x[mesh.facets[:, k]] - x[mesh.facets[:, k - 1]] for x in (mesh.x, core))
        turned |= np.sum(before * now, axis=1) <= 0.0
    if turned.any():
        worst = int(np.flatnonzero(turned)[0])
        raise ParameterError(
            f"fillet = {radius:g} m is too large: it removes whole facets, such as facet "
            f"{worst} at {shown(mesh.x[mesh.facets[worst, 0]])} m; give less than half of the "
            "body's thickness there"
        )
    return Rounded(FacetedSurface(core, mesh.facets), radius)
