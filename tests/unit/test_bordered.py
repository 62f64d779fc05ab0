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
