"""The slope with a weak zone that `slope_failure.py` and `slope_runout.py` bring to failure.

Lengths in m, moduli and strengths in Pa. The slope falls by 45° from the height TOP to its toe on
ground of the height BASE.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scene import draw_points

__all__ = [
    "BASE", "DENSITY", "GRAVITY", "GRID_TOP", "NU", "TOE", "TOP", "WEAK", "YIELD", "ZONE", "E",
    "draw_slope", "in_body", "in_zone",
]  # fmt: skip

E, NU, YIELD, WEAK = 1e6, 0.3, 15e3, 7.5e3
DENSITY, GRAVITY = 2400.0, 10.0
BASE, TOP, TOE, GRID_TOP = 2.0, 8.0, 12.0, 9.0
ZONE = (4.0, 12.0), (2.0, 3.0)


def in_zone(x: np.ndarray) -> np.ndarray:
    """Whether points at x, shape (2, n), were in the weak zone."""
    (left, right), (low, high) = ZONE
    return (x[0] >= left) & (x[0] <= right) & (x[1] >= low) & (x[1] <= high)


def in_body(x: np.ndarray, width: float) -> np.ndarray:
    """Whether x, shape (2, n), is in the slope or in the ground, up to a width (m)."""
    # rounding must not decide about the points on the slope's surface
    inside = (x[1] >= 0) & (x[1] <= TOP) & (x[0] >= 0) & (x[0] <= width)
    return inside & ((x[1] <= BASE) | (x[0] + x[1] <= TOE + BASE + 1e-9))


def draw_slope(axes: Any, state: Any, limit: float, width: float) -> Any:
    """Draw the deformed slope, by plastic strain, over its first outline.

    Args:
        axes: Matplotlib axes.
        state: x, F, l0 and plastic strain of all points.
        limit: Plastic strain with the last colour.
        width: Width of the ground (m).
    """
    drawn = draw_points(axes, *state, cmap="viridis", clim=(0, limit))
    outline = [(0, TOP), (TOE + BASE - TOP, TOP), (TOE, BASE), (width, BASE)]
    axes.plot(*np.array(outline).T, color="0.4", lw=0.6, ls="--")
    return drawn
