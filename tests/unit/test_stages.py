"""Where the time of a step goes: the records of steps and PETSc's log tell the same."""

from __future__ import annotations

import inspect
import os
import subprocess
import sys
import time

import numpy as np
import pytest
import ufl
from conftest import ROOT, unit_grid
from dolfinx import fem
from petsc4py import PETSc

import dolfinmpm as mpm
from dolfinmpm._platform import stages
from dolfinmpm.assembly.stencilsums import Matrix


class Ticks:
    """A clock that goes on by one second whenever it is read."""

    def __init__(self):
        self.now = 0

    def __call__(self):
        self.now += 1
        return float(self.now)


@pytest.fixture(autouse=True)
def measured():
    mpm.measure_stages()
    yield
    mpm.measure_stages(False)


@pytest.fixture
def ticks(monkeypatch):
    clock = Ticks()
    monkeypatch.setattr(stages, "perf_counter", clock)
    return clock


def block(kind="static", **options):
    grid = unit_grid("quadrilateral", 4)
    points = mpm.fill(grid, mpm.Box((0, 0), (1, 0.6)), 2, 1000.0)
    V = mpm.Space(grid, "linear")
    g = fem.Constant(grid, (0.0, 0.0))
    u, v = V.increment, V.test
    F = mpm.momentum(mpm.materials.Hencky(E=1e6, nu=0.3), points, u, v)
    F -= ufl.inner(points.density * g, v) * points.dX
    bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
    if kind == "static":
        return mpm.QuasiStatic(F, u, points, bcs, **options), g
    if kind == "arc":
        g.value[1] = -10.0
        return mpm.ArcLength(F, u, points, bcs, load=g, **options), g
    return getattr(mpm, kind)(F, u, points, bcs, **options), g


def take(problem, g, k=1):
    if isinstance(problem, mpm.ArcLength):
        return problem.step()
    g.value[1] = -1.0 * k
    return problem.step(0.01 * k) if hasattr(problem, "time") else problem.step()


def test_time_belongs_to_the_stage_in_front(ticks):
    watch = stages.Watch()
    with stages.solve:  # read at 1
        with stages.assemble:  # 2
            with stages.assemble, stages.evaluate:  # 3
                pass  # 4
            with stages.solve:  # 5
                pass  # 6
        with stages.evaluate:  # 7, 8
            pass  # 9
    found = watch.stop()  # 10
    assert ticks.now == 10
    assert found == dict.fromkeys(stages.NAMES, 0.0) | {"solve": 4.0, "assemble": 3.0,
                                                       "evaluate": 2.0}  # fmt: skip


def test_a_stage_ends_with_an_error(ticks):
    @stages.evaluate
    def fails():
        raise ValueError

    watch = stages.Watch()
    with pytest.raises(ValueError), stages.solve:  # noqa: PT011
        fails()
    with stages.solve:
        pass
    assert watch.stop()["evaluate"] == 1.0
    assert stages._clock.front is None


@pytest.mark.parametrize(
    "kind", ["static", "arc", "Newmark", "GeneralisedAlpha", "Explicit", "general"]
)
def test_stages_are_all_of_a_step_but_what_looks_at_loads(kind, monkeypatch):
    """Counted in readings of the clock: between entering and leaving a stage there is one tick."""
    problem, g = block(*(("Explicit",) if kind == "general" else (kind,)),
                       **({"fused": False} if kind == "general" else {}))  # fmt: skip
    take(problem, g)
    inside, clock = [0], Ticks()

    def reading():
        inside[0] += stages._clock.front is not None
        return clock()

    monkeypatch.setattr(stages, "perf_counter", reading)
    record = take(problem, g, 2)
    assert set(record.stages) == set(stages.NAMES)
    assert sum(record.stages.values()) <= inside[0]
    own = {name for name, seconds in record.stages.items() if seconds > 0}
    wanted = set(stages.STEP)
    if kind == "Explicit":
        # one loop over the points does it all
        wanted -= {"assemble", "solve", "commit"}
    assert own == wanted


def test_stages_are_no_more_than_the_step():
    problem, g = block()
    for k in range(1, 4):
        record = take(problem, g, k)
        assert 0.0 < sum(record.stages.values()) <= record.seconds


def test_output_belongs_to_the_step_before(tmp_path):
    problem, g = block()
    take(problem, g)
    assert problem.history[0].stages["output"] == 0.0
    with mpm.ParaView(tmp_path / "points.pvd", problem.points) as file:
        file.write(1.0)
    take(problem, g, 2)
    problem.save(tmp_path / "state.npz")
    for record in problem.history:
        assert record.stages["output"] > 0.0
    written = [record.stages for record in problem.history]
    again, _ = block()
    again.load(tmp_path / "state.npz")
    assert again.history[0].stages == written[0]


def test_a_history_takes_them_as_columns():
    problem, g = block()
    history = mpm.History()
    for k in (1, 2):
        record = take(problem, g, k)
        history.record(load=k, **record.stages)
    assert history.names == ("load", *stages.NAMES)
    assert np.all(history["evaluate"] > 0)


def test_nothing_is_measured_unless_asked(ticks, tmp_path):
    problem, g = block()
    mpm.measure_stages(False)
    if PETSc.Log.isActive():
        pytest.skip("this run keeps a log, which asks for it")
    record = take(problem, g)
    with mpm.ParaView(tmp_path / "points.pvd", problem.points) as file:
        file.write(1.0)
    assert ticks.now == 0
    assert record.stages == {}
    mpm.measure_stages()
    with stages.solve, pytest.raises(RuntimeError, match="between steps"):
        mpm.measure_stages(False)
    assert sum(take(problem, g, 2).stages.values()) > 0


def test_a_measured_function_takes_its_arguments_as_before(ticks):
    @stages.solve
    def function(a, b=[], *rest, c, d: int = 4, **options):  # noqa: B006
        """What it does."""
        return a, b, rest, c, d, options, stages._clock.front

    class Owner:
        @stages.assemble
        def method(self, x, /, y=1):
            return x, y

    for on in (True, False):
        mpm.measure_stages(on)
        front = stages.solve if on else None
        assert function(1, c=3) == (1, [], (), 3, 4, {}, front)
        assert function(1, 2, 5, c=3, d=6, e=7) == (1, 2, (5,), 3, 6, {"e": 7}, front)
        assert function(b=2, a=1, c=3)[:2] == (1, 2)
        assert function(1, c=3)[1] is function(1, c=3)[1]
        assert Owner().method(2, y=3) == (2, 3)
        with pytest.raises(TypeError, match="missing 1 required"):
            Owner().method()
    assert function.__doc__ == "What it does."
    assert list(inspect.signature(function).parameters) == ["a", "b", "rest", "c", "d", "options"]


def test_the_operator_takes_keywords():
    problem, _ = block()
    operator = problem.operator()
    x = np.zeros(operator.here.unknowns.owned)
    matrix = problem.newton.linear.matrix or Matrix(operator.here.pattern, operator.here.unknowns)
    assert operator.residual(x=x).norm == operator.residual(x).norm
    operator.move(x=x, scale=0.5)
    operator.tangent(matrix=matrix)
    assert np.any(matrix.data)


LOGGED = """
import sys, time
sys.path[:0] = ["tests", "tests/unit"]
from petsc4py import PETSc
from test_stages import block, take
from dolfinmpm._platform import stages

if len(sys.argv) > 1:
    PETSc.Log.begin()
# PETSc's log alone asks for the records
problem, g = block()
for k in range(1, 4):
    assert sum(take(problem, g, k).stages.values()) > 0
with stages.assemble:
    time.sleep(0.3)
    with stages.evaluate:
        time.sleep(0.6)
for stage in (stages.activate, stages.evaluate, stages.assemble, stages.solve, stages.commit):
    print(stage.name, stage.seconds, stage.event.getPerfInfo()["time"])
"""


@pytest.mark.parametrize("how", ["call", "option"])
def test_petsc_says_the_same(how, tmp_path):
    """What sleeps is in one stage only; seconds differ by what happens between two readings."""
    script = tmp_path / "logged.py"
    script.write_text(LOGGED)
    option = {"PETSC_OPTIONS": f"-log_view :{tmp_path / 'log'}"} if how == "option" else {}
    done = subprocess.run(
        [sys.executable, script, *(["begin"] if how == "call" else [])],
        cwd=ROOT, env={**os.environ, "PYTHONPATH": str(ROOT), **option}, capture_output=True,
        text=True, check=True,
    )  # fmt: skip
    rows = {name: (float(a), float(b)) for name, a, b in map(str.split, done.stdout.splitlines())}
    for own, petsc in rows.values():
        assert own > 0
        assert petsc == pytest.approx(own, rel=0.02, abs=0.1)
    assert rows["assemble"][1] >= 0.3
    assert rows["evaluate"][1] - 0.6 < rows["evaluate"][0]
    if how == "option":
        log = (tmp_path / "log").read_text()
        for name in ("activate", "evaluate", "assemble", "solve", "commit", "migrate"):
            assert f"mpm:{name}" in log


def test_petsc_is_asked_nothing_where_it_keeps_no_log(monkeypatch):
    if PETSc.Log.isActive():
        pytest.skip("this run keeps a log")
    asked = []
    monkeypatch.setattr(stages, "_active", lambda: asked.append(time) or False)
    problem, g = block()
    take(problem, g)
    # once when the fixture asked, once a step
    assert len(asked) == 1
    for stage in stages._ALL:
        assert stage.event.getPerfInfo()["count"] == 0
