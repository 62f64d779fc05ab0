"""Material points as a mesh of PyVista, with their domains as cells."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from dolfinmpm._platform.errors import MissingPackageError, call_together
from dolfinmpm.body.axisymmetry import in_section

if TYPE_CHECKING:
    from dolfinmpm.body.points import MaterialPoints

__all__ = ["domains", "load_pyvista", "of_points"]

Array = npt.NDArray[Any]
# VTK's order of corners, and its number of the cell, by dimension
_CORNERS = {
    1: np.array([(-1,), (1,)]),
    2: np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]),
    3: np.array([(x, y, z) for z in (-1, 1) for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))]),
}
_KINDS = {1: 3, 2: 9, 3: 12}


def load_pyvista() -> Any:
    """The package PyVista.

    Raises:
        MissingPackageError: PyVista is not installed.
    """
    try:
        import pyvista
    except ImportError:
        raise MissingPackageError(
            "this needs PyVista: pip install pyvista; pictures in 2D need Matplotlib alone"
        ) from None
    return pyvista


def domains(x: Array, edges: Array) -> Any:
    """A mesh with one cell per point.

    Args:
        x: Centres (m), shape (n, d).
        edges: Half-edges of the domains as columns (m), shape (n, d, d).

    Raises:
        MissingPackageError: PyVista is not installed.
    """
    pyvista = load_pyvista()
    n, d = x.shape
    signs = _CORNERS[d]
    corners = np.zeros((n, len(signs), 3))
    corners[:, :, :d] = x[:, None] + np.einsum("nij,cj->nci", edges, signs)
    size = len(signs)
    cells = np.column_stack([np.full(n, size), np.arange(n * size).reshape(n, size)])
    kinds = np.full(n, _KINDS[d], np.uint8)
    return pyvista.UnstructuredGrid(cells.ravel(), kinds, corners.reshape(-1, 3))


def of_points(points: MaterialPoints, *, deformed: bool = True) -> Any:
    """The mesh of all ranks' points with all fields, on rank 0; None elsewhere. Collective."""
    names = [name for name in points.fields if name != "cell"]
    gathered = points.gather(*names)

    def build() -> Any:
        if gathered is None:
            return None
        rows = dict(zip(names, gathered))
        edges = rows["l"][:, None] * np.eye(points.gdim)
        if deformed:
            edges = in_section(points, rows["F"]) * rows["l0"][:, None]
        mesh = domains(rows["x"], edges)
        for name, values in rows.items():
            mesh.cell_data[name] = values.reshape(len(values), -1) if values.ndim > 1 else values
        displacement = np.zeros((len(rows["x"]), 3))
        displacement[:, : points.gdim] = rows["x"] - rows["x0"]
        mesh.cell_data["displacement"] = displacement
        return mesh

    return call_together(points.comm, build)
