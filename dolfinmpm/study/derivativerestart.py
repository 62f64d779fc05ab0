"""Checkpoints of a run and of the runs that follow it: derivatives go on after an interruption."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm._platform.argumentchecks import whole
from dolfinmpm._platform.errors import CheckpointError, ParameterError, call_on_root
from dolfinmpm._platform.filepaths import file_path
from dolfinmpm.io.rowfile import plain, restored
from dolfinmpm.io.vtkfiles import replace_file
from dolfinmpm.solve.problem import Problem
from dolfinmpm.study.followingruns import FollowedRun, FollowingRuns

__all__ = ["Savepoints"]

Array = npt.NDArray[np.float64]
_INDEX = "derivatives.json"


class Savepoints:
    """Checkpoints in one folder; the last complete set counts. Collective.

    Each problem of each run has an archive of its own. The index is written after them, in one
    move, and the archives of the set before are removed after it. So a run that is killed at any
    time leaves a complete set.

    Args:
        folder: The folder; it is created.
        every: Number of steps from one set to the next.
        base: The run.
        sets: The runs that follow, for each perturbation and parameter.
        made_by: What the numbers belong to: parameters, sizes, perturbations.

    Raises:
        ParameterError: The folder is no path, `every` is no whole number from 1, or the steps are
            an iterator, of which none can be left out.
        OSError: The folder cannot be made.
    """

    def __init__(
        self, folder: str | os.PathLike[str], every: int, base: FollowedRun,
        sets: Sequence[Sequence[FollowingRuns]], made_by: dict[str, Any],
    ):  # fmt: skip
        self._folder = file_path("restart", folder)
        self._every = whole("every", every, 1)
        if not isinstance(base.run.steps, Sequence):
            raise ParameterError(
                f"restart = '{self._folder}' goes on after the steps that have been taken, and an "
                "iterator can leave out none: give study.Run a list of steps"
            )
        self._base, self._sets = base, sets
        # as JSON gives it back
        self._made_by = json.loads(json.dumps(made_by))
        call_on_root(base.comm, lambda: self._folder.mkdir(parents=True, exist_ok=True))

    def _largest(self, value: float) -> float:
        return float(self._base.comm.allreduce(value, op=MPI.MAX))

    def _archives(self, taken: int) -> list[tuple[Problem, Path]]:
        """All problems with the paths of their archives after some steps."""
        runs = [self._base, *(m for pairs in self._sets for pair in pairs for m in pair.members)]
        return [
            (problem, self._folder / f"step{taken}_run{k}_problem{p}.npz")
            for k, run in enumerate(runs)
            for p, problem in enumerate(run.problems)
        ]

    def write(self, figures: Any, found: Any) -> None:
        """Write a set if one is due. Collective.

        Args:
            figures: Name → values after each step.
            found: Derivatives, for each perturbation: name → parameter → values after each step.

        Raises:
            CheckpointError, OSError: A file cannot be written.
        """
        taken = self._base.taken
        if taken % self._every:
            return
        archives = self._archives(taken)
        for problem, path in archives:
            problem.save(path)
        index = {
            "made_by": self._made_by,
            "taken": taken,
            "members": [[len(pair.members) for pair in pairs] for pairs in self._sets],
            "out": [[pair.out for pair in pairs] for pairs in self._sets],
            "moved": [[self._largest(pair.moved) for pair in pairs] for pairs in self._sets],
            "notes": [[pair.notes for pair in pairs] for pairs in self._sets],
            "figures": figures,
            "derivatives": found,
        }

        def replace() -> None:
            replace_file(self._folder / _INDEX, json.dumps(index, default=plain))
            for old in set(self._folder.glob("step*_run*_problem*.npz")) - {p for _, p in archives}:
                old.unlink()

        call_on_root(self._base.comm, replace)

    def read(self) -> tuple[Any, Any] | None:
        """Set all runs to the last set, and return its figures and derivatives. Collective.

        Returns:
            Figures and derivatives as `write` takes them; None if the folder has no set.

        Raises:
            CheckpointError: A file is damaged.
            ParameterError: The set belongs to other parameters, perturbations or more steps.
        """
        index = call_on_root(self._base.comm, self._index)
        if index is None:
            return None
        for what, mine in self._made_by.items():
            if index["made_by"].get(what) != mine:
                raise ParameterError(
                    f"restart = '{self._folder}' has a run with {what} = "
                    f"{index['made_by'].get(what)}, and this one has {mine}: give a folder of its "
                    "own, or remove the old one"
                )
        taken, steps = index["taken"], len(self._base.run.steps)  # type: ignore[arg-type]
        if taken > steps:
            raise ParameterError(
                f"restart = '{self._folder}' has {taken} steps, and this run takes {steps}: give a "
                "folder of its own, or remove the old one"
            )
        kept = (index[name] for name in ("members", "out", "notes", "moved"))
        for pairs, *of_pairs in zip(self._sets, *kept):
            for pair, number, one, known, moved in zip(pairs, *of_pairs):
                pair.moved = moved
                pair.notes = {what: list(at) for what, at in known.items()}
                pair.go_on(number, taken, one)
        self._base.leave_out(taken)
        for problem, path in self._archives(taken):
            problem.load(path)
        return index["figures"], index["derivatives"]

    def _index(self) -> Any:
        path = self._folder / _INDEX
        if not path.exists():
            return None
        try:
            return json.loads(path.read_text(encoding="utf-8"), object_hook=restored)
        except ValueError as cause:
            raise CheckpointError(
                f"'{path}' is damaged ({cause}): remove the folder, and begin anew"
            ) from cause
