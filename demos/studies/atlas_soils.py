"""Soils of the stability atlas: their laws by the numbers that are drawn."""

from __future__ import annotations

import math
from typing import Any

import dolfinmpm as mpm

__all__ = ["SWELLING", "law_of", "pressure_of"]

SWELLING = 0.02  # κ̂ of Cam-Clay


def law_of(p: dict[str, Any]) -> Any:
    """The law of a problem."""
    E, nu, c, phi = p["E"], p["nu"], p["cohesion"], p["friction"]
    if p["law"] == "von Mises":
        return mpm.materials.VonMises(E, nu, radius=math.sqrt(2) * c)
    if p["law"] == "Tresca":
        return mpm.materials.Tresca(E, nu, c)
    if p["law"] == "Mohr-Coulomb":
        return mpm.materials.MohrCoulomb(E, nu, c, phi)
    if p["law"] == "Drucker-Prager":
        return mpm.materials.DruckerPrager(E, nu, c, phi, fit="plane strain")
    sine = math.sin(math.radians(phi))
    p0 = pressure_of(p)
    return mpm.materials.CamClay(
        swelling=SWELLING, compression=p["compression"], M=6 * sine / (3 - sine),
        mu0=E / (2 * (1 + nu)), alpha=0.0, reference_pressure=p0, preconsolidation=p["ratio"] * p0,
    )  # fmt: skip


def pressure_of(p: dict[str, Any]) -> float:
    """Pressure from outside (Pa): that which gives friction the strength of the cohesion."""
    if p["law"] != "Cam-Clay":
        return 0.0
    return p["cohesion"] / math.tan(math.radians(p["friction"]))
