"""Observed orders of a large deformation with a known solution, in full and in cut cells."""

from __future__ import annotations

import functools

import pytest
from conftest import figures_of


@functools.cache
def solve(*options, ranks=1):
    script = "demos/studies/manufactured_solution.py"
    if "--basis" not in options:
        options = "--basis", "gimp", *options
    return figures_of(script, "--json", "-", "--no-plot", *options, ranks=ranks)


@functools.cache
def orders(scene, *options):
    """The lowest overall orders of displacement and stress in full or in cut cells."""
    figures = solve("--cells", "8,16,32", *options)
    assert all(run["displacement"] is not None for run in figures["runs"])
    found = [order for name, order in figures["overall"].items() if name.startswith(scene)]
    return [min(order[key] for order in found) for key in ("displacement", "stress")]


@pytest.mark.parametrize(
    ("scene", "law"),
    [
        ("cut cells", "hencky"),
        pytest.param("full cells", "hencky", marks=pytest.mark.long),
        pytest.param("full cells", "neo-hookean", marks=pytest.mark.long),
        pytest.param("cut cells", "neo-hookean", marks=pytest.mark.long),
    ],
)
def test_order_in_many_steps(scene, law):
    displacement, stress = orders(scene, "--law", law)
    assert displacement > 1.9
    assert stress > 1.5


@pytest.mark.parametrize(
    ("basis", "cells"),
    [
        pytest.param("bspline2", "8,16,32", marks=pytest.mark.long),
        ("bspline2", "8,16"),
        pytest.param("bspline3", "8,16", marks=pytest.mark.long),
    ],
)
def test_order_of_splines(basis, cells):
    figures = solve("--cells", cells, "--basis", basis, "--cuts", "0.37")
    assert len(figures["overall"]) == 2
    for order in figures["overall"].values():
        assert order["displacement"] >= 1.9
        assert order["stress"] >= 1.5
    # GIMP begins at 3e-3 and 1.5e-3
    assert all(run["displacement"] < 1e-3 for run in figures["runs"])


def test_splines_at_points_alone_do_not_converge():
    options = "--basis", "bspline2", "--averaged", "off", "--scene", "full"
    runs = solve("--cells", "8,16", *options)["runs"]
    assert all(1e-3 < run["displacement"] < 5e-3 for run in runs)


@pytest.mark.parametrize("scene", ["full cells", "cut cells"])
def test_order_in_one_step_is_that_of_linear_elements(scene):
    displacement, stress = orders(scene, "--steps", "1")
    assert displacement == pytest.approx(2, abs=0.05)
    assert stress == pytest.approx(1, abs=0.08)


@pytest.mark.parametrize("stabilisation", ["none", "aggregation"])
def test_order_under_other_stabilisations(stabilisation):
    options = "--scene", "cut", "--cuts", "0.37", "--stabilisation", stabilisation
    assert orders("cut cells", *options)[0] > 1.9


@pytest.mark.long
def test_a_large_stretch():
    displacement, stress = orders("full cells", "--amplitude", "0.25")
    assert displacement > 1.9
    assert stress > 1.4


def test_errors_do_not_depend_on_the_ranks():
    options = "--cells", "8,16", "--cuts", "0.001"
    one, two = (solve(*options, ranks=ranks)["runs"] for ranks in (1, 2))
    for run, other in zip(one, two):
        for key in ("displacement", "stress"):
            assert other[key] == pytest.approx(run[key], rel=1e-9)
