"""The load of a stiff footing is in balance with the supports, whatever the tolerance."""

import numpy as np
import pytest
from dolfinx import fem
from mpi4py import MPI

import dolfinmpm as mpm


def footing_on_clay(tolerance, stabilisation="aggregation"):
    """Loads of a smooth footing and of the base (N/m), c = 10 kPa, in steps of 2 mm."""
    h = 0.125
    grid = mpm.create_lattice(MPI.COMM_WORLD, [np.arange(0.0, n * h + 0.01, h) for n in (32, 17)])
    points = mpm.fill(grid, mpm.Box((0, 0), (4, 2)), per_cell=2, density=1e3)
    V = mpm.Space(grid, "gimp")
    clay = mpm.materials.Tresca(1e8, 0.33, cohesion=10e3)
    F = mpm.momentum(clay, points, V.increment, V.test, fbar=True)
    under = mpm.Surface(points, lambda x: np.isclose(x[1], 2.0) & (x[0] < 1), normal=(0, 1))
    settlement = fem.Constant(grid, 0.0)
    footing = mpm.RigidFooting(under, settlement, rough=False, E=1e8)
    F += footing.contact(V.increment, V.test)
    base = mpm.fixed(V, "bottom")
    bcs = mpm.rollers(V, "left", "right") + base
    options = {"stabilisation": stabilisation, "tolerance": tolerance}
    problem = mpm.QuasiStatic(F, V.increment, points, bcs, **options)
    loads = []
    for k in range(1, 6):
        settlement.value = 2e-3 * k
        problem.step()
        loads.append((footing.load(), mpm.reaction(problem, base)[1]))
    return np.array(loads)


@pytest.mark.parametrize("tolerance", [1e-4, 1e-6])
def test_load_is_in_balance_with_the_base(tolerance):
    """Forces at zero increments are those of the stiff footing, 10⁵ times the load.

    Out-of-balance forces of a millionth of these were taken for balance, and the load was wrong by
    a part of itself.
    """
    loads = footing_on_clay(tolerance)
    assert loads[:, 0] == pytest.approx(loads[:, 1], rel=1e-3)
    assert np.all((loads[:, 0] > 51e3) & (loads[:, 0] < 56e3))
