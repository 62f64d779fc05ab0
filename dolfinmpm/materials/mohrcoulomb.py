"""Mohr–Coulomb's plasticity: six planes with their edges and the apex."""

from __future__ import annotations

import math

import numba
import numpy as np

from dolfinmpm._platform.errors import ParameterError
from dolfinmpm.materials.base import ELASTIC, Law
from dolfinmpm.materials.lawkernel import law_kernel
from dolfinmpm.materials.parametrised import Array, Parameter, Value
from dolfinmpm.materials.principal import descending, elastic, moduli

__all__ = ["MohrCoulomb"]

_ROOT = math.sqrt(2.0 / 3.0)


@numba.njit(error_model="numpy")
def return_to_planes(
    lmbda, mu, cohesion, last_cohesion, friction, last_friction, dilation, rate,
    strain, old, new, stress, tangent,
):  # fmt: skip
    """Return to (1 + sin φ) τ₁ − (1 − sin φ) τ₃ = 2c cos φ; the body of kernels, angles in radians.

    For a given strength the return has a closed form. Let τ₁ ≥ τ₂ ≥ τ₃, and let g be the flow and
    n the gradient of a plane. At an edge two stresses become equal. The edge is a plane for the
    mean of these stresses, and the difference of their strains is plastic. So plane and edges
    differ only in g, n and the matrix P that takes this mean. If the strength depends on the
    plastic strain α, one equation is left: α = α_n + √(2/3) ‖Δεᵖ(α)‖.
    """
    i, j, k = descending(strain)
    e1, e2, e3 = strain[i], strain[j], strain[k]
    trace = e1 + e2 + e3
    pressure = lmbda * trace

    alpha = old[0]
    changes = rate != 0.0 and (cohesion != last_cohesion or friction != last_friction)
    c, phi, c_slope, phi_slope = cohesion, friction, 0.0, 0.0
    if changes:
        left = math.exp(-rate * alpha)
        c_slope = -rate * (cohesion - last_cohesion) * left
        phi_slope = -rate * (friction - last_friction) * left
        c = last_cohesion + (cohesion - last_cohesion) * left
        phi = last_friction + (friction - last_friction) * left
    sin, cos = 0.0, 1.0
    if phi != 0.0:
        sin, cos = math.sin(phi), math.cos(phi)
    q = 2.0 * c * cos
    f = 2.0 * mu * (e1 - e3) + 2.0 * (pressure + mu * (e1 + e3)) * sin - q
    if f <= 0.0:
        elastic(lmbda, mu, trace, strain, stress, tangent)
        new[0] = alpha
        return 0
    if not f < math.inf:
        return 1

    up, down = 1.0, 1.0
    if dilation != 0.0:
        up += math.sin(dilation)
        down -= math.sin(dilation)
    spread = lmbda * (up - down)
    gap12, gap23 = (e1 - e2) / up, (e2 - e3) / down
    below, above = alpha, math.inf
    for iteration in range(100):
        P11, P12, P22, P23, P33 = 1.0, 0.0, 1.0, 0.0, 1.0
        g1, g2, g3 = up, 0.0, -down
        n1, n2, n3 = 1.0 + sin, 0.0, sin - 1.0
        m1, m3, gap, half = e1, e3, 0.0, 0.0
        apex = False
        stiff = 2.0 * sin * spread + 2.0 * mu * (n1 * g1 + n3 * g3)
        # α beyond its solution can put f below zero on the way
        multiplier = max(f / stiff, 0.0)
        if multiplier >= gap12 or multiplier >= gap23:
            # the plane's return would change the order; the edge that it meets first
            # follows from the flow alone, for a return past both of them too
            if gap12 < gap23:
                P11 = P12 = P22 = 0.5
                g1 = g2 = 0.5 * up
                n1 = n2 = 0.5 * n1
                m1 = 0.5 * (e1 + e2)
                gap = gap12
            else:
                P22 = P23 = P33 = 0.5
                g2 = g3 = -0.5 * down
                n2 = n3 = 0.5 * n3
                m3 = 0.5 * (e2 + e3)
                gap = gap23
            stiff = 2.0 * sin * spread + 2.0 * mu * (n1 * g1 + n2 * g2 + n3 * g3)
            multiplier = 2.0 * mu * (m1 - m3) + 2.0 * (pressure + mu * (m1 + m3)) * sin - q
            # rounding only can make it less than what the plane alone gives up to the edge
            multiplier = max(multiplier / stiff, gap)
        # the last stress follows from f = 0, which so holds to the rounding of the
        # stress itself, however far out the trial was
        x1 = pressure + 2.0 * mu * m1 - multiplier * (spread + 2.0 * mu * g1)
        x3 = ((1.0 + sin) * x1 - q) / (1.0 - sin)
        if P12 != 0.0:
            x2 = x1
        elif P23 != 0.0:
            x2 = x3
        else:
            x2 = min(max(pressure + 2.0 * mu * e2 - multiplier * spread, x3), x1)
        if x3 > x1 or e1 == e3:
            # past the apex: the plastic strain is whatever leads to the apex
            apex = True
            x1 = x2 = x3 = 0.5 * q / sin
            kept = min(x1 / (3.0 * lmbda + 2.0 * mu), e1)
            h1, h2, h3 = e1 - kept, e2 - kept, e3 - kept
        else:
            h1, h2, h3 = multiplier * g1, multiplier * g2, multiplier * g3
            if P12 != 0.0:
                half = 0.5 * (e1 - e2)
                h1 += half
                h2 -= half
            elif P23 != 0.0:
                half = 0.5 * (e2 - e3)
                h2 += half
                h3 -= half
        plastic = math.sqrt(h1 * h1 + h2 * h2 + h3 * h3)
        if not changes:
            alpha += _ROOT * plastic
            break

        # derivatives by α at fixed strain: of the multiplier (of the pressure at the
        # apex), then of the plastic strain
        over = 1.0 / plastic if plastic > 0.0 else 0.0
        if apex:
            slope = (c_slope * cos - c * phi_slope / sin) / sin
            along = -(h1 + h2 + h3) / (3.0 * lmbda + 2.0 * mu) * over
        else:
            slope = phi_slope * cos * (x1 + x3) - 2.0 * (c_slope * cos - c * sin * phi_slope)
            slope /= stiff
            along = (h1 * g1 + h2 * g2 + h3 * g3) * over
        residual = alpha - old[0] - _ROOT * plastic
        steep = 1.0 - _ROOT * along * slope
        done = abs(residual) <= 1e-14 * (alpha + abs(e1) + abs(e3))
        if (done or iteration == 0) and not steep > 0.0:
            # strength falls faster than elasticity unloads: this strain has no single stress
            return 1
        if done:
            break
        if residual < 0.0:
            below = alpha
        else:
            above = alpha
        step = alpha - residual / steep
        if not below < step < above:
            step = 0.5 * (below + above) if above < math.inf else old[0] + _ROOT * plastic
        alpha = step
        left = math.exp(-rate * alpha)
        c_slope = -rate * (cohesion - last_cohesion) * left
        c = last_cohesion + (cohesion - last_cohesion) * left
        if friction != last_friction:
            phi_slope = -rate * (friction - last_friction) * left
            phi = last_friction + (friction - last_friction) * left
            sin, cos = math.sin(phi), math.cos(phi)
        q = 2.0 * c * cos
        f = 2.0 * mu * (e1 - e3) + 2.0 * (pressure + mu * (e1 + e3)) * sin - q
    else:
        return 2
    new[0] = alpha

    shift = lmbda / (3.0 * lmbda + 2.0 * mu) * (x1 + x2 + x3)
    strain[i] = (x1 - shift) / (2.0 * mu)
    strain[j] = (x2 - shift) / (2.0 * mu)
    strain[k] = (x3 - shift) / (2.0 * mu)
    stress[i], stress[j], stress[k] = x1, x2, x3

    # derivatives by the trial strains of the multiplier: s, and through α
    s1 = s2 = s3 = 0.0
    if not apex:
        s1 = (2.0 * lmbda * sin + 2.0 * mu * n1) / stiff
        s2 = (2.0 * lmbda * sin + 2.0 * mu * n2) / stiff
        s3 = (2.0 * lmbda * sin + 2.0 * mu * n3) / stiff
    if changes:
        weight = _ROOT / steep * slope
        if apex:
            s1, s2, s3 = weight * h1 * over, weight * h2 * over, weight * h3 * over
        else:
            a1 = a2 = a3 = 0.0
            if P12 != 0.0:
                a1, a2 = half * over, -half * over
            elif P23 != 0.0:
                a2, a3 = half * over, -half * over
            s1 += weight * (along * s1 + a1)
            s2 += weight * (along * s2 + a2)
            s3 += weight * (along * s3 + a3)
    if apex:
        for row in range(3):
            tangent[3 * row + i], tangent[3 * row + j], tangent[3 * row + k] = s1, s2, s3
        return 0
    G = 2.0 * mu
    r = spread + G * g1
    tangent[3 * i + i] = lmbda + G * P11 - r * s1
    tangent[3 * i + j] = lmbda + G * P12 - r * s2
    tangent[3 * i + k] = lmbda - r * s3
    r = spread + G * g2
    tangent[3 * j + i] = lmbda + G * P12 - r * s1
    tangent[3 * j + j] = lmbda + G * P22 - r * s2
    tangent[3 * j + k] = lmbda + G * P23 - r * s3
    r = spread + G * g3
    tangent[3 * k + i] = lmbda - r * s1
    tangent[3 * k + j] = lmbda + G * P23 - r * s2
    tangent[3 * k + k] = lmbda + G * P33 - r * s3
    return 0


@law_kernel
def _mohrcoulomb(parameters, strain, old, new, stress, tangent):
    lmbda, mu = moduli(parameters[0], parameters[1])
    degree = math.pi / 180.0
    return return_to_planes(
        lmbda, mu, parameters[2], parameters[5], parameters[3] * degree, parameters[6] * degree,
        parameters[4] * degree, parameters[7], strain, old, new, stress, tangent,
    )  # fmt: skip


class MohrCoulomb(Law):
    """Mohr–Coulomb's law: f = τ₁ − τ₃ + (τ₁ + τ₃) sin φ − 2c cos φ, on Hencky's elasticity.

    Tension is positive and τ₁ ≥ τ₂ ≥ τ₃. Flow is that of f with the dilation angle ψ
    in place of φ. The return goes to the plane, to one of its two edges or to the
    apex, after de Souza Neto, Perić & Owen, Computational Methods for Plasticity
    (2008), section 8.2, with the tangent that is consistent with it.

    If the return to an edge would pass the apex, the stress is the apex, p = c cot φ. All strain
    beyond the apex is plastic, for ψ > 0 and for ψ = 0. For ψ = 0 the flow of the planes does not
    lead to the apex, and the volume opens there without stress. So the stress stays continuous in
    the strain, and the dissipation p Δε_vᵖ is not negative. The book instead couples α to
    Δε_vᵖ / sin ψ, which has no limit for ψ → 0. At the apex of a law without hardening the tangent
    is zero. For c = 0 a point at the apex carries no stress.

    Cohesion and friction angle follow the accumulated plastic strain α as
    value = residual + (peak − residual) e^(−rate·α). Here α grows by √(2/3) ‖Δεᵖ‖ on planes, edges
    and apex alike. (The book's α grows by 2 cos φ Δγ, without dilation √3 cos φ times as much.) The
    dilation angle is constant.

    Strength must not fall faster than elasticity unloads. Otherwise a strain has several stresses.
    For a constant friction angle this bounds the parameters on planes and edges. At the apex, and
    for a friction angle that changes, the bound depends on the state. (A rising friction angle
    lowers the apex, too.) A state in which strength falls too fast has no stress.

    Args:
        E: Young's modulus (Pa), positive.
        nu: Poisson's ratio, -1 < ν < 0.5.
        cohesion: Cohesion c (Pa), not negative; may be zero if there is friction.
        friction_angle: φ (degrees), from 0 to 89.
        dilation_angle: ψ (degrees), from 0 to the smaller friction angle.
        residual_cohesion: Cohesion to which c tends (Pa); by default c does not change.
        residual_friction_angle: Angle to which φ tends (degrees); by default φ does not change.
        rate: Rate of this change by α; positive if residual values differ.

    Raises:
        ParameterError: A parameter is outside its range, the dilation angle exceeds a
            friction angle, there is neither cohesion nor friction, residual values have
            no rate, or the fall of strength is too steep.

    Triaxial compression without cohesion: the stresses at yield differ by tan²(45° + φ/2):

    >>> import dolfinmpm as mpm
    >>> law = mpm.materials.MohrCoulomb(E=2e6, nu=0.25, cohesion=0.0, friction_angle=30.0)
    >>> s = law.respond([[0.0, 0.0, -9e-3]]).stress[0]
    >>> round(float(s[2] / s[0]), 6)
    3.0
    """

    parameters = ELASTIC | {
        "cohesion": Parameter("Pa", low=0.0, high=1e300, closed=True),
        "friction_angle": Parameter("degrees", low=0.0, high=89.0, closed=True),
        "dilation_angle": Parameter("degrees", low=0.0, high=89.0, closed=True),
        "residual_cohesion": Parameter("Pa", low=0.0, high=1e300, closed=True),
        "residual_friction_angle": Parameter("degrees", low=0.0, high=89.0, closed=True),
        "rate": Parameter("", low=0.0, closed=True),
    }
    internal = {"plastic_strain": ("", 0.0)}
    kernel = _mohrcoulomb
    strengths = ("cohesion", "residual_cohesion")
    friction_angles = ("friction_angle", "residual_friction_angle")

    def __init__(
        self,
        E: Value,
        nu: Value,
        cohesion: Value,
        friction_angle: Value,
        *,
        dilation_angle: Value = 0.0,
        residual_cohesion: Value | None = None,
        residual_friction_angle: Value | None = None,
        rate: Value = 0.0,
    ):
        if residual_cohesion is None and residual_friction_angle is None:
            self._refuse_rate(rate, "residual_cohesion or residual_friction_angle")
        super().__init__(
            E=E,
            nu=nu,
            cohesion=cohesion,
            friction_angle=friction_angle,
            dilation_angle=dilation_angle,
            residual_cohesion=cohesion if residual_cohesion is None else residual_cohesion,
            residual_friction_angle=(
                friction_angle if residual_friction_angle is None else residual_friction_angle
            ),
            rate=rate,
        )

    def admissible(self, values: dict[str, Array]) -> None:
        """Raise ParameterError where parameters contradict each other; see the class."""
        name = type(self).__name__
        c, phi, psi = values["cohesion"], values["friction_angle"], values["dilation_angle"]
        last_c, last_phi = values["residual_cohesion"], values["residual_friction_angle"]
        self._warn_of_radians(values)
        smaller = np.minimum(phi, last_phi)
        if (psi > smaller).any():
            worst = np.argmax(psi - smaller)
            raise ParameterError(
                f"{name}: dilation_angle = {psi[worst]:g} degrees must not exceed the friction "
                f"angle, {smaller[worst]:g} degrees"
            )
        if (((c == 0.0) & (phi == 0.0)) | ((last_c == 0.0) & (last_phi == 0.0))).any():
            raise ParameterError(f"{name}: without friction the cohesion must be positive")
        pairs = (("cohesion", "residual_cohesion"), ("friction_angle", "residual_friction_angle"))
        self._check_rate(values, pairs)
        nu = values["nu"]
        mu = 0.5 * values["E"] / (1.0 + nu)
        lmbda = 2.0 * mu * nu / (1.0 - 2.0 * nu)
        s, s_flow = np.sin(np.radians(phi)), np.sin(np.radians(psi))
        up, down = 1.0 + s_flow, 1.0 - s_flow
        fall = np.where(phi == last_phi, values["rate"] * (c - last_c), 0.0)
        for first, third in ((1.0, 1.0), (0.5, 1.0), (1.0, 0.5)):
            flow = np.sqrt(first * up**2 + third * down**2)
            stiff = 4.0 * lmbda * s * s_flow
            stiff += 2.0 * mu * (first * (1.0 + s) * up + third * (1.0 - s) * down)
            limit = stiff / (2.0 * np.cos(np.radians(phi)) * _ROOT * flow)
            self._bound_softening("the cohesion", fall, limit)

    def yield_function(self, stress: Array, internal: Array, parameters: Array) -> Array:
        """Yield function f of principal Kirchhoff stresses (Pa), shape (n,)."""
        _, _, c, phi, _, last_c, last_phi, rate = parameters.T
        left = np.exp(-rate * internal[:, 0])
        c, phi = last_c + (c - last_c) * left, np.radians(last_phi + (phi - last_phi) * left)
        high, low = stress.max(axis=1), stress.min(axis=1)
        return high - low + (high + low) * np.sin(phi) - 2.0 * c * np.cos(phi)
