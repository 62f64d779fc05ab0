"""Surfaces of rigid bodies from shapes and from meshes, with fillets.

Fillets round convex edges. The rounded body contains all positions within the radius r of a core.
The faces of the core lie r behind the faces of the body. So each corner of a mesh moves by δ, with
n·δ = −r for the normals n of its facets. Concave edges stay sharp.
"""

from __future__ import annotations

import os
from typing import Any

import numpy as np
import numpy.typing as npt

from dolfinmpm._platform.argumentchecks import floats, refuse_idle, shown
from dolfinmpm._platform.errors import ParameterError
from dolfinmpm.body.meshfiles import read_mesh
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.body.shapes import Ball, Box, Polygon, TurnedBox
from dolfinmpm.contact.facetedsurface import FacetedSurface, facet_normals
from dolfinmpm.contact.meshparts import check_parts, volume_of
from dolfinmpm.contact.rigidshapes import Cone, Plane
from dolfinmpm.contact.surfaces import HalfSpace, Revolved, RigidSurface, Round, Rounded

__all__ = ["mesh_surface", "refuse_half", "surface_of"]

Array = npt.NDArray[np.float64]
Facet = npt.NDArray[np.int64]

# Corners within this share of the mesh's size are the same corner: STL has single precision
_SAME = 1e-6


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
        if x.shape[1] < 3 or not np.ptp(x[np.concatenate(triangles)].reshape(-1, x.shape[1])[:, 2]):
            raise ParameterError(
                f"{name} has triangles in a plane, and a rigid body has a closed surface: in 2D "
                "give its outline, mpm.RigidBody(mpm.Polygon(corners), ...), or a mesh of lines "
                "with the body to the left of each"
            )
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
            neighbours have opposite normals, more than two facets meet at an edge, or the normals
            of all facets or of one part point inwards; see `check_parts`.
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
            f"{x[cells[flat[0], 0]]} m: remove them"
        )
    _check_edges(x, cells, name)
    volume = volume_of(x, cells)
    if volume <= 0.0:
        raise ParameterError(
            f"{name} is inside out: the normals of its facets point into the body; reverse the "
            "order of their corners"
        )
    check_parts(x, cells, name)
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


# Sides of a box: its corners in binary order, anticlockwise as seen from outside
_SIDES = np.array(
    [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
)
_TRIANGLES = np.concatenate([_SIDES[:, [0, 1, 2]], _SIDES[:, [0, 2, 3]]])


def surface_of(shape: Any, fillet: float) -> RigidSurface:
    """The surface of a shape; see `RigidBody`.

    Args:
        shape: The shape.
        fillet: Radius by which convex edges are rounded (m).

    Raises:
        ParameterError: A rigid body cannot have this shape, a mesh has a fault, or the fillet is
            too large.
        OSError: A file cannot be read.
    """
    if isinstance(shape, (Plane, Ball)):
        refuse_idle("fillet", fillet, 0.0, "this shape has no edges")
    if isinstance(shape, Plane):
        return HalfSpace(shape.point, shape.normal)
    if isinstance(shape, Ball):
        centre, low = shape.centroid, shape.low
        assert centre is not None
        assert low is not None
        return Round(centre, float(centre[0] - low[0]))
    if isinstance(shape, Polygon):
        return _polygon(shape.vertices, fillet)
    if isinstance(shape, (Box, TurnedBox)):
        return _box(shape, fillet)
    if isinstance(shape, Cone):
        return Revolved(_polygon(shape.profile, fillet), shape.tip, shape.axis)
    if isinstance(shape, str) and not os.path.splitext(shape)[1]:
        raise ParameterError(
            f"shape = {shown(shape)} is no shape, and no file of a mesh, whose name has an ending: "
            "give a shape such as mpm.Disc((0, 1), 0.5)"
        )
    if isinstance(shape, (str, os.PathLike)) or type(shape).__module__.startswith("meshio"):
        surface = mesh_surface(shape)
        return filleted(surface, fillet) if fillet else surface
    corners = floats(shape)
    if corners is not None and corners.ndim == 2 and corners.shape[1] == 2:
        raise ParameterError(
            f"shape has {len(corners)} positions, and a rigid body needs a shape: give the corners "
            "of its outline in order, mpm.RigidBody(mpm.Polygon(corners), ...)"
        )
    if isinstance(shape, MaterialPoints):
        raise ParameterError(
            "shape = MaterialPoints is a body that deforms: give the shape itself, such as the Box "
            "or Polygon that mpm.fill took"
        )
    raise ParameterError(
        f"shape = {shown(shape)} is none of a rigid body: give Plane, Disc, Ball, Box, TurnedBox, "
        "Polygon, Wedge, Cone, or a closed surface mesh of triangles"
    )


def refuse_half(surface: RigidSurface, name: str) -> None:
    """Raise where a body of revolution has a face on the axis, which would push points across it.

    Args:
        surface: Surface of the body.
        name: Name of the body, for messages.

    Raises:
        ParameterError: The surface begins at x[0] = 0.
    """
    low, high = float(surface.low[0]), float(surface.high[0])
    if high > 0.0 and abs(low) < _SAME * high:
        raise ParameterError(
            f"'{name}' lies between x[0] = 0 and {high:g} m, so it has a face on the axis: in "
            "axisymmetric problems give the whole section, with its mirror image at x[0] < 0"
        )


def _closed(corners: Array) -> FacetedSurface:
    """The surface of a polygon whose corners go anticlockwise."""
    at = np.arange(len(corners))
    return FacetedSurface(corners, np.column_stack([at, np.roll(at, -1)]))


def _polygon(vertices: Array, fillet: float) -> RigidSurface:
    x = np.asarray(vertices, float)
    y = np.roll(x, -1, axis=0)
    if np.sum(x[:, 0] * y[:, 1] - x[:, 1] * y[:, 0]) < 0:
        x = x[::-1]
    if fillet == 0.0:
        return _closed(x)
    before, after = x - np.roll(x, 1, axis=0), np.roll(x, -1, axis=0) - x
    before /= np.linalg.norm(before, axis=1)[:, None]
    after /= np.linalg.norm(after, axis=1)[:, None]
    # edges that move inwards meet on the bisectors
    inward = [np.column_stack([-e[:, 1], e[:, 0]]) for e in (before, after)]
    half = 1.0 + np.sum(inward[0] * inward[1], axis=1)
    core = x + fillet * (inward[0] + inward[1]) / half[:, None]
    kept = np.sum((np.roll(core, -1, axis=0) - core) * after, axis=1)
    if not np.all(half > 1e-9) or not np.all(kept > 0.0):
        shortest = np.linalg.norm(np.roll(x, -1, axis=0) - x, axis=1).min()
        raise ParameterError(
            f"fillet = {fillet:g} m is too large: it removes a whole edge of the shape, whose "
            f"shortest edge has {shortest:.4g} m; give a smaller fillet"
        )
    return Rounded(_closed(core), fillet)


def _box(shape: Box | TurnedBox, fillet: float) -> RigidSurface:
    box = shape.box if isinstance(shape, TurnedBox) else shape
    low, high = box.low, box.high
    if not 2 <= low.size <= 3:
        raise ParameterError("a rigid box has two or three coordinates")
    if not np.all(high - low > 2 * fillet):
        raise ParameterError(
            f"fillet = {fillet:g} m must be less than half of the box's sides, {high - low} m"
        )
    low, high = low + fillet, high - fillet
    if low.size == 2:
        x = np.array([low, (high[0], low[1]), high, (low[0], high[1])])
    else:
        bits = np.array([[k >> 2 & 1, k >> 1 & 1, k & 1] for k in range(8)])
        x = np.where(bits, high, low)
    if isinstance(shape, TurnedBox):
        x = shape.turn(x)
    core = _closed(x) if low.size == 2 else FacetedSurface(x, _TRIANGLES)
    return Rounded(core, fillet) if fillet else core
