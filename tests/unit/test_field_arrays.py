"""Changes of fields between steps: explicit steps of one call each see all of them."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from conftest import COMM
from dolfinx import fem, mesh

import dolfinmpm as mpm
from dolfinmpm.body.fieldarrays import FieldArrays
from dolfinmpm.dynamics import fused
from dolfinmpm.dynamics.fusable import FusedLoads
from dolfinmpm.materials import Hencky, NeoHookean, VonMises

FIELDS = ("x", "velocity", "acceleration", "F", "stress", "V", "plastic_strain")
STIFF, SOFT = VonMises(E=2e5, nu=0.3, radius=500.0), NeoHookean(E=1e5, nu=0.3)
LONG = pytest.mark.long
VARYING = VonMises(E=lambda x: 1e5 * (1 + 0.5 * x[0]), nu=0.3, radius=500.0)


def arrays():
    return FieldArrays({name: np.zeros((3, 2)) for name in ("a", "b", "c")})


def test_what_nobody_asks_for_is_not_touched():
    fields = arrays()
    assert fields.touched(None) == {"a", "b", "c"}
    moment = fields.moment()
    assert fields.touched(moment) == set()
    assert fields.read("a").shape == (3, 2)
    assert "a" in fields
    assert list(fields) == ["a", "b", "c"]
    assert fields.keys() == {"a", "b", "c"}
    assert fields.touched(moment) == set()
    assert fields.touched(fields.moment()) == set()


@pytest.mark.parametrize(
    "ask",
    [
        lambda f: f["b"],
        lambda f: f.get("b"),
        lambda f: f.pop("b") is not None and f.update(b=np.ones(1)),
        lambda f: f.update(b=np.ones(1)),
        lambda f: f.__setitem__("b", np.ones(1)),
    ],
)
def test_what_is_asked_for_or_put_in_is_touched(ask):
    fields = arrays()
    moment = fields.moment()
    ask(fields)
    assert fields.touched(moment) == {"b"}
    assert fields.touched(fields.moment()) == set()


@pytest.mark.parametrize(
    "ask",
    [dict, lambda f: {**f}, lambda f: list(f.values()), lambda f: [a for _, a in f.items()]],
)
def test_what_hands_out_all_touches_all(ask):
    fields = arrays()
    moment = fields.moment()
    ask(fields)
    assert fields.touched(moment) == {"a", "b", "c"}


@pytest.mark.parametrize(
    "view", [lambda a: a, lambda a: a[:, 0], lambda a: a.T[0][1:], lambda a: memoryview(a)]
)
def test_what_somebody_holds_is_touched_until_it_is_let_go(view):
    fields = arrays()
    held = view(fields["c"])
    for _ in range(3):
        assert fields.touched(fields.moment()) == {"c"}
    del held
    assert fields.touched(fields.moment()) == set()


def test_a_view_of_what_others_may_hold_is_touched():
    fields, whole = arrays(), np.zeros((6, 2))
    fields["a"] = whole[:3]
    assert fields.touched(fields.moment()) == {"a"}


def test_two_that_ask_do_not_hide_changes_from_each_other():
    fields = arrays()
    first = fields.moment()
    fields["a"][:] = 1.0
    second = fields.moment()
    assert fields.touched(first) == {"a"}
    assert fields.touched(second) == set()


# -- explicit steps ----------------------------------------------------------------------------


class Scene:
    """A block that is thrown at a floor, by loads that a test may change."""

    def __init__(self, law=STIFF, d=2, scheme="usl", basis="bspline2", mapping="flip"):
        low, high, n = (0.0,) * d, (1.0,) * d, (8,) * d
        make = mesh.create_rectangle if d == 2 else mesh.create_box
        kind = mesh.CellType.quadrilateral if d == 2 else mesh.CellType.hexahedron
        self.grid = make(COMM, [low, high], n, kind)
        self.block = mpm.Box((0.26, 0.13, 0.26)[:d], (0.74, 0.51, 0.74)[:d])
        self.points = mpm.fill(self.grid, self.block, 2, 1000.0)
        self.points["tag"][self.points["x"][:, 0] > 0.5] = 1
        V = mpm.Space(self.grid, basis)
        u, v = V.increment, V.test
        self.g = fem.Constant(self.grid, (0.3, -2.0, 0.2)[:d])
        self.push = fem.Constant(self.grid, 0.0)
        self.law = law
        F = mpm.momentum(law, self.points, u, v)
        F -= ufl.inner(self.points.density * self.g, v) * self.points.dX
        F -= 500.0 * v[0] * self.points.dX(1)
        self.points.add_field("velocity", (d,), "m/s")
        x = self.points["x"]
        self.points["velocity"] = np.stack([x[:, 1] - 0.5, -x[:, 0]] + [0 * x[:, 0]] * (d - 2), 1)
        bcs = mpm.prescribed(V, "bottom", 1, increment=0.0) + mpm.prescribed(
            V, "bottom", 0, increment=self.push
        )
        self.problem = mpm.Explicit(F, u, self.points, bcs, scheme=scheme, mapping=mapping)
        assert self.problem.unfused == ""
        self.dt = 0.3 * self.problem.critical_step()
        # as a script that keeps what it was given once; the first step puts points in order
        self.go(1)
        self.held = self.points["velocity"]

    def go(self, calls=3):
        for _ in range(calls):
            self.problem.step(self.problem.time + self.dt)

    def values(self):
        order = np.argsort(self.points["id"])
        return {name: self.points[name][order] for name in FIELDS if name in self.points.fields}


def other(scene):
    """A second body, above the first."""
    upper = mpm.Box((0.4, 0.63), (0.6, 0.74))
    return mpm.fill(scene.grid, upper, 2, 1500.0)


def from_file(scene, folder):
    scene.go(1)
    scene.problem.save(folder / "state.npz")
    scene.go(2)
    scene.problem.load(folder / "state.npz")


def by_another_problem(scene, folder):
    """Steps of a second problem that has the same points."""
    V = mpm.Space(scene.grid, "bspline2")
    F = mpm.momentum(scene.law, scene.points, V.increment, V.test)
    second = mpm.Explicit(F, V.increment, scene.points, mpm.fixed(V, "bottom"), scheme="musl")
    second.step(scene.dt)


def scaled(name, factor=1.2):
    """Another value of a field, in its place."""

    def change(scene, folder):
        scene.points[name][::3] *= factor

    return change


def whole(scene, folder):
    scene.points["velocity"] = 1.1 * scene.points["velocity"]


def by_held_array(scene, folder):
    scene.held[::2] *= 0.9


def by_dictionary(scene, folder):
    scene.points.fields["velocity"][::2] *= 0.9


def by_new_array(scene, folder):
    scene.points.fields["velocity"] = 0.9 * scene.points["velocity"]


def by_ufl_field(scene, folder):
    scene.points.velocity.array[::2] *= 0.9


def by_attribute(scene, folder):
    scene.points.density = 1300.0


def tags(scene, folder):
    scene.points["tag"] = 1 - scene.points["tag"]


def stresses(scene, folder):
    s = np.diag([-100.0, -50.0, -70.0])
    mpm.set_stress(scene.law, scene.points, np.broadcast_to(s, (len(scene.points), 3, 3)))


def plastic(scene, folder):
    scene.points["plastic_strain"] = 0.05


def gravity(scene, folder):
    scene.g.value[:] *= 1.5


def prescribed(scene, folder):
    scene.push.value = 2e-5


def stop(scene, folder):
    scene.push.value = 2e-5
    scene.go(1)
    scene.push.value = 0.0


def move(scene, folder):
    scene.points["x"][:, 1] += 0.07
    scene.points.locate()


def come(scene, folder):
    scene.points.add(other(scene))


def leave(scene, folder):
    scene.points.remove(lambda x: x[0] > 0.6)


CHANGES = {
    "velocity": scaled("velocity"), "whole velocity": whole, "held": by_held_array,
    "dictionary": by_dictionary, "new array": by_new_array, "ufl": by_ufl_field,
    "density": by_attribute, "first volume": scaled("V0"),
    "elastic strain": scaled("be", 1.001), "tag": tags,
    "set_stress": stresses, "gravity": gravity, "prescribed": prescribed, "stop": stop,
    "x": move, "add": come, "remove": leave, "file": from_file, "problem": by_another_problem,
    "internal": plastic,
}  # fmt: skip


def run(monkeypatch, anew, change, folder, **scene):
    """Values after a change between calls of one step; `anew` takes everything anew in all."""
    with monkeypatch.context() as patch:
        if anew:
            patch.setattr(FieldArrays, "touched", lambda self, since: set(self))
        one = Scene(**scene)
        one.go()
        change(one, folder)
        one.go()
        return one.values()


def check(monkeypatch, change, folder, **scene):
    found, expected = (run(monkeypatch, anew, change, folder, **scene) for anew in (False, True))
    still = run(monkeypatch, False, lambda scene, folder: None, folder, **scene)
    same = []
    for name in expected:
        scale = np.abs(expected[name]).max() or 1.0
        assert found[name].shape == expected[name].shape
        assert np.abs(found[name] - expected[name]).max() <= 1e-11 * scale, name
        same.append(
            still[name].shape == found[name].shape
            and np.abs(still[name] - found[name]).max() <= 1e-9 * scale
        )
    # else the test says nothing
    assert not all(same)


@pytest.mark.parametrize("name", CHANGES)
def test_a_change_between_calls_is_seen(monkeypatch, tmp_path, name):
    check(monkeypatch, CHANGES[name], tmp_path)


@pytest.mark.parametrize(
    ("change", "scene"),
    [
        (scaled("F", 1.001), {"law": SOFT}),
        pytest.param(stresses, {"scheme": "musl"}, marks=LONG),
        pytest.param(whole, {"law": SOFT, "scheme": "usf", "mapping": "apic"}, marks=LONG),
        (scaled("l", 0.9), {"basis": "gimp"}),
        (scaled("vonmises_parameters", 1.1), {"law": VARYING}),
        pytest.param(whole, {"law": Hencky(E=1e5, nu=0.3), "d": 3}, marks=LONG),
        (stresses, {"d": 3}),
    ],
)
def test_a_change_is_seen_whatever_the_scene(monkeypatch, tmp_path, change, scene):
    check(monkeypatch, change, tmp_path, **scene)


def counted(monkeypatch, calls, owner, name):
    true = getattr(owner, name)

    def count(*args, **options):
        calls.append(name)
        return true(*args, **options)

    monkeypatch.setattr(owner, name, count)


@pytest.mark.parametrize("law", [STIFF, SOFT])
def test_nothing_is_taken_anew_where_nothing_was_touched(monkeypatch, law):
    scene = Scene(law)
    del scene.held
    scene.go(2)
    calls = []
    counted(monkeypatch, calls, fused, "PointArrays")
    counted(monkeypatch, calls, FusedLoads, "evaluate")
    counted(monkeypatch, calls, mpm.MaterialPoints, "error_in_fields")
    scene.go()
    assert calls == []
    # the loads do not ask for positions; whether these are possible is another matter
    assert scene.points["x"].shape == (len(scene.points), 2)
    scene.go()
    assert calls == ["error_in_fields"]


def test_what_is_impossible_is_refused_between_calls():
    scene = Scene()
    scene.go()
    scene.points["density"][2] = -1.0
    with pytest.raises(mpm.errors.ParameterError, match="density = -1"):
        scene.go()
    scene.points["density"][2] = 1000.0
    scene.go()


def test_a_faster_point_makes_shorter_steps():
    scene = Scene()
    scene.problem.step(scene.problem.time + 2 * scene.dt)
    parts = scene.problem.history[-1].parts
    scene.points["velocity"] = 60.0 * scene.points["velocity"]
    scene.problem.step(scene.problem.time + 2 * scene.dt)
    assert scene.problem.history[-1].parts > parts
