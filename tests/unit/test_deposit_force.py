"""The body force of a deposit: weight, water that flows, and fill that comes later."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from conftest import COMM

import dolfinmpm as mpm
from dolfinmpm._platform.errors import ParameterError

LAYER = mpm.Layer(0.0, 18e3, K0=0.5, saturated_unit_weight=20e3)


class Ground:
    """Ground of a length of 8 m on a fixed base, under its own weight."""

    def __init__(self, height, table):
        self.grid = mpm.create_lattice(COMM, [np.linspace(0, 8, 17), np.linspace(0, 6, 13)])
        ground = mpm.Deposit(4.0, LAYER, water_table=table)
        self.points = mpm.fill(self.grid, mpm.Box((0, 0), (8, height)), 2, ground.density)
        V = mpm.Space(self.grid, "gimp")
        F = mpm.momentum(mpm.materials.Hencky(50e6, 0.3), self.points, V.increment, V.test)
        F -= ufl.inner(ground.body_force(self.points), V.test) * self.points.dX
        self.base = mpm.fixed(V, "bottom")
        self.problem = mpm.QuasiStatic(F, V.increment, self.points, self.base)

    def reaction(self):
        """Force of the base on the ground after a step (N/m)."""
        self.problem.step()
        return mpm.reaction(self.problem, self.base)


def test_water_below_a_sloping_table_drags_the_ground():
    """A table that falls by 1 in 4 takes γ_w/4 per volume; the fixed base carries it."""
    fall = 0.25
    ground = Ground(1, mpm.Terrain(([0, 8],), [4.0, 4.0 - 8 * fall]))
    assert ground.reaction()[0] == pytest.approx(-8 * 9810 * fall, rel=1e-9)
    assert ground.points["seepage_force"] == pytest.approx(9810 * fall, rel=1e-12)


def test_fill_on_a_deposit_has_a_weight():
    """New points had no weight, without a message."""
    ground = Ground(4, lambda x: 3.0 - 0.1 * x[0])
    grid, points = ground.grid, ground.points
    whole = ground.reaction()[1]
    points.remove(points["x0"][:, 1] > 3.0)
    assert ground.reaction()[1] == pytest.approx(whole - 8 * 18e3, rel=1e-6)
    points.add(mpm.fill(grid, mpm.Box((0, 3), (8, 4)), 2, 1800.0))
    assert ground.reaction()[1] == pytest.approx(whole, rel=1e-6)
    bank = mpm.fill(grid, mpm.Box((0, 4), (8, 5)), 2, 1900.0)
    with pytest.raises(ParameterError, match="above the surface of the deposit"):
        points.add(bank)
    bank.add_field("effective_weight", (), "N/m^d", 19e3)
    points.add(bank)
    assert ground.reaction()[1] == pytest.approx(whole + 8 * 19e3, rel=1e-6)
