"""Tresca's plasticity, for undrained clay."""

from __future__ import annotations

import numpy as np

from dolfinmpm.materials.base import ELASTIC, Law
from dolfinmpm.materials.lawkernel import law_kernel
from dolfinmpm.materials.mohrcoulomb import return_to_planes
from dolfinmpm.materials.parametrised import Array, Parameter, Value
from dolfinmpm.materials.principal import moduli

__all__ = ["Tresca"]


@law_kernel
def _tresca(parameters, strain, old, new, stress, tangent):
    lmbda, mu = moduli(parameters[0], parameters[1])
    return return_to_planes(
        lmbda, mu, parameters[2], parameters[3], 0.0, 0.0, 0.0, parameters[4],
        strain, old, new, stress, tangent,
    )  # fmt: skip


# Rate at which cohesion tends to its last value, by plastic strain
_RATE = 5.0


class Tresca(Law):
    """Tresca's law: f = τ₁ − τ₃ − 2c(α), associated, on Hencky's elasticity.

    c(α) = c_ult + (c₀ − c_ult) e^(−rate·α). The accumulated plastic strain α grows by √(2/3) ‖Δεᵖ‖,
    in plane strain 2/√3 times the multiplier. The return goes to the plane or to one of its two
    edges, with the consistent tangent, after de Souza Neto, Perić & Owen, Computational Methods
    for Plasticity (2008), section 8.1. (The book's α is the sum of the multipliers.)

    The tangent is symmetric where strength is constant. At an edge of the yield surface, α is not
    the sum of the multipliers, so that a changing strength makes the tangent unsymmetric.

    Strength must fall slowly, so that a strain has one stress: c must not fall faster than 3/2 μ
    by α.

    Args:
        E: Young's modulus (Pa), positive.
        nu: Poisson's ratio, -1 < ν < 0.5.
        cohesion: First cohesion c₀ (Pa), positive.
        ultimate_cohesion: Last cohesion c_ult (Pa), positive; c₀ by default.
        rate: Rate of this change by α, not negative.

    Raises:
        ParameterError: A parameter is outside its range, or the strength falls too fast.

    Largest and smallest stress differ by 2c at yield:

    >>> import dolfinmpm as mpm
    >>> law = mpm.materials.Tresca(E=2e6, nu=0.25, cohesion=500.0)
    >>> s = law.respond([[2e-3, 0.0, -2e-3]]).stress[0]
    >>> s.round(6).tolist()
    [500.0, 0.0, -500.0]
    """

    parameters = ELASTIC | {
        "cohesion": Parameter("Pa", low=0.0),
        "ultimate_cohesion": Parameter("Pa", low=0.0),
        "rate": Parameter("", low=0.0, closed=True),
    }
    internal = {"plastic_strain": ("", 0.0)}
    kernel = _tresca
    strengths = ("cohesion", "ultimate_cohesion")

    def __init__(
        self,
        E: Value,
        nu: Value,
        cohesion: Value,
        *,
        ultimate_cohesion: Value | None = None,
        rate: Value = _RATE,
    ):
        if ultimate_cohesion is None:
            self._refuse_rate(rate, "ultimate_cohesion", _RATE)
        super().__init__(
            E=E,
            nu=nu,
            cohesion=cohesion,
            ultimate_cohesion=cohesion if ultimate_cohesion is None else ultimate_cohesion,
            rate=rate,
        )
        # the strain α by which strength changes is not the multiplier of an edge
        first, last = self.values["cohesion"], self.values["ultimate_cohesion"]
        if callable(first) or callable(last):
            self.symmetric = first is last
        else:
            self.symmetric = np.array_equal(first, last)

    def admissible(self, values: dict[str, Array]) -> None:
        """Raise ParameterError where a strain has more than one stress."""
        if (values["cohesion"] != values["ultimate_cohesion"]).any():
            self._check_rate(values, (("cohesion", "ultimate_cohesion"),))
        fall = values["rate"] * (values["cohesion"] - values["ultimate_cohesion"])
        limit = 0.75 * values["E"] / (1.0 + values["nu"])
        self._bound_softening("the cohesion", fall, limit, "3/2 μ")

    def yield_function(self, stress: Array, internal: Array, parameters: Array) -> Array:
        """Yield function f of principal Kirchhoff stresses (Pa), shape (n,)."""
        _, _, first, last, rate = parameters.T
        c = last + (first - last) * np.exp(-rate * internal[:, 0])
        return stress.max(axis=1) - stress.min(axis=1) - 2.0 * c
