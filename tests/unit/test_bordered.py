"""Newton's method with additional equations: steps that make forces grow are shortened."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from dolfinx import fem
from mpi4py import MPI

import dolfinmpm as mpm
from dolfinmpm.solve.bordered import Bordered
from dolfinmpm.solve.operator import Residual


class Stub:
    """Equations whose out-of-balance force is a function of the unknown, and their border."""

    def __init__(self, norm):
        self.norm, self.value, self.updates = norm, np.zeros(1), 0

    def update_external(self):
        self.updates += 1

    def residual(self, x):
        # loads depend on the border's unknowns, and are up to date
        assert self.updates > 0
        norm = self.norm(float(x[0]))
        self.updates = 0
        return Residual(np.array([norm]), norm, 1.0)

    def move(self, change):
        self.value += change


@pytest.mark.parametrize(
    ("norm", "share"),
    [
        # a growth that Newton's method may make good
        (lambda x: 1 + 2.9 * x, 1.0),
        (lambda x: 1 + 100 * x**3, 0.25),
        (lambda x: np.nan if x > 0.3 else 1.0, 0.25),
        (lambda x: 10.0, 1 / 16),
    ],
)
def test_a_step_that_makes_forces_grow_is_shortened(norm, share):
    stub: Any = Stub(norm)
    x = np.zeros(1)
    found = Bordered(stub, stub)._move(stub, x, np.ones(1), np.full(1, -2.0), 1.0)
    assert x[0] == share
    assert stub.value[0] == -2.0 * share
    assert found.norm == norm(share)


def test_a_body_out_of_balance_on_soil_in_balance():
    """A plate on an elastic block under a growing force: no step is shortened."""
    grid = mpm.create_lattice(MPI.COMM_SELF, [np.linspace(0, 2, 9), np.linspace(0, 1.5, 7)])
    points = mpm.fill(grid, mpm.Box((0, 0), (2, 1)), 2, 1.0)
    V = mpm.Space(grid, "gimp", configuration="total")
    force = fem.Constant(grid, (0.0, 0.0))
    plate = mpm.RigidBody(
        mpm.Box((-0.5, 0.995), (2.5, 1.5)), force=force, free=(False, True, False)
    )
    F = mpm.momentum(mpm.materials.Hencky(E=1e5, nu=0.3), points, V.increment, V.test)
    F += mpm.contact(plate, points, V.increment, V.test)
    bcs = mpm.fixed(V, "bottom") + mpm.rollers(V, "left", "right")
    problem = mpm.QuasiStatic(F, V.increment, points, bcs, max_iterations=7)
    for k in range(4):
        force.value[1] = -3000.0 * (k + 1)
        record = problem.step()
        assert (record.iterations, record.halvings) == (4, 0)


@pytest.mark.parametrize(
    ("law", "friction"),
    [(mpm.materials.Tresca(1e7, 0.3, cohesion=20e3), 0.0), (mpm.materials.Hencky(1e7, 0.3), 0.4)],
)
def test_a_free_body_whose_edge_leaves_a_corner(law, friction):
    """The corner's force is lost within a step. Full steps then went up and down without end."""
    grid = mpm.create_lattice(MPI.COMM_WORLD, [np.arange(-4, 4.1, 0.25), np.arange(-2, 0.6, 0.25)])
    points = mpm.fill(grid, mpm.Box((-4, -2), (4, 0)), 2, 1700.0)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    load = fem.Constant(grid, (0.0, 0.0))
    free = (friction > 0, True, friction > 0)
    footing = mpm.RigidBody(mpm.Box((-1, 0), (1, 0.5)), free=free, force=load, name="footing")
    F = mpm.momentum(law, points, u, v) + mpm.contact(footing, points, u, v, friction=friction)
    bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
    problem = mpm.QuasiStatic(F, u, points, bcs, stabilisation="ghost")
    for pressed in (25e3, 50e3):
        load.value[:] = 0.2 * pressed * free[0], -pressed
        record = problem.step()
        np.testing.assert_allclose(record.bodies["footing"]["force"], -load.value, atol=1e-3)
        assert record.halvings == 0
    # an elastic layer of 2 m carries the mean pressure of 25 kPa
    assert 0.5 < (0.25 - footing.position[1]) / (2.0 * 25e3 / 1.35e7) < 1.5


def test_a_load_by_a_function_that_jumps_is_told():
    """Substeps divide constants, and not a function that reads what a script changes."""
    grid = mpm.create_lattice(MPI.COMM_WORLD, [np.arange(-2, 2.1, 0.5), np.arange(-1, 0.6, 0.5)])
    points = mpm.fill(grid, mpm.Box((-2, -1), (2, 0)), 2, 1700.0)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    pressed = [4e4]
    box, free = mpm.Box((-1.01, 0), (1.01, 0.5)), (False, True, False)
    footing = mpm.RigidBody(box, free=free, force=lambda t: (0.0, -pressed[0]))
    F = mpm.momentum(mpm.materials.Tresca(1e7, 0.3, cohesion=20e3), points, u, v)
    F += mpm.contact(footing, points, u, v)
    bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
    problem = mpm.QuasiStatic(F, u, points, bcs, stabilisation="ghost", max_halvings=1)
    problem.step()
    pressed[0] = 1e8
    with pytest.raises(mpm.errors.ConvergenceError, match=r"function of t that jumps.*Constant"):
        problem.step()
