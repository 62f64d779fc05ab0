"""Parameters from measurements: exact data, intervals, runs that fail, what is not told."""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest

import dolfinmpm as mpm
from dolfinmpm import study
from dolfinmpm._platform.errors import ConvergenceError, ParameterError, UnknownNameError

sys.path.append(str(Path(__file__).resolve().parents[2] / "demos" / "studies"))
from derivative_scenes import column, history_of

TRUTH = {"E": 10e3, "yield": 600.0, "nu": 0.2}


def yielding(m):
    return column({"density": 80.0, **m}, law="von-mises")


def of_steps(figure, count=6):
    """A scene whose figure "y" is a function of the parameters and of the number of the step."""

    def scene(m):
        run = column({"E": 10e3, "nu": 0.2, "density": 80.0}, steps=count)
        steps = []
        run.steps = [lambda step=step: (step(), steps.append(1)) for step in run.steps]
        run.measured = {"y": lambda: figure(m, len(steps))}
        return run

    return scene


def line(m, step):
    return m["a"] + m["b"] * step


@pytest.fixture(scope="module")
def exact():
    return {"motion": history_of(yielding, TRUTH)["motion"]}


def test_exact_data_give_the_parameters(exact):
    start = {"E": 15e3, "yield": 800.0, "nu": 0.3}
    rows = []
    fit = study.calibrate(yielding, start, exact, progress=rows.append)
    assert fit.parameters == pytest.approx(TRUTH, rel=1e-5)
    assert len(fit.trace) <= 8
    assert rows == fit.trace
    assert fit.misfit < 1e-6
    assert fit.figures["motion"] == pytest.approx(exact["motion"], rel=1e-5, abs=1e-8)


def test_intervals_are_those_of_linear_regression():
    """A figure that is linear in two parameters, of which one is negative."""
    x, noise = np.arange(1.0, 7.0), np.array([0.1, -0.2, 0.05, 0.1, -0.1, 0.02])
    y = -1.0 - 0.5 * x + noise
    fit = study.calibrate(
        of_steps(line), {"a": -2.0, "b": -1.0}, {"y": y}, scales={"a": 1.0, "b": 1.0}
    )
    (b, a), covariance = np.polyfit(x, y, 1, cov=True)
    assert fit.parameters == pytest.approx({"a": a, "b": b}, rel=1e-5)
    np.testing.assert_allclose(fit.covariance, covariance[::-1, ::-1], rtol=1e-5)
    low, high = fit.intervals["a"]
    # 95 % of Student's distribution with 4 degrees of freedom
    assert high - low == pytest.approx(2 * 2.776445 * np.sqrt(covariance[1, 1]), rel=1e-5)


def test_what_is_not_told_is_said(exact, tmp_path):
    """Settlements of an elastic column depend on the density over Young's modulus only."""

    def elastic(m):
        return column({"nu": 0.2, **m})

    measured = {"motion": history_of(elastic, {"E": 10e3, "density": 80.0})["motion"]}
    fit = study.calibrate(elastic, {"E": 12e3, "density": 80.0}, measured)
    assert fit.parameters["density"] / fit.parameters["E"] == pytest.approx(8e-3, rel=1e-3)
    assert any(
        "E and density are told together, rather by their ratio" in x for x in fit.notes
    ) or (any("do not depend on" in x for x in fit.notes))
    assert "runs" in str(fit)
    with mpm.figure(str(tmp_path / "fit.png"), dpi=50) as (_, axes):
        fit.draw(axes)
    assert matplotlib.image.imread(tmp_path / "fit.png").std() > 0.01


def test_a_run_that_fails_shortens_the_step(exact):
    failed = []

    def fragile(m):
        if m["E"] < 14e3 and len(failed) < 2:
            failed.append(m["E"])
            raise ConvergenceError("too soft")
        return yielding({**TRUTH, **m})

    fit = study.calibrate(fragile, {"E": 40e3}, exact)
    assert fit.parameters["E"] == pytest.approx(10e3, rel=1e-4)
    assert [row["failed"] for row in fit.trace].count("too soft") == len(failed)
    assert failed

    def never(m):
        raise ConvergenceError("too soft")

    with pytest.raises(ConvergenceError, match="too soft"):
        study.calibrate(never, {"E": 1.0}, {"y": [1.0]})


def test_a_fit_that_ends_beside_runs_that_fail(exact):
    """The best run is one beside which others fail, and no best fit."""

    def fragile(m):
        if m["E"] < 14e3:
            raise ConvergenceError("too soft")
        return yielding({**TRUTH, **m})

    fit = study.calibrate(fragile, {"E": 40e3}, exact, tolerance=1e-3)
    assert fit.parameters["E"] == pytest.approx(14e3, rel=0.05)
    (note,) = fit.notes
    assert "runs beside the best one fail, the last with 'too soft'" in note
    assert "no best fit, and intervals do not hold" in note


def test_bounds_and_gaps(exact):
    gaps = {"motion": np.where(np.arange(5)[:, None] == 2, np.nan, exact["motion"])}
    elastic = {k: TRUTH[k] for k in ("yield", "nu")}
    fit = study.calibrate(
        lambda m: yielding({**elastic, **m}), {"E": 14e3}, gaps, bounds={"E": (12e3, 20e3)}
    )
    assert fit.parameters["E"] == pytest.approx(12e3, rel=1e-2)


def test_measurements_of_weight_zero_do_not_count():
    """Intervals are those of the measurements without them."""
    y = np.array([1.2, 1.4, 2.1, 2.4])
    start, scene = {"a": 0.8, "b": 0.5}, of_steps(line, 4)
    gaps = study.calibrate(scene, start, {"y": [*y[:3], np.nan]}, weights={"y": 1.0})
    zero = study.calibrate(scene, start, {"y": y}, weights={"y": [1.0, 1.0, 1.0, 0.0]})
    assert zero.intervals == gaps.intervals
    assert zero.misfit == gaps.misfit
    two = study.calibrate(scene, start, {"y": y}, weights={"y": [1.0, 1.0, 0.0, 0.0]})
    assert two.intervals == {"a": (0.0, np.inf), "b": (0.0, np.inf)}
    assert "2 measurements for 2 parameters leave no variance to see: measure more" in two.notes
    with pytest.raises(ParameterError, match=r"1 measurements \(those of weight 0 do not count\)"):
        study.calibrate(scene, start, {"y": y}, weights={"y": [0.0, 1.0, 0.0, 0.0]})


def test_a_figure_that_is_not_finite():
    def broken(m, step):
        return np.nan if step == 2 else m["a"] * step

    with pytest.raises(ParameterError, match="the figure 'y' is nan after step 2 in the first run"):
        study.calibrate(of_steps(broken, 3), {"a": 1.0}, {"y": [2.0, 4.0, 6.0]})
    fit = study.calibrate(of_steps(broken, 3), {"a": 1.0}, {"y": [2.0, np.nan, 6.0]})
    assert fit.parameters["a"] == pytest.approx(2.0, rel=1e-5)

    def root(m, step):
        return np.sqrt(1.0 - m["a"]) if m["a"] <= 1.0 else np.nan

    with pytest.raises(ParameterError, match="derivative of the figure 'y' by a is nan after step"):
        study.calibrate(of_steps(root, 2), {"a": 1.0}, {"y": [0.5, 0.5]})

    def later(m, step):
        return np.log(2.2 - m["a"]) if m["a"] < 2.2 else np.nan

    # a later run fails in place of the calibration
    fit = study.calibrate(of_steps(later, 2), {"a": 1.0}, {"y": [-1.0, -1.0]})
    assert fit.parameters["a"] == pytest.approx(2.2 - np.exp(-1.0), rel=1e-5)
    assert any("the figure 'y' is nan after step 1" in row["failed"] for row in fit.trace)


@pytest.mark.long
def test_ends_of_parameters_are_told():
    """Bounds that hold a parameter back, and a positive parameter whose best value is below 0."""
    y = -1.0 + 2.0 * np.arange(1, 4)
    held = study.calibrate(
        of_steps(line, 3), {"a": -0.5, "b": 1.5}, {"y": y}, bounds={"a": (-0.7, 0.7), "b": (1, 9)}
    )
    assert held.parameters["a"] == pytest.approx(-0.7, rel=1e-3)
    low, high = held.intervals["a"]
    assert low < high
    assert [x for x in held.notes if "bound" in x] == [
        "a ends at its bound -0.7: the measurements ask for more, and intervals do not hold there"
    ]
    falls = study.calibrate(of_steps(line, 3), {"a": 1.0, "b": 1.5}, {"y": y})
    assert falls.parameters["a"] < 1e-3
    assert any("goes towards 0, which its logarithm does not reach" in x for x in falls.notes)
    free = study.calibrate(
        of_steps(line, 3), {"a": -0.5, "b": 1.5}, {"y": y}, bounds={"a": (-2.0, 2.0), "b": (1, 9)}
    )
    assert free.parameters == pytest.approx({"a": -1.0, "b": 2.0}, rel=1e-4)
    assert free.notes == []


@pytest.mark.parametrize(
    ("start", "measured", "options", "message"),
    [
        ({"E": 1e4}, {}, {}, "must be a dictionary of arrays"),
        ({"E": 1e4}, {"y": [1.0]}, {"weights": {"z": 1.0}}, "weights has 'z', and measured has y"),
        ({"E": 1e4}, {"y": [1.0]}, {"weights": {"y": -1.0}}, "must be zero or positive"),
        ({"E": 1e4}, {"y": [1.0]}, {"bounds": {"nu": (0, 1)}}, "the parameters are E"),
        ({"E": 1e4}, {"y": [1.0]}, {"bounds": {"E": (1, 2)}}, "must be between its bounds 1 and 2"),
        ({"E": 1e4}, {"y": [1.0]}, {}, "measured has 'y', and the figures of the scene are motion"),
        ({"E": 1e4}, {"motion": [1.0]}, {}, r"has the shape \(1,\), and the figure has \(5, 2\)"),
        ({"E": 1e4}, {"y": "soft"}, {}, "must be numbers"),
        ({"E": 1e4}, {"y": [1.0]}, {"weights": {"y": 0.0}}, "weights are all zero"),
        ({"E": 1e4}, {"y": [1.0]}, {"weights": {"y": np.inf}}, "must be zero or positive"),
        ({"E": 1e4}, {"y": [9.0]}, {"weights": {"y": 1e200}}, "must be below 1e.200"),
        ({"E": 1e4}, {"y": [1.0]}, {"weights": 2.0}, "must be a dictionary of numbers"),
        ({"E": 1e4}, {"y": [1.0]}, {"bounds": 2.0}, "must be a dictionary of pairs"),
        ({"E": 1e4}, {"y": [1.0]}, {"bounds": {"E": (2e4, 1e3)}}, "least below the largest"),
        ({"E": 1e4}, {"y": [1.0]}, {"weights": {"y": -2.0}}, r"\['y'\] = .*-2.* zero or positive"),
        ({"E": 1e4}, {"y": [1.0]}, {"bounds": {"E": 1.0}}, "must be .least, largest."),
        ({"E": 1e4}, {"y": [1.0]}, {"progress": 1}, "progress"),
        ({"E": 1e4}, {"y": [np.nan]}, {}, "0 measurements cannot tell 1 parameters"),
        ({"E": 1e4}, {"y": [1.0, np.inf]}, {}, r"\['y'\] is infinite after step 2.*: give NaN"),
    ],
)
def test_bad_measurements(start, measured, options, message):
    def elastic(m):
        return column({"nu": 0.2, "density": 80.0, **m})

    with pytest.raises(ParameterError, match=message):
        study.calibrate(elastic, start, measured, **options)


def test_runs_that_end_before_the_best_fit():
    y = [np.exp(0.3 * k) for k in range(1, 7)]

    def grown(m, step):
        return np.exp(m["a"] * step)

    few = study.calibrate(of_steps(grown), {"a": 1.0}, {"y": y}, max_runs=2)
    assert "the best of max_runs = 2 runs, and no best fit" in few.notes[-1]
    assert "max_runs" in str(few)
    enough = study.calibrate(of_steps(grown), {"a": 1.0}, {"y": y})
    assert enough.parameters["a"] == pytest.approx(0.3, rel=1e-6)
    assert not any("max_runs" in note for note in enough.notes)


@pytest.mark.parametrize(
    "weight",
    [
        1e-150,
        pytest.param(1e-8, marks=pytest.mark.long),
        pytest.param(1e150, marks=pytest.mark.long),
    ],
)
def test_units_of_weights_have_no_effect(weight):
    """Iterations had ended at the start with small weights, and in nan with large ones."""
    start, y = {"a": 2.0, "b": 3.0}, [0.9, 3.1, 5.2, 6.9, 9.1, 11.0]
    one, other = (
        study.calibrate(of_steps(line), start, {"y": y}, scales=start, weights={"y": w})
        for w in (1.0, weight)
    )
    assert other.parameters == pytest.approx(one.parameters, rel=1e-6)
    assert other.intervals["a"] == pytest.approx(one.intervals["a"], rel=1e-6)
    assert other.misfit == pytest.approx(weight * one.misfit, rel=1e-6)


def test_measurements_of_zero():
    """The note about a parameter without an end was not there, and intervals were nan."""
    fit = study.calibrate(of_steps(lambda m, _: m["a"]), {"a": 5e6}, {"y": np.zeros(6)})
    assert any("goes towards 0" in note for note in fit.notes)
    fit = study.calibrate(of_steps(lambda *_: 0.0), {"a": 5e6}, {"y": np.zeros(6)})
    assert fit.intervals["a"] == (0.0, np.inf)
    assert fit.notes == ["the measurements do not depend on a^+1.00"]


@pytest.mark.long
def test_only_figures_can_be_drawn():
    fit = study.calibrate(of_steps(lambda m, _: m["a"]), {"a": 5e6}, {"y": np.ones(6)})
    with pytest.raises(UnknownNameError, match="no figure 'a'; measured are y"):
        fit.draw(None, "a")
