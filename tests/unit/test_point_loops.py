"""Compiled loops over points and their stencils, beside the same sums in NumPy."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import COMM

import dolfinmpm as mpm
from dolfinmpm.body.fieldarrays import checksums
from dolfinmpm.dynamics.energies import stress_works
from dolfinmpm.dynamics.transfer import collect, scatter, scatter_stress
from dolfinmpm.grid.tensors import inverses

RANDOM = np.random.default_rng(7)


@pytest.mark.parametrize("d", [1, 2, 3])
def test_inverses(d):
    A = np.eye(d) + 0.3 * RANDOM.normal(size=(20, d, d))
    np.testing.assert_allclose(inverses(A), np.linalg.inv(A), rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize("d", [1, 2, 3])
def test_works_of_stresses(d):
    n = 15
    H, linear = 0.2 * RANDOM.normal(size=(n, d, d)), np.arange(n) % 3 == 0
    before, after = RANDOM.uniform(1, 2, (2, n))
    old, new = RANDOM.normal(size=(2, n, 3, 3))
    rate = H @ np.linalg.inv(np.eye(d) + 0.5 * H)
    rate[linear] = H[linear]
    wanted = [
        np.einsum("p,pij,pij->", V, sigma[:, :d, :d], rate)
        for V, sigma in ((before, old), (after, new))
    ]
    np.testing.assert_allclose(stress_works(H, linear, before, old, after, new), wanted, rtol=1e-12)


@pytest.mark.parametrize("basis", ["gimp", "bspline2"])
@pytest.mark.parametrize("d", [2, 3])
def test_sums_to_nodes_and_back(d, basis):
    grid = mpm.create_lattice(COMM, [np.linspace(0.0, 1.0, 5)] * d)
    points = mpm.fill(grid, mpm.Box((0.1,) * d, (0.8,) * d), 2, 1.0)
    V = mpm.Space(grid, basis)
    law = mpm.materials.Hencky(1e5, 0.2)
    problem = mpm.QuasiStatic(mpm.momentum(law, points, V.increment, V.test), V.increment, points)
    field = problem.activate().fields[0]
    s, nodes = field.stencils, int(field.stencils.nodes.max()) + 1
    N, dN = np.zeros((len(points), nodes)), np.zeros((len(points), nodes, d))
    for g in range(s.groups.size - 1):
        seen = s.nodes[s.node_start[g] : s.node_start[g + 1]]
        for k, p in enumerate(s.order[s.groups[g] : s.groups[g + 1]]):
            at = s.value_start[g] + k * seen.size
            N[p, seen], dN[p, seen] = s.N[at : at + seen.size], s.dN[at : at + seen.size]
    np.testing.assert_allclose(N.sum(axis=1), 1.0, rtol=1e-12)
    for components in (1, d, d + 2):
        q, weight = RANDOM.normal(size=(len(points), components)), RANDOM.uniform(size=len(points))
        out = np.ones((nodes, components))
        scatter(s, weight, q, out)
        np.testing.assert_allclose(out, 1.0 + N.T @ (weight[:, None] * q), atol=1e-12)
        at_nodes = RANDOM.normal(size=(nodes, components))
        np.testing.assert_allclose(collect(s, at_nodes), N @ at_nodes, atol=1e-12)
    stress, out = RANDOM.normal(size=(len(points), 3, 3)), np.ones((nodes, d))
    scatter_stress(s, stress[:, :d, :d], out)
    wanted = 1.0 + np.einsum("pij,paj->ai", stress[:, :d, :d], dN)
    np.testing.assert_allclose(out, wanted, atol=1e-11)


@pytest.mark.parametrize("size", [0, 1, 2, 7, 1000])
def test_checksums_tell_changes(size):
    values = RANDOM.normal(size=size)
    found = checksums(values)
    half = size // 2
    wanted = [values[:half].sum(), values[half:].sum(), values @ values, values[:-1] @ values[1:]]
    np.testing.assert_allclose(found, wanted, rtol=1e-10, atol=1e-12)
    assert checksums(values.copy()) == found
    if size > 1:
        assert checksums(values[::-1]) != found
        other = values.copy()
        other[size // 3] += 1e-6
        assert checksums(other) != found
    assert np.isnan(checksums(np.array([1.0, np.nan, 2.0]))).any()
    # whole numbers beyond 2³² have squares that integers do not hold
    assert checksums(np.array([2**40, 1]))[2] == pytest.approx(2.0**80)
