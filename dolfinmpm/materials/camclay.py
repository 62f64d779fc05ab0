"""Modified Cam-Clay over the hyperelasticity of Borja and Tamagnini."""

from __future__ import annotations

import math

import numba
import numpy as np
import numpy.typing as npt

from dolfinmpm.materials.lawkernel import law_kernel
from dolfinmpm.materials.parametrised import Parameter, Value
from dolfinmpm.materials.pressureelasticity import (
    PressureElastic,
    elastic_tangent,
    meridian_tangent,
)

__all__ = ["CamClay"]

Array = npt.NDArray[np.float64]
_ITERATIONS = 200  # usually a few; bisection alone needs 60 and more
# States beyond the yield surface by less than this (f by pc²) have the elastic tangent. At the
# start of a step rounding alone would otherwise choose the plastic tangent at some yielded points.
# Where a step has several solutions, this choice could lead Newton's method to another solution.
_TIE = 1e-11


@numba.njit(cache=True, error_model="numpy")
def _on_surface(t, z_trial, y_trial, shear_trial, swelling, compression, M, mu0, alpha):
    """The stress at the place t of the yield surface, and the residual of the flow rule.

    All follows from z = t² = ln(pc/X), with X = |p0| e^Ω. The value z gives the elastic volume
    change, and this gives pc. Then f = 0 is a quadratic equation in (ε_sᵉ)² with one root that is
    not negative. So f = 0 holds by construction, and the flow rule is the only equation left.
    Derivatives by t stay finite at the tip q = 0; derivatives by z do not.

    Returns:
        Residual and its derivative by t; ε_sᵉ, X/pc, p/pc, q/(M pc), 3μ/(M pc), the plastic
        compression and ln pc, with p and pc positive.
    """
    z = t * t
    x, below = math.exp(-z), -math.expm1(-z)  # X/pc and 1 − X/pc
    # names that begin with d are derivatives by z
    dy = swelling / compression - 1.0
    dplastic = -swelling * dy
    plastic = dplastic * (z - z_trial)
    y = y_trial + dy * (z - z_trial)  # ln X
    ax = alpha * x
    m = 3.0 * (mu0 * math.exp(-y - z) + ax) / M
    dm = 3.0 * ax * dy / M - m * swelling / compression
    a = 1.5 * alpha / swelling
    # f = 0: x²a² ε² + b ε − x(1 − x) = 0 for ε = (ε_sᵉ)². Over `size`, as m² can be huge
    size = m * m + a
    square = (x * a / size) ** 2
    b = (m * m + a * x * (2.0 * x - 1.0)) / size
    discriminant_root = math.sqrt(b * b + 4.0 * square * x * below)
    eps = (
        2.0 * x * below / (b + discriminant_root)
        if b >= 0.0
        else (discriminant_root - b) / (2.0 * square)
    ) / size
    db = 2.0 * m * dm - a * x * (4.0 * x - 1.0)
    deps = (2.0 * (x * a * eps) ** 2 - db * eps - x * (1.0 - 2.0 * x)) / (discriminant_root * size)
    shear = math.sqrt(eps)
    dshear = 0.5 * deps / shear
    g = x * (1.0 + a * eps)
    dg = -g + x * a * deps
    h = m * shear
    dh = dm * shear + m * dshear
    gap = shear_trial - shear
    residual = gap * (2.0 * g - 1.0) - 2.0 * plastic * h / M
    slope = 2.0 * gap * dg - dshear * (2.0 * g - 1.0) - 2.0 * (dplastic * h + plastic * dh) / M
    return residual, 2.0 * t * slope, shear, x, g, h, m, plastic, y + z


@numba.njit(cache=True, error_model="numpy")
def _place(z_trial, y_trial, shear_trial, swelling, compression, M, mu0, alpha):
    """The place t of the yield surface to which the trial strain returns, or NaN.

    The residual is positive towards the tip and negative away from it. At t² = z_trial the plastic
    volume change is zero, and the residual has the sign of 2p − pc. The root lies between this
    place and the critical state, on the wet side (`wet`, 2p > pc) or on the dry side. Beyond the
    critical state, or where ε_sᵉ exceeds the trial value, the residual can vanish again with a
    negative multiplier. Such places only narrow the bracket.
    """
    low, high = 0.0, math.inf
    wet = True
    if z_trial > 0.0:
        t = math.sqrt(z_trial)
    else:
        # the residual is linear in t near the tip
        m = 3.0 * (mu0 * math.exp(-y_trial + z_trial * (swelling / compression - 1.0)) + alpha) / M
        plastic = z_trial * (swelling / compression - 1.0) * swelling
        shear = shear_trial / (1.0 + 2.0 * plastic * m / M)
        t = min(shear * math.sqrt(m * m + 1.5 * alpha / swelling), 0.5)
    for k in range(_ITERATIONS):
        residual, slope, shear, _, g, _, _, _, _ = _on_surface(
            t, z_trial, y_trial, shear_trial, swelling, compression, M, mu0, alpha
        )
        valid = shear < shear_trial
        if k == 0 and z_trial > 0.0:
            if not valid:  # by rounding only: the trial state is on the surface
                return t
            wet = g >= 0.5
        valid = valid and (g > 0.5) == wet
        if residual == 0.0 and (valid or g == 0.5):
            return t
        if (valid and residual > 0.0) or (not valid and not wet):
            low = t
        else:
            high = t
        following = t - residual / slope
        if valid and abs(following - t) <= 1e-10 * t:
            return following
        if high == math.inf:
            # also where the slope points back
            following = min(following, 2.0 * t + 0.5) if following > t else 2.0 * t + 0.5
        elif not (valid and low < following < high) or (k > 12 and k % 3 == 0):
            following = 0.5 * (low + high)
            if high - low <= 4e-16 * high:
                return following
        t = following
    return math.nan


@law_kernel
def _cam_clay(parameters, strain, old, new, stress, tangent):
    swelling, compression, M = parameters[0], parameters[1], parameters[2]
    mu0, alpha = parameters[3], parameters[4]
    pc = old[0]
    volume = strain[0] + strain[1] + strain[2]
    mean = volume / 3.0
    e = (strain[0] - mean, strain[1] - mean, strain[2] - mean)
    norm = math.sqrt(e[0] * e[0] + e[1] * e[1] + e[2] * e[2])
    if not (math.isfinite(norm) and math.isfinite(volume) and pc > 0.0):
        return 1
    shear_trial = math.sqrt(2.0 / 3.0) * norm
    y_trial = math.log(parameters[5]) - (volume - parameters[6]) / swelling
    z_trial = math.log(pc) - y_trial
    tie, mu, p, coupling = False, 0.0, 0.0, 0.0
    if z_trial >= -_TIE:  # rounded, at the tip
        X = math.exp(y_trial)
        mu = mu0 + alpha * X
        p = X * (1.0 + 1.5 * alpha / swelling * shear_trial * shear_trial)
        ratio = 3.0 * mu * shear_trial / M
        coupling = 2.0 * alpha * X / swelling
        f = ratio * ratio + p * (p - pc)
        if f <= 0.0:
            if p <= 0.0:  # too small for a double
                return 1
            new[0] = pc
            for i in range(3):
                stress[i] = -p + 2.0 * mu * e[i]
            elastic_tangent(p / swelling, mu, coupling, e, tangent)
            return 0
        tie = f <= _TIE * pc * pc
    bulk = p / swelling

    t = 0.0
    if shear_trial > 0.0:
        t = _place(z_trial, y_trial, shear_trial, swelling, compression, M, mu0, alpha)
    _, _, shear, x, g, h, m, plastic, log_pc = _on_surface(
        t, z_trial, y_trial, shear_trial, swelling, compression, M, mu0, alpha
    )
    pc = math.exp(log_pc)
    # Multiplier times pc, by the normal (2g − 1, 2h), which is a unit vector
    normal, across = 2.0 * g - 1.0, 2.0 * h
    flow = plastic * normal + M * (shear_trial - shear) * across
    across /= M

    # Derivatives of (ε_vᵉ, ε_sᵉ) by the trial strains, all stresses over pc
    rate = 1.0 / (compression - swelling)
    D11 = g / swelling
    D12 = -3.0 * alpha * x * shear / swelling
    D22 = M * m
    # the flow rule, with the multiplier eliminated from its two equations
    A1 = (1.0 + flow * (2.0 * D11 + rate)) * across + 2.0 * flow * D12 / (M * M) * normal
    A2 = 2.0 * flow * D12 * across + (1.0 + 2.0 * flow * D22 / (M * M)) * normal
    # f = 0
    B1 = across * D12 - normal * D11 - g * rate
    B2 = across * D22 - normal * D12
    determinant = A1 * B2 - A2 * B1
    right1, right2 = (1.0 + flow * rate) * across, -g * rate
    v_v = (right1 * B2 - A2 * right2) / determinant
    s_v = (A1 * right2 - B1 * right1) / determinant
    v_s = normal * B2 / determinant
    s_s = -B1 * normal / determinant
    E11, E12 = pc * (D11 * v_v + D12 * s_v), pc * (D11 * v_s + D12 * s_s)
    E21, E22 = pc * (D12 * v_v + D22 * s_v), pc * (D12 * v_s + D22 * s_s)
    p, q = pc * g, pc * M * h
    if not (math.isfinite(E11 + E12 + E21 + E22) and math.isfinite(p + q) and p > 0.0):
        return 1

    n = (0.0, 0.0, 0.0)
    if shear_trial > 0.0:
        n = (e[0] / norm, e[1] / norm, e[2] / norm)
    meridian_tangent(E11, E12, E21, E22, q, shear_trial, n, tangent)
    two = math.sqrt(2.0 / 3.0)
    volume += plastic
    for i in range(3):
        stress[i] = -p + two * q * n[i]
        strain[i] = volume / 3.0 + shear * n[i] / two
    if tie:
        elastic_tangent(bulk, mu, coupling, e, tangent)
    new[0] = pc
    return 0


class CamClay(PressureElastic):
    """Modified Cam-Clay over the hyperelasticity of Borja and Tamagnini.

    With p = tr(τ)/3 < 0 in compression, q = √(3/2) |dev τ|, ε_v = tr ε, ε_s = √(2/3) |dev ε| of
    the elastic logarithmic strain, and p0 = −reference_pressure:

    - p = p0 e^Ω (1 + 3α ε_s²/(2κ̂)) and q = 3(μ0 − α p0 e^Ω) ε_s, with Ω = −(ε_v − ε_v0)/κ̂: the
      derivatives of the energy Ψ = −p0 κ̂ e^Ω + 3/2 (μ0 − α p0 e^Ω) ε_s²;
    - f = (q/M)² + p (p − pc), with associated flow;
    - pc hardens by pc = pc_n exp[−Δε_vᵖ/(λ̂ − κ̂)], with Δε_vᵖ the plastic volume change of a step.

    See Borja & Tamagnini (1998), Cam-Clay plasticity, Part III, Computer Methods in Applied
    Mechanics and Engineering 155. The local equations are reduced to one scalar equation for
    the place on the yield surface, with a bracket that holds a root for every trial strain;
    f = 0 is met to rounding whatever the strain.

    Without strain p is p0 e^(ε_v0/κ̂), hence p0 for ε_v0 = 0: points start under pressure. The
    pressure never vanishes: no strain reaches tension. With α > 0 the ratio q/|p| of elastic
    states has a bound, √(3ακ̂/2) for μ0 = 0. Beyond this bound the energy is not convex. So choose
    α with a bound above M.

    Internal variables: `preconsolidation_pressure` |pc| (Pa), positive. Its first value is the
    parameter `preconsolidation`.

    Args:
        swelling: Slope κ̂ of unloading, −dε_v/d ln |p|, positive. Here p is the pressure of the
            Kirchhoff stress. A slope κ̃ of ln(specific volume) by ln |Cauchy pressure| gives
            κ̂ = κ̃/(1 − κ̃).
        compression: Slope λ̂ of isotropic virgin compression, in the same sense; κ̂ < λ̂.
        M: Slope of the critical state line, q = M |p|, positive.
        mu0: Constant part μ0 of the shear modulus (Pa), not negative.
        alpha: Part α of the shear modulus that grows with pressure, not negative; μ0 and α
            must not both be 0.
        reference_pressure: |p0| (Pa), positive: compression as a positive number.
        preconsolidation: First |pc| (Pa), positive, at least the pressure without strain.
        reference_strain: Elastic volume strain ε_v0 at which p = p0 without shear.

    Raises:
        ParameterError: A parameter is outside its range or contradicts another.

    In virgin compression the preconsolidation pressure is the pressure:

    >>> import dolfinmpm as mpm
    >>> start = {"reference_pressure": 50e3, "preconsolidation": 50e3}
    >>> slopes = {"swelling": 0.02, "compression": 0.1, "M": 1.2}
    >>> law = mpm.materials.CamClay(**slopes, mu0=1e6, alpha=0.0, **start)
    >>> end = law.respond([[-0.01, -0.01, -0.01]])
    >>> end.stress[0].round().tolist(), end.internal.round().tolist()
    ([-67493.0, -67493.0, -67493.0], [[67493.0]])
    """

    parameters = {
        # the softest clays have slopes of some 0.5
        "swelling": Parameter("", low=0.0, high=1.0),
        "compression": Parameter("", low=0.0, high=1.0),
        "M": Parameter("", low=0.0, high=3.0),
        "mu0": Parameter("Pa", low=0.0, closed=True),
        "alpha": Parameter("", low=0.0, closed=True),
        "reference_pressure": Parameter("Pa", low=0.0),
        "reference_strain": Parameter(""),
        "preconsolidation": Parameter("Pa", low=0.0),
    }
    internal = {"preconsolidation_pressure": ("Pa", "preconsolidation")}
    kernel = _cam_clay
    _without_strength = (
        "has no strength to divide. Give its undrained strength in the present state to "
        "mpm.materials.Tresca(E, nu, cohesion=...), one value for each point, in a problem of a "
        "body of its own under the same total stress: in plane strain M/√3 p (pc/(2 p))^(1 − "
        "swelling/compression), with the effective pressure p and the points' "
        "preconsolidation_pressure pc. The how-to on factors of safety has the lines"
    )

    def __init__(
        self,
        *,
        swelling: Value,
        compression: Value,
        M: Value,
        mu0: Value,
        alpha: Value,
        reference_pressure: Value,
        preconsolidation: Value,
        reference_strain: Value = 0.0,
    ):
        super().__init__(
            swelling=swelling,
            compression=compression,
            M=M,
            mu0=mu0,
            alpha=alpha,
            reference_pressure=reference_pressure,
            reference_strain=reference_strain,
            preconsolidation=preconsolidation,
        )

    def admissible(self, values: dict[str, Array]) -> None:
        """Raise ParameterError where parameters contradict each other."""
        flat = values["compression"] <= values["swelling"]
        rules = [(flat, "compression", "swelling", "be larger than")]
        self._check_start(values, "preconsolidation", values["preconsolidation"], rules)

    def yield_function(self, stress: Array, internal: Array, parameters: Array) -> Array:
        """f = (q/M)² + p (p − pc) (Pa²), shape (n,); see `Law.yield_function`."""
        p = stress.mean(axis=1)
        q = np.sqrt(1.5 * ((stress - p[:, None]) ** 2).sum(axis=1))
        return (q / parameters[:, 2]) ** 2 + p * (p + internal[:, 0])
