"""What changes after a problem was made, and copies: told, or without effect on others."""

from __future__ import annotations

import copy
import operator
import pickle

import numpy as np
import pytest
import ufl
from conftest import COMM
from dolfinx import fem, mesh

import dolfinmpm as mpm
from dolfinmpm._platform.errors import FormError, ParameterError


def scene(kind=mpm.QuasiStatic, **options):
    grid = mpm.create_lattice(COMM, [range(3), range(3)])
    points = mpm.fill(grid, mpm.Box((0, 0), (2, 2)), per_cell=2, density=1000.0)
    V = mpm.Space(grid)
    law = mpm.materials.Hencky(E=1e6, nu=0.0)
    bcs = mpm.fixed(V, "bottom") + mpm.rollers(V, "left")
    F = mpm.momentum(law, points, V.increment, V.test)
    return kind(F, V.increment, points, bcs, **options), law, V, bcs


KINDS = {
    mpm.QuasiStatic: None, mpm.Transient: 1.0, mpm.Newmark: 1e-3, mpm.GeneralisedAlpha: 1e-3,
    mpm.Explicit: 1e-3,
}  # fmt: skip


@pytest.mark.parametrize("kind", KINDS)
def test_conditions_that_are_appended_later(kind):
    problem, _, V, bcs = scene(kind)
    bcs += mpm.rollers(V, "right")
    with pytest.raises(
        ParameterError, match=r"bcs, .* has 4 entries now, .* it had 3; .*list\(bcs"
    ):
        problem.step(KINDS[kind])
    del bcs[-1]
    problem.step(KINDS[kind])
    # another condition in the place of one
    bcs[-1] = mpm.rollers(V, "right")[0]
    with pytest.raises(ParameterError, match="has 3 entries now"):
        problem.step(None if KINDS[kind] is None else 2 * KINDS[kind])


def test_conditions_in_other_collections():
    problem, _, V, bcs = scene()
    for given in (tuple(bcs), (one for one in bcs)):
        mpm.QuasiStatic(problem.form.given, V.increment, problem.points, given).step()


@pytest.mark.parametrize("name", ["parameters", "values"])
def test_parameters_of_a_law_in_its_dictionaries(name):
    _, law, _, _ = scene()
    held = getattr(law, name)
    before = dict(held)
    changes = (
        lambda: held.__setitem__("E", 2e6), lambda: held.update(E=2e6), lambda: held.pop("E"),
        lambda: held.__delitem__("E"), lambda: held.clear(),
        lambda: held.setdefault("G", 1.0), lambda: operator.ior(held, {"E": 2e6}),
    )  # fmt: skip
    for change in changes:
        with pytest.raises(ParameterError, match=r"a law are fixed.* make a new law and a"):
            change()
    assert dict(getattr(law, name)) == before
    assert held.copy() | {"E": 2e6} == {**before, "E": 2e6}
    # those of all laws of this kind
    assert mpm.materials.Hencky(E=3e6, nu=0.1).E == 3e6


@pytest.mark.parametrize(
    "copied", [copy.copy, copy.deepcopy, lambda x: pickle.loads(pickle.dumps(x))]
)
def test_copies(copied):
    problem, hencky, V, _ = scene()
    for one in (problem, problem.points, V):
        with pytest.raises(ParameterError, match=r"cannot be copied .*problem\.save\(path\)"):
            copied(one)
    strain = [1e-3, 0.0, -1e-3]
    for law in (hencky, mpm.materials.MohrCoulomb(1e6, 0.3, 1e3, 30.0)):
        again = copied(law)
        assert repr(again) == repr(law)
        assert np.array_equal(again.respond(strain).stress, law.respond(strain).stress)


@pytest.mark.parametrize("kind", [mpm.QuasiStatic, mpm.Newmark, mpm.Explicit])
def test_tags_without_a_law_after_a_step(kind):
    grid = mpm.create_lattice(COMM, [range(3), range(4)])
    points = mpm.fill(grid, mpm.Box((0, 0), (2, 2)), per_cell=2, density=1000.0, tag=1)
    V, law = mpm.Space(grid), mpm.materials.Hencky(E=1e6, nu=0.0)
    u, v, g = V.increment, V.test, fem.Constant(grid, (0.0, -10.0))
    F = mpm.momentum(law, points, u, v, tag=1) + mpm.momentum(law, points, u, v, tag=4)
    F -= ufl.inner(points.density * g, v) * points.dX
    problem = kind(F, u, points, mpm.fixed(V, "bottom"))
    times = iter([None] * 9 if kind is mpm.QuasiStatic else np.arange(1, 9) * 1e-3)
    problem.step(next(times))
    above = points["x"][:, 1] > 1.5
    points["tag"][above] = 3
    with pytest.raises(FormError, match=r"the 4 points of tag 3 have the load .* and no law"):
        problem.step(next(times))
    # a law of this tag has been waiting
    points["tag"][above] = 4
    problem.step(next(times))
    points.add(mpm.fill(grid, mpm.Box((0, 2), (2, 3)), per_cell=2, density=1000.0, tag=7))
    with pytest.raises(FormError, match=r"the 8 points of tag 7 have the load .* and no law"):
        problem.step(next(times))


GRIDS = {
    1: lambda: mesh.create_interval(COMM, 2, (0.0, 2.0)),
    2: lambda: mpm.create_lattice(COMM, [range(3), range(3)]),
}


@pytest.mark.parametrize("d", GRIDS)
def test_functions_that_change_their_argument(d):
    def left(x):
        x *= 0.5
        return x[0] < 0.5

    points = mpm.fill(GRIDS[d](), mpm.Where(left, low=(0,) * d, high=(2.0,) * d), 2, 1.0)
    assert points["x"].max(axis=0).tolist() == [0.75, 1.75][:d]
    points.add_field("depth", value=lambda x: left(x) * 1.0)
    points.remove(lambda x: ~left(x) | (x[0] > 0.3))
    assert points["x"].max(axis=0).tolist() == [0.25, 1.75][:d]
    assert points["x0"].max(axis=0).tolist() == [0.25, 1.75][:d]
