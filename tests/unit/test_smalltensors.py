"""Small tensors of the loops: those of a decomposition in axes, even where values meet."""

from __future__ import annotations

import numba
import numpy as np
import pytest

from dolfinmpm._platform.simd import matrix
from dolfinmpm.dynamics import smalltensors as small


@numba.njit(error_model="numpy")
def decomposed(d, a, r, P, D):
    """Principal values, P and D."""
    small.spectrum(d, a, r, P, D)


@numba.njit(error_model="numpy")
def combined(d, r, P, D, out):
    small.combine(d, r, P, D, out)


def parts_of(a):
    """Principal values, P and D of a tensor."""
    r, P, D = np.zeros(3), np.zeros((3, 3)), np.zeros((3, 3))
    decomposed(len(a), a, r, P, D)
    return r, P, D


def tensor(r, parts, d=3):
    """The tensor with other principal values."""
    found = np.zeros((d, d))
    combined(d, np.asarray(r), *parts[1:], found)
    return found


@pytest.mark.parametrize(
    "values",
    [
        (1.0, 1.0, 1.0), (1.001, 1.0, 0.998), (1.0, 1.0 + 1e-15, 1.3), (1.0, 1.0 + 1e-9, 0.5),
        (1.0, 1.0 + 1e-12, 1.0 + 1e-11), (0.5, 0.5, 2.0), (2.0, 2.0, 0.5), (1.0, 2.0, 3.0),
    ],
)  # fmt: skip
def test_functions_of_a_tensor(values):
    rng = np.random.default_rng(1)
    for k in range(40):
        Q = np.linalg.qr(rng.normal(size=(3, 3)))[0] if k else np.eye(3)
        a = Q @ np.diag(values) @ Q.T
        a = 0.5 * (a + a.T)
        parts = parts_of(a)
        assert sorted(parts[0]) == pytest.approx(sorted(values), abs=4e-15)
        assert np.abs(tensor(parts[0], parts) - a).max() <= 4e-15
        value, axis = np.linalg.eigh(a)
        for f in (np.log, np.sqrt):
            expected = axis @ np.diag(f(value)) @ axis.T
            assert np.abs(tensor(f(parts[0]), parts) - expected).max() <= 4e-15


@pytest.mark.parametrize("values", [(1.0, 1.0), (1.0, 1.0 + 1e-12), (2.0, 0.5)])
def test_functions_of_a_tensor_in_the_plane(values):
    for angle in (0.0, 0.3, 2.0):
        c, s = np.cos(angle), np.sin(angle)
        Q = np.array([[c, s], [-s, c]])
        a = Q @ np.diag(values) @ Q.T
        parts = parts_of(0.5 * (a + a.T))
        assert parts[0][1:] == pytest.approx(sorted(values)[::-1], abs=4e-15)
        expected = Q @ np.diag(np.log(values)) @ Q.T
        found = tensor([7.0, *np.log(parts[0][1:])], parts, 2)
        assert np.abs(found - expected).max() <= 4e-15


@pytest.mark.parametrize("size", [1e-80, 1e-20, 1e60])
def test_sizes(size):
    rng = np.random.default_rng(2)
    a = rng.normal(size=(3, 3))
    a = size * (a + a.T)
    parts = parts_of(a)
    assert np.abs(tensor(parts[0], parts) - a).max() <= 4e-15 * np.abs(a).max()
    assert np.sort(parts[0]) == pytest.approx(np.linalg.eigvalsh(a), abs=4e-15 * np.abs(a).max())


def test_no_tensor_at_all():
    assert np.all(parts_of(np.zeros((3, 3)))[0] == 0.0)


@numba.njit(error_model="numpy")
def changed(d, t, H, y, moved, diagonal):
    """H carried, y turned by its spin, and the diagonal of the stretch of 1 + t H."""
    F = matrix(3, 3)
    for i in range(d):
        for j in range(d):
            F[i, j] = t * H[i, j] + (1.0 if i == j else 0.0)
    scale = small.carried(d, t, H, moved)
    small.turned(d, t, H, y)
    small.stretches(d, F, diagonal)
    return scale, small.determinant(d, F)


@pytest.mark.parametrize("d", [2, 3])
def test_carried_turned_and_stretched(d):
    rng = np.random.default_rng(4)
    t = 0.1
    for _ in range(20):
        H, y = rng.normal(size=(d, d)), rng.normal(size=(d, d))
        y = y + y.T
        moved, turned, diagonal = np.zeros((d, d)), y.copy(), np.zeros(3)
        scale, det = changed(d, t, H, turned, moved, diagonal)
        F, W = np.eye(d) + t * H, 0.5 * t * (H - H.T)
        assert scale == pytest.approx(np.linalg.det(F), rel=1e-14)
        assert det == pytest.approx(np.linalg.det(F), rel=1e-14)
        assert np.abs(moved - H @ np.linalg.inv(F)).max() <= 1e-13
        R = np.linalg.solve(np.eye(d) - 0.5 * W, np.eye(d) + 0.5 * W)
        assert np.abs(turned - R @ y @ R.T).max() <= 1e-13
        value, axis = np.linalg.eigh(F.T @ F)
        U = axis @ np.diag(np.sqrt(value)) @ axis.T
        assert np.abs(diagonal[:d] - np.diag(U)).max() <= 1e-13
