"""Operators: tensors in a weak form whose value and tangent come from a law, and not from UFL."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt
import ufl
from ufl.core.expr import Expr

from dolfinmpm._platform.errors import FormError
from dolfinmpm.body.fields import space_at
from dolfinmpm.body.points import MaterialPoints

__all__ = ["AveragingLaw", "KeepingLaw", "KeptTangents", "PointOperator", "PointwiseLaw", "if_kept"]

Array = npt.NDArray[np.float64]
Rows = npt.NDArray[np.int32]


class PointwiseLaw(Protocol):
    """Interface of a law: a function of operand and state at every point."""

    def evaluate(self, operand: Array, value: Array, tangent: Array | None, rows: Rows) -> int:
        """Compute the value, and the tangent if an array is given, at some points.

        The call must not change the state, because the solver calls it any number of times.

        Args:
            operand: Values of the operand, shape (n, size of the operand).
            value: Written: the value, shape (n, size of the value).
            tangent: Written: the derivative of the value by the operand, shape (n, size of the
                value, size of the operand); or None.
            rows: Numbers of the points on this rank, all with the operator's tags, shape (n,).

        Returns:
            The first of the n points at which the law failed, counted from 0, or -1.
        """

    def commit(self, operand: Array, rows: Rows) -> dict[str, Array]:
        """New values of the law's fields at the end of a converged step.

        Args:
            operand: Values of the operand, shape (n, size of the operand).
            rows: Numbers of the points on this rank, shape (n,).

        Returns:
            Values at these points by name of the field, each of shape (n, ...).
        """


@runtime_checkable
class AveragingLaw(PointwiseLaw, Protocol):
    """A `PointwiseLaw` that also needs cell means of a scalar function of its operand.

    The operand must depend on one increment only: it is the gradient of the increment, with a hoop
    term at axisymmetric points.
    """

    def prepare(self, operand: Array, mean: Callable[[Array], Array]) -> None:
        """Compute the means for new increments. Collective.

        Args:
            operand: Operand at all points of this rank, shape (points, size).
            mean: Function that averages a scalar at the points, shape (points,), over the cells
                that they overlap, and returns the means at the points, shape (points,).
                Collective.
        """

    def measure_slope(self, operand: Array) -> Array:
        """Derivative of the averaged scalar by the operand, shape (points, size)."""

    def evaluate(
        self,
        operand: Array,
        value: Array,
        tangent: Array | None,
        rows: Rows,
        by_mean: Array | None = None,
    ) -> int:
        """Like `PointwiseLaw.evaluate`, with the means from the last call of `prepare`.

        Args:
            operand, value, tangent, rows: See `PointwiseLaw.evaluate`; the tangent is the
                derivative at constant mean.
            by_mean: Written together with the tangent: the derivative of the value by the mean at
                the point, shape (n, size of the value).
        """


@dataclass(frozen=True)
class KeptTangents:
    """Intermediate results of a law at some points, kept for later calls.

    Attributes:
        values: The intermediate results, shape (n, `KeepingLaw.keeps`).
        known: True if the results belong to the present operand and state, and the law reads
            them. False if the law must write them.
    """

    values: Array
    known: bool


def if_kept(kept: KeptTangents | None) -> dict[str, Any]:
    """Keyword `kept` for a call of a law; no keyword for laws that keep nothing."""
    return {} if kept is None else {"kept": kept}


@runtime_checkable
class KeepingLaw(PointwiseLaw, Protocol):
    """A `PointwiseLaw` whose intermediate results are kept, and serve several calls.

    At the same increments, the tangent and the end of the step need the same intermediate results
    as the value. The caller stores these results, and knows whether increments have changed.
    """

    @property
    def keeps(self) -> int:
        """How many numbers are kept per point; 0 if nothing is kept."""

    def evaluate(
        self,
        operand: Array,
        value: Array,
        tangent: Array | None,
        rows: Rows,
        *,
        kept: KeptTangents | None = None,
    ) -> int:
        """Like `PointwiseLaw.evaluate` or `AveragingLaw.evaluate`.

        Args:
            operand, value, tangent, rows: See `PointwiseLaw.evaluate`.
            kept: Intermediate results at these points, written or read; or None.
        """

    def commit(
        self, operand: Array, rows: Rows, kept: KeptTangents | None = None
    ) -> dict[str, Array]:
        """New values of the law's fields at the end of a step; see `PointwiseLaw.commit`."""


class PointOperator(ufl.Coefficient):
    """A tensor in a weak form that a law computes at every material point.

    Args:
        points: The material points.
        law: Law that computes the tensor.
        operand: UFL expression that is the argument of the law.
        shape: Shape of the tensor.
        name: Name in messages.
        tags: Tags of the points at which the law is called. The tensor is zero at other points.
            None means all points.

    Attributes:
        declaration: Declaration of the law's data at the points; None if the law has no data.
    """

    def __init__(
        self,
        points: MaterialPoints,
        law: PointwiseLaw,
        operand: Expr,
        shape: tuple[int, ...],
        name: str,
        tags: tuple[int, ...] | None = None,
    ):
        super().__init__(space_at(points, shape))
        self.points = points
        self.law = law
        self.operand = operand
        self.name = name
        self.tags = tags
        self.declaration: Any = None

    @functools.cached_property
    def slope(self) -> PointOperator:
        """Derivative of the value by the operand, as another operator; see `_Slope`.

        Raises:
            FormError: The law takes means over cells, or this operator is a derivative already.
        """
        if isinstance(self.law, AveragingLaw):
            raise FormError(
                f"'{self}' takes means over cells (fbar=True): its derivative at a point depends "
                "on the increments at other points, and ufl.derivative cannot compute it; use "
                "fbar=False or leave the derivative of the stress out"
            )
        if isinstance(self.law, _Slope):
            raise FormError(
                f"only the solver takes the second derivative of the law of '{self}'; take "
                "ufl.derivative of the stress once"
            )
        shape = (*self.ufl_shape, *self.operand.ufl_shape)
        of_law = _Slope(self.law)
        name = f"derivative of {self.name}"
        result = PointOperator(self.points, of_law, self.operand, shape, name, self.tags)
        result.declaration = self.declaration
        return result

    def __str__(self) -> str:
        return self.name


# Step of central differences: truncation error (step squared) and rounding error are similar
_STEP = 2e-6


class _Slope:
    """The tangent of a law as another law of the same operand, without state.

    The tangent of this second law is the second derivative of the first law. It is computed by
    central differences of the first law's tangent. Newton's method then keeps its order if the law
    is smooth. The cost is two evaluations of the law per component of the operand.
    """

    def __init__(self, law: PointwiseLaw):
        self._law = law

    def _at(self, operand: Array, out: Array, rows: Rows) -> int:
        size = operand.shape[1]
        value = np.empty((len(operand), out.shape[1] // size))
        return self._law.evaluate(operand, value, out.reshape(len(operand), -1, size), rows)

    def evaluate(self, operand: Array, value: Array, tangent: Array | None, rows: Rows) -> int:
        """Compute the law's tangent and its derivative; see `PointwiseLaw`."""
        bad = self._at(operand, value, rows)
        if bad >= 0 or tangent is None:
            return bad
        sides = np.empty((2, *value.shape))
        for k in range(operand.shape[1]):
            step = _STEP * np.maximum(1.0, np.abs(operand[:, k]))
            for side, sign in enumerate((1.0, -1.0)):
                moved = operand.copy()
                moved[:, k] += sign * step
                bad = self._at(moved, sides[side], rows)
                if bad >= 0:
                    return bad
            tangent[:, :, k] = (sides[0] - sides[1]) / (2 * step)[:, None]
        return -1

    def commit(self, operand: Array, rows: Rows) -> dict[str, Array]:
        """No fields: the operator of the law itself keeps the state."""
        return {}

    def describe(self, operand: Array, row: int) -> str:
        """The law's description of a point at which it found no stress, for messages."""
        describe = getattr(self._law, "describe", None)
        return "" if describe is None else describe(operand, row)
