"""A run that finds its mass singular gives it a ghost penalty: the state knows it."""

from __future__ import annotations

import numpy as np
import pytest
from dolfinx import fem
from mpi4py import MPI

import dolfinmpm as mpm


def wet_block():
    """A wet block in quadratic splines that falls into its bottom, and its mixture's density."""
    grid = mpm.create_lattice(MPI.COMM_WORLD, [np.arange(-1.0, 6.0), np.arange(-1.0, 7.0)])
    points = mpm.fill(grid, mpm.Box((0, 0), (4, 3.6)), per_cell=2, density=2000.0)
    V, Q = mpm.Space(grid, "bspline2"), mpm.Space(grid, "gimp", shape=())
    points.add_field("velocity", (2,), "m/s", lambda x: np.stack([0.2 * np.sin(x[1]), 0 * x[0]], 1))
    fields, gravity = (V.increment, Q.increment), fem.Constant(grid, (0.0, -10.0))
    F = mpm.poromechanics(
        mpm.materials.Hencky(1e6, 0.3), points, fields, (V.test, Q.test), permeability=1e-3,
        porosity=0.4, gravity=gravity,
    )  # fmt: skip
    bcs = mpm.prescribed(V, lambda x: x[1] < 1e-6, 1) + mpm.prescribed(V, lambda x: x[0] < 1e-6, 0)
    bcs += mpm.prescribed(Q, lambda x: x[0] > 3 - 1e-6, 0, value=0.0)
    return mpm.Newmark(F, list(fields), points, bcs, tolerance=1e-10)


@pytest.mark.filterwarnings("ignore::dolfinmpm._platform.errors.SingularMassWarning")
@pytest.mark.parametrize("again", [False, True])
def test_a_run_with_a_late_ghost_mass_goes_on_from_a_checkpoint(tmp_path, again):
    """The penalty has the density at which it began, which the water has changed since."""
    path = MPI.COMM_WORLD.bcast(tmp_path / "run.npz")
    whole = wet_block()
    for k in range(4):
        if k == (0 if again else 2):
            whole.save(path)
        whole.step(0.02 * (k + 1))
    assert not whole.motion.rule.by_forces
    x = whole.points["x"].copy()
    rest = whole if again else wet_block()
    rest.load(path)
    assert rest.motion.rule.by_forces == again
    for k in range(len(rest.history), 4):
        rest.step(0.02 * (k + 1))
    np.testing.assert_array_equal(rest.points["x"], x)
