"""The fluid in the pores, its permeability, and checks of the mixture's density."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass
from typing import Any

import numpy as np
from dolfinx import fem
from mpi4py import MPI
from ufl.core.expr import Expr

from dolfinmpm._platform.argumentchecks import Tags, is_endless, number
from dolfinmpm._platform.errors import ParameterError, raise_together
from dolfinmpm._platform.uncopied import unchanged
from dolfinmpm._platform.units import refuse_number_of
from dolfinmpm.body.points import MaterialPoints, PointField

__all__ = ["Fluid", "kozeny_carman", "refuse_hollow", "refuse_light"]

Permeability = Callable[[Any, Any], Expr]
# Numbers of water's unit weight (kN/m³ and N/m³) that scripts give for its density
_UNIT_WEIGHTS = (9.8, 9.807, 9.81, 9800.0, 9807.0, 9810.0)
# Ranges of numbers that are water's bulk modulus in other units
_BULK_MODULI = {"GPa": (1.9, 2.5), "MPa": (1.9e3, 2.5e3)}


@unchanged()
@dataclass(frozen=True)
class Fluid:
    """The fluid in the pores, water by default.

    Args:
        density: Density ρ_w (kg/m³).
        gravity: Acceleration g (m/s²) in the unit weight γ_w = ρ_w g, which turns a hydraulic
            conductivity into a permeability. The load by gravity is another argument of
            `poromechanics`.
        bulk_modulus: Bulk modulus K_w (Pa), infinite for an incompressible fluid.

    Raises:
        ParameterError: A number is not positive, the density is a unit weight, or the bulk modulus
            is that of water in MPa or GPa.

    >>> import dolfinmpm as mpm
    >>> mpm.Fluid().unit_weight, mpm.Fluid(bulk_modulus=2.2e9).compressible
    (9810.0, True)
    """

    density: float = 1000.0
    _: KW_ONLY
    gravity: float = 9.81
    bulk_modulus: float = math.inf

    def __post_init__(self):
        number("density", self.density, 0.0, unit="kg/m³")
        number("gravity", self.gravity, 0.0, unit="m/s²")
        if self.density in _UNIT_WEIGHTS and 9.0 < self.gravity < 11.0:
            raise ParameterError(
                f"density = {self.density:g} kg/m³ is the number of water's unit weight, in kN/m³ "
                "or N/m³: give its density, 1000.0 kg/m³; gravity= makes the unit weight of it"
            )
        if not is_endless(self.bulk_modulus):
            number("bulk_modulus", self.bulk_modulus, 0.0, unit="Pa")
            # any consistent system of units works: with kg/m³, moduli are in Pa
            for unit in _BULK_MODULI if 900.0 < self.density < 1100.0 else ():
                told = f"Pa is the number of water's in {unit}: give 2.2e9 Pa"
                refuse_number_of("bulk_modulus", self.bulk_modulus, *_BULK_MODULI[unit], told)

    @property
    def unit_weight(self) -> float:
        """Unit weight γ_w = ρ_w g (N/m³)."""
        return self.density * self.gravity

    @property
    def compressible(self) -> bool:
        """Whether the bulk modulus is finite."""
        return self.bulk_modulus != math.inf


def kozeny_carman(k: float, porosity: float) -> Permeability:
    """Hydraulic conductivity that depends on the porosity n: proportional to n³/(1 − n)².

    The formula is by Kozeny (1927) and Carman (1937). Use it in
    `poromechanics(..., permeability=...)`.

    Args:
        k: Hydraulic conductivity at the first porosity (m/s).
        porosity: First porosity, in (0, 1).

    Returns:
        A function of the volume ratio J and the porosity n, for UFL.

    Raises:
        ParameterError: A number is outside its range, or the numbers look swapped: the porosity is
            below 0.02 and smaller than the conductivity.

    The conductivity after a compression from n = 0.4 to n = 0.3:

    >>> import dolfinmpm as mpm
    >>> k = mpm.kozeny_carman(1e-9, porosity=0.4)
    >>> round(k(1.0, 0.3) / 1e-9, 4)
    0.3099
    """
    k, n0 = number("k", k, 0.0, unit="m/s"), number("porosity", porosity, 0.0, 1.0)
    if n0 < min(k, 0.02):
        raise ParameterError(
            f"k = {k:g} m/s with porosity = {n0:g}: no soil is so dense and so permeable. "
            "The numbers look swapped: give mpm.kozeny_carman(k, porosity)"
        )

    def permeability(J: Any, n: Any) -> Expr:
        return k * (1 - n0) ** 2 / n0**3 * n**3 / (1 - n) ** 2

    return permeability


def refuse_hollow(points: MaterialPoints, fluid: Fluid, porosity: Any, tags: Tags) -> None:
    """Refuse a mixture that is not heavier than the water in it. Collective.

    Args:
        points: Material points; their density is the density ρ of the mixture.
        fluid: The fluid.
        porosity: First porosity n0, a constant or a field of the points. Other expressions are not
            checked.
        tags: Tags of the points to check, or None for all points.

    Raises:
        ParameterError: The density ρ of a point is not above n0 ρ_w.
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
            f"the density of the mixture is {density[p]:.6g} kg/m³ at {points['x'][p]} m, but with "
            f"the porosity {n0[p]:.4g} the water alone has {water[p]:.6g} kg/m³: give the points "
            "the density (1 − n0) ρ_s + n0 ρ_w of grains and water"
        )
    raise_together(points.comm, error)


def refuse_light(points: MaterialPoints, fluid: Fluid, porosity: Any, M: Any) -> None:
    """Refuse a mixture in which waves grow if Darcy's law has the soil's acceleration. Collective.

    The waves are solutions of ρ s² U + M κ² U = κ P and (S s + K κ²) P = κ (K ρ_w s² − s) U, with
    S = n0/K_w and K = k/γ_w. By the criterion of Routh and Hurwitz, all roots s have a negative
    real part only if (ρ − ρ_w)(1 + M S) > ρ M S. The condition does not depend on the wave number
    κ and on the permeability.

    Args:
        points: Material points; their density is the density ρ of the mixture.
        fluid: The fluid.
        porosity: First porosity n0, a constant or an expression. An expression counts as 1, the
            largest possible value.
        M: P-wave modulus, a constant (Pa).

    Raises:
        ParameterError: The density of a point is too small.
    """
    lightest = points.density.array.min(initial=math.inf)
    lightest = points.comm.allreduce(float(lightest), op=MPI.MIN)
    n0 = float(np.max(porosity.value)) if isinstance(porosity, fem.Constant) else 1.0
    stored = n0 / fluid.bulk_modulus * float(M.value)
    least = fluid.density * (1 + stored)
    if not lightest > least:
        raise ParameterError(
            f"the smallest density of the mixture is {lightest:.6g} kg/m³ and must be above "
            f"{least:.6g}, ρ_w (1 + M n0/K_w), for the soil's acceleration in Darcy's law: waves "
            "would grow without bounds. Give the points the density (1 − n0) ρ_s + n0 ρ_w, give "
            "the fluid a larger bulk_modulus, or leave inertia out"
        )
