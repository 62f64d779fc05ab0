"""Derivatives of a run by its parameters, found together with the run."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm._platform.argumentchecks import (
    check_function,
    check_kind,
    coordinates,
    number,
    shown,
    truth,
)
from dolfinmpm._platform.errors import ParameterError
from dolfinmpm.solve.quasistatic import QuasiStatic
from dolfinmpm.study.branches import Marks, differences, mirror
from dolfinmpm.study.scenerun import Run, Scene
from dolfinmpm.study.tape import Reader, Tape, follow, record

__all__ = ["Derivatives", "differentiate", "sizes_of"]

Array = npt.NDArray[np.float64]
# name of a figure → parameter → values after each step
_Found = dict[str, dict[str, list[Array]]]

# Perturbation of a parameter as a share of its size, in central and in one-sided differences. Their
# rounding is 1e-16 over it. The third derivative counts with its square, the second with itself.
CENTRAL, ONE_SIDED = 1e-6, 3e-8
# Ratio of the second perturbation of an estimate to the first one, and the estimated error from
# which a derivative is doubtful
_SECOND, _DOUBTFUL = 8.0, 1e-3


@dataclass
class Derivatives:
    """Figures of a run, and their derivatives by its parameters.

    Attributes:
        parameters: The parameters.
        scales: Parameter → size Δm. The derivatives are Δm ∂/∂m: by ln m, unless `scales` was
            given to `differentiate`.
        figures: Name → values after each step, shape (steps, ...).
        derivatives: Name → parameter → Δm times the derivative after each step, the same shape.
        notes: What the derivatives have met, such as points that start to yield within the
            perturbation.
        errors: Parameter → estimated error: the largest difference of its derivatives with another
            perturbation, relative to the largest value. Empty where no estimate was made.
        seconds: Wall time of "run", and of each parameter by its name (s).

    The stress in a bar is proportional to Young's modulus:

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
    >>> found = mpm.study.differentiate(scene, {"E": 1e6})
    >>> (found.figures["stress"] / found.derivatives["stress"]["E"]).round(6).tolist()
    [1.0]
    """

    parameters: dict[str, float]
    scales: dict[str, float]
    figures: dict[str, Array]
    derivatives: dict[str, dict[str, Array]]
    notes: list[str] = field(default_factory=list)
    errors: dict[str, float] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)


class _Member:
    """One run: that at the parameters, or one at perturbed parameters.

    Args:
        scene: The example.
        parameters: Its parameters.
    """

    def __init__(self, scene: Scene, parameters: Mapping[str, float]):
        run = scene(dict(parameters))
        check_kind("the result of scene", run, Run, "return study.Run(problem, steps, measured)")
        self.run, self.problems = run, run.problems
        for problem in self.problems:
            if problem.history:
                raise ParameterError(
                    f"the scene has taken {len(problem.history)} steps before its run: give them "
                    "among the steps of study.Run, so that derivatives follow them"
                )
        self.marks = Marks(self.problems)
        self.taken = 0
        self._steps = iter(run.steps)

    @property
    def comm(self) -> MPI.Intracomm:
        return self.problems[0].comm

    def advance(self) -> bool:
        """Take the next step; returns whether there was one. Collective."""
        self.marks.begin()
        item = next(self._steps, self)
        if item is not self and callable(item):
            item()
        self.taken += 1
        return item is not self

    def measure(self) -> dict[str, Array]:
        """The figures in the present state. Collective."""
        return {
            name: coordinates(f"measured['{name}']", get())
            for name, get in self.run.measured.items()
        }


class _Pair:
    """Two runs at m ± ε Δm that follow the run at m, or one of them.

    Args:
        scene, parameters: The example, and its parameters.
        name: The parameter.
        scale: Its size Δm.
        epsilon: The perturbation ε.
        signs: Signs of the perturbations.
        tape: Solutions of the run at m.
    """

    def __init__(
        self, scene: Scene, parameters: Mapping[str, float], name: str, scale: float,
        epsilon: float, signs: Sequence[int], tape: Tape,
    ):  # fmt: skip
        started = time.perf_counter()
        self.name, self.epsilon = name, epsilon
        m = parameters[name]
        self.members: list[_Member] = []
        self.readers: list[Reader] = []
        for sign in signs:
            member = _Member(scene, {**parameters, name: m + sign * epsilon * scale})
            reader = Reader(tape, *self.readers)
            for problem in member.problems:
                if isinstance(problem, QuasiStatic):
                    follow(problem, reader)
            self.members.append(member)
            self.readers.append(reader)
        # what was met → numbers of the steps
        self.notes: dict[str, list[int]] = {}
        self.seconds = time.perf_counter() - started

    def told(self) -> list[str]:
        """Its notes, in words."""
        return [
            f"{self.name}, step {', '.join(map(str, at[:10]))}: {what} within the perturbation"
            for what, at in self.notes.items()
        ]

    def advance(self, base: _Member, marks: Mapping[str, Any]) -> dict[str, Array]:
        """Follow a step; returns the derivatives of the figures. Collective.

        Args:
            base: The run at m, after the step.
            marks: What has happened in its step.
        """
        started = time.perf_counter()
        leaves: list[list[str]] = []
        for member, reader in zip(self.members, self.readers):
            reader.begin()
            if not member.advance():
                raise ParameterError(
                    f"the scene takes fewer steps at another {self.name}: let the number of steps "
                    "be the same for all parameters"
                )
            found = differences(base.comm, marks, member.marks.end())
            leaves.append([*reader.off, *(f"{n} {what}" for what, n in found.items())])
        derivatives = self._differences(base, leaves)
        self.seconds += time.perf_counter() - started
        return derivatives

    def _differences(self, base: _Member, leaves: Sequence[Sequence[str]]) -> dict[str, Array]:
        """Differences of the figures over ε, one-sided where one run has left. Collective."""
        for reason in {reason for reasons in leaves for reason in reasons}:
            self.notes.setdefault(reason, []).append(base.taken)
        plus, *others = (member.measure() for member in self.members)
        middle = base.measure()
        for name, value in plus.items():
            if value.shape != middle[name].shape:
                raise ParameterError(
                    f"measured['{name}'] has the shape {middle[name].shape}, and {value.shape} at "
                    f"another {self.name}: let it be the same for all parameters"
                )
        if not others:
            return {k: np.asarray((plus[k] - middle[k]) / self.epsilon) for k in plus}
        minus, left = others[0], [bool(reasons) for reasons in leaves]
        if left[0] == left[1]:
            return {k: np.asarray((plus[k] - minus[k]) / (2 * self.epsilon)) for k in plus}
        good, bad = (self.members[k].problems for k in (left.index(False), left.index(True)))
        sign = -1.0 if left[0] else 1.0
        side = minus if left[0] else plus
        if not mirror(base.problems, good, bad):
            self.notes.setdefault("points are on other ranks", []).append(base.taken)
        return {k: np.asarray(sign * (side[k] - middle[k]) / self.epsilon) for k in side}


def differentiate(
    scene: Scene,
    parameters: Mapping[str, float],
    *,
    scales: Mapping[str, float] | None = None,
    central: bool = True,
    epsilon: float | None = None,
    estimate: bool = False,
) -> Derivatives:
    """Figures of a run and their derivatives by its parameters, in one run. Collective.

    The function `scene` builds the example at given parameters. Parameters may be numbers of laws,
    densities, loads, permeabilities, friction, penalties, initial stresses, motions of rigid
    bodies, and lengths of the body: all that the function takes from its argument. It is called
    once at the parameters, and once or twice per parameter. The perturbed runs follow the run step
    by step: each solves its equations once per substep with the tangent of the run, see
    `dolfinmpm.study.tape`. Their difference is the derivative; no derivative of a law or a term
    is needed.

    Args:
        scene: Function of a dictionary of parameters that returns a `Run`.
        parameters: Name → value.
        scales: Name → size Δm of a parameter, in its unit. The derivative is then Δm ∂/∂m. Without
            a size, Δm is the value itself, so that derivatives are by ln m. A parameter whose value
            is zero needs a size.
        central: Whether two runs per parameter, at m ± ε Δm, give the derivative. One run, at
            m + ε Δm, takes half the time, and loses two digits.
        epsilon: Perturbation of a parameter, as a share of Δm: by default 1e-6, and 3e-8 for one
            run per parameter.
        estimate: Whether to estimate errors by a second perturbation, 8 times as large, in twice
            the time. A derivative that does not exist differs from one perturbation to another.

    Returns:
        Figures and derivatives after each step.

    Raises:
        ParameterError: A parameter or a size is no number, or a size is zero; the scene returns no
            `Run`, or has taken steps already.

    The settlement of a column under its weight falls as Young's modulus rises:

    >>> import dolfinmpm as mpm
    >>> import ufl
    >>> from dolfinx import fem
    >>> from mpi4py import MPI
    >>> def scene(m):
    ...     grid = mpm.create_lattice(MPI.COMM_WORLD, [range(2), range(6)])
    ...     points = mpm.fill(grid, mpm.Box((0, 0), (1, 4)), per_cell=2, density=m["density"])
    ...     V = mpm.Space(grid, "gimp")
    ...     g = fem.Constant(grid, (0.0, 0.0))
    ...     F = mpm.momentum(mpm.materials.Hencky(m["E"], 0.0), points, V.increment, V.test)
    ...     F -= ufl.inner(points.density * g, V.test) * points.dX
    ...     bcs = mpm.fixed(V, "bottom") + mpm.rollers(V, "left", "right")
    ...     problem = mpm.QuasiStatic(F, V.increment, points, bcs)
    ...     def step(k):
    ...         g.value[1] = -10.0 * k / 2
    ...         problem.step()
    ...     top = mpm.probe(points, (0.5, 4.0))
    ...     settlement = lambda: -top.displacement[1]
    ...     steps = [lambda k=k: step(k) for k in (1, 2)]
    ...     return mpm.study.Run(problem, steps, {"settlement": settlement})
    >>> found = mpm.study.differentiate(scene, {"E": 1e7, "density": 2000.0})
    >>> found.figures["settlement"].round(4).tolist()
    [0.008, 0.0159]
    >>> of = found.derivatives["settlement"]
    >>> of["E"].round(4).tolist(), of["density"].round(4).tolist()
    ([-0.0079, -0.0158], [0.0079, 0.0158])
    """
    check_function("scene", scene, "of a dictionary of parameters")
    sizes = sizes_of(parameters, {} if scales is None else scales)
    truth("central", central)
    truth("estimate", estimate)
    epsilon = (CENTRAL if central else ONE_SIDED) if epsilon is None else epsilon
    number("epsilon", epsilon, 0.0, 0.01)
    started = time.perf_counter()
    tape, base = Tape(), _Member(scene, parameters)
    for problem in base.problems:
        if isinstance(problem, QuasiStatic):
            record(problem, tape)
    signs = (1, -1) if central else (1,)
    sets = [
        [_Pair(scene, parameters, k, sizes[k], times * epsilon, signs, tape) for k in parameters]
        for times in ((1.0, _SECOND) if estimate else (1.0,))
    ]
    figures: dict[str, list[Array]] = {k: [] for k in base.run.measured}
    found: list[_Found] = [{k: {m: [] for m in sizes} for k in figures} for _ in sets]
    while True:
        tape.clear()
        if not base.advance():
            break
        marks = base.marks.end()
        for k, value in base.measure().items():
            figures[k].append(value)
        for pairs, derivatives in zip(sets, found):
            for pair in pairs:
                for k, value in pair.advance(base, marks).items():
                    derivatives[k][pair.name].append(value)
    if base.taken == 1:
        raise ParameterError("the scene takes no step: derivatives are those of a run")
    seconds = {name: sum(p.seconds for pairs in sets for p in pairs if p.name == name)
               for name in sizes}  # fmt: skip
    seconds["run"] = time.perf_counter() - started - sum(seconds.values())
    errors = {m: _difference(m, *found) for m in sizes} if estimate else {}
    return Derivatives(
        dict(parameters), sizes,
        {k: np.array(values) for k, values in figures.items()},
        {k: {m: np.array(v) for m, v in by.items()} for k, by in found[0].items()},
        [text for pair in sets[0] for text in pair.told()]
        + [f"{m}: two perturbations differ by {e:.1%}, so that the derivative may not exist"
           for m, e in errors.items() if e > _DOUBTFUL],
        errors, seconds,
    )  # fmt: skip


def _difference(name: str, one: _Found, two: _Found) -> float:
    """Largest difference of two derivatives by a parameter, relative to the largest value."""
    found = [0.0]
    for k, by in one.items():
        a, b = np.array(by[name]), np.array(two[k][name])
        size = np.abs(a).max(initial=0.0)
        found.append(float(np.abs(a - b).max(initial=0.0) / size) if size else 0.0)
    return max(found)


def sizes_of(parameters: Mapping[str, float], scales: Mapping[str, float]) -> dict[str, float]:
    """The sizes Δm of the parameters.

    Raises:
        ParameterError: A parameter or a size is no number, a name is unknown, or a size is zero.
    """
    if not isinstance(parameters, Mapping) or not parameters:
        raise ParameterError(
            f"parameters = {shown(parameters)} must be a dictionary of names and numbers"
        )
    for name in scales:
        if name not in parameters:
            raise ParameterError(
                f"scales has '{name}', and the parameters are {', '.join(parameters)}"
            )
    found = {}
    for name, value in parameters.items():
        number(name, value)
        found[name] = float(number(f"scales['{name}']", scales.get(name, value)))
        if found[name] == 0.0:
            raise ParameterError(
                f"{name} = 0 has no logarithm: give the size of its changes, "
                f"scales={{'{name}': ...}}, in its unit"
            )
    return found
