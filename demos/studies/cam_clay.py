"""The normally or over-consolidated Cam-Clay of the studies of a cone and of a wet slope."""

from __future__ import annotations

import dolfinmpm as mpm

__all__ = ["COMPRESSION", "PRESSURE", "SWELLING", "M", "cam_clay"]

# Even effective stress at first (Pa)
PRESSURE = 50e3
M, SWELLING, COMPRESSION = 1.05, 0.018, 0.13


def cam_clay(ratio: float, shear_modulus: float) -> mpm.materials.CamClay:
    """Modified Cam-Clay that is isotropically consolidated to `ratio` times PRESSURE.

    Args:
        ratio: Overconsolidation ratio R.
        shear_modulus: G (Pa).
    """
    return mpm.materials.CamClay(
        swelling=SWELLING, compression=COMPRESSION, M=M, mu0=shear_modulus, alpha=0.0,
        reference_pressure=PRESSURE, preconsolidation=ratio * PRESSURE,
    )  # fmt: skip
