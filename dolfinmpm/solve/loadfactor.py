"""The load factor of an arc-length step, and the equation for it."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.mesh import Mesh
from mpi4py import MPI
from ufl.algorithms import expand_derivatives, extract_coefficients
from ufl.algorithms.analysis import extract_constants
from ufl.algorithms.apply_algebra_lowering import apply_algebra_lowering
from ufl.algorithms.apply_derivatives import apply_derivatives

from dolfinmpm._platform.errors import FormError, ParameterError
from dolfinmpm.body.points import MaterialPoints

__all__ = ["Constraint", "LoadFactor"]


class LoadFactor:
    """The load factor λ, and the constants multiplied by it.

    Args:
        form: Weak form that contains the constants.
        grid: Background grid.
        constants: DOLFINx constants; their present values are the load at λ = 1.
        factor: First λ.

    Raises:
        ParameterError: There is no constant, a constant is invalid, or all constants are zero.
        FormError: The form does not contain a constant.
    """

    def __init__(
        self, form: ufl.Form, grid: Mesh, constants: Sequence[fem.Constant], factor: float
    ):
        if not constants or not all(isinstance(c, fem.Constant) for c in constants):
            raise ParameterError(
                f"load = {constants!r} must be one or several dolfinx.fem.Constant of the form"
            )
        if len({id(c) for c in constants}) < len(constants):
            raise ParameterError(
                "load has a constant twice, so its load would count twice; give each once"
            )
        if not math.isfinite(factor):
            raise ParameterError(f"factor = {factor} must be finite")
        _check_load(form, constants)
        self.constants = list(constants)
        self._reference = [np.array(c.value, float) for c in constants]
        if not any(np.any(r) for r in self._reference):
            raise ParameterError(
                "the load's constants are all zero; set them to the load at factor 1 before"
            )
        self._factor = fem.Constant(grid, np.float64(factor))
        self.derivative = self._derive(form, grid)

    def _derive(self, form: ufl.Form, grid) -> ufl.Form:
        """∂(form)/∂λ, with constants equal to λ times their present values."""
        factor = ufl.variable(self._factor)
        scaled = {
            c: factor * fem.Constant(grid, r) for c, r in zip(self.constants, self._reference)
        }
        kept = []
        for integral in expand_derivatives(
            ufl.replace(expand_derivatives(form), scaled)
        ).integrals():
            lowered = apply_algebra_lowering(ufl.diff(integral.integrand(), factor))
            slope = apply_derivatives(lowered)
            if ufl.algorithms.extract_arguments(slope):
                kept.append(integral.reconstruct(slope))
        return ufl.Form(kept)

    @property
    def value(self) -> float:
        """The present λ."""
        return float(self._factor.value)

    def describe(self) -> str:
        """The load at λ = 1, for messages."""
        values = [", ".join(f"{value:.9g}" for value in r.flat) for r in self._reference]
        return " and ".join(f"({value})" for value in values)

    def error_in_constants(self) -> ParameterError | None:
        """An error if the constants do not hold λ times the load, or None."""
        for k, (constant, reference) in enumerate(zip(self.constants, self._reference)):
            if not np.array_equal(constant.value, self.value * reference):
                return ParameterError(
                    f"constant {k} of the load = {constant.value} was set by hand, and must be "
                    f"{self.value * reference}: steps along the path find the load. For another "
                    "load make a new ArcLength of the same points"
                )
        return None

    def set(self, factor: float) -> None:
        """Set λ and the constants."""
        self._factor.value = factor
        for constant, reference in zip(self.constants, self._reference):
            constant.value = factor * reference


def _check_load(form: ufl.Form, constants: Sequence[fem.Constant]) -> None:
    integrands = [integral.integrand() for integral in expand_derivatives(form).integrals()]
    found = {c for i in integrands for c in extract_constants(i)}
    missing = [k for k, constant in enumerate(constants) if constant not in found]
    if missing:
        raise FormError(f"constant {missing[0]} of the load is in no term of the form")
    for coefficient in {c for i in integrands for c in extract_coefficients(i)}:
        operand = getattr(coefficient, "operand", None)
        if operand is not None and any(c in constants for c in extract_constants(operand)):
            raise FormError(
                f"the law '{coefficient}' takes a constant of the load as its argument; the load "
                "factor can only multiply terms outside laws"
            )


class Constraint:
    """The additional equation of an arc-length step.

    Spherical: ⟨Δu, Δu⟩ + ψ² Δλ² = ℓ². Cylindrical: the same with ψ = 0 (Crisfield 1981, doi
    10.1016/0045-7949(81)90108-5). ⟨a, b⟩ = Σ V0 a_p·b_p / Σ V0 is a mean over the material points.
    So it does not depend on the grid, nor on nodes of cut cells with little support by points. ψ is
    ‖du/dλ‖ in the first step. Displacement control has a linear form c(v) instead: c(Δu) = ℓ.

    Args:
        control: "spherical", "cylindrical" or a form over the points, linear in the test
            function alone.
        u: Increment.
        v: Test function.
        points: Material points.

    Raises:
        ParameterError: The control is unknown.
    """

    def __init__(self, control: str | ufl.Form, u, v, points: MaterialPoints):
        self.linear = isinstance(control, ufl.Form)
        if not self.linear and control not in ("spherical", "cylindrical"):
            raise ParameterError(
                f'control = {control!r} must be "spherical", "cylindrical" or a form linear in the '
                "test function, such as surface.mean((0, 1), v)"
            )
        self.kind = "displacement" if self.linear else control
        volume = points.comm.allreduce(float(points["V0"].sum()), op=MPI.SUM)
        weight = fem.Constant(points.grid, 1 / volume)
        self.form = control if self.linear else weight * ufl.inner(u, v) * points.dX
        self.weight = 1 / volume
        self.psi: float | None = None if control == "spherical" else 0.0
