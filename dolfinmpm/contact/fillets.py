"""Sharp edges of closed surface meshes made round.

All that is within a radius r of a core is the body with its convex edges rounded by r, if the
core's faces lie r behind the body's. A corner of the mesh is moved to where the planes of its
facets are then: n·δ = −r for each of their normals n. Edges that are concave stay as they are.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from dolfinmpm._platform.argumentchecks import shown
from dolfinmpm._platform.errors import ParameterError
from dolfinmpm.contact.facets import Facets, facet_normals
from dolfinmpm.contact.surfaces import Rounded

__all__ = ["filleted"]

Array = npt.NDArray[np.float64]

# Share of the radius by which a corner's planes may miss each other when they are moved
_MISS = 0.05


def filleted(mesh: Facets, radius: float) -> Rounded:
    """A mesh with its convex edges rounded; it stays within its shape.

    Args:
        mesh: The closed surface.
        radius: Radius (m).

    Raises:
        ParameterError: The radius is too large for an edge or a wall of the body, or the planes of
            more than three faces that meet at a corner do not do so when they are moved.
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
        # planes of one direction are one plane, for small angles between them to be rounding
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
    # a facet that is turned twice looks outwards again, but its edges run the other way
    for k in range(mesh.gdim):
        before, now = (x[mesh.facets[:, k]] - x[mesh.facets[:, k - 1]] for x in (mesh.x, core))
        turned |= np.sum(before * now, axis=1) <= 0.0
    if turned.any():
        worst = int(np.flatnonzero(turned)[0])
        raise ParameterError(
            f"fillet = {radius:g} m is too large: it takes away whole facets, such as facet "
            f"{worst} at {shown(mesh.x[mesh.facets[worst, 0]])} m; give less than half of the "
            "body's thickness there"
        )
    return Rounded(Facets(core, mesh.facets), radius)
