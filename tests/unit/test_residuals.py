"""Residuals of a problem are pure, and prolongations are matrices."""

from __future__ import annotations

import numpy as np
from conftest import Linearised, dense
from test_solver import column, state


def test_residuals_are_pure():
    """Evaluating the residual, as often as one likes, changes no field of the points."""
    problem, g = column(8)
    g.value[1] = -0.25
    problem.step()
    before = state(problem.points)
    linearised = Linearised(problem)
    x = np.random.default_rng(0).uniform(-0.1, 0.1, linearised.size)
    values = [linearised.residual(x) for _ in range(3)]
    assert np.array_equal(values[0], values[2])
    for name, fields in problem.points.fields.items():
        assert np.array_equal(fields, before[name])


def test_prolongation_equals_the_matrix_product():
    """Ties taken into the stencils and blocks give Cᵀ K C and Cᵀ f."""
    from scipy import sparse

    for ghost in (False, True):
        plain, g = column(8, ghost=ghost)
        g.value[1] = -0.25
        plain.step()
        K = plain.stiffness()
        size = plain.here.unknowns.fields[0].row_of.shape[0]
        full = dense(K)
        nodes = plain.here.unknowns.fields[0].nodes
        rows = plain.here.unknowns.fields[0].row_of
        x = plain.fields[0].space.function_space.tabulate_dof_coordinates()
        top = nodes[np.argsort(x[nodes, 1])[-2:]]
        pairs = {}
        for a in top:  # the uppermost nodes continue the line of the two below them
            below = [b for b in nodes if abs(x[b, 0] - x[a, 0]) < 1e-9 and b != a]
            below.sort(key=lambda b: -x[b, 1])
            pairs[a] = {below[0]: 2.0, below[1]: -1.0}

        def tie(stencils, active, size=size, pairs=pairs):
            C = sparse.lil_matrix((size, size))
            C.setdiag(1.0)
            for a, weights in pairs.items():
                C[a, a] = 0.0
                for b, w in weights.items():
                    C[a, b] = w
            C = C.tocsr()
            C.eliminate_zeros()
            return C

        tied, g2 = column(8, ghost=ghost, prolongation=tie)
        for name, values in plain.points.fields.items():
            tied.points.fields[name][...] = values
        reduced = dense(tied.stiffness())
        new_rows = tied.here.unknowns.fields[0].row_of
        C = np.zeros((full.shape[0], reduced.shape[0]))
        for a in nodes:
            for i in range(2):
                if rows[a, i] < 0:
                    continue
                if a in pairs:
                    for b, w in pairs[a].items():
                        C[rows[a, i], new_rows[b, i]] = w
                else:
                    C[rows[a, i], new_rows[a, i]] = 1.0
        np.testing.assert_allclose(reduced, C.T @ full @ C, atol=1e-9 * np.abs(full).max())
        g2.value[1] = -0.5
        assert tied.step().parts >= 1
