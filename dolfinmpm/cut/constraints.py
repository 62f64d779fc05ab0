"""Constraints of a field: the matrix C of its stabilisation, of the user and of hanging nodes."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm._platform.errors import DolfinMPMError, ParameterError, call_together
from dolfinmpm.basis import LeafBasis, Placement, Stencils
from dolfinmpm.cut.activation import Basis, Field
from dolfinmpm.cut.aggregation import MeshRoots

if TYPE_CHECKING:
    from scipy import sparse

__all__ = ["Constraints", "constraints_of"]


class Constraints(NamedTuple):
    """Constraints of a field in a step.

    Attributes:
        C: Matrix from the independent nodes to all nodes, or None.
        level: Fill fraction from which the nodes of a cell are independent, or None if no
            stabilisation constrains nodes.
        penalty: Rows, columns and blocks of the penalty of weak aggregation, or None.
    """

    C: sparse.csr_matrix | None
    level: float | None
    penalty: tuple[npt.NDArray, npt.NDArray, npt.NDArray] | None


def constraints_of(
    field: Field,
    basis: Basis,
    where: Placement,
    seen: Stencils,
    nodes: npt.NDArray[np.int32],
    fixed: npt.NDArray[np.bool_],
    roots: MeshRoots | None,
) -> Constraints:
    """The constraints of a field on the active cells. Collective.

    Args:
        field: The field.
        basis: Its basis, with the overlap of ranks for the step.
        where: Points and markers.
        seen: Their stencils on all active nodes.
        nodes: Active nodes, increasing.
        fixed: Mask of the prescribed components. Their nodes do not follow other nodes.
        roots: Roots of ill-filled cells on meshes that are no lattices, or None.
    """
    C = level = penalty = None
    comm = basis.nodes.comm
    if field.constraining is not None:
        C = field.constraining.constraint_matrix(where, basis, seen, nodes, fixed, roots)
    if C is not None and field.stabilisation.kind == "weak-aggregation":
        owned = nodes[: np.searchsorted(nodes, basis.nodes.owned)]
        radius = basis.node_coordinates()[:, 0] if where.axisymmetric else None
        sizes = basis.node_sizes() if isinstance(basis, LeafBasis) else None
        penalty = field.stabilisation.penalty(field.space, C, owned, radius, sizes)
        C = None
    if C is not None and field.constraining is not None:
        level = field.constraining.level(basis.degree)
    if field.prolongate is not None:
        call = functools.partial(field.prolongate, seen, nodes)
        if (of_basis := getattr(field.prolongate, "of_basis", None)) is not None:
            call = functools.partial(of_basis, basis, nodes)
        given = _given_matrix(call, basis.nodes.size, comm)
        C = given if C is None else C @ given
    if isinstance(basis, LeafBasis) and basis.hangs.any():
        H = basis.hanging
        # a node may follow a root with hanging corners
        C = H if C is None else H @ C @ H
    return Constraints(C, level, penalty)


def _given_matrix(function: Callable[[], Any], size: int, comm: MPI.Comm) -> sparse.csr_matrix:
    """The matrix C of a user's function. Collective.

    Args:
        function: Function without arguments, which returns the matrix.
        size: Number of nodes of this rank.
        comm: Communicator.

    Raises:
        ParameterError: The function fails, or returns something else, or zeros on all ranks.
    """
    from scipy import sparse

    def made() -> sparse.csr_matrix:
        try:
            C = sparse.csr_matrix(function(), dtype=np.float64)
        except DolfinMPMError:
            raise
        except Exception as error:
            raise ParameterError(
                f"prolongation failed with {type(error).__name__}: {error}; it is called with "
                "stencils and active nodes, and returns a matrix of shape (nodes, nodes)"
            ) from error
        if C.shape != (size, size) or not np.isfinite(C.data).all():
            raise ParameterError(
                f"prolongation returned a matrix of shape {C.shape}, and must return finite "
                f"numbers of shape {(size, size)}, one row and one column per node of this rank"
            )
        return C

    C = call_together(comm, made)
    entries, nodes = comm.allreduce(np.array([np.count_nonzero(C.data), size]), op=MPI.SUM)
    if nodes and not entries:
        raise ParameterError(
            f"prolongation returned zeros for all {nodes} nodes, which would hold the whole body: "
            "the row of an independent node has a 1 in its own column"
        )
    return C
