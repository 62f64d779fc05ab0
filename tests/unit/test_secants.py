"""Shares of Newton's steps where contact comes and goes."""

from __future__ import annotations

import math

import numpy as np
import pytest
from mpi4py import MPI

from dolfinmpm.solve.operator import Residual
from dolfinmpm.solve.secants import Secants


def searched(force, x, step):
    """Share and residual of a step, and where the force was asked for."""
    asked = []

    def residual(x):
        asked.append(np.array(x))
        values = force(x)
        return Residual(values, float(np.linalg.norm(values)), 1.0)

    x, step = np.atleast_1d(np.asarray(x, float)), np.atleast_1d(np.asarray(step, float))
    now = residual(x)
    asked.clear()
    search = Secants(MPI.COMM_SELF, residual)
    share, found = search.find(x, step, now)
    # what is moved by the residual stays where the step ends
    np.testing.assert_array_equal(asked[-1], x + share * step)
    np.testing.assert_array_equal(found.values, force(x + share * step))
    return share, found, asked, search


def test_a_step_of_a_linear_force_is_taken_whole():
    K = np.array([[3.0, 1.0], [0.5, 2.0]])
    force = lambda x: K @ x - [1.0, 2.0]  # noqa: E731
    share, found, asked, _ = searched(force, [4.0, -1.0], -np.linalg.solve(K, force([4.0, -1.0])))
    assert share == 1.0
    assert len(asked) == 1
    assert found.norm < 1e-14


@pytest.mark.parametrize("stiff", [5.0, 20.0])
def test_a_stop_that_is_met_on_the_way_ends_the_step_there(stiff):
    """Without a search Newton's method would go to and fro: a soft spring meets a stiff stop."""
    force = lambda x: x - 1.0 + stiff * np.maximum(x - 0.25, 0.0)  # noqa: E731
    share, found, asked, search = searched(force, 0.0, 1.0)
    assert share < 0.5
    assert found.norm <= 0.5
    assert len(asked) <= 6
    assert not search.stuck


def test_a_step_that_is_too_short_is_made_longer():
    force = lambda x: np.tanh(x) - 0.5  # noqa: E731
    share, found, _, _ = searched(force, 0.0, 0.2)
    assert 1.5 < share <= 2.0
    assert found.norm < 0.2


def test_strains_without_a_stress_are_backed_away_from():
    force = lambda x: np.log1p(x) + 0.5 if x > -0.9 else x * np.nan  # noqa: E731
    _, found, _, _ = searched(force, 0.0, -4.0)
    assert math.isfinite(found.norm)
    assert found.norm < 0.5


def test_where_no_stress_is_found_the_norm_says_so():
    _, found, asked, _ = searched(lambda x: np.where(x == 0.0, 1.0, np.nan), 0.0, 1.0)
    assert math.isnan(found.norm)
    assert len(asked) == 10


def test_the_norm_counts_along_a_step_that_no_force_resists():
    """Where the tangent is not definite; such steps in a row are the end of an attempt."""
    force = lambda x: np.array([1.0 - x[0] / 0.3, x[1]])  # noqa: E731
    share, found, _, search = searched(force, [0.0, 0.0], [1.0, 0.0])
    assert share == pytest.approx(0.4)
    assert found.norm < 1.0
    assert not search.stuck
    search.find(np.zeros(2), np.array([1.0, 0.0]), Residual(force(np.zeros(2)), 1.0, 1.0))
    assert search.stuck


def test_the_nearest_share_is_looked_at_once():
    """A stop that is met at once: the secants ask for ever shorter shares than are taken."""
    force = lambda x: x - 1.0 + 1e3 * np.maximum(x - 0.01, 0.0)  # noqa: E731
    share, _, asked, _ = searched(force, 0.0, 1.0)
    assert share == 0.1
    assert [float(x[0]) for x in asked] == [1.0, 0.1]
