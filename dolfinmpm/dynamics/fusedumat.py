"""UMATs in the fused loops of explicit steps: their data, and a point's stress."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numba
import numpy as np
import numpy.typing as npt

from dolfinmpm._platform.simd import matrix, numbers
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.dynamics.smalltensors import add_symmetric, carried, take_symmetric
from dolfinmpm.forms.declarations import Declaration
from dolfinmpm.grid.lattice import smallest_height
from dolfinmpm.kinematics.incremental import ENERGIES
from dolfinmpm.kinematics.umatpoint import (
    INLINE,
    column,
    put,
    respond,
    row,
    spin,
    start,
    take_six,
    turn,
)
from dolfinmpm.materials.umatcall import FAILURES
from dolfinmpm.materials.umatshim import OFFSETS

__all__ = ["UmatCalls", "begin_umats", "umat_stress", "variables_of"]

_STRESS, _STRAIN = OFFSETS["stress"], OFFSETS["stran"]
_ENERGY, _STATE = OFFSETS["energies"], OFFSETS["statev"]


def variables_of(declaration: Declaration) -> list[str]:
    """Names of the fields that are state variables of a UMAT in the loops: energies, STATEV."""
    return [*ENERGIES, *declaration.law.internal]


@dataclass
class UmatCalls:
    """Data of the calls of the UMATs of a form.

    Attributes:
        names: CMNAME of each law, shape (laws, 80).
        sizes: Sizes of each law, see `UMAT.numbers`, shape (laws, 6).
        ids: Numbers of the points.
        work: Arrays of a call, see `OFFSETS`.
        moment: Time at the start of the strain (s), size of a cell (m), and time that it takes (s).
        status: Number of the last failure, see `FAILURES`.
    """

    names: npt.NDArray[np.uint8]
    sizes: npt.NDArray[np.int64]
    ids: npt.NDArray[np.int64]
    work: npt.NDArray[np.float64]
    moment: npt.NDArray[np.float64]
    status: npt.NDArray[np.int32]

    @classmethod
    def of(cls, points: MaterialPoints, declarations: Sequence[Declaration]) -> UmatCalls:
        """The data of the declared UMATs. Collective."""
        laws = [d.law for d in declarations]
        width = max(len(law.internal) for law in laws)
        return cls(
            np.stack([law.name for law in laws]),
            np.stack([law.numbers(6 if points.gdim == 3 else 4) for law in laws]),
            points["id"], np.zeros(_STATE + max(width, 1)),
            np.array([0.0, smallest_height(points.grid), 1.0]), np.zeros(1, np.int32),
        )  # fmt: skip

    @property
    def data(self) -> tuple[npt.NDArray, ...]:
        """The arrays for the loops."""
        return self.names, self.sizes, self.ids, self.work, self.moment, self.status

    def failure(self) -> str:
        """What the last failure of a UMAT was, or an empty string."""
        return FAILURES.get(int(self.status[0]), "")


@numba.njit(**INLINE)
def begin_umats(calls):
    """Write what all points of a step share."""
    work, moment, status = calls[3], calls[4], calls[5]
    start(work, moment[0], moment[2], moment[1])
    status[0] = 0


@numba.njit(**INLINE)
def umat_stress(
    d, jaumann, calls, laws, law, dt, H, F, dF, J, X, p, state, internal, tau, out, t
):  # fmt: skip
    """Write a point's Cauchy stress after an increment, and its new state.

    Args:
        d, jaumann: Dimension; Jaumann's rate or small strain.
        calls: See `UmatCalls.data`.
        laws, law: See `Laws.table`, and the number of the UMAT.
        dt, H: Length of the step (s), and the rate of the increment (1/s).
        F, dF: Deformation gradient before the increment, and that of the increment.
        J: Volume ratio before the increment.
        X: Positions (m), of all points as are the next arrays.
        p: The point.
        state, internal: Total strain; energies and state variables.
        tau, out: J σ (Pa); σ across the plane in two dimensions.
        t: Written: σ (Pa).

    Returns:
        Whether the UMAT has found a stress.
    """
    names, sizes, ids, work, _, status = calls
    addresses, properties, _, _ = laws
    m = 6 if d == 3 else 4
    R, e, G, sigma = matrix(3, 3), matrix(3, 3), matrix(3, 3), matrix(3, 3)
    w = numbers(3)
    for i in range(3):
        for j in range(3):
            e[i, j] = sigma[i, j] = 0.0
    for i in range(d):
        for j in range(d):
            G[i, j] = dt * H[i, j]
    if jaumann:
        # by the middle of the step
        if not carried(d, 0.5, G, G) > 0.0:
            return False
        scale = spin(d, G, w)
        turn(d, w, scale, R)
    add_symmetric(d, 1.0, G, e)
    take_symmetric(d, d, tau, p, sigma)
    for i in range(d):
        for j in range(d):
            sigma[i, j] *= 1.0 / J if jaumann else 1.0
    if d == 2:
        sigma[2, 2] = out[p]
    take_six(m, state, p, t)
    put(d if jaumann else 0, m, t, R, 2.0, work, _STRAIN)
    for k in range(3):
        work[_ENERGY + k] = internal[p, k]
    count = sizes.ctypes.data + 48 * law
    variables = sizes[law, 3]
    for k in range(variables):
        work[_STATE + k] = internal[p, 3 + k]
    sizes[law, 5] = ids[p]
    status[0] = respond(
        d, m, jaumann, addresses[law], properties.ctypes.data + 8 * law * properties.shape[1],
        count, names.ctypes.data + 80 * law, work, sigma, R, e, F, dF, X, p,
    )  # fmt: skip
    total = 0.0
    for k in range(m):
        i, j = row(k), column(k)
        total += work[_STRESS + k]
        t[i, j] = t[j, i] = work[_STRESS + k]
        strain = work[_STRAIN + k] if k < 3 else 0.5 * work[_STRAIN + k]
        state[p, k if k < 4 else 9 - k] = strain + e[i, j]
    for k in range(3):
        internal[p, k] = work[_ENERGY + k]
    for k in range(variables):
        internal[p, 3 + k] = work[_STATE + k]
        total += work[_STATE + k]
    if d == 2:
        out[p] = t[2, 2]
    if status[0] == 0 and not abs(total) < np.inf:
        status[0] = 3
    return status[0] == 0
