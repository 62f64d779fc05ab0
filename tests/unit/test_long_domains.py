"""Domains that would grow longer than the grid within a step."""

from types import SimpleNamespace

import numpy as np
from mpi4py import MPI

import dolfinmpm as mpm
from dolfinmpm.solve.newstate import _impossible

NONE = np.empty(0, np.intp)


def test_a_step_fails_with_a_domain_longer_than_the_grid():
    """Without a stabilisation a torn body had such domains, and the next step blamed the input."""
    lines = [np.linspace(0.0, 4.0, 5), np.linspace(0.0, 1.0, 2)]
    grid = mpm.create_lattice(MPI.COMM_WORLD, lines)
    points = mpm.fill(grid, mpm.Box((0, 0), (4, 1)), per_cell=2, density=1.0)
    blamed = []
    operator = SimpleNamespace(
        form=SimpleNamespace(points=points), points=SimpleNamespace(blame=blamed.append)
    )
    half = points["l"].copy()
    # as long as the grid is wide, and as high
    half[3] = 2.0, 0.5
    assert _impossible(operator, {"l": half}, NONE) is None
    assert not blamed
    half[3] = 0.25, 0.51
    reason = _impossible(operator, {"l": half}, NONE)
    assert reason is not None
    assert "longer than the grid" in reason
    assert blamed == [3]
    reason = _impossible(operator, {"l": half, "V": np.full(3, np.nan)}, np.array([5]))
    assert reason is not None
    assert "not finite" in reason
    assert blamed == [3, 5]
