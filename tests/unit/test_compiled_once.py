"""Nothing is compiled again for another number, mesh, count of points or time."""

from __future__ import annotations

import itertools

import pytest
import ufl
from conftest import COMM
from dolfinx import fem, jit, mesh

import dolfinmpm as mpm
from dolfinmpm._platform import jit as loaded


@pytest.fixture
def compiled(tmp_path, monkeypatch):
    """A function that names what has been compiled into an empty cache so far."""
    monkeypatch.setitem(jit.DOLFINX_DEFAULT_JIT_OPTIONS, "cache_dir", (tmp_path, ""))
    # what this process has loaded is not compiled again
    monkeypatch.setattr(loaded, "_compiled", {})
    return lambda: {path.name for path in tmp_path.glob("*.c")}


def settle(basis, n, size, per_cell, moduli, stabilisation, cell=mesh.CellType.quadrilateral):
    """A body that takes its weight, with a stabilisation of given numbers."""
    grid = mesh.create_rectangle(COMM, [(0, 0), (size, size)], (n, n), cell)
    body = mpm.Box((0, 0), (size, 0.6 * size))
    points = mpm.fill(grid, body, per_cell=per_cell, density=1000.0 * size)
    V = mpm.Space(grid, basis)
    law = mpm.materials.Hencky(*moduli)
    g = fem.Constant(grid, (0.0, -size))
    F = mpm.momentum(law, points, V.increment, V.test)
    F -= ufl.inner(points.density * g, V.test) * points.dX
    bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
    stabilisation = mpm.Stabilisation(**stabilisation)
    problem = mpm.QuasiStatic(F, V.increment, points, bcs, stabilisation=stabilisation)
    problem.step()
    return problem


@pytest.mark.parametrize("basis", ["gimp", "bspline2"])
@pytest.mark.parametrize(
    ("first", "second"),
    [
        ({"kind": "ghost"}, {"kind": "ghost", "E": 3e5, "factor": 0.7}),
        ({"kind": "soft"}, {"kind": "soft", "E": 3e5, "nu": 0.1, "eta": 2e-3}),
    ],
    ids=["ghost", "soft"],
)
def test_other_numbers(basis, first, second, compiled):
    settle(basis, 4, 1.0, 2, (1e6, 0.3), first)
    once = compiled()
    assert once
    settle(basis, 6, 2.5, 3, (3e6, 0.2), second)
    assert compiled() == once


def test_whatever_was_made_before(compiled, monkeypatch):
    """UFL numbers all constants, functions and variables that a process makes."""
    settle("gimp", 4, 1.0, 2, (1e6, 0.3), {"kind": "ghost"})
    once = compiled()
    for first in (992, 995, 998):
        # numbers of other lengths are sorted otherwise
        for kind in (ufl.Constant, ufl.Coefficient):
            monkeypatch.setattr(kind, "_counter", itertools.count(first))
        settle("gimp", 4, 1.0, 2, (1e6, 0.3), {"kind": "ghost"})
    assert compiled() == once


def test_laws_in_ufl(compiled):
    def energy(strain, G, K):
        mean = sum(strain) / 3
        return G * sum((e - mean) ** 2 for e in strain) + 4.5 * K * mean**2

    mpm.materials.EnergyWithYield(energy, G=1e5, K=2e5)
    once = compiled()
    assert len(once) == 1
    mpm.materials.EnergyWithYield(energy, G=3e5, K=4e5)
    assert compiled() == once


@pytest.mark.parametrize("basis", ["linear", "gimp", "bspline2"])
def test_ghost_penalties_on_rectangular_grids_compile_nothing(basis, compiled):
    """One element tensor for all facets that are alike is made without FFCx."""
    settle(basis, 4, 1.0, 2, (1e6, 0.3), {"kind": "none"})
    without = compiled()
    assert without
    settle(basis, 4, 1.0, 2, (1e6, 0.3), {"kind": "ghost"})
    assert compiled() == without


def test_ghost_penalties_on_other_grids_compile_one_form(compiled):
    settle("linear", 4, 1.0, 2, (1e6, 0.3), {"kind": "none"}, mesh.CellType.triangle)
    without = compiled()
    settle("linear", 4, 1.0, 2, (1e6, 0.3), {"kind": "ghost"}, mesh.CellType.triangle)
    assert len(compiled() - without) == 1
