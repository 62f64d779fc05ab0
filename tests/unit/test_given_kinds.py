"""What users give in spellings and kinds of their own: it counts, or ends in an error."""

from __future__ import annotations

import copy
import math
import pickle

import numpy as np
import pytest
from mpi4py import MPI

import dolfinmpm as mpm
from dolfinmpm._platform.argumentchecks import coordinates, floats, number, whole
from dolfinmpm._platform.errors import ConvergenceError, ParameterError

COMM = MPI.COMM_WORLD


def block(**given):
    grid = mpm.create_lattice(COMM, [range(4), range(3)])
    return mpm.fill(grid, mpm.Box((0, 0), (2, 1)), per_cell=2, density=1.0, **given)


def test_other_spellings_of_words_count():
    """They had passed the check, and the other choice was taken in silence."""
    law = mpm.materials.Hencky(1e6, 0.3)
    for path, end in (("triaxial", 1e-3), ("simple shear", 1e-3)):
        usual, spelt = (
            mpm.study.element_test(law, path, end, by=by, pressure=1e3, steps=2)
            for by in ("strain", "Strain")
        )
        for name in usual.names:
            np.testing.assert_array_equal(usual[name], spelt[name])


def test_a_run_without_a_solution_is_an_error_in_any_spelling():
    def scene(m):
        raise ConvergenceError("no solution")

    def made(m):
        points = block()
        V = mpm.Space(points.grid)
        F = mpm.momentum(mpm.materials.Hencky(m["E"], 0.3), points, V.increment, V.test)
        problem = mpm.QuasiStatic(F, V.increment, points, mpm.fixed(V, "bottom"))
        return mpm.study.Run(problem, [lambda: scene(m)], {"margin": lambda: 1.0})

    given = {"E": mpm.study.Normal(1e6, 1.0)}
    for spelling in ("raise", "Raise"):
        with pytest.raises(ConvergenceError):
            mpm.study.monte_carlo(made, given, runs=2, unconverged=spelling)
    found = mpm.study.monte_carlo(made, given, runs=2, unconverged="Failure")
    assert found.probability == 1.0


def test_masked_numbers_do_not_count():
    assert math.isnan(coordinates("x", np.ma.masked_array([1.0, 2.0], [True, False]))[0])
    with pytest.raises(ParameterError, match="nan must be finite"):
        number("x", np.ma.masked_array([1.0], [True])[0])


def test_truth_values_are_numbers_of_fields_alone():
    assert floats([True, False]).tolist() == [1.0, 0.0]
    with pytest.raises(ParameterError, match=r"x = \[True, False\] must be numbers"):
        coordinates("x", [True, False])
    assert floats(np.datetime64("2020-01-01")) is None
    assert floats(["1.5"]) is None
    points = block()
    points.add_field("wet", value=lambda x: x[0] < 1.0)
    assert sorted(set(points["wet"].tolist())) == [0.0, 1.0]


def test_whole_numbers_have_bounds():
    assert whole("n", 2**63 - 1, 0) == 2**63 - 1
    assert whole("seed", 10**40, 0, math.inf) == 10**40
    with pytest.raises(ParameterError, match=r"n = 9223372036854775808 must be .* at most"):
        whole("n", 2**63, 0)


def test_points_go_by_several_tags():
    """A tuple of tags had removed nothing, or ended in NumPy."""
    grid = mpm.create_lattice(COMM, [range(4), range(3)])
    parts = [
        mpm.fill(grid, mpm.Box((k, 0), (k + 1, 1)), per_cell=2, density=1.0, tag=k)
        for k in range(3)
    ]
    points = parts[0] + parts[1] + parts[2]
    change = points.remove(tag=(0, 2))
    assert change.count == 8
    assert set(points["tag"].tolist()) == {1}


def test_a_period_may_come_second():
    V = mpm.Space(mpm.create_lattice(COMM, [range(6), range(3)]))
    assert mpm.tied(V, 2.0).count == mpm.tied(V, period=2.0).count == 2


def _sinking(t):
    return (0.0, -t)


@pytest.mark.parametrize("way", [(0.0, -0.01), _sinking])
def test_rigid_bodies_can_be_pickled(way):
    body = mpm.RigidBody(mpm.Disc((0.0, 1.0), 0.5), velocity=way, name="disc")
    again = pickle.loads(pickle.dumps(body))
    assert again.name == "disc"
    for t in (0.0, 2.0):
        np.testing.assert_array_equal(again.prescribed(t)[0], body.prescribed(t)[0])


def test_rigid_bodies_with_other_functions_say_so():
    moved = mpm.RigidBody(mpm.Disc((0, 1), 0.5), velocity=lambda t: (0.0, -t))
    pushed = mpm.RigidBody(mpm.Disc((0, 1), 0.5), mass=1.0, inertia=1.0, force=lambda t: (0.0, -t))
    for body in (moved, pushed):
        with pytest.raises(ParameterError, match=r"function of time can be pickled if .* by def"):
            pickle.dumps(body)
    np.testing.assert_array_equal(copy.deepcopy(moved).prescribed(3.0)[0], (0.0, -3.0))


def test_random_fields_can_be_pickled():
    field = mpm.study.RandomField((0, 0), (4, 2), 2.0, mean=1.0, coefficient=0.1, modes=3)
    xi = field.sample(seed=1)
    again = pickle.loads(pickle.dumps(field))
    np.testing.assert_array_equal(again.at([(1.0, 1.0)], xi), field.at([(1.0, 1.0)], xi))
