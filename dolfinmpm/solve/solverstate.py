"""State of the solver of implicit steps, so that a restarted run gives the same figures.

Most of this state changes only the last bits of results. For example, the couplings kept by the
matrix decide the order of its factorisation.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from dolfinmpm.assembly.state import Local
from dolfinmpm.cut.pattern import KeptCouplings
from dolfinmpm.solve.linearsolver import WORKSPACE

__all__ = ["SolverState"]


class SolverState:
    """Share of the next step, line search, workspace, first guess and couplings of a problem.

    Args:
        problem: The problem, with Newton's method.
    """

    def __init__(self, problem: Any):
        self._problem = problem

    def state(self) -> dict[str, Any]:
        """The state, by name; see `dolfinmpm.assembly.state`."""
        problem, newton = self._problem, self._problem.newton
        found: dict[str, Any] = {
            "share": problem.share,
            "search": newton.search if newton.searches else None,
            "workspace": newton.linear.mumps.get(WORKSPACE),
        }
        if problem.here is not None:
            kept = KeptCouplings.of(problem.here)
            for name in ("active", "rows", "columns"):
                found[name] = Local(getattr(kept, name))
        return found | {name: Local(values) for name, values in newton.guess.state().items()}

    def set_state(self, values: Mapping[str, Any]) -> None:
        """Restore a state returned by `state`, and discard later data. Collective."""
        problem, newton = self._problem, self._problem.newton
        newton.linear.forget()
        problem.share = values["share"]
        if newton.searches and values["search"]:
            newton.search = values["search"]
        if values["workspace"]:
            newton.linear.mumps[WORKSPACE] = values["workspace"]
        local = {name: one.values for name, one in values.items() if isinstance(one, Local)}
        newton.guess.set_state(local, problem.points.partition)
        for space in problem.form.spaces:
            space.increment.x.array[:] = 0.0
        problem.kept = None
        if "active" in local:
            problem.kept = KeptCouplings(local["active"], local["rows"], local["columns"])
