"""What flows through the pores, and how easily."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass
from typing import Any

import numpy as np
from dolfinx import fem
from mpi4py import MPI
from ufl.core.expr import Expr

from dolfinmpm._platform.checks import Tags, number
from dolfinmpm._platform.errors import ParameterError, raise_together
from dolfinmpm.body.points import MaterialPoints, PointField

__all__ = ["Fluid", "kozeny_carman", "refuse_hollow", "refuse_light"]

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
    _: KW_ONLY
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
        ParameterError: A number is outside its range, or both look swapped: a porosity below 0.02
            and more metres a second than that.
    """
    k, n0 = number("k", k, 0.0, unit="m/s"), number("porosity", porosity, 0.0, 1.0)
    if n0 < min(k, 0.02):
        raise ParameterError(
            f"k = {k:g} m/s with porosity = {n0:g}: no soil is as dense and lets as much through. "
            "They look swapped: give mpm.kozeny_carman(k, porosity)"
        )

    def permeability(J: Any, n: Any) -> Expr:
        return k * (1 - n0) ** 2 / n0**3 * n**3 / (1 - n) ** 2

    return permeability


def refuse_hollow(points: MaterialPoints, fluid: Fluid, porosity: Any, tags: Tags) -> None:
    """Raise where the mixture is lighter than the water in it. Collective.

    Args:
        points: Material points, of the density ρ of the mixture.
        fluid: The fluid.
        porosity: n0, a constant or a field of the points; an expression is not looked at.
        tags: Tags of the points that are meant, or None for all.

    Raises:
        ParameterError: Somewhere ρ is no more than n0 ρ_w.
    """
    if not isinstance(porosity, (fem.Constant, PointField)):
        return
    of_points = isinstance(porosity, PointField)
    n0 = np.broadcast_to(porosity.array if of_points else porosity.value, len(points))
    density, water = points.density.array, n0 * fluid.density
    own = True if tags is None else np.isin(points["tag"], tags)
    bad = np.flatnonzero(~(density > water) & own)
    error = None
    if bad.size:
        p = bad[0]
        error = ParameterError(
            f"the density of the mixture is {density[p]:.6g} kg/m³ at {points['x'][p]} m, and with "
            f"the porosity {n0[p]:.4g} the water alone has {water[p]:.6g}: give the points the "
            "density (1 − n0) ρ_s + n0 ρ_w of grains and water"
        )
    raise_together(points.comm, error)


def refuse_light(points: MaterialPoints, fluid: Fluid, porosity: Any, M: Any) -> None:
    """Raise where waves grow if Darcy's law has the acceleration of the soil. Collective.

    Of ρ s² U + M κ² U = κ P, (S s + K κ²) P = κ (K ρ_w s² − s) U, S = n0/K_w and K = k/γ_w, all
    roots s have a negative real part only if (ρ − ρ_w)(1 + M S) > ρ M S (Routh & Hurwitz), at any
    wave number κ and permeability.

    Args:
        points: Material points, of the density ρ of the mixture.
        fluid: The fluid.
        porosity: n0, a constant, or an expression, of which the largest value is 1.
        M: P-wave modulus, a constant (Pa).

    Raises:
        ParameterError: Somewhere they have not.
    """
    lightest = points.density.array.min(initial=math.inf)
    lightest = points.comm.allreduce(float(lightest), op=MPI.MIN)
    n0 = float(np.max(porosity.value)) if isinstance(porosity, fem.Constant) else 1.0
    stored = n0 / fluid.bulk_modulus * float(M.value)
    least = fluid.density * (1 + stored)
    if not lightest > least:
        raise ParameterError(
            f"the density of the mixture is {lightest:.6g} kg/m³ somewhere and must be above "
            f"{least:.6g}, ρ_w (1 + M n0/K_w), for the soil's acceleration in Darcy's law: waves "
            "would grow without bounds. Give the points the density (1 − n0) ρ_s + n0 ρ_w, the "
            "fluid a larger bulk_modulus, or leave inertia out"
        )
