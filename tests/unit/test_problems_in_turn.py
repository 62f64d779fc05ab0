"""Problems of the same points, one after the other: the second goes on from the state."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from mpi4py import MPI

import dolfinmpm as mpm


def dragged(second, **changes):
    """A disc is pressed into a block and dragged, in four steps; the force on it, and stresses.

    Args:
        second: Whether the last two steps are those of a new form and a new problem.
        changes: Arguments of the second contact.
    """
    grid = mpm.create_lattice(MPI.COMM_WORLD, [np.arange(0, 2.3, 0.25), np.arange(0, 2.1, 0.25)])
    points = mpm.fill(grid, mpm.Box((0.25, 0), (1.75, 1.1)), 2, 1800.0)
    disc = mpm.RigidBody(mpm.Disc((1.0, 1.4), 0.3), increment=(0.02, -0.03))
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    soil = mpm.materials.VonMises(1e6, 0.3, yield_stress=3e4)

    def problem(**options):
        F = mpm.momentum(soil, points, u, v)
        F -= ufl.inner(points.density * ufl.as_vector((0.0, -9.81)), v) * points.dX
        F += mpm.contact(disc, points, u, v, **{"friction": 0.3, **options})
        return mpm.QuasiStatic(F, u, points, mpm.fixed(V, "bottom"), stabilisation="ghost")

    steps = problem()
    for k in range(4):
        steps = problem(**changes) if k == 2 and second else steps
        steps.step()
    return disc.force, points["stress"].copy(), points


def test_a_new_form_goes_on_with_the_friction():
    """A new contact with the same body had begun without tangential forces: they were 0.3 % off."""
    (force, stress, points), (expected, of_one, _) = dragged(True), dragged(False)
    np.testing.assert_allclose(force, expected, rtol=1e-7)
    np.testing.assert_allclose(stress, of_one, atol=1e-7 * np.abs(of_one).max())
    assert "contact2_normal_force" not in points.fields


@pytest.mark.parametrize("changes", [{"penalty": 10.0}, {"tag": 0}])
def test_another_penalty_or_other_points_begin_anew(changes):
    """Forces of one stiffness have no meaning with another one."""
    points = dragged(True, **changes)[2]
    assert "contact2_normal_force" in points.fields
    assert np.abs(points["contact2_normal_force"]).max() > 0.0
