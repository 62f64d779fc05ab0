"""What the strain frameworks share: a law, its state at the points, and the loop over them."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
import numpy.typing as npt

from dolfinmpm._platform.errors import call_together
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.materials.base import Law

__all__ = ["Framework", "parameters_at", "symmetric", "widened"]

Array = npt.NDArray[np.float64]


def symmetric(components: Array) -> Array:
    """Tensors of shape (..., 3, 3) from (xx, yy, zz, xy, yz, zx), shape (..., 6)."""
    return components[..., [[0, 3, 5], [3, 1, 4], [5, 4, 2]]]


def widened(tensor: Array) -> Array:
    """Tensors of shape (n, d, d) as (n, 3, 3), with zeros across."""
    d = tensor.shape[-1]
    wide = np.zeros((len(tensor), 3, 3))
    wide[:, :d, :d] = tensor
    return wide


def _field_of(law: Law) -> str:
    return f"{type(law).__name__.lower()}_parameters"


def parameters_at(law: Law, points: MaterialPoints) -> Array:
    """A law's parameters at the points of this rank.

    Returns:
        Shape (1, parameters) if none varies, else (points, parameters).

    Raises:
        ParameterError: A value is outside its range, or their number is not that of
            the points.
    """
    if law.varies and _field_of(law) in points.fields:
        # given in the order that the points had at first: they may have migrated since
        return points[_field_of(law)]
    return law.parameter_array(points["x0"])


def _first_internal(law: Law, k: int, x: Array) -> Array:
    """The k-th internal variable of points at x, shape (gdim, n), that have not yielded."""
    first = law.first_internal(law.parameter_array(x.T))[:, k]
    return np.broadcast_to(first, x.shape[1:])


class Framework:
    """A law under one measure of strain, as an operator of the increment's gradient.

    Adds to the points the field `state`, six components of the elastic strain's tensor
    (xx, yy, zz, xy, yz, zx); one field for each internal variable of the law, by its
    name; and `<law>_parameters` if parameters vary from point to point.

    A subclass gives `kernel`, a compiled loop over the points for every dimension:

    `kernel(law, parameters, H, F_n, state_n, internal_n, S, A, want_tangent, commit,
    state, internal, sigma) -> first point without a stress, or -1`.

    Attributes:
        multiplicative: Whether increments of deformation are multiplied and the law's
            stress is Kirchhoff's, rather than added and Cauchy's.
        state: Name of the field.
        rest: The field's value without elastic strain.

    Args:
        law: Constitutive law.
        points: Material points.

    Raises:
        ParameterError: A parameter that varies is outside its range somewhere.
    """

    multiplicative: bool
    state: str
    rest: tuple[float, ...]
    kernel: Callable[[int], Callable]
    _takes_F = False

    def __init__(self, law: Law, points: MaterialPoints):
        self.law = law
        self.points = points
        points.add_field(self.state, (6,), "", self.rest)
        parameters = call_together(points.comm, lambda: law.parameter_array(points["x0"]))
        for k, (name, (unit, _)) in enumerate(law.internal.items()):
            points.add_field(name, (), unit, partial(_first_internal, law, k))
        self._parameters: Array | None = parameters
        if law.varies:
            # parameters of a point go with it from rank to rank
            self._field = _field_of(law)
            points.add_field(
                self._field, (parameters.shape[1],), "", lambda x: law.parameter_array(x.T)
            )
            points[self._field] = parameters
            self._parameters = None
        self._kernel = type(self).kernel(points.gdim)

    @property
    def parameters(self) -> Array:
        """The law's parameters, shape (1, parameters) or, if any varies, (points, parameters)."""
        return self.points[self._field] if self._parameters is None else self._parameters

    @property
    def internal(self) -> Array:
        """The law's internal variables at the points, shape (points, variables)."""
        old = np.empty((len(self.points), len(self.law.internal)))
        for k, name in enumerate(self.law.internal):
            old[:, k] = self.points[name]
        return old

    def _run(self, operand, S, A, want_tangent, here, new, internal, sigma) -> int:
        points = self.points
        old = np.empty((len(operand), len(self.law.internal)))
        for k, name in enumerate(self.law.internal):
            old[:, k] = points[name][here]
        parameters = self._parameters
        if parameters is None:
            parameters = points[self._field][here]
        state, F = points[self.state], points["F"]
        if not isinstance(here, slice):
            state = state.take(here, axis=0)
            F = F.take(here, axis=0) if self._takes_F else F
        return self._kernel(
            self.law.address, parameters, operand, F, state, old,
            S, A, want_tangent, len(sigma) > 0, new, internal, sigma,
        )  # fmt: skip

    def evaluate(self, operand: Array, value: Array, tangent: Array | None, rows) -> int:
        """Flux S and its derivative by ∇ũ; see `PointwiseLaw`."""
        nothing = np.empty((0, 6)), np.empty((0, 0)), np.empty((0, 3, 3))
        A = np.empty((0, 1, 1)) if tangent is None else tangent
        return self._run(operand, value, A, tangent is not None, rows, *nothing)

    def commit(self, operand: Array, rows: npt.NDArray[np.integer]) -> dict[str, Array]:
        """Elastic strain, internal variables and Cauchy stress at the end of the step."""
        n = len(rows)
        new = {self.state: np.empty((n, 6)), "stress": np.empty((n, 3, 3))}
        internal = np.empty((n, len(self.law.internal)))
        if n:
            none = np.empty((0, 1)), np.empty((0, 1, 1))
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
        parameters = self.parameters
        at = row if len(parameters) > 1 else 0
        number = int(self.points["id"][row])
        strain = np.linalg.eigvalsh(trial)
        return self.law.describe(number, strain, self.internal[row], parameters[at : at + 1])
