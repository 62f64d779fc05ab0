"""Mirror images of a run about another run, from which derivatives follow."""

from __future__ import annotations

import numpy as np
from conftest import unit_grid

import dolfinmpm as mpm
from dolfinmpm.study.branches import RunState, mirror


def test_the_mirror_image_of_a_point_beside_a_grid_line_is_in_its_cell():
    """A step had refused it: its point was said to be in the cell of the run in the middle."""

    def shifted(way):
        points = mpm.fill(unit_grid("quadrilateral", 4), mpm.Box((0, 0), (0.5, 0.5)), 1, 1.0)
        V = mpm.Space(points.grid, "gimp")
        F = mpm.momentum(mpm.materials.Hencky(E=1e6, nu=0.3), points, V.increment, V.test)
        problem = mpm.QuasiStatic(F, V.increment, points, mpm.fixed(V, "bottom"))
        points["x"] += (way, 0.0)
        points.locate()
        return problem

    base, good, bad = (shifted(way) for way in (0.12, 0.11, 0.12))
    assert mirror(RunState([base]), RunState([good]), [bad])
    np.testing.assert_allclose(bad.points["x"], base.points["x"] + (0.01, 0.0), atol=1e-15)
    assert bad.points["cell"].tolist() != base.points["cell"].tolist()
    bad.step()
