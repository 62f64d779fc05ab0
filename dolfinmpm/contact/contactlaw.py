"""The contact law: forces of a penalty or a multiplier at contact points, and Coulomb's friction.

A rigid surface has the gap g, the outward normal n and H = ∇n at a contact point at ξ. All
quantities are in the frame of the body. So a motion of the body itself is no slip:

    p = max(0, λ − ε_N g),    w = t_n − ε_T (ξ − ξ_n),    t = P w if |P w| ≤ T,
    t = T P w/|P w| else,    T = min(μ max(0, p − p_w A), τ A),    f = p n + t,    P = I − n ⊗ n.

The largest shear stress τ is a property of clay: α c_u at the interface, however high the pressure.
A is the area of the contact point. Without τ, T = μ p is Coulomb's friction. p_w is the pore
pressure where friction is that of the effective pressure, else 0.

This is the return mapping of Coulomb's law with an elastic slip (Wriggers, Computational Contact
Mechanics, 2006, ch. 10; AMPSSIE uses it in the material point method). The derivative of f by ξ is
exact and contains the derivative of the normal. It is not symmetric where a point slips.

Friction also acts at walls (`dolfinmpm.kinematics.walls`), at sides of the grid
(`dolfinmpm.dynamics.faces`), and between bodies at the nodes (`dolfinmpm.dynamics.collision`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numba
import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm._platform.argumentchecks import number, refuse_idle
from dolfinmpm._platform.errors import DoubtfulInputWarning, ParameterError, warn
from dolfinmpm._platform.units import (
    FAR_MODULI,
    LARGEST_PENALTY,
    LEAST_PENALTY,
    friction_coefficient,
)

__all__ = [
    "FREE",
    "SHEARS",
    "SLIPS",
    "STICKS",
    "ContactLaw",
    "contact_forces",
    "explicit_reduction",
    "slip_work",
]

Array = npt.NDArray[np.float64]

# Penalty by default, in units of E/h
USUAL_PENALTY = 5.0
# Largest one. Forces follow from overlaps, of which rounding leaves few digits: under a plane on a
# block of 1 m with a strain of 1 % the force was off by 3e-5 with 1e9, by 0.04, 1.5 and 2.5 % with
# 1e10, 1e11 and 1e12, and was 0 with 1e24
_LARGEST = 1e9
# Penalty below which another unit is likely: a block of four cells under a plate had 27 % of the
# force with 0.1, 3.5 % with 0.01
_SOFTEST = USUAL_PENALTY / FAR_MODULI
# A point that slips does so at μ p, or it shears at τ A: between the two is a kink of the force
FREE, STICKS, SLIPS, SHEARS = 0, 1, 2, 3


@dataclass(frozen=True)
class ContactLaw:
    """Parameters of a contact law, as the user gives them.

    Attributes:
        friction: μ.
        penalty: Penalty in units of E/h, if `stiffness` is None.
        stiffness: Penalty per area κ (Pa/m), or None.
        slip_share: ε_T/ε_N.
        penetration: Largest penetration (m), bounded by multipliers, or None.
        shear_limit: Largest shear stress τ (Pa), or None.

    Raises:
        ParameterError: A parameter has the wrong type or a value outside its range.
    """

    friction: float
    penalty: float
    stiffness: float | None
    slip_share: float
    penetration: float | None
    shear_limit: float | None = None

    def __post_init__(self) -> None:
        # frozen: the number is kept as a float
        object.__setattr__(self, "friction", friction_coefficient(self.friction))
        number("penalty", self.penalty, LEAST_PENALTY, _LARGEST, closed=True)
        if self.stiffness is not None:
            number("stiffness_per_area", self.stiffness, 0.0, unit="Pa/m")
            refuse_idle(
                "penalty", self.penalty, USUAL_PENALTY, "stiffness_per_area is given in its place"
            )
        number("slip_stiffness", self.slip_share, 0.0, LARGEST_PENALTY)
        if not self.friction:
            refuse_idle("slip_stiffness", self.slip_share, 0.5, "it is of friction: give friction=")
            refuse_idle("shear_limit", self.shear_limit, None, "it bounds friction: give friction=")
        if self.shear_limit is not None:
            number("shear_limit", self.shear_limit, 0.0, unit="Pa")
        if self.penetration is not None:
            number("penetration", self.penetration, 0.0, unit="m")
        elif self.stiffness is None and self.penalty < _SOFTEST:
            warn(
                MPI.COMM_WORLD,
                f"penalty = {self.penalty:g} is in units of E/h, with Young's modulus and the size "
                f"of the cells, and less than a hundredth of the usual {USUAL_PENALTY:g}: the "
                "bodies pass into each other nearly without a force. Leave it out, or give a "
                "Winkler stiffness as stiffness_per_area (Pa/m)",
                DoubtfulInputWarning,
            )

    def refuse_far(self, owner: str, E: float, cell: float) -> None:
        """Raise ParameterError if a given κ is far from the default one, as in kPa/m for Pa/m.

        Args:
            owner: The contact, in words.
            E: Young's modulus of the body (Pa); 0 if it is not known.
            cell: Size of the cells (m).
        """
        usual = USUAL_PENALTY * E / cell
        if self.stiffness is not None and self.stiffness < usual / FAR_MODULI:
            raise ParameterError(
                f"{owner} has stiffness_per_area = {self.stiffness:g} Pa/m, less than a hundredth "
                f"of the usual {USUAL_PENALTY:g} E/h = {usual:.3g} Pa/m (E = {E:.3g} Pa, cells of "
                f"{cell:.3g} m): the bodies would pass into each other. Give it in Pa/m, or leave "
                "it out. For a contact that is meant to be as soft, give "
                f"penalty={self.stiffness * cell / E:.3g}, in units of E/h"
            )
        if self.stiffness is not None and E > 0.0 and self.stiffness > _LARGEST * E / cell:
            raise ParameterError(
                f"{owner} has stiffness_per_area = {self.stiffness:g} Pa/m, more than "
                f"{_LARGEST:g} E/h = {_LARGEST * E / cell:.3g} Pa/m (E = {E:.3g} Pa, cells of "
                f"{cell:.3g} m): forces follow from overlaps, and these would be lost by rounding. "
                "Give a smaller one, or leave it out"
            )

    def largest_slip_forces(self, areas: Array) -> Array:
        """τ A at contact points (N), shape (m,); infinite without a limit.

        Args:
            areas: Areas A of the contact points (m^(d-1)), shape (m,).
        """
        limit = math.inf if self.shear_limit is None else self.shear_limit
        return np.full(areas.shape, math.inf) if math.isinf(limit) else limit * areas


@numba.njit(cache=True, error_model="numpy")
def contact_forces(
    gap, normal, curvature, at, start, before, multiplier, normal_stiffness, slip_stiffness,
    friction, limit, water, clinging, force, tangential, normal_force, derivative, state,
):  # fmt: skip
    """Forces at contact points and their derivatives; see above. All in the frame of the body.

    Args:
        gap, normal, curvature: g, n and H at the points, shapes (m,), (m, d), (m, d, d).
        at, start: ξ and ξ_n (m), shape (m, d).
        before: t_n (N), shape (m, d).
        multiplier: λ (N), shape (m,).
        normal_stiffness, slip_stiffness: ε_N and ε_T (N/m), shape (m,).
        friction: μ.
        limit: τ A (N), shape (m,).
        water: p_w A (N), shape (m,).
        clinging: Points that stay in contact even outside the body, with p < 0, shape (m,).
        force: Output: f (N), shape (m, d).
        tangential: Output: t (N), shape (m, d).
        normal_force: Output: p (N), shape (m,).
        derivative: Output: ∂f/∂ξ (N/m), shape (m, d, d).
        state: Output: FREE, STICKS, SLIPS or SHEARS, shape (m,). Contact without friction counts
            as STICKS.
    """
    d = at.shape[1]
    w, trial, dn = np.empty(d), np.empty(d), np.empty(d)
    tangent = np.empty((d, d))
    for c in range(at.shape[0]):
        n, H = normal[c], curvature[c]
        eN, eT = normal_stiffness[c], slip_stiffness[c]
        p = multiplier[c] - eN * gap[c]
        state[c] = FREE
        normal_force[c] = 0.0
        for i in range(d):
            force[c, i] = 0.0
            tangential[c, i] = 0.0
            for j in range(d):
                derivative[c, i, j] = 0.0
        if not (p > 0.0 or clinging[c]):
            continue
        normal_force[c] = p
        state[c] = STICKS
        for i in range(d):
            force[c, i] = p * n[i]
            for j in range(d):
                derivative[c, i, j] = p * H[i, j] - eN * n[i] * n[j]
        if friction == 0.0 or p <= 0.0:
            continue
        along = 0.0
        for i in range(d):
            w[i] = before[c, i] - eT * (at[c, i] - start[c, i])
            along += w[i] * n[i]
        size = 0.0
        for i in range(d):
            trial[i] = w[i] - along * n[i]
            size += trial[i] * trial[i]
        size = math.sqrt(size)
        for j in range(d):
            dn[j] = 0.0
            for i in range(d):
                dn[j] += w[i] * H[i, j]
        for i in range(d):
            for j in range(d):
                tangent[i, j] = eT * n[i] * n[j] - along * H[i, j] - n[i] * dn[j]
            tangent[i, i] -= eT
        bound, slope, slips = friction * (p - water[c]), friction * eN, SLIPS
        if bound < 0.0:
            bound, slope = 0.0, 0.0
        if bound > limit[c]:
            bound, slope, slips = limit[c], 0.0, SHEARS
        if size <= bound:
            for i in range(d):
                tangential[c, i] = trial[i]
                force[c, i] += trial[i]
                for j in range(d):
                    derivative[c, i, j] += tangent[i, j]
            continue
        state[c] = slips
        share = bound / size
        for i in range(d):
            tangential[c, i] = share * trial[i]
            force[c, i] += share * trial[i]
        for j in range(d):
            dsize = 0.0
            for i in range(d):
                dsize += trial[i] * tangent[i, j]
            dsize /= size
            for i in range(d):
                s = trial[i] / size
                derivative[c, i, j] += share * (tangent[i, j] - s * dsize) - slope * n[j] * s


def slip_work(tangential: Array, before: Array, slip: Array, normal: Array, stiffness: Array):
    """Work dissipated by friction at points that slip (J), shape (m,).

    Args:
        tangential, before: t and t_n (N), shape (m, d).
        slip: ξ − ξ_n (m), shape (m, d).
        normal: n, shape (m, d).
        stiffness: ε_T (N/m), shape (m,).
    """
    w = before - stiffness[:, None] * slip
    trial = np.linalg.norm(w - np.sum(w * normal, axis=1)[:, None] * normal, axis=1)
    size = np.linalg.norm(tangential, axis=1)
    return size * (trial - size) / stiffness


def explicit_reduction(gap: Array, closing: Array, normal_force: Array) -> Array:
    """Reduction of normal forces in an explicit step, (p/2) max(0, 1 − |g|/|Δg|) (N), shape (m,).

    A force at the start of a step acts for half a step before and for half a step after. In one of
    these halves the point may be outside for some time. The work of p = −ε_N g over this half
    then differs from the energy of the penalty, ½ ε_N g². So half of the force acts only by the
    share |g|/|Δg| of the time inside. The work over a contact is then that of the penalty to
    second order, wherever in a step the contact begins and ends.

    Args:
        gap: g (m), shape (m,).
        closing: Closing or opening of the gaps in a step (m), shape (m,).
        normal_force: p (N), shape (m,).
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        outside = 1.0 - np.abs(gap) / np.abs(closing)
    return 0.5 * np.where(outside > 0.0, outside, 0.0) * np.maximum(normal_force, 0.0)
