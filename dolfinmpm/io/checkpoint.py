"""Checkpoints: the state of points and solver for a restart, in one archive of NumPy (.npz).

The file has the version `VERSION` and these arrays:

- `points/<field>`: every field of the points, rank by rank;
- `cells/<name>`: arrays with one row per cell of the grid, rank by rank, with `cells/middle`;
- `local/<name>`: data of a single rank;
- `header.json`, written last: fingerprint and partition of the grid, fields and laws of the
  points, the solver's numbers, and its history.

Every array has a checksum. `numpy.load` opens the file: `numpy.load("slope.npz")["points/x"]`.
"""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm._platform.errors import CheckpointError, raise_together
from dolfinmpm.assembly.state import Local, OfCells
from dolfinmpm.body.exchange import exchange
from dolfinmpm.body.location import destinations
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.grid.fingerprint import differs, fingerprint, owned_corners, partition
from dolfinmpm.grid.partition import Partition
from dolfinmpm.io.rowfile import RowReader, RowWriter

__all__ = ["VERSION", "Checkpoint", "read", "write"]

Arrays = dict[str, npt.NDArray[Any]]
State = dict[str, Any]

FORMAT, VERSION = "dolfinmpm checkpoint", 6

# Number of positions that ranks exchange at a time.
_ASKED = 50_000


@dataclass(frozen=True)
class Checkpoint:
    """Content of a checkpoint for this rank. Reading a checkpoint changes nothing.

    Attributes:
        fields: Fields of the points by name, shape (points, ...).
        state: The state given to `write`. `Local` data are missing if the number of ranks or the
            partition of the grid has changed.
        history: Records of the steps.
        computed: Rank that computes the points of each cell; None for the partition by DOLFINx.
    """

    fields: Arrays
    state: State
    history: list[dict[str, Any]]
    computed: Partition | None = None

    def put(self, points: MaterialPoints) -> None:
        """Copy the fields from the file to the points. Collective."""
        for name in points.fields:
            points.fields[name] = self.fields[name]
        points.partition = self.computed
        points.restored += 1
        points.recount()


def write(
    path: str | os.PathLike[str],
    points: MaterialPoints,
    state: State,
    history: list[dict[str, Any]],
    laws: Sequence[str] = (),
) -> None:
    """Write a checkpoint. A complete new file replaces an old file of this name. Collective.

    Args:
        path: File to write, in an existing folder.
        points: Material points.
        state: State of the problem, see `dolfinmpm.assembly.state`: numbers, words, None and
            small arrays that are the same on all ranks; `Local` and `OfCells` of the same names
            on all ranks.
        history: Records of the steps, the same on all ranks.
        laws: Descriptions of the laws at the points.

    Raises:
        CheckpointError: The file cannot be written. An old file of this name is unchanged.
    """
    grid = points.grid
    local = {name: one.values for name, one in state.items() if isinstance(one, Local)}
    cells = {name: one.values for name, one in state.items() if isinstance(one, OfCells)}
    plain = {k: v for k, v in state.items() if not isinstance(v, (Local, OfCells))}
    if cells:
        cells["middle"] = owned_corners(grid).mean(axis=1)
    header = {
        "ranks": points.comm.size,
        "grid": fingerprint(grid),
        "partition": partition(grid),
        "fields": _shapes(points),
        "laws": sorted(laws),
        "configuration": points.configuration,
        "computed": None if points.partition is None else dataclasses.asdict(points.partition),
        "state": plain,
        "history": history,
    }
    with RowWriter(points.comm, path, FORMAT, VERSION) as file:
        for group, arrays in (("points", points.fields), ("cells", cells), ("local", local)):
            for name, values in arrays.items():
                file.rows(f"{group}/{name}", values)
        file.header(header)


def read(
    path: str | os.PathLike[str], points: MaterialPoints, laws: Sequence[str] = ()
) -> Checkpoint:
    """Read a checkpoint on any number of ranks. Collective.

    With the same number of ranks and the same partition of the grid, every rank gets its own rows
    in their order. Else every rank gets the points in its own cells, sorted by their id.

    Args:
        path: The file.
        points: Points of the same grid, with the same fields; they are not changed.
        laws: Descriptions of the laws at the points, as in `write`.

    Raises:
        CheckpointError: The file is missing, cut short, damaged, of another version, of
            another grid, or of points with other fields or laws.
    """
    comm, grid = points.comm, points.grid
    here, shares = fingerprint(grid), partition(grid)
    with RowReader(comm, path, FORMAT, VERSION) as file:
        header = file.header
        raise_together(comm, _mismatch(str(file.path), header, points, here, laws))
        kept = header["partition"] == shares
        kept = kept and header["configuration"] == points.configuration

        def rows(group: str) -> Arrays:
            names = file.names(group)
            counts = file.counts(f"{group}/{names[0]}") if names else []
            counts = counts if kept else _even(sum(counts), comm.size)
            return {name: file.rows(f"{group}/{name}", counts) for name in names}

        fields, cells = rows("points"), rows("cells")
        local: Arrays | None = None
        error: CheckpointError | None = None
        if kept:
            names = file.names("local")
            local = {name: file.rows(f"local/{name}", file.counts(f"local/{name}"))
                     for name in names}  # fmt: skip
        else:
            position = "x0" if points.configuration == "total" else "x"
            fields = _sent(grid, fields, position, str(file.path))
            fields = _sorted(fields, "id")
            if cells:
                cells = _sorted(_sent(grid, cells, "middle", str(file.path)), "cell")
                owned = grid.topology.index_map(grid.topology.dim).size_local
                if not np.array_equal(cells.pop("cell"), np.arange(owned)):
                    error = CheckpointError(f"{file.path} has not one row for each cell")
                raise_together(comm, error)
    cells.pop("middle", None)
    computed = header.get("computed") if kept else None
    state = dict(header["state"])
    if computed is not None:
        computed = Partition.restored(computed)
    state |= {name: OfCells(values) for name, values in cells.items()}
    state |= {name: Local(values) for name, values in (local or {}).items()}
    return Checkpoint(fields, state, header["history"], computed)


def _even(total: int, parts: int) -> list[int]:
    return [total // parts + (rank < total % parts) for rank in range(parts)]


def _sorted(rows: Arrays, key: str) -> Arrays:
    order = np.argsort(rows[key], kind="stable")
    return {name: values[order] for name, values in rows.items()}


def _sent(grid, rows: Arrays, position: str, path: str) -> Arrays:
    """Rows, each on the rank that owns the cell at its position, named in "cell". Collective."""
    comm, x = grid.comm, rows[position]
    rank, cell = np.empty(len(x), np.int32), np.empty(len(x), np.int64)
    most = comm.allreduce(len(x), op=MPI.MAX)
    # a few at a time: all ranks get every position whose cell its own rank does not find
    for begin in range(0, most, _ASKED):
        some = slice(begin, begin + _ASKED)
        to = destinations(grid, x[some])
        rank[some], cell[some] = to.rank, to.cell
    lost = np.flatnonzero(rank < 0)
    error = None
    if lost.size:
        error = CheckpointError(f"{path} has {lost.size} points outside the grid: {x[lost[0]]} m")
    raise_together(comm, error)
    first = grid.topology.index_map(grid.topology.dim).local_range[0]
    arrived = exchange(comm, {**rows, "cell": cell}, rank)
    arrived["cell"] = (arrived["cell"] - first).astype(np.int32)
    return arrived


def _shapes(points: MaterialPoints) -> dict[str, Any]:
    return {name: [a.dtype.str, list(a.shape[1:])] for name, a in points.fields.items()}


def _mismatch(
    path: str,
    header: dict[str, Any],
    points: MaterialPoints,
    here: dict[str, Any],
    laws: Sequence[str],
) -> CheckpointError | None:
    """Error about fields or laws that only the file or only the points have, or None."""
    apart = differs(header["grid"], here)
    if apart:
        return CheckpointError(f"{path} is of another grid: {apart} of this one; build the same")
    for what, there, now in (
        ("laws", header["laws"], laws),
        ("fields", _listed(header["fields"]), _listed(_shapes(points))),
    ):
        more, less = sorted({*there} - {*now}), sorted({*now} - {*there})
        if more or less:
            return CheckpointError(
                f"{path} is of another problem: of the points' {what} it has "
                f"{', '.join(more) or 'nothing'} that the points have not, and lacks "
                f"{', '.join(less) or 'none'}; build the same problem, with all its fields, "
                "before you load"
            )
    return None


def _listed(fields: dict[str, Any]) -> Sequence[str]:
    return [f"{name} {np.dtype(kind).name}{tuple(shape)}" for name, (kind, shape) in fields.items()]
