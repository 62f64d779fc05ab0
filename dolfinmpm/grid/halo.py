"""Numberings of grid nodes and cells that reach as far across rank borders as points' domains do.

DOLFINx's ghost layer holds only neighbours across facets. The domain of a material point also
reaches across corners. A lattice therefore gets its own index maps. They have the same owned
indices and the same ghosts as DOLFINx's maps. Behind them come all nodes and cells within a given
number of layers of the owned cells. A partition may tell the rank that computes each cell.
Ownership then follows the partition, and the cells of DOLFINx's mesh are known too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from dolfinx import la
from dolfinx.common import IndexMap
from mpi4py import MPI

from dolfinmpm._platform.compat import make_index_map

__all__ = ["LatticeHalo", "Numbering"]


class Numbering:
    """Owned and ghost indices of nodes or cells on this rank.

    Args:
        comm: Communicator.
        index_map: Index map of the nodes or cells.

    Attributes:
        comm, index_map: The arguments.
        owned: Number of owned indices.
        size: Number of owned and ghost indices.
    """

    def __init__(self, comm: MPI.Intracomm, index_map: IndexMap):
        self.comm = comm
        self.index_map = index_map
        self.owned = index_map.size_local
        self.size = index_map.size_local + index_map.num_ghosts

    def vector(self, components: int = 1, dtype: npt.DTypeLike = np.float64) -> la.Vector:
        """A distributed array with `components` entries per index. Collective."""
        return la.vector(self.index_map, components, dtype=dtype)

    def share_flags(self, flags: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
        """Whether the flag of each index is set on any rank, shape (size,). Collective."""
        if self.comm.size == 1:
            return flags
        shared = self.vector(dtype=np.int32)
        shared.array[:] = flags
        shared.scatter_reverse(la.InsertMode.add)
        shared.scatter_forward()
        return shared.array > 0


@dataclass(frozen=True)
class LatticeHalo:
    """A lattice's nodes and cells around this rank's own cells.

    Attributes:
        layers: Number of layers of cells around the owned cells that this rank knows.
        nodes: Numbering of the nodes.
        cells: Numbering of the cells.
        origin: Lattice position of the first cell of the tables, shape (gdim,).
        node_table: Local node index by (lattice position − origin), -1 for an unknown node. It has
            `degree` more entries per direction than `cell_table`.
        node_ijk: Lattice position of every known node, shape (nodes, gdim).
        cell_ijk: Lattice position of every known cell, shape (cells, gdim).
        cell_table: Local cell index by (lattice position − origin), -1 for an unknown cell.
    """

    layers: int
    nodes: Numbering
    cells: Numbering
    origin: npt.NDArray[np.int32]
    node_table: npt.NDArray[np.int32]
    node_ijk: npt.NDArray[np.int32]
    cell_ijk: npt.NDArray[np.int32]
    cell_table: npt.NDArray[np.int32]


def dilated(mask: npt.NDArray[np.bool_], layers: int) -> npt.NDArray[np.bool_]:
    """Mask of the cells within some layers of the cells of a mask, also across corners."""
    from scipy.ndimage import binary_dilation

    box = np.ones((2 * layers + 1,) * mask.ndim, bool)
    return np.asarray(binary_dilation(mask, box))


def _directory(comm, keys, values, wanted):
    """Values of the wanted keys on any rank, and the ranks that have these keys. Collective.

    Rank k % size answers questions about key k.
    """

    def by_rank(items):
        return [items[items % comm.size == r] for r in range(comm.size)]

    mine = comm.alltoall([(keys[keys % comm.size == r], values[keys % comm.size == r])
                          for r in range(comm.size)])  # fmt: skip
    kept_keys = np.concatenate([k for k, _ in mine])
    kept_values = np.concatenate([v for _, v in mine])
    kept_owner = np.repeat(np.arange(comm.size), [k.size for k, _ in mine])
    order = np.argsort(kept_keys)
    answers = []
    for question in comm.alltoall(by_rank(wanted)):
        at = order[np.searchsorted(kept_keys[order], question)] if question.size else question
        answers.append((kept_values[at], kept_owner[at]))
    found_values = np.empty(wanted.size, np.int64)
    found_owner = np.empty(wanted.size, np.int32)
    for rank, (value, owner) in enumerate(comm.alltoall(answers)):
        found_values[wanted % comm.size == rank] = value
        found_owner[wanted % comm.size == rank] = owner
    return found_values, found_owner


def _extend(comm, index_map, ijk, shape, needed):
    """Numbering whose ghosts cover the needed lattice positions, and the positions in its order."""
    keys = np.ravel_multi_index(tuple(ijk.T), shape).astype(np.int64)
    owned = index_map.size_local
    new = np.setdiff1d(np.ravel_multi_index(tuple(needed.T), shape).astype(np.int64), keys)
    values, owners = _directory(
        comm, keys[:owned], index_map.local_range[0] + np.arange(owned, dtype=np.int64), new
    )
    extended = make_index_map(
        comm, owned, np.append(index_map.ghosts, values), np.append(index_map.owners, owners)
    )
    positions = np.vstack([ijk, np.column_stack(np.unravel_index(new, shape))])
    return Numbering(comm, extended), positions.astype(np.int32)


def build_halo(
    comm: MPI.Intracomm,
    shape: tuple[int, ...],
    degree: int,
    cell_map: IndexMap,
    cell_ijk: npt.NDArray[np.int32],
    node_map: IndexMap,
    node_ijk: npt.NDArray[np.int32],
    layers: int,
    further: npt.NDArray[np.int32],
    around: npt.NDArray[np.int32] | None = None,
) -> LatticeHalo:
    """Numberings and tables for points that reach `layers` cells beyond their own. Collective.

    Args:
        comm: Communicator.
        shape: Number of cells of the lattice in each direction.
        degree: Degree of the functions: a cell has degree + 1 nodes per direction.
        cell_map: Index map of the cells.
        cell_ijk: Lattice position of every cell in `cell_map`, shape (cells, gdim).
        node_map: Index map of the nodes.
        node_ijk: Lattice position of every node in `node_map`, shape (nodes, gdim).
        layers: Number of layers of cells to know around the cells of `around`.
        further: Lattice positions of further cells to know, shape (n, gdim).
        around: Lattice positions of the cells inside the layers, shape (n, gdim). All owned cells
            must be among them. By default they are the owned cells.
    """
    gdim = len(shape)
    if comm.size == 1:
        nodes, cells = Numbering(comm, node_map), Numbering(comm, cell_map)
        origin = np.zeros(gdim, np.int32)
        stop = np.array(shape)
    else:
        own = cell_ijk[: cell_map.size_local] if around is None else around
        known = np.vstack([cell_ijk, own, further])
        known = known if len(known) else np.zeros((1, gdim), np.int32)
        origin = np.maximum(known.min(axis=0) - layers, 0).astype(np.int32)
        stop = np.minimum(known.max(axis=0) + 1 + layers, shape)
        mask: npt.NDArray[np.bool_] = np.zeros(stop - origin, bool)
        mask[tuple((own - origin).T)] = True
        mask = dilated(mask, layers)
        mask[tuple((further - origin).T)] = True
        node_mask = np.zeros(stop - origin + degree, bool)
        for corner in np.ndindex(*(degree + 1,) * gdim):
            node_mask[tuple(slice(c, c + n) for c, n in zip(corner, mask.shape))] |= mask
        cells, cell_ijk = _extend(comm, cell_map, cell_ijk, shape, np.argwhere(mask) + origin)
        nodes, node_ijk = _extend(
            comm, node_map, node_ijk, np.array(shape) + degree, np.argwhere(node_mask) + origin
        )
    node_table = np.full(stop - origin + degree, -1, np.int32)
    cell_table = np.full(stop - origin, -1, np.int32)
    for table, positions in ((node_table, node_ijk), (cell_table, cell_ijk)):
        inside = np.all((positions >= origin) & (positions < origin + table.shape), axis=1)
        table[tuple((positions[inside] - origin).T)] = np.flatnonzero(inside)
    return LatticeHalo(layers, nodes, cells, origin, node_table, node_ijk, cell_ijk, cell_table)
