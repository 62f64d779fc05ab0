"""Footings and springs hold faces of points, which laws with mean volumes would shift."""

from __future__ import annotations

import pytest
from conftest import unit_grid
from dolfinx import fem
from test_tangent import box

import dolfinmpm as mpm
from dolfinmpm._platform import errors
from dolfinmpm.materials import Hencky


@pytest.mark.parametrize("holds", ["footing", "springs"])
def test_mean_volumes_hold_no_faces(holds):
    """F changes after a step, so that faces shift; what holds them is refused, loads are not."""
    grid = unit_grid("quadrilateral")
    points = mpm.fill(grid, box(grid), 2, 1.0)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    top = mpm.Surface(points, lambda x: x[1] > 0.8, (0, 1), name="top")
    F = mpm.momentum(Hencky(20.0, 0.3), points, u, v, fbar="volumes")
    mpm.QuasiStatic(F + top.pressure(fem.Constant(grid, 1.0), u, v), u, points)
    if holds == "springs":
        F += mpm.springs(top, u, v, stiffness=10.0)
    else:
        F += mpm.RigidFooting(top, fem.Constant(grid, 0.0), E=20.0).contact(u, v)
    with pytest.raises(errors.ParameterError, match=rf'fbar = "volumes" .*{holds}'):
        mpm.QuasiStatic(F, u, points)
