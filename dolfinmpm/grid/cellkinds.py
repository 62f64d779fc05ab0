"""Kinds of cells that a background grid may have."""

from __future__ import annotations

from dolfinx.mesh import CellType, Mesh

from dolfinmpm._platform.errors import UnsupportedGridError

__all__ = ["check_cells"]

_KINDS = (
    CellType.interval, CellType.triangle, CellType.quadrilateral, CellType.tetrahedron,
    CellType.hexahedron,
)  # fmt: skip


def check_cells(grid: Mesh) -> None:
    """Raise UnsupportedGridError unless all cells are of one kind that points can lie in."""
    kinds = list(grid.topology.entity_types[grid.topology.dim])
    if len(kinds) > 1 or kinds[0] not in _KINDS:
        raise UnsupportedGridError(
            f"the background grid has cells of kind {' and '.join(kind.name for kind in kinds)}; "
            "its cells must be of one of these kinds: intervals, triangles, quadrilaterals, "
            "tetrahedra or hexahedra. Mesh the domain with one of them, such as "
            "mesh.CellType.tetrahedron"
        )
