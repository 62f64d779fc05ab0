"""Laws and fields of the points in the layout of the fused loops.

A neo-Hookean law stores all work of its stress. So the loops need not sum up the work of every
step: the work is exactly the change of the stored energy.
"""

from __future__ import annotations

from collections.abc import Sequence, Set
from typing import Any

import numba
import numpy as np
import numpy.typing as npt

from dolfinmpm.body.points import MOTION, MaterialPoints
from dolfinmpm.dynamics.fusedumat import UmatCalls, variables_of
from dolfinmpm.dynamics.mass import point_masses
from dolfinmpm.dynamics.passes import FAST, JAUMANN, LAW, NEO, SMALL
from dolfinmpm.dynamics.smalltensors import (
    contracted,
    determinant,
    logarithm,
    logarithm_near_one,
)
from dolfinmpm.forms.declarations import Declaration
from dolfinmpm.grid.tensors import determinants
from dolfinmpm.kinematics.incremental import Incremental
from dolfinmpm.materials.base import lame
from dolfinmpm.materials.neohookean import NeoHookean
from dolfinmpm.materials.umat import UMAT

__all__ = ["Laws", "PointArrays", "formulation_of", "stored_energy"]


@numba.njit(error_model="numpy", fastmath=FAST)
def _in_plane(F, V0, lmbda, mu):
    """Stored energy of one law in two dimensions, and the number of points with a wrong energy.

    The energy is wrong for points with J far from 1. Without a branch for these points, the loop
    handles several points at once.
    """
    total, far = 0.0, 0
    for p in range(F.shape[0]):
        a, b, c, e = F[p, 0, 0], F[p, 0, 1], F[p, 1, 0], F[p, 1, 1]
        J = a * e - b * c
        z = (J - 1.0) / (J + 1.0)
        far += not abs(z) <= 0.1
        q = logarithm_near_one(z)
        trace = a * a + b * b + c * c + e * e - 2.0
        total += V0[p] * (0.5 * mu * trace - mu * q + 0.5 * lmbda * q * q)
    return total, far


@numba.njit(cache=True, error_model="numpy", fastmath=FAST)
def stored_energy(F, V0, numbers, which):
    """Σ V₀ ψ, ψ = ½μ (tr FᵀF − d) − μ ln J + ½λ (ln J)².

    Args:
        F: Deformation gradients, shape (n, d, d). Points with det F ≤ 0 are left out.
        V0: Initial volumes (m^d), shape (n,).
        numbers: λ and μ per law (Pa), shape (laws, 2).
        which: Number of the law per point, shape (n,), or (1,) for a single law.

    Returns:
        The energy (J; per metre of thickness in 2D).
    """
    d = F.shape[1]
    if d == 2 and which.shape[0] == 1:
        total, far = _in_plane(F, V0, numbers[which[0], 0], numbers[which[0], 1])
        if far == 0:
            return total
    total = 0.0
    for p in range(F.shape[0]):
        L = which[p] if which.shape[0] > 1 else which[0]
        lmbda, mu = numbers[L, 0], numbers[L, 1]
        J = determinant(d, F[p])
        if J > 0.0:
            q = logarithm(J)
            stretch = contracted(d, F[p], F[p]) - d
            total += V0[p] * (0.5 * mu * stretch - mu * q + 0.5 * lmbda * q * q)
    return total


def kirchhoff(F, numbers, which, pairs):
    """Kirchhoff's stress τ = λ ln J 1 + μ (FFᵀ − 1) (Pa), by the columns of `pairs`.

    Args:
        F, numbers, which: As for `stored_energy`.
        pairs: Rows and columns of the components.

    Returns:
        The components, shape (n, components).
    """
    lmbda, mu = numbers[which if len(which) > 1 else np.zeros(len(F), int)].T
    volumetric = lmbda * np.log(determinants(F))
    tau = np.empty((len(F), len(pairs[0])))
    for k, (i, j) in enumerate(zip(*pairs)):
        tau[:, k] = mu * np.sum(F[:, i] * F[:, j], axis=1)
        if i == j:
            tau[:, k] += volumetric - mu
    return tau


Array = npt.NDArray[np.float64]


def formulation_of(declaration: Declaration) -> int | None:
    """Number of the strain formulation of a law in the loops, or None if they have none."""
    if isinstance(declaration.law, NeoHookean):
        return NEO
    return {"large": LAW, "small": SMALL, "jaumann": JAUMANN}.get(declaration.strain)


class Laws:
    """The laws of a form in the layout of the fused loops.

    Args:
        points: Material points.
        declarations: Declarations of laws in the form.

    Attributes:
        kind: Kind of the strain formulation, see `dolfinmpm.dynamics.passes`.
        state: Name of the field of elastic strain; empty if the law uses F.
        fbar: Whether points share changes of volume, or "centres"; see `Declaration`.
        internal: Internal variables side by side, shape (n, variables).
        table: Addresses of the laws, their parameters, whether parameters vary over points, and
            the law of each point.
        calls: Data of the calls of UMATs, or None for other laws.
    """

    table: tuple[Any, ...]
    internal: Array
    calls: UmatCalls | None = None

    def __init__(self, points: MaterialPoints, declarations: Sequence[Declaration]):
        self._points, self._declarations = points, list(declarations)
        kind = formulation_of(self._declarations[0])
        assert kind is not None
        self.kind, self._stored = kind, 0.0
        self._revision, self._marked = -1, False
        # revision of the state that the known stored energy belongs to
        self._stored_of: tuple[int, bytes] | None = None
        self._published = isinstance(self._declarations[0].law, UMAT)
        self.state = {LAW: "be", NEO: ""}.get(kind, "elastic_strain")
        if self._published:
            self.state = Incremental.state
        self.fbar = self._declarations[0].fbar

    def gather(self, touched: Set[str]) -> None:
        """Read the present parameters and internal variables of the points. Collective.

        Args:
            touched: Fields that may have changed since the last call, on any rank.
        """
        points, n = self._points, len(self._points)
        laws = self._declarations
        if self._revision == points.revision and touched <= MOTION:
            self._gather_again()
            return
        self._revision, self._marked = points.revision, False
        for d in laws:
            d.bind()
        addresses = np.zeros(len(laws), np.intp)
        if self.kind == NEO:
            numbers = np.array([lame(d.law.E, d.law.nu) for d in laws])
        elif self._published:
            addresses[:] = [d.law.address for d in laws]
            numbers = _rows([d.law.properties for d in laws])
            self.calls = UmatCalls.of(points, laws)
        else:
            addresses[:] = [d.law.stress_address for d in laws]
            numbers = self._parameters()
        which = np.zeros(1, np.uint8)
        if len(laws) > 1:
            which = np.zeros(n, np.uint8)
            for k, d in enumerate(laws):
                which[d.rows] = k
        by_points = any(d.law.varies for d in laws)
        self.table = addresses, numbers, by_points, which
        names = [] if self.kind == NEO else [list(d.law.internal) for d in laws]
        if self._published:
            names = [variables_of(d) for d in laws]
        width = max((len(own) for own in names), default=0)
        self._names = names
        if len(laws) == 1 and width == 1:
            # a single variable of a single law already has the layout of the loop
            self.internal = points[names[0][0]].reshape(-1, 1)
            return
        self.internal = np.zeros((n, width))
        for d, own in zip(laws, names):
            for k, name in enumerate(own):
                self.internal[d.rows, k] = points[name][d.rows]

    def _gather_again(self) -> None:
        """Read data that may have changed without a change of the laws' fields."""
        laws = self._declarations
        if self.kind == NEO:
            addresses, _, *others = self.table
            numbers = np.array([lame(d.law.E, d.law.nu) for d in laws])
            self.table = addresses, numbers, *others
        elif len(laws) == 1 and len(self._names[0]) == 1:
            self.internal = self._points[self._names[0][0]].reshape(-1, 1)

    def release(self) -> None:
        """Release references to the fields' arrays."""
        if len(self._declarations) == 1 and self.internal.shape[1] == 1:
            self.internal = np.empty((0, 1))

    def scatter(self) -> None:
        """Write the internal variables to the points' fields, and mark changed fields."""
        if not self._marked:
            marks = self._points.fields.read("moved_under")
            for d in self._declarations:
                marks[d.rows] = d.mark
            self._marked = True
        if len(self._declarations) == 1 and self.internal.shape[1] == 1:
            return
        for d, own in zip(self._declarations, self._names):
            for k, name in enumerate(own):
                self._points[name][d.rows] = self.internal[d.rows, k]

    def gained(self) -> float:
        """Energy stored by neo-Hookean points since the last call (J), on this rank."""
        _, numbers, _, which = self.table
        fields = self._points.fields
        now = stored_energy(fields.read("F"), fields.read("V0"), numbers, which)
        before, self._stored = self._stored, now
        self._stored_of = self._points.revision, numbers.tobytes()
        return now - before

    def start(self, touched: Set[str]) -> None:
        """Read the present state of the points and their stored energy. Collective.

        Args:
            touched: See `gather`.
        """
        self.gather(touched)
        if self.kind == NEO:
            now = self._points.revision, self.table[1].tobytes()
            if self._stored_of != now or touched & {"F", "V0"}:
                self.gained()

    def _parameters(self) -> Array:
        laws, n = self._declarations, len(self._points)
        # kernels also need parameters derived from the declared ones
        values = [d.parameters() for d in laws]
        if not any(d.law.varies for d in laws):
            return _rows([own[0] for own in values])
        width = max(own.shape[1] for own in values)
        numbers = np.zeros((n, width))
        for d, own in zip(laws, values):
            numbers[d.rows, : own.shape[1]] = own
        return numbers


def _rows(values: Sequence[Array]) -> Array:
    """Rows of different lengths, with zeros behind the shorter ones."""
    result = np.zeros((len(values), max(own.size for own in values)))
    for row, own in zip(result, values):
        row[: own.size] = own
    return result


# Rows and columns of a symmetric tensor, in the order of its components in the loops
_PAIRS = {2: ([0, 1, 0], [0, 1, 1]), 3: ([0, 1, 2, 0, 1, 0], [0, 1, 2, 1, 2, 2])}
# The same with the hoop component of axisymmetric points
_RINGS = [0, 1, 0, 2], [0, 1, 1, 2]


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
        self._pairs = _RINGS if points.axisymmetric else _PAIRS[d]
        tau = np.empty((n, len(self._pairs[0])))
        for k, (i, j) in enumerate(zip(*self._pairs)):
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
            self.data[-2][:] = kirchhoff(self._points["F"], numbers, which, self._pairs)

    def publish(self) -> None:
        """Give the fields what steps without a record keep for themselves and go on with."""
        points, (tau, e_out) = self._points, self.data[-2:]
        small = self._laws.kind == SMALL
        J = determinants(points["F"])
        points["V"][:] = J * points["V0"]
        i, j = self._pairs
        self.strain()
        sigma = tau if small else tau / J[:, None]
        points["stress"][:, i, j] = sigma
        points["stress"][:, j, i] = sigma
        if self._laws.calls is not None and points.gdim == 2:
            points["stress"][:, 2, 2] = e_out
        elif self._laws.state and points.gdim == 2:
            logarithmic = self._laws.kind == LAW
            points[self._laws.state][:, 2] = np.exp(2.0 * e_out) if logarithmic else e_out
