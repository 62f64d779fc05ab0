"""A run of an example, and runs at neighbouring parameters that follow it step by step."""

from __future__ import annotations

import itertools
import time
import warnings
from collections.abc import Callable, Mapping, Sequence

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm._platform.argumentchecks import shown
from dolfinmpm._platform.collective import check_same_call
from dolfinmpm._platform.errors import DifferentProblemWarning, ParameterError, call_together
from dolfinmpm.kinematics.footing import motions_under_footings
from dolfinmpm.materials.umat import UMAT
from dolfinmpm.solve.arclength import ArcLength
from dolfinmpm.solve.quasistatic import QuasiStatic
from dolfinmpm.study.branches import Events, Marks, RunState, differences, has_mirror, mirror
from dolfinmpm.study.scenerun import Scene, built, figure
from dolfinmpm.study.tape import Reader, Tape, follow

__all__ = ["FollowedRun", "FollowingRuns"]

Array = npt.NDArray[np.float64]

# Share of the forces that curvature leaves at the perturbation ε, as a multiple of ε, and its bound
_CURVED, _EVEN = 10.0, 1e-5
# Relative difference of figures on two ranks that is rounding
_ROUNDING = 1e-9
_UNCONVERGED = (
    "forces remain that the tangent does not remove (it may not be the derivative of the forces, "
    "or they are rounded, as those of a stiff footing), so that derivatives may be wrong"
)
# The force of a `RigidFooting` is its stiffness times a gap, which is the difference of two motions
# that are some 10⁴ times as large: it has 11 digits. Where a UMAT chooses substeps by an error, its
# stress jumps by some 1e-7 from one number of substeps to the next, which nobody can tell.
_FOOTING, _UMAT = 1e-5, 1e-4


class FollowedRun:
    """One run: that at the parameters, or one at perturbed parameters.

    Args:
        scene: The example.
        parameters: Its parameters.
        quiet: Whether a state that it loads may be one of other parameters without a warning.
    """

    def __init__(self, scene: Scene, parameters: Mapping[str, float], quiet: bool = False):
        with warnings.catch_warnings():
            if quiet:
                warnings.simplefilter("ignore", DifferentProblemWarning)
            run = built(scene, dict(parameters))
        self.run, self.problems = run, run.problems
        for problem in self.problems:
            if problem.history and not run.given:
                raise ParameterError(
                    f"the scene has taken {len(problem.history)} steps before its run: give them "
                    "among the steps of study.Run, so that derivatives follow them; or, if their "
                    "state is a given one that no parameter changes, such as one that "
                    "problem.load has read, say study.Run(..., given=True)"
                )
        self.marks = Marks(self.problems)
        self.taken = 0
        self._steps = iter(run.steps)

    def refuse_shared(self, other: FollowedRun, name: str) -> None:
        """Raise ParameterError if another run steps the same points or rigid bodies.

        Args:
            other: A run at another value of a parameter.
            name: The parameter.
        """
        for one, two in itertools.product(self.problems, other.problems):
            bodies = [body.name for body in one.bodies.all if body in two.bodies.all]
            if bodies or one.points is two.points:
                what = f"the rigid body '{bodies[0]}'" if bodies else "the material points"
                raise ParameterError(
                    f"the scene returns the same object for {what} at two values of {name}, and "
                    "each run would move those of the other: make grid, points, bodies and problem "
                    "within the function scene"
                )

    @property
    def comm(self) -> MPI.Intracomm:
        """Communicator of the points."""
        return self.problems[0].comm

    @property
    def needs_both(self) -> bool:
        """Whether a derivative needs runs on both sides from the first step on.

        Near the limit points of a path, second derivatives are large. And steps of an iterator
        cannot be left out by a run that begins later.
        """
        paths = any(isinstance(problem, ArcLength) for problem in self.problems)
        return paths or self.rough is not None or not isinstance(self.run.steps, Sequence)

    @property
    def rough(self) -> float | None:
        """Perturbation, as a share, above the roughness of the figures; None if they are smooth."""
        forms = [problem.form for problem in self.problems]
        if any(isinstance(law.law, UMAT) for form in forms for law in form.parts.declarations):
            return _UMAT
        return _FOOTING if any(motions_under_footings(form.given) for form in forms) else None

    def leave_out(self, steps: int) -> None:
        """Leave out the next steps."""
        for _ in range(steps):
            next(self._steps)
        self.taken += steps

    def advance(self) -> bool:
        """Take the next step; returns whether there was one. Collective."""
        self.marks.begin()
        item = next(self._steps, self)
        if item is not self and callable(item):
            item()
        self.taken += 1
        return item is not self

    def has_more(self) -> bool:
        """Whether there is another step."""
        return next(self._steps, self) is not self

    def measure(self) -> dict[str, Array]:
        """The figures in the present state. Collective.

        Raises:
            ParameterError: A figure is no number, or differs between ranks.
        """
        given = {name: get() for name, get in self.run.measured.items()}

        def checked() -> dict[str, Array]:
            return {name: figure(f"measured['{name}']", value) for name, value in given.items()}

        # a rank whose figure has failed does not come, which this barrier tells
        check_same_call(self.comm, "the figures of study.Run", names=list(given))
        found = call_together(self.comm, checked)
        if self.comm.size > 1:
            first = self.comm.bcast(found)
            call_together(self.comm, lambda: _check_equal(found, first, self.comm.rank))
        return found


def _check_equal(figures: Mapping[str, Array], first: Mapping[str, Array], rank: int) -> None:
    """Raise ParameterError unless figures are those of rank 0, up to rounding."""
    for name, value in figures.items():
        wanted = first.get(name, np.empty((0,)))
        size = _ROUNDING * np.abs(wanted).max(initial=0.0)
        if value.shape != wanted.shape or not np.allclose(
            value, wanted, rtol=_ROUNDING, atol=size, equal_nan=True
        ):
            raise ParameterError(
                f"measured['{name}'] is {shown(wanted)} on rank 0 and {shown(value)} on rank "
                f"{rank}: a figure is equal on all ranks; a sum over points goes over all ranks "
                "by points.comm.allreduce"
            )


class FollowingRuns:
    """A run at m + ε Δm that follows the run at m, and one at m − ε Δm, if need be.

    The second run begins where the first one takes another way than the run at m.

    Args:
        make: Function of a sign that returns a run at m ± ε Δm.
        name: The parameter.
        epsilon: The perturbation ε.
        both: Whether both runs begin at once.
        tape: Solutions of the run at m.

    Attributes:
        name, epsilon: The arguments.
        members, readers: The runs, and their readers of the tape.
        moved: Largest change of a position on this rank by the perturbation (m), or ε times the
            largest displacement, if this is larger.
    """

    def __init__(
        self, make: Callable[[int], FollowedRun], name: str, epsilon: float, both: bool, tape: Tape
    ):
        started = time.perf_counter()
        self.name, self.epsilon = name, epsilon
        self._make, self._tape = make, tape
        self._even = min(_CURVED * epsilon, _EVEN) if both else 0.0
        self.moved = 0.0
        self.members: list[FollowedRun] = []
        self.readers: list[Reader] = []
        # number of the run that could not be set to the mirror image of the other one
        self.out: int | None = None
        for sign in (1, -1)[: 1 + both]:
            self._add(sign)
        # what was met → numbers of the steps
        self.notes: dict[str, list[int]] = {}
        self.seconds = time.perf_counter() - started

    def _add(self, sign: int) -> None:
        """Let another run follow the tape."""
        member, reader = self._make(sign), Reader(self._tape, self, self._even)
        for problem in member.problems:
            if isinstance(problem, QuasiStatic):
                follow(problem, reader)
        self.members.append(member)
        self.readers.append(reader)

    def go_on(self, members: int, steps: int, out: int | None) -> None:
        """Have as many runs as a checkpoint, and leave out the steps before it."""
        self.out = out
        if members > len(self.members):
            self._add(-1)
        for member in self.members:
            member.leave_out(steps)

    @property
    def may_begin(self) -> bool:
        """Whether the second run may begin in the next step."""
        return len(self.members) == 1 and isinstance(self.members[0].run.steps, Sequence)

    def told(self) -> list[str]:
        """Its notes, in words."""
        return [
            f"{self.name}, step {', '.join(map(str, at[:10]))}: {what} within the perturbation"
            for what, at in self.notes.items()
        ]

    def advance(
        self, base: FollowedRun, before: RunState | None, marks: Events,
        middle: Mapping[str, Array],
    ) -> dict[str, Array]:  # fmt: skip
        """Follow a step; returns the derivatives of the figures. Collective.

        Args:
            base: The run at m, after the step.
            before: Its state before the step; None if no second run may begin.
            marks: Events of its step.
            middle: Its figures after the step.
        """
        started = time.perf_counter()
        before_step = RunState(self.members[0].problems) if self.may_begin else None
        leaves = [self._follow(base, k, marks) for k in range(len(self.members))]
        if before_step is not None and before is not None and leaves[0]:
            self._add(-1)
            self.members[1].leave_out(base.taken - 1)
            self._mirror(before, before_step, 1)
            leaves.append(self._follow(base, 1, marks))
        self._note_motion(base)
        derivatives = self._differences(base, leaves, middle)
        self.seconds += time.perf_counter() - started
        return derivatives

    def _note_motion(self, base: FollowedRun) -> None:
        """Update the largest change of a position."""
        for problem, other in zip(base.problems, self.members[0].problems):
            read, read_other = problem.points.fields.read, other.points.fields.read
            way = np.abs(read("x") - read("x0")).max(initial=0.0)
            self.moved = max(self.moved, self.epsilon * float(way))
            if np.array_equal(read("id"), read_other("id")):
                change = np.abs(read_other("x") - read("x")).max(initial=0.0)
                self.moved = max(self.moved, float(change))

    def _follow(self, base: FollowedRun, k: int, marks: Events) -> list[str]:
        """Let a run follow a step; returns what it does otherwise than the run at m. Collective."""
        member, reader = self.members[k], self.readers[k]
        reader.begin()
        if not member.advance():
            raise ParameterError(
                f"the scene takes fewer steps at another {self.name}: let the number of steps be "
                "the same for all parameters"
            )
        found = differences(base.comm, marks, member.marks.end())
        return [*reader.off, *(f"{n} {what}" for what, n in found.items())]

    def finish(self) -> None:
        """Raise ParameterError if a run has more steps than the run at m."""
        if any(member.has_more() for member in self.members):
            raise ParameterError(
                f"the scene takes more steps at another {self.name}: let the number of steps be "
                "the same for all parameters"
            )

    def _measured(self, member: FollowedRun, middle: Mapping[str, Array]) -> dict[str, Array]:
        """The figures of a run, which are those of the run at m. Collective."""
        found = member.measure()
        if found.keys() != middle.keys():
            raise ParameterError(
                f"measured has {', '.join(middle)}, and {', '.join(found)} at another {self.name}: "
                "let the figures be the same for all parameters"
            )
        for name, value in found.items():
            if value.shape != middle[name].shape:
                raise ParameterError(
                    f"measured['{name}'] has the shape {middle[name].shape}, and {value.shape} at "
                    f"another {self.name}: let it be the same for all parameters"
                )
        return found

    def _differences(
        self, base: FollowedRun, leaves: Sequence[Sequence[str]], middle: Mapping[str, Array]
    ) -> dict[str, Array]:
        """Differences of the figures over ε, one-sided where one run has left. Collective."""
        told = [reasons for k, reasons in enumerate(leaves) if k != self.out]
        for reason in {reason for reasons in told for reason in reasons}:
            self.notes.setdefault(reason, []).append(base.taken)
        # beside a kink, the tangent of the run at m is not that of another run
        if not any(leaves) and not all(reader.converged for reader in self.readers):
            self.notes.setdefault(_UNCONVERGED, []).append(base.taken)
        plus, *others = (self._measured(member, middle) for member in self.members)
        if not others:
            return {k: np.asarray((plus[k] - middle[k]) / self.epsilon) for k in plus}
        minus, left = others[0], [bool(reasons) for reasons in leaves]
        if self.out is not None:
            left = [k == self.out for k in (0, 1)]
        if left[0] == left[1]:
            return {k: np.asarray((plus[k] - minus[k]) / (2 * self.epsilon)) for k in plus}
        good, bad = left.index(False), left.index(True)
        sign, side = (-1.0, minus) if left[0] else (1.0, plus)
        if not self._mirror(RunState(base.problems), RunState(self.members[good].problems), bad):
            self.notes.setdefault("points are on other ranks", []).append(base.taken)
        return {k: np.asarray(sign * (side[k] - middle[k]) / self.epsilon) for k in side}

    def _mirror(self, base: RunState, good: RunState, bad: int) -> bool:
        """Set a run to the mirror image of the other one, if there is any. Collective.

        Else it gets the state of the run at m, and counts as one that has left the way.

        Args:
            base: State of the run at m.
            good: State of the other run.
            bad: Number of the run that is set.

        Returns:
            Whether its state could be set; see `mirror`.
        """
        able = has_mirror(base, good)
        self.out = None if able else bad
        return mirror(base, good if able else base, self.members[bad].problems)
