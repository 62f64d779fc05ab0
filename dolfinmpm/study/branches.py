"""Runs at neighbouring parameters that yield or touch otherwise, and the mirror image of a run.

A derivative follows from runs at m + ε Δm, or m ± ε Δm, that take the same way: the same cells are
active, the same points yield, touch and slip. If one run leaves the way of the run at m, the other
run and the run at m give a one-sided difference. The run that left is then set to the mirror image
of the other one, s(−) = 2 s − s(+), and goes on from there. A second run that does not exist yet
begins in this step, from the mirror image of the first run. Contacts that just touch may have no
mirror image. Then differences stay one-sided until they have one.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import zip_longest
from typing import Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm.assembly.state import HasState, Local, OfCells, gathered, given_back
from dolfinmpm.body.pointchecks import astray
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.dynamics.explicit import Explicit
from dolfinmpm.kinematics.walls import Wall
from dolfinmpm.solve.problem import Problem
from dolfinmpm.solve.quasistatic import QuasiStatic

__all__ = ["Events", "Marks", "RunState", "has_mirror", "mirror", "points_of"]

Array = npt.NDArray[Any]
# words for what happens → for each set of points, or problem, sorted sets of numbers of its points
# or nodes
Events = dict[str, list[list[Array]]]

_YIELD = "points start or stop to yield"
_CROSS = "points cross a cell"
# endings of names of fields whose sign tells whether a contact is closed
_NOT_NEGATIVE = ("_normal_force", "_stiffness", "_overlap")
_WALL = "markers of walls begin or end to touch or slip"


def points_of(problems: Sequence[Problem]) -> list[MaterialPoints]:
    """All points and markers of some problems, each once."""
    markers = [[of.boundary.markers for of in p.form.boundaries] for p in problems]
    return list(dict.fromkeys(x for p, own in zip(problems, markers) for x in (p.points, *own)))


class Marks:
    """Which points of a run yield or cross a cell, and where explicit steps have kinks, in a step.

    Args:
        problems: The problems of the run.
    """

    def __init__(self, problems: Sequence[Problem]):
        self._problems = problems
        self._points = list(dict.fromkeys(problem.points for problem in problems))
        # functions with a kink at the border of cells
        spaces = [space for problem in problems for space in problem.form.spaces]
        self._kinks = any(not s.basis.averaged and s.basis.continuity == 0 for s in spaces)
        bounds = [of for problem in problems for of in problem.form.boundaries]
        self._walls = [one for of in bounds for one in of.conditions if isinstance(one, Wall)]
        self._before: list[dict[str, Array]] = []
        watched = [p.watch_kinks() for p in problems if isinstance(p, Explicit)]
        self._watched = [kinks for kinks in watched if kinks is not None]

    def _names(self, points: MaterialPoints) -> list[str]:
        """Names of the internal variables of the laws."""
        laws = [
            d.law for p in self._problems if p.points is points for d in p.form.parts.declarations
        ]
        names = {name for law in laws for name in getattr(law, "internal", ())}
        return sorted(name for name in names if name in points.fields)

    def begin(self) -> None:
        """Keep the state at the start of a step."""
        self._before = [
            {
                name: points.fields.read(name).copy()
                for name in ("id", "cell", *self._names(points))
                if name in points.fields
            }
            for points in self._points
        ]
        for kinks in self._watched:
            kinks.begin()

    def end(self) -> Events:
        """What has happened in the step."""
        found: Events = {_YIELD: []}
        if self._kinks:
            found[_CROSS] = []
        for kinks in self._watched:
            for what, sets in kinks.sets.items():
                found.setdefault(what, []).append(sets)
        if self._walls:
            found[_WALL] = [
                [np.sort(wall.boundary.markers.fields.read("id")[at]) for at in wall.states()]
                for wall in self._walls
            ]
        for points, before in zip(self._points, self._before):
            ids, first = points.fields.read("id"), before["id"]
            # points that changed rank are left out
            at = np.flatnonzero(np.isin(ids, first))
            order = np.argsort(first)
            rows = order[np.searchsorted(first[order], ids[at])]
            changed = {
                name: np.any(
                    points.fields.read(name)[at] != old[rows], axis=tuple(range(1, old.ndim))
                )
                for name, old in before.items()
            }
            names = [name for name in self._names(points) if name in before]
            found[_YIELD].append([np.sort(ids[at][changed[name]]) for name in names])
            if self._kinks:
                # points that come from another rank have crossed a cell
                crossed = np.ones(len(ids), bool)
                crossed[at] = changed["cell"]
                found[_CROSS].append([np.sort(ids[crossed])])
        return found


def differences(comm: MPI.Intracomm, a: Events, b: Events) -> dict[str, int]:
    """Number of points or nodes in which two results of `Marks.end` differ. Collective.

    Returns:
        Words for what differs → number, where there is a difference.
    """
    names = sorted({*a, *b})
    counts = [sum(_apart(p, q) for p, q in zip(a.get(name, ()), b.get(name, ()))) for name in names]
    sums = comm.allreduce(np.array(counts, np.int64), op=MPI.SUM)
    return {name: int(n) for name, n in zip(names, sums) if n}


def _apart(a: Sequence[Array], b: Sequence[Array]) -> int:
    """Number of points or nodes that are in a set of one list, and not in that of the other."""
    pairs = zip_longest(a, b, fillvalue=np.empty(0, np.int64))
    apart = [np.setxor1d(p, q) for p, q in pairs if not np.array_equal(p, q)]
    return np.unique(np.concatenate(apart)).size if apart else 0


class RunState:
    """A copy of the state of a run, without what its solvers have learnt. Collective.

    Args:
        problems: The problems of the run.

    Attributes:
        points: Fields of each set of points and markers by name, and the partition of the grid.
        kept: Other values that go from step to step, by name, for each problem.
        shares: Share of the next step at which a problem begins its substeps.
        comm: Communicator of the points.
    """

    def __init__(self, problems: Sequence[Problem]):
        self.comm = problems[0].comm
        self.points = [
            ({name: p.fields.read(name).copy() for name in p.fields}, p.partition)
            for p in points_of(problems)
        ]
        self.kept = [gathered(_keeping(problem)) for problem in problems]
        self.shares = [getattr(problem, "share", 1.0) for problem in problems]


def _keeping(problem: Problem) -> list[tuple[str, HasState]]:
    """What has a state, without the solver."""
    return [(name, one) for name, one in problem.keeping() if name != "solver"]


def has_mirror(base: RunState, good: RunState) -> bool:
    """Whether the mirror image of a run has the contacts of a third run. Collective.

    A contact that just touches may have a negative force in the mirror image. A law of contact
    would take it as open.

    Args:
        base: The run in the middle.
        good: The run that is mirrored.
    """
    able = True
    for (a, _), (b, _) in zip(base.points, good.points):
        for name in a:
            if name.endswith(_NOT_NEGATIVE) and name in b and a[name].shape == b[name].shape:
                closed, image = a[name] > 0.0, _mirrored(a[name], b[name]) > 0.0
                able &= np.array_equal(closed, b[name] > 0.0) and np.array_equal(closed, image)
    return bool(base.comm.allreduce(able, op=MPI.LAND))


def mirror(base: RunState, good: RunState, bad: Sequence[Problem]) -> bool:
    """Set the state of a run to the mirror image of another run about a third run. Collective.

    Args:
        base: The run in the middle.
        good: The run that is mirrored.
        bad: The problems that get the mirror image.

    Returns:
        Whether it could be done: points that have gone to different ranks cannot be mirrored.
    """
    alike = all(
        np.array_equal(a["id"], b["id"]) for (a, _), (b, _) in zip(base.points, good.points)
    )
    if not bad[0].comm.allreduce(alike, op=MPI.LAND):
        return False
    for (a, partition), (b, _), points in zip(base.points, good.points, points_of(bad)):
        for name in a:
            if name in b:
                points.fields[name] = _mirrored(a[name], b[name])
        points.partition = partition
        points.recount()
        # the mirror image of a point beside a grid line may be in another cell
        if bad[0].comm.allreduce(astray(points) is not None, op=MPI.LOR):
            points.locate()
    for problem, known, more, share in zip(bad, base.kept, good.kept, base.shares):
        given_back(_keeping(problem), {k: _mirrored(v, more.get(k, v)) for k, v in known.items()})
        problem.here = None
        if isinstance(problem, QuasiStatic):
            problem.share = share
    return True


def _mirrored(a: Any, b: Any) -> Any:
    """2 a − b of numbers and arrays of numbers; a of everything else."""
    if isinstance(a, (Local, OfCells)):
        return type(a)(_mirrored(a.values, b.values))
    if isinstance(a, float) and isinstance(b, float):
        return 2 * a - b
    if isinstance(a, np.ndarray) and a.dtype == np.float64 and np.shape(b) == a.shape:
        # values that are equal in both stay equal, also infinite ones
        return np.where(a == b, a, 2 * a - b)
    return a.copy() if isinstance(a, np.ndarray) else a
