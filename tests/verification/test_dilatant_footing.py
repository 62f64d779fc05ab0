"""A smooth rigid footing on dilatant ground: what F-bar's refusal of it advises instead.

Prandtl's limit for φ = ψ is q = c cot φ (e^{π tan φ} tan²(45° + φ/2) − 1), 14.83 c at 20°. The cone
of "plane strain" has the same limit loads as Mohr–Coulomb's pyramid.
"""

from __future__ import annotations

import numpy as np
import pytest
from dolfinx import fem, mesh
from mpi4py import MPI

import dolfinmpm as mpm

# m, m, m, Pa, Pa, degrees
WIDTH, DEPTH, HALF_WIDTH, E, COHESION, ANGLE = 15.0, 5.0, 2.0, 1e8, 1e4, 20.0
_TAN = np.tan(np.radians(ANGLE))
LIMIT = (np.exp(np.pi * _TAN) * np.tan(np.radians(45 + ANGLE / 2)) ** 2 - 1) / _TAN


def bearing_factors(h):
    """q/c at settlements of 1, 2, ... 16 mm, with quadratic splines and cells of h (m)."""
    n = round(WIDTH / h), round((DEPTH + 1) / h)
    grid = mesh.create_rectangle(
        MPI.COMM_SELF, [(0, 0), (WIDTH, DEPTH + 1)], n, mesh.CellType.quadrilateral
    )
    points = mpm.fill(grid, mpm.Box((0, 0), (WIDTH, DEPTH)), 2, 1000.0)
    under = mpm.Surface(
        points, lambda x: np.isclose(x[1], DEPTH) & (x[0] < HALF_WIDTH), (0, 1), name="under"
    )
    V = mpm.Space(grid, "bspline2")
    u, v = V.increment, V.test
    settlement = fem.Constant(grid, 0.0)
    law = mpm.materials.DruckerPrager(
        E, 0.33, COHESION, ANGLE, dilation_angle=ANGLE, fit="plane strain"
    )
    footing = mpm.RigidFooting(under, settlement, rough=False, E=E)
    F = mpm.momentum(law, points, u, v) + footing.contact(u, v)
    bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
    stabilisation = mpm.Stabilisation("aggregation", E=E)
    problem = mpm.QuasiStatic(F, u, points, bcs, stabilisation=stabilisation)
    factors = []
    for k in range(1, 17):
        settlement.value = 1e-3 * k
        problem.step()
        factors.append(footing.load() / HALF_WIDTH / COHESION)
    return np.array(factors)


@pytest.mark.long
def test_finer_splines_without_f_bar_approach_the_limit():
    """The stabilisation that the refusal names: a plateau, from above, at first order in h."""
    error = {}
    for h in (0.5, 0.25):
        factors = bearing_factors(h)
        assert 0 < factors[-1] - factors[-3] < 0.01 * LIMIT
        error[h] = factors[-1] / LIMIT - 1
    assert 0 < error[0.25] < 0.12
    assert error[0.25] < 0.6 * error[0.5]
