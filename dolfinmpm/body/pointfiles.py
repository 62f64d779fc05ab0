"""Points read from files: tables of text, and meshes of the body."""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Mapping
from typing import Any

import basix
import numpy as np
import numpy.typing as npt
from dolfinx.mesh import Mesh

from dolfinmpm._platform.argumentchecks import choice, shown, truth, whole
from dolfinmpm._platform.errors import ParameterError, UnsupportedGridError, call_together
from dolfinmpm._platform.filepaths import text_of
from dolfinmpm.body.axisymmetry import ring
from dolfinmpm.body.meshfiles import read_mesh
from dolfinmpm.body.pointchecks import require_grid

__all__ = ["from_csv", "from_mesh"]

Array = npt.NDArray[np.float64]


def from_csv(grid: Mesh, path, density, tag: int, delimiter: str) -> dict[str, Any]:
    """Arguments of `MaterialPoints.from_arrays`; see `MaterialPoints.from_csv`. Collective."""
    require_grid(grid)
    if not isinstance(delimiter, str) or len(delimiter) != 1:
        raise ParameterError(f"delimiter = {shown(delimiter)} must be one character, such as ','")
    axes = "xyz"[: grid.geometry.dim]

    def read() -> dict[str, Any]:
        if grid.comm.rank != 0:
            return _nothing(len(axes))
        names, values, lines = _table(path, delimiter)
        return _arguments(path, axes, dict(zip(names, values.T)), lines, density, tag)

    return call_together(grid.comm, read)


def _nothing(gdim: int) -> dict[str, Any]:
    none = np.empty(0)
    return {"x": np.empty((0, gdim)), "volume": none, "density": none, "id": none.astype(np.int64)}


def _advice(names: list[str], cell: str = "") -> str:
    """What to do about a table with another delimiter, or with decimal commas, for messages."""
    for mark in (";", "\t"):
        if any(mark in name for name in names):
            return f"; give delimiter={mark!r}"
    return "; write decimals with a point" if "," in cell else ""


def _table(path: Any, delimiter: str) -> tuple[list[str], Array, list[int]]:
    """Names and values of a table, shape (lines, columns), and where in the file the lines are."""
    reader = csv.reader(text_of("path", path).splitlines(), delimiter=delimiter)
    names = [name.strip() for name in next(reader, [])]
    rows, lines = [], []
    for row in reader:
        if row and any(cell.strip() for cell in row):
            rows.append(row)
            lines.append(reader.line_num)
    double = [name for name, count in Counter(names).items() if count > 1]
    if double or not all(names):
        raise ParameterError(
            f"{path}, line 1: column {double[0]!r} is named twice" if double else
            f"{path}, line 1: a column has no name; the first line should name all of them"
        )  # fmt: skip
    for line, row in zip(lines, rows):
        if len(row) != len(names):
            raise ParameterError(
                f"{path}, line {line}: {len(row)} columns, but the first line names {len(names)}: "
                f"{', '.join(names)}{_advice(names)}"
            )
    try:
        return names, np.array(rows, float).reshape(len(rows), len(names)), lines
    except ValueError:
        for line, row in zip(lines, rows):
            for name, cell in zip(names, row):
                try:
                    float(cell)
                except ValueError:
                    raise ParameterError(
                        f"{path}, line {line}, column '{name}': {cell!r} is not a number"
                        f"{_advice(names, cell)}"
                    ) from None
        raise


def _arguments(
    path, axes: str, columns: dict[str, Array], lines: list[int], density, tag: int
) -> dict[str, Any]:
    """Columns of a table as arguments of `MaterialPoints.from_arrays`."""
    for name in (*axes, "volume", *(() if density is not None else ("density",))):
        if name not in columns:
            hint = "; or give density=" if name == "density" else ""
            raise ParameterError(
                f"{path}, line 1: there is no column '{name}', only {', '.join(columns)}{hint}"
            )
    for name in "xyz"[len(axes) :]:
        if name in columns:
            raise ParameterError(
                f"{path}, line 1: there is a column '{name}', but the grid has {len(axes)} "
                "dimensions; take the column out of the file"
            )
    if density is not None and "density" in columns:
        raise ParameterError(f"{path} has a column 'density': leave the argument out")
    if tag and "tag" in columns:
        raise ParameterError(f"{path} has a column 'tag': leave the argument out")

    def whole(name: str) -> npt.NDArray[np.int64]:
        values = columns.pop(name)
        bad = np.flatnonzero(~(values == np.round(values)))
        if bad.size:
            raise ParameterError(
                f"{path}, line {lines[bad[0]]}, column '{name}': {values[bad[0]]} is not a whole "
                "number"
            )
        return values.astype(np.int64)

    return {
        "x": np.column_stack([columns.pop(name) for name in axes]),
        "volume": columns.pop("volume"),
        "density": columns.pop("density") if density is None else density,
        "tag": whole("tag") if "tag" in columns else tag,
        "id": whole("id") if "id" in columns else np.arange(len(lines)),
        "fields": columns,
    }


# What meshio calls the cells, and the order in which Basix has their corners.
_CELLS = {
    "line": (basix.CellType.interval, [0, 1]),
    "triangle": (basix.CellType.triangle, [0, 1, 2]),
    "quad": (basix.CellType.quadrilateral, [0, 1, 3, 2]),
    "tetra": (basix.CellType.tetrahedron, [0, 1, 2, 3]),
    "hexahedron": (basix.CellType.hexahedron, [0, 1, 3, 2, 4, 5, 7, 6]),
}
# Volumes of cells below this share of the cube of their size are rounding
_FLAT = 1e-12
_DIMENSION = {"vertex": 0, "line": 1, "triangle": 2, "quad": 2}


def from_mesh(
    grid: Mesh, mesh, density, points: str, degree: int, tag, axisymmetric: bool
) -> dict[str, Any]:
    """Arguments of `MaterialPoints.from_arrays`; see `MaterialPoints.from_mesh`. Collective."""
    require_grid(grid)
    gdim = grid.geometry.dim
    points = choice("points", points, ("quadrature", "centres"))
    whole("degree", degree, 1)
    truth("axisymmetric", axisymmetric)

    def read() -> dict[str, Any]:
        if grid.comm.rank != 0:
            return _nothing(gdim)
        x, volume, tags = _points_of(mesh, gdim, points, degree)
        tags = tags if tag is None else np.full(len(x), tag)
        rho = density
        if isinstance(density, Mapping):
            missing = np.setdiff1d(tags, list(density))
            if missing.size:
                raise ParameterError(
                    f"density has no value for the tag {missing[0]} of the mesh, only for "
                    f"{', '.join(map(str, density))}"
                )
            rho = np.array([density[t] for t in tags.tolist()])
        volume = ring(x[:, 0], volume) if axisymmetric else volume
        return {"x": x, "volume": volume, "density": rho, "tag": tags, "id": np.arange(len(x))}

    return call_together(grid.comm, read)


def _points_of(mesh, gdim: int, points: str, degree: int) -> tuple[Array, Array, Any]:
    """Positions, volumes and tags of points in the cells of a mesh."""
    import meshio

    if not isinstance(mesh, meshio.Mesh):
        mesh = read_mesh(mesh)
    nodes = np.asarray(mesh.points, float)
    if np.any(np.ptp(nodes[:, gdim:], axis=0) > 1e-12 * np.ptp(nodes)):
        raise UnsupportedGridError(
            f"the nodes of the mesh do not lie in the first {gdim} coordinates of the grid, but "
            f"reach over {np.ptp(nodes[:, gdim:], axis=0)} m across"
        )
    groups = mesh.cell_data.get("gmsh:physical", [np.zeros(len(b.data), int) for b in mesh.cells])
    pieces = []
    for block, group in zip(mesh.cells, groups):
        kind = block.type.rstrip("0123456789")
        if _DIMENSION.get(kind, 3) != gdim or not len(block.data):
            continue
        if block.type not in _CELLS:
            raise UnsupportedGridError(
                f"the mesh has cells of the kind {block.type}; cells must be "
                f"{', '.join(_CELLS)} with straight edges: mesh the body with cells of first order"
            )
        cell, order = _CELLS[block.type]
        x, volume = _quadrature(nodes[:, :gdim][block.data[:, order]], cell, points, degree)
        pieces.append((x.reshape(-1, gdim), volume.ravel(), np.repeat(group, volume.shape[1])))
    if not pieces:
        kinds = ", ".join(sorted({block.type for block in mesh.cells})) or "none"
        raise UnsupportedGridError(
            f"the mesh has no cells of the grid's {gdim} dimensions, only {kinds}; save the "
            "elements of the body itself"
        )
    x, volume, tags = (np.concatenate(parts) for parts in zip(*pieces))
    return x, volume, tags.astype(np.int64)


def _quadrature(corners: Array, cell, points: str, degree: int) -> tuple[Array, Array]:
    """Positions and volumes of points, shapes (cells, q, gdim) and (cells, q)."""
    element = basix.create_element(basix.ElementFamily.P, cell, 1)

    def at(degree: int) -> tuple[Array, Array]:
        xi, weights = (np.asarray(a) for a in basix.make_quadrature(cell, degree))
        if weights.min() <= 0:
            raise ParameterError(
                f"degree = {degree}: the quadrature has a negative weight, and a point cannot have "
                "a negative volume; take the degree below or above"
            )
        table = np.asarray(element.tabulate(1, xi))[..., 0]
        J = np.einsum("jqa,cai->cqij", table[1:], corners)
        det = np.linalg.det(J)
        turned = np.sign(det) != np.sign(det[:, :1])
        size = np.ptp(corners, axis=1).max(axis=1)[:, None]
        flat = np.abs(det) <= _FLAT * size ** corners.shape[2]
        bad = np.flatnonzero(np.any(turned | flat, axis=1))
        if bad.size:
            raise ParameterError(
                f"the cell of the mesh with the corners {corners[bad[0]].tolist()} m has no volume "
                "or is folded; mend the mesh"
            )
        return np.einsum("qa,cai->cqi", table[0], corners), np.abs(det) * weights

    # exact for the volume and the first moments of a hexahedron
    x, volume = at(3 if cell in (basix.CellType.quadrilateral, basix.CellType.hexahedron) else 1)
    whole = volume.sum(axis=1, keepdims=True)
    if points == "centres":
        return np.einsum("cq,cqi->ci", volume / whole, x)[:, None], whole
    x, volume = at(degree)
    # a rule of few points does not integrate the volume of a distorted cell
    return x, volume * whole / volume.sum(axis=1, keepdims=True)
