"""Derivatives of runs with free rigid bodies and footings."""

from __future__ import annotations

import sys
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from dolfinx import fem

import dolfinmpm as mpm
from dolfinmpm import study

sys.path.append(str(Path(__file__).resolve().parents[2] / "demos" / "studies"))
from derivative_scenes import errors_of, grid_of, history_of, motion_of

IMPACT = {"vx": 0.5, "gap": 0.005}


def impact(m, steps=4, dt=0.004, penalty=5.0):
    """A free rigid disc falls on an elastic block, which it meets in the second step."""
    grid = grid_of((3.0, 2.0), (12, 8))
    points = mpm.fill(grid, mpm.Box((0.8, 0.3), (2.2, 0.9)), 2, 1000.0)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    ball = mpm.RigidBody(
        mpm.Disc((1.4, 1.2 + m["gap"]), 0.3), mass=100.0, inertia=4.5,
        velocity=(m["vx"], -1.0), name="ball",
    )  # fmt: skip
    F = mpm.momentum(mpm.materials.Hencky(2e6, 0.3), points, u, v)
    F += mpm.contact(ball, points, u, v, penalty=penalty)
    problem = mpm.Newmark(F, u, points, [], stabilisation="ghost", tolerance=1e-10)
    moves = [partial(problem.step, dt * (k + 1)) for k in range(steps)]
    measured = {"position": lambda: ball.position, "motion": motion_of(points)}
    return study.Run(problem, moves, measured)


def test_a_body_in_free_flight_whose_inertia_is_a_sum_of_rounding():

    def scene(m):
        run = impact(IMPACT | m)
        # without friction the points hardly depend on this velocity
        return study.Run(run.problem, run.steps, {"position": run.measured["position"]})

    for options in ({}, {"epsilon": 1e-5}, {"scales": {"vx": 20.0}}):
        found = study.differentiate(scene, {"vx": 0.5}, **options)
        assert not found.notes
        errors = errors_of(scene, {"vx": 0.5}, found)
        assert max(errors.values()) < 1e-5
        # before the contact the disc moves with its first velocity
        at = found.derivatives["position"]["vx"][0] / found.scales["vx"]
        np.testing.assert_allclose(at, [0.004, 0.0], atol=1e-9)


@pytest.mark.long
def test_a_contact_that_just_touches_has_no_mirror_image():
    """At larger gaps the disc does not touch a second point in the third step."""

    def scene(m):
        # soft, so that the disc presses one point when it meets the next one
        return impact(IMPACT | m, steps=6, penalty=0.2)

    def touches(gap):
        run = scene({"gap": gap})
        for step in run.steps[:3]:
            step()
        return int((run.problem.points["contact1_normal_force"] > 0.0).sum()) >= 2

    low, high = 0.005, 0.0055
    for _ in range(24):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if touches(middle) else (low, middle)
    h = 1e-6
    at, near = (history_of(scene, {"gap": gap})["position"][:, 1] for gap in (low, low - h))
    for options in ({}, {"central": True}):
        found = study.differentiate(scene, {"gap": low}, scales={"gap": 0.01}, **options)
        assert len(found.notes) == 1
        assert "gap, step 3: 1 contact point" in found.notes[0]
        derivative = found.derivatives["position"]["gap"][:, 1] / 0.01
        np.testing.assert_allclose(derivative, (at - near) / h, atol=2e-3)


def test_the_load_of_a_footing_has_digits_enough():
    """Its gaps are of 1e-8 m, where places are of 3 m: their difference had errors of 4e-4."""

    def pressed(m):
        grid = grid_of((6.0, 4.0), (12, 8))
        points = mpm.fill(grid, mpm.Box((0, 0), (6, 3)), 2, 2000.0)
        V, settlement = mpm.Space(grid, "gimp"), fem.Constant(grid, 0.0)
        top = mpm.Surface(points, lambda x: (x[1] > 2.9) & (x[0] < 1.0), (0, 1))
        footing = mpm.RigidFooting(top, settlement, E=1e6)
        F = mpm.momentum(mpm.materials.Hencky(m["E"], m["nu"]), points, V.increment, V.test)
        F += footing.contact(V.increment, V.test)
        bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
        options = {"stabilisation": "ghost", "tolerance": 1e-11}
        problem = mpm.QuasiStatic(F, V.increment, points, bcs, **options)

        def step():
            settlement.value = 0.002
            problem.step()

        return study.Run(problem, [step], {"load": footing.load})

    parameters = {"E": 1e6, "nu": 0.3}
    found = study.differentiate(pressed, parameters)
    errors = errors_of(pressed, parameters, found, 1e-3)
    assert max(errors.values()) < 2e-6
    assert not found.notes
    # a limit state takes the same two runs, at the perturbation of a footing
    gradient = study.LimitState(pressed, "load", parameters).gradient([1e6, 0.3])
    wanted = [by[-1] / parameters[m] for m, by in found.derivatives["load"].items()]
    np.testing.assert_allclose(gradient, wanted, rtol=1e-6)


def test_forces_of_a_stiff_contact_that_lose_digits_are_told():
    """Overlaps of 1e-5 m, where places are of 1 m: the derivative of the force was off by 2e-4."""

    def pushed(m, stiffness):
        grid = grid_of((3.0, 2.0), (12, 8))
        points = mpm.fill(grid, mpm.Box((0.5, 0), (2.5, 1.2)), 2, 2000.0)
        V = mpm.Space(grid, "gimp")
        u, v = V.increment, V.test
        wall = mpm.RigidBody(mpm.Plane((0, 1.2), (0.0, -1.0)), increment=(0.0, -m["way"]))
        F = mpm.momentum(mpm.materials.Hencky(1e6, 0.3), points, u, v)
        F += mpm.contact(wall, points, u, v, stiffness_per_area=stiffness)
        bcs = mpm.fixed(V, "bottom")
        problem = mpm.QuasiStatic(F, u, points, bcs, stabilisation="ghost", tolerance=1e-10)
        return study.Run(problem, [problem.step] * 2, {"force": lambda: wall.force[1]})

    for stiffness, central, told in ((1e8, None, 0), (1e9, None, 1), (1e9, True, 0)):
        options = {"central": central, "epsilon": 1e-5} if central else {}
        scene = partial(pushed, stiffness=stiffness)
        found = study.differentiate(scene, {"way": 0.002}, **options)
        assert len(found.notes) == told
        assert all("bodies overlap by" in note for note in found.notes)
        error = max(errors_of(scene, {"way": 0.002}, found, 1e-3).values())
        assert error < (1e-3 if told else 3e-5)
