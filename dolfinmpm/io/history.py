"""What a script keeps of every step: load–settlement curves and the like."""

from __future__ import annotations

import os

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm._platform.errors import ParameterError
from dolfinmpm.io.tables import write_table

__all__ = ["History"]


class History:
    """Named numbers, one of each a step.

    `history.record(settlement=s.value, load=footing.load())` after every step;
    `history["load"]` is then an array, and `history.write("curve.csv")` a table.

    Args:
        comm: Ranks that record the same numbers.

    Attributes:
        names: Names of the numbers, in the order of the first record.
    """

    def __init__(self, comm: MPI.Comm = MPI.COMM_WORLD):
        self._comm = comm
        self._rows: list[dict[str, float]] = []
        self.names: tuple[str, ...] = ()

    def record(self, **values: float) -> None:
        """Add one of each number.

        Raises:
            ParameterError: The names are not those of the first record, or a value is not
                a single number.
        """
        if self._rows and set(values) != set(self.names):
            raise ParameterError(
                f"record has {', '.join(values)}; the first had {', '.join(self.names)}: give the "
                "same names every time"
            )
        wrong = [name for name, value in values.items() if np.ndim(value) != 0]
        if wrong:
            raise ParameterError(
                f"{wrong[0]} = {values[wrong[0]]} must be a single number; record components "
                "under names of their own"
            )
        self.names = self.names or tuple(values)
        self._rows.append({name: float(values[name]) for name in self.names})

    def __len__(self) -> int:
        return len(self._rows)

    def __getitem__(self, name: str) -> npt.NDArray[np.float64]:
        if name not in self.names:
            raise KeyError(f"nothing is recorded as '{name}'; there are {', '.join(self.names)}")
        return np.array([row[name] for row in self._rows])

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write a table as .csv or .json; see `study.write_table`. Collective."""
        write_table(self._rows, path, self._comm)
