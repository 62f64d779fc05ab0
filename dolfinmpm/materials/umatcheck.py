"""Faults of a UMAT: state between points, and a wrong tangent."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from dolfinmpm._platform.argumentchecks import coordinates, number, shown
from dolfinmpm._platform.errors import ParameterError
from dolfinmpm.materials.tangentcheck import tangent_fault
from dolfinmpm.materials.umatcall import DDSDDE, FAILURES, STATEV, STRESS
from dolfinmpm.materials.umatshim import OFFSETS

if TYPE_CHECKING:
    from dolfinmpm.materials.umat import UMAT

__all__ = ["check_umat"]

Array = npt.NDArray[np.float64]

_POINTS = 24
# Share of the strain increment by which differences are taken
_STEP = 1e-4


def check_umat(
    law: UMAT,
    stress: float | Sequence[float],
    strain: float,
    components: int,
    tolerance: float,
) -> list[str]:
    """The faults of a UMAT as text; see `UMAT.check`."""
    if components not in (4, 6):
        raise ParameterError(f"components = {components} must be 4 or 6")
    number("strain", strain, 0.0), number("tolerance", tolerance, 0.0)
    mean = coordinates("stress", stress)
    if mean.ndim == 0:
        mean = np.array([float(mean)] * 3 + [0.0] * (components - 3))
    if mean.shape != (components,):
        raise ParameterError(f"stress = {shown(stress)} must be a number or {components} numbers")
    # the same points in every call: a check must be repeatable
    random = np.random.default_rng(1)
    size = np.abs(mean).max()
    sigma = mean + 0.1 * size * random.uniform(-1, 1, (_POINTS, components))
    increments = strain * random.uniform(-1, 1, (_POINTS, components))
    # varying or arrayed first values need points: the first one serves
    state = np.repeat(law.first_state(np.zeros((1, 3))), _POINTS, axis=0)
    work = law.work(sigma, state, components)
    at = OFFSETS["dstran"]
    work[:, at : at + components] = increments
    law.try_once(work[0], components)
    found = _between_points(law, work, components)
    return found + _tangent(law, work, components, strain * _STEP, tolerance)


def _run(law: UMAT, work: Array, components: int) -> tuple[Array, npt.NDArray[np.int32]]:
    result = work.copy()
    return result, law.call(result, components)


def _between_points(law: UMAT, work: Array, components: int) -> list[str]:
    """Differences between evaluations of the same points in other orders."""
    _run(law, work, components)  # what is read once, at the first call, is no fault
    forward, status = _run(law, work, components)
    backward, _ = _run(law, work[::-1].copy(), components)
    twice, _ = _run(law, np.repeat(work, 2, axis=0), components)
    faults = []
    if (status != 0).all():
        faults.append(f"{law!r} {FAILURES[int(status[0])]} at all points of the check")
    others = {"another order": backward[::-1], "each point twice": twice[1::2]}
    for order, other in others.items():
        for what, start, size in (
            ("stress", STRESS, components),
            ("state variables", STATEV, len(law.internal)),
            ("DDSDDE", DDSDDE, components**2),
        ):
            columns = slice(start, start + size)
            if not np.array_equal(forward[:, columns], other[:, columns], equal_nan=True):
                gap = np.nanmax(np.abs(forward[:, columns] - other[:, columns]))
                faults.append(
                    f"{law!r} keeps state between points: evaluated in {order}, its {what} differ "
                    f"by {gap:g}. Look for SAVE, COMMON, DATA, and variables that are not set; "
                    "keep history in STATEV only"
                )
                break
    return faults


def _tangent(law: UMAT, work: Array, components: int, h: float, tolerance: float) -> list[str]:
    """Differences between DDSDDE and differences of stress."""
    m = components
    base, status = _run(law, work, m)
    good = status == 0
    numeric = np.empty((len(work), m, m))
    kink = np.zeros(len(work))
    for j in range(m):
        sides = []
        for sign in (1.0, -1.0):
            moved = work.copy()
            moved[:, OFFSETS["dstran"] + j] += sign * h
            result, status = _run(law, moved, m)
            good &= status == 0
            sides.append(result[:, STRESS : STRESS + m])
        numeric[:, :, j] = (sides[0] - sides[1]) / (2 * h)
        bend = np.abs(sides[0] - 2 * base[:, STRESS : STRESS + m] + sides[1]).max(axis=1) / h
        kink = np.maximum(kink, bend)
    # Fortran stores column by column
    own = base[:, DDSDDE : DDSDDE + m * m].reshape(-1, m, m).swapaxes(1, 2)
    if good.any() and not numeric[good].any():
        return [
            f"{law!r} gives the same stress for every DSTRAN. Does it set STRESS? Are its numbers "
            "REAL*8 (INCLUDE 'ABA_PARAM.INC')? Has it all arguments of UMAT?"
        ]
    return tangent_fault(
        law, lambda i, j: f"DDSDDE({i + 1},{j + 1})", own, numeric, kink, good, tolerance
    )
