"""Random slopes of the stability atlas: they fail under their weight, and slide.

A slope on ground of the same soil, on a rough base, between smooth walls; the weight grows from
nothing in equal steps, as in `slope_failure`. Drawn evenly between these bounds:

- height H 3 to 6 m, angle 30 to 75°, cells of H/6 to H/3.5, the ground below 2 to 3 cells thick;
- toe and crest anywhere in a cell, so that the surface cuts the grid; edges filled by whole parts
  of cells or exactly; 2 to 4 points per cell and direction;
- von Mises, Tresca, Mohr-Coulomb, Drucker-Prager (friction of 5° to 25°, and 10° less than the
  slope's angle at most; no dilation) or Cam-Clay;
- cohesion between 0.25 and 0.8 of that at which even a plane wedge would slide (Culmann's number,
  `culmann`), so that the slope fails at 15 to 70 % of its weight;
- Young's modulus 50 to 500 times the cohesion, by its logarithm, and 5 times the weight of a column
  of the slope's height at least; ν from 0.2 to 0.45;
- F-bar for half of them; not for Cam-Clay, and not for linear functions with 2² points.

Cam-Clay (κ̂ = 0.02, λ̂ = 0.1 to 0.2, overconsolidation ratio 1 to 3) stands under an even pressure
p0 from outside, in place of the suction of its water. What p0 lends, p0 tan φ', is the cohesion.
"""

from __future__ import annotations

import math
from typing import Any

import ufl
from atlas_example import Example, culmann, random_of, rectangle
from atlas_soils import law_of, pressure_of
from dolfinx import fem, mesh
from mpi4py import MPI
from scene import faces

import dolfinmpm as mpm

__all__ = ["BASES", "build", "draw"]

BASES = "linear", "gimp", "bspline2", "bspline3"
LAWS = "von Mises", "Tresca", "Mohr-Coulomb", "Drucker-Prager", "Cam-Clay"
DENSITY, GRAVITY = 2000.0, 10.0  # kg/m³, m/s²
STEPS = 20


def draw(seed: int) -> dict[str, Any]:
    """The numbers of a problem (m, degrees, Pa)."""
    rng = random_of("slopes", seed)
    height, angle = rng.uniform(3.0, 6.0), rng.uniform(30.0, 75.0)
    h = height / rng.uniform(3.5, 6.0)
    law = LAWS[rng.integers(len(LAWS))]
    friction = rng.uniform(5.0, min(25.0, angle - 10.0))
    friction = friction if law in ("Mohr-Coulomb", "Drucker-Prager", "Cam-Clay") else 0.0
    weight = DENSITY * GRAVITY * height
    cohesion = weight / culmann(angle, friction) * rng.uniform(0.25, 0.8)
    return {
        "law": law, "height": height, "angle": angle, "base": h * rng.uniform(2.0, 3.0), "h": h,
        "crest_width": rng.uniform(0.5, 1.0) * height, "friction": friction, "cohesion": cohesion,
        "E": max(5 * weight, cohesion * 10 ** rng.uniform(math.log10(50), math.log10(500))),
        "nu": rng.uniform(0.2, 0.45), "per_cell": int(rng.integers(2, 5)),
        "exact": bool(rng.integers(2)), "fbar": bool(rng.integers(2)) and law != "Cam-Clay",
        "compression": rng.uniform(0.1, 0.2), "ratio": rng.uniform(1.0, 3.0),
    }  # fmt: skip


def width_of(p: dict[str, Any]) -> tuple[float, float]:
    """Place of the toe, and width of the ground with room for what slides (m)."""
    toe = p["crest_width"] + p["height"] / math.tan(math.radians(p["angle"]))
    return toe, toe + 2.2 * p["height"]


def inside_of(p: dict[str, Any]) -> Any:
    """Function that tells whether positions, shape (2, n), are in the slope or in the ground."""
    top, slant = p["base"] + p["height"], math.tan(math.radians(p["angle"]))
    toe, _ = width_of(p)

    def inside(x):
        face = toe - (x[1] - p["base"]) / slant
        return (x[1] <= top) & ((x[1] <= p["base"]) | (x[0] <= face))

    return inside


def outline_of(p: dict[str, Any], width: float) -> list[tuple[float, float]]:
    """Corners of the body (m)."""
    base, top, (toe, _) = p["base"], p["base"] + p["height"], width_of(p)
    return [(0, 0), (width, 0), (width, base), (toe, base), (p["crest_width"], top), (0, top)]


def build(p: dict[str, Any], basis: str, stabilisation: str, comm: MPI.Comm) -> Example:
    """Make the problem ready. Collective."""
    _, width = width_of(p)
    h = p["h"]
    grid: mesh.Mesh = rectangle(comm, (width, p["base"] + p["height"] + 1.0 * h), h)
    width = float(math.ceil(width / h - 1e-9) * h)
    # pressure acts on faces of whole parts of cells
    exact = p["exact"] and p["law"] != "Cam-Clay"
    shape = mpm.Polygon(outline_of(p, width)) if exact else mpm.Where(inside_of(p))
    points = mpm.fill(grid, shape, p["per_cell"], DENSITY, exact=exact)
    V = mpm.Space(grid, basis, domains="volume")
    u, v = V.increment, V.test
    fbar = p["fbar"] and not (basis == "linear" and p["per_cell"] == 2)
    law, gravity = law_of(p), fem.Constant(grid, (0.0, 0.0))
    F = mpm.momentum(law, points, u, v, fbar=fbar)
    F -= ufl.inner(points.density * gravity, v) * points.dX
    if p["law"] == "Cam-Clay":
        for face in faces(points, inside_of(p), width):
            F += face.pressure(pressure_of(p), u, v)
    bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
    problem = mpm.QuasiStatic(F, u, points, bcs, stabilisation=stabilisation)

    def go(k: int) -> None:
        gravity.value[1] = -GRAVITY * k / STEPS
        problem.step()

    return Example(
        problem, STEPS, go, {0: law}, h, keeps_volume=p["law"] in ("von Mises", "Tresca")
    )
