"""What explicit loops do not fuse, and why."""

from __future__ import annotations

import pytest
from conftest import COMM
from dolfinx import mesh
from test_fused import HENCKY, lattice, problem

import dolfinmpm as mpm
from dolfinmpm.materials import NeoHookean


@pytest.mark.parametrize(
    ("why", "scene"),
    [
        ("fused=False", {"fused": False}),
        ("consistent", {"mass": "consistent", "basis": "linear"}),
        ("filters", {"mapping": "xpic"}),
        ("vary", {"law": NeoHookean(E=lambda x: 1e5 + x[0], nu=0.3)}),
        ("a step changes", {"load": lambda points, g: g * points.V}),
    ],
    ids=lambda x: x if isinstance(x, str) else "",
)
def test_what_is_not_fused_says_why(why, scene):
    assert why in problem(**scene).unfused


def test_one_dimension_is_not_fused():
    grid = mesh.create_interval(COMM, 4, [0, 4])
    points = mpm.fill(grid, mpm.Box((1,), (2,)), 2, 1.0)
    V = mpm.Space(grid, "gimp")
    F = mpm.momentum(HENCKY, points, V.increment, V.test)
    assert "two and three dimensions" in mpm.Explicit(F, V.increment, points).unfused


def test_functions_at_first_positions_are_not_fused():
    grid = lattice()
    points = mpm.fill(grid, mpm.Disc((0, 0), 0.5), 2, 1.0)
    V = mpm.Space(grid, "gimp", configuration="total")
    F = mpm.momentum(HENCKY, points, V.increment, V.test)
    assert "total Lagrangian" in mpm.Explicit(F, V.increment, points).unfused
