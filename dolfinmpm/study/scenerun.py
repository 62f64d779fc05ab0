"""An example as a function of its parameters: a problem, its steps, and what is measured."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Iterable, Mapping, Sequence, Set
from dataclasses import dataclass
from typing import Any
from weakref import WeakSet

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm._platform.argumentchecks import (
    check_dictionary,
    check_function,
    check_kind,
    check_takes,
    coordinates,
    shown,
    truth,
)
from dolfinmpm._platform.errors import (
    DoubtfulInputWarning,
    ParameterError,
    UnknownNameError,
    call_together,
    raise_together,
    warn,
)
from dolfinmpm._platform.uncopied import Unchanged
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.solve.problem import Problem

__all__ = ["Run", "Scene", "built", "figure", "last_number", "last_value", "take_steps"]

# Points of all runs that scenes have returned
_RETURNED: WeakSet[MaterialPoints] = WeakSet()
Scene = Callable[[dict[str, float]], "Run"]
# What has items that are no steps
_NO_STEPS = (str, bytes, Mapping, Set, np.ndarray)

# Likeness of two names of parameters that may be one, such as E and E0
_LIKE = 0.6


@dataclass
class Run(Unchanged):
    """An example at given parameters, ready for its first step.

    Attributes:
        problem: The problem, or problems that take the steps.
        steps: One function per step. A function sets the loads, and calls `problem.step`. Or an
            iterator that takes a step each time it is asked for the next item.
        measured: Name → function that returns a figure after a step: a number, or an array of the
            same shape for all parameters, equal on all ranks.
        given: Whether the state before the first step is given, such as a state that
            `problem.load` has read. It does not depend on the parameters then.

    One step of a bar:

    >>> import dolfinmpm as mpm
    >>> from mpi4py import MPI
    >>> def scene(m):
    ...     grid = mpm.create_lattice(MPI.COMM_WORLD, [range(2), range(5)])
    ...     points = mpm.fill(grid, mpm.Box((0, 0), (1, 4)), per_cell=2, density=2000.0)
    ...     V = mpm.Space(grid, "gimp")
    ...     F = mpm.momentum(mpm.materials.Hencky(m["E"], 0.0), points, V.increment, V.test)
    ...     bcs = mpm.fixed(V, "bottom") + mpm.prescribed(V, "top", 1, increment=-0.01)
    ...     problem = mpm.QuasiStatic(F, V.increment, points, bcs)
    ...     stress = lambda: points["stress"][:, 1, 1].mean()
    ...     return mpm.study.Run(problem, [problem.step], {"stress": stress})
    >>> round(float(scene({"E": 1e6}).measured["stress"]()), 1)
    0.0
    """

    _live = frozenset({"problem", "steps", "measured", "given"})

    problem: Problem | Sequence[Problem]
    steps: Iterable[Any]
    measured: Mapping[str, Callable[[], npt.ArrayLike]]
    given: bool = False

    def __post_init__(self) -> None:
        several: list[Any] = [*self.problems]
        for problem in several or [None]:
            check_kind("problem", problem, Problem, "give a problem of dolfinmpm")
        truth("given", self.given)
        such = ' of functions, such as {"settlement": lambda: top.mean_displacement()[1]}'
        check_dictionary("measured", self.measured, such, some=True)
        for name, get in self.measured.items():
            check_function(f"measured['{name}']", get, "without arguments")
        if isinstance(self.steps, (list, tuple)):
            for step in self.steps:
                check_function("each of steps", step, "without arguments")
            if not self.steps:
                raise ParameterError("steps = [] has no step: derivatives are those of a run")
        elif not isinstance(self.steps, Iterable) or isinstance(self.steps, _NO_STEPS):
            raise ParameterError(
                f"steps = {shown(self.steps)} must be a list of functions without arguments, such "
                "as [problem.step], or an iterator that takes a step for each item"
            )

    @property
    def problems(self) -> list[Problem]:
        """The problems, as a list."""
        several = isinstance(self.problem, (list, tuple))
        return list(self.problem) if several else [self.problem]  # type: ignore[list-item]


class _Parameters(dict[str, float]):
    """Parameters of a run, with a message where a scene asks for another one.

    Attributes:
        read: Names that the scene has asked for.
        absent: Names that it has asked for by `get`, and that are not there.
    """

    def __init__(self, given: Mapping[str, float]):
        super().__init__(given)
        self.read: set[str] = set()
        self.absent: set[str] = set()

    def __getitem__(self, name: str) -> float:
        self.read.add(name)
        return super().__getitem__(name)

    def get(self, name: str, default: Any = None) -> Any:
        (self.read if name in self else self.absent).add(name)
        return super().get(name, default)

    def warn_of_misspelt(self, comm: MPI.Intracomm) -> None:
        """Warn, before a run takes its time, of a parameter that the scene has by another name."""
        for name in [one for one in self.keys() if one not in self.read]:
            near = difflib.get_close_matches(name, sorted(self.absent), 1, _LIKE)
            if near:
                warn(
                    comm,
                    f"the study gives the scene the parameter '{name}', and the scene has not "
                    f"read it, but asked for '{near[0]}' with a default: it may be misspelt",
                    DoubtfulInputWarning,
                )

    def __missing__(self, name: str) -> float:
        # a KeyError too, so that a scene may catch it as that of any dictionary
        raise UnknownNameError(
            f"the scene asks for the parameter {shown(name)}, and those that the study gives it "
            f"are {', '.join(map(str, self)) or 'none'}: give it to the study, or take its value "
            f"in the scene by m.get({shown(name)}, value)"
        )


def _moved_before(points: MaterialPoints) -> ParameterError | None:
    """An error for points that a scene has returned before, and that have moved since, or None."""
    if points not in _RETURNED or not points["moved_under"].any():
        return None
    return ParameterError(
        f"the scene has returned the same {points.total} material points before, and they have "
        "moved since, so that this run would go on from the end of another one: make grid, points "
        "and problem within the function scene; or, if it sets their state, as problem.load does, "
        "say study.Run(..., given=True)"
    )


def built(scene: Callable[..., Any], *arguments: Any, limit: str | None = None) -> Run:
    """The run that a scene makes of its arguments.

    Args:
        scene: The example.
        arguments: Its arguments.
        limit: Name of a figure that it must have.

    Raises:
        ParameterError: The scene returns something else, such as None, or lacks the figure; or its
            points are those of an earlier run, and have moved.
    """
    check_takes("scene", scene, *arguments)
    given = [_Parameters(a) if isinstance(a, dict) else a for a in arguments]
    run = scene(*given)
    check_kind("the result of scene", run, Run, "return study.Run(problem, steps, measured)")
    for problem in run.problems:
        raise_together(problem.comm, None if run.given else _moved_before(problem.points))
        _RETURNED.add(problem.points)
    for one in given:
        if isinstance(one, _Parameters) and run.problems:
            one.warn_of_misspelt(run.problems[0].comm)
    if limit is not None and limit not in run.measured:
        raise ParameterError(
            f"limit = {shown(limit)} is no figure of the scene; its figures are "
            f"{', '.join(run.measured)}"
        )
    return run


def take_steps(run: Run) -> None:
    """Take all steps of a run. Collective."""
    for item in run.steps:
        if callable(item):
            item()


def figure(what: str, given: Any) -> npt.NDArray[np.float64]:
    """A figure as numbers.

    Args:
        what: Its name in messages.
        given: What its function has returned.

    Raises:
        ParameterError: It is None, which would become nan, or something else than numbers.
    """
    if given is None:
        raise ParameterError(f"{what} = None must be numbers: let its function return the figure")
    return coordinates(what, given)


def last_number(name: str, given: Any, m: Mapping[str, float]) -> float:
    """A figure after the last step as a number.

    Args:
        name: Name of the figure.
        given: What its function has returned.
        m: Parameters of the run, for the message.

    Raises:
        ParameterError: It is not one number, or NaN, which is neither below zero nor above.
    """
    values = figure(f"the figure '{name}'", given)
    if values.size != 1:
        raise ParameterError(
            f"the figure '{name}' has the shape {values.shape} at {dict(m)}, and a limit is one "
            "number: return the entry that counts, such as the least"
        )
    if np.isnan(values).any():
        raise ParameterError(f"the figure '{name}' is nan at {dict(m)}: return a number")
    return float(values.item())


def last_value(run: Run, name: str, m: Mapping[str, float]) -> float:
    """A figure of a run after its last step. Collective.

    Args:
        run: The run.
        name: Name of the figure.
        m: Parameters of the run, for the message.

    Raises:
        ParameterError: The figure is not a number.
    """
    given = run.measured[name]()
    return call_together(run.problems[0].comm, lambda: last_number(name, given, m))
