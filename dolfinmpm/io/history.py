"""Numbers recorded in every step, such as load–settlement curves."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm._platform.argumentchecks import check_kind, file_path, shown
from dolfinmpm._platform.collective import collective
from dolfinmpm._platform.errors import ParameterError, UnknownNameError, call_together
from dolfinmpm.body.probes import Probe
from dolfinmpm.io.ownership import refuse_other, take_paths
from dolfinmpm.io.tables import check_suffix, write_table

__all__ = ["History"]


class History:
    """Named numbers, one value per name and step.

    Call `history.record(settlement=s.value, load=footing.load())` after every step. Then
    `history["load"]` is an array, and `history.write("curve.csv")` writes a table.

    `record(crest=crest)` with an `mpm.probe` records its displacement (m) as `crest_x`, `crest_y`
    and in 3D `crest_z`. After `measure_stages()`, `record(..., **problem.history[-1].stages)`
    records the times of the stages (s).

    Args:
        comm: Ranks that record the same numbers.

    Attributes:
        names: Names of the numbers, in the order of the first record.
    """

    def __init__(self, comm: MPI.Comm = MPI.COMM_WORLD):
        check_kind("comm", comm, MPI.Comm, "MPI.COMM_WORLD by default")
        self._comm = comm
        self._rows: list[dict[str, float]] = []
        self.names: tuple[str, ...] = ()

    def record(self, *unnamed: Any, **values: float | Probe) -> None:
        """Add one value per name, and the displacement of each probe.

        With a probe all ranks must call it.

        Args:
            unnamed: Not allowed; values need names.
            values: Name → number, or name → probe.

        Raises:
            ParameterError: There is no value, or a value without a name. Or the names differ from
                those of the first record, or a value is not a single number.
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

    def __getitem__(self, name: str) -> npt.NDArray[np.float64]:
        if name not in self.names:
            known = ", ".join(self.names) or "no records yet"
            raise UnknownNameError(f"nothing is recorded as '{name}'; there are {known}")
        return np.array([row[name] for row in self._rows])

    @collective(comm_of=lambda history, *_, **__: history._comm)
    def write(self, path: str | os.PathLike[str]) -> None:
        """Write a table as .csv or .json; see `study.write_table`. Collective.

        Raises:
            ParameterError: The path is invalid, nothing has been recorded, or another existing
                `History` writes to the path.
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
        write_table(self._rows, path, comm=self._comm)


def _with_components(values: dict[str, Any]) -> dict[str, Any]:
    """The values with the displacements of probes, component by component. Collective."""
    found: dict[str, Any] = {}
    for name, value in values.items():
        if isinstance(value, Probe):
            found |= {f"{name}_{axis}": u for axis, u in zip("xyz", value.displacement)}
        else:
            found[name] = value
    return found


def _single(name: str, value: Any) -> float:
    try:
        single = np.ndim(value) == 0 and not isinstance(value, (str, bytes))
        number = float(value) if single else None
    except (TypeError, ValueError):
        number = None
    if number is None:
        raise ParameterError(
            f"{name} = {shown(value)} must be a single number; record components under names of "
            "their own"
        )
    return number
