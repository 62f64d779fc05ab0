"""Steps in time: records, parts, lengths by their error, and restart."""

from __future__ import annotations

import math

import numpy as np
import pytest
from conftest import COMM
from scenes import vibrating_bar
from test_newmark import LAWS, block

import dolfinmpm as mpm
from dolfinmpm._platform.errors import ConvergenceError, DolfinMPMError, ParameterError


def test_records_and_times():
    problem, _ = block(load=(0.0, -1.0))
    assert problem.time == 0.0
    for t in mpm.times(0.1, dt=0.04):
        record = problem.step(t)
        assert (record.time, problem.time) == (t, t)
        assert record.dt == pytest.approx(0.1 / 3)
    assert problem.time == 0.1
    assert [r.time for r in problem.history] == pytest.approx([0.1 / 3, 0.2 / 3, 0.1])
    problem.step(0.15)
    assert problem.history[-1].dt == pytest.approx(0.05)


def test_a_step_that_fails_is_taken_in_parts():
    law = mpm.materials.Hencky(E=2e3, nu=0.3)
    whole, _ = block(law=law, load=(0.0, -30.0), max_iterations=4)
    record = whole.step(0.4)
    assert record.halvings > 0
    assert record.parts > 1
    assert record.time == whole.time == 0.4
    assert record.dt <= 0.2
    # a failure leaves everything where it was
    stuck, g = block(law=law, load=(0.0, -3.0), max_iterations=4, max_halvings=0)
    stuck.step(0.02)
    before = {name: values.copy() for name, values in stuck.points.fields.items()}
    g.value[1] = -300.0
    with pytest.raises(ConvergenceError):
        stuck.step(0.5)
    assert stuck.time == 0.02
    for name, values in stuck.points.fields.items():
        np.testing.assert_array_equal(values, before[name])


def test_steps_that_are_as_long_as_their_error_allows():
    """They grow from a short first one, at most to the double, and the last ends at the end."""
    typical = []
    for bound in (1e-3, 1e-4):
        problem = vibrating_bar(error=bound, stabilisation="ghost")
        problem.step(0.01)
        lengths = [0.01]
        for t in mpm.times(3.0, dt="auto", start=0.01):
            before = problem.time
            assert float(t) == before
            record = problem.step(t)
            lengths.append(problem.time - before)
            assert record.time == problem.time
        assert problem.time == 3.0
        growth = np.array(lengths[1:]) / np.array(lengths[:-1])
        assert growth.max() < 2.0 + 1e-9
        typical.append(np.median(lengths))
    assert typical[0] > 2 * typical[1] > 0.01


def test_a_run_of_chosen_steps_begins_with_a_short_one():
    """Its first step had been the whole run, in one record, and had failed in a long run."""
    problem = vibrating_bar(error=1e-3, stabilisation="ghost")
    for t in mpm.times(300.0, dt="auto"):
        problem.step(t)
        if problem.time > 2.0:
            break
    lengths = np.diff([0.0, *(record.time for record in problem.history)])
    assert lengths[0] == pytest.approx(0.3, rel=1e-12)
    assert len(lengths) > 5
    assert np.max(lengths[1:] / lengths[:-1]) < 2.0 + 1e-9


@pytest.mark.parametrize("bare", [float, np.float64, lambda t: t + 0.0])
def test_the_bare_number_of_a_chosen_time_is_enough(bare):
    """It goes where the time of the loop itself goes, also within another loop at that time."""
    ends = []
    for each in (lambda t: t, bare):
        problem = vibrating_bar(error=1e-3, stabilisation="ghost")
        problem.step(0.01)
        for t in mpm.times(1.0, dt="auto", start=0.01):
            problem.step(each(t))
        assert problem.time == 1.0
        ends.append([record.time for record in problem.history])
    assert ends[0] == ends[1]
    # no loop waits any more
    with pytest.raises(ParameterError, match=r"t = 1 s must be later than the time of the state"):
        problem.step(1.0)


def test_loops_within_each_other_take_their_own_times():
    one, other = (vibrating_bar(error=1e-3, stabilisation="ghost") for _ in range(2))
    for problem in (one, other):
        problem.step(0.01)
    outer = mpm.times(0.5, dt="auto", start=0.01)
    t = next(outer)
    for s in mpm.times(0.2, dt="auto", start=0.01):
        other.step(float(s))
    one.step(float(t))
    assert other.time == 0.2
    assert 0.01 < one.time == t.reached


def test_a_step_whose_error_is_too_large_is_halved():
    bound, free = vibrating_bar(error=1e-2, stabilisation="ghost"), vibrating_bar()
    parts = [bound.step(t).parts for t in (1.0, 2.0)]
    assert min(parts) > 1
    assert bound.history[0].halvings > 0
    assert [free.step(t).parts for t in (1.0, 2.0)] == [1, 1]


def test_an_automatic_loop_needs_its_steps_to_be_taken():
    with pytest.raises(ParameterError, match=r"no step was taken from t = 0 s: call problem\.step"):
        for _ in mpm.times(1.0, dt="auto"):
            pass


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"end": 1.0, "dt": -0.1}, r"dt = -0\.1 s must be above 0"),
        ({"end": 1.0, "dt": 0.0}, r"dt = 0 s must be above 0"),
        ({"end": 1.0, "dt": "fast"}, "dt = 'fast' must be a time in s or \"auto\""),
        ({"end": -1.0, "dt": 0.1}, r"end = -1 s must be above 0"),
        ({"end": 1.0, "dt": 0.1, "start": 1.0}, r"end = 1 s must be above 1"),
        ({"end": math.nan, "dt": 0.1}, r"end = nan s must be"),
    ],
)
def test_times_that_do_not_rise(given, message):
    with pytest.raises(ParameterError, match=message):
        list(mpm.times(**given))


def shaken(rule=mpm.Newmark, **options):
    """A block under a load that changes its sign; `step` takes the next step of a run."""
    problem, g = block(rule, **options)

    def step():
        k = len(problem.history)
        g.value[0] = 4.0 * np.sin(0.9 * (k + 1))
        g.value[1] = -10.0 if k > 4 else 0.0
        return problem.step(problem.time + 0.01)

    return problem, step


def bits(problem):
    fields = {name: values.tobytes() for name, values in problem.points.fields.items()}
    energies, clock = problem.energies(), problem.scheme.clock
    return fields, energies, problem.time, clock.wanted, [
        vars(record) | {"seconds": None, "stages": None} for record in problem.history
    ]  # fmt: skip


RUNS = {
    "newmark": {},
    "newmark, lumped": {"mass": "lumped"},
    "apic": {"mass": "lumped", "mapping": "apic"},
    "tpic": {"mass": "lumped", "mapping": "tpic", "basis": "bspline2"},
    "generalised-α": {"rule": mpm.GeneralisedAlpha, "rho_inf": 0.7},
    "aggregation": {"stabilisation": "aggregation"},
    "error bound": {"error": 0.1},
    "yielding": {"law": LAWS["yielding"]},
}


@pytest.mark.parametrize("name", RUNS)
def test_a_run_goes_on_bit_for_bit(name, tmp_path):
    problem, step = shaken(**RUNS[name])
    for k in range(10):
        step()
        if k in (0, 3, 4, 6):
            problem.save(tmp_path / f"{k}.npz")
    for k in (0, 3, 4, 6):
        again, step = shaken(**RUNS[name])
        again.load(tmp_path / f"{k}.npz")
        assert again.time == again.history[-1].time
        while len(again.history) < 10:
            step()
        assert bits(again) == bits(problem)


def test_a_file_of_another_problem_is_refused(tmp_path):
    problem, step = shaken()
    step()
    problem.save(tmp_path / "a.npz")
    for other in ({"rule": mpm.GeneralisedAlpha}, {"mapping": "flip"}):
        with pytest.raises(DolfinMPMError, match="is of another problem"):
            shaken(**other)[0].load(tmp_path / "a.npz")


@pytest.mark.parametrize(
    ("mass", "mapping"),
    [("consistent", None), ("consistent", "flip"), ("lumped", None), ("lumped", "flip")],
)
@pytest.mark.parametrize("steps", [20, 80])
def test_the_work_of_a_side_that_moves(steps, mass, mapping):
    """A bar pushed with v has the stress ρ c v until the wave comes back, whatever the step."""
    L, h, E, v = 2.0, 0.125, 1e6, 1e-3
    c = math.sqrt(E / 1000.0)
    grid = mpm.create_lattice(COMM, [h * np.arange(18), h * np.arange(2)])
    points = mpm.fill(grid, mpm.Box((0, 0), (L, h)), 2, 1000.0)
    V = mpm.Space(grid, "gimp")
    F = mpm.momentum(mpm.materials.Hencky(E=E, nu=0.0), points, V.increment, V.test)
    bcs = mpm.rollers(V, "bottom", "top") + mpm.moving(V, "left", 0, velocity=v)
    problem = mpm.Newmark(F, V.increment, points, bcs, mass=mass, mapping=mapping)
    end = 0.8 * L / c
    for t in mpm.times(end, dt=end / steps):
        problem.step(t)
    assert problem.energies().external == pytest.approx(1000.0 * c * v**2 * end * h, rel=0.04)
