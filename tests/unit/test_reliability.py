"""Reliability indices against exact ones, and random fields against their statistics."""

from __future__ import annotations

import math
import sys
from pathlib import Path

import numpy as np
import pytest

import dolfinmpm as mpm
from dolfinmpm import study
from dolfinmpm._platform.errors import ConvergenceError, MissingPackageError, ParameterError

sys.path.append(str(Path(__file__).resolve().parents[2] / "demos" / "studies"))
from derivative_scenes import column

# standard normal values, close enough for sums over their density
GRID = np.linspace(-8, 8, 2001)


def planned(margin):
    """An example whose margin is a function of its parameters and of a run."""

    def scene(m):
        run = column({"E": 10e3, "nu": 0.2, "density": 80.0}, steps=1)
        run.measured = {"margin": lambda: margin(m)}
        return run

    return scene


@pytest.fixture
def openturns():
    return pytest.importorskip("openturns", reason="OpenTURNS is optional, and not installed")


def test_a_linear_limit_state_is_exact(openturns):
    """β = mean over deviation of the margin."""
    scene = planned(lambda m: 3.0 * m["strength"] - 2.0 * m["load"] - 1.0)
    given = {"strength": study.Normal(5.0, 0.7), "load": study.Normal(3.0, 0.9)}
    found = study.reliability(scene, given, tolerance=1e-8)
    variance = (3 * 0.7) ** 2, (2 * 0.9) ** 2
    beta = (3 * 5.0 - 2 * 3.0 - 1.0) / math.sqrt(sum(variance))
    assert found.beta == pytest.approx(beta, abs=1e-6)
    assert found.importance["strength"] == pytest.approx(variance[0] / sum(variance), abs=1e-6)
    assert found.probability == pytest.approx(0.5 * math.erfc(beta / math.sqrt(2)), rel=1e-5)
    assert found.runs[0] < 8


def test_the_importance_of_an_even_chance(openturns):
    """With β = 0 the design point has no direction; the gradient of a + 2 b has one."""
    given = {"a": study.Normal(), "b": study.Normal()}
    found = study.reliability(planned(lambda m: m["a"] + 2.0 * m["b"]), given)
    assert (found.beta, found.probability) == (0.0, 0.5)
    assert found.importance == pytest.approx({"a": 0.2, "b": 0.8}, abs=1e-6)
    assert found.runs[0] < 4


@pytest.mark.long
def test_a_search_that_stops_short_says_so(openturns):
    """A margin that touches zero has no slope there; one with two ways to fail leads astray."""
    given = {"a": study.Normal(), "b": study.Normal()}
    touches = study.reliability(planned(lambda m: (m["a"] - 2.21) ** 4), given)
    assert touches.beta < 1.9
    assert len(touches.notes) == 1
    assert "standard deviations away (tolerance 0.001): the search has not" in touches.notes[0]
    sand = {"a": study.Normal(10.0, 5.0), "b": study.Normal(9.9, 5.0)}
    found = study.reliability(planned(lambda m: m["a"] ** 3 + m["b"] ** 3 - 18.0), sand)
    assert any("off its direction" in note for note in found.notes)
    straight = study.reliability(planned(lambda m: 2.21 - m["a"]), given)
    assert straight.beta == pytest.approx(2.21, abs=1e-6)
    assert straight.notes == []


def test_lognormal_strength_over_load(openturns):
    """The logarithm of the ratio of two lognormal parameters is normal."""
    scene = planned(lambda m: math.log(m["strength"] / m["load"]))
    given = {"strength": study.LogNormal(20e3, 0.3), "load": study.LogNormal(10e3, 0.2)}
    found = study.reliability(scene, given, tolerance=1e-7)
    spread = math.sqrt(math.log1p(0.3**2) + math.log1p(0.2**2))
    beta = math.log(given["strength"].middle / given["load"].middle) / spread
    assert found.beta == pytest.approx(beta, abs=1e-5)
    assert found.design["strength"] == pytest.approx(found.design["load"], rel=1e-5)


def test_a_weight_that_may_be_too_large(openturns, tmp_path):
    """A run's own figure: the settlement of a column is linear in its small weight."""

    def scene(m):
        run = column({"E": 10e3, "nu": 0.2, "density": m["density"]}, steps=1, gravity=-0.1)
        motion = run.measured["motion"]
        # settlements are 1.12 mm on average
        run.measured = {"margin": lambda: 1.0 + motion()[1] / 1.4e-3}
        return run

    one = study.LimitState(scene, "margin", {"density": 8.0})
    slope = float(one.gradient([80.0])[0])
    beta = one([80.0]) / (abs(slope) * 8.0)
    found = study.reliability(scene, {"density": study.Normal(80.0, 8.0)})
    assert found.beta == pytest.approx(beta, rel=1e-3)
    with mpm.figure(str(tmp_path / "form.png"), dpi=50) as (_, axes):
        found.draw(axes)
    probability, variation = found.check(runs=20)
    assert probability == pytest.approx(found.probability, rel=3 * variation)


def test_plain_sampling_of_a_linear_limit_state():
    """The share of failures is that of the exact probability; a run without solution may count."""
    given = {"strength": study.Normal(5.0, 0.7), "load": study.LogNormal(3.0, 0.3)}
    m = column({"E": 10e3, "nu": 0.2, "density": 80.0}, steps=1)

    def scene(values):
        return study.Run(
            m.problem, [lambda: None], {"margin": lambda: values["strength"] - values["load"]}
        )

    found = study.monte_carlo(scene, given, runs=20000, seed=3)
    load = np.exp(math.log(given["load"].middle) + math.sqrt(math.log1p(0.09)) * GRID)
    weight = np.exp(-(GRID**2) / 2) / np.exp(-(GRID**2) / 2).sum()
    exact = sum(w * 0.5 * math.erfc((5.0 - x) / 0.7 / math.sqrt(2)) for w, x in zip(weight, load))
    assert found.probability == pytest.approx(exact, rel=3 * found.variation)
    assert found.variation == pytest.approx(math.sqrt((1 - exact) / exact / 20000), rel=0.1)
    assert 0.5 * math.erfc(found.beta / math.sqrt(2)) == pytest.approx(found.probability)
    again = study.monte_carlo(scene, given, runs=5, seed=3)
    assert again.samples == study.monte_carlo(scene, given, runs=5, seed=3).samples

    def failing(values):
        def step():
            raise ConvergenceError("no solution")

        return study.Run(m.problem, [step], {"margin": lambda: 1.0})

    with pytest.raises(ConvergenceError, match="no solution"):
        study.monte_carlo(failing, given, runs=2)
    assert study.monte_carlo(failing, given, runs=2, unconverged="failure").probability == 1.0


@pytest.mark.parametrize(
    ("distributions", "options", "message"),
    [
        ({}, {}, "must be a dictionary of distributions"),
        ({"a": 1.0}, {}, "must be a study.Normal"),
        ({"a": study.Normal()}, {"runs": 1}, "runs = 1"),
        ({"a": study.Normal()}, {"ranks": 1}, "scene of two arguments"),
        ({"a": study.Normal()}, {"limit": "safety"}, "is no figure of the scene"),
        ({"a": study.Normal()}, {"unconverged": "skip"}, "unconverged"),
    ],
)
def test_bad_samplings(distributions, options, message):
    with pytest.raises(ParameterError, match=message):
        study.monte_carlo(planned(lambda m: 1.0), distributions, **options)


def test_a_margin_that_is_no_number_is_not_safe():
    scene = planned(lambda m: math.nan)
    with pytest.raises(ParameterError, match=r"'margin' is nan at {'a': .*}: return a number"):
        study.monte_carlo(scene, {"a": study.Normal()}, runs=2)
    with pytest.raises(ParameterError, match="'margin' is nan"):
        study.LimitState(scene, "margin", {"a": 1.0})([0.0])


def test_a_gradient_lets_no_nan_through():
    g = study.LimitState(planned(lambda m: math.nan), "margin", {"a": 1.0})
    for call in (g.gradient, g):
        with pytest.raises(ParameterError, match=r"'margin' is nan at {'a': 0.0}: return a number"):
            call([0.0])
    root = planned(lambda m: math.sqrt(1.0 - m["a"]) if m["a"] <= 1.0 else math.nan)
    with pytest.raises(ParameterError, match="derivative of the figure 'margin' by a is nan at"):
        study.LimitState(root, "margin", {"a": 1.0}).gradient([1.0])
    with pytest.raises(ParameterError, match="a = nan must be finite"):
        study.LimitState(root, "margin", {"a": 1.0})([math.nan])


@pytest.mark.parametrize(
    ("scene", "message"),
    [
        (planned(lambda m: np.ones(2)), r"'margin' has the shape \(2,\) at .*, and a limit is one"),
        (planned(lambda m: "safe"), r"'margin'.* = 'safe' must be numbers"),
        (planned(lambda m: None), r"'margin'.* = None must be numbers"),
        (planned(lambda m: np.nan), "'margin' is nan"),
        (lambda m: None, r"the result of scene = None must be a Run: return study\.Run"),
    ],
)
def test_scenes_without_a_margin(scene, message):
    g = study.LimitState(scene, "margin", {"a": 1.0})
    for call in (
        lambda: g([0.0]),
        lambda: g.gradient([0.0]),
        lambda: study.monte_carlo(scene, {"a": study.Normal()}, runs=2),
    ):
        with pytest.raises(ParameterError, match=message):
            call()


def test_a_reliability_without_a_margin(openturns):
    for margin, message in ((np.ones(2), "has the shape"), (math.nan, "'margin' is nan at")):
        with pytest.raises(ParameterError, match=message):
            study.reliability(planned(lambda m, margin=margin: margin), {"a": study.Normal()})


@pytest.mark.parametrize(
    ("sizes", "message"),
    [
        ({}, "must be a dictionary of numbers"),
        ({"a": 0.0}, r"sizes\['a'\] = 0 must be above 0"),
        ({"a": math.nan}, "nan"),
    ],
)
def test_bad_sizes(sizes, message):
    with pytest.raises(ParameterError, match=message):
        study.LimitState(planned(lambda m: 1.0), "margin", sizes)


def test_what_is_missing_or_wrong(monkeypatch):
    with pytest.raises(ParameterError, match="limit = 'safety' is no figure of the scene"):
        study.LimitState(planned(lambda m: 1.0), "safety", {"a": 1.0})([1.0])
    with pytest.raises(ParameterError, match="one number for each of a"):
        study.LimitState(planned(lambda m: 1.0), "margin", {"a": 1.0})([1.0, 2.0])
    monkeypatch.setitem(sys.modules, "openturns", None)
    with pytest.raises(MissingPackageError, match="pip install openturns"):
        study.reliability(planned(lambda m: 1.0), {"a": study.Normal()})


@pytest.mark.parametrize("kernel", ["gaussian", "exponential"])
def test_a_field_has_its_mean_deviation_and_correlation(kernel):
    field = study.RandomField(
        (0, 0), (4, 2), (2.0, 1.0), mean=5.0, coefficient=0.2, modes=60, kernel=kernel,
        lognormal=False,
    )  # fmt: skip
    assert field.share > (0.999 if kernel == "gaussian" else 0.8)
    x = np.array([(1.9, 1.1), (2.9, 1.1)])
    xi = np.random.default_rng(0).standard_normal((4000, 60))
    values = np.array([field.at(x, dict(zip(field.names, row))) for row in xi])
    deviation = values.std(axis=0)
    assert values.mean(axis=0) == pytest.approx([5.0, 5.0], abs=0.06)
    if kernel == "gaussian":
        assert deviation == pytest.approx([1.0, 1.0], rel=0.05)
        assert np.corrcoef(values.T)[0, 1] == pytest.approx(math.exp(-0.25), abs=0.03)


def variance_over_the_box(field, x):
    """Mean over places of the squares of the modes of a normal field whose variance is one."""
    middle = field.at(x, {})
    modes = np.array([field.at(x, {name: 1.0}) - middle for name in field.names])
    return float((modes**2).sum(axis=0).mean())


@pytest.mark.parametrize(("count", "length"), [(3, 10.0), (20, 1.0), (40, 1.0)])
def test_the_share_of_a_line_is_the_exact_one(count, length):
    """Ghanem & Spanos (1991), section 2.3.3: modes of exp(-r) over a line are known."""
    field = study.RandomField(
        (0,), (10,), length, mean=1.0, coefficient=1.0, modes=count, kernel="exponential",
        lognormal=False,
    )  # fmt: skip
    c, values = 1 / length, []
    for k in range(count):
        # bisection between the poles: c - w tan(5 w) = 0 and w + c tan(5 w) = 0
        low, high = k * np.pi / 10, (k + 1) * np.pi / 10
        for _ in range(60):
            w = (low + high) / 2
            tan = math.tan(5 * w)
            below = c - w * tan > 0 if k % 2 == 0 else w + c * tan < 0
            low, high = (w, high) if below else (low, w)
        values.append(2 * c / (w**2 + c**2) / 10)
    assert field.share == pytest.approx(sum(values), rel=0.01)
    x = (np.arange(2003) + 0.5)[:, None] * 10 / 2003
    assert field.share == pytest.approx(variance_over_the_box(field, x), abs=0.003)


@pytest.mark.parametrize("kernel", ["gaussian", "exponential"])
@pytest.mark.parametrize("count", [20, 60])
def test_the_share_is_that_between_the_nodes(kernel, count):
    field = study.RandomField(
        (0, 0), (10, 5), (4.0, 1.5), mean=1.0, coefficient=1.0, modes=count, kernel=kernel,
        lognormal=False,
    )  # fmt: skip
    lines = [(np.arange(n) + 0.5) * a / n for n, a in ((37, 10), (29, 5))]
    x = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 2)
    assert field.share == pytest.approx(variance_over_the_box(field, x), abs=0.002)


def test_a_field_by_its_seed_and_of_bad_values():
    options = {"mean": 20e3, "coefficient": 0.3, "modes": 5}
    field = study.RandomField((0, 0), (4, 2), 2.0, **options)
    again = study.RandomField((0, 0), (4, 2), 2.0, **options)
    x = np.random.default_rng(3).uniform(0, 2, (7, 2))
    assert np.array_equal(field.at(x, field.sample(4)), again.at(x, again.sample(4)))
    assert np.array_equal(field.at(x, field.sample(4))[2:5], field.at(x[2:5], field.sample(4)))
    assert (field.at(x, field.sample(4)) > 0).all()
    for wrong, message in (
        ({"lengths": 0.0}, "lengths"),
        ({"lengths": 0.01}, "200, 100|400, 200"),
        ({"modes": 10**5}, "at most 2500"),
        ({"high": (0, 2)}, "must be above low"),
        ({"kernel": "square"}, "kernel"),
        ({"lengths": (1.0, 2.0, 3.0)}, "one number, or 2"),
        ({"name": 1}, "name = 1 must be a str"),
        ({"lognormal": "no"}, "lognormal = 'no' must be True or False"),
    ):
        given = {"low": (0, 0), "high": (4, 2), "lengths": 2.0, **options, **wrong}
        with pytest.raises(ParameterError, match=message):
            study.RandomField(given.pop("low"), given.pop("high"), given.pop("lengths"), **given)


@pytest.mark.parametrize("seed", [-1, 1.5, None, True])
def test_seeds_are_whole_numbers(seed):
    field = study.RandomField((0,), (4,), 2.0, mean=1.0, coefficient=0.3, modes=2)
    with pytest.raises(ParameterError, match=r"seed = .* must be a whole number of at least 0"):
        field.sample(seed)


def test_the_seed_of_a_check_is_a_whole_number(openturns):
    found = study.Reliability(0.0, 0.5, {"a": 0.0}, {"a": 0.0}, {"a": 1.0}, [1, 0])
    with pytest.raises(ParameterError, match="seed = None must be a whole number of at least 0"):
        found.check(seed=None)


def test_places_have_the_dimension_of_the_box():
    options = {"mean": 1.0, "coefficient": 0.3, "modes": 2}
    plane = study.RandomField((0, 0), (4, 2), 2.0, **options)
    line = study.RandomField((0,), (4,), 2.0, **options)
    xi = plane.sample(1)
    assert plane.at((1.0, 1.0), xi) == pytest.approx(plane.at([(1.0, 1.0)], xi))
    assert line.at((1.0, 2.0, 3.0), xi) == pytest.approx(line.at([[1.0], [2.0], [3.0]], xi))
    for field in (plane, line):
        assert field.at(np.zeros((0, len(field._low))), xi).shape == (0,)
        assert field.at([], xi).shape == (0,)
        for shape in ((2, 3), (0, 3), (1, 2, 2), ()):
            with pytest.raises(ParameterError, match=r"x has the shape .* \(n, [12]\): the box"):
                field.at(np.zeros(shape), xi)
    with pytest.raises(ParameterError, match="x = 'here' must be numbers"):
        line.at("here", xi)


@pytest.mark.long
def test_distributions_that_form_cannot_take(openturns):
    correlated = openturns.Normal([30.0, 10.0], [3.0, 2.0], openturns.CorrelationMatrix(2))
    with pytest.raises(ParameterError, match=r"\['a'\] is one of 2 numbers.*correlated ones"):
        study.reliability(planned(lambda m: m["a"]), {"a": correlated})
    for given in (openturns.Bernoulli(0.3), openturns.Dirac(3.0)):
        with pytest.raises(ParameterError, match=r"\['a'\] is not continuous.*monte_carlo"):
            study.reliability(planned(lambda m: m["a"]), {"a": given})


def test_correlated_parameters_of_independent_numbers(openturns):
    """a − b of means 30 and 10, deviations 3 and 2, and a correlation of 0.6."""
    r = 0.6

    def margin(m):
        a, z = 30.0 + 3.0 * m["z1"], r * m["z1"] + math.sqrt(1 - r**2) * m["z2"]
        return a - (10.0 + 2.0 * z)

    found = study.reliability(planned(margin), {"z1": study.Normal(), "z2": study.Normal()})
    assert found.beta == pytest.approx(20.0 / math.sqrt(9 + 4 - 2 * r * 6), rel=1e-6)


def test_a_limit_that_is_never_reached(openturns):
    given = {"E": study.LogNormal(1e6, 0.1)}
    match = r"'margin' is 9.99005e\+08 at the medians, .* 1.01e\+04 standard deviations away"
    with pytest.raises(ConvergenceError, match=match):
        study.reliability(planned(lambda m: 1e9 - m["E"]), given)
    with pytest.raises(ParameterError, match="limit = 'margin' changes with none of E"):
        study.reliability(planned(lambda m: 1e9), given)


@pytest.mark.long
def test_a_limit_that_is_within_reach_of_a_straight_line_and_never_zero(openturns):
    given = {"E": study.LogNormal(1e6, 0.1)}
    match = r"'margin' is .* at the medians, and may not fall to zero .*study\.monte_carlo"
    with pytest.raises(ConvergenceError, match=match):
        study.reliability(planned(lambda m: m["E"] + 1e5), given)


def test_a_field_does_not_depend_on_where_its_box_is():
    """The signs of modes with two equal peaks were chance, and distances lost digits."""
    options = {"mean": 20e3, "coefficient": 0.3, "modes": 6}
    near = study.RandomField((0, 0), (10, 5), 4.0, **options)
    shift = np.array([5e6, 4.5e6])
    far = study.RandomField(shift, shift + np.array([10, 5]), 4.0, **options)
    x, xi = np.array([(3.0, 2.0), (8.0, 4.5)]), near.sample(1)
    assert far.at(x + shift, xi) == pytest.approx(near.at(x, xi), rel=1e-8)


def test_places_far_outside_the_box_and_odd_numbers_are_refused():
    options = {"mean": 1.0, "coefficient": 0.3, "modes": 2}
    field = study.RandomField((0, 0), (4, 2), (2.0, 1.0), **options)
    assert np.isfinite(field.at([(5.9, 2.9)], field.sample(1))).all()
    for x in ((6.1, 1.0), (1.0, -1.1), (np.nan, 1.0), (1000.0, 1000.0)):
        with pytest.raises(ParameterError, match=r"at most a correlation length, \[2\. 1\.\] m"):
            field.at([x], {})
    with pytest.raises(ParameterError, match=r"xi = \[1.0, 2.0\] must be a dictionary"):
        field.at([(1.0, 1.0)], [1.0, 2.0])
    for wrong in (np.nan, "a"):
        with pytest.raises(ParameterError, match=r"xi\['xi1'\] = "):
            field.at([(1.0, 1.0)], {"xi1": wrong})
    for low, high in ((0.0, 4.0), ([[0, 0]], [[4, 2]]), ((0, 0), (np.inf, 2)), ((), ())):
        with pytest.raises(ParameterError, match="must be two corners of a box"):
            study.RandomField(low, high, 2.0, **options)
