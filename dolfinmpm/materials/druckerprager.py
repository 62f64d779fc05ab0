"""Drucker–Prager's cone over Hencky's elasticity."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from dolfinmpm._platform.argumentchecks import choice
from dolfinmpm._platform.errors import ParameterError
from dolfinmpm.materials.base import ELASTIC, Law
from dolfinmpm.materials.lawkernel import law_kernel
from dolfinmpm.materials.parametrised import Parameter, Value

__all__ = ["DruckerPrager"]

Array = npt.NDArray[np.float64]


@law_kernel
def _drucker_prager(parameters, strain, old, new, stress, tangent):
    E, nu, cohesion, hardening = parameters[0], parameters[1], parameters[2], parameters[5]
    eta, xi, eta_flow = parameters[6], parameters[7], parameters[8]
    G = 0.5 * E / (1.0 + nu)
    K = E / (3.0 * (1.0 - 2.0 * nu))
    mean = (strain[0] + strain[1] + strain[2]) / 3.0
    e = (strain[0] - mean, strain[1] - mean, strain[2] - mean)
    p = 3.0 * K * mean
    norm2 = e[0] * e[0] + e[1] * e[1] + e[2] * e[2]
    sqrt_J2 = G * math.sqrt(2.0 * norm2)  # √J₂
    strength = xi * (cohesion + hardening * old[0])
    f = sqrt_J2 + eta * p - strength
    if not math.isfinite(f):
        return 1
    new[0] = old[0]
    if f <= 0.0:
        for i in range(3):
            stress[i] = p + 2.0 * G * e[i]
            for j in range(3):
                tangent[3 * i + j] = K - 2.0 / 3.0 * G
            tangent[4 * i] += 2.0 * G
        return 0

    # Side of the cone: f is linear in the multiplier
    rate = math.sqrt(1.0 / 3.0 + 2.0 / 9.0 * eta_flow * eta_flow)  # of the plastic strain
    slope = G + K * eta * eta_flow + xi * hardening * rate
    multiplier = f / slope
    back = p - K * eta_flow * multiplier
    # From f = 0 instead of √J₂ − G Δγ: exactly on the cone, for any size of the trial stress
    end = strength + xi * hardening * rate * multiplier - eta * back
    if (sqrt_J2 > G * multiplier and end > 0.0) or eta == 0.0:
        end = max(end, 0.0)
        scale = 2.0 * G / sqrt_J2
        n = (scale * e[0], scale * e[1], scale * e[2])
        shear = 2.0 * G * end / sqrt_J2
        for i in range(3):
            # the part with n_j, and the part that is equal for all j
            along = n[i] * (G - G * G / slope) - K * eta_flow * G / slope - 0.5 * shear * n[i]
            even = K - (n[i] * G + K * eta_flow) * eta * K / slope - shear / 3.0
            for j in range(3):
                tangent[3 * i + j] = along * n[j] + even
            tangent[4 * i] += shear
        for i in range(3):
            stress[i] = back + end * n[i]
            strain[i] = back / (3.0 * K) + 0.5 * end * n[i] / G
        new[0] = old[0] + rate * multiplier
        return 0

    # Apex: the deviator vanishes, and the plastic volume change follows from the pressure alone
    gap = eta * p - strength
    B = eta * K
    C = xi * hardening * math.sqrt(2.0 / 3.0)
    discriminant = C * C * (norm2 * (B * B - C * C / 3.0) + gap * gap / 3.0)
    volume = 0.0
    if gap * gap > C * C * norm2 and gap > 0.0:  # false by rounding only
        volume = (gap * gap - C * C * norm2) / (gap * B + math.sqrt(max(discriminant, 0.0)))
    size = math.sqrt(norm2 + volume * volume / 3.0)
    new[0] = old[0] + math.sqrt(2.0 / 3.0) * size
    back = xi * (cohesion + hardening * new[0]) / eta
    for j in range(3):
        # without hardening the apex does not move, and a difference of equals would leave rounding
        column = 0.0
        if C > 0.0:
            column = K * C * (e[j] + volume / 3.0) / (B * size + C * volume / 3.0)
        for i in range(3):
            tangent[3 * i + j] = column
    for i in range(3):
        stress[i] = back
        strain[i] = back / (3.0 * K)
    return 0


def cone(angle: Array, fit: str) -> tuple[Array, Array]:
    """η and ξ of the cone that fits Mohr–Coulomb's pyramid of this angle (rad)."""
    sine, cosine = np.sin(angle), np.cos(angle)
    if fit in ("compression", "extension"):
        above = 6.0
        below = math.sqrt(3.0) * (3.0 - sine if fit == "compression" else 3.0 + sine)
    else:
        above, below = math.sqrt(3.0), np.sqrt(3.0 + sine**2)
    return above * sine / below, above * cosine / below


class DruckerPrager(Law):
    """Drucker–Prager's law: f = √J₂ + η p − ξ c, over Hencky's elasticity.

    J₂ and p = tr(τ)/3 are of the Kirchhoff stress, with p positive in tension. Plastic strain
    flows along the derivative of √J₂ + η̄ p, where η̄ is η for the dilation angle. The
    cohesion is c + H ε̄ᵖ, with the accumulated plastic strain ε̄ᵖ = ∫ √(2/3 ε̇ᵖ : ε̇ᵖ) dt.

    The cone touches Mohr–Coulomb's pyramid as in de Souza Neto, Perić & Owen (2008),
    Computational Methods for Plasticity, §6.4.4:

    - "compression": at the outer edges, exact in triaxial compression, and much too strong in plane
      strain: 3.1 times Mohr–Coulomb's deviator in biaxial compression for φ = ψ = 30°;
      η = 6 sin φ/(√3 (3 − sin φ)), ξ = 6 cos φ/(√3 (3 − sin φ));
    - "extension": at the inner edges, exact in triaxial extension; with 3 + sin φ;
    - "plane strain": the same limit loads in plane strain under associated flow;
      η = 3 tan φ/√(9 + 12 tan² φ), ξ = 3/√(9 + 12 tan² φ);
    - "inner": the widest cone within the pyramid, tangent to its faces. It is the same cone as
      "plane strain"; the two names stand for two reasons to choose it.

    If the return to the side of the cone would pass the apex, the stress is the apex: p = ξ c/η,
    without deviator. The plastic strain is then the whole loss of elastic strain. Its volume
    change need not obey the dilation angle, as in a vertex where the cone meets the plane
    p = ξ c/η: the plastic work there is not negative. This rule holds for every dilation angle.
    The book's apex equation derives the hardening from the volume change. It divides by η̄ and
    fails for ψ = 0. With hardening, ε̄ᵖ at the apex solves a quadratic equation. At an apex
    without hardening the tangent is zero.

    Internal variables: `plastic_strain` ε̄ᵖ, initially 0.

    Args:
        E: Young's modulus (Pa), positive.
        nu: Poisson's ratio, -1 < ν < 0.5.
        cohesion: Cohesion c (Pa), not negative. With 0 the apex is at the origin.
        friction_angle: φ (degrees), 0 ≤ φ ≤ 90; at 0 there is no apex.
        dilation_angle: ψ (degrees), 0 ≤ ψ ≤ φ; 0 by default, as for `MohrCoulomb`;
            ψ = φ is associated flow.
        fit: Fit of the cone to the pyramid, see above.
        hardening: Slope H of the cohesion over ε̄ᵖ (Pa), not negative.

    Raises:
        ParameterError: A parameter is outside its range, dilation is larger than friction,
            or the fit is unknown.

    The same strength as `MohrCoulomb` in triaxial compression:

    >>> import dolfinmpm as mpm
    >>> law = mpm.materials.DruckerPrager(E=2e6, nu=0.25, cohesion=0.0, friction_angle=30.0)
    >>> s = law.respond([[0.0, 0.0, -9e-3]]).stress[0]
    >>> round(float(s[2] / s[0]), 6)
    3.0
    """

    parameters = ELASTIC | {
        "cohesion": Parameter("Pa", low=0.0, closed=True),
        "friction_angle": Parameter("degrees", low=0.0, high=90.0, closed=True),
        "dilation_angle": Parameter("degrees", low=0.0, high=90.0, closed=True),
        "hardening": Parameter("Pa", low=0.0, closed=True),
    }
    internal = {"plastic_strain": ("", 0.0)}
    kernel = _drucker_prager
    strengths = ("cohesion", "hardening")
    friction_angles = ("friction_angle",)
    fits = ("compression", "extension", "plane strain", "inner")

    def __init__(
        self,
        E: Value,
        nu: Value,
        cohesion: Value,
        friction_angle: Value,
        *,
        dilation_angle: Value = 0.0,
        fit: str = "compression",
        hardening: Value = 0.0,
    ):
        self.fit = choice("DruckerPrager: fit", fit, self.fits)
        super().__init__(
            E=E,
            nu=nu,
            cohesion=cohesion,
            friction_angle=friction_angle,
            dilation_angle=dilation_angle,
            hardening=hardening,
        )

    def admissible(self, values: dict[str, Array]) -> None:
        """Raise ParameterError where dilation is larger than friction."""
        self._warn_of_radians(values)
        friction, dilation = values["friction_angle"], values["dilation_angle"]
        if ((values["cohesion"] == 0.0) & (friction == 0.0)).any():
            raise ParameterError("DruckerPrager: without friction the cohesion must be positive")
        bad = dilation > friction
        if bad.any():
            at = int(np.argmax(bad))
            raise ParameterError(
                f"DruckerPrager: dilation_angle = {dilation[at]:g} degrees must not be larger than "
                f"friction_angle = {friction[at]:g} degrees"
            )

    def completed(self, parameters: Array) -> Array:
        """The parameters of the kernel: the declared ones, then η, ξ and η̄."""
        friction, dilation = np.radians(parameters[:, 3]), np.radians(parameters[:, 4])
        eta_flow, _ = cone(dilation, self.fit)
        return np.column_stack([parameters, *cone(friction, self.fit), eta_flow])

    def yield_function(self, stress: Array, internal: Array, parameters: Array) -> Array:
        """f = √J₂ + η p − ξ (c + H ε̄ᵖ) (Pa), shape (n,); see `Law.yield_function`."""
        p = stress.mean(axis=1)
        sqrt_J2 = np.sqrt(0.5 * ((stress - p[:, None]) ** 2).sum(axis=1))
        c = parameters[:, 2] + parameters[:, 5] * internal[:, 0]
        return sqrt_J2 + parameters[:, 6] * p - parameters[:, 7] * c

    def __repr__(self) -> str:
        return f"{super().__repr__()[:-1]}, fit={self.fit!r})"
