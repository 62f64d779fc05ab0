"""What both studies of Hertz's contact share: the ellipse of pressure that fits best."""

from __future__ import annotations

import math
from typing import Any

import numpy as np


def fitted_ellipse(
    r: np.ndarray, force: np.ndarray, pressure: np.ndarray, sphere: bool
) -> tuple[float, float]:
    """Half-width (m) and peak (Pa) of the elliptic pressure that fits.

    The half-width is from the second moment, ⟨r²⟩ = b²/4 of cylinders and 2b²/5 of spheres. The
    peak is the peak of the ellipse that fits best within 0.4 of the half-width.

    Args:
        r: Distances from the middle (m), shape (n,).
        force, pressure: Force (N) and pressure (Pa) there, shape (n,).
        sphere: Whether spheres touch.
    """
    b = math.sqrt((2.5 if sphere else 4) * (force @ r**2 / force.sum()))
    inner = r < 0.4 * b
    shape = np.sqrt(1 - (r[inner] / b) ** 2)
    return b, float(pressure[inner] @ shape / (shape @ shape))


def draw_pressure(axes: Any, figures: dict[str, Any], r: Any, pressure: Any, label: str) -> None:
    """Draw pressures (Pa) at distances r (m) from the middle, and Hertz's."""
    b, peak = figures["exact_half_width"], figures["exact_peak_pressure"]
    s = np.linspace(0, b, 200)
    axes.plot(s, peak * np.sqrt(1 - (s / b) ** 2) / 1e3, color="k", lw=1, label="Hertz")
    axes.plot(r, pressure / 1e3, "o", ms=3, label=label)
    axes.set(xlabel="distance from the middle (m)", ylabel="pressure (kPa)")
    axes.set(xlim=(0, 1.3 * b), ylim=(0, None))
    axes.legend()
