"""Fields that points do not have yet, and who gives them."""

from __future__ import annotations

import pytest
from conftest import unit_grid

import dolfinmpm as mpm
from dolfinmpm._platform.errors import UnknownNameError


@pytest.mark.parametrize("name", ["pressure", "porosity"])
def test_the_problem_gives_points_the_fields_of_the_water(name):
    grid = unit_grid("quadrilateral", 2)
    points = mpm.fill(grid, mpm.Box((0, 0), (1, 1)), 2, 1800.0)
    V, Q = mpm.Space(grid, "gimp"), mpm.Space(grid, "gimp", shape=())
    soil = mpm.materials.Hencky(1e6, 0.3)
    fields, tests = (V.increment, Q.increment), (V.test, Q.test)
    F = mpm.poromechanics(soil, points, fields, tests, permeability=1e-9, porosity=0.4)
    with pytest.raises(UnknownNameError, match="a problem gives it to them when it is made from"):
        points[name]
    bcs = mpm.fixed(V, "bottom") + mpm.fixed(Q, "top")
    mpm.Transient(F, fields, points, bcs)
    assert len(points[name]) == len(points)
