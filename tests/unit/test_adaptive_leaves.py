"""Adaptive ghost penalties between leaves, also of different sizes."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI

import dolfinmpm as mpm
from dolfinmpm.assembly.facetpenalties import isotropic, local_constant, smooth_constant
from dolfinmpm.assembly.latticefacets import splines_between
from dolfinmpm.assembly.leafpairs import leaf_pair
from dolfinmpm.study import conditioning


def settled(cells, levels, d=2, size=None, height=2.3, factor="adaptive", basis="gimp"):
    """A body that settles under its weight in one step."""
    grid = mpm.create_lattice(MPI.COMM_WORLD, [np.linspace(0, 4, cells + 1)] * d)
    size = size or (lambda x: np.full(x.shape[1], 4 / (cells * 2**levels)))
    V = mpm.Space(grid, basis, **({"refine": size, "levels": levels} if levels else {}))
    body = mpm.Box((0,) * d, (3.3,) * (d - 1) + (height,))
    points = mpm.fill(grid, body, 2, 1000.0, **({"refine": V} if levels else {}))
    u, v = V.increment, V.test
    g = fem.Constant(grid, (0.0,) * (d - 1) + (-10.0,))
    F = mpm.momentum(mpm.materials.Hencky(1e6, 0.3), points, u, v)
    F -= ufl.inner(points.density * g, v) * points.dX
    ghost = mpm.Stabilisation("ghost", factor=factor)
    problem = mpm.QuasiStatic(F, u, points, mpm.fixed(V, "bottom"), stabilisation=ghost)
    problem.step()
    return problem


@pytest.mark.parametrize(
    ("d", "cells", "basis"), [(2, 8, "gimp"), (3, 3, "gimp"), (2, 8, "bspline2")]
)
def test_equal_leaves_have_the_penalties_of_a_grid(d, cells, basis):
    norm = settled(2 * cells, 0, d, basis=basis).stiffness().norm()
    assert settled(cells, 1, d, basis=basis).stiffness().norm() == pytest.approx(norm, rel=1e-11)


@pytest.mark.parametrize("basis", ["gimp", "bspline2"])
def test_cuts_do_not_spoil_the_condition_of_leaves_of_two_sizes(basis):
    def size(x):
        return np.where(np.abs(x[0] - 3.3) < 0.5, 0.125, 0.5)

    kappas = [
        conditioning(settled(8, 2, size=size, height=height, basis=basis), 1.0).kappa_K
        for height in (2.001, 2.13, 2.251, 2.37, 2.499)
    ]
    assert max(kappas) < 3 * min(kappas)


# first and second leaf: lower corner and edge
@pytest.mark.parametrize(
    ("first", "second"),
    [(((0, 0), 1), ((1, 0), 1)), (((0, 0), 1), ((1, 0.5), 0.5)), (((1, 0), 0.5), ((0, 0), 1))],
)
@pytest.mark.parametrize("degree", [1, 2])
def test_a_penalty_meets_its_target_across_a_facet(first, second, degree):
    edges = np.array([first[1], second[1]], float)[:, None, None]
    lows = np.array([first[0], second[0]], float)[:, :, None]
    knots = lows + edges * np.arange(1 - degree, degree + 1)
    # the penalty on jumps of the highest normal derivative, by Gauss points of the smaller side
    small = knots[int(second[1] < first[1]), 1, degree - 1 : degree + 1]
    t, w = np.polynomial.legendre.leggauss(degree + 1)
    y, w = small[0] + 0.5 * (small[1] - small[0]) * (t + 1), 0.5 * (small[1] - small[0]) * w
    slopes = []
    for sign, (across, along) in zip((1.0, -1.0), knots):
        highest = splines_between(across, np.ones(1), degree)
        slopes.append(sign * np.kron(highest, splines_between(along, y, 0)))
    jump = np.hstack(slopes)
    pair = leaf_pair(knots, 0, (jump.T * w) @ jump)
    # without the penalty there would be no bound
    assert pair.J.any()
    gamma = pair.penalty(0.3, 4.0)
    full, cut = pair.stiffness(isotropic(1.0, 0.3, 2))
    for a, b in ((full, cut), (cut, full)):
        values, vectors = np.linalg.eigh(pair.J)
        smooth = vectors[:, values < 1e-10 * values[-1]]
        target = max(4.0, 2.0 * smooth_constant(a, b, smooth))
        assert local_constant(a, b, gamma * pair.J) < target * (1 + 1e-6)
        assert local_constant(a, b, 0.5 * gamma * pair.J) > smooth_constant(a, b, smooth)
