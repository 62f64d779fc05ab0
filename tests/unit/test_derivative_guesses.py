"""Where linear solutions of derivatives begin: from changes by other parameters and steps."""

from __future__ import annotations

import functools
import sys
from collections import Counter
from pathlib import Path

import numpy as np

from dolfinmpm import study
from dolfinmpm.solve.linearsolver import LinearSolver
from dolfinmpm.solve.operator import Operator
from dolfinmpm.study import tapedtangent
from dolfinmpm.study.followingruns import FollowingRuns
from dolfinmpm.study.tapedtangent import SpareSolver

sys.path.append(str(Path(__file__).resolve().parents[2] / "demos" / "studies"))
from derivative_scenes import CASES, column


def counted_by_parameter(monkeypatch, owner, name):
    """Counter of the calls of a method, by the parameter that a run follows."""
    counts, present = Counter(), []
    plain, advance = getattr(owner, name), FollowingRuns.advance

    def counted(self, *args, **options):
        counts.update(present[-1:])
        return plain(self, *args, **options)

    def with_name(self, *args):
        present.append(self.name)
        try:
            return advance(self, *args)
        finally:
            present.pop()

    monkeypatch.setattr(owner, name, counted)
    monkeypatch.setattr(FollowingRuns, "advance", with_name)
    return counts


def test_a_change_that_others_contain_needs_one_solution_per_step(monkeypatch):
    # a column under its own weight: density acts as stiffness does, with the other sign
    counts = counted_by_parameter(monkeypatch, LinearSolver, "again")

    def scene(m):
        return column({**m, "nu": 0.2}, dimension=3, steps=1, fine=4, tolerance=1e-9)

    study.differentiate(scene, {"E": 10e3, "density": 80.0})
    assert counts["E"] >= 2
    assert counts["density"] == 1


def test_forces_at_the_solution_are_found_once(monkeypatch):
    counts = counted_by_parameter(monkeypatch, Operator, "_internal")
    # with the tangent at the solution
    monkeypatch.setattr(tapedtangent, "_MANY", 1)
    study.differentiate(functools.partial(column, steps=1), CASES["elastic"][1])
    # before the solution and after it
    assert counts == {"E": 2, "nu": 2, "density": 2}


def test_changes_of_the_last_step_go_on_where_other_nodes_are_active():
    run = column(CASES["elastic"][1], gravity=-20.0, steps=4)
    numberings = []
    for step in run.steps:
        step()
        numberings.append(run.problem.here.unknowns)
    former, present = numberings[-2:]
    assert present.owned < former.owned
    change = np.random.default_rng(1).standard_normal(former.owned)
    spare = SpareSolver(changes=[change], unknowns=former)
    (found,) = spare.take_changes(present)
    assert spare.changes == []
    before, now = (numbering.nodal() for numbering in (former, present))
    for numbering, values, nodal in (former, change, before), (present, found, now):
        numbering.expand(values, numbering.nodal().arrays, nodal)
    nodes = present.fields[0].nodes
    common = np.intersect1d(nodes, former.fields[0].nodes)
    assert common.size > 20
    np.testing.assert_array_equal(now.arrays[0][common], before.arrays[0][common])
    new = np.setdiff1d(nodes, common)
    assert not now.arrays[0][new].any()
