"""A remedy that a scene does not use costs it nothing."""

from __future__ import annotations

import sys
from collections import Counter
from pathlib import Path

import pytest
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

import dolfinmpm as mpm

BASES = ("linear", "gimp", "bspline2", "bspline3")
REMEDIES = ("ghost", "aggregation", "weak-aggregation", "extended", "soft")
# where all of the remedies' own work is done
MODULES = ("stabilise", "aggregate", "fractions", "prolong", "ordinary")


def column(basis, remedy="none"):
    """A column, cut at its top, under half of a small weight."""
    n, h = 6, 1.0
    grid = mesh.create_rectangle(
        MPI.COMM_WORLD, [(0, 0), (h, (n + 2) * h)], (1, n + 2), mesh.CellType.quadrilateral
    )
    per_cell = 3 if basis == "bspline3" else 2
    points = mpm.fill(grid, mpm.Box((0, 0), (h, (n + 0.6) * h)), per_cell, 1.0)
    V = mpm.Space(grid, basis)
    gravity = fem.Constant(grid, (0.0, 0.0))
    F = mpm.momentum(mpm.materials.Hencky(E=1e3, nu=0.0), points, V.increment, V.test)
    F -= ufl.inner(points.density * gravity, V.test) * points.dX
    bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
    problem = mpm.QuasiStatic(F, V.increment, points, bcs, stabilisation=remedy)
    gravity.value[1] = -1.0
    return problem


def calls_in_a_step(problem):
    """How often a step calls each function of the remedies, and of facets and active cells."""
    called: Counter[str] = Counter()

    def see(frame, event, _):
        path, name = Path(frame.f_code.co_filename), frame.f_code.co_name
        if event != "call" or path.parent.name != "dolfinmpm":
            return
        if path.stem in MODULES or (path.stem, name) in (
            ("active", "select"),
            ("active", "active_cells"),
        ):
            called[f"{path.stem}.{name}"] += 1

    sys.setprofile(see)
    try:
        record = problem.step()
    finally:
        sys.setprofile(None)
    assert record.parts == 1
    return called


@pytest.mark.parametrize("basis", BASES)
def test_without_a_remedy_its_code_does_not_run(basis):
    """One question is asked a step, whether there are ties, and answered with None."""
    assert calls_in_a_step(column(basis)) == {"stabilise.ties": 1}


@pytest.mark.parametrize("remedy", REMEDIES)
def test_with_a_remedy_it_does(remedy):
    """So that the test above cannot pass because it looks in the wrong place."""
    called = calls_in_a_step(column("gimp", remedy))
    assert sum(called.values()) > 1


@pytest.mark.parametrize("basis", BASES)
def test_without_a_remedy_nothing_of_it_is_needed(basis, monkeypatch):
    """Facets, fill fractions, ties, continued stencils and terms of UFL may all be broken."""

    def broken(*_, **__):
        raise AssertionError("a remedy that is not used was run")

    for name in (
        "stabilise.ties", "stabilise.fill_fractions", "stabilise.support_shares",
        "stabilise.ghost", "stabilise.soft", "stabilise.Stabilisation.penalty",
        "fractions.domain_shares", "active.GhostFacets.__init__", "active.GhostFacets.select",
        "solve.newton.ghost_facets", "solve.newton.active_cells", "solve.newton.Prolongation",
        "solve.newton.reduce_blocks", "solve.newton.OrdinaryAssembler",
        "solve.newton.multiply_blocks", "solve.newton.add_blocks",
    ):  # fmt: skip
        monkeypatch.setattr(f"dolfinmpm.{name}", broken)
    problem = column(basis)
    problem.step()
    assert problem.history[-1].residuals[-1] < 1e-9
    system = problem.system
    for unused in (system.ordinary, system._tangent_only, system._facets, system._penalty):
        assert unused is None
    # splines' values at Lagrange nodes are all that _T may hold
    assert system._T is system._extraction


@pytest.mark.parametrize("basis", BASES)
def test_without_a_remedy_the_pattern_is_that_of_the_points(basis):
    """Entries for nodes that a point sees together, and no more; a ghost penalty adds some."""
    problem = column(basis)
    problem.step()
    unknowns, stencils = problem.system.unknowns, problem.system.stencils
    seen = [stencils.nodes[a:b] for a, b in zip(stencils.node_start[:-1], stencils.node_start[1:])]
    pairs = {(int(a), int(b)) for nodes in seen for a in nodes for b in nodes}
    free = (~unknowns.fixed).sum(axis=1)
    entries = problem.system.tangent_matrix().getInfo()["nz_used"]
    assert entries == sum(free[a] * free[b] for a, b in pairs)
    widened = column(basis, "ghost")
    widened.step()
    assert widened.system.tangent_matrix().getInfo()["nz_used"] > entries
