"""Shares of domains in cells, for averages over cells."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

import dolfinmpm as mpm
from dolfinmpm.basis.lineweights import INNER
from dolfinmpm.cut.cellaverages import CellAverages, sharing_stencils
from dolfinmpm.materials import Hencky

CELL = 0.25
HALF = 0.0625


def shares_of(x, levels=0):
    """Shares of one square domain in cells of 1/4, by the cells' lower corners."""
    grid = mpm.create_lattice(MPI.COMM_SELF, [np.linspace(0, 1, 5)] * 2)
    points = mpm.fill(grid, mpm.Box((0, 0), (CELL, CELL)), 1, 1.0)
    points["x"], points["l"] = x, (HALF, HALF)
    if levels:
        V = mpm.Space(grid, "gimp", refine=lambda x: np.full(x.shape[1], CELL), levels=levels)
        where = points.placement("updated")
        V.refinement.update_leaves(where, True)
        basis = V.refinement.basis(V.basis, 0, None)
    else:
        basis, where = mpm.Space(grid, "gimp").basis, points.placement()
    stencils = sharing_stencils(where, basis.stencils(where), basis)
    shares = CellAverages(where.volume, where, stencils, basis).shares
    low = basis.cell_corners()[0]
    assert shares.values.sum() == pytest.approx(1.0, abs=1e-15)
    at = (tuple(np.round(low[c] / CELL).astype(int)) for c in shares.of)
    return {cell: share for cell, share in zip(at, shares.values, strict=True) if share}


@pytest.mark.parametrize("levels", [0, 1])
def test_a_domain_that_reaches_over_a_line_has_shares_in_both_cells(levels):
    found = shares_of((CELL - 0.25 * HALF, 1.5 * CELL), levels)
    assert set(found) == {(0, 1), (1, 1)}
    # of the inner part of the domain
    assert found[1, 1] == pytest.approx(0.5 - 0.125 / INNER, rel=1e-12)


@pytest.mark.parametrize("levels", [0, 1])
def test_a_domain_that_reaches_over_a_line_by_little_has_no_share_there(levels):
    assert shares_of((CELL - 0.999 * HALF, 1.5 * CELL), levels) == {(0, 1): 1.0}
    # beyond, the share grows from zero, without a jump
    found = shares_of((CELL - (INNER - 1e-6) * HALF, 1.5 * CELL), levels)
    assert found[1, 1] == pytest.approx(0.5e-6, rel=0.01)


def test_tiny_motions_couple_no_further_nodes_than_domains_do():
    """Domains beside grid lines: F-bar must not fill the tangent after the first step."""
    entries = {}
    for fbar in (False, True):
        grid = mpm.create_lattice(MPI.COMM_SELF, [np.linspace(0, 1, 5)] * 2)
        points = mpm.fill(grid, mpm.Box((0, 0), (1, 0.5)), 2, 1.0)
        V = mpm.Space(grid, "gimp")
        F = mpm.momentum(Hencky(20.0, 0.3), points, V.increment, V.test, fbar=fbar)
        for shift in (1e-5, 0.1):
            points["x"] += shift * HALF
            problem = mpm.QuasiStatic(F, V.increment, points, mpm.fixed(V, "bottom"))
            problem.activate()
            entries[fbar, shift] = problem.here.pattern.indices.size
    assert entries[True, 1e-5] == entries[False, 1e-5]
    assert entries[True, 0.1] > entries[False, 0.1]
