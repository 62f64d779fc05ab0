"""Parameters of sands by their relative density."""

from __future__ import annotations

import math
from dataclasses import dataclass

from dolfinmpm._platform.argumentchecks import number
from dolfinmpm._platform.errors import ParameterError

__all__ = ["Sand", "sand"]

# gravity with which the formulas' unit weights were published
_GRAVITY = 10.0


@dataclass(frozen=True)
class Sand:
    """Parameters of a sand.

    Attributes:
        relative_density: RD, a share.
        unit_weight: γ above the water table (N/m³).
        saturated_unit_weight: γ below it (N/m³).
        E_ref: Young's modulus at the confining stress p_ref (Pa).
        p_ref: 100 kPa.
        exponent: m in E = E_ref (σ'/p_ref)^m.
        friction_angle, dilation_angle: φ and ψ (degrees).
        cohesion: c (Pa).
        nu: Poisson's ratio.
        K0: Horizontal by vertical effective stress at rest.

    >>> import dolfinmpm as mpm
    >>> dense = mpm.materials.sand(0.8)
    >>> dense.E_ref, dense.density, dense.friction_angle
    (48000000.0, 1820.0, 38.0)
    """

    relative_density: float
    unit_weight: float
    saturated_unit_weight: float
    E_ref: float
    p_ref: float
    exponent: float
    friction_angle: float
    dilation_angle: float
    cohesion: float
    nu: float
    K0: float

    @property
    def density(self) -> float:
        """Mass per volume above the water table (kg/m³), with g = 10 m/s²."""
        return self.unit_weight / _GRAVITY

    @property
    def parameters(self) -> dict[str, float]:
        """Arguments of `MohrCoulomb` and `DruckerPrager` besides E."""
        names = ("nu", "cohesion", "friction_angle", "dilation_angle")
        return {name: getattr(self, name) for name in names}


def sand(relative_density: float, *, nu: float = 0.3, cohesion: float = 300.0) -> Sand:
    """Parameters of a quartz sand by empirical formulas of its relative density.

    E_ref = 60 MPa RD at 100 kPa, m = 0.7 − RD/3.2, φ = 28 + 12.5 RD and ψ = 12.5 RD − 2 degrees,
    γ = 15 + 4 RD and 19 + 1.6 RD kN/m³ dry and saturated (Brinkgreve, Engin & Engin 2010,
    "Validation of empirical formulas to derive model parameters for sands", NUMGE 2010), and
    K0 = 1 − sin φ (Jaky). Loose sand that would contract has ψ = 0.

    Args:
        relative_density: RD, a share in [0, 1].
        nu: Poisson's ratio, which the formulas do not give.
        cohesion: c (Pa), likewise. A small cohesion holds the surface together.

    Raises:
        ParameterError: RD is not in [0, 1], such as a value in per cent. Or nu or the cohesion is
            outside its range.

    >>> import dolfinmpm as mpm
    >>> medium = mpm.materials.sand(0.5)
    >>> law = mpm.materials.MohrCoulomb(E=medium.E_ref, **medium.parameters)
    >>> medium.parameters["friction_angle"], round(medium.K0, 3)
    (34.25, 0.437)
    """
    RD = number("relative_density", relative_density)
    if not 0.0 <= RD <= 1.0:
        raise ParameterError(
            f"relative_density = {RD:g} must be a share in [0, 1]; give {RD:g} % as {RD / 100:g}"
        )
    number("nu", nu, -1.0, 0.5), number("cohesion", cohesion, 0.0, closed=True, unit="Pa")
    phi = 28.0 + 12.5 * RD
    return Sand(
        relative_density=RD,
        unit_weight=(15.0 + 4.0 * RD) * 1e3,
        saturated_unit_weight=(19.0 + 1.6 * RD) * 1e3,
        E_ref=60e6 * RD,
        p_ref=100e3,
        exponent=0.7 - RD / 3.2,
        friction_angle=phi,
        dilation_angle=max(12.5 * RD - 2.0, 0.0),
        cohesion=float(cohesion),
        nu=float(nu),
        K0=1.0 - math.sin(math.radians(phi)),
    )
