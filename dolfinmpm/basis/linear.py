"""Linear basis on any DOLFINx mesh with straight-sided cells."""

from __future__ import annotations

import copy

import numba
import numpy as np
from dolfinx.mesh import CellType, Mesh

from dolfinmpm._platform.compat import geometry_dofmap, make_index_map
from dolfinmpm.basis.cells import BOX, SIMPLEX, pull_back
from dolfinmpm.basis.stencils import Placement, Stencils, group_starts, running_sum
from dolfinmpm.grid.halo import Numbering
from dolfinmpm.grid.partition import Partition

__all__ = ["LinearBasis", "kind_of"]


def kind_of(grid: Mesh) -> int:
    """Kind of the grid's cells for the kernels of `cells`: SIMPLEX or BOX."""
    simplices = (CellType.triangle, CellType.tetrahedron)
    return SIMPLEX if grid.topology.cell_type in simplices else BOX


@numba.njit(cache=True, error_model="numpy")
def _fill(kind, vertices, coordinates, dofs, x, cells, order, groups, nodes, N, dN):
    m, d = vertices.shape[1], x.shape[1]
    X, N_ref, dN_ref = np.empty((m, d)), np.empty(m), np.empty((m, d))
    J, K, xi = np.empty((d, d)), np.empty((d, d)), np.empty(d)
    rank = np.empty(m, np.int64)
    for g in range(groups.size - 1):
        cell = cells[order[groups[g]]]
        for a in range(m):
            rank[a] = 0
            for b in range(m):
                if dofs[cell, b] < dofs[cell, a]:
                    rank[a] += 1
            nodes[g * m + rank[a]] = dofs[cell, a]
            for i in range(d):
                X[a, i] = coordinates[vertices[cell, a], i]
        for position in range(groups[g], groups[g + 1]):
            pull_back(kind, X, x[order[position]], xi, N_ref, dN_ref, J, K)
            for a in range(m):
                at = position * m + rank[a]
                N[at] = N_ref[a]
                for i in range(d):
                    dN[at, i] = 0.0
                    for j in range(d):
                        dN[at, i] += dN_ref[a, j] * K[j, i]


class LinearBasis:
    """Linear functions: a point sees the nodes of its own cell.

    Args:
        grid: Background grid of intervals, triangles, quadrilaterals, tetrahedra
            or hexahedra.
        node_map: Index map of the grid's linear Lagrange space.
        dofs: Nodes of each cell, shape (cells, nodes per cell).
        node_x: Positions of the nodes (m), shape (nodes, 3).
    """

    degree = 1
    continuity = 0
    averaged = False
    coarsen = 1
    partition = None
    grid_nodes = None
    grid_cells = None

    def __init__(self, grid: Mesh, node_map, dofs, node_x):
        self.grid = grid
        self.nodes = Numbering(grid.comm, node_map)
        self.cells = Numbering(grid.comm, grid.topology.index_map(grid.topology.dim))
        self.dofs = dofs
        self._node_x = node_x
        self._vertices = geometry_dofmap(grid)
        self._coordinates = np.ascontiguousarray(grid.geometry.x[:, : grid.geometry.dim])
        self.kind = kind_of(grid)

    def node_coordinates(self):
        """Positions of the nodes (m), shape (nodes, 3)."""
        return self._node_x

    def grown(self, layers: int, partition: Partition | None = None) -> LinearBasis:
        """The basis itself: a point sees only nodes of its own cell, and DOLFINx has these."""
        assert partition is None
        return self

    def knowing(self, indices, owners, x) -> LinearBasis:
        """A copy of the basis that knows more nodes of other ranks. Collective.

        Args:
            indices: Global indices of the nodes, all new on this rank, shape (n,).
            owners: Ranks that own the nodes, shape (n,).
            x: Positions of the nodes (m), shape (n, 3).
        """
        old, comm = self.nodes.index_map, self.grid.comm
        ghosts, of = np.append(old.ghosts, indices), np.append(old.owners, owners)
        wider = copy.copy(self)
        wider.nodes = Numbering(comm, make_index_map(comm, old.size_local, ghosts, of))
        wider._node_x = np.vstack([self._node_x, x])
        return wider

    def reach(self, where: Placement) -> tuple[int, int]:
        """0 and 1: a point overlaps only its own cell; see `LatticeBasis.reach`."""
        return 0, 1

    def stencils(self, where: Placement) -> Stencils:
        """Stencils of the points.

        Args:
            where: The points.
        """
        x, cells = where.x, where.cell
        order = np.argsort(cells, kind="stable").astype(np.int32)
        groups = group_starts(cells[order].astype(np.int64))
        number, m = groups.size - 1, self._vertices.shape[1]
        s = Stencils(
            order, groups,
            running_sum(np.full(number, m), np.int32), np.empty(number * m, np.int32),
            running_sum(np.diff(groups).astype(np.int64) * m, np.int64),
            np.empty(len(x) * m), np.empty((len(x) * m, x.shape[1])),
            np.arange(number + 1, dtype=np.int32), cells[order[groups[:-1]]],
        )  # fmt: skip
        _fill(
            self.kind, self._vertices, self._coordinates, self.dofs, x, cells, order, groups,
            s.nodes, s.N, s.dN,
        )  # fmt: skip
        return s
