"""Numberings of grid nodes and cells that reach as far across rank borders as the points do.

DOLFINx's ghost layer holds the neighbours across facets only. The domain of a
material point also reaches across corners, so that a lattice gets index maps of
its own: the same owned indices, the same ghosts first, and behind them every
node and cell within a given number of layers of the owned cells. Where a partition tells which
rank computes a cell, what is owned follows it, and the cells of DOLFINx's mesh are known too.
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
    """Owned and ghost indices of nodes or cells on this rank."""

    def __init__(self, comm: MPI.Intracomm, index_map: IndexMap):
        self.comm = comm
        self.index_map = index_map
        self.owned = index_map.size_local
        self.size = index_map.size_local + index_map.num_ghosts

    def vector(self, components: int = 1, dtype: npt.DTypeLike = np.float64) -> la.Vector:
        """A distributed array, `components` entries an index. Collective."""
        return la.vector(self.index_map, components, dtype=dtype)

    def share_flags(self, flags: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
        """Flags that are set on any rank that knows the index, shape (size,). Collective."""
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
        layers: Layers of cells around the owned ones that are known here.
        nodes: Numbering of the nodes.
        cells: Numbering of the cells.
        origin: Lattice position of the first cell of the tables, shape (gdim,).
        node_table: Local node index by lattice position less origin, -1 where
            the node is not known here; `degree` more than cell_table a direction.
        node_ijk: Lattice position of every node known here, shape (nodes, gdim).
        cell_ijk: Lattice position of every cell known here, likewise.
        cell_table: Local cell index by lattice position less origin, -1 likewise.
    """

    layers: int
    nodes: Numbering
    cells: Numbering
    origin: npt.NDArray[np.int32]
    node_table: npt.NDArray[np.int32]
    node_ijk: npt.NDArray[np.int32]
    cell_ijk: npt.NDArray[np.int32]
    cell_table: npt.NDArray[np.int32]


def _directory(comm, keys, values, wanted):
    """Values that other ranks keep under the wanted keys, and who keeps them. Collective."""

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
    """An index map whose ghosts cover the needed lattice positions, and all positions' order."""
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
    also: npt.NDArray[np.int32],
    around: npt.NDArray[np.int32] | None = None,
) -> LatticeHalo:
    """Numberings and tables for points that reach `layers` cells beyond their own. Collective.

    Args:
        comm: Communicator.
        shape: Number of cells of the lattice in each direction.
        degree: Degree of the functions: a cell has degree + 1 nodes per direction.
        cell_map: Index map of the cells.
        cell_ijk: Lattice position of every cell of that map, shape (cells, gdim).
        node_map: Index map of the nodes.
        node_ijk: Lattice position of every node of that map, shape (nodes, gdim).
        layers: Layers of cells that are to be known around the owned cells, or others.
        also: Lattice positions of further cells that are to be known, shape (n, gdim).
        around: Lattice positions of the cells that layers are around, all owned ones among them,
            likewise; the owned ones by default.
    """
    gdim = len(shape)
    if comm.size == 1:
        nodes, cells = Numbering(comm, node_map), Numbering(comm, cell_map)
        origin = np.zeros(gdim, np.int32)
        stop = np.array(shape)
    else:
        own = cell_ijk[: cell_map.size_local] if around is None else around
        known = np.vstack([cell_ijk, own, also])
        known = known if len(known) else np.zeros((1, gdim), np.int32)
        origin = np.maximum(known.min(axis=0) - layers, 0).astype(np.int32)
        stop = np.minimum(known.max(axis=0) + 1 + layers, shape)
        mask: npt.NDArray[np.bool_] = np.zeros(stop - origin, bool)
        mask[tuple((own - origin).T)] = True
        for d in range(gdim if layers else 0):
            wide = np.pad(mask, [(layers, layers) if d == e else (0, 0) for e in range(gdim)])
            windows = np.lib.stride_tricks.sliding_window_view(wide, 2 * layers + 1, d)
            mask = np.asarray(windows.any(axis=-1))
        mask[tuple((also - origin).T)] = True
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
