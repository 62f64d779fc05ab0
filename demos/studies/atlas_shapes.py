"""Random shapes of the stability atlas, and their outlines."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

import dolfinmpm as mpm

__all__ = ["ALL", "SHAPES", "corners_of", "random_shape", "rounded", "shape_of"]

SHAPES = "disc", "box", "turned box", "polygon"
# Waves around a blob and their heights, by the radius
BLOB = {2: 0.1, 3: 0.03}
ALL = *SHAPES, "bar", "blob"


def random_shape(rng: np.random.Generator, radius: float, kinds: Any = SHAPES) -> dict[str, Any]:
    """A disc, a box, a turned box or a convex polygon of 3 to 7 corners about the origin.

    A bar is a turned box two to three times as long as it is wide, in a circle 1.3 times as large;
    a blob is smooth and convex.

    Args:
        rng: Random numbers.
        radius: Of a circle around it (m); polygons have their corners on it, and no edge that is
            shorter than a third of it.
        kinds: Which of them.
    """
    kind = kinds[rng.integers(len(kinds))]
    reach: Any = 1.0
    if kind in ("disc", "blob"):
        angles = 2 * np.pi * np.arange(48) / 48
        if kind == "blob":
            waves = [a * np.cos(k * angles + rng.uniform(0, 2 * np.pi)) for k, a in BLOB.items()]
            reach = 1.0 + sum(waves)
            reach /= reach.max()
    elif kind == "polygon":
        count = int(rng.integers(3, 8))
        gaps = 1.0 + rng.uniform(0.0, 1.0, count)
        angles = 2 * np.pi * np.cumsum(gaps) / gaps.sum() + rng.uniform(0.0, 2 * np.pi)
    else:
        diagonal = rng.uniform(0.25, 0.75) * 0.5 * np.pi
        if kind == "bar":
            diagonal, radius = math.atan(1.0 / rng.uniform(2.0, 3.0)), 1.3 * radius
        turned = 0.0 if kind == "box" else rng.uniform(0.1, 0.7)
        half = [-diagonal, diagonal, np.pi - diagonal, np.pi + diagonal]
        angles = turned + np.array(half)
    corners = (radius * reach * np.array([np.cos(angles), np.sin(angles)])).T
    return {"kind": kind, "radius": radius, "corners": corners.tolist()}


def corners_of(shape: dict[str, Any], centre: Any) -> Any:
    """Corners of a shape's outline (m), anticlockwise, shape (n, 2)."""
    return np.array(shape["corners"]) + centre


def shape_of(shape: dict[str, Any], centre: Any) -> Any:
    """A shape of the library, about a centre (m)."""
    if shape["kind"] == "disc":
        return mpm.Disc((float(centre[0]), float(centre[1])), shape["radius"])
    corners = corners_of(shape, centre)
    if shape["kind"] == "box":
        return mpm.Box(tuple(corners.min(axis=0)), tuple(corners.max(axis=0)))
    return mpm.Polygon(corners)


def rounded(corners: Any, fillet: float, count: int = 6) -> Any:
    """The outline of a convex polygon whose corners are rounded (m), shape (m, 2).

    Args:
        corners: Corners anticlockwise (m), shape (n, 2).
        fillet: Radius of the rounding (m).
        count: Points on each arc.
    """
    if fillet <= 0:
        return corners
    found = []
    for last, here, following in zip(np.roll(corners, 1, 0), corners, np.roll(corners, -1, 0)):
        normals = [
            np.array([d[1], -d[0]]) / np.linalg.norm(d) for d in (here - last, following - here)
        ]
        # the centre of the arc is a radius behind both edges
        centre = here + np.linalg.solve(normals, [-fillet, -fillet])
        first, end = (math.atan2(n[1], n[0]) for n in normals)
        turn = np.linspace(0.0, (end - first) % (2 * math.pi), count)
        outward = np.column_stack([np.cos(first + turn), np.sin(first + turn)])
        found.append(centre + fillet * outward)
    return np.concatenate(found)
