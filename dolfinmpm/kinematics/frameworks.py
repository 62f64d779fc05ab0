"""What the strain frameworks share: a law, its state at the points, and the loop over them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.forms.declarations import Tags, rows_within
from dolfinmpm.kinematics.parameters import PointParameters
from dolfinmpm.materials.base import Law

__all__ = ["Framework", "symmetric", "widened"]

Array = npt.NDArray[np.float64]
Rows = npt.NDArray[np.int32]


def symmetric(components: Array) -> Array:
    """Tensors of shape (..., 3, 3) from (xx, yy, zz, xy, yz, zx), shape (..., 6)."""
    return components[..., [[0, 3, 5], [3, 1, 4], [5, 4, 2]]]


def widened(tensor: Array) -> Array:
    """Tensors of shape (n, d, d) as (n, 3, 3), with zeros across."""
    d = tensor.shape[-1]
    wide = np.zeros((len(tensor), 3, 3))
    wide[:, :d, :d] = tensor
    return wide


class Framework:
    """A law under one measure of strain, as an operator of the increment's gradient.

    Adds to the points, once bound, the field `state`, six components of the elastic strain's
    tensor (xx, yy, zz, xy, yz, zx); one field for each internal variable of the law, by
    its name; and those of `PointParameters`. Laws with other tags share the fields, each
    with values at its own points only; the internal variables of others are 0 there.

    A subclass gives `kernel`, a compiled loop over the points for every dimension:

    `kernel(law, parameters, H, F_n, state_n, internal_n, S, A, want_tangent, commit,
    state, internal, sigma) -> first point without a stress, or -1`.

    Attributes:
        measure: Name of the measure of strain.
        multiplicative: Whether increments of deformation are multiplied and the law's
            stress is Kirchhoff's, rather than added and Cauchy's.
        state: Name of the field.
        rest: The field's value without elastic strain.

    Args:
        law: Constitutive law.
        points: Material points.
        tags: Tags of the points that the law is for; None means all.
    """

    measure: str
    multiplicative: bool
    state: str
    rest: tuple[float, ...]
    kernel: Callable[[int], Callable]
    _takes_F = False

    def __init__(self, law: Law, points: MaterialPoints, tags: Tags = None):
        self.law = law
        self.points = points
        self.tags = tags
        self._parameters = PointParameters(law, points, tags)
        self._kernel = type(self).kernel(points.gdim)

    @property
    def rows(self) -> Rows:
        """The law's points on this rank."""
        return rows_within(self.points, self.tags)

    def bind(self) -> None:
        """Add the fields, with first values where points have none. Collective.

        Raises:
            ParameterError: A parameter that varies is outside its range somewhere.
        """
        self._parameters.adopt()
        points, rows = self.points, self.rows
        points.add_field(self.state, (6,), "", self.rest)
        parameters = self.parameters(rows)
        first = np.broadcast_to(
            self.law.first_internal(parameters), (len(rows), len(self.law.internal))
        )
        for k, (name, (unit, _)) in enumerate(self.law.internal.items()):
            # which points have a value: another law may give them another first one
            known = f"has_{name}"
            if known not in points.fields:
                given = name in points.fields
                points.fields[known] = np.full(len(points), given, np.int8)
                points.add_field(name, (), unit)
            new = points[known][rows] == 0
            points[name][rows[new]] = first[new, k]
            points[known][rows] = 1

    def parameters(self, rows: Rows | slice) -> Array:
        """The law's parameters, shape (1, parameters) or, if any varies, (rows, parameters)."""
        return self._parameters.at(rows)

    def internal(self, rows: Rows | slice) -> Array:
        """The law's internal variables at some points, shape (rows, variables)."""
        columns = [self.points[name][rows] for name in self.law.internal]
        if not columns:
            return np.empty((len(self.points["id"][rows]), 0))
        return np.stack(columns, axis=1)

    def _run(self, operand, S, A, want_tangent, rows, new, internal, sigma) -> int:
        points = self.points
        F = points["F"].take(rows, axis=0) if self._takes_F or len(sigma) else points["F"]
        return self._kernel(
            self.law.address, self.parameters(rows), operand, F,
            points[self.state].take(rows, axis=0), self.internal(rows),
            S, A, want_tangent, len(sigma) > 0, new, internal, sigma,
        )  # fmt: skip

    def evaluate(self, operand: Array, value: Array, tangent: Array | None, rows: Rows) -> int:
        """Flux S and its derivative by ∇ũ; see `PointwiseLaw`."""
        nothing = np.empty((0, 6)), np.empty((0, 0)), np.empty((0, 3, 3))
        A = np.empty((0, 1, 1)) if tangent is None else tangent
        return self._run(operand, value, A, tangent is not None, rows, *nothing)

    def commit(self, operand: Array, rows: Rows) -> dict[str, Array]:
        """Elastic strain, internal variables and Cauchy stress at the end of the step."""
        n = len(rows)
        new = {self.state: np.empty((n, 6)), "stress": np.empty((n, 3, 3))}
        internal = np.empty((n, len(self.law.internal)))
        if n:
            none = np.empty((0, 1)), np.empty((0, 1, 1))
            operand = np.ascontiguousarray(operand)
            bad = self._run(operand, *none, False, rows, new[self.state], internal, new["stress"])
            if bad >= 0:
                for values in new.values():
                    values[bad:] = np.nan
        new |= {name: internal[:, k].copy() for k, name in enumerate(self.law.internal)}
        return new

    def trial_strain(self, operand: Array, rows: npt.NDArray[np.int32]) -> Array:
        """Trial elastic strain tensors of some points, as the law sees them.

        Args:
            operand: Gradients of the increment at these points, shape (n, d, d).
            rows: Which points they are, shape (n,).

        Returns:
            Shape (n, 3, 3); not a number where the increment admits none.
        """
        raise NotImplementedError

    def describe(self, operand: Array, row: int) -> str:
        """What is known of a point at which there is no stress, for messages.

        Args:
            operand: Gradient of the increment there, shape (d, d).
            row: Which point of this rank it is.
        """
        d = self.points.gdim
        H = np.asarray(operand, float).reshape(1, d, d)
        det = float(np.linalg.det(np.eye(d) + H[0]))
        trial = self.trial_strain(H, np.array([row], np.int32))[0]
        if not np.isfinite(trial).all():
            return f"det ΔF = {det:.4g} of the increment turns the point inside out"
        here = slice(row, row + 1)
        number = int(self.points["id"][row])
        strain = np.linalg.eigvalsh(trial)
        return self.law.describe(number, strain, self.internal(here)[0], self.parameters(here))
