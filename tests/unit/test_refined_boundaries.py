"""Boundaries and walls beside leaves hold a body as on a fine grid."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI

import dolfinmpm as mpm


@pytest.mark.parametrize(
    ("method", "basis"), [("nitsche", "gimp"), ("penalty", "gimp"), ("nitsche", "bspline2")]
)
def test_a_boundary_across_leaves_holds_the_body_as_on_a_fine_grid(method, basis):
    def settled(cells, **options):
        grid = mpm.create_lattice(MPI.COMM_SELF, [np.linspace(0, 4, cells + 1)] * 2)
        V = mpm.Space(grid, basis, **options)
        corners = [(0.3, 0.3), (3.7, 0.3), (3.7, 2.3), (0.3, 2.3)]
        body = mpm.Polygon(corners)
        points = mpm.fill(grid, body, per_cell=2, density=2000.0, refine=V, exact=True)
        u, v, law = V.increment, V.test, mpm.materials.Hencky(1e6, 0.3)
        F = mpm.momentum(law, points, u, v)
        load = fem.Constant(grid, (0.0, -9.81))
        F -= ufl.inner(points.density * load, v) * points.dX
        foot = mpm.Boundary.from_polygon(points, corners[:2], closed=False, spacing=0.05)
        extra = {"penalty": 20.0} if method == "penalty" else {}
        F += mpm.dirichlet(foot, u, v, law=law, method=method, **extra)
        problem = mpm.QuasiStatic(F, u, points, stabilisation=mpm.Stabilisation("ghost"))
        problem.step()
        return float(points["V0"] @ (points["x"] - points["x0"])[:, 1]) / 6.8

    fine = settled(16)
    assert settled(4, refine=lambda x: np.full(x.shape[1], 0.25), levels=2) == pytest.approx(
        fine, rel=1e-6
    )
    mixed = settled(4, refine=lambda x: np.where(x[1] < 1.1, 0.25, 0.5), levels=2)
    assert mixed == pytest.approx(fine, rel=0.02)


@pytest.mark.parametrize("gdim", [2, 3])
def test_a_wall_at_a_side_holds_leaves_as_on_a_fine_grid(gdim):
    """With pieces as long as the leaves; those of the grid's cells are too few."""

    def pushed(levels, spacing):
        grid = mpm.create_lattice(MPI.COMM_SELF, [np.linspace(0, 2, 3 if levels else 5)] * gdim)
        refined = {"refine": lambda x: np.full(x.shape[1], 0.5), "levels": 1} if levels else {}
        V = mpm.Space(grid, "gimp", **refined)
        box = mpm.Box((0.0,) * gdim, (2.0,) * (gdim - 1) + (1.7,))
        points = mpm.fill(grid, box, 2, 1e3, **({"refine": V} if levels else {}))
        u, v = V.increment, V.test
        law = mpm.materials.Hencky(1e6, 0.3)
        F = mpm.momentum(law, points, u, v)
        wall = mpm.Boundary.from_side(points, "right", spacing=spacing)
        F += mpm.signorini(wall, u, v, stiffness_per_area=1e7)
        bcs = mpm.prescribed(V, "left", 0, increment=0.01) + mpm.rollers(V, "bottom")
        if gdim == 3:
            bcs += mpm.rollers(V, "front", "back")
        mpm.QuasiStatic(F, u, points, bcs, stabilisation="ghost", tolerance=1e-10).step()
        return wall.force(), np.sort(points["stress"][:, 0, 0])

    fine, same, rough = (pushed(*case) for case in ((0, None), (1, 0.5), (1, None)))
    for a, b, c in zip(fine, same, rough):
        assert np.abs(a - b).max() < 1e-8 * np.abs(a).max()
        assert np.abs(a - c).max() > 1e-6 * np.abs(a).max()
