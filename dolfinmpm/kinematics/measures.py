"""What a measure of strain is: a few functions in UFL, compiled with the derivatives UFL finds."""

from __future__ import annotations

import functools
from typing import Any

import basix.ufl
import numpy as np
import numpy.typing as npt
import ufl
from ufl.algorithms.apply_algebra_lowering import apply_algebra_lowering
from ufl.algorithms.apply_derivatives import apply_derivatives
from ufl.core.expr import Expr

from dolfinmpm.forms.pointwise import Program, compile_here
from dolfinmpm.kinematics.spectral import components, layout

__all__ = ["StrainMeasure", "measure_in"]

Array = npt.NDArray[np.float64]


def _diff(expression: Expr, variable: Expr) -> Expr:
    return apply_derivatives(apply_algebra_lowering(ufl.diff(expression, variable)))


def _entries(tensor: Expr) -> list[Expr]:
    return [tensor[i] if i else tensor for i in np.ndindex(*tensor.ufl_shape)]


class StrainMeasure:
    """How an increment makes the trial tensor of a law, and how the law's stress makes a flux.

    A subclass states these in UFL, for the gradient H of the increment, shape (d, d); all
    derivatives follow. Each is compiled when first asked for, by the rank that asks: nothing
    here is collective, and one that never assembles a tangent compiles none.

    Attributes:
        logarithmic: Whether the trial tensor is a left Cauchy–Green tensor, b with ε = ½ ln b,
            instead of a strain.
        checks: How many numbers must be positive.

    Args:
        d: Dimension of space.
    """

    logarithmic: bool

    def __init__(self, d: int):
        self.d, at = d, layout(d)
        # any domain will do, for nothing is integrated over it
        element = basix.ufl.element("Lagrange", "interval", 1, shape=(1,))
        self._z = z = ufl.Constant(ufl.Mesh(element, ufl_id=0), shape=(at.size,))
        six, inside = components(3), components(d)

        def tensor(start: int) -> Expr:
            return ufl.as_tensor([[z[start + d * i + j] for j in range(d)] for i in range(d)])

        def symmetric(row: list[Expr], index: list[tuple[int, int]]) -> Expr:
            where = [[row[index.index((min(i, j), max(i, j)))] for j in range(d)] for i in range(d)]
            return ufl.as_tensor(where)

        self._H, self._G = ufl.variable(tensor(at.H)), ufl.variable(tensor(at.G))
        self._F = tensor(at.F)
        self._old = symmetric([z[at.state + k] for k in range(6)], six)
        m = len(inside)
        self._stress = ufl.variable(ufl.as_vector([z[at.stress + k] for k in range(m)]))
        self._tau = symmetric([self._stress[k] for k in range(m)], inside)
        self._law = ufl.as_tensor([[z[at.law + m * k + j] for j in range(m)] for k in range(m)])
        self._slope = ufl.as_tensor(
            [[[z[at.slope + (k * d + i) * d + j] for j in range(d)] for i in range(d)]
             for k in range(m)]
        )  # fmt: skip
        self.checks = len(self.positive(self._H))

    # -- what a subclass states ----------------------------------------------------

    def rate(self, H: Expr) -> Expr:
        """First stage of the trial tensor, shape (d, d); H itself by default.

        A stage of its own keeps the derivatives of long expressions short: they are
        multiplied as numbers.
        """
        return H

    def trial(self, G: Expr, old: Expr) -> Expr:
        """Trial tensor, symmetric, shape (d, d).

        Args:
            G: The first stage.
            old: The state at the start of the step.
        """
        raise NotImplementedError

    def flux(self, stress: Expr, H: Expr, F: Expr) -> Expr:
        """Flux per initial volume (Pa), shape (d, d).

        Args:
            stress: The law's stress.
            H: The increment's gradient.
            F: Deformation gradient at the start of the step.
        """
        raise NotImplementedError

    def volume(self, H: Expr, F: Expr) -> Expr:
        """Ratio of the law's stress to Cauchy's at the end of the step."""
        return ufl.as_ufl(1.0)

    def positive(self, H: Expr) -> list[Expr]:
        """Numbers that must be positive, or the point is turned inside out."""
        return []

    # -- what follows ----------------------------------------------------------------

    @property
    def _staged(self) -> bool:
        return type(self).rate is not StrainMeasure.rate

    def _program(self, expressions: list[Expr]) -> Program:
        return compile_here(expressions, {self._z: "z"})

    def _trial_of(self, G: Expr) -> Expr:
        tensor = self.trial(G, self._old)
        return ufl.as_vector([tensor[i] for i in components(self.d)])

    @functools.cached_property
    def _first(self) -> Program:
        values = self.rate(self._H) if self._staged else self._trial_of(self._H)
        return self._program([*self.positive(self._H), *_entries(values)])

    @functools.cached_property
    def _second(self) -> Program | None:
        return self._program(_entries(self._trial_of(self._G))) if self._staged else None

    @functools.cached_property
    def _flux(self) -> Program:
        return self._program(_entries(self.flux(self._tau, self._H, self._F)))

    @functools.cached_property
    def _volume(self) -> Program:
        return self._program([self.volume(self._H, self._F)])

    @functools.cached_property
    def _slopes(self) -> list[Program | None]:
        """Tangent, and the derivatives of the two stages if there are two."""
        flux = self.flux(self._tau, self._H, self._F)
        slope = self._slope if self._staged else _diff(self._trial_of(self._H), self._H)
        i, j, m, n, a, b = ufl.indices(6)
        through = _diff(flux, self._stress)[i, j, a] * (self._law[a, b] * slope[b, m, n])
        total = _diff(flux, self._H) + ufl.as_tensor(through, (i, j, m, n))
        programs: list[Program | None] = [self._program(_entries(apply_algebra_lowering(total)))]
        if not self._staged:
            return [*programs, None, None]
        by_H, by_G = _diff(self.rate(self._H), self._H), _diff(self._trial_of(self._G), self._G)
        return [*programs, self._program(_entries(by_H)), self._program(_entries(by_G))]

    def programs(self, slopes: bool, volume: bool) -> tuple[int, ...]:
        """Addresses of the compiled functions, as `stress_kernel` takes them; 0 where none is.

        Args:
            slopes: Whether a tangent is asked for.
            volume: Whether the end of the step is.
        """
        asked: list[Any] = [self._first, self._second, self._flux]
        asked.append(self._volume if volume else None)
        asked += self._slopes if slopes else [None] * 3
        return tuple(0 if program is None else program.function for program in asked)

    def trials(self, H: Array, state: Array) -> tuple[Array, npt.NDArray[np.bool_]]:
        """Trial tensors outside the loop, for messages.

        Args:
            H: Gradients of the increment, shape (n, d²).
            state: State at the start of the step, shape (n, 6).

        Returns:
            Their components, shape (n, m), and whether the points are not turned inside out,
            shape (n,).
        """
        at = layout(self.d)
        z = np.zeros((len(H), at.size))
        z[:, at.H : at.H + H.shape[1]], z[:, at.state : at.state + 6] = H, state
        first = np.empty((len(H), self._first.size))
        self._first.run({"z": z}, first)
        good = np.all(first[:, : self.checks] > 0, axis=1).reshape(len(H))
        trial = first[:, self.checks :]
        if self._second is not None:
            z[:, at.G : at.G + H.shape[1]] = trial
            trial = np.empty((len(H), self._second.size))
            self._second.run({"z": z}, trial)
        return trial, good


_made: dict[tuple[type[StrainMeasure], int], StrainMeasure] = {}


def measure_in(kind: type[StrainMeasure], d: int) -> StrainMeasure:
    """The measure in d dimensions; asked again, the same one."""
    if (kind, d) not in _made:
        _made[kind, d] = kind(d)
    return _made[kind, d]
