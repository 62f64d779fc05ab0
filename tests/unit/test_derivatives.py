"""Derivatives of runs against differences of whole runs, and where they do not exist."""

from __future__ import annotations

import functools
import itertools
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI

import dolfinmpm as mpm
from dolfinmpm import study
from dolfinmpm._platform.errors import (
    ConvergenceError,
    DifferentProblemWarning,
    ParameterError,
)
from dolfinmpm.solve import linearsolver
from dolfinmpm.solve.linearsolver import LinearSolver
from dolfinmpm.study import tapedtangent

sys.path.append(str(Path(__file__).resolve().parents[2] / "demos" / "studies"))
from derivative_scenes import CASES, column, errors_of, history_of, sizes_of, swing

# example → parameters that the short test takes
SHORT = {
    "elastic": ["E", "density"],
    "von Mises": ["yield"],
    "contact with friction": ["friction", "height"],
    "consolidation": ["permeability"],
    "arc length": ["E"],
    "Newmark": ["density"],
    "explicit": ["velocity"],
}
# bounds of the errors: what differences of whole runs themselves are exact to
ELASTIC, OTHERS = 1e-7, 1e-5
# lengths of a figure that changes from run to run
COUNT = itertools.count(1)


def largest_error(name, names):
    """The largest error of the derivatives of an example by some of its parameters."""
    scene, parameters = CASES[name]
    rest = {k: v for k, v in parameters.items() if k not in names}
    sizes = {k: v for k, v in sizes_of(name).items() if k in names}
    chosen = {k: parameters[k] for k in names}

    def example(m):
        return scene({**rest, **m})

    found = study.differentiate(example, chosen, scales=sizes)
    assert not found.notes
    for by in found.derivatives.values():
        assert {values.shape for values in by.values()} == {by[names[0]].shape}
    return max(errors_of(example, chosen, found).values())


@pytest.mark.parametrize("name", SHORT)
def test_derivatives_are_differences_of_whole_runs(name):
    bound = ELASTIC if name.startswith("elastic") else OTHERS
    assert largest_error(name, SHORT[name]) < bound


@pytest.mark.parametrize("fbar", [True, "volumes"])
def test_a_step_that_is_halved_with_means_over_cells(fbar):
    scene = functools.partial(column, steps=1, gravity=-100.0, fbar=fbar)
    found = study.differentiate(scene, CASES["elastic"][1])
    assert max(errors_of(scene, CASES["elastic"][1], found).values()) < 1e-6


@pytest.mark.long
@pytest.mark.parametrize("name", CASES)
def test_derivatives_of_all_examples(name):
    bound = ELASTIC if name.startswith("elastic") else OTHERS
    assert largest_error(name, list(CASES[name][1])) < bound


def test_figures_are_those_of_a_run_without_derivatives():
    scene, parameters = CASES["von Mises"]
    found = study.differentiate(scene, parameters)
    for name, values in history_of(scene, parameters).items():
        assert np.array_equal(found.figures[name], values)


def test_two_runs_per_parameter_have_more_digits():
    scene, parameters = CASES["elastic"]
    for central, bound in ((False, 1e-7), (True, 2e-9)):
        found = study.differentiate(scene, parameters, central=central)
        assert max(errors_of(scene, parameters, found).values()) < bound


def kinked(strength):
    """A column of which points begin to yield exactly at a strength."""
    fixed = {"E": 10e3, "nu": 0.2, "density": 80.0}
    return lambda m: column({**fixed, "yield": strength * m["share"]}, "von-mises", steps=1)


def test_a_point_that_begins_to_yield_is_told():
    # the strength at which the first point yields, by bisection of whole runs
    low, high = 300.0, 3000.0
    for _ in range(28):
        middle = 0.5 * (low + high)
        run = kinked(middle)({"share": 1.0})
        for step in run.steps:
            step()
        yields = bool(run.problem.points["plastic_strain"].any())
        low, high = (middle, high) if yields else (low, middle)
    found = study.differentiate(kinked(high), {"share": 1.0}, estimate=True)
    assert found.notes
    assert "points start or stop to yield within the perturbation" in found.notes[0]
    # the side on which no point yields has the derivative zero
    assert all(np.abs(by["share"]).max() < 1e-6 for by in found.derivatives.values())
    # one run that leaves: the other side begins later, and gives the same
    later = study.differentiate(kinked(high), {"share": 1.0}, scales={"share": -1.0})
    assert "points start or stop to yield within the perturbation" in later.notes[0]
    assert all(np.abs(by["share"]).max() < 1e-6 for by in later.derivatives.values())


@pytest.mark.parametrize("side", [0, 1])
def test_a_second_run_begins_where_the_first_one_leaves(side, tmp_path):
    """In the third of five steps, a point yields at strengths below one between these two."""
    fixed = {"E": 10e3, "nu": 0.2, "density": 80.0}
    ends = [500.0, 510.0]

    def scene(m):
        return column({**fixed, **m}, "von-mises")

    def number(strength):
        run = scene({"yield": strength})
        for step in run.steps[:3]:
            step()
        return np.count_nonzero(run.problem.points["plastic_strain"])

    of_first = number(ends[0])
    for _ in range(21):
        middle = sum(ends) / 2
        ends[int(number(middle) != of_first)] = middle
    # the perturbation goes towards the other end, and passes the kink
    strength, sign = ends[side], 1 - 2 * side
    found = study.differentiate(scene, {"yield": strength}, scales={"yield": sign * strength})
    assert "yield, step 3: 1 points start or stop to yield" in found.notes[0]
    h = -sign * 1e-5
    at, near, far = (history_of(scene, {"yield": strength * (1 + k * h)}) for k in (0.0, 0.5, 1.0))
    for name, by in found.derivatives.items():
        exact = (4 * near[name] - far[name] - 3 * at[name]) / h
        np.testing.assert_allclose(
            sign * by["yield"], exact, rtol=0, atol=1e-6 * np.abs(exact).max()
        )
    # a checkpoint after the fourth step has both runs
    for _ in range(2):
        again = study.differentiate(
            scene, {"yield": strength}, scales=found.scales, restart=tmp_path, every=4
        )
        assert again.notes == found.notes
        assert len(list(tmp_path.glob("*.npz"))) == 3
        for name, by in found.derivatives.items():
            size = np.abs(by["yield"]).max()
            np.testing.assert_allclose(
                again.derivatives[name]["yield"], by["yield"], rtol=0, atol=1e-6 * size
            )


def test_errors_are_estimated_by_a_second_perturbation():
    scene, parameters = CASES["elastic"]
    found = study.differentiate(scene, {**parameters, "density": 60.0}, estimate=True)
    assert found.errors.keys() == parameters.keys()
    assert 0.0 < max(found.errors.values()) < 1e-6
    assert not found.notes

    def rough(m):
        run = scene({**parameters, "E": m["E"]})
        # a figure with many small jumps has no derivative
        run.measured["settlement"] = lambda: np.floor(1e6 * run.problem.points["x"][:, 1].sum())
        return run

    doubtful = study.differentiate(rough, {"E": parameters["E"]}, estimate=True)
    assert doubtful.errors["E"] > 1e-3
    assert "the derivative may not exist" in doubtful.notes[-1]


@pytest.mark.parametrize(
    ("parameters", "options", "message"),
    [
        ({}, {}, "must be a dictionary of names and numbers"),
        ({"E": 0.0}, {}, "E = 0 has no logarithm"),
        ({"E": 1.0}, {"scales": {"nu": 1.0}}, "scales has 'nu', and the parameters are E"),
        ({"E": 1.0}, {"epsilon": 0.5}, "epsilon"),
        ({"E": "stiff"}, {}, "E = 'stiff'"),
    ],
)
def test_bad_parameters(parameters, options, message):
    with pytest.raises(ParameterError, match=message):
        study.differentiate(lambda m: None, parameters, **options)


def test_bad_scenes():
    with pytest.raises(ParameterError, match=r"return study.Run\(problem, steps, measured\)"):
        study.differentiate(lambda m: None, {"E": 1.0})

    def begun(m):
        run = swing({"E": m["E"], "density": 1.0, "velocity": 0.1}, steps=2)
        next(iter(run.steps))()
        return run

    with pytest.raises(ParameterError, match=r"has taken 1 steps .* study.Run\(..., given=True\)"):
        study.differentiate(begun, {"E": 100.0})

    def shorter(m):
        return swing(
            {"E": m["E"], "density": 1.0, "velocity": 0.1}, steps=2 if m["E"] == 100.0 else 1
        )

    with pytest.raises(ParameterError, match="fewer steps at another E"):
        study.differentiate(shorter, {"E": 100.0})

    def longer(m):
        return swing(
            {"E": m["E"], "density": 1.0, "velocity": 0.1}, steps=1 if m["E"] == 100.0 else 2
        )

    with pytest.raises(ParameterError, match="more steps at another E"):
        study.differentiate(longer, {"E": 100.0})


def with_figure(m, figure, steps=2):
    """Two short steps with figures of the parameters and of the number of the step."""
    run = swing({"E": 100.0, "density": 1.0, "velocity": 0.1}, steps=steps)
    measured = {
        name: functools.partial(lambda get: get(m, len(run.problem.history)), get)
        for name, get in figure(m).items()
    }
    return study.Run(run.problem, run.steps, measured)


def test_figures_that_change():
    def growing(m):
        return with_figure(m, lambda m: {"y": lambda m, k: np.zeros(k)})

    with pytest.raises(ParameterError, match=r"shape \(2,\) after step 2, and \(1,\) after"):
        study.differentiate(growing, {"a": 1.0})

    def renamed(m):
        return with_figure(m, lambda m: {"y" if m["a"] == 1.0 else "z": lambda m, k: 1.0})

    with pytest.raises(ParameterError, match="measured has y, and z at another a"):
        study.differentiate(renamed, {"a": 1.0})


def test_figures_that_are_no_numbers_have_no_estimated_error():
    def rooted(m):
        return with_figure(m, lambda m: {"y": lambda m, k: np.sqrt(1.0 - m["a"])})

    with np.errstate(invalid="ignore"):
        found = study.differentiate(rooted, {"a": 1.0}, estimate=True)
    assert found.errors == {"a": np.inf}
    assert "derivatives are not finite" in found.notes[-1]


def test_perturbations_are_those_that_numbers_have():
    def far(m):
        return with_figure(m, lambda m: {"y": lambda m, k: k * (m["a"] - 1e6)})

    # of 1e6, only changes by multiples of 1e-10 have a number
    for size in (1.0, 13.0, 1e6):
        found = study.differentiate(far, {"a": 1e6}, scales={"a": size}, epsilon=2e-6)
        np.testing.assert_allclose(found.derivatives["y"]["a"], [size, 2 * size], rtol=1e-12)
    for size, least in ((1e-12, "1e-06"), (0.4, "1e-06")):
        with pytest.raises(ParameterError, match=f"lost in rounding; it must be .*{least}"):
            study.differentiate(far, {"a": 1e6}, scales={"a": size}, epsilon=2e-6)

    def linear(m):
        return with_figure(m, lambda m: {"margin": lambda m, k: 3e6 - 2.0 * m["a"]}, steps=1)

    g = study.LimitState(linear, "margin", {"a": 1e-6})
    np.testing.assert_allclose(g.gradient([1e6]), [-2.0], rtol=1e-6)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"problem": None}, "give a problem of dolfinmpm"),
        ({"steps": []}, "has no step"),
        ({"steps": iter([])}, "the scene takes no step"),
        ({"steps": [1, 2]}, "each of steps = 1"),
        ({"measured": {}}, "must be a dictionary of functions"),
        ({"measured": {"y": 1.0}}, "measured..y.. = 1.0"),
        ({"measured": {"y": lambda: "low"}}, "must be numbers"),
        ({"measured": {"y": lambda: np.ones(next(COUNT))}}, "at another E"),
    ],
)
def test_bad_runs(change, message):
    def scene(m):
        run = swing({"E": m["E"], "density": 1.0, "velocity": 0.1}, steps=1)
        given = {"problem": run.problem, "steps": run.steps, "measured": run.measured}
        return study.Run(**given | change)

    with pytest.raises(ParameterError, match=message):
        study.differentiate(scene, {"E": 100.0})


def test_a_run_that_goes_on_from_a_saved_state(tmp_path):
    scene, parameters = CASES["von Mises"]
    path = tmp_path / "half.npz"
    run = scene(parameters)
    for step in run.steps[:3]:
        step()
    run.problem.save(path)

    def goes_on(m):
        run = scene(m)
        run.problem.load(path)
        return study.Run(run.problem, run.steps[3:], run.measured, given=True)

    with warnings.catch_warnings():
        # perturbed runs load the state of other parameters on purpose
        warnings.simplefilter("error", DifferentProblemWarning)
        found = study.differentiate(goes_on, parameters)
    whole = history_of(scene, parameters)
    for name, values in found.figures.items():
        np.testing.assert_allclose(values, whole[name][3:], rtol=1e-12, atol=1e-12)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DifferentProblemWarning)
        assert max(errors_of(goes_on, parameters, found).values()) < OTHERS


def bar(m, options=None):
    """Weight of a bar, in two steps; figures are the positions of its points."""
    grid = mpm.create_lattice(MPI.COMM_WORLD, [range(2), range(6)])
    points = mpm.fill(grid, mpm.Box((0, 0), (1, 4)), 2, 80.0)
    V = mpm.Space(grid, "gimp")
    g = fem.Constant(grid, (0.0, -10.0))
    F = mpm.momentum(mpm.materials.Hencky(m["E"], 0.2), points, V.increment, V.test)
    F -= ufl.inner(points.density * g, V.test) * points.dX
    bcs = mpm.fixed(V, "bottom") + mpm.rollers(V, "left", "right")
    problem = mpm.QuasiStatic(F, V.increment, points, bcs, petsc_options=options)
    return study.Run(problem, [problem.step] * 2, {"x": lambda: points["x"].copy()})


def test_parameters_in_single_precision_lose_no_digits():
    single = study.differentiate(bar, {"E": np.float32(1e5)})
    double = study.differentiate(bar, {"E": 1e5})
    assert np.array_equal(single.derivatives["x"]["E"], double.derivatives["x"]["E"])


def test_iterations_that_do_not_converge_are_told(monkeypatch):
    jacobi = functools.partial(bar, options={"ksp_type": "cg", "pc_type": "jacobi"})
    study.differentiate(jacobi, {"E": 1e5})
    monkeypatch.setattr(linearsolver, "MOST_AGAIN", 1)
    with pytest.raises(ConvergenceError, match="derivatives would be wrong"):
        study.differentiate(jacobi, {"E": 1e5})


def test_another_method_solves_where_the_first_one_does_not_converge(monkeypatch):
    whole = study.differentiate(bar, {"E": 1e5})
    relaxed, again, relax = set(), LinearSolver.again, LinearSolver.relax

    def stuck(self, *args, **options):
        found = again(self, *args, **options)
        if id(self) in relaxed:
            return found
        self.stuck = True
        return np.zeros_like(found)

    def with_note(self):
        relaxed.add(id(self))
        return relax(self)

    monkeypatch.setattr(LinearSolver, "again", stuck)
    monkeypatch.setattr(LinearSolver, "relax", with_note)
    found = study.differentiate(bar, {"E": 1e5})
    assert relaxed
    size = np.abs(whole.derivatives["x"]["E"]).max()
    np.testing.assert_allclose(
        found.derivatives["x"]["E"], whole.derivatives["x"]["E"], rtol=0, atol=1e-6 * size
    )


def test_multigrid_leaves_less_of_the_increments_than_of_the_forces(monkeypatch):
    scene = functools.partial(column, dimension=3, steps=2, fine=4, tolerance=1e-9)
    parameters = CASES["elastic, 3D"][1]
    run = scene(parameters)
    run.steps[0]()
    assert run.problem.newton.linear.method.pc == "mg"
    loose = study.differentiate(scene, parameters).derivatives
    monkeypatch.setattr(tapedtangent, "_LEVELS", 1e-11)
    tight = study.differentiate(scene, parameters).derivatives
    for name, by in tight.items():
        size = max(np.abs(values).max() for values in by.values())
        for m, values in by.items():
            assert np.abs(loose[name][m] - values).max() < 0.5 * ELASTIC * size
