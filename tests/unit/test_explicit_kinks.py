"""Derivatives of explicit runs: kinks of contact, sides, damping and viscosity are told."""

from __future__ import annotations

import sys
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from conftest import unit_grid

import dolfinmpm as mpm
from dolfinmpm import study
from dolfinmpm.dynamics import kinks

sys.path.append(str(Path(__file__).resolve().parents[2] / "demos" / "studies"))
from derivative_scenes import errors_of
from onesided import around_kink, check_at_kink

FALL = {"E": 1e5, "friction": 0.05, "down": 1.0, "across": 0.2, "gap": 0.0}


def fall(m, on="wall", steps=4, basis="gimp", **options):
    """A block is thrown aslant at a rigid wall, or at the bottom of the grid."""
    grid = unit_grid("quadrilateral", 6)
    points = mpm.fill(grid, mpm.Box((0.1, 0.0), (0.6, 0.4)), 2, 1000.0)
    points["x"][:, 1] += m["gap"]
    V = mpm.Space(grid, basis)
    F = mpm.momentum(mpm.materials.Hencky(m["E"], 0.2), points, V.increment, V.test)
    sides = []
    if on == "wall":
        plane = mpm.RigidBody(mpm.Plane((0, 0), (0, 1)), name="wall")
        F += mpm.contact(plane, points, V.increment, V.test, friction=m["friction"])
    elif on == "side":
        sides = mpm.frictional(V, "bottom", friction=m["friction"])
    else:
        sides = mpm.rollers(V, "bottom")
    problem = mpm.Explicit(F, V.increment, points, sides, **options)
    points["velocity"] = (m["across"], -m["down"])
    measured = {
        "motion": lambda: points["velocity"].mean(axis=0),
        "places": lambda: points["x"][np.argsort(points["id"])],
    }
    times = [3e-3 * (k + 1) for k in range(steps)]
    return study.Run(problem, [partial(problem.step, t) for t in times], measured)


def sets_of(scene, parameters, what, steps):
    """Numbers of what is beyond its kink in the last of some steps."""
    run = scene(parameters)
    watch = run.problem.watch_kinks()
    for step in run.steps[:steps]:
        watch.begin()
        step()
    return [numbers.tolist() for numbers in watch.sets[what]]


@pytest.mark.parametrize("on", ["wall", "side"])
@pytest.mark.parametrize("basis", ["gimp", pytest.param("bspline2", marks=pytest.mark.long)])
def test_derivatives_are_differences_of_whole_runs(on, basis):
    scene, at = partial(fall, on=on, basis=basis), FALL | {"gap": -0.001}
    found = study.differentiate(scene, at)
    assert not found.notes
    errors = errors_of(scene, at, found, h=1e-5)
    assert all(abs(d).max() > 1e-5 for d in found.derivatives["motion"].values())
    assert max(errors.values()) < 1e-5


@pytest.mark.parametrize(
    ("scene", "what", "name", "ends", "step"),
    [
        (fall, kinks.CORNERS, "friction", (0.05, 0.9), 3),
        (fall, kinks.CORNERS, "gap", (0.0, 0.01), 3),
        (partial(fall, on="side"), kinks.AT_SIDES, "friction", (0.02, 0.9), 3),
        (partial(fall, on="side"), kinks.AT_SIDES, "E", (1e5, 2e6), 8),
        (partial(fall, on="held", bulk_viscosity=(0.1, 1.0)), kinks.CLOSING, "E", (1e5, 2e6), 8),
    ],
    ids=["corners slip", "corners touch", "nodes slip", "nodes touch", "points close"],
)
@pytest.mark.parametrize("side", [0, 1])
def test_a_kink_within_the_perturbation_is_told(scene, what, name, ends, step, side):
    """In one of the steps, something is beyond its kink on one side of a value only."""
    found = around_kink(lambda m: sets_of(scene, FALL | {name: m}, what, step), ends, 44)

    def one(m):
        return scene({**FALL, **m}, steps=step)

    check_at_kink(one, name, found, side, what, share=2e-5, least=5e-9)


def test_a_velocity_that_turns_round_under_local_damping_is_told():
    def scene(m):
        return fall({**FALL, **m}, on="held", damping=0.1, steps=1)

    found = study.differentiate(scene, {"across": -1e-9}, scales={"across": 1.0})
    assert any(kinks.DAMPED in note for note in found.notes)


def test_smooth_explicit_steps_stay_fused():
    free = fall(FALL, on="held")
    assert free.problem.watch_kinks() is None
    assert not free.problem.unfused
    rubbed = fall(FALL, on="side")
    assert not rubbed.problem.unfused
    assert rubbed.problem.watch_kinks() is not None
    assert "watched" in rubbed.problem.unfused


def test_who_asks_for_no_derivatives_keeps_no_kinks():
    run = fall(FALL, on="side", fused=False)
    run.steps[0]()
    assert run.problem._loop.kinks is None
