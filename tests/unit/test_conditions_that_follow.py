"""Essential conditions whose place is asked for anew in every step."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import unit_grid
from dolfinx import fem

import dolfinmpm as mpm
from dolfinmpm._platform.errors import ParameterError

EDGE = {"top": 1.0}


def lowered(x):
    """The left side, below an edge that comes down."""
    return (np.abs(x[0]) < 1e-9) & (x[1] < EDGE["top"] + 1e-9)


def body():
    grid = unit_grid("quadrilateral", 8)
    return mpm.fill(grid, mpm.Box((0, 0), (0.6, 0.8)), 2, 1000.0)


def block(bcs, kind=mpm.QuasiStatic, configuration="updated", points=None, **options):
    points = body() if points is None else points
    V = mpm.Space(points.grid, "gimp", configuration=configuration)
    law = mpm.materials.Hencky(E=1e5, nu=0.3)
    F = mpm.momentum(law, points, V.increment, V.test)
    F -= 2000.0 * (V.test[0] - V.test[1]) * points.dX
    held = [*mpm.fixed(V, "bottom"), *bcs(V)]
    return kind(F, V.increment, points, held, **options)


def follows(V):
    return mpm.prescribed(V, lowered, 0, follows=True)


def held_by(problem):
    """How many nodes are held sideways."""
    return problem.here.unknowns.fields[0].fixed[:, 0].sum()


def test_each_step_holds_what_is_there_then():
    """As problems that are built anew for every step with a place of its own."""
    EDGE["top"] = 1.0
    problem = block(follows, stabilisation="ghost")
    other = body()
    held = []
    for top in (1.0, 1.0, 0.5, 0.25, 0.75):
        EDGE["top"] = top
        problem.step()
        held.append(held_by(problem))
        block(follows, points=other, stabilisation="ghost").step()
        np.testing.assert_allclose(problem.points["x"], other["x"], rtol=0, atol=1e-10)
    assert held[0] == held[1] > held[4] > held[2] > held[3]


def test_nobody_may_be_there():
    EDGE["top"] = -1.0
    problem = block(lambda V: follows(V))
    problem.step()
    EDGE["top"] = 1.0
    none = held_by(problem)
    problem.step()
    assert held_by(problem) > none


def test_explicit_steps_ask_too():
    EDGE["top"] = 0.5
    problem = block(follows, mpm.Explicit)
    assert "follows" in problem.unfused
    problem.step(1e-3)
    held = held_by(problem)
    EDGE["top"] = 1.0
    problem.step(2e-3)
    assert held_by(problem) == held + 5


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda V: mpm.prescribed(V, "left", 0, follows=True), "function of positions"),
        (
            lambda V: mpm.prescribed(V, lowered, 0, increment=lambda x: x[0], follows=True),
            "a constant",
        ),
        (lambda V: mpm.prescribed(V, lambda x: "no", 0, follows=True), "function of places"),
    ],
)
def test_what_does_not_follow(make, text):
    with pytest.raises(ParameterError, match=text):
        block(make)


def test_first_positions_stay():
    EDGE["top"] = 1.0
    with pytest.raises(ParameterError, match="first positions"):
        block(follows, configuration="total")


def test_a_constant_follows():
    EDGE["top"] = 0.5

    def pushed(V):
        push = fem.Constant(V.grid, 0.01)
        return mpm.prescribed(
            V, lambda x: lowered(x) & (x[1] > 0.05), 0, increment=push, follows=True
        )

    problem = block(pushed)
    x0 = problem.points["x"].copy()
    problem.step()
    near = (x0[:, 0] < 0.04) & (x0[:, 1] < 0.4) & (x0[:, 1] > 0.1)
    way = problem.points["x"][near, 0] - x0[near, 0]
    assert near.any()
    np.testing.assert_allclose(way, 0.01, atol=4e-3)
