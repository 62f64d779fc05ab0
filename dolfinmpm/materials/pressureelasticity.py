"""The hyperelasticity of Borja and Tamagnini: stiffness grows with pressure."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numba
import numpy as np
import numpy.typing as npt

from dolfinmpm._platform.errors import ParameterError
from dolfinmpm.materials.base import Law
from dolfinmpm.materials.parametrised import Array, Parameter

__all__ = ["PRESSURE_ELASTIC", "PressureElastic", "elastic_tangent", "meridian_tangent"]

# Where a rule is broken, the names of two values, and the rule between them
Rule = tuple[npt.NDArray[np.bool_], str, str, str]

PRESSURE_ELASTIC = {
    "swelling": Parameter("", low=0.0, high=1.0),
    "mu0": Parameter("Pa", low=0.0, closed=True),
    "alpha": Parameter("", low=0.0, closed=True),
    "reference_pressure": Parameter("Pa", low=0.0),
    "reference_strain": Parameter(""),
}


@numba.njit(cache=True, error_model="numpy")
def elastic_tangent(bulk, mu, coupling, e, tangent):
    """Write the derivatives of stress by strain (Pa).

    Args:
        bulk: p/κ̂ (Pa).
        mu: Shear modulus (Pa).
        coupling: 2α X/κ̂ (Pa).
        e: Deviator of the elastic strain, three values.
        tangent: Output, nine values.
    """
    for i in range(3):
        for j in range(3):
            tangent[3 * i + j] = bulk - 2.0 / 3.0 * mu - coupling * (e[i] + e[j])
        tangent[4 * i] += 2.0 * mu


@numba.njit(cache=True, error_model="numpy")
def meridian_tangent(E11, E12, E21, E22, q, shear, n, tangent):
    """Write the derivatives of stress −p + √(2/3) q n by strain (Pa), with n fixed to the trial.

    Args:
        E11, E12: Derivatives of −p by the trial volume strain and shear strain (Pa).
        E21, E22: Derivatives of q, likewise.
        q: q (Pa).
        shear: Trial shear strain √(2/3) |e|.
        n: Unit vector along the deviator of the trial strain, three values.
        tangent: Output, nine values.
    """
    secant = E22  # q/ε_s of the trial strain, and its limit
    if shear > 0.0:
        secant = q / shear
    secant *= 2.0 / 3.0
    two = math.sqrt(2.0 / 3.0)
    for i in range(3):
        even = E11 + two * n[i] * E21 - secant / 3.0
        along = two * E12 + (2.0 / 3.0 * E22 - secant) * n[i]
        for j in range(3):
            tangent[3 * i + j] = even + along * n[j]
        tangent[4 * i] += secant


class PressureElastic(Law):
    """Base of laws over the hyperelasticity of Borja and Tamagnini.

    The laws have the parameters `PRESSURE_ELASTIC` among theirs, and a size of the yield surface
    (Pa) as the first internal variable.
    """

    def _check_start(
        self, values: dict[str, Array], what: str, largest: Array, rules: Sequence[Rule] = (),
        advice: str = "",
    ) -> None:  # fmt: skip
        """Raise ParameterError where the first state is beyond the yield surface, or stiffness 0.

        Args:
            values: Name → values of the parameters.
            what: Name of the largest pressure on the yield surface.
            largest: This pressure (Pa).
            rules: Further rules, which come first: where each is broken, two names, and the rule.
            advice: What to do about a first state beyond the yield surface, after a semicolon.
        """
        first = values["reference_pressure"] * np.exp(
            values["reference_strain"] / values["swelling"]
        )
        known = values | {"the first pressure": first, what: largest}
        beyond = first > largest * (1.0 + 1e-12)
        for bad, left, right, rule in (
            *rules,
            (values["mu0"] + values["alpha"] <= 0.0, "mu0", "alpha", "not be 0 together with"),
            (beyond, what, "the first pressure", "be at least"),
        ):
            if bad.any():
                at = int(np.argmax(bad))
                raise ParameterError(
                    f"{type(self).__name__}: {left} = {known[left][at]:g} must {rule} "
                    f"{right} = {known[right][at]:g}{advice if left == what else ''}"
                )

    def energy(self, strain: Array, parameters: Array) -> Array:
        """Ψ = |p0| κ̂ e^Ω + 3/2 (μ0 + α |p0| e^Ω) ε_s² (J/m³); see `Law.energy`."""
        names = list(self.parameters)
        swelling, mu0, alpha, p0, volume = (
            parameters[:, names.index(name)] for name in PRESSURE_ELASTIC
        )
        trace = strain.sum(axis=1)
        shear = 2.0 / 3.0 * np.sum((strain - trace[:, None] / 3) ** 2, axis=1)
        x = p0 * np.exp((volume - trace) / swelling)
        return swelling * x + 1.5 * (mu0 + alpha * x) * shear

    def unyielding(self, internal: Array) -> Array:
        """Internal variables of an infinitely large yield surface; see `Law.unyielding`."""
        found = np.array(internal, float)
        found[:, 0] = np.inf
        return found
