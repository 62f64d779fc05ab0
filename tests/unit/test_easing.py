"""Forces that are out of balance before a step are released by shares where all at once fails."""

from __future__ import annotations

import numpy as np
import pytest
from dolfinx import mesh
from mpi4py import MPI

import dolfinmpm as mpm


def released(most: int, halvings: int = 10):
    """A column whose elements are compressed to begin with, in at most so many iterations."""
    grid = mesh.create_rectangle(
        MPI.COMM_WORLD, [(0, 0), (1, 3)], (2, 6), mesh.CellType.quadrilateral
    )
    points = mpm.fill(grid, mpm.Box((0, 0), (1, 2)), 2, 1000.0)
    V = mpm.Space(grid, "linear", configuration="total")
    law = mpm.materials.Hencky(1e5, 0.3)
    F = mpm.momentum(law, points, V.increment, V.test)
    mpm.set_stress(law, points, -3e4 * np.eye(3))
    bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
    problem = mpm.QuasiStatic(
        F, V.increment, points, bcs, tolerance=1e-6, max_iterations=most, max_halvings=halvings,
        petsc_options={"snes_linesearch_type": "basic"},
    )  # fmt: skip
    return problem, problem.step()


def test_forces_out_of_balance_are_released_by_shares():
    whole, record = released(20)
    assert record.halvings == 0
    needed = len(record.residuals) - 1
    eased, record = released(needed - 1)
    assert record.halvings == 10
    assert record.parts > 1
    assert record.residuals[-1] <= eased.tolerance
    assert np.abs(eased.points["x"] - eased.points["x0"]).max() > 0.1
    assert eased.points["x"] == pytest.approx(whole.points["x"], abs=1e-5)


def test_few_halvings_are_kept():
    needed = len(released(20)[1].residuals) - 1
    with pytest.raises(mpm.errors.ConvergenceError):
        released(needed - 1, halvings=2)
