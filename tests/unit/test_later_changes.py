"""What changes after a problem was made, and copies: told, or without effect on others."""

from __future__ import annotations

import copy
import operator
import pickle

import numpy as np
import pytest
from conftest import COMM

import dolfinmpm as mpm
from dolfinmpm._platform.errors import ParameterError


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
