"""Soil with water in the stability atlas: slopes that rise, and ground under a footing.

Displacement and pore pressure in one form (`poromechanics`), equal orders with the pressure
projection, the stabilisation on both fields. The soil begins weightless under an even effective
stress, by the suction of its water, as in `coupled_slope`; its surface drains.

- Slopes: those of `atlas_slopes` with 2 or 3 points per cell and direction; their weight grows in
  20 steps. Mohr-Coulomb (φ 15 to 25°), whose surface is wet in half of them, or Cam-Clay, whose
  suction is held at its surface. The undrained strength is 0.25 to 0.8 of that at which even a
  plane wedge would slide.
- Footings: ground 12 by 6 cells of 0.5 m, Cam-Clay (M 0.8 to 1.2, suction 20 to 60 kPa,
  overconsolidation ratio 1 to 3), a pressure on a strip 2 to 3 cells wide beside the wall of
  symmetry that grows in 20 steps to 0.3 to 0.9 times (2 + π) c_u.
- The rise takes 1e-4 to 1e2 of H²/c_v, by its logarithm: from no drainage to all of it.
"""

from __future__ import annotations

import math
from typing import Any

import atlas_slopes
import numpy as np
import ufl
from atlas_example import Example, culmann, random_of, rectangle
from atlas_soils import SWELLING, law_of
from dolfinx import fem
from mpi4py import MPI
from scene import faces

import dolfinmpm as mpm

__all__ = ["BASES", "build", "draw"]

BASES = "linear", "gimp", "bspline2"
STEPS, PERMEABILITY = 20, 1e-9  # -, m/s
CELL, GROUND = 0.5, (12, 6)  # m, cells


def draw(seed: int) -> dict[str, Any]:
    """The numbers of a problem (m, degrees, Pa)."""
    rng = random_of("water", seed)
    p = {**atlas_slopes.draw(seed), "per_cell": int(rng.integers(2, 4)), "exact": False}
    clay = bool(rng.integers(2))
    p |= {"law": "Cam-Clay" if clay else "Mohr-Coulomb", "wet": bool(rng.integers(2)) and not clay}
    p |= {"footing": bool(rng.integers(2)), "time": 10 ** rng.uniform(-4, 2)}
    p["friction"] = rng.uniform(15.0, min(25.0, p["angle"] - 10.0))
    weight = atlas_slopes.DENSITY * atlas_slopes.GRAVITY * p["height"]
    p["cohesion"] = weight / culmann(p["angle"], 0.0) * rng.uniform(0.25, 0.8) / undrained(p)
    p["E"] = max(5 * weight, p["cohesion"] * rng.uniform(50, 200))
    if p["footing"]:
        M, p0 = rng.uniform(0.8, 1.2), rng.uniform(20e3, 60e3)
        p |= {
            "law": "Cam-Clay", "wet": False, "friction": math.degrees(math.asin(3 * M / (6 + M))),
            "height": GROUND[1] * CELL, "strip": int(rng.integers(2, 4)),
            "load": rng.uniform(0.3, 0.9),
        }  # fmt: skip
        p["cohesion"] = p0 * math.tan(math.radians(p["friction"]))
        p["E"] = p["cohesion"] * rng.uniform(50, 200)
    return p


def undrained(p: dict[str, Any]) -> float:
    """Undrained strength by the cohesion c (-), p0 tan φ being c; see `coupled_slope`.

    Mohr-Coulomb c cos φ + p0 sin φ, Cam-Clay M/√3 p0 (R/2)^(1 − κ̂/λ̂).
    """
    phi = math.radians(p["friction"])
    if p["law"] == "Mohr-Coulomb":
        return 2.0 * math.cos(phi)
    M = 6 * math.sin(phi) / (3 - math.sin(phi))
    slope = 1 - SWELLING / p["compression"]
    return M / math.sqrt(3) * (p["ratio"] / 2) ** slope / math.tan(phi)


def modulus_of(p: dict[str, Any]) -> float:
    """P-wave modulus of the soil at first (Pa)."""
    G = p["E"] / (2 * (1 + p["nu"]))
    if p["law"] == "Cam-Clay":
        return suction_of(p) / SWELLING + 4 / 3 * G
    return 2 * G * (1 - p["nu"]) / (1 - 2 * p["nu"])


def suction_of(p: dict[str, Any]) -> float:
    """Suction of the water at first (Pa): with it friction has the strength of the cohesion."""
    return p["cohesion"] / math.tan(math.radians(p["friction"]))


def ground_of(p: dict[str, Any], comm: MPI.Comm) -> tuple[Any, Any, list[Any]]:
    """Grid, points, and faces of the surface. Collective."""
    if p["footing"]:
        size = GROUND[0] * CELL, GROUND[1] * CELL
        grid = rectangle(comm, (size[0], size[1] + 2 * CELL), CELL)
        points = mpm.fill(grid, mpm.Box((0, 0), size), p["per_cell"], 1.0)
        top = mpm.Surface(points, lambda x: x[1] > size[1] * (1 - 1e-9), (0, 1), name="top")
        return grid, points, [top]
    h, (_, width) = p["h"], atlas_slopes.width_of(p)
    grid = rectangle(comm, (width, p["base"] + p["height"] + h), h)
    inside = atlas_slopes.inside_of(p)
    points = mpm.fill(grid, mpm.Where(inside), p["per_cell"], 1.0)
    width = math.ceil(width / h - 1e-9) * h
    return grid, points, faces(points, inside, width)


def build(p: dict[str, Any], basis: str, stabilisation: str, comm: MPI.Comm) -> Example:
    """Make the problem ready. Collective."""
    grid, points, surface = ground_of(p, comm)
    V = mpm.Space(grid, basis, domains="volume")
    Q = mpm.Space(grid, basis, shape=(), domains="volume")
    u, v, suction, modulus = V.increment, V.test, suction_of(p), modulus_of(p)
    law, load = law_of(p), fem.Constant(grid, (0.0, 0.0))
    held = 0.0 if p["wet"] else -suction
    F = mpm.poromechanics(
        law, points, (u, Q.increment), (v, Q.test), permeability=PERMEABILITY, porosity=0.5,
        modulus=modulus, drained=[(face, held) for face in surface],
    )  # fmt: skip
    if p["law"] == "Mohr-Coulomb":
        mpm.set_stress(law, points, -suction * np.eye(3))
    if p["footing"]:
        top, across = p["height"] * (1 - 1e-9), p["strip"] * CELL
        strip = mpm.Surface(points, lambda x: (x[1] > top) & (x[0] < across), (0, 1), name="strip")
        F += strip.traction(load, v)
        whole = p["load"] * (2 + math.pi) * undrained(p) * p["cohesion"]
    else:
        F -= ufl.inner(load, v) * points.dX
        whole = atlas_slopes.DENSITY * atlas_slopes.GRAVITY
    bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
    problem = mpm.Transient(
        F, [u, Q.increment], points, bcs, stabilisation=[stabilisation] * 2, tolerance=1e-7
    )
    points["pressure"] = -suction
    rise = p["time"] * p["height"] ** 2 / (PERMEABILITY / mpm.Fluid().unit_weight * modulus)

    def go(k: int) -> None:
        load.value[1] = -whole * k / STEPS
        problem.step(rise * k / STEPS)

    return Example(problem, STEPS, go, {0: law}, float(grid_size(p)))


def grid_size(p: dict[str, Any]) -> float:
    """Size of the cells (m)."""
    return CELL if p["footing"] else p["h"]
