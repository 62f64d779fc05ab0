"""The state of a problem, kept in memory and put back: what is tried from it leaves no trace."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from dolfinmpm.solve.problem import Problem

__all__ = ["KeptState"]

Arrays = dict[str, npt.NDArray[Any]]


class KeptState:
    """What a problem, its points, boundaries and rigid bodies are now. Collective.

    Args:
        problem: The problem, between steps.
    """

    def __init__(self, problem: Problem):
        self._problem, points = problem, problem.points
        self._fields: Arrays = {name: points.fields.read(name).copy() for name in points.fields}
        self._of_markers = [set(markers.fields) for markers in self._markers]
        self._partition = points.partition
        self._state = problem.state()
        self._history = list(problem.history)
        # what the user has set since the last step
        self._set = [(item, np.array(_array(item))) for item in problem.loads.items]
        self._set += [(u, u.x.array.copy()) for u in self._increments]
        self._dt = float(points.dt.value)

    @property
    def _markers(self) -> list[Any]:
        return [of.boundary.markers for of in self._problem.form.boundaries]

    @property
    def _increments(self) -> list[Any]:
        return [space.increment for space in self._problem.form.spaces]

    def put(self) -> None:
        """Put all back as it was, points on the ranks that had them. Collective."""
        problem, points = self._problem, self._problem.points
        for name in [*points.fields]:
            if name not in self._fields:
                del points.fields[name]
        for name, values in self._fields.items():
            points.fields[name] = values.copy()
        points.partition = self._partition
        points.recount()
        for markers, names in zip(self._markers, self._of_markers):
            for name in [*markers.fields]:
                if name not in names:
                    del markers.fields[name]
        problem.set_state(self._state)
        problem.history[:] = self._history
        for item, values in self._set:
            _array(item)[...] = values
        points.dt.value = self._dt


def _array(item: Any) -> npt.NDArray[np.float64]:
    """The numbers of a constant or a function of DOLFINx."""
    values: npt.NDArray[np.float64] = item.x.array if hasattr(item, "x") else item.value
    return values
