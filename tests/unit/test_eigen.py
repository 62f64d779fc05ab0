"""Eigenvalues and axes of small symmetric matrices against LAPACK's, and of special ones."""

from __future__ import annotations

import numpy as np
import pytest

from dolfinmpm.grid.tensors import eigen

# rounding of a few operations, relative to the largest component
ROUNDING = 5e-15


def found(a):
    """Eigenvalues and eigenvectors."""
    d = len(a)
    values, vectors = np.empty(d), np.empty((d, d))
    eigen(d, np.array(a), values, vectors)
    return values, vectors


def turned(values, rng):
    """A matrix with these eigenvalues and random axes."""
    Q = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    a = Q @ np.diag(values) @ Q.T
    return 0.5 * (a + a.T)


def matrices(kind, rng):
    a = rng.standard_normal((3, 3))
    a = a + a.T
    match kind:
        case "any":
            return a
        case "near the identity":
            return np.eye(3) + 10.0 ** rng.uniform(-16, 0) * a
        case "two equal":
            return turned([1.0, 1.0, rng.uniform(-3, 3)], rng)
        case "two nearly equal":
            return turned([1.0, 1.0 + 10.0 ** rng.uniform(-16, 0), 2.0], rng)
        case "three equal":
            return turned([1.0] * 3, rng)
        case "far apart":
            return turned([1.0, 1e-3, 1e-6], rng)
        case "one component is zero":
            a[0, 1] = a[1, 0] = 0.0
            return a
        case "tiny":
            return 1e-120 * a
    return 1e120 * a


@pytest.mark.parametrize(
    "kind",
    ["any", "near the identity", "two equal", "two nearly equal", "three equal", "far apart",
     "one component is zero", "tiny", "huge"],
)  # fmt: skip
def test_as_exact_as_lapack(kind):
    rng = np.random.default_rng(1)
    for _ in range(300):
        a = matrices(kind, rng)
        values, vectors = found(a)
        size = np.abs(a).max()
        assert np.abs(vectors.T @ vectors - np.eye(3)).max() < ROUNDING
        assert np.abs(vectors * values @ vectors.T - a).max() < ROUNDING * size
        assert np.abs(np.sort(values) - np.linalg.eigvalsh(a)).max() < ROUNDING * size


@pytest.mark.parametrize("axes", [(0, 1), (1, 2), (0, 2)])
def test_an_axis_without_shear_stays_one(axes):
    i, j = axes
    k = 3 - i - j
    a = np.diag([3.0, -1.0, 7.0])
    a[i, j] = a[j, i] = 0.5
    values, vectors = found(a)
    assert values[k] == a[k, k]
    assert vectors[:, k].tolist() == np.eye(3)[k].tolist()
    assert vectors * values @ vectors.T == pytest.approx(a, abs=ROUNDING * 7)


@pytest.mark.parametrize("d", [1, 2, 3])
def test_a_diagonal_matrix_keeps_its_axes(d):
    a = np.diag([2.0, 5.0, 2.0][:d])
    values, vectors = found(a)
    assert values.tolist() == np.diag(a).tolist()
    assert vectors.tolist() == np.eye(d).tolist()
