"""NorSand: critical state plasticity of sand with a state parameter."""

from __future__ import annotations

import math

import numba
import numpy as np
import numpy.typing as npt

from dolfinmpm.materials.lawkernel import law_kernel
from dolfinmpm.materials.lodeangle import lode_ratio, lode_ratios, lode_slopes
from dolfinmpm.materials.parametrised import Parameter, Value
from dolfinmpm.materials.pressureelasticity import (
    PRESSURE_ELASTIC,
    PressureElastic,
    elastic_tangent,
    meridian_tangent,
)

__all__ = ["NorSand"]

Array = npt.NDArray[np.float64]

# Pressure (Pa) at which the critical void ratio is given, as published parameters have it
_UNIT = 1e3
# States beyond the yield surface by less than this (q/p) have the elastic tangent, as in Cam-Clay
_TIE = 1e-11
_ITERATIONS = 100
# Residual of the yield surface (q/p) above which a short step is no solution
_SMALL = 1e-8
_DENSEST = 0.05


@numba.njit(cache=True, error_model="numpy")
def _dilatancy(place, M, N):
    """D = −Δε_v^p/Δε_s^p at ln(p/p_i), and its derivative; η = M − (1 − N) D."""
    if N == 0.0:
        return M * place, M
    power = N / (1.0 - N)
    return M * math.expm1(power * place) / N, M / (1.0 - N) * math.exp(power * place)


@numba.njit(cache=True, error_model="numpy")
def _limit(psi, M, N, chi):
    """ln(p_i*/p) at which the dilatancy D is χ ψ_i, and its derivative by ψ_i.

    No η has the dilatancy of sand with 1 + N χ ψ_i/M ≤ 0. Below _DENSEST the tangent goes on.
    """
    if N == 0.0:
        return -chi * psi / M, -chi / M
    z, power = 1.0 + N * chi * psi / M, (1.0 - N) / N
    kept = max(z, _DENSEST)
    slope = -power / kept
    return -power * math.log(kept) + slope * (z - kept), slope * N * chi / M


@numba.njit(cache=True, error_model="numpy")
def _flow(gamma, shear, place, trial, last, specific, parameters):
    """The state under a given plastic shear strain Δγ and elastic shear strain.

    The place ℓ = ln(p/p_i) gives D, the flow rule ε_v = ε_v^tr + Δγ D gives p, and so p_i. Left is
    p_i (1 + h Δγ) = p_in + h Δγ p_i*. The difference of the logarithms of both sides falls with ℓ,
    by more than ℓ grows: so a first place and its residual bracket the only solution.

    Returns:
        Whether it was found; ℓ, ε_v, ln X, ln p, D, ∂D/∂ℓ, p_i*/p_i, and the derivative of
        ln(p_i*/p) by ψ_i.
    """
    swelling, alpha, M, N = parameters[0], parameters[2], parameters[5], parameters[6]
    chi, h, gamma_e, slope = parameters[7], parameters[8], parameters[9], parameters[10]
    grown = math.log1p(1.5 * alpha / swelling * shear * shear)
    first = math.log(parameters[3]) + parameters[4] / swelling
    low, high = -math.inf, math.inf
    volume = y = lp = D = dD = limit = dlimit = 0.0
    good = False
    for k in range(_ITERATIONS):
        D, dD = _dilatancy(place, M, N)
        volume = trial + gamma * D
        y = first - volume / swelling
        lp = y + grown
        log_pi = lp - place
        psi = specific - 1.0 - gamma_e + slope * (log_pi - math.log(_UNIT))
        limit, dlimit = _limit(psi, M, N, chi)
        if good:
            break
        target = lp + limit
        shift = max(last, target)
        own, wanted = math.exp(last - shift), h * gamma * math.exp(target - shift)
        residual = log_pi - shift - math.log((own + wanted) / (1.0 + h * gamma))
        if not math.isfinite(residual):
            break
        share, turn = wanted / (own + wanted), -gamma * dD / swelling
        falls = (turn - 1.0) * (1.0 - share * slope * dlimit) - share * turn
        if residual > 0.0:
            low, high = place, min(high, place + residual)
        else:
            high, low = place, max(low, place + residual)
        following = place - residual / falls
        good = abs(following - place) <= 1e-9  # the next correction is rounding
        if not good and k > 6 and k % 2 == 0:
            following = 0.5 * (low + high)
        place = following
    return good, place, volume, y, lp, D, dD, math.exp(place + limit), dlimit


@numba.njit(cache=True, error_model="numpy")
def _slopes(gamma, shear, tip, state, last, specific, angle, parameters):
    """Residual of the yield surface, its total derivative by Δγ, and derivatives by the trial.

    Args:
        tip: Whether the stress stays at the tip q = 0, where ε_sᵉ = 0.
        state: Result of `_flow`.
        angle: Ratio of q on the surface to that in compression.

    Returns:
        Residual and derivative; then the derivatives of ε_vᵉ by the volume strain and the shear
        strain of the trial and by `angle`, and those of Δγ.
    """
    _, place, _, y, lp, D, dD, G, dlimit = state
    swelling, mu0, alpha = parameters[0], parameters[1], parameters[2]
    M, N, h, slope = parameters[5], parameters[6], parameters[8], parameters[10]
    A = 1.5 * alpha / swelling
    X, p = math.exp(y), math.exp(lp)
    modulus = 3.0 * (mu0 + alpha * X)
    Lv = -1.0 / swelling
    Ls = 0.0 if tip else 2.0 * A * shear / (1.0 + A * shear * shear)
    e_v, e_s = 1.0 - gamma * dD * Lv, -gamma * dD * Ls
    h_v, h_s = -h * gamma * G * Lv, -h * gamma * G * Ls
    E = math.exp(last - lp + place)
    e_a, h_a = gamma * dD, E + h * gamma * G * (1.0 - slope * dlimit)
    if tip:
        residual = place - (1.0 if N == 0.0 else -math.log(1.0 - N) * (1.0 - N) / N)
        f_v, f_s, f_a, f_m = Lv, 0.0, -1.0, 0.0
    else:
        p *= angle
        ratio = modulus * shear / p
        residual = ratio - M + (1.0 - N) * D
        bend = (1.0 - N) * dD
        f_v = -3.0 * alpha * X * shear / (swelling * p) + (bend - ratio) * Lv
        f_s = modulus / p + (bend - ratio) * Ls
        f_a, f_m = -bend, -ratio / angle
    det = e_v * h_a - e_a * h_v
    e_g, h_g = -D - e_s, -h * (G - 1.0) - h_s
    v_g, a_g = -(e_g * h_a - e_a * h_g) / det, -(e_v * h_g - e_g * h_v) / det
    slope_g = -f_s + f_v * v_g + f_a * a_g
    h_t = -h * gamma * G * dlimit * specific
    v_t, a_t = -(-h_a - e_a * h_t) / det, -(e_v * h_t + h_v) / det
    v_s, a_s = -(e_s * h_a - e_a * h_s) / det, -(e_v * h_s - e_s * h_v) / det
    g_t = -(f_v * v_t + f_a * a_t) / slope_g
    g_s = -(f_s + f_v * v_s + f_a * a_s) / slope_g
    g_m = -f_m / slope_g
    by_volume = (v_t + v_g * g_t, v_s + v_g * g_s, v_g * g_m)
    return residual, slope_g, by_volume, (g_t, g_s, g_m)


@numba.njit(cache=True, error_model="numpy")
def _return(trial, shear_trial, place, last, specific, angle, parameters):
    """Plastic shear strain Δγ, whether at the tip, and the state; a bracket holds the root.

    Where the plastic shear strain would pass the trial shear strain, the stress is the tip q = 0
    of the yield surface. Flow in several directions then adds up to the deviator of the trial
    strain and less: Δγ is the sum (Koiter's rule).
    """
    low, high, gamma, tip = 0.0, shear_trial, 0.0, False
    found = _flow(shear_trial, 0.0, place, trial, last, specific, parameters)
    if not found[0]:
        return False, gamma, tip, found
    if (1.0 - parameters[6]) * found[5] >= parameters[5]:  # η ≤ 0
        tip, gamma, low, high = True, shear_trial, shear_trial, math.inf
        place = found[1]
    for k in range(_ITERATIONS):
        shear = 0.0 if tip else shear_trial - gamma
        found = _flow(gamma, shear, place, trial, last, specific, parameters)
        if not found[0]:
            break
        place = found[1]
        residual, slope, _, _ = _slopes(gamma, shear, tip, found, last, specific, angle, parameters)
        if residual > 0.0:
            low = gamma
        else:
            high = gamma
        following = gamma - residual / slope
        # a short step alone is no solution: far beyond the surface hardening has a huge slope
        short = abs(following - gamma) <= 1e-15 * max(gamma, shear_trial)
        if residual == 0.0 or (short and abs(residual) <= _SMALL):
            return True, gamma, tip, found
        if high == math.inf:
            if not following > gamma or following > 2.0 * gamma + 1e-3:
                following = 2.0 * gamma + 1e-3
        elif not low < following < high or (k > 12 and k % 3 == 0):
            following = 0.5 * (low + high)
            if high - low <= 4e-16 * high:
                return True, gamma, tip, found
        gamma = following
    return False, gamma, tip, found


@law_kernel
def _norsand(parameters, strain, old, new, stress, tangent):
    swelling, mu0, alpha = parameters[0], parameters[1], parameters[2]
    M, N = parameters[5], parameters[6]
    trial = strain[0] + strain[1] + strain[2]
    mean = trial / 3.0
    e = (strain[0] - mean, strain[1] - mean, strain[2] - mean)
    norm = math.sqrt(e[0] * e[0] + e[1] * e[1] + e[2] * e[2])
    if not (math.isfinite(norm) and math.isfinite(trial) and old[0] > 0.0):
        return 1
    shear_trial = math.sqrt(2.0 / 3.0) * norm
    n = (0.0, 0.0, 0.0)
    if shear_trial > 0.0:
        n = (e[0] / norm, e[1] / norm, e[2] / norm)
    # stress keeps the direction of the trial deviator, which is known before the return
    angle, by_z, z = lode_ratio(n, parameters[13])
    last = math.log(old[0])
    specific = (1.0 + old[2]) * math.exp(trial - parameters[4])
    X = parameters[3] * math.exp((parameters[4] - trial) / swelling)
    p = X * (1.0 + 1.5 * alpha / swelling * shear_trial * shear_trial)
    mu = mu0 + alpha * X
    coupling = 2.0 * alpha * X / swelling
    f, place = -1.0, math.log(p) - last
    if old[0] < math.inf:
        D, _ = _dilatancy(place, M, N)
        f = 3.0 * mu * shear_trial / (p * angle) - M + (1.0 - N) * D
    if not (f < math.inf and 0.0 < p < math.inf):
        return 1
    if f <= 0.0:
        new[0], new[1], new[2] = old[0], specific - 1.0, old[2]
        for i in range(3):
            stress[i] = -p + 2.0 * mu * e[i]
        elastic_tangent(p / swelling, mu, coupling, e, tangent)
        return 0
    if not specific > 1.0:
        return 1

    good, gamma, tip, found = _return(trial, shear_trial, place, last, specific, angle, parameters)
    if not good:
        return 1
    _, place, volume, y, lp, _, _, _, _ = found
    shear = 0.0 if tip else shear_trial - gamma
    _, _, dv, dg = _slopes(gamma, shear, tip, found, last, specific, angle, parameters)
    X1, p1 = math.exp(y), math.exp(lp)
    modulus = 3.0 * (mu0 + alpha * X1)
    q = modulus * shear
    ds = (0.0, 0.0, 0.0) if tip else (-dg[0], 1.0 - dg[1], -dg[2])
    cross = 3.0 * alpha * X1 * shear / swelling
    E11, E12 = p1 / swelling * dv[0] - cross * ds[0], p1 / swelling * dv[1] - cross * ds[1]
    E21, E22 = modulus * ds[0] - cross * dv[0], modulus * ds[1] - cross * dv[1]
    if not (math.isfinite(E11 + E12 + E21 + E22) and 0.0 < p1 < math.inf):
        return 1
    meridian_tangent(E11, E12, E21, E22, q, shear_trial, n, tangent)
    two = math.sqrt(2.0 / 3.0)
    if by_z > 0.0 and norm > 0.0:
        by_p = p1 / swelling * dv[2] - cross * ds[2]
        by_q = two * (modulus * ds[2] - cross * dv[2])
        slopes = lode_slopes(n, z, norm)
        for j in range(3):
            for i in range(3):
                tangent[3 * i + j] += (by_p + by_q * n[i]) * by_z * slopes[j]
    for i in range(3):
        stress[i] = -p1 + two * q * n[i]
        strain[i] = volume / 3.0 + shear * n[i] / two
    if f <= _TIE:
        elastic_tangent(p / swelling, mu, coupling, e, tangent)
    new[0], new[1] = math.exp(lp - place), specific - 1.0
    new[2] = (1.0 + old[2]) * math.exp(trial - volume) - 1.0
    return 0


class NorSand(PressureElastic):
    """NorSand over the hyperelasticity of Borja and Tamagnini.

    With p = −tr(τ)/3 > 0 in compression, q = √(3/2) |dev τ|, η = q/p, and the specific volume
    v = 1 + e, which all volume strain changes:

    - elasticity as in `CamClay`;
    - f = q − η(p) p with η = M [1 − (1 − N) (p/p_i)^(N/(1−N))]/N, and M [1 + ln(p_i/p)] for N = 0.
      The flow is associated. So D = −dε_vᵖ/dε_sᵖ = (M − η)/(1 − N): the critical state is η = M;
    - e_c(p) = Γ − λ ln(p / 1 kPa) is the critical void ratio, ψ_i = e − e_c(p_i) the state
      parameter. The most negative dilatancy is χ ψ_i. It belongs to the image pressure p_i*;
    - dp_i = h (p_i* − p_i) dε_sᵖ, by the implicit rule of Euler. So p_i hardens or softens until
      the critical state, in which p = p_i = p_i* and e = e_c(p).

    See Jefferies & Been, Soil Liquefaction (2015), and Borja & Andrade (2006), Critical state
    plasticity, Part VI, Computer Methods in Applied Mechanics and Engineering 195, whose law this
    is with equal N for yield surface and flow. In other directions than triaxial
    compression, η is smaller by the ratio of Sheng, Sloan & Yu (2000). D then belongs to η over
    this ratio, and the flow has the direction of the stress deviator. Without shear the stress
    is at the tip of f, and Δγ is the sum of the flow in all directions.

    Internal variables: `image_pressure` p_i (Pa); `void_ratio` e; `reference_void_ratio`, the
    void ratio after unloading to the reference pressure. First values: `image_pressure`, and
    `void_ratio` for both.

    Args:
        swelling: Slope κ̂ of unloading, −dε_v/d ln p, positive, as in `CamClay`.
        M: Critical stress ratio q/p in triaxial compression, positive.
        N: Shape of f, 0 ≤ N < 1; 0 to 0.5 for sands.
        chi: Dilatancy per state parameter χ, positive; some 2.5 to 4.5.
        hardening: h, positive; some 50 to 500.
        critical_void_ratio: Γ, e of the critical state at 1 kPa, positive.
        critical_slope: λ, by the natural logarithm; not negative.
        void_ratio: First void ratio e at the reference pressure, positive.
        image_pressure: First p_i (Pa), positive. A stress on the surface without shear has
            p_i = p/2.718 for N = 0, and p (1 − N)^((1−N)/N) else.
        extension: M in triaxial extension by M, 0.6 to 1; Mohr and Coulomb have 3/(3 + M).
        mu0, alpha, reference_pressure, reference_strain: As in `CamClay`.

    Raises:
        ParameterError: A parameter is outside its range or contradicts another.

    Dense sand has a peak and dilates:

    >>> import dolfinmpm as mpm
    >>> slopes = {"critical_void_ratio": 0.82, "critical_slope": 0.03}
    >>> law = mpm.materials.NorSand(
    ...     swelling=0.005, mu0=20e6, alpha=0.0, reference_pressure=100e3, M=1.25, N=0.2, chi=3.5,
    ...     hardening=150.0, **slopes, void_ratio=0.65, image_pressure=50e3)
    >>> test = mpm.study.element_test(law, "triaxial", -0.2, pressure=100e3, strain="small")
    >>> bool(test["q"].max() > 1.04 * test["q"][-1]), bool(test["void_ratio"][-1] > 0.65)
    (True, True)
    """

    parameters = PRESSURE_ELASTIC | {
        "M": Parameter("", low=0.0, high=3.0),
        "N": Parameter("", low=0.0, high=0.95, closed=True),
        "chi": Parameter("", low=0.0),
        "hardening": Parameter("", low=0.0),
        "critical_void_ratio": Parameter("", low=0.0, high=10.0),
        "critical_slope": Parameter("", low=0.0, closed=True),
        "void_ratio": Parameter("", low=0.0, high=10.0),
        "image_pressure": Parameter("Pa", low=0.0),
        "extension": Parameter("", low=0.6, high=1.0, closed=True),
    }
    internal = {
        "image_pressure": ("Pa", "image_pressure"),
        "void_ratio": ("", "void_ratio"),
        "reference_void_ratio": ("", "void_ratio"),
    }
    derived = ("void_ratio",)
    kernel = _norsand

    def __init__(
        self, *, swelling: Value, M: Value, N: Value = 0.0, chi: Value, hardening: Value,
        critical_void_ratio: Value, critical_slope: Value, void_ratio: Value,
        image_pressure: Value, mu0: Value, alpha: Value, reference_pressure: Value,
        reference_strain: Value = 0.0, extension: Value = 1.0,
    ):  # fmt: skip
        super().__init__(
            swelling=swelling, M=M, N=N, chi=chi, hardening=hardening, void_ratio=void_ratio,
            critical_void_ratio=critical_void_ratio, critical_slope=critical_slope,
            image_pressure=image_pressure, mu0=mu0, alpha=alpha, extension=extension,
            reference_pressure=reference_pressure, reference_strain=reference_strain,
        )  # fmt: skip

    def admissible(self, values: dict[str, Array]) -> None:
        """Raise ParameterError where parameters contradict each other."""
        tip = _tip(values["N"]) * values["image_pressure"]
        advice = "; give a larger image_pressure"
        self._check_start(values, "the tip", tip, advice=advice)

    def yield_function(self, stress: Array, internal: Array, parameters: Array) -> Array:
        """f = q − η p (Pa), shape (n,); see `Law.yield_function`."""
        M, N, extension = (
            parameters[:, list(self.parameters).index(name)] for name in ("M", "N", "extension")
        )
        mean = -stress.mean(axis=1)
        s = stress + mean[:, None]
        q = np.sqrt(1.5 * (s**2).sum(axis=1))
        angle = lode_ratios(s, extension)
        with np.errstate(invalid="ignore", divide="ignore"):
            place = np.log(mean / internal[:, 0])
            power = N / (1.0 - N)
            D = M * np.where(N > 0.0, np.expm1(power * place) / N, place)
        return np.where(mean > 0.0, q - angle * (M - (1.0 - N) * D) * mean, q - mean)


def _tip(N: Array) -> Array:
    """p/p_i at the tip q = 0 of the yield surface, shape of N."""
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(N > 0.0, (1.0 - N) ** ((N - 1.0) / N), math.e)
