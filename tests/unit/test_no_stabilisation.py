"""A stabilisation that a scene does not use costs it nothing."""

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
STABILISATIONS = ("ghost", "aggregation", "weak-aggregation", "extended", "soft")
# where all of the stabilisations' own work is done
MODULES = ("stabilisations", "penalties", "aggregation", "fractions", "prolongation", "krylov")


def column(basis, stabilisation="none"):
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
    problem = mpm.QuasiStatic(F, V.increment, points, bcs, stabilisation=stabilisation)
    gravity.value[1] = -1.0
    return problem


def calls_in_a_step(problem):
    """How often a step calls each function of stabilisations, facets and active cells."""
    called: Counter[str] = Counter()

    def see(frame, event, _):
        path, name = Path(frame.f_code.co_filename), frame.f_code.co_name
        if event != "call" or len(path.parts) < 3 or path.parts[-3] != "dolfinmpm":
            return
        if path.stem in MODULES or (path.stem, name) == ("activecells", "select"):
            called[f"{path.stem}.{name}"] += 1

    sys.setprofile(see)
    try:
        record = problem.step()
    finally:
        sys.setprofile(None)
    assert record.parts == 1
    return called


@pytest.mark.parametrize("basis", BASES)
def test_without_a_stabilisation_its_code_does_not_run(basis):
    """Not a function of it, after the first step, which asks whether nodes are tied."""
    problem = column(basis)
    problem.step()
    assert not calls_in_a_step(problem)


@pytest.mark.parametrize("stabilisation", STABILISATIONS)
def test_with_a_stabilisation_it_does(stabilisation):
    """So that the test above cannot pass because it looks in the wrong place."""
    problem = column("gimp", stabilisation)
    problem.step()
    assert calls_in_a_step(problem)


@pytest.mark.parametrize("basis", BASES)
def test_without_a_stabilisation_nothing_of_it_is_needed(basis, monkeypatch):
    """Facets, fill fractions, ties, continued stencils and terms of UFL may all be broken."""

    def broken(*_, **__):
        raise AssertionError("a stabilisation that is not used was run")

    for name in (
        "cut.stabilisations.constraint_matrix", "cut.stabilisations.fill_fractions",
        "cut.stabilisations.support_shares",
        "cut.penalties.ghost", "cut.penalties.soft", "cut.stabilisations.Stabilisation.penalty",
        "cut.fractions.domain_shares", "cut.activecells.GhostFacets.__init__",
        "cut.activecells.GhostFacets.select", "cut.activecells.ghost_facets",
        "cut.activate.Prolongation", "cut.activate.mesh_roots",
        "assembly.gridassembler.reduce_blocks", "assembly.gridassembler.compile_form",
        "solve.operator.add_product", "solve.operator.add_blocks",
    ):  # fmt: skip
        monkeypatch.setattr(f"dolfinmpm.{name}", broken)
    problem = column(basis)
    problem.step()
    assert problem.history[-1].residuals[-1] < 1e-9
    (field,) = problem.here.fields
    assert not problem.form.softened
    assert not problem.here.blocks_of("stiffness")
    assert not problem.here.blocks_of("soft")
    assert field.C is None
    assert not problem.here.blocks_of("penalty")
    assert field.entities == {}
    assert field.stencils is field.full_stencils


@pytest.mark.parametrize("basis", BASES)
def test_without_a_stabilisation_the_pattern_is_that_of_the_points(basis):
    """Entries for nodes that a point sees together, and no more; a ghost penalty adds some."""
    problem = column(basis)
    entries = problem.stiffness().getInfo()["nz_used"]
    unknowns, stencils = problem.here.unknowns.fields[0], problem.here.fields[0].full_stencils
    seen = [stencils.nodes[a:b] for a, b in zip(stencils.node_start[:-1], stencils.node_start[1:])]
    pairs = {(int(a), int(b)) for nodes in seen for a in nodes for b in nodes}
    free = (~unknowns.fixed).sum(axis=1)
    assert entries == sum(free[a] * free[b] for a, b in pairs)
    widened = column(basis, "ghost")
    widened.step()
    assert widened.stiffness().getInfo()["nz_used"] > entries
