"""Arrays of the points in the layout of the fused loops."""

from __future__ import annotations

from collections.abc import Set
from typing import Any

import numpy as np
import numpy.typing as npt

from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.dynamics.fusable import Laws
from dolfinmpm.dynamics.fusedneohookean import kirchhoff
from dolfinmpm.dynamics.mass import point_masses
from dolfinmpm.dynamics.passes import LAW, NEO, SMALL
from dolfinmpm.grid.tensors import determinants

__all__ = ["PointArrays"]

Array = npt.NDArray[np.float64]

# Rows and columns of a symmetric tensor, in the order of its components in the loops
_PAIRS = {2: ([0, 1, 0], [0, 1, 1]), 3: ([0, 1, 2, 0, 1, 0], [0, 1, 2, 1, 2, 2])}


# Fields that the kept arrays depend on, besides the elastic strain
_SOURCES = frozenset(("stress", "V", "V0", "density"))


class PointArrays:
    """Arrays of the points in the layout of the loops, for an unchanged set of points.

    Some arrays are computed from fields. They are kept from call to call as long as only the loops
    write to these fields.

    Args:
        points: Material points.
        laws: The laws of the points.
        affine: Name of the field of affine velocities, or None.

    Attributes:
        data: The arrays, in the order of the loops.
        J_bar: Product of the mean volume changes of all steps with F-bar; else empty.
        rows, skipped: All points, and space for points that a loop skips or does not scatter.
    """

    data: tuple[Any, ...]
    J_bar: Array

    def __init__(self, points: MaterialPoints, laws: Laws, affine: str | None):
        self._points, self._laws = points, laws
        d = points.gdim
        n = len(points)
        self._affine, self._revision = affine, points.revision
        state = points[laws.state] if laws.state else np.empty((0, 6))
        small, logarithmic = laws.kind == SMALL, laws.kind == LAW
        e_out = 0.5 * np.log(state[:, 2]) if logarithmic else state[:, 2].copy()
        if laws.calls is not None:
            # Cauchy's stress, and not the strain
            e_out = points["stress"][:, 2, 2].copy()
        # Kirchhoff stresses; by columns, because fancy indexing is ten times slower
        stress, J = points["stress"], 1.0 if small else points["V"] / points["V0"]
        tau = np.empty((n, len(_PAIRS[d][0])))
        for k, (i, j) in enumerate(zip(*_PAIRS[d])):
            tau[:, k] = J * stress[:, i, j]
        self.rows, self.skipped = np.arange(n, dtype=np.int32), np.empty((2, n), np.int32)
        self._own = point_masses(points), tau, e_out
        self.take()

    def still(self, touched: Set[str]) -> bool:
        """Whether the kept arrays are still valid after changes of some fields."""
        sources = _SOURCES | {self._laws.state}
        return self._revision == self._points.revision and not sources & touched

    def take(self) -> None:
        """Take references to the fields' arrays. Replaced arrays need a new call."""
        points, laws, n, d = self._points, self._laws, len(self._points), self._points.gdim
        m, tau, e_out = self._own
        C = points[self._affine] if self._affine else np.empty((n, d, d))
        state = points[laws.state] if laws.state else np.empty((0, 6))
        self.J_bar = points["J_bar"] if laws.fbar and laws.kind == LAW else np.empty(0)
        self.data = (
            points["x"], points["l"], points["l0"], points["velocity"], C, points["F"],
            points["V"], points["V0"], m, state, laws.internal, points["stress"],
            points["acceleration"], tau, e_out,
        )  # fmt: skip

    def release(self) -> None:
        """Release the references to the fields' arrays."""
        self.data, self.J_bar = (), np.empty(0)

    def strain(self) -> None:
        """Take stresses of the strains now, where the loops do not keep them."""
        if self._laws.kind == NEO:
            _, numbers, _, which = self._laws.table
            F, pairs = self._points["F"], _PAIRS[self._points.gdim]
            self.data[-2][:] = kirchhoff(F, numbers, which, pairs)

    def publish(self) -> None:
        """Give the fields what steps without a record keep for themselves and go on with."""
        points, (tau, e_out) = self._points, self.data[-2:]
        small = self._laws.kind == SMALL
        J = determinants(points["F"])
        points["V"][:] = J * points["V0"]
        i, j = _PAIRS[points.gdim]
        self.strain()
        sigma = tau if small else tau / J[:, None]
        points["stress"][:, i, j] = sigma
        points["stress"][:, j, i] = sigma
        if self._laws.calls is not None and points.gdim == 2:
            points["stress"][:, 2, 2] = e_out
        elif self._laws.state and points.gdim == 2:
            logarithmic = self._laws.kind == LAW
            points[self._laws.state][:, 2] = np.exp(2.0 * e_out) if logarithmic else e_out
