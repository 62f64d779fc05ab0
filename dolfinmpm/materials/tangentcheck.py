"""A law's tangent against differences of its stress."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from dolfinmpm._platform.argumentchecks import number

if TYPE_CHECKING:
    from dolfinmpm.materials.base import Law

__all__ = ["check_law", "tangent_fault"]

Array = npt.NDArray[np.float64]

_POINTS = 24
# Largest trial strains
_STRAINS = 1e-3, 1e-2, 1e-1
# Differences to both sides that differ by more than this share show a kink
_KINK = 0.02
# Share of the strain by which differences are taken
_STEP = 1e-4


def check_law(law: Law, strain: float | None, tolerance: float) -> list[str]:
    """The faults of a law's tangent as text; see `Law.check`."""
    number("tolerance", tolerance, 0.0)
    if strain is not None:
        number("strain", strain, 0.0)
        return _faults_at(law, strain, tolerance)
    # soft ground yields at large strains only; a law may have no stress there
    for size in _STRAINS:
        if told := _faults_at(law, size, tolerance, needed=size == _STRAINS[0]):
            return told
    return []


def _faults_at(law: Law, strain: float, tolerance: float, *, needed: bool = True) -> list[str]:
    """The faults at trial strains of one size, where stresses may be needed."""
    # the same points in every call: a check must be repeatable
    trial = strain * np.random.default_rng(1).uniform(-1, 1, (_POINTS, 3))
    parameters = law.parameter_array(None)
    old = np.repeat(law.first_internal(parameters)[:1], _POINTS, axis=0)
    stress, tangent = _responses(law, trial, old, parameters)
    good: npt.NDArray[np.bool_] = np.asarray(np.isfinite(stress).all(axis=1))
    h, numeric, kink = strain * _STEP, np.empty((_POINTS, 3, 3)), np.zeros(_POINTS)
    for j in range(3):
        moved = [trial + s * np.eye(3)[j] for s in (h, -h)]
        ahead, behind = (_responses(law, at, old, parameters)[0] for at in moved)
        good = good & np.isfinite(ahead + behind).all(axis=1)
        numeric[:, :, j] = (ahead - behind) / (2 * h)
        kink = np.maximum(kink, np.abs(ahead - 2 * stress + behind).max(axis=1) / h)
    if not good.any() and not needed:
        return []
    if not good.any():
        return [f"{law!r} finds no stress at any strain of the check; give a smaller strain"]
    turned, _ = _responses(law, trial[:, [1, 2, 0]], old, parameters)
    gap = np.abs(turned[good] - stress[good][:, [1, 2, 0]]).max()
    # NaN, where the turned strain has no stress, is a difference, too
    if not gap <= tolerance * np.abs(stress[good]).max():
        return [
            f"{law!r} depends on the order of the axes: of the same strains in another order, a "
            f"stress differs by {gap:g} Pa. The three axes are those of the strain, in any order, "
            "so that a law is isotropic. For other materials take a UMAT, or an energy in UFL"
        ]
    good = good & (needed | (np.abs(numeric).max(axis=(1, 2)) > 0.0))  # not where all axes yield
    return tangent_fault(
        law, lambda i, j: f"tangent[{3 * i + j}]", tangent, numeric, kink, good, tolerance
    )


def _responses(law: Law, trial: Array, old: Array, parameters: Array) -> tuple[Array, Array]:
    """Stresses and tangents of single points; NaN at a point without a stress."""
    stress, tangent = np.full((len(trial), 3), np.nan), np.zeros((len(trial), 3, 3))
    for p in range(len(trial)):
        bad, found = law.evaluated(trial[p : p + 1], old[p : p + 1], parameters)
        if bad < 0:
            stress[p], tangent[p] = found.stress[0], found.tangent[0]
    return stress, tangent


def tangent_fault(
    law: Any,
    entry: Callable[[int, int], str],
    own: Array,
    numeric: Array,
    kink: Array,
    good: npt.NDArray[np.bool_],
    tolerance: float,
) -> list[str]:
    """The largest difference between a tangent and differences of stress, as text.

    Args:
        law: The law, for the message.
        entry: Name of an entry of the tangent by its row and column.
        own: Tangents of the law (Pa), shape (points, m, m).
        numeric: Differences of stress over strain (Pa), likewise.
        kink: Difference of the slopes to both sides (Pa), shape (points,).
        good: Whether a point has a stress, shape (points,).
        tolerance: Largest difference, as a share of the largest entry.
    """
    size = np.abs(numeric).max(axis=(1, 2))
    compared = good & np.isfinite(size) & (size > 0) & (kink <= _KINK * size)
    if not compared.any() and not good.all():
        return []
    if not compared.any():
        return [
            f"{law!r}: no point without a kink for its tangent. Stresses of single precision look "
            "like this, too: are all its numbers REAL*8?"
        ]
    gap = np.abs(own - numeric).max(axis=(1, 2)) / np.where(compared, size, 1.0)
    gap[~compared] = 0.0
    gap[compared & ~np.isfinite(gap)] = np.inf
    worst = int(np.argmax(gap))
    if gap[worst] <= tolerance:
        return []
    i, j = divmod(int(np.argmax(np.abs(own[worst] - numeric[worst]))), own.shape[-1])
    return [
        f"{law!r} has a wrong tangent: {entry(i, j)} = {own[worst, i, j]:g} Pa, but "
        f"differences of the stress give {numeric[worst, i, j]:g} Pa ({(gap > tolerance).sum()} of "
        f"{compared.sum()} points differ by more than {tolerance:g}). Newton's method then takes "
        "more iterations"
    ]
