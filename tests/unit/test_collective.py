"""What ranks compare at the barrier of a collective call, and how long one waits there."""

from __future__ import annotations

import inspect
import math
import os
import sys

import numpy as np
import pytest
import ufl
from badinputs import scene
from dolfinx import fem

import dolfinmpm as mpm
from dolfinmpm._platform import sharedmemory
from dolfinmpm._platform.collective import ProcessState, script_line
from dolfinmpm._platform.errors import ParameterError
from dolfinmpm._platform.plainvalues import difference, digest, equal_up_to_rounding, plain_value
from dolfinmpm._platform.sharedmemory import Slot
from dolfinmpm._platform.watchdog import Patience, _limit, message
from dolfinmpm.solve.agreement import of_step

# those that a step makes itself, or that only call what a user gives
WITHOUT_BARRIER = {
    "MaterialPoints.add_field", "MaterialPoints.migrate", "MaterialPoints.recount",
    "Mapping.add_fields", "Mapping.to_grid", "Mapping.to_points", "Stabilisation.measure",
    "Stabilisation.constraint_matrix", "Space.cell_size", "Space.cell_edges", "sweep",
    "convergence", "factor_of_safety", "differentiate", "calibrate", "reliability",
    "monte_carlo", "LimitState.gradient", "Reliability.check",
}  # fmt: skip


def public():
    """Public functions, and methods of public classes, by name."""
    for module in (mpm, mpm.study, mpm.materials):
        for name in module.__all__:
            one = getattr(module, name)
            if inspect.isfunction(one):
                yield name, one
            if not inspect.isclass(one):
                continue
            for method in dir(one):
                found = inspect.getattr_static(one, method)
                found = getattr(found, "__func__", getattr(found, "fget", found))
                if not method.startswith("_") or method == "__add__":
                    yield f"{name}.{method}", found


def test_every_public_collective_call_has_a_barrier():
    names = set()
    for name, function in public():
        text = " ".join((function.__doc__ or "").split())
        if "ollective" not in text or "ot collective" in text or name in WITHOUT_BARRIER:
            continue
        names.add(name)
        assert getattr(function, "is_collective", False), name
    assert len(names) > 60
    made = mpm.Space, mpm.Surface, mpm.Boundary, mpm.RigidFooting, mpm.ParaView, mpm.MaterialPoints
    made += mpm.QuasiStatic, mpm.Transient, mpm.ArcLength, mpm.Newmark, mpm.Explicit
    for kind in (*made, mpm.GeneralisedAlpha):
        assert kind.__init__.is_collective, kind


def test_what_differs_is_named():
    def found(a, b):
        return difference([("value", plain_value(a))], [("value", plain_value(b))])

    assert found(1.0, 2.0) == ("value", 1.0, 2.0)
    assert found(1, 1.0) is found(np.float64(2.0), 2) is found(math.nan, math.nan) is None
    assert found(True, 1) == ("value", True, 1)
    assert found("a", None) == ("value", "a", None)
    assert found({"a": 1, "b": (2, 3)}, {"a": 1, "b": (2, 4)}) == ("b of value", (2, 3), (2, 4))
    assert found([1, 2], [1]) == ("value", (1, 2), (1,))
    assert found(np.arange(3.0), np.arange(3.0)) is None
    assert found(np.zeros(2000), np.ones(2000))[1].startswith("an array of 2000 with the checksum")
    assert found({"left", "top"}, {"top", "left"}) is None
    assert found(print, len) is None
    assert found(print, 3.0) == ("value", "a function", 3.0)
    assert difference([("a", 1)], [("b", 1)]) == ("a", 1, "nothing")


def test_rounding_is_a_difference_that_is_known_as_such():
    assert difference([("t", 0.0)], [("t", -0.0)]) is None
    for a, b in ((1.0, 1.0 + 1e-14), ((1.0, 0.0), (1.0, 1e-13)), (("a", 1.0), ("a", 1.0 - 1e-12))):
        assert difference([("t", a)], [("t", b)]) == ("t", a, b)
        assert equal_up_to_rounding(a, b)
    for a, b in ((1.0, 1.001), ((1.0, 0.0), (1.0, 1e-9)), ("a", "b"), (1.0, "1.0"), ((1.0,), ())):
        assert not equal_up_to_rounding(a, b)


def test_forms_are_compared_by_laws_constants_fields_and_numbers():
    s = scene()

    def form(E=1e4, g=-1.0, factor=2.0, tag=None, rate="density", name=None):
        # constants of other forms may have been made in between
        gravity = fem.Constant(s.grid, (0.0, g))
        if name is not None:
            gravity.name = name
        law = mpm.materials.Hencky(E, 0.3)
        F = mpm.momentum(law, s.points, s.u, s.v, tag=tag)
        return F - factor * ufl.inner(getattr(s.points, rate) * gravity, s.v) * s.points.dX

    def found(**other):
        one, two = plain_value(form()), plain_value(form(**other))
        assert (digest(one) == digest(two)) == (not other)
        return difference([("form", one)], [("form", two)])

    assert found() is None
    assert found(E=2e4) == ("E of Hencky of term 1 of form", 1e4, 2e4)
    assert found(tag=1) == ("tag of Hencky of term 1 of form", None, (1,))
    assert found(g=-2.0) == ("constant 1 of term 2 of form", (0.0, -1.0), (0.0, -2.0))
    assert found(factor=3.0)[0] == "numbers of term 2 of form"
    assert found(rate="V0") == ("fields of term 2 of form", ("density",), ("V0",))
    changed = "constant 1 of term 2", "constant 'gravity' of term 2"
    assert found(name="gravity") == ("form", *changed)


def test_arguments_are_told_by_what_matters():
    s = scene()

    def found(a, b):
        name, one, two = difference([("it", plain_value(a))], [("it", plain_value(b))])
        return f"{name}: {one}, {two}"

    boxes = mpm.Box((0, 0), (1, 1)), mpm.Box((0, 0), (1, 2))
    assert found(*boxes) == "high of it: (1.0, 1.0), (1.0, 2.0)"
    assert found(mpm.Plane((0, 1), (0, 1)), mpm.Plane((0, 2), (0, 1))).startswith("point of it")
    assert found(boxes[0], mpm.Disc((0.5, 0.5), 0.5)).startswith("kind of it")
    laws = (
        mpm.materials.VonMises(1e6, 0.3, radius=1e3),
        mpm.materials.VonMises(1e6, 0.3, radius=2e3),
    )
    assert found(*laws) == "radius of it: 1000.0, 2000.0"
    other = mpm.Stabilisation("ghost", E=1.0), mpm.Stabilisation("ghost", E=2.0)
    assert found(*other) == "E of it: 1.0, 2.0"
    assert found(s.V.increment, s.S.increment) == "shape of it: (2,), ()"
    assert found(fem.Constant(s.grid, 1.0), fem.Constant(s.grid, 2.0)) == "it: 1.0, 2.0"
    bodies = [
        mpm.RigidBody(mpm.Plane((0, 1), (0, -1)), velocity=(0.0, v), name="plate")
        for v in (1.0, 2.0)
    ]
    assert found(*bodies).startswith("motion of it: ((0.0, 1.0)")
    held = [mpm.prescribed(s.V, "left", 0, increment=value) for value in (0.1, 0.2)]
    assert found(*held) == "component 0 at 'left' of it: 0.1, 0.2"


def test_steps_are_compared_by_time_loads_conditions_and_bodies():
    s = scene()
    body = mpm.RigidBody(mpm.Plane((0, 3), (0, -1)), velocity=lambda t: (0.0, -t), name="lid")
    push = fem.Constant(s.grid, 0.0)
    bcs = [
        *mpm.prescribed(s.V, "left", 0, increment=push),
        *mpm.moving(s.V, "bottom", 1, velocity=lambda t: 3 * t),
    ]
    F = s.F + mpm.contact(body, s.points, s.u, s.v)
    problem = mpm.Newmark(F, s.u, s.points, bcs)
    told_of = dict(of_step(problem, 0.5))
    assert told_of["t"] == told_of["the last time"] == 0.5
    assert told_of["constant 1"] == (0.0, -1.0)
    assert told_of["increment of condition 1 at 'left'"] == 0.0
    assert told_of["velocity of condition 2 at 'bottom'"] == 1.5
    assert told_of["motion of 'lid'"] == ((0.0, -0.5),)
    (first,) = mpm.times([0.5])
    assert dict(of_step(problem, first)) == told_of
    # what is wrong with the time is for the step to say
    assert dict(of_step(problem, "soon"))["t"] == "soon"


# -- who waits ------------------------------------------------------------------

ME = Slot(0, group=1, calls=5, waiting=True, since=0)
OUTSIDE = Slot(1, group=1, calls=4, since=7)


def looks(patience, slots_of, seconds, me=ME):
    """What a rank does, second by second."""
    return [patience.look([me, *slots_of], me, 1.0) for _ in range(seconds)]


def test_a_rank_that_others_leave_alone_tells_once_and_ends():
    patience = Patience(30.0)
    found = looks(patience, [OUTSIDE], 30)
    assert patience.first == 10.0
    assert found == [""] * 9 + ["tell"] + [""] * 19 + ["end"]
    assert patience.missing == [OUTSIDE]
    # short limits are told of at half of them, and with none it is told and no more
    assert looks(Patience(4.0), [OUTSIDE], 4) == ["", "tell", "", "end"]
    assert looks(Patience(0.0), [OUTSIDE], 100).count("tell") == 1
    assert "end" not in looks(Patience(0.0), [OUTSIDE], 100)


def test_ranks_that_work_are_waited_for():
    inside = Slot(1, group=1, calls=4, inside=True, since=7)
    elsewhere = Slot(1, group=2, calls=9, inside=True, since=7)
    together = Slot(1, group=1, calls=5, waiting=True)
    for other in (inside, elsewhere, together):
        assert set(looks(Patience(3.0), [other], 50)) == {""}
    # one that does anything at all is not idle
    patience = Patience(3.0)
    for k in range(50):
        assert patience.look([ME, Slot(1, group=1, calls=4, since=k)], ME, 1.0) == ""
    # with one that works among the others nothing is known of how long these wait
    assert set(looks(Patience(3.0), [OUTSIDE, inside], 50)) == {""}


def test_ranks_that_will_not_come_are_not_waited_for():
    gone = Slot(1, group=1, calls=4, since=7, ended=True)
    inside = Slot(2, group=1, calls=4, inside=True, since=7)
    assert looks(Patience(100.0), [gone], 1) == ["end"]
    assert looks(Patience(100.0), [gone, inside], 1) == ["end"]
    assert looks(Patience(0.0), [gone], 3) == ["tell", "", ""]
    # this one has left by an error what the other is still in
    me = Slot(0, group=1, calls=5, waiting=True, failed=True)
    assert looks(Patience(4.0), [inside], 4, me) == ["", "tell", "", "end"]


def test_a_wait_that_was_right_makes_more_patient():
    patience = Patience(30.0)
    assert "tell" in looks(patience, [OUTSIDE], 12)
    patience.begin()
    assert patience.first == 24.0
    assert set(looks(patience, [OUTSIDE], 23)) == {""}


def test_what_is_told_names_ranks_and_places():
    patience = Patience(60.0)
    others = [
        Slot(1, since=7, text="line 3 of a.py"), Slot(2, ended=True),
        Slot(3, group=1, calls=4, inside=True), Slot(5, group=2, waiting=True),
    ]  # fmt: skip
    patience.look([ME, *others], ME, 12.0)
    text = message([0, 4], patience, "fill, line 9 of a.py", False)
    assert text.startswith("dolfinmpm: ranks 0, 4 have waited for 12 s in fill, line 9 of a.py. ")
    assert "Rank 1 is at line 3 of a.py in no call of dolfinmpm. " in text
    assert "Rank 2 has come to the end of its script. " in text
    assert "Rank 3 is in a call that ranks 0, 4 left by an error. " in text
    assert "Rank 5 is in a call with other ranks. " in text
    assert text.endswith("All ranks are ended after 60 s (DOLFINMPM_WAIT = 60; 0 is never).")
    assert message([0], patience, "", True).endswith("All ranks are ended (DOLFINMPM_WAIT = 60).")
    assert message([0], Patience(0.0), "", False).endswith("for ever (DOLFINMPM_WAIT = 0).")


@pytest.mark.parametrize(("text", "limit"), [("", 600.0), ("0", 0.0), ("2.5", 2.5)])
def test_the_limit_is_that_of_the_environment(monkeypatch, text, limit):
    monkeypatch.setenv("DOLFINMPM_WAIT", text)
    assert _limit() == limit


@pytest.mark.parametrize("text", ["soon", "-1", "inf", "nan"])
def test_a_limit_that_is_no_number_is_refused(monkeypatch, text):
    monkeypatch.setenv("DOLFINMPM_WAIT", text)
    with pytest.raises(ParameterError, match=f"DOLFINMPM_WAIT = '{text}' must be a number"):
        _limit()


# -- slots ----------------------------------------------------------------------


@pytest.fixture
def folder(monkeypatch, tmp_path):
    """A folder of files of slots, of a run of its own."""
    monkeypatch.setattr(sharedmemory, "_folder", lambda: tmp_path)
    monkeypatch.setenv("PMIX_NAMESPACE", "this test")
    return tmp_path


def test_others_see_what_a_process_writes(folder):
    memory, file = sharedmemory.own_memory(3)
    memory["calls"], memory["waiting"] = 7, True
    for other in (sharedmemory.find(3), sharedmemory.find(3, file)):
        sharedmemory.ask(other)
        assert sharedmemory.read(other, 3) == Slot(3, calls=7, waiting=True)
        assert memory["asked"]
        sharedmemory.answer(memory, "line 5 of ä.py")
        assert not memory["asked"]
        assert sharedmemory.read(other, 3).text == "line 5 of ä.py"
    assert sharedmemory.find(4) is None
    sharedmemory.answer(memory, "x" * 1000)
    assert sharedmemory.read(sharedmemory.find(3), 3).text == "x" * 448


def test_files_of_a_run_are_removed_by_who_ends_last(folder):
    first, _ = sharedmemory.own_memory(0)
    second, file = sharedmemory.own_memory(1)
    (folder / "another file").touch()
    first["ended"] = True
    sharedmemory.remove_all()
    assert len(list(folder.iterdir())) == 3
    second["ended"] = True
    sharedmemory.remove_all()
    assert [path.name for path in folder.iterdir()] == ["another file"]
    # what a killed process left goes with the next run; no process has so high a number
    killed = file.rpartition("-")[0] + "-99999999"
    open(killed, "w").close()
    sharedmemory.own_memory(0)
    assert not os.path.exists(killed)


def test_the_end_of_a_copy_of_a_process_is_not_its_own(folder):
    here = ProcessState()
    here.memory, _ = sharedmemory.own_memory(0)
    here._process += 1
    here.end()
    assert not sharedmemory.read(here.memory, 0).ended
    here._process -= 1
    here.end()
    assert sharedmemory.read(here.memory, 0).ended
    here.publish()
    assert not sharedmemory.read(here.memory, 0).ended


def test_without_a_file_a_process_writes_for_itself(monkeypatch, tmp_path):
    monkeypatch.setattr(sharedmemory, "_folder", lambda: tmp_path / "absent")
    memory, file = sharedmemory.own_memory(0)
    assert file == ""
    memory["calls"] = 2
    assert sharedmemory.read(memory, 0).calls == 2
    assert sharedmemory.find(0) is None


def test_a_line_is_that_of_the_script():
    here = sys._getframe()
    assert script_line(here) == f"line {here.f_lineno} of test_collective.py"
    found = []
    np.apply_along_axis(
        lambda row: found.append(script_line(sys._getframe())) or 0.0, 0, np.zeros(1)
    )
    assert found[0].endswith(" of test_collective.py")
    assert script_line(None) == "an unknown line"
