"""The elastic strain of a given stress: the inverse of a law's elastic response."""

from __future__ import annotations

import math

import numba
import numpy as np
import numpy.typing as npt

from dolfinmpm.basis.cells import invert
from dolfinmpm.materials.base import Law
from dolfinmpm.materials.lawkernel import call_law

__all__ = ["belong", "elastic_strain"]

Array = npt.NDArray[np.float64]

# Largest error of a strain that is kept as a stretch, by rounding
_ROUNDED = 1e-14
# A determinant that is rounding beside its terms, and what its matrix then gets on the diagonal, by
# the largest modulus: enough for a determinant that is not rounding
_SINGULAR, _SHIFT = 1e-15, 1e-4


@numba.njit(cache=True, error_model="numpy")
def _invert_stiffness(D, inverse):
    """Write the inverse of a stiffness D, shape (3, 3); that of a fluid has none, and is shifted.

    The strain of a stress that a fluid has then converges by the factor of the shift.
    """
    largest = max(abs(D[0, 0]), abs(D[1, 1]), abs(D[2, 2]))
    if abs(invert(D, inverse)) <= _SINGULAR * largest**3:
        for i in range(3):
            D[i, i] += _SHIFT * largest
        invert(D, inverse)


@numba.njit(cache=True, error_model="numpy")
def _invert(law, parameters, elastic, old, stress, strain, reached, good):
    trial, tau, best = np.empty(3), np.empty(3), np.empty(3)
    D, inverse = np.empty((3, 3)), np.empty((3, 3))
    new, step = np.empty(max(old.shape[1], 1)), np.empty(3)
    for p in range(stress.shape[0]):
        at = p if parameters.shape[0] > 1 else 0
        size = max(abs(stress[p, 0]), abs(stress[p, 1]), abs(stress[p, 2]))
        for i in range(3):
            strain[p, i] = step[i] = 0.0
            best[i] = 0.0
        error, share, soft = math.inf, 1.0, 0.0
        # Newton's method; a step that does not reduce the error of the stress is halved
        for _ in range(400):
            for i in range(3):
                strain[p, i] = best[i] + share * step[i]
                trial[i] = strain[p, i]
            status = call_law(
                law, parameters.ctypes.data + 8 * at * parameters.shape[1], trial.ctypes.data,
                elastic.ctypes.data + 8 * p * elastic.shape[1], new.ctypes.data,
                tau.ctypes.data, D.ctypes.data,
            )  # fmt: skip
            found = math.inf
            if status == 0:
                found = max(
                    abs(stress[p, 0] - tau[0]), abs(stress[p, 1] - tau[1]),
                    abs(stress[p, 2] - tau[2]),
                )  # fmt: skip
            if not found < error:
                share *= 0.5
                if share < 1e-12 or error <= 1e-13 * size:
                    break
                continue
            if error == math.inf:
                stiff = max(abs(D[0, 0]), abs(D[1, 1]), abs(D[2, 2]))
                soft = size / stiff if stiff > 0.0 else 0.0
            error, share = found, 1.0
            for i in range(3):
                best[i] = strain[p, i]
            if error == 0.0:
                break
            _invert_stiffness(D, inverse)
            for i in range(3):
                step[i] = 0.0
                for j in range(3):
                    step[i] += inverse[i, j] * (stress[p, j] - tau[j])
            if not math.isfinite(step[0] + step[1] + step[2]):
                break
        # the law itself, with its own yield surface, checks the result: under this strain it
        # returns the stress without plastic flow, except for rounding on the yield surface
        largest = soft
        for i in range(3):
            strain[p, i] = trial[i] = best[i]
            largest = max(largest, abs(best[i]))
        status = call_law(
            law, parameters.ctypes.data + 8 * at * parameters.shape[1], trial.ctypes.data,
            old.ctypes.data + 8 * p * old.shape[1], new.ctypes.data, tau.ctypes.data,
            D.ctypes.data,
        )  # fmt: skip
        good[p] = status == 0
        for i in range(3):
            reached[p, i] = tau[i] if status == 0 else math.nan
            good[p] &= abs(tau[i] - stress[p, i]) <= 1e-9 * size
            good[p] &= abs(trial[i] - best[i]) <= 1e-9 * largest


def elastic_strain(
    law: Law, stress: Array, internal: Array, parameters: Array
) -> tuple[Array, npt.NDArray[np.bool_], Array]:
    """Principal elastic strains under which a law returns given stresses without yielding.

    Args:
        law: Constitutive law.
        stress: Principal stresses of the law (Pa), shape (n, 3).
        internal: Internal variables, shape (n, variables).
        parameters: Parameters, shape (1, parameters) or (n, parameters).

    Returns:
        The strains, shape (n, 3); whether the law returns the given stress, shape (n,); and
        the stresses returned by the law (Pa), shape (n, 3).
    """
    stress = np.ascontiguousarray(stress)
    parameters = np.ascontiguousarray(parameters)
    strain, reached = np.empty_like(stress), np.empty_like(stress)
    good = np.empty(len(stress), bool)
    old = np.ascontiguousarray(internal)
    elastic = np.ascontiguousarray(law.unyielding(old))
    _invert(law.address, parameters, elastic, old, stress, strain, reached, good)
    return strain, good, reached


def belong(
    law: Law, strain: Array, stress: Array, internal: Array, parameters: Array, share: float
) -> npt.NDArray[np.bool_]:
    """Whether a law's elasticity gives stresses for strains, shape (n,).

    Stresses beyond the strength are accepted, because the law returns them for no strain.

    Args:
        law: Constitutive law.
        strain: Principal elastic strains, shape (n, 3).
        stress: Principal stresses of the law (Pa), shape (n, 3), in the order of the strains.
        internal: Internal variables, shape (n, variables).
        parameters: Parameters, shape (1, parameters) or (n, parameters).
        share: Difference regarded as zero, as a share of the largest stress at the point. What the
            rounding of a strain makes is regarded as zero, too.
    """
    slack = share * np.abs(stress).max(axis=1, initial=0.0)
    if law.has_moduli:
        M, G = law.moduli(strain, internal, parameters).T
        # strains are rounded as differences from 1
        slack = slack + _ROUNDED * M
        volume = strain.sum(axis=1)
        found = ((M - 2 * G) * volume)[:, None] + 2 * np.atleast_1d(G)[:, None] * strain
    else:
        found = law.response(strain, law.unyielding(internal), parameters)
    # NaN where no stress exists
    same = np.abs(found - stress).max(axis=1, initial=0.0) <= slack
    return same | (law.yield_function(stress, internal, parameters) > 0)
