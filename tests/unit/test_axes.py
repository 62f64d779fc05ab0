"""Isotropic functions by projectors: those of a decomposition in axes, even where values meet."""

from __future__ import annotations

import numba
import numpy as np
import pytest

from dolfinmpm.dynamics.axes import axes, combine

INDEX = ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2))


@numba.njit(error_model="numpy")
def decomposed(a):
    """Eigenvalues, and components of P and D."""
    return axes(a[0, 0], a[1, 1], a[2, 2], a[0, 1], a[1, 2], a[0, 2])


@numba.njit(error_model="numpy")
def on_diagonal(first, second, third, P, D):
    return combine(first, second, third, P, D)


def tensor(first, second, third, parts):
    """The tensor with other eigenvalues."""
    P, D = np.array(parts[3:9]), np.array(parts[9:])
    found = np.zeros((3, 3))
    for k, (i, j) in enumerate(INDEX):
        one = 0.5 * (second + third) * (i == j)
        found[i, j] = found[j, i] = (
            one + (first - 0.5 * (second + third)) * P[k] + 0.5 * (second - third) * D[k]
        )
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
        parts = decomposed(a)
        assert sorted(parts[:3]) == pytest.approx(sorted(values), abs=4e-15)
        assert np.abs(tensor(*parts[:3], parts) - a).max() <= 4e-15
        value, axis = np.linalg.eigh(a)
        for f in (np.log, np.sqrt):
            expected = axis @ np.diag(f(value)) @ axis.T
            found = tensor(*f(parts[:3]), parts)
            assert np.abs(found - expected).max() <= 4e-15
            for i in range(3):
                one = on_diagonal(*f(parts[:3]), parts[3 + i], parts[9 + i])
                assert one == pytest.approx(expected[i, i], abs=4e-15)


@pytest.mark.parametrize("size", [1e-80, 1e-20, 1e60])
def test_sizes(size):
    rng = np.random.default_rng(2)
    a = rng.normal(size=(3, 3))
    a = size * (a + a.T)
    parts = decomposed(a)
    assert np.abs(tensor(*parts[:3], parts) - a).max() <= 4e-15 * np.abs(a).max()
    assert np.sort(parts[:3]) == pytest.approx(np.linalg.eigvalsh(a), abs=4e-15 * np.abs(a).max())


def test_no_tensor_at_all():
    assert decomposed(np.zeros((3, 3)))[:3] == (0.0, 0.0, 0.0)
