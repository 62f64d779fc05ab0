"""The border of an arc-length step: one equation for the load factor."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm._platform.errors import FormError
from dolfinmpm.basis.space import Space
from dolfinmpm.body.points import MaterialPoints, PointField
from dolfinmpm.solve.loadfactor import Constraint, LoadFactor
from dolfinmpm.solve.newton import Newton
from dolfinmpm.solve.operator import Operator
from dolfinmpm.solve.weakform import WeakForm

__all__ = ["PathBorder"]

Array = npt.NDArray[np.float64]


class PathBorder:
    """The load factor as unknown, and the length of the step along the path as equation.

    Args:
        load: The load factor.
        constraint: The equation for it.
        trail: Field of the points with their increment in the last step (m).
        spaces: Spaces of the increments.
        points: Material points.

    Attributes:
        load, constraint: The arguments.
        length: Length of the step (m); None if the first step is to set it.
        last_change: Change of the factor in the last step, or None before the first step.
        first: Change of the factor aimed at by the first step, if `length` is None.
        factor: λ of the present state.
        travelled: Controlled displacement since the first step (m).
        speed: Root mean square displacement per load factor so far (m), or infinity before any. It
            bounds the estimate of the displacements in the first step.
        conjugate, tolerance, unmet, sizes, acting: See `Border`.

    Raises:
        FormError: The load factor multiplies a term of the grid with the increment, or the control
            is no form over the points.
    """

    # error of the length: it only selects the next state, and has no physical meaning
    tolerance = 1e-6
    unmet = "the length of the step was not met"
    # the equation is a length, and the unknown a factor
    conjugate = False
    # the length by which the equation is divided does not change in a step
    sizes = np.asarray([1.0])
    # the load is one of the external forces
    acting = 0.0

    def __init__(
        self,
        load: LoadFactor,
        constraint: Constraint,
        trail: PointField,
        spaces: Sequence[Space],
        points: MaterialPoints,
    ):
        self.load, self.constraint = load, constraint
        self.length: float | None = None
        self.last_change: float | None = None
        self.first = 0.0
        self.factor = load.value
        self.travelled = 0.0
        self.speed = math.inf
        self._trail = trail
        self._slope_form = WeakForm(load.derivative, spaces, points)
        self._control_form = WeakForm(constraint.form, spaces, points)
        if any(form is not None for form in self._slope_form.parts.grid.internal):
            raise FormError(
                "the load factor multiplies a term over cells or facets of the grid that contains "
                "the increment; integrate it over the points instead"
            )
        control = self._control_form
        varies = any(region.internal is not None for region in control.regions)
        if constraint.linear and (varies or control.parts.grid):
            raise FormError(
                "a control must be a form over the points that contains the test function, and "
                "neither the increment nor terms over cells or facets"
            )

    @property
    def moving(self) -> set[int]:
        """Subdomain ids of the active facets and cells over which its forms integrate."""
        return self._slope_form.moving | self._control_form.moving

    def begin(self, operator: Operator) -> None:
        """See `Border`. Collective."""
        self._operator = operator
        self._slope = Operator(self._slope_form, operator.here)
        self._control = Operator(self._control_form, operator.here)
        self._start = self.load.value

    def reset(self) -> None:
        """See `Border`."""
        self.load.set(self._start)

    @property
    def settled(self) -> bool:
        """See `Border`: whether the length of the step and ψ are known."""
        return self.length is not None and self.constraint.psi is not None

    @property
    def value(self) -> Array:
        """See `Border`: the load factor, shape (1,)."""
        return np.array([self.load.value])

    def _dot(self, a: Array, b: Array) -> float:
        comm = self._operator.here.unknowns.comm
        return comm.allreduce(float(a @ b), op=MPI.SUM)

    def slopes(self, x: Array) -> Array:
        """∂r/∂λ; see `Border`. Collective."""
        self._slope.update_external()
        return self._slope.residual(x).values[:, None]

    def move(self, change: Array) -> None:
        """See `Border`. Collective."""
        self.load.set(self.load.value + float(change[0]))

    def predict(self, newton: Newton, operator: Operator) -> tuple[Array, float] | str:
        """Predict along the tangent of the path, in the direction of the last step. Collective."""
        constraint = self.constraint
        operator.move_to_zero()
        newton.linear.take_tangent(operator)
        q = self.slopes(np.zeros(operator.here.unknowns.owned))[:, 0]
        rate = newton.linear.solve(-q)
        # a failed solution is infinite
        with np.errstate(invalid="ignore"):
            along = self._dot(self._control.residual(rate).values, rate)
        if not math.isfinite(along) or along == 0.0:
            return "the tangent is singular, or the load does not move what controls the step"
        if constraint.linear:
            assert self.length is not None
            change = self.length / along
        else:
            # near a limit point the displacement per load factor has no bound; its mean has one
            usual = min(math.sqrt(along), self.speed)
            if constraint.psi is None:
                constraint.psi = usual
            if self.length is None:
                self.length = abs(self.first) * math.hypot(usual, constraint.psi)
            speed = math.sqrt(along + constraint.psi**2)
            change = math.copysign(self.length / speed, self._side())
        self.load.set(self._start + change)
        return change * rate, abs(change) * math.sqrt(self._dot(q, q))

    def _side(self) -> float:
        """Sign of the predictor, so that the path does not turn back. Collective."""
        if self.last_change is None:
            return self.first
        moved = self._trail.array
        rate = self._control.points.value[0][:, : moved.shape[1]]
        V0 = self._trail.points["V0"]
        forward = self.constraint.weight * self._dot(V0, np.sum(moved * rate, axis=1))
        assert self.constraint.psi is not None
        return forward + self.constraint.psi**2 * self.last_change

    def gap(self, x: Array) -> tuple[Array, Array, Array]:
        """The relative error of the length in the present state; see `Border`. Collective."""
        constraint = self.constraint
        assert self.length is not None
        w = self._control.residual(x).values
        if constraint.linear:
            gap = self._dot(w, x) / self.length - 1
            by_x = np.asarray(w[:, None] / self.length, float)
            return np.array([gap]), by_x, np.zeros((1, 1))
        change, square = self.load.value - self._start, self.length**2
        assert constraint.psi is not None
        value = (self._dot(w, x) + constraint.psi**2 * change**2) / square - 1
        by_factor = 2 * constraint.psi**2 * change / square
        by_x = np.asarray(2 * w[:, None] / square, float)
        return np.array([value]), by_x, np.array([[by_factor]])
