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


def test_load_of_a_stiff_rigid_body_is_in_balance_with_the_base():
    """With a penalty of 100 the load was a quarter more than the base carried."""
    h = 1.0 / 16
    lines = [np.arange(65) * h, np.arange(34) * h]
    grid = mpm.create_lattice(MPI.COMM_WORLD, lines)
    points = mpm.fill(grid, mpm.Box((0, 0), (4, 2)), per_cell=2, density=1e3)
    V = mpm.Space(grid, "gimp")
    clay = mpm.materials.Tresca(1e8, 0.33, cohesion=10e3)
    F = mpm.momentum(clay, points, V.increment, V.test, fbar=True)
    box = mpm.RigidBody(mpm.Box((-1, 2), (1, 3)), increment=(0, -10e-3), name="box")
    F += mpm.contact(box, points, V.increment, V.test, penalty=100.0)
    base = mpm.fixed(V, "bottom")
    bcs = mpm.rollers(V, "left", "right") + base
    options = {"stabilisation": "aggregation", "tolerance": 1e-4}
    problem = mpm.QuasiStatic(F, V.increment, points, bcs, **options)
    problem.step()
    assert box.force[1] == pytest.approx(mpm.reaction(problem, base)[1], rel=1e-2)
