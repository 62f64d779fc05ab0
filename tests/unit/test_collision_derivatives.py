"""Derivatives of runs with bodies that collide at the nodes, and the kinks that are told there."""

from __future__ import annotations

import sys
from functools import partial
from pathlib import Path

import pytest
from conftest import unit_grid

import dolfinmpm as mpm
from dolfinmpm import study
from dolfinmpm.dynamics.kinks import COLLIDING

sys.path.append(str(Path(__file__).resolve().parents[2] / "demos" / "studies"))
from derivative_scenes import errors_of
from onesided import around_kink, check_at_kink

AWAY = {"E": 1e5, "friction": 0.3, "speed": 1.0, "across": 0.2, "gap": -0.002}


def thrown(m, steps=4, scheme="musl", mapping="flip", gap_test=True):
    """A block is thrown aslant at another one."""
    grid = unit_grid("quadrilateral", 6)
    points = mpm.fill(grid, mpm.Box((0.1, 0.1), (0.8, 0.45)), 2, 1000.0, tag=1)
    points += mpm.fill(grid, mpm.Box((0.25, 0.45), (0.65, 0.8)), 2, 1000.0, tag=2)
    above = points["tag"] == 2
    points["x"][above, 1] += m["gap"]
    V = mpm.Space(grid, "gimp")
    F = mpm.momentum(mpm.materials.Hencky(m["E"], 0.2), points, V.increment, V.test)
    collision = mpm.Collision((1, 2), friction=m["friction"], gap_test=gap_test)
    problem = mpm.Explicit(
        F, V.increment, points, collision=collision, scheme=scheme, mapping=mapping
    )
    points["velocity"][above] = (m["across"], -m["speed"])
    measured = {
        "motion": lambda: points["velocity"][points["tag"] == 2].mean(axis=0),
        "places": lambda: points["x"].copy(),
    }
    times = [3e-3 * (k + 1) for k in range(steps)]
    return study.Run(problem, [partial(problem.step, t) for t in times], measured)


def states_of(scene, parameters, steps):
    """The sets of nodes that touch and slip in the last of some steps."""
    run = scene(parameters)
    kinks = run.problem.watch_kinks()
    for step in run.steps[:steps]:
        kinks.begin()
        step()
    return [numbers.tolist() for numbers in kinks.sets[COLLIDING] if numbers.size]


@pytest.mark.parametrize(
    "options",
    [{}, {"scheme": "usl"}, {"mapping": "pic", "gap_test": False}],
    ids=["musl", "usl", "pic without a gap test"],
)
def test_derivatives_of_a_collision_are_differences_of_whole_runs(options):
    scene = partial(thrown, **options)
    found = study.differentiate(scene, AWAY, scales={"gap": 0.1})
    assert not found.notes
    errors = errors_of(scene, AWAY, found, h=1e-5)
    assert all(abs(d).max() > 1e-3 for d in found.derivatives["motion"].values())
    assert max(errors.values()) < 1e-5


@pytest.mark.parametrize(
    ("name", "low", "high"), [("friction", 0.1, 0.4), ("across", 0.2, 0.4), ("gap", 0.004, 0.012)]
)
@pytest.mark.parametrize("side", [0, 1])
def test_a_node_between_two_states_is_told(name, low, high, side):
    """In the third step, nodes touch or slip otherwise on both sides of a value."""
    ends = around_kink(lambda m: states_of(thrown, AWAY | {name: m}, 3), (low, high), 40)

    def scene(m):
        return thrown({**AWAY, **m})

    note = check_at_kink(scene, name, ends, side, COLLIDING)
    assert note.startswith(f"{name}, step ")


def test_who_asks_for_no_derivatives_keeps_no_kinks():
    run = thrown(AWAY)
    run.steps[0]()
    assert run.problem._loop.kinks is None
