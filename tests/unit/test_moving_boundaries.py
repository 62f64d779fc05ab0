"""Boundaries with a prescribed displacement, in steps in time: they move evenly over a step."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI

import dolfinmpm as mpm


def pressed(kind, method="nitsche", value=None, **options):
    """A block under a plate that moves down: the problem, the boundary, and its displacement."""
    grid = mpm.create_lattice(MPI.COMM_WORLD, [range(7), range(6)])
    points = mpm.fill(grid, mpm.Box((0.0, 0.0), (6.0, 2.6)), 2, 1.0)
    V, law = mpm.Space(grid, "gimp"), mpm.materials.Hencky(1e3, 0.3)
    s = fem.Constant(grid, (0.0, 0.0))
    top = mpm.Boundary.from_polygon(points, [(6.0, 2.6), (0.0, 2.6)], closed=False)
    F = mpm.momentum(law, points, V.increment, V.test)
    given = s if value is None else value(s)
    F += mpm.dirichlet(top, V.increment, V.test, given, law=law, method=method)
    bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
    return kind(F, V.increment, points, bcs, stabilisation="ghost", **options), top, s


def expression(s):
    """The displacement as an expression of half of it."""
    return ufl.as_vector((0.0, 2.0 * s[1]))


@pytest.mark.parametrize("value", [None, expression])
@pytest.mark.parametrize("method", ["nitsche", "penalty"])
@pytest.mark.parametrize("rho", [None, 1.0, 0.5])
def test_the_force_of_a_boundary_that_moves_slowly_is_that_at_rest(rho, method, value):
    """The force had swung, by the first step's jump, or had been 772 N for -9 N while it moved."""
    kind, options = mpm.Newmark, {}
    if rho is not None:
        kind, options = mpm.GeneralisedAlpha, {"rho_inf": rho}
    share = 1.0 if value is None else 0.5
    problem, top, s = pressed(kind, method, value, **options)
    rest, under, quiet = pressed(mpm.QuasiStatic, method, value)
    for k in range(1, 21):
        s.value[1] = quiet.value[1] = -0.01 * share * (1 - np.cos(0.05 * np.pi * k))
        problem.step(0.1 * k)
        rest.step()
        assert top.force()[1] == pytest.approx(under.force()[1], abs=0.3)
    assert under.force()[1] == pytest.approx(-62.8, abs=0.1)
    energies = problem.energies()
    stored = 0.5 * 0.02 * 62.8
    assert energies.external == pytest.approx(stored, rel=0.01)
    assert abs(energies["integrator"]) < 0.01 * stored


@pytest.mark.parametrize("given", ["number", "function"])
def test_the_first_step_brings_about_a_displacement_that_is_given_as_a_number(given):
    """At the level of generalised-α it had been reached in full, and then surpassed by as much."""
    down = np.array([0.0, -0.02])

    def value(s):
        return down if given == "number" else (lambda x: np.tile(down, (x.shape[1], 1)))

    problem, top, _ = pressed(mpm.GeneralisedAlpha, "penalty", value, rho_inf=1.0)
    for t in (0.5, 1.0):
        problem.step(t)
        np.testing.assert_allclose(top.markers["x"][:, 1], 2.58, rtol=0, atol=2e-4)


def test_parts_of_a_step_take_parts_of_a_displacement_that_is_given_as_a_number():
    """A step that does not converge is halved, and its displacement with it."""
    problem, top, _ = pressed(mpm.QuasiStatic, "penalty", lambda s: (0.0, -0.5), max_iterations=1)
    record = problem.step()
    assert record.parts > 1
    np.testing.assert_allclose(top.markers["x"][:, 1], 2.1, rtol=0, atol=2e-3)
