"""Material points that crossed a rank border move with every field they carry."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm._platform.errors import MigrationError
from dolfinmpm.body.location import Destinations

__all__ = ["migrate", "send_rows"]


def migrate(points, to: Destinations) -> int:
    """Move points to the ranks that own their cells. Collective.

    Reads and changes every field of the points. The number of points and their
    mass are compared before and after, over all ranks.

    Args:
        points: Material points.
        to: Owner and cell of each of them.

    Returns:
        How many points changed rank, over all ranks.

    Raises:
        MigrationError: Points or mass were lost or doubled.
    """
    comm, fields = points.comm, points.fields
    first = points.grid.topology.index_map(points.grid.topology.dim).local_range[0]
    leaving = np.flatnonzero(to.rank != comm.rank)
    moved = comm.allreduce(leaving.size, op=MPI.SUM)
    if moved == 0:
        fields["cell"][:] = to.cell - first
        return 0
    before = _totals(points)
    for name, rows in send_rows(comm, {**fields, "cell": to.cell}, to.rank).items():
        fields[name] = rows if name != "cell" else (rows - first).astype(np.int32)
    after = _totals(points)
    if after[0] != before[0] or abs(after[1] - before[1]) > 1e-12 * abs(before[1]):
        raise MigrationError(
            f"migration changed the points from {before[0]:.0f} with mass {before[1]!r} kg to "
            f"{after[0]:.0f} with mass {after[1]!r} kg; please report this with mpm.info()"
        )
    return moved


def send_rows(
    comm: MPI.Intracomm, rows: dict[str, npt.NDArray[Any]], rank: npt.NDArray[np.int32]
) -> dict[str, npt.NDArray[Any]]:
    """Rows of arrays, each sent to the rank that is named for it. Collective.

    Args:
        comm: Communicator of the ranks.
        rows: Arrays of n rows each, of the same names, shapes of a row and types on all ranks.
        rank: Where each row goes, shape (n,).

    Returns:
        The rows that stayed in their order, and behind them those that came, by rank.
    """
    leaving = np.flatnonzero(rank != comm.rank)
    leaving = leaving[np.argsort(rank[leaving], kind="stable")]
    counts = np.bincount(rank[leaving], minlength=comm.size)
    packed = np.hstack(
        [np.ascontiguousarray(a[leaving]).view(np.uint8).reshape(leaving.size, _row_bytes(a))
         for a in rows.values()]
    )  # fmt: skip
    width = packed.shape[1]
    arriving = np.empty_like(counts)
    comm.Alltoall(counts, arriving)
    received = np.empty((arriving.sum(), width), np.uint8)
    comm.Alltoallv([np.ascontiguousarray(packed), counts * width], [received, arriving * width])
    staying = rank == comm.rank
    start, joined = 0, {}
    for name, values in rows.items():
        size = _row_bytes(values)
        piece = np.ascontiguousarray(received[:, start : start + size]).view(values.dtype)
        joined[name] = np.concatenate([values[staying], piece.reshape(-1, *values.shape[1:])])
        start += size
    return joined


def _row_bytes(values: np.ndarray) -> int:
    return values.dtype.itemsize * int(np.prod(values.shape[1:], dtype=int))


def _totals(points) -> np.ndarray:
    mass = float(np.dot(points["density"], points["V0"]))
    return points.comm.allreduce(np.array([len(points), mass]), op=MPI.SUM)
