"""The critical step of the order "usl", which is shorter than that of "musl"."""

import math

import numpy as np
import pytest
from mpi4py import MPI

import dolfinmpm as mpm


def bar(basis, **options):
    """A free bar of two cells by twenty, whose points have random velocities."""
    grid = mpm.create_lattice(MPI.COMM_WORLD, [np.arange(31.0), np.arange(3.0)])
    points = mpm.fill(grid, mpm.Box((5.0, 0.0), (25.0, 2.0)), 2, 1.0)
    V = mpm.Space(grid, basis)
    F = mpm.momentum(mpm.materials.Hencky(1.0, 0.0), points, V.increment, V.test)
    sides = mpm.rollers(V, "top", "bottom")
    problem = mpm.Explicit(F, V.increment, points, sides, **options)
    noise = np.random.default_rng(0).standard_normal(len(points))
    points["velocity"] = np.column_stack([1e-7 * noise, 0.0 * noise])
    return problem


def test_noise_does_not_grow_in_usl():
    """Two points per cell and direction smear by s = 1/4: steps are stable up to 0.76 · 2/ω_max."""
    problem = bar("linear", scheme="usl")
    first = problem.energies().kinetic
    problem.step(200.0)
    now = problem.energies()
    assert now.kinetic + now.strain < first


def test_usl_has_a_shorter_critical_step():
    steps = [bar("linear", scheme=s).critical_step() for s in ("musl", "usf", "usl")]
    np.testing.assert_allclose(steps, [1.0, 1.0, math.sqrt(0.5)], rtol=1e-6)
    exact = [bar("linear", scheme=s).critical_step(exact=True) for s in ("musl", "usl")]
    assert exact[1] == pytest.approx(math.sqrt(0.5) * exact[0])
    # a consistent mass smears nothing
    steps = [
        bar("linear", scheme=s, mass="consistent", ghost_mass=0.0).critical_step()
        for s in ("musl", "usl")
    ]
    assert steps[1] == steps[0]
