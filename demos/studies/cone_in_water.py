"""Saturated Cam-Clay for the study of a cone: its numbers, its weak form, the drainage curve.

The clay is weightless and under the even effective stress p₀ by the suction −p₀ of its water, with
no total stress: what the cone carries is q_c − σ_v0. Pressures beyond those at first are p + p₀.

Results in cells of R/2, after 8 R: the factor is 9.7 without drainage (Teh & Houlsby 9.72), 9.4 at
v d/c_v = 1000, and 14.5 drained. The drained one is 1.55 times as large, and still grows by 7 %
over four diameters. The middle of the curve is at 5.9 (a fit has V50 = 5.8, m = 1.2), with c_v of
the ground at rest. At 1000, pore pressure is 77 % of the resistance. With five times the penalty,
points are crushed at the shoulder.
"""

from __future__ import annotations

import math

import numpy as np
from cam_clay import COMPRESSION, PRESSURE, SWELLING, M, cam_clay
from scipy.optimize import least_squares

import dolfinmpm as mpm

POROSITY = 0.5
# v d/c_v of what counts as drained, and of a run in between; None for water that stays
VELOCITIES = {"drained": 1e-2, "partly": 3.0, "undrained": None}


class Clay:
    """Modified Cam-Clay, isotropically consolidated.

    Args:
        ratio: Overconsolidation ratio R.
        index: G/c_u.
        velocity: V = v d/c_v, with c_v = k p₀/(λ̂ γ_w) of virgin compression; None without
            drainage.
        diameter: d of the cone (m).
        way: Its way in a step of 1 s (m).

    Attributes:
        strength: c_u = M/√3 p₀ (R/2)^(1 − κ̂/λ̂) (Pa), in plane strain (Wood 1990, ch. 7).
        shear_modulus, bulk_modulus: G, and K at first (Pa).
        permeability: k that goes with the velocity (m/s).
        law: The law.
    """

    def __init__(
        self, ratio: float, index: float, velocity: float | None, diameter: float, way: float
    ):
        size = PRESSURE * (ratio / 2) ** (1 - SWELLING / COMPRESSION)
        self.strength = M * size / math.sqrt(3)
        self.shear_modulus = index * self.strength
        self.bulk_modulus = PRESSURE / SWELLING
        c_v = way * diameter / velocity if velocity else 0.0
        self.permeability = c_v * mpm.Fluid().unit_weight * COMPRESSION / PRESSURE
        self.law = cam_clay(ratio, self.shear_modulus)

    @property
    def young(self) -> float:
        """E at first (Pa)."""
        G, K = self.shear_modulus, self.bulk_modulus
        return 9 * K * G / (3 * K + G)

    def form(self, points, space, u, v, **options):
        """Weak form, pressure, and conditions on it; the ground drains upwards and far away."""
        Q, p0 = space, -PRESSURE
        drained, bcs = [], []
        if self.permeability > 0:
            drained = [(mpm.Surface(points, lambda x: x[-1] > -1e-9, _up(points.gdim)), p0)]
            for side in ("right", "bottom"):
                bcs += mpm.prescribed(Q, side, 0, value=p0)
        modulus = self.bulk_modulus + 4 / 3 * self.shear_modulus
        F = mpm.poromechanics(
            self.law, points, (u, Q.increment), (v, Q.test), permeability=self.permeability,
            porosity=POROSITY, modulus=modulus, drained=drained, **options,
        )  # fmt: skip
        return F, bcs


def _up(gdim: int) -> tuple[float, ...]:
    return (0.0,) * (gdim - 1) + (1.0,)


def backbone(V, ratio, V50=3.0, m=1.0):
    """Resistance by the undrained one against v d/c_v: 1 + (ratio − 1)/(1 + (V/V50)^m).

    DeJong & Randolph (2012, doi 10.1061/(ASCE)GT.1943-5606.0000646); ratio is that of drained to
    undrained resistance.
    """
    return 1 + (ratio - 1) / (1 + (np.asarray(V, float) / V50) ** m)


def compared(runs):
    """What the runs of several velocities say together.

    Args:
        runs: Figures of the runs, by growing velocity; the first is taken as drained, the last as
            undrained.

    Returns:
        Drained by undrained resistance; the velocity with the mean of both; V50 and m of the
        backbone that fits best, and the largest distance from that of V50 = 3 and m = 1 as a share
        of the difference. c_v is that of the ground at rest; where the cone compresses it, it
        consolidates faster, for κ and λ are slopes by ln p.
    """
    V = np.array([run["velocity"] for run in runs])
    q = np.array([run.get("factor", math.nan) for run in runs])
    ratio = q[0] / q[-1]
    share = (q / q[-1] - 1) / (ratio - 1)
    figures = {"drained_ratio": float(ratio), "shares": share.tolist()}
    if len(V) < 4 or not np.isfinite(share).all():
        return figures
    fit = least_squares(lambda x: backbone(V, 2.0, math.exp(x[0]), x[1]) - 1 - share, (1.0, 1.0))
    return figures | {
        "V50": float(np.exp(np.interp(-0.5, -share, np.log(V)))),
        "V50_fitted": math.exp(fit.x[0]),
        "m_fitted": float(fit.x[1]),
        "apart": float(np.abs(share - backbone(V, 2.0) + 1).max()),
    }
