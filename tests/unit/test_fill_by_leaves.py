"""Points by the leaves of a refined space."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

import dolfinmpm as mpm


def lattice(gdim):
    return mpm.create_lattice(MPI.COMM_SELF, [np.linspace(0, 4, 5)] * gdim)


def test_fill_by_leaves_has_the_volume_of_the_shape():
    grid = lattice(2)
    V = mpm.Space(grid, "gimp", refine=lambda x: np.where(x[0] < 1.7, 0.25, 1.0), levels=2)
    for shape, exact in ((mpm.Box((0, 0), (4, 2.3)), False), (mpm.Disc((2, 2), 1.5), True)):
        points = mpm.fill(grid, shape, per_cell=2, density=1e3, refine=V, exact=exact)
        assert points["V"].sum() == pytest.approx(shape.volume, rel=1e-12)
        left = points["x"][:, 0] < 1.5
        assert points["l"][left].max() <= 0.0625 * (1 + 1e-9)


def test_fill_by_leaves_knows_only_the_leaves_of_the_shape():
    """Small cells above a body would have had small neighbours in it."""
    grid, asked = lattice(2), [0.0]

    def size(x):
        asked[0] = max(asked[0], x[1].max())
        return np.where(np.abs(x[1] - 2.5) < 0.1, 0.125, 1.0)

    V = mpm.Space(grid, "gimp", refine=size, levels=3)
    points = mpm.fill(grid, mpm.Box((0, 0), (4, 2)), per_cell=2, density=1e3, refine=V)
    assert points.total == 4 * 2 * 4
    assert asked[0] == 2.0


def test_steps_keep_the_number_of_points_per_leaf():
    """Points of a fill with 4 had merged to 2 before the first step, without a message."""
    grid = lattice(2)
    V = mpm.Space(grid, "gimp", refine=lambda x: 0.5 + 0 * x[0], levels=1)
    for n in (1, 4):
        with pytest.raises(mpm.errors.ParameterError, match=f"per_cell={n}"):
            mpm.fill(grid, mpm.Box((0, 0), (2, 1)), n, 1e3, refine=V)
    assert mpm.fill(grid, mpm.Box((0, 0), (2, 1)), 3, 1e3, refine=V).total == 4 * 2 * 3**2
    V = mpm.Space(grid, "gimp", refine=lambda x: 0.5 + 0 * x[0], levels=1, per_cell=4)
    points = mpm.fill(grid, mpm.Box((0, 0), (2, 1)), 4, 1e3, refine=V)
    F = mpm.momentum(mpm.materials.Hencky(1e6, 0.2), points, V.increment, V.test)
    mpm.QuasiStatic(F, V.increment, points, mpm.fixed(V, "left")).step()
    assert points.total == 4 * 2 * 4**2


@pytest.mark.parametrize("gdim", [2, 3])
def test_points_of_leaves_are_families_that_merge(gdim):
    """A fill of leaves is what splits of larger points would have made."""
    grid, middle = lattice(gdim), np.full((gdim, 1), 1.3)

    def size(x):
        return np.maximum(0.13, 0.5 * np.linalg.norm(x - middle, axis=0) - 0.1)

    V = mpm.Space(grid, "gimp", refine=size, levels=2)
    box = mpm.Box((0,) * gdim, (4,) * gdim)
    points = mpm.fill(grid, box, per_cell=2, density=1e3, refine=V)
    coarse = mpm.fill(grid, box, per_cell=2, density=1e3)
    assert len(set(points["id"])) == len(points) > len(coarse)
    level = np.log2(0.25 / points["l"][:, 0])
    np.testing.assert_array_equal(mpm.families(points).level, level)
    assert level.max() == 2
    for _ in range(2):
        assert mpm.merge(points, 1e-12).count > 0
    assert mpm.families(points).level.max() == 0
    merged, whole = (np.lexsort(of["x"].T.round(9)) for of in (points, coarse))
    for name in ("x", "l", "V"):
        np.testing.assert_allclose(points[name][merged], coarse[name][whole], rtol=1e-14)
