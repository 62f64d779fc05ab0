"""Von Mises' plasticity with isotropic hardening."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from dolfinmpm._platform.argumentchecks import shown
from dolfinmpm._platform.errors import ParameterError
from dolfinmpm.materials.base import ELASTIC, Law
from dolfinmpm.materials.lawkernel import law_kernel
from dolfinmpm.materials.parametrised import Array, Parameter, Value
from dolfinmpm.materials.principal import elastic, moduli

__all__ = ["VonMises"]

_ROOT = math.sqrt(2.0 / 3.0)


@law_kernel
def _vonmises(parameters, strain, old, new, stress, tangent):
    lmbda, mu = moduli(parameters[0], parameters[1])
    # radii of the yield surface in the deviatoric plane
    share = parameters[6]
    first, linear = share * parameters[2], share * parameters[3]
    rise, rate = share * parameters[4] - first, parameters[5]
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
    # the largest and the smallest value may be numbers even if another value is NaN
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
    # a negative hardening may use up the strength; a zero stress has no direction
    if not strength > 0.0:
        return 1
    new[0] = alpha

    # the deviator gets its length from the strength, not from trial stress less flow: f = 0
    # then holds to the rounding of the stress itself, for any size of the trial stress
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
    """Von Mises' law: f = √(2 J₂) − √(2/3) σ_y(α), associated, on Hencky's elasticity.

    σ_y(α) = σ_0 + H α + (σ_∞ − σ_0)(1 − e^(−δα)) is the yield stress of a bar in tension.
    The accumulated plastic strain α grows by √(2/3) ‖Δεᵖ‖: it is the bar's plastic strain. The
    undrained shear strength is c_u = σ_y/√3. After Simo & Hughes, Computational Inelasticity
    (1998), box 3.2.

    AMPLE (Coombs & Augarde 2020, doi 10.1016/j.advengsoft.2020.102748) gives the radius
    ρ = √(2/3) σ_y = √2 c_u of the yield surface in the deviatoric plane. With `radius`, hardening
    and saturation are those of the radius, too.

    Strength must fall slowly, so that a strain has one stress: σ_y must not fall faster than 3 μ
    by α, and the radius not faster than √6 μ. A point whose strength is used up has no stress.

    Args:
        E: Young's modulus (Pa), positive.
        nu: Poisson's ratio, -1 < ν < 0.5.
        yield_stress: Uniaxial yield stress σ_0 (Pa), positive.
        radius: Radius of the first yield surface (Pa), positive; instead of `yield_stress`.
        hardening: Linear part H (Pa), negative where strength falls.
        saturation: Limit σ_∞ of the exponential part (Pa), positive. By default the first value,
            without exponential part.
        rate: Rate δ of the exponential part, not negative.

    Raises:
        ParameterError: A parameter is outside its range, not exactly one of `yield_stress` and
            `radius` is given, or the strength falls too fast.

    The deviator of the stress at yield is √(2/3) σ_y:

    >>> import dolfinmpm as mpm
    >>> law = mpm.materials.VonMises(E=2e6, nu=0.25, yield_stress=1e3)
    >>> s = law.respond([[2e-3, -1e-3, -1e-3]]).stress[0]
    >>> s.round(6).tolist()
    [666.666667, -333.333333, -333.333333]
    """

    internal = {"plastic_strain": ("", 0.0)}
    kernel = _vonmises
    symmetric = True

    def __init__(
        self,
        E: Value,
        nu: Value,
        *,
        yield_stress: Value | None = None,
        radius: Value | None = None,
        hardening: Value = 0.0,
        saturation: Value | None = None,
        rate: Value = 0.0,
    ):
        if (yield_stress is None) == (radius is None):
            raise ParameterError(
                f"VonMises: yield_stress = {shown(yield_stress)} and radius = {shown(radius)}; "
                "give exactly one: the uniaxial yield stress (Pa), or the radius of the yield "
                "surface, √(2/3) of it"
            )
        first: Any = yield_stress if radius is None else radius
        name = "yield_stress" if radius is None else "radius"
        self.strengths = (name, "hardening", "saturation")
        self.parameters = ELASTIC | {
            name: Parameter("Pa", low=0.0),
            "hardening": Parameter("Pa"),
            "saturation": Parameter("Pa", low=0.0),
            "rate": Parameter("", low=0.0, closed=True),
        }
        if saturation is None:
            self._refuse_rate(rate, "saturation")
        super().__init__(
            E=E,
            nu=nu,
            hardening=hardening,
            saturation=first if saturation is None else saturation,
            rate=rate,
            **{name: first},
        )

    @property
    def _first(self) -> tuple[str, float]:
        """Name of the first strength, and the factor from it to the radius."""
        return ("radius", 1.0) if "radius" in self.parameters else ("yield_stress", _ROOT)

    def admissible(self, values: dict[str, Array]) -> None:
        """Raise ParameterError where a strain has more than one stress."""
        first, share = self._first
        self._check_rate(values, ((first, "saturation"),))
        rise = values["rate"] * (values["saturation"] - values[first])
        steepest = values["hardening"] + np.minimum(rise, 0.0)
        limit = math.sqrt(1.5) / share * values["E"] / (1.0 + values["nu"])
        symbol = "√6 μ" if first == "radius" else "3 μ"
        self._bound_softening(f"the {first.replace('_', ' ')}", -steepest, limit, symbol)

    def completed(self, parameters: Array) -> Array:
        """The parameters of the kernel: the declared ones, then the factor to radii."""
        return np.column_stack([parameters, np.full(len(parameters), self._first[1])])

    def yield_function(self, stress: Array, internal: Array, parameters: Array) -> Array:
        """Yield function f of principal Kirchhoff stresses (Pa), shape (n,)."""
        _, _, first, linear, last, rate, share = parameters.T
        first, linear, last = share * first, share * linear, share * last
        alpha = internal[:, 0]
        a, b, c = stress.T
        size = np.sqrt(((a - b) ** 2 + (b - c) ** 2 + (c - a) ** 2) / 3.0)
        return size - first - linear * alpha - (last - first) * (1.0 - np.exp(-rate * alpha))
