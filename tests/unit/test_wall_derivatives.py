"""Derivatives of runs against walls, and the kinks that are told there."""

from __future__ import annotations

import sys
from functools import partial
from pathlib import Path

import pytest
import ufl
from conftest import unit_grid
from dolfinx import fem

import dolfinmpm as mpm
from dolfinmpm import study
from dolfinmpm.study.branches import Marks

sys.path.append(str(Path(__file__).resolve().parents[2] / "demos" / "studies"))
from derivative_scenes import errors_of
from onesided import around_kink, check_at_kink

AT = {"E": 1e5, "friction": 0.2, "push": 0.01, "along": 0.004, "gap": 0.001}
WALL = "markers of walls begin or end to touch or slip"


def pushed(m, steps=4):
    """A block whose left face is moved is pushed against a wall, and along it."""
    grid = unit_grid("quadrilateral", 5)
    points = mpm.fill(grid, mpm.Box((0.0, 0.2), (1.0, 0.6)), 2, 1000.0)
    points["x"][:, 0] -= m["gap"] * points["x"][:, 0]
    law = mpm.materials.Hencky(m["E"], 0.2)
    V = mpm.Space(grid, "gimp")
    F = mpm.momentum(law, points, V.increment, V.test)
    # it sags, so that no two markers touch at the same time
    F -= points.density * ufl.dot(ufl.as_vector((0.0, -0.5)), V.test) * points.dX
    wall = mpm.Boundary.from_side(points, "right")
    F += mpm.signorini(wall, V.increment, V.test, law=law, friction=m["friction"])
    push, along = fem.Constant(grid, m["push"] / 4), fem.Constant(grid, 0.0)
    bcs = [
        *mpm.prescribed(V, "left", 0, increment=push),
        *mpm.prescribed(V, "left", 1, increment=along),
    ]
    problem = mpm.QuasiStatic(F, V.increment, points, bcs, tolerance=1e-12, stabilisation="ghost")

    def step(k):
        along.value = m["along"] * k / 4
        problem.step()

    places = {"force": wall.force, "mean": lambda: points["x"].mean(axis=0)}
    return study.Run(problem, [partial(step, k) for k in range(steps)], places)


def sets_of(parameters, steps):
    """Markers that touch and that slip in the last of some steps."""
    run = pushed(parameters)
    marks = Marks(run.problems)
    for step in run.steps[:steps]:
        marks.begin()
        step()
    return [numbers.tolist() for numbers in marks.end()[WALL][0]]


def test_derivatives_are_differences_of_whole_runs():
    found = study.differentiate(pushed, AT)
    assert not found.notes
    assert all(abs(d).max() > 1e-9 for d in found.derivatives["force"].values())
    assert max(errors_of(pushed, AT, found, h=1e-5).values()) < 1e-5


@pytest.mark.parametrize(
    ("name", "ends", "step", "side"),
    [
        pytest.param("friction", (0.05, 0.9), 3, 0, marks=pytest.mark.long),
        pytest.param("gap", (0.001, 0.02), 2, 1, marks=pytest.mark.long),
        pytest.param("friction", (0.05, 0.9), 3, 1, marks=pytest.mark.long),
        pytest.param("gap", (0.001, 0.02), 2, 0, marks=pytest.mark.long),
    ],
)
def test_a_kink_within_the_perturbation_is_told(name, ends, step, side):
    # with friction the way of Newton's method may decide whether a marker touches
    fixed = AT | ({"friction": 0.0} if name == "gap" else {})
    # not nearer to the kink than what the solver leaves
    found = around_kink(lambda m: sets_of(fixed | {name: m}, step), ends, 30)

    def one(m):
        return pushed({**fixed, **m}, steps=step)

    check_at_kink(one, name, found, side, WALL, share=1e-4, least=1e-7)
