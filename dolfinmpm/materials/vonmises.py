"""Von Mises' plasticity with isotropic hardening."""

from __future__ import annotations

import math

import numpy as np

from dolfinmpm.materials.base import ELASTIC, Array, Law, Parameter, Value, law_kernel
from dolfinmpm.materials.principal import elastic, moduli

__all__ = ["VonMises"]

_ROOT = math.sqrt(2.0 / 3.0)


@law_kernel
def _vonmises(parameters, strain, old, new, stress, tangent):
    lmbda, mu = moduli(parameters[0], parameters[1])
    first, linear = parameters[2], parameters[3]
    rise, rate = parameters[4] - first, parameters[5]
    a, b, c = strain[0], strain[1], strain[2]
    # all sums in the order of size, so that they do not depend on the order of the axes
    high, low = max(a, b), min(a, b)
    middle = max(low, min(high, c))
    high, low = max(high, c), min(low, c)
    trace = high + middle + low
    size = (high - middle) ** 2 + (middle - low) ** 2 + (high - low) ** 2
    size = 2.0 * mu * math.sqrt(size / 3.0)

    alpha = old[0]
    saturates = rise != 0.0 and rate != 0.0
    strength, slope = first + linear * alpha, linear
    if saturates:
        left = math.exp(-rate * alpha)
        strength += rise * (1.0 - left)
        slope += rise * rate * left
    f = size - strength
    # the largest and the smallest of values that are not all numbers may be numbers
    if not abs(a + b + c) < math.inf:
        return 1
    if f <= 0.0:
        elastic(lmbda, mu, trace, strain, stress, tangent)
        new[0] = alpha
        return 0
    if not f < math.inf:
        return 1

    if not saturates:
        alpha += _ROOT * f / (2.0 * mu + _ROOT * slope)
        strength = first + linear * alpha
    else:
        below, above = 0.0, size / (2.0 * mu)
        multiplier = 0.0
        for _ in range(100):
            step = multiplier + f / (2.0 * mu + _ROOT * slope)
            multiplier = step if below < step < above else 0.5 * (below + above)
            alpha = old[0] + _ROOT * multiplier
            left = math.exp(-rate * alpha)
            strength = first + linear * alpha + rise * (1.0 - left)
            slope = linear + rise * rate * left
            f = size - 2.0 * mu * multiplier - strength
            if abs(f) <= 1e-14 * size:
                break
            if f > 0.0:
                below = multiplier
            else:
                above = multiplier
        else:
            return 2
    # a negative hardening may use the strength up; a stress of no size has no direction
    if not strength > 0.0:
        return 1
    new[0] = alpha

    # the deviator takes the length of the strength, not of its trial less the flow: f = 0
    # then holds to the rounding of the stress itself, however far out the trial was
    shrink = strength / size
    steep = _ROOT * slope / (2.0 * mu + _ROOT * slope)
    bulk = lmbda + 2.0 / 3.0 * mu
    d0 = ((a - b) + (a - c)) / 3.0
    d1 = ((b - c) + (b - a)) / 3.0
    d2 = ((c - a) + (c - b)) / 3.0
    strain[0] = trace / 3.0 + shrink * d0
    strain[1] = trace / 3.0 + shrink * d1
    strain[2] = trace / 3.0 + shrink * d2
    pressure, factor = bulk * trace, 2.0 * mu * shrink
    stress[0] = pressure + factor * d0
    stress[1] = pressure + factor * d1
    stress[2] = pressure + factor * d2
    unit = 2.0 * mu / size
    d0, d1, d2 = unit * d0, unit * d1, unit * d2
    along = 2.0 * mu * steep - factor
    rest = bulk - factor / 3.0
    tangent[0] = rest + factor + along * d0 * d0
    tangent[4] = rest + factor + along * d1 * d1
    tangent[8] = rest + factor + along * d2 * d2
    tangent[1] = tangent[3] = rest + along * (d0 * d1)
    tangent[2] = tangent[6] = rest + along * (d0 * d2)
    tangent[5] = tangent[7] = rest + along * (d1 * d2)
    return 0


class VonMises(Law):
    """Von Mises' law: f = √(2 J₂) − ρ_y(α), associated, on Hencky's elasticity.

    ρ_y(α) = ρ_y0 + H α + (ρ_∞ − ρ_y0)(1 − e^(−δα)). The accumulated plastic strain
    α grows by √(2/3) ‖Δεᵖ‖, so that it is the plastic strain of a bar in tension.
    The bar yields at σ_y = √(3/2) ρ_y, its stress rises by √(3/2) H, and the
    undrained shear strength is c_u = ρ_y/√2. After Simo & Hughes, Computational
    Inelasticity (1998), box 3.2, with ρ_y as in AMPLE (Coombs & Augarde 2020, doi
    10.1016/j.advengsoft.2020.102748).

    A negative hardening is allowed up to where a strain has one stress only: nowhere may ρ_y
    fall faster than √6 μ by α. A point whose strength is used up has no stress.

    Args:
        E: Young's modulus (Pa), positive.
        nu: Poisson's ratio, -1 < ν < 0.5.
        yield_stress: Radius ρ_y0 of the first yield surface (Pa), positive.
        hardening: Linear part H (Pa), negative where strength falls.
        saturation: Radius ρ_∞ (Pa), positive, to which the exponential part tends; that
            of first yield by default, that is no exponential part.
        rate: Rate δ of the exponential part, not negative.

    Raises:
        ParameterError: A parameter is outside its range, or the fall of strength too steep.
    """

    parameters = ELASTIC | {
        "yield_stress": Parameter("Pa", low=0.0),
        "hardening": Parameter("Pa"),
        "saturation": Parameter("Pa", low=0.0),
        "rate": Parameter("", low=0.0, closed=True),
    }
    internal = {"plastic_strain": ("", 0.0)}
    kernel = _vonmises
    strengths = ("yield_stress", "hardening", "saturation")
    symmetric = True

    def __init__(
        self,
        E: Value,
        nu: Value,
        yield_stress: Value,
        hardening: Value = 0.0,
        saturation: Value | None = None,
        rate: Value = 0.0,
    ):
        if saturation is None:
            self._refuse_rate(rate, "saturation")
        super().__init__(
            E=E,
            nu=nu,
            yield_stress=yield_stress,
            hardening=hardening,
            saturation=yield_stress if saturation is None else saturation,
            rate=rate,
        )

    def admissible(self, values: dict[str, Array]) -> None:
        """Raise ParameterError where a strain has more than one stress."""
        self._check_rate(values, (("yield_stress", "saturation"),))
        rise = values["rate"] * (values["saturation"] - values["yield_stress"])
        steepest = values["hardening"] + np.minimum(rise, 0.0)
        limit = math.sqrt(1.5) * values["E"] / (1.0 + values["nu"])
        self._bound_softening("the yield stress", -steepest, limit, "√6 μ")

    def yield_function(self, stress: Array, internal: Array, parameters: Array) -> Array:
        """Yield function f of principal Kirchhoff stresses (Pa), shape (n,)."""
        _, _, first, linear, last, rate = parameters.T
        alpha = internal[:, 0]
        a, b, c = stress.T
        size = np.sqrt(((a - b) ** 2 + (b - c) ** 2 + (c - a) ** 2) / 3.0)
        return size - first - linear * alpha - (last - first) * (1.0 - np.exp(-rate * alpha))
