"""Surface meshes of rigid bodies: reading, joining of equal corners, checks."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
import numpy.typing as npt

from dolfinmpm._platform.argumentchecks import shown
from dolfinmpm._platform.errors import ParameterError
from dolfinmpm.body.meshfiles import read_mesh
from dolfinmpm.contact.facetedsurface import FacetedSurface, facet_normals

__all__ = ["checked", "is_mesh", "mesh_surface"]

Array = npt.NDArray[np.float64]
Facet = npt.NDArray[np.int64]

# Corners within this share of the mesh's size are the same corner: STL has single precision
_SAME = 1e-6


def is_mesh(shape: Any) -> bool:
    """Whether a shape is a file or a `meshio.Mesh`."""
    return isinstance(shape, (str, os.PathLike)) or type(shape).__module__.startswith("meshio")


def mesh_surface(mesh: Any) -> FacetedSurface:
    """The surface of a mesh of triangles, or in the plane of segments.

    Args:
        mesh: A file that meshio reads, or a `meshio.Mesh`.

    Raises:
        ParameterError: The mesh has no triangles, is open, or inside out; see `checked`.
        OSError: The file cannot be read.
    """
    import meshio

    name = "the mesh"
    if not isinstance(mesh, meshio.Mesh):
        name = str(mesh)
        mesh = read_mesh(mesh)
    x = np.asarray(mesh.points, float)
    triangles = [np.asarray(b.data) for b in mesh.cells if b.type == "triangle"]
    lines = [np.asarray(b.data) for b in mesh.cells if b.type == "line"]
    if triangles:
        return checked(x[:, :3], np.concatenate(triangles), name)
    if lines:
        return checked(x[:, :2], np.concatenate(lines), name)
    kinds = ", ".join(sorted({b.type for b in mesh.cells})) or "nothing"
    raise ParameterError(
        f"{name} has cells of kind {kinds}; the surface of a rigid body has triangles, or in 2D "
        "lines: give a surface mesh"
    )


def checked(x: Array, facets: npt.NDArray[np.integer], name: str) -> FacetedSurface:
    """A closed surface with outward normals, from facets that need not share their corners.

    Args:
        x: Corners (m), shape (n, gdim).
        facets: Corners of the facets, shape (m, gdim).
        name: Name of the mesh in messages.

    Raises:
        ParameterError: A corner is not finite, facets are degenerate, the surface has a hole, two
            neighbours have opposite normals, more than two facets meet at an edge, or all normals
            point inwards.
    """
    if len(facets) == 0:
        raise ParameterError(f"{name} has no facets")
    if not np.isfinite(x).all():
        bad = int(np.flatnonzero(~np.isfinite(x).all(axis=1))[0])
        raise ParameterError(f"corner {bad} of {name} at {x[bad]} m must be finite")
    x, cells = _joined(x, np.asarray(facets, np.int64))
    d = x.shape[1]
    size = float(np.ptp(x, axis=0).max())
    measure = np.linalg.norm(facet_normals(x, cells), axis=1)
    flat = np.flatnonzero(measure <= 1e-12 * size ** (d - 1))
    if flat.size:
        what = "length" if d == 2 else "area"
        raise ParameterError(
            f"{flat.size} facets of {name} have no {what}, such as facet {flat[0]} at "
            f"{shown(x[cells[flat[0], 0]])} m: remove them"
        )
    _check_edges(x, cells, name)
    middle = x[cells].mean(axis=1) - x.mean(axis=0)
    volume = float(np.sum(middle * facet_normals(x, cells)))
    if volume <= 0.0:
        raise ParameterError(
            f"{name} is inside out: the normals of its facets point into the body; reverse the "
            "order of their corners"
        )
    return FacetedSurface(x, cells)


def _joined(x: Array, facets: Facet) -> tuple[Array, Facet]:
    """Join corners at the same position."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    used, facets = np.unique(facets, return_inverse=True)
    x, facets = x[used], facets.reshape(-1, x.shape[1])
    size = float(np.ptp(x, axis=0).max())
    pairs = cKDTree(x).query_pairs(_SAME * size, output_type="ndarray")
    graph = coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(x),) * 2)
    _, group = connected_components(graph, directed=False)
    _, first = np.unique(group, return_index=True)
    return x[first], group[facets].astype(np.int64)


def _check_edges(x: Array, facets: Facet, name: str) -> None:
    """Raise unless two facets with opposite directions meet at every edge, or corner in 2D."""
    d = x.shape[1]
    if d == 2:
        ends = np.bincount(facets[:, 1], minlength=len(x))
        begins = np.bincount(facets[:, 0], minlength=len(x))
        places, forth, back = x, begins, ends
    else:
        directed = np.concatenate([facets[:, [k, (k + 1) % 3]] for k in range(3)])
        ordered = directed[:, 0] < directed[:, 1]
        edges, which = np.unique(np.sort(directed, axis=1), axis=0, return_inverse=True)
        which = which.reshape(-1)
        forth = np.bincount(which[ordered], minlength=len(edges))
        back = np.bincount(which[~ordered], minlength=len(edges))
        places = x[edges].mean(axis=1)
    count = forth + back
    part = "corner" if d == 2 else "edge"
    for bad, what in (
        (count == 1, f"is open: {{}} {part}s at the rim of a hole have one facet only"),
        (count > 2, f"meets itself: {{}} {part}s have more than two facets"),
        (
            forth != back,
            f"has neighbours whose normals disagree at {{}} {part}s",
        ),
    ):
        at = np.flatnonzero(bad)
        if at.size:
            place = np.array2string(places[at[0]], precision=6)
            raise ParameterError(
                f"{name} {what.format(at.size)}, such as the {part} at {place} m: repair the mesh, "
                "so that it is closed and all normals point outwards"
            )
