"""Operators: terms of a weak form whose value and tangent do not come from UFL."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import basix.ufl
import numpy as np
import numpy.typing as npt
import ufl
from ufl.core.expr import Expr

from dolfinmpm._platform.errors import FormError
from dolfinmpm.body.points import MaterialPoints

__all__ = ["AveragingLaw", "KeepingLaw", "KeptTangents", "PointOperator", "PointwiseLaw", "if_kept"]

Array = npt.NDArray[np.float64]
Rows = npt.NDArray[np.int32]


class PointwiseLaw(Protocol):
    """What an operator calls: a function of its operand and state at every point."""

    def evaluate(self, operand: Array, value: Array, tangent: Array | None, rows: Rows) -> int:
        """Value, and the tangent if an array is given, at some points.

        Must not change the state: the solver calls it as often as it likes.

        Args:
            operand: shape (n, size of the operand).
            value: Written, shape (n, size of the value).
            tangent: Written, shape (n, size of the value, size of the operand).
            rows: Which points of this rank they are, all within the operator's tags,
                shape (n,).

        Returns:
            The first of the n points where it failed, counted from 0, or -1.
        """

    def commit(self, operand: Array, rows: Rows) -> dict[str, Array]:
        """Fields of some points at the end of a converged step, by name.

        Args:
            operand: shape (n, size of the operand).
            rows: Which points of this rank they are, shape (n,).

        Returns:
            Values for these points, each of shape (n, ...).
        """


@runtime_checkable
class AveragingLaw(Protocol):
    """A `PointwiseLaw` that also needs a mean over the cells of a scalar made of its operand.

    Its operand must be made of one increment: its gradient, with a hoop term at axisymmetric points.
    """

    def prepare(self, operand: Array, mean: Callable[[Array], Array]) -> None:
        """Take the means for new increments. Collective.

        Args:
            operand: Operand at all points of this rank, shape (points, size).
            mean: Function from a scalar at the points, shape (points,), to its mean
                over the cells that they overlap, likewise. Collective.
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
        """As `PointwiseLaw.evaluate`, with the means last prepared.

        Args:
            operand, value, tangent, rows: See there; the tangent is that at constant mean.
            by_mean: Written with the tangent: the derivative of the value by the point's
                mean, shape (n, size of the value).
        """

    def commit(self, operand: Array, rows: Rows) -> dict[str, Array]:
        """Fields of some points at the end of a converged step; see `PointwiseLaw.commit`."""


@dataclass(frozen=True)
class KeptTangents:
    """What is kept of a law's answers at some points.

    Attributes:
        values: The numbers, shape (n, `KeepingLaw.keeps`).
        known: Whether they are those of this operand and state, to be read; else they are
            to be written.
    """

    values: Array
    known: bool


def if_kept(kept: KeptTangents | None) -> dict[str, Any]:
    """The argument `kept` of a call, without which laws that keep nothing are called."""
    return {} if kept is None else {"kept": kept}


@runtime_checkable
class KeepingLaw(Protocol):
    """A `PointwiseLaw` that does most of its work once for the same increments.

    What its value is made of serves the tangent, and the end of the step, at the same
    increments too. Who asks holds the numbers, and knows whether increments are the same.
    """

    @property
    def keeps(self) -> int:
        """How many numbers it keeps of a point; 0 if none after all."""

    def evaluate(
        self,
        operand: Array,
        value: Array,
        tangent: Array | None,
        rows: Rows,
        *,
        kept: KeptTangents | None = None,
    ) -> int:
        """As `PointwiseLaw.evaluate`, or `AveragingLaw.evaluate`.

        Args:
            operand, value, tangent, rows: See there.
            kept: What is kept of these points, written or read; or None.
        """

    def commit(
        self, operand: Array, rows: Rows, kept: KeptTangents | None = None
    ) -> dict[str, Array]:
        """Fields of some points at the end of a converged step; see `PointwiseLaw.commit`."""


class PointOperator(ufl.Coefficient):
    """A tensor in a weak form that a law computes at every material point.

    Args:
        points: The material points.
        law: What computes it.
        operand: The UFL expression that the law is a function of.
        shape: Shape of the value.
        name: Its name in messages.
        tags: Tags of the points at which the law is asked; it is zero at others. None
            means all points.

    Attributes:
        declaration: What the law needs of the points; None if nothing.
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
        cell = points.grid.topology.cell_name()
        # of degree 1, for UFL would drop the gradient of a constant before it can be refused
        element = basix.ufl.element("DG", cell, 1, shape=shape)
        super().__init__(ufl.FunctionSpace(points.grid.ufl_domain(), element))
        self.points = points
        self.law = law
        self.operand = operand
        self.name = name
        self.tags = tags
        self.declaration: Any = None

    @functools.cached_property
    def slope(self) -> PointOperator:
        """Derivative of the value by the operand, an operator itself; see `_Slope`.

        Raises:
            FormError: The law takes means over cells, or this is a slope already.
        """
        if isinstance(self.law, AveragingLaw):
            raise FormError(
                f"'{self}' takes means over cells (fbar=True): its derivative at a point depends "
                "on the increments at others, and ufl.derivative cannot see through it; use "
                "fbar=False or leave the derivative of the stress out"
            )
        if isinstance(self.law, _Slope):
            raise FormError(
                f"a second derivative through the law of '{self}' is left to the solver; take "
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


# of central differences: the error of the step's square and that of rounding are alike then
_STEP = 2e-6


class _Slope:
    """The tangent of a law as a law of the same operand; it keeps no state of its own.

    Its own tangent, the second derivative of the law, is taken by central differences of the
    law's tangent. Newton's method keeps its order by it where the law is smooth, at
    the cost of two evaluations of the law for every component of the operand.
    """

    def __init__(self, law: PointwiseLaw):
        self._law = law

    def _at(self, operand: Array, out: Array, rows: Rows) -> int:
        size = operand.shape[1]
        value = np.empty((len(operand), out.shape[1] // size))
        return self._law.evaluate(operand, value, out.reshape(len(operand), -1, size), rows)

    def evaluate(self, operand: Array, value: Array, tangent: Array | None, rows: Rows) -> int:
        """The law's tangent and its derivative; see `PointwiseLaw`."""
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
        """Nothing: the law's own operator keeps its state."""
        return {}

    def describe(self, operand: Array, row: int) -> str:
        """What is known of a point at which there is no stress, in the law's own words."""
        describe = getattr(self._law, "describe", None)
        return "" if describe is None else describe(operand, row)
