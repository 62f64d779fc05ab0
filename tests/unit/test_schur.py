"""What stands for the Schur complement of a pressure is as large as it, on any grid."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import dense
from petsc4py import PETSc
from scipy import linalg
from test_poromechanics import block, held, problem_of

from dolfinmpm.solve.schur import schur_matrix


def ends(n, permeability):
    """Smallest and largest eigenvalue of Ŝ⁻¹ S on n cells, with a cut top."""
    F, points, V, Q, _ = block(height=0.8, n=n, permeability=permeability)
    problem = problem_of(F, points, V, Q, held(V), stabilisation="ghost")
    A = problem.stiffness()
    unknowns = problem.here.unknowns
    u, p = (np.flatnonzero(unknowns.only(k, np.ones(unknowns.owned))) for k in range(2))
    rows = [PETSc.IS().createGeneral(r.astype(np.int32)) for r in (u, p)]
    K, found = dense(A), dense(schur_matrix(A, *rows))
    S = K[np.ix_(p, p)] - K[np.ix_(p, u)] @ linalg.solve(K[np.ix_(u, u)], K[np.ix_(u, p)])
    values = linalg.eigvals(S, found)
    assert np.abs(values.imag).max() < 1e-6
    return values.real.min(), values.real.max()


@pytest.mark.parametrize(
    ("n", "permeability"),
    [(6, 0.0), *(pytest.param(n, k, marks=pytest.mark.long) for n in (6, 20) for k in (1e-3, 1e2))],
)
def test_it_is_as_large_as_the_true_one(n, permeability):
    low, high = ends(n, permeability)
    assert 0.1 < low <= high < 1.6
