"""Newton's method where rounding of strains bounds the balance of forces."""

import numpy as np
import pytest
from dolfinx import fem
from mpi4py import MPI

import dolfinmpm as mpm


@pytest.mark.parametrize("basis", ["gimp", "bspline2"])
def test_rounded_strains_of_nearly_incompressible_soil_end_the_iterations(basis):
    """A pressure of 1 kPa on stiff undrained clay: forces balance to 1e-8 only, at any step."""
    grid = mpm.create_lattice(MPI.COMM_WORLD, [range(9), range(9)])
    points = mpm.fill(grid, mpm.Box((0, 0), (8, 7)), 2, 1900.0)
    V = mpm.Space(grid, basis)
    u, v = V.increment, V.test
    top = mpm.Surface(points, lambda x: np.isclose(x[1], 7) & (x[0] < 2), (0, 1))
    load = fem.Constant(grid, (0.0, -1e3))
    F = mpm.momentum(mpm.materials.Hencky(50e6, 0.499), points, u, v, fbar=True)
    F += top.traction(load, v)
    bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
    record = mpm.QuasiStatic(F, u, points, bcs).step()
    assert record.halvings == 0
    assert record.iterations < 9
    assert record.residuals[-1] < 1e-7
    settled = -top.mean_displacement()[1]
    assert settled == pytest.approx(3.6e-5, rel=0.05)
