"""Strain formulations as a few functions in UFL, compiled together with their derivatives."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from ufl.algorithms.apply_algebra_lowering import apply_algebra_lowering
from ufl.core.expr import Expr

from dolfinmpm.forms.pointterms import derive
from dolfinmpm.forms.pointwise import Program, compile_here, input_numbers
from dolfinmpm.kinematics.spectral import components, layout

__all__ = ["StrainFunctions", "strain_functions"]

Array = npt.NDArray[np.float64]


def _entries(tensor: Expr) -> list[Expr]:
    return [tensor[i] if i else tensor for i in np.ndindex(*tensor.ufl_shape)]


class StrainFunctions:
    """The trial tensor of a law from an increment, and the flux from the law's stress.

    A subclass defines both in UFL, for the gradient H of the increment, shape (d, d). Derivatives
    are found by UFL. Each function is compiled at its first use, by the rank that uses it. Nothing
    is collective, and a rank that never assembles a tangent compiles no tangent.

    Attributes:
        logarithmic: True if the trial tensor is a left Cauchy–Green tensor b, with ε = ½ ln b.
            False if it is a strain.
        checks: Number of values that `positive` returns.

    Args:
        d: Dimension of space.
    """

    logarithmic: bool

    def __init__(self, d: int):
        self.d, at = d, layout(d)
        self._z = z = input_numbers(at.size)
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

    # -- defined by a subclass -------------------------------------------------------

    def rate(self, H: Expr) -> Expr:
        """First stage G of the trial tensor, shape (d, d); by default G is H.

        A first stage shortens the derivatives of long expressions: the derivatives of both stages
        are multiplied as numbers.
        """
        return H

    def trial(self, G: Expr, old: Expr) -> Expr:
        """Symmetric trial tensor, shape (d, d).

        Args:
            G: The first stage, shape (d, d).
            old: Elastic state at the start of the step, shape (d, d).
        """
        raise NotImplementedError

    def flux(self, stress: Expr, H: Expr, F: Expr) -> Expr:
        """Flux per initial volume (Pa), shape (d, d).

        Args:
            stress: The law's stress (Pa), shape (d, d).
            H: The increment's gradient, shape (d, d).
            F: Deformation gradient at the start of the step, shape (d, d).
        """
        raise NotImplementedError

    def volume(self, H: Expr, F: Expr) -> Expr:
        """Ratio of the law's stress to the Cauchy stress at the end of the step."""
        return ufl.as_ufl(1.0)

    def positive(self, H: Expr) -> list[Expr]:
        """Numbers that are positive unless the increment turns the point inside out."""
        return []

    # -- derived from these functions --------------------------------------------------

    @property
    def _staged(self) -> bool:
        return type(self).rate is not StrainFunctions.rate

    def _program(self, expressions: list[Expr]) -> Program:
        return compile_here(expressions, self._z)

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
        """Programs of the tangent, and of the derivatives of two stages, or None."""
        flux = self.flux(self._tau, self._H, self._F)
        slope = self._slope if self._staged else derive(self._trial_of(self._H), self._H)
        i, j, m, n, a, b = ufl.indices(6)
        through = derive(flux, self._stress)[i, j, a] * (self._law[a, b] * slope[b, m, n])
        total = derive(flux, self._H) + ufl.as_tensor(through, (i, j, m, n))
        programs: list[Program | None] = [self._program(_entries(apply_algebra_lowering(total)))]
        if not self._staged:
            return [*programs, None, None]
        by_H, by_G = derive(self.rate(self._H), self._H), derive(self._trial_of(self._G), self._G)
        return [*programs, self._program(_entries(by_H)), self._program(_entries(by_G))]

    def programs(self, slopes: bool, volume: bool) -> tuple[int, ...]:
        """Addresses of the compiled functions for `stress_kernel`; 0 for functions not needed.

        Args:
            slopes: Whether the tangent is needed.
            volume: Whether the state at the end of the step is needed.
        """
        asked: list[Any] = [self._first, self._second, self._flux]
        asked.append(self._volume if volume else None)
        asked += self._slopes if slopes else [None] * 3
        return tuple(0 if program is None else program.function for program in asked)

    def trials(self, H: Array, state: Array) -> tuple[Array, npt.NDArray[np.bool_]]:
        """Trial tensors outside the compiled loop, for messages.

        Args:
            H: Gradients of the increment, shape (n, d²).
            state: Elastic state at the start of the step, shape (n, 6).

        Returns:
            The m independent components of the trial tensors, shape (n, m), and whether each point
            is not turned inside out, shape (n,).
        """
        at = layout(self.d)
        z = np.zeros((len(H), at.size))
        z[:, at.H : at.H + H.shape[1]], z[:, at.state : at.state + 6] = H, state
        first = self._first.values(z)
        good = np.all(first[:, : self.checks] > 0, axis=1).reshape(len(H))
        trial = first[:, self.checks :]
        if self._second is not None:
            z[:, at.G : at.G + H.shape[1]] = trial
            trial = self._second.values(z)
        return trial, good


@functools.cache
def strain_functions(kind: Any, d: int) -> StrainFunctions:
    """The strain formulation in d dimensions, one object per kind and dimension."""
    return kind(d)
