"""Derivatives of a run by its parameters, found together with the run."""

from __future__ import annotations

import os
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from dolfinmpm._platform.argumentchecks import (
    check_dictionary,
    check_function,
    check_names,
    number,
    truth,
    whole,
)
from dolfinmpm._platform.collective import check_same_call
from dolfinmpm._platform.errors import ParameterError
from dolfinmpm._platform.uncopied import FOUND, unchanged
from dolfinmpm.solve.quasistatic import QuasiStatic
from dolfinmpm.study.branches import RunState
from dolfinmpm.study.derivativenotes import (
    doubtful,
    rounded_away,
    rounded_contacts,
    too_steep,
    without_effect,
)
from dolfinmpm.study.derivativerestart import Savepoints
from dolfinmpm.study.followingruns import FollowedRun, FollowingRuns
from dolfinmpm.study.scenerun import Scene
from dolfinmpm.study.tape import Tape, record

__all__ = ["Derivatives", "differentiate", "sizes_of"]

Array = npt.NDArray[np.float64]
# name of a figure → parameter → values after each step
_Found = dict[str, dict[str, list[Array]]]

# Perturbation of a parameter as a share of its size, in central and in one-sided differences. Their
# rounding is 1e-16 over it, times 10 to 100 from the solution. The third derivative counts with its
# square, the second with itself.
CENTRAL, ONE_SIDED = 1e-6, 8e-8
# Ratio of the second perturbation of an estimate to the first one
_SECOND = 8.0
# Least perturbation as a share of the parameter: the rounding of figures, 1e-16 of them or more,
# is then at most 1e-4 of their derivatives by ln m
_LEAST = 1e-12


@unchanged(FOUND)
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


def differentiate(
    scene: Scene,
    parameters: Mapping[str, float],
    *,
    scales: Mapping[str, float] | None = None,
    central: bool | None = None,
    epsilon: float | None = None,
    estimate: bool = False,
    restart: str | os.PathLike[str] | None = None,
    every: int = 10,
) -> Derivatives:
    """Figures of a run and their derivatives by its parameters, in one run. Collective.

    The function `scene` builds the example at given parameters. Parameters may be numbers of laws,
    densities, loads, permeabilities, friction, penalties, initial stresses, motions of rigid
    bodies, and lengths of the body: all that the function takes from its argument. It is called
    once at the parameters, and once or twice per parameter. The perturbed runs follow the run step
    by step: each solves its equations once per substep with the tangent of the run, see
    `dolfinmpm.study.tape`. Their difference is the derivative; no derivative of a law or a term
    is needed.

    One run per parameter, at m + ε Δm, is exact to 1e-7 in elastic runs. If it takes another way
    than the run itself, for example if another point yields, a run at m − ε Δm begins in this step
    from the mirror image of the first run. Let each function of `steps` set all that it needs. One
    run does not tell what happens at less than m; `central=True` does.

    Args:
        scene: Function of a dictionary of parameters that returns a `Run`.
        parameters: Name → value.
        scales: Name → size Δm of a parameter, in its unit. The derivative is then Δm ∂/∂m. Without
            a size, Δm is the value itself, so that derivatives are by ln m. A parameter whose value
            is zero needs a size. A negative size looks at less than m instead, and the
            derivatives have the other sign.
        central: Whether two runs per parameter, at m ± ε Δm, begin at once. Their difference has
            two more digits, and takes twice the time. By default only for estimates of errors, for
            paths of `ArcLength`, with a `RigidFooting` or a `UMAT`, and for steps that are an
            iterator, because a run that begins later cannot leave them out.
        epsilon: Perturbation of a parameter, as a share of Δm: by default 8e-8, and 1e-6 for two
            runs per parameter. With a `RigidFooting` it is 1e-5, because few digits of its load
            are known, and with a `UMAT` 1e-4, because its substeps may change. Positions x are
            rounded, so that derivatives of a motion u have errors of some 1e-16 |x| / (ε |u|): for
            tiny motions take central=True, and 1e-5.
        estimate: Whether to estimate errors by a second perturbation, 8 times as large, in twice
            the time of two runs per parameter. A derivative that does not exist differs from one
            perturbation to another.
        restart: Folder for checkpoints of the run and of all that follow it. If the folder has a
            set of them, the run goes on from there. So a run that was broken off is started again
            by the same call. `History` objects and files of the function `scene` begin anew.
        every: Number of steps from one set of checkpoints to the next.

    Returns:
        Figures and derivatives after each step.

    Raises:
        ParameterError: A parameter or a size is no number, or a size is zero; ε Δm is below
            1e-12 of the parameter, so that rounding of the figures would be larger; the scene
            returns no `Run`, or has taken steps already, and does not say that their state is
            given; figures or the number of steps change; or the checkpoints belong to other
            parameters.
        CheckpointError: A checkpoint is damaged, or cannot be written.

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
    # in single precision the perturbation would be lost
    parameters = {name: float(value) for name, value in parameters.items()}
    if central is not None:
        truth("central", central)
    truth("estimate", estimate), whole("every", every, 1)
    if epsilon is not None:
        number("epsilon", epsilon, 0.0, 0.01)
    started = time.perf_counter()
    tape, base = Tape(), FollowedRun(scene, parameters)
    given = {"parameters": parameters, "scales": sizes, "central": central, "epsilon": epsilon,
             "estimate": estimate, "restart": restart, "every": every}  # fmt: skip
    check_same_call(base.comm, "study.differentiate", **given)
    for problem in base.problems:
        if isinstance(problem, QuasiStatic):
            record(problem, tape)
    both = base.needs_both or estimate if central is None else central
    usual = (base.rough or CENTRAL) if both else ONE_SIDED
    first = usual if epsilon is None else epsilon

    def pair(name: str, epsilon: float) -> FollowingRuns:
        change = _change(name, parameters[name], sizes[name], epsilon)

        def make(sign: int) -> FollowedRun:
            moved = parameters[name] + sign * change
            other = FollowedRun(scene, {**parameters, name: moved}, quiet=True)
            base.refuse_shared(other, name)
            return other

        return FollowingRuns(make, name, change / sizes[name], both, tape)

    sets = [
        [pair(name, times * first) for name in sizes]
        for times in ((1.0, _SECOND) if estimate else (1.0,))
    ]
    saved = None
    if restart is not None:
        made_by = {"parameters": parameters, "scales": sizes, "epsilon": first,
                   "central": both, "estimate": estimate}  # fmt: skip
        saved = Savepoints(restart, every, base, sets, made_by)
    figures, found = _followed(base, sets, tape, saved)
    seconds = {name: sum(p.seconds for pairs in sets for p in pairs if p.name == name)
               for name in sizes}  # fmt: skip
    seconds["run"] = time.perf_counter() - started - sum(seconds.values())
    errors = {m: _difference(m, *found) for m in sizes} if estimate else {}
    return Derivatives(
        parameters, sizes,
        {k: np.array(values) for k, values in figures.items()},
        {k: {m: np.array(v) for m, v in by.items()} for k, by in found[0].items()},
        [text for pair in sets[0] for text in pair.told()]
        + rounded_away(base, sets[0])
        + rounded_contacts(base, sets[0])
        + without_effect(found[0], list(sizes))
        + too_steep(figures, found[0], sets[0])
        + doubtful(errors),
        errors, seconds,
    )  # fmt: skip


def _followed(
    base: FollowedRun,
    sets: Sequence[Sequence[FollowingRuns]],
    tape: Tape,
    saved: Savepoints | None,
) -> tuple[dict[str, list[Array]], list[_Found]]:
    """Take all steps of a run, and let others follow each step. Collective.

    Args:
        base: The run.
        sets: The runs that follow, for each perturbation and parameter.
        tape: Solutions of the run.
        saved: Checkpoints, if there are to be any.

    Returns:
        Figures, and their derivatives for each set.
    """
    figures: dict[str, list[Array]] = {k: [] for k in base.run.measured}
    found: list[_Found] = [{k: {one.name: [] for one in pairs} for k in figures} for pairs in sets]
    if saved is not None:
        figures, found = saved.read() or (figures, found)
    while True:
        tape.clear()
        may_begin = any(pair.may_begin for pairs in sets for pair in pairs)
        before = RunState(base.problems) if may_begin else None
        if not base.advance():
            break
        marks, middle = base.marks.end(), base.measure()
        for k, value in middle.items():
            if figures[k] and value.shape != figures[k][0].shape:
                raise ParameterError(
                    f"measured['{k}'] has the shape {value.shape} after step {base.taken}, and "
                    f"{figures[k][0].shape} after the first one: let it be the same in all steps"
                )
            figures[k].append(value)
        for pairs, derivatives in zip(sets, found):
            for one in pairs:
                for k, value in one.advance(base, before, marks, middle).items():
                    derivatives[k][one.name].append(value)
        if saved is not None:
            saved.write(figures, found)
    if base.taken == 1:
        raise ParameterError("the scene takes no step: derivatives are those of a run")
    for pairs in sets:
        for one in pairs:
            one.finish()
    return figures, found


def _change(name: str, value: float, size: float, epsilon: float) -> float:
    """The change ε Δm of a parameter as its values have it, with all digits.

    Raises:
        ParameterError: It is below 1e-12 of the parameter, so that few digits of the figures'
            differences would be left.
    """
    change, least = epsilon * size, _LEAST * abs(value)
    if abs(change) < least:
        raise ParameterError(
            f"{name} = {value:g}: its change by epsilon times its size, {epsilon:g} · {size:g} = "
            f"{change:g}, is lost in rounding; it must be at least {_LEAST:g} of the parameter, "
            f"{least:g}: give a larger size, scales={{'{name}': ...}}, or a larger epsilon"
        )
    return (value + change) - value


def _difference(name: str, one: _Found, two: _Found) -> float:
    """Largest difference of two derivatives by a parameter, relative to the largest value.

    It is infinite where a derivative is not a number.
    """
    found = [0.0]
    for k, by in one.items():
        a, b = np.array(by[name]), np.array(two[k][name])
        if not (np.isfinite(a).all() and np.isfinite(b).all()):
            return float("inf")
        size = np.abs(a).max(initial=0.0)
        found.append(float(np.abs(a - b).max(initial=0.0) / size) if size else 0.0)
    return max(found)


def sizes_of(parameters: Mapping[str, float], scales: Mapping[str, float]) -> dict[str, float]:
    """The sizes Δm of the parameters.

    Raises:
        ParameterError: A parameter or a size is no number, a name is unknown, or a size is zero.
    """
    check_dictionary("parameters", parameters, " of names and numbers", some=True)
    check_dictionary("scales", scales, " of names and numbers")
    check_names("scales", scales, parameters, "the parameters are")
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
