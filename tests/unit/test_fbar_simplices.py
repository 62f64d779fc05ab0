"""F-bar on triangles and tetrahedra, whose volume change is constant in each cell already."""

from __future__ import annotations

import pytest
from conftest import unit_grid
from test_fbar import additive
from test_tangent import box, check

import dolfinmpm as mpm
from dolfinmpm._platform.errors import ParameterError
from dolfinmpm.materials import Hencky


@pytest.mark.parametrize("kind", ["triangle", "tetrahedron"])
def test_simplices_have_one_volume_change_already(kind):
    """F-bar had done nothing there, and clay had locked in silence."""
    grid = unit_grid(kind, 3)
    points = mpm.fill(grid, box(grid), 2, 1.0)
    V = mpm.Space(grid, "linear")
    F = additive(points, V.increment, V.test)
    check(mpm.QuasiStatic(F, V.increment, points, mpm.fixed(V, "bottom")))
    F = mpm.momentum(Hencky(E=10.0, nu=0.45), points, V.increment, V.test, fbar=True)
    with pytest.raises(ParameterError, match=f"do nothing .* {kind}: .* quadrilaterals"):
        mpm.QuasiStatic(F, V.increment, points, mpm.fixed(V, "bottom"))


def test_hoop_strains_of_triangles_have_means():
    grid = unit_grid("triangle", 3)
    points = mpm.fill(grid, box(grid), 2, 1.0, axisymmetric=True)
    V = mpm.Space(grid, "linear")
    F = mpm.momentum(Hencky(E=10.0, nu=0.45), points, V.increment, V.test, fbar=True)
    check(mpm.QuasiStatic(F, V.increment, points, mpm.fixed(V, "bottom")))
