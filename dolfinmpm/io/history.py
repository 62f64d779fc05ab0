"""Numbers recorded in every step, such as load–settlement curves."""

from __future__ import annotations

import os
from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm._platform import stages
from dolfinmpm._platform.argumentchecks import check_dictionary, check_kind, shown
from dolfinmpm._platform.collective import collective
from dolfinmpm._platform.errors import (
    LocalValueWarning,
    ParameterError,
    UnknownNameError,
    call_together,
    warn,
)
from dolfinmpm._platform.filepaths import file_path
from dolfinmpm._platform.html import table
from dolfinmpm._platform.uncopied import Unchanged
from dolfinmpm.body.probes import Probe
from dolfinmpm.io.figures import check_size, figure
from dolfinmpm.io.ownership import refuse_other, take_paths
from dolfinmpm.io.tables import check_suffix, write_table

__all__ = ["History"]

# Numbers that differ by less than this share of the largest one differ by rounding
_ROUNDING = 1e-6
# ... and so do those below this share of a unit
_LEAST = 1e-9


class History(Unchanged):
    """Named numbers, one value per name and step.

    Call `history.record(settlement=s.value, load=footing.load())` after every step. Then
    `history["load"]` is an array, and `history.write("curve.csv")` writes a table.

    `record(crest=crest)` with an `mpm.probe` records its displacement (m) as `crest_x`, `crest_y`
    and in 3D `crest_z`. `record(force=wall.force)` records the components of a vector in the same
    way. After `measure_stages()`, `record(..., **problem.history[-1].stages)` records the times of
    the stages (s).

    Args:
        comm: Ranks that record the same numbers.

    Attributes:
        names: Names of the numbers, in the order of the first record.

    >>> import dolfinmpm as mpm
    >>> curve = mpm.History()
    >>> for share in mpm.steps(2):
    ...     curve.record(share=share, load=-1e4 * share)
    >>> curve["load"].tolist()
    [-5000.0, -10000.0]
    """

    def __init__(self, comm: MPI.Comm = MPI.COMM_WORLD):
        check_kind("comm", comm, MPI.Comm, "MPI.COMM_WORLD by default")
        self._comm = comm
        self._rows: list[dict[str, float]] = []
        self.names: tuple[str, ...] = ()

    def record(self, *unnamed: Any, **values: float | npt.NDArray[np.float64] | Probe) -> None:
        """Add one value per name, the components of vectors, and the displacements of probes.

        All ranks record the same number: a sum over a rank's own points goes through
        `comm.allreduce(value)` before. With a probe all ranks must call it.

        Args:
            unnamed: Not allowed; values need names.
            values: Name → number, array of shape (2,) or (3,), or probe.

        Raises:
            ParameterError: There is no value, or a value without a name. Or the names differ from
                those of the first record, or a value is neither a number nor a vector.
        """
        if unnamed:
            raise ParameterError(
                f"record({shown(unnamed[0])}) has no name: write record(load=...) or another word"
            )
        values = _with_components(values)
        if self._rows and set(values) != set(self.names):
            raise ParameterError(
                f"record has {', '.join(values)}; the first had {', '.join(self.names)}: give the "
                "same names every time"
            )
        if not values:
            raise ParameterError("record needs a number or more, as in record(load=footing.load())")
        row = {name: _single(name, value) for name, value in values.items()}
        self.names = self.names or tuple(values)
        self._rows.append({name: row[name] for name in self.names})

    def __len__(self) -> int:
        return len(self._rows)

    def __iter__(self) -> Iterator[str]:  # `in` and list() would count numbers from 0 without it
        return iter(self.names)

    def __getitem__(self, name: str) -> npt.NDArray[np.float64]:
        if not isinstance(name, str) or name not in self.names:
            known = ", ".join(self.names) or "no records yet"
            raise UnknownNameError(f"nothing is recorded as {shown(name)}; there are {known}")
        return np.array([row[name] for row in self._rows])

    @collective(comm_of=lambda history, *_, **__: history._comm)
    def write(self, path: str | os.PathLike[str]) -> None:
        """Write the numbers of rank 0 as .csv or .json; see `study.write_table`. Collective.

        Raises:
            ParameterError: The path is invalid, nothing has been recorded, or another existing
                `History` writes to the path.

        Warns:
            LocalValueWarning: Numbers differ between ranks by more than rounding. The times of
                stages may differ.
        """
        at = file_path("path", path)
        check_suffix(at)

        def check() -> None:
            if not self._rows:
                raise ParameterError(
                    "nothing has been recorded yet; call record(name=value) before, on all ranks"
                )
            refuse_other(self, at, "History")

        call_together(self._comm, check)
        take_paths(self, [at])
        self._compare()
        write_table(self._rows, path, comm=self._comm)

    def _compare(self) -> None:
        """Warn of numbers that differ between ranks. Collective."""
        names = self._comm.bcast(self.names)
        own = [self[name] if name in self.names else np.empty(0) for name in names]
        for name, columns in zip(names, zip(*self._comm.allgather(own))):
            first = columns[0]
            size = max(float(np.abs(first[np.isfinite(first)]).max(initial=0.0)), _LEAST)
            for rank, other in enumerate(columns):
                if len(other) != len(first) or name in stages.STEP:
                    continue
                same = np.isclose(first, other, rtol=0.0, atol=_ROUNDING * size, equal_nan=True)
                if same.all():
                    continue
                k = int(np.argmin(same))
                warn(
                    self._comm,
                    f"record({name}=...) differs between ranks: {first[k]:.6g} on rank 0, "
                    f"{other[k]:.6g} on rank {rank} in record {k + 1}, and rank 0's number is "
                    f"written. Sum what each rank has of its own: {name}=comm.allreduce(value), "
                    "or with op=MPI.MAX for a largest value or a time",
                    LocalValueWarning,
                )
                break

    def plot(
        self,
        path: str | os.PathLike[str],
        x: str,
        *y: str,
        labels: dict[str, str] | None = None,
        ylabel: str | None = None,
        size: tuple[float, float] = (3.5, 2.6),
    ) -> None:
        """Draw recorded numbers over one of them. Rank 0 writes the picture.

        Args:
            path: Picture to write; its ending selects the format (.png, .pdf, ...).
            x: Name of the number along the horizontal axis.
            y: Names of the numbers to draw, one after another; all others by default.
            labels: Name → text beside the axes and in the legend, with its unit.
            ylabel: Text beside the vertical axis, with its unit, for several numbers.
            size: Width and height (inch).

        Raises:
            UnknownNameError: Nothing is recorded under a name.
            ParameterError: There is nothing to draw, or an argument has the wrong type.
            OSError: The file cannot be written; on rank 0 only.

        >>> import tempfile
        >>> curve = History()
        >>> for t in (0.0, 1.0, 2.0):
        ...     curve.record(t=t, load=t**2)
        >>> curve.plot(f"{tempfile.mkdtemp()}/load.png", "t", "load", labels={"t": "time (s)"})
        """
        check_size(size)
        labels = {} if labels is None else labels
        check_dictionary("labels", labels, ", name → text")
        for name in labels:
            self[name]
        texts = {name: name.replace("_", " ") for name in self.names} | dict(labels)
        for several in y:
            if isinstance(several, (list, tuple)):
                names = ", ".join(map(repr, several))
                raise ParameterError(
                    f"y = {shown(several)} must be names one after another: "
                    f"plot(path, {x!r}, {names})"
                )
        drawn = y or tuple(name for name in self.names if name != x)
        if not drawn:
            raise ParameterError(f"there is nothing to draw over {x!r}; record another number")
        columns = self[x], [self[name] for name in drawn]
        with figure(path, *size) as (_, axes):
            for name, values in zip(drawn, columns[1]):
                axes.plot(columns[0], values, label=texts[name])
            axes.set_xlabel(texts[x])
            if len(drawn) > 1:
                axes.legend()
            axes.set_ylabel(ylabel or (texts[drawn[0]] if len(drawn) == 1 else ""))

    def __repr__(self) -> str:
        return f"History of {len(self)} records: {', '.join(self.names)}".rstrip(": ")

    def _repr_html_(self) -> str:
        """The last records as a table, for notebooks."""
        return table(self._rows[-8:], f"{len(self)} records")


def _with_components(values: dict[str, Any]) -> dict[str, Any]:
    """The values with vectors and displacements of probes by component. Collective."""
    found: dict[str, Any] = {}
    for name, value in values.items():
        shape = value.shape if isinstance(value, np.ndarray) else None
        if isinstance(value, Probe) or shape in ((2,), (3,)):
            vector = value.displacement if isinstance(value, Probe) else value
            found |= {f"{name}_{axis}": component for axis, component in zip("xyz", vector)}
        else:
            found[name] = value[0] if shape == (1,) else value
    return found


def _single(name: str, value: Any) -> float:
    try:
        single = np.ndim(value) == 0 and not isinstance(value, (str, bytes))
        number = float(value) if single else None
    except (TypeError, ValueError, OverflowError):
        number = None
    if number is None:
        raise ParameterError(
            f"{name} = {shown(value)} must be a single number, or an array of 2 or 3 components"
        )
    return number
