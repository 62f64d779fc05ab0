"""Share of the support of splines in a body, also beside the grid's sides and on leaves."""

from __future__ import annotations

import math

import numpy as np
import pytest
from mpi4py import MPI

import dolfinmpm as mpm
from dolfinmpm.basis.stencils import spread
from dolfinmpm.cut.fractions import support_shares


def shares_of_square(degree, top, cells=4):
    """Shares of all functions of a grid of square cells that is filled up to a height (y, x)."""
    grid = mpm.create_lattice(MPI.COMM_SELF, [np.linspace(0, n, n + 1) for n in (4, cells)])
    points = mpm.fill(grid, mpm.Box((0, 0), (4, top)), 4, 1.0)
    basis = mpm.Space(grid, f"bspline{degree}").basis
    where = points.placement()
    shares = support_shares(where, basis.stencils(where), basis)
    return shares[np.lexsort(basis.halo.node_ijk.T)].reshape(cells + degree, 4 + degree)


@pytest.mark.parametrize("degree", [2, 3])
def test_functions_of_a_full_grid_have_all_their_support(degree):
    assert shares_of_square(degree, 4.0) == pytest.approx(1.0, abs=1e-13)


@pytest.mark.parametrize(("degree", "steeper"), [(2, 1.0), (3, 1.5)])
def test_functions_that_begin_in_a_cut_cell(degree, steeper):
    """As much as elsewhere counts, times what knots at the side of the grid make it steeper."""
    first = degree + 2
    low, high = (shares_of_square(degree, 2.5, cells)[first] for cells in (4, 10))
    assert low == pytest.approx(steeper * high, abs=1e-13)
    # ∫ of t^p/p! from 0 to 1/2
    exact = 0.5 ** (degree + 1) / math.factorial(degree + 1)
    assert high.max() == pytest.approx(exact, rel=0.1)


@pytest.mark.parametrize("degree", [2, 3])
def test_leaves_of_one_size_have_the_shares_of_a_grid(degree):
    grid = mpm.create_lattice(MPI.COMM_SELF, [np.linspace(0, 4, 5)] * 2)
    points = mpm.fill(grid, mpm.Box((0, 0), (4, 2.5)), 4, 1.0)
    V = mpm.Space(grid, f"bspline{degree}", refine=lambda x: np.ones(x.shape[1]), levels=1)
    where, plain = points.placement(), mpm.Space(grid, f"bspline{degree}").basis
    V.refinement.update_leaves(points.placement("updated"), True)
    basis = V.refinement.basis(V.basis, 0, None)
    on_lattice = support_shares(where, plain.stencils(where), plain)
    found = support_shares(where, basis.stencils(where), basis)
    known = {tuple(x): k for k, x in enumerate(np.round(plain.node_coordinates(), 9))}
    same = [known[tuple(x)] for x in np.round(basis.node_coordinates(), 9)]
    assert found == pytest.approx(on_lattice[same], abs=1e-13)


@pytest.mark.parametrize("degree", [2, 3])
def test_points_of_other_fields_count_nowhere(degree):
    grid = mpm.create_lattice(MPI.COMM_SELF, [np.linspace(0, 4, 5)] * 2)
    where = mpm.fill(grid, mpm.Box((0, 0), (4, 2.5)), 4, 1.0).placement()
    basis = mpm.Space(grid, f"bspline{degree}").basis
    rows = np.flatnonzero(where.x[:, 1] < 1.5)
    own = where.of(rows)
    low = basis.stencils(own)
    expected = support_shares(own, low, basis)
    assert expected.min() == 0.0 < expected.max()
    found = support_shares(where, spread(low, rows, len(where.x)), basis)
    assert found == pytest.approx(expected, abs=1e-13)
    none = np.empty(0, int)
    nowhere = spread(basis.stencils(where.of(none)), none, len(where.x))
    assert not support_shares(where, nowhere, basis).any()
