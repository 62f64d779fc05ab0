"""Operators: terms of a weak form whose value and tangent do not come from UFL."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol, runtime_checkable

import basix.ufl
import numpy as np
import numpy.typing as npt
import ufl
from ufl.core.expr import Expr

from dolfinmpm.body.points import MaterialPoints

__all__ = ["AveragingLaw", "PointOperator", "PointwiseLaw"]

Array = npt.NDArray[np.float64]


class PointwiseLaw(Protocol):
    """What an operator calls: a function of its operand and state at every point."""

    def evaluate(
        self, operand: Array, value: Array, tangent: Array | None, rows: npt.NDArray[np.int32]
    ) -> int:
        """Value, and the tangent if an array is given, at some points.

        Must not change the state: the solver calls it as often as it likes.

        Args:
            operand: shape (n, size of the operand).
            value: Written, shape (n, size of the value).
            tangent: Written, shape (n, size of the value, size of the operand).
            rows: Which points they are, shape (n,).

        Returns:
            The first of the n points where it failed, counted from 0, or -1.
        """

    def commit(self, operand: Array, rows: npt.NDArray[np.integer]) -> dict[str, Array]:
        """Fields of some points at the end of a converged step, by name.

        Args:
            operand: shape (n, size of the operand).
            rows: Which points they are, shape (n,).
        """


@runtime_checkable
class AveragingLaw(Protocol):
    """A `PointwiseLaw` that also needs a mean over the cells of a scalar made of its operand.

    Its operand must be the gradient of an increment.
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
        rows: npt.NDArray[np.int32],
        by_mean: Array | None = None,
    ) -> int:
        """As `PointwiseLaw.evaluate`, with the means last prepared.

        Args:
            operand, value, tangent, rows: See there; the tangent is that at constant mean.
            by_mean: Written with the tangent: the derivative of the value by the point's
                mean, shape (n, size of the value).
        """

    def commit(self, operand: Array, rows: npt.NDArray[np.integer]) -> dict[str, Array]:
        """Fields of some points at the end of a converged step, by name.

        Args:
            operand: shape (n, size of the operand).
            rows: Which points they are, shape (n,).
        """


class PointOperator(ufl.Coefficient):
    """A tensor in a weak form that a law computes at every material point.

    Args:
        points: The material points.
        law: What computes it.
        operand: The UFL expression that the law is a function of.
        shape: Shape of the value.
        name: Its name in messages.
    """

    def __init__(
        self,
        points: MaterialPoints,
        law: PointwiseLaw,
        operand: Expr,
        shape: tuple[int, ...],
        name: str,
    ):
        cell = points.grid.topology.cell_name()
        # of degree 1, for UFL would drop the gradient of a constant before it can be refused
        element = basix.ufl.element("DG", cell, 1, shape=shape)
        super().__init__(ufl.FunctionSpace(points.grid.ufl_domain(), element))
        self.points = points
        self.law = law
        self.operand = operand
        self.name = name

    def __str__(self) -> str:
        return self.name
