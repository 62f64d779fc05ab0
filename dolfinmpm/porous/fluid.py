"""What flows through the pores, and how easily."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from ufl.core.expr import Expr

from dolfinmpm._platform.checks import number

__all__ = ["Fluid", "kozeny_carman"]

Permeability = Callable[[Any, Any], Expr]


@dataclass(frozen=True)
class Fluid:
    """The fluid in the pores, water by default.

    Args:
        density: ρ_w (kg/m³).
        gravity: The acceleration g (m/s²) by which hydraulic conductivities are permeabilities,
            γ_w = ρ_w g; not the load, which a form is given apart.
        bulk_modulus: K_w (Pa), infinite for an incompressible fluid.

    Raises:
        ParameterError: One is not positive.
    """

    density: float = 1000.0
    gravity: float = 9.81
    bulk_modulus: float = math.inf

    def __post_init__(self):
        number("density", self.density, 0.0, unit="kg/m³")
        number("gravity", self.gravity, 0.0, unit="m/s²")
        if self.bulk_modulus != math.inf:
            number("bulk_modulus", self.bulk_modulus, 0.0, unit="Pa")

    @property
    def unit_weight(self) -> float:
        """γ_w (N/m³)."""
        return self.density * self.gravity

    @property
    def compressible(self) -> bool:
        """Whether its bulk modulus is finite."""
        return self.bulk_modulus != math.inf


def kozeny_carman(k: float, porosity: float) -> Permeability:
    """Hydraulic conductivity that follows the porosity: k n³/(1 − n)² by its first value.

    Kozeny (1927) and Carman (1937); for `poromechanics(..., permeability=...)`.

    Args:
        k: Hydraulic conductivity at the first porosity (m/s).
        porosity: That porosity, in (0, 1).

    Raises:
        ParameterError: A number is outside its range.
    """
    k, n0 = number("k", k, 0.0, unit="m/s"), number("porosity", porosity, 0.0, 1.0)

    def permeability(J: Any, n: Any) -> Expr:
        return k * (1 - n0) ** 2 / n0**3 * n**3 / (1 - n) ** 2

    return permeability
