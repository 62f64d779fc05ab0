"""The means over cells that F-bar takes."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import unit_grid
from dolfinx import mesh
from mpi4py import MPI
from test_fbar import BASES, means_of, with_history
from test_tangent import box, check

import dolfinmpm as mpm
from dolfinmpm._platform import errors
from dolfinmpm.basis.lineweights import INNER
from dolfinmpm.basis.stencils import gather
from dolfinmpm.cut.cellaverages import layers_needed
from dolfinmpm.cut.fractions import domain_shares
from dolfinmpm.materials import Hencky


@pytest.mark.parametrize("basis", BASES)
def test_means_keep_constants_and_sums(basis):
    grid = mesh.create_rectangle(
        MPI.COMM_SELF, [(0, 0), (5, 5)], (5, 5), mesh.CellType.quadrilateral
    )
    points = mpm.fill(grid, mpm.Disc((2.2, 2.6), 1.9), 3, 1.0)
    rng = np.random.default_rng(1)
    points["V"] *= rng.uniform(0.5, 2, len(points))
    V = mpm.Space(grid, basis)
    means = means_of(points, V.basis)
    np.testing.assert_allclose(means.mean(np.full(len(points), 3.0)), 3.0, rtol=1e-14)
    m = rng.uniform(1, 2, len(points))
    mean = means.mean(m)
    assert mean.std() < 0.5 * m.std()
    np.testing.assert_allclose(points["V"] @ mean, points["V"] @ m, rtol=1e-13)


def test_means_of_overlapping_domains_by_hand():
    """A point astride two cells, three quarters in the first, and one in the second cell."""
    grid = mesh.create_interval(MPI.COMM_SELF, 2, [0.0, 2.0])
    points = mpm.fill(grid, mpm.Box(0.0, 2.0), 1, 1.0)
    points["x"], points["l"] = [[0.8], [1.6]], [0.4]
    points["V"] = [2.0, 3.0]
    V = mpm.Space(grid, "gimp")
    means = means_of(points, V.basis)
    # without the outermost parts of the domain
    share = (0.2 - 0.4 * (1 - INNER)) / (0.8 * INNER)
    second = (share * 2 * 10 + 3 * 20) / (share * 2 + 3)
    expected = [(1 - share) * 10 + share * second, second]
    np.testing.assert_allclose(means.mean(np.array([10.0, 20.0])), expected, rtol=1e-14)


@pytest.mark.parametrize("size", [0.83, 0.6])
def test_means_by_centres_over_the_domains_of_others(size):
    """Each point has its cell's mean, and its domain beyond the cell counts nowhere else.

    Around the smaller body domains reach into cells without a centre.
    """
    grid = unit_grid("quadrilateral", 4)
    points = mpm.fill(grid, box(grid, size), 2, 1.0)
    points["l"] = (0.1, 0.1)
    V = mpm.Space(grid, "gimp")
    u = V.increment
    F = mpm.momentum(Hencky(E=10.0, nu=0.45), points, u, V.test, fbar="centres")
    problem = mpm.QuasiStatic(F, u, points, mpm.fixed(V, "bottom"))
    with_history(points)
    check(problem)
    means = problem.here.regions[0].averages
    m = np.sin(np.arange(len(points)))
    cell = np.unique(points["cell"], return_inverse=True)[1]
    sums = np.bincount(cell, points["V"] * m) / np.bincount(cell, points["V"])
    np.testing.assert_allclose(means.mean(m), sums[cell], rtol=1e-13)
    assert problem.here.fields[0].stencils.cells.size > len(sums)
    with pytest.raises(errors.ParameterError, match="'centres' is for linear functions and GIMP"):
        mpm.momentum(
            Hencky(E=10.0, nu=0.45), points, mpm.Space(grid, "bspline2").increment, V.test,
            fbar="centres",
        )  # fmt: skip


def test_means_by_centres_and_by_domains_do_not_meet():
    grid = unit_grid("quadrilateral", 4)
    points = mpm.fill(grid, box(grid), 2, 1.0)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    F = mpm.momentum(Hencky(E=10.0, nu=0.45), points, u, v, fbar="centres", tag=(0, 1))
    F += mpm.momentum(Hencky(E=10.0, nu=0.45), points, u, v, fbar=True, tag=2)
    with pytest.raises(errors.FormError, match='fbar="centres" meet'):
        mpm.QuasiStatic(F, u, points).activate()


def test_means_over_lower_splines_by_hand():
    """Of quadratic splines over hat functions: two points in one cell, one at the next knot."""
    grid = mesh.create_interval(MPI.COMM_SELF, 3, [0.0, 3.0])
    points = mpm.fill(grid, mpm.Box(0.0, 3.0), 1, 1.0)
    points["x"], points["V"] = [[0.25], [0.75], [1.0]], [1.0, 2.0, 4.0]
    V = mpm.Space(grid, "bspline2", averaged=False)
    means = means_of(points, V.basis)
    first = (0.75 * 1 * 10 + 0.25 * 2 * 20) / (0.75 * 1 + 0.25 * 2)
    second = (0.25 * 1 * 10 + 0.75 * 2 * 20 + 4 * 30) / (0.25 * 1 + 0.75 * 2 + 4)
    expected = [0.75 * first + 0.25 * second, 0.25 * first + 0.75 * second, second]
    np.testing.assert_allclose(means.mean(np.array([10.0, 20.0, 30.0])), expected, rtol=1e-14)


@pytest.mark.parametrize(("basis", "share"), [("bspline2", 1 / 3), ("bspline3", 2 / 15)])
def test_what_means_leave_of_a_wave_of_two_cells(basis, share):
    """That of the lumped projection, ∫ N_i Σ_j ± N_j for splines N one degree lower."""
    n = 16
    grid = mesh.create_interval(MPI.COMM_SELF, n, [0.0, float(n)])
    points = mpm.fill(grid, mpm.Box(0.0, float(n)), 20, 1.0)
    V = mpm.Space(grid, basis, averaged=False)
    s = V.basis.stencils(points.placement())
    u = np.where(V.basis.halo.node_ijk[:, :1] % 2, 1.0, -1.0)
    value, slope = np.empty((len(points), 1)), np.empty((len(points), 1, 1))
    gather(s, u, value, slope)
    volume = slope[:, 0, 0]
    inner = (points["x"][:, 0] > 6) & (points["x"][:, 0] < n - 6)
    mean = means_of(points, V.basis).mean(volume)
    np.testing.assert_allclose(mean[inner], share * volume[inner], atol=2e-3 * volume.max())


def test_means_of_splines_see_what_alternates_within_two_cells():
    """Quadratic splines whose coefficients alternate vanish at the knots: cells see no volume."""
    n = 12
    grid = mesh.create_interval(MPI.COMM_SELF, n, [0.0, float(n)])
    points = mpm.fill(grid, mpm.Box(0.0, float(n)), 4, 1.0)
    V = mpm.Space(grid, "bspline2", averaged=False)
    s = V.basis.stencils(points.placement())
    u = np.empty((V.basis.nodes.size, 1))
    u[:, 0] = np.where(V.basis.halo.node_ijk[:, 0] % 2, 1.0, -1.0)
    value, slope = np.empty((len(points), 1)), np.empty((len(points), 1, 1))
    gather(s, u, value, slope)
    # away from the ends, where the functions differ
    inner = (points["x"][:, 0] > 3) & (points["x"][:, 0] < n - 3)
    volume = slope[:, 0, 0]
    size = np.abs(volume[inner]).max()
    assert size > 1
    share_start, shares = domain_shares(points.placement(), s, V.basis)
    sums = np.bincount(s.cells[np.repeat(np.arange(n), 4)], shares * volume[s.order], n)
    assert share_start[-1] == len(points)
    assert np.abs(sums[3 : n - 3]).max() < 1e-12
    mean = means_of(points, V.basis).mean(volume)
    assert np.abs(mean[inner]).max() > 0.3 * size


@pytest.mark.parametrize(
    ("basis", "half", "layers"),
    [("linear", 0.1, 0), ("gimp", 0.1, 1), ("bspline2", 0.1, 2), ("bspline3", 0.1, 2),
     ("gimp", 0.3, 4), ("bspline2", 0.3, 5)],
)  # fmt: skip
def test_layers_that_means_need(basis, half, layers):
    """As many as a domain spans beyond its first cell, and one for a spline's support."""
    grid = unit_grid("quadrilateral", 6)
    points = mpm.fill(grid, mpm.Box((0.3, 0.3), (0.7, 0.7)), 2, 1.0)
    points["l"] = half, half
    V = mpm.Space(grid, basis)
    _, span = V.basis.reach(points.placement())
    assert layers_needed(span, V.basis) == layers
