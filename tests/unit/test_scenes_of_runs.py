"""Scenes of studies that are no functions of their parameters alone: refused, or told."""

from __future__ import annotations

import itertools

import pytest
import ufl
from conftest import COMM
from dolfinx import fem

import dolfinmpm as mpm
from dolfinmpm import study
from dolfinmpm._platform.errors import ParameterError


def parts(density=2000.0):
    grid = mpm.create_lattice(COMM, [range(2), range(5)])
    points = mpm.fill(grid, mpm.Box((0, 0), (1, 3)), per_cell=2, density=density)
    return grid, points, mpm.Space(grid, "gimp")


def column(m, of=None, body=None):
    grid, points, V = of or parts(m.get("density", 2000.0))
    u, v, g = V.increment, V.test, fem.Constant(grid, (0.0, -10.0))
    F = mpm.momentum(mpm.materials.Hencky(m["E"], 0.0), points, u, v)
    F -= ufl.inner(points.density * g, v) * points.dX
    if body is not None:
        F += mpm.contact(body, points, u, v)
    bcs = mpm.fixed(V, "bottom") + mpm.rollers(V, "left", "right")
    problem = mpm.QuasiStatic(F, u, points, bcs)
    top = mpm.probe(points, (0.5, 3.0))
    return study.Run(problem, [problem.step], {"way": lambda: -top.displacement[1]})


def test_runs_of_the_same_points_or_bodies():
    shared = parts()
    with pytest.raises(ParameterError, match="for the material points at two values of E"):
        study.differentiate(lambda m: column(m, shared), {"E": 1e7})
    tool = mpm.RigidBody(mpm.Plane((0.0, 3.5), (0.0, -1.0)), name="plate")
    with pytest.raises(ParameterError, match="the rigid body 'plate' at two values of E"):
        study.differentiate(lambda m: column(m, body=tool), {"E": 1e7})


def test_runs_that_go_on_from_the_end_of_another():
    shared = parts()
    limit = study.LimitState(lambda m: column(m, shared), "way", {"E": 1e5})
    first = limit([1e7])
    with pytest.raises(ParameterError, match=r"the same 12 material points before.*given=True"):
        limit([2e7])
    own = study.LimitState(column, "way", {"E": 1e5})
    assert own([1e7]) == pytest.approx(first, rel=1e-9)
    assert own([2e7]) == pytest.approx(first / 2, rel=0.01)


def test_scenes_with_a_counter_and_parameters_without_effect():
    calls = itertools.count()
    found = study.differentiate(
        lambda m: column({**m, "density": 2000.0 + next(calls)}), {"E": 1e7, "depth": 3.0}
    )
    assert any("same at the same parameters" in note for note in found.notes)
    # E itself has its effect, and nothing is told of it
    found = study.differentiate(column, {"E": 1e7, "depth": 3.0})
    (note,) = found.notes
    assert note.startswith("depth: no figure changes")


def test_a_figure_that_returns_nothing():
    def scene(m):
        run = column(m)
        return study.Run(run.problem, run.steps, {"way": lambda: None})

    with pytest.raises(ParameterError, match=r"measured\['way'\] = None must be numbers"):
        study.differentiate(scene, {"E": 1e7})
