"""Mean forces of contact over a step in time, which make no energy, and the energy of penalties.

With q = λ − ε_N g at the start and at the end of a step, the normal force p = max(0, q) stores
ψ = p²/(2ε_N). The mean over the step that conserves energy is

    p̄ = (p₁² − p₀²) / (2 (q₁ − q₀)),    n̄ · Δξ = g₁ − g₀.

Then p̄ n̄ · Δξ = −Δψ exactly (Simo & Tarnow 1992, doi 10.1007/BF00913408; Laursen & Chawla 1997,
doi 10.1002/(SICI)1097-0207(19970315)40:5<863::AID-NME92>3.0.CO;2-V). n̄ is the normal in the middle
of the path Δξ in the frame of the body, corrected along Δξ (Gonzalez 1996, doi 10.1007/BF02440162).

Friction: the tangential force t₁ at the end follows from Coulomb's return mapping under p₁. The
mean t̄ = (t₀ + t₁)/2 acts over the step. A point that sticks stores |t|²/(2ε_T). A point that slips
dissipates t̄ · Δs.

Between steps, facing contact points, gaps and areas are found anew. The penalties ½ p²/ε_N would
then store more than before, or less. Energy that they lose is spare. Energy that they would gain
beyond the spare energy is held back: all normal forces q > 0 at the start become √s q, by
multipliers λ = −(1 − √s) q in the step's potential. Then the mean force gives back only energy that
has been stored.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numba
import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm.contact.contactlaw import FREE, SHEARS, SLIPS, STICKS

__all__ = [
    "SPARE_SHARE",
    "MeanForceWeights",
    "bounding_multipliers",
    "mean_forces",
    "normal_energy",
    "slip_energy",
]


@dataclass(frozen=True)
class MeanForceWeights:
    """Weights of mean forces over a step in the balance within the step.

    Attributes:
        weight: Weight of the forces.
        scale: Increments at the end of the step divided by increments at the time of the balance.
    """

    weight: float
    scale: float


@numba.njit(cache=True, error_model="numpy")
def _mean(q0, q1):
    """p̄, and its derivative by q₁."""
    if q0 >= 0.0 and q1 >= 0.0:
        return 0.5 * (q0 + q1), 0.5
    if q1 > 0.0:
        return q1 * q1 / (2.0 * (q1 - q0)), q1 * (q1 - 2.0 * q0) / (2.0 * (q1 - q0) ** 2)
    if q0 > 0.0:
        return q0 * q0 / (2.0 * (q0 - q1)), q0 * q0 / (2.0 * (q0 - q1) ** 2)
    return 0.0, 0.0


@numba.njit(cache=True, error_model="numpy")
def mean_forces(
    first, gap, normal, middle, curvature, path, before, multiplier, normal_stiffness,
    slip_stiffness, friction, limit, water, force, tangential, normal_force, derivative, loss,
    state,
):  # fmt: skip
    """Mean forces at contact points over a step and their derivatives, in the frame of the body.

    Args:
        first, gap: g at the start and at the end (m), shape (m,).
        normal: n at the end, shape (m, d).
        middle, curvature: n and ∇n in the middle of the path, shapes (m, d), (m, d, d).
        path: Δξ (m), shape (m, d).
        before: t₀ (N), shape (m, d).
        multiplier: λ (N), shape (m,).
        normal_stiffness, slip_stiffness: ε_N and ε_T (N/m), shape (m,).
        friction: μ.
        limit, water: τ A and p_w A (N), shape (m,), see `dolfinmpm.contact.contactlaw`.
        force: Output: p̄ n̄ + t̄ (N), shape (m, d).
        tangential: Output: t₁ (N), shape (m, d).
        normal_force: Output: p₁ (N), shape (m,).
        derivative: Output: derivative of the force by ξ at the end (N/m), shape (m, d, d).
        loss: Output: work dissipated by friction (J), shape (m,).
        state: Output: FREE, STICKS, SLIPS or SHEARS, shape (m,); FREE if there is no force.
    """
    d = path.shape[1]
    along, start, w, trial = np.empty(d), np.empty(d), np.empty(d), np.empty(d)
    dn, ds = np.empty(d), np.empty(d)
    tangent = np.empty((d, d))
    for c in range(path.shape[0]):
        n, H, eN, eT = middle[c], curvature[c], normal_stiffness[c], slip_stiffness[c]
        q0, q1 = multiplier[c] - eN * first[c], multiplier[c] - eN * gap[c]
        p, dp = _mean(q0, q1)
        last = max(q1, 0.0)
        normal_force[c], loss[c], state[c] = last, 0.0, FREE
        rubbed = 0.0
        for i in range(d):
            force[c, i] = 0.0
            tangential[c, i] = 0.0
            rubbed += before[c, i] ** 2
            for j in range(d):
                derivative[c, i, j] = 0.0
        if p == 0.0 and rubbed == 0.0:
            continue
        state[c] = STICKS
        # n̄ = n + s Δξ
        size, error = 0.0, gap[c] - first[c]
        for i in range(d):
            size += path[c, i] ** 2
            error -= n[i] * path[c, i]
        s = error / size if size > 0.0 else 0.0
        for j in range(d):
            ds[j] = 0.0
            if size > 0.0:
                bent = 0.0
                for i in range(d):
                    bent += H[i, j] * path[c, i]
                ds[j] = (normal[c, j] - n[j] - 0.5 * bent - 2.0 * s * path[c, j]) / size
        for i in range(d):
            along[i] = n[i] + s * path[c, i]
        for i in range(d):
            force[c, i] = p * along[i]
            for j in range(d):
                derivative[c, i, j] = p * (0.5 * H[i, j] + path[c, i] * ds[j])
                derivative[c, i, j] -= dp * eN * along[i] * normal[c, j]
            derivative[c, i, i] += p * s
        if friction == 0.0:
            continue
        # t₀ turns with the normal, into the plane across that in the middle
        off, left = 0.0, 0.0
        for i in range(d):
            off += before[c, i] * n[i]
        for i in range(d):
            start[i] = before[c, i] - off * n[i]
            left += start[i] ** 2
        turned = math.sqrt(rubbed / left) if left > 0.0 else 0.0
        # w = t₀ − ε_T Δξ/2 is the mean of a point that sticks
        off = 0.0
        for i in range(d):
            start[i] *= turned
            w[i] = start[i] - 0.5 * eT * path[c, i]
            off += w[i] * n[i]
        size = 0.0
        for i in range(d):
            trial[i] = w[i] - off * n[i]
            size += trial[i] * trial[i]
        size = math.sqrt(size)
        for j in range(d):
            dn[j] = 0.0
            for i in range(d):
                dn[j] += w[i] * 0.5 * H[i, j]
        for i in range(d):
            for j in range(d):
                tangent[i, j] = 0.5 * (eT * n[i] * n[j] - off * H[i, j]) - n[i] * dn[j]
            tangent[i, i] -= 0.5 * eT
        share = 1.0
        bound, slope, slips = friction * (p - water[c]), friction * dp * eN, SLIPS
        if bound < 0.0:
            bound, slope = 0.0, 0.0
        if bound > limit[c]:
            bound, slope, slips = limit[c], 0.0, SHEARS
        if size > bound:
            state[c], share = slips, bound / size
        done, kept = 0.0, 0.0
        for i in range(d):
            mean = share * trial[i]
            force[c, i] += mean
            tangential[c, i] = 2.0 * mean - start[i] if last > 0.0 else 0.0
            kept += tangential[c, i] ** 2
        if state[c] >= SLIPS or last == 0.0:
            done = 0.0
            for i in range(d):
                # Δξ along the surface
                done -= share * trial[i] * 2.0 * (start[i] - trial[i]) / eT
            loss[c] = done - 0.5 * (kept - rubbed) / eT
        for j in range(d):
            by_size = 0.0
            if state[c] >= SLIPS:
                for i in range(d):
                    by_size += trial[i] * tangent[i, j]
                by_size /= size
            for i in range(d):
                change = share * tangent[i, j]
                if state[c] >= SLIPS:
                    s = trial[i] / size
                    change -= share * s * by_size + slope * normal[c, j] * s
                derivative[c, i, j] += change


Array = npt.NDArray[np.float64]

# Share of the work of friction that is spare too. So the energy held back does not add up where
# bodies slide for long.
SPARE_SHARE = 0.01


def bounding_multipliers(
    normal_force: Array, normal: float, tangential: float, available: float, comm: MPI.Intracomm
) -> Array:
    """Multipliers of a step (N), shape (m,), with the stored energy bounded. Collective.

    Args:
        normal_force: −ε_N g at the start of the step (N), shape (m,).
        normal: Energy that these normal forces store on this rank (J).
        tangential: Energy of the tangential forces at the start of the step on this rank (J).
        available: Energy stored on this rank at the end of the last step, and spare energy (J).
        comm: Communicator of the points.
    """
    q = np.maximum(normal_force, 0.0)
    sums = np.array([normal, tangential, available])
    comm.Allreduce(MPI.IN_PLACE, sums, op=MPI.SUM)
    normal, tangential, available = map(float, sums)
    if normal <= 0.0 or normal + tangential <= available:
        return np.zeros_like(q)
    share = max(available - tangential, 0.0) / normal
    return (math.sqrt(share) - 1.0) * q


def normal_energy(normal_force: Array, stiffness: Array) -> Array:
    """Energy of the normal penalties, ½ p²/ε_N (J), shape (m,); zero for tensile forces.

    Args:
        normal_force: p (N), shape (m,).
        stiffness: ε_N (N/m), shape (m,). Points with zero stiffness store nothing.
    """
    k = np.where(stiffness > 0.0, stiffness, np.inf)
    return np.asarray(0.5 * np.maximum(normal_force, 0.0) ** 2 / k)


def slip_energy(tangential: Array, stiffness: Array, slip_share: float) -> Array:
    """Energy of elastic slip, ½ |t|²/ε_T (J), shape (m,).

    Args:
        tangential: t (N), shape (m, d).
        stiffness: ε_N (N/m), shape (m,). Points with zero stiffness store nothing.
        slip_share: ε_T/ε_N.
    """
    k = np.where(stiffness > 0.0, stiffness, np.inf)
    return np.asarray(0.5 * np.sum(tangential * tangential, axis=1) / (slip_share * k))
