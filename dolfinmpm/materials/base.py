"""What a constitutive law declares, and how its kernel is called.

A law works on principal logarithmic strains and Kirchhoff stresses (Pa) in three
dimensions; the kinematics around it are the same for every law. Its kernel is a
C function, so that one compiled loop serves all laws.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numba
import numpy as np
import numpy.typing as npt
from numba import types

from dolfinmpm.errors import ParameterError

__all__ = ["Law", "Parameter", "law_kernel"]

_DOUBLES = types.CPointer(types.float64)
KERNEL_SIGNATURE = types.int32(_DOUBLES, _DOUBLES, _DOUBLES, _DOUBLES, _DOUBLES, _DOUBLES)


def law_kernel(function: Callable) -> Callable:
    """Compile a law's kernel.

    The function takes six arrays and returns 0, or another number if the strain
    admits no stress:

    `kernel(parameters, strain, old, new, stress, tangent)`

    with the parameters in the order declared; the three principal trial
    logarithmic strains, which a law with a return mapping replaces by the elastic
    ones; the internal variables at the start of the step; those at its end
    (written); the three principal Kirchhoff stresses (Pa, written); and the nine
    derivatives of stress by trial strain, row by row (Pa, written).
    """
    return numba.cfunc(KERNEL_SIGNATURE, cache=True)(function)


@dataclass(frozen=True)
class Parameter:
    """A parameter of a law: its unit and the open or closed interval that it may be in."""

    unit: str
    low: float = -math.inf
    high: float = math.inf
    closed: bool = False

    def check(self, law: str, name: str, value: float) -> None:
        """Raise ParameterError unless the value is admissible."""
        inside = self.low <= value <= self.high if self.closed else self.low < value < self.high
        if not (math.isfinite(value) and inside):
            left, right = ("[", "]") if self.closed else ("(", ")")
            raise ParameterError(
                f"{law}: {name} = {value} {self.unit} must be in "
                f"{left}{self.low}, {self.high}{right}".replace("  ", " ")
            )


class Law:
    """Base of the laws whose stress comes from a kernel.

    A subclass declares `parameters` (name → Parameter, in the order in which the
    kernel reads them), `internal` (name → (unit, first value)) and `kernel`.
    """

    parameters: dict[str, Parameter] = {}
    internal: dict[str, tuple[str, float]] = {}
    kernel: Callable

    def __init__(self, **values: float):
        missing = set(self.parameters) ^ set(values)
        if missing:
            raise ParameterError(
                f"{type(self).__name__} takes the parameters {', '.join(self.parameters)}; "
                f"missing or unknown: {', '.join(sorted(missing))}"
            )
        self.values: dict[str, float] = {}
        for name, parameter in self.parameters.items():
            parameter.check(type(self).__name__, name, float(values[name]))
            self.values[name] = float(values[name])

    @property
    def address(self) -> int:
        """Address of the compiled kernel."""
        return self.kernel.address  # type: ignore[attr-defined]

    @property
    def parameter_array(self) -> npt.NDArray[np.float64]:
        """The parameters as the kernel takes them, shape (1, parameters)."""
        return np.array([list(self.values.values())])

    def __repr__(self) -> str:
        inside = ", ".join(f"{name}={value:g}" for name, value in self.values.items())
        return f"{type(self).__name__}({inside})"


def lame(E: float, nu: float) -> tuple[float, float]:
    """Lamé's λ and μ (Pa) from Young's modulus E (Pa) and Poisson's ratio."""
    return E * nu / ((1 + nu) * (1 - 2 * nu)), E / (2 * (1 + nu))


ELASTIC = {
    "E": Parameter("Pa", low=0.0),
    "nu": Parameter("", low=-1.0, high=0.5),
}
