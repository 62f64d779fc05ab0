"""Pieces of a body that touch nothing: in steps without inertia they have no equilibrium."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm.basis.conditionchecks import free_motions
from dolfinmpm.basis.conditions import node_coordinates
from dolfinmpm.basis.leafbasis import LeafBasis
from dolfinmpm.cut.activecells import active_on_grid

if TYPE_CHECKING:
    from dolfinmpm.solve.quasistatic import QuasiStatic

__all__ = ["loose_piece"]

Numbers = npt.NDArray[np.int64]

# Pieces that are looked at
_MOST = 10


def loose_piece(problem: QuasiStatic) -> str:
    """A piece of the body that no condition holds, in words. Collective.

    Pieces share no nodes. Those of refined spaces are not looked at.

    Args:
        problem: The problem, after a step that failed.

    Returns:
        The words, or an empty string if the body is one piece, or conditions hold all pieces.
    """
    assert problem.here is not None
    first = problem.here.fields[0]
    space, basis, comm = first.space, first.basis, problem.comm
    if isinstance(basis, LeafBasis):
        return ""
    active = active_on_grid(first)
    own = active if basis.grid_nodes is None else basis.grid_nodes[active]
    piece = _pieces(first.full_stencils, basis, own, comm)
    count = comm.allreduce(int(piece.max(initial=-1)), op=MPI.MAX) + 1
    if count < 2:
        return ""
    x = node_coordinates(space)
    for k in range(min(count, _MOST)):
        own = active[piece == k]
        free = free_motions(problem.bcs, space, own, problem.points.axisymmetric)
        if free:
            sums = comm.allreduce(np.append(x[own].sum(axis=0), own.size), op=MPI.SUM)
            at = (sums[:-1] / sums[-1])[: problem.points.gdim]
            return (
                f"the body has {count} pieces that share no nodes, and no condition holds the "
                f"rigid motions {', '.join(free)} of the one around {at} m, unless contact does: "
                "let it rest on the others, hold or remove it, or take Newmark"
            )
    return ""


def _pieces(stencils: Any, basis: Any, active: npt.NDArray[np.int32], comm: MPI.Comm) -> Numbers:
    """Number of the piece of some own nodes, the same on all ranks, shape (n,). Collective."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    counts = np.diff(stencils.node_start)
    # points of other fields have no nodes
    own = counts > 0
    heads = np.repeat(stencils.nodes[stencils.node_start[:-1][own]], counts[own])
    size = basis.nodes.size
    graph = coo_matrix((np.ones(heads.size), (heads, stencils.nodes)), shape=(size, size))
    _, label = connected_components(graph, directed=False)
    # one edge for each node: to the first node of its piece on this rank
    seen = np.unique(stencils.nodes)
    _, first, which = np.unique(label[seen], return_index=True, return_inverse=True)
    number = basis.nodes.index_map.local_to_global
    edges = np.stack([number(seen), number(seen[first[which.ravel()]])])
    every = np.concatenate(comm.allgather(edges), axis=1)
    nodes, ends = np.unique(every, return_inverse=True)
    ends = ends.reshape(2, -1)
    whole = coo_matrix((np.ones(ends.shape[1]), tuple(ends)), shape=(nodes.size,) * 2)
    _, piece = connected_components(whole, directed=False)
    return piece[np.searchsorted(nodes, number(active))].astype(np.int64)
