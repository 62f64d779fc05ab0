"""PETSc options of one problem, separate from the options of other problems."""

from __future__ import annotations

import itertools
import sys
import weakref
from collections.abc import Mapping
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

from dolfinmpm._platform.argumentchecks import nearest
from dolfinmpm._platform.compat import option_was_read
from dolfinmpm._platform.errors import UnreadOptionWarning, warn

__all__ = ["Options"]

_numbers = itertools.count(1)
_of_problems: set[str] = set()
# Common options, to suggest a correct spelling
_COMMON = (
    "ksp_atol", "ksp_converged_reason", "ksp_gmres_restart", "ksp_max_it", "ksp_monitor",
    "ksp_rtol", "ksp_type", "ksp_view", "mat_mumps_icntl_14", "pc_factor_levels",
    "pc_factor_mat_ordering_type", "pc_factor_mat_solver_type", "pc_gamg_threshold",
    "pc_hypre_type", "pc_type", "snes_converged_reason", "snes_linesearch_type", "snes_max_it",
    "snes_monitor", "snes_rtol",
)  # fmt: skip


class Options:
    """Options under a unique prefix of one problem.

    Three sources give options. A later source overrides an earlier one: the arguments of the
    problem; PETSc's database under the common prefix; the command line under the common prefix,
    such as `python3 case.py -mpm_ksp_type cg`. The options are removed from the database when
    the problem is deleted.

    Args:
        owner: The problem.
        common: Common prefix of all problems.
        given: Options of this problem, without prefix; a flag has the value None.

    Attributes:
        prefix: The prefix of this problem.
        names: Names of the options that the user has set, in small letters.
        unread: Options of this problem that may not have been read by a solver.
    """

    def __init__(self, owner: Any, common: str, given: Mapping[str, Any]):
        self.prefix = f"{common}{next(_numbers)}_"
        database = PETSc.Options()
        values = dict(given)
        for name, value in database.getAll().items():
            of_other = any(name.startswith(prefix) for prefix in _of_problems)
            if name.startswith(common) and not of_other:
                values[name.removeprefix(common)] = value
        values |= _from_command_line(common)
        for name, value in values.items():
            database[self.prefix + name] = value
        self.names = frozenset(name.lower() for name in values)
        self._suggested: set[str] = set()
        self.unread = dict(given)
        _of_problems.add(self.prefix)
        weakref.finalize(owner, _remove, self.prefix)

    def get(self, name: str) -> str | None:
        """The user's value of an option, or None."""
        known = name in self.names
        return PETSc.Options().getString(self.prefix + name, "") or None if known else None

    def warn_of_unread(self, comm: MPI.Comm) -> None:
        """Warn once of options of the problem that no solver has read after a solution.

        Args:
            comm: Communicator of the problem.
        """
        given, self.unread = self.unread, {}
        for name, value in given.items():
            if option_was_read(self.prefix + name):
                continue
            hint = nearest(name, _COMMON, "'", 0.8)
            warn(
                comm,
                f"petsc_options gives {name} = {value!r}, and nothing that solves this problem has "
                f"read it{hint}",
                UnreadOptionWarning,
            )

    def mentions(self, start: str) -> bool:
        """Whether the user has set an option with a name that begins with `start`."""
        return any(name.startswith(start) for name in self.names)

    def suggest(self, values: Mapping[str, Any]) -> None:
        """Set default options, unless the user has set them. They replace earlier defaults."""
        database = PETSc.Options()
        for name in self._suggested:
            database.delValue(self.prefix + name)
        self._suggested = set()
        chosen = {name for name in values if name not in self.names}
        for name in chosen:
            database[self.prefix + name] = values[name]
        self._suggested = chosen


def _from_command_line(common: str) -> dict[str, str | None]:
    """Options on the command line, which petsc4py does not read when DOLFINx imports it."""
    found: dict[str, str | None] = {}
    words = sys.argv[1:]
    for word, after in itertools.zip_longest(words, words[1:], fillvalue="-"):
        if word.startswith(f"-{common}"):
            number = after.lstrip("-").replace(".", "", 1)[:1].isdigit()
            valued = not after.startswith("-") or number
            found[word.removeprefix(f"-{common}")] = after if valued else None
    return found


def _remove(prefix: str) -> None:
    """Remove a problem's options from the database."""
    _of_problems.discard(prefix)
    if PETSc.Sys.isFinalized():
        return
    database = PETSc.Options()
    for name in database.getAll():
        if name.startswith(prefix):
            database.delValue(name)
