"""Rigid bodies of random shape in the stability atlas, pressed into soil and dragged through it.

The soil, 16 by 6 to 7 cells of 0.25 m, is at rest under its weight (2000 kg/m³). The horizontal
stress is K0 = ν/(1 − ν) times the vertical one, with friction at least 1 − sin φ (Jaky), because
the first stress must not be beyond the yield surface. A body comes down onto it, goes 0.5 to 1.5
cells deep, and then 1 to 3 cells to the side. Drawn evenly between these bounds:

- a disc, a box, a turned box or a convex polygon of 3 to 7 corners, within a circle of 1.2 to 2.2
  cells; half of those with corners have fillets of 0.1 to 0.3 cells; a third turns by up to 0.02
  per step;
- steps of 0.1 to 0.25 cells, friction 0 to 0.4, contact penalty κ h/E of 1 to 3;
- von Mises or Tresca (c 12 to 40 kPa), Mohr-Coulomb or Drucker-Prager (c 6 to 20 kPa, φ 15 to 35°,
  no dilation); Young's modulus 100 to 400 times the cohesion, ν from 0.2 to 0.4; no F-bar, which
  lets clay flow too much beside a rigid body; 2 to 4 points per cell and direction.

Ground flows past the body: domains follow the volume, the ghost penalty is a tenth of the usual
one, and the balance is asked for to 2e-4 of the loads, as README has it.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import ufl
from atlas_example import Example, Rigid, random_of, rectangle
from atlas_shapes import random_shape, rounded, shape_of
from atlas_soils import law_of
from dolfinx import fem
from mpi4py import MPI

import dolfinmpm as mpm

__all__ = ["BASES", "a_tenth", "build", "draw"]

BASES = "linear", "gimp", "bspline2", "bspline3"
LAWS = "von Mises", "Tresca", "Mohr-Coulomb", "Drucker-Prager"
H, WIDTH, DENSITY, GRAVITY = 0.25, 16, 2000.0, 10.0  # m, cells, kg/m³, m/s²
TENTHS = {"linear": 0.1, "gimp": 0.1, "bspline2": 10.0, "bspline3": 1e3}
DEEPEST = 0.3  # cells that a point's centre may be inside a body


def draw(seed: int) -> dict[str, Any]:
    """The numbers of a problem (m, degrees, Pa)."""
    rng = random_of("bodies", seed)
    law = LAWS[rng.integers(len(LAWS))]
    rubs = law in ("Mohr-Coulomb", "Drucker-Prager")
    cohesion = rng.uniform(6e3, 20e3) if rubs else rng.uniform(12e3, 40e3)
    shape = random_shape(rng, rng.uniform(1.2, 2.2) * H)
    fillet = rng.uniform(0.1, 0.3) * H if rng.integers(2) else 0.0
    return {
        "law": law, "cohesion": cohesion, "friction": rng.uniform(15, 35) if rubs else 0.0,
        "E": cohesion * rng.uniform(100, 400), "nu": rng.uniform(0.2, 0.4),
        "per_cell": int(rng.integers(2, 5)), "top": rng.uniform(6.0, 7.0) * H,
        "shape": shape, "fillet": 0.0 if shape["kind"] == "disc" else fillet,
        "x": rng.uniform(4.0, 5.0) * H, "depth": rng.uniform(0.5, 1.5) * H,
        "drag": rng.uniform(1.0, 3.0) * H, "step": rng.uniform(0.1, 0.25) * H,
        "rubs": rng.uniform(0.0, 0.4), "penalty": rng.uniform(1.0, 3.0),
        "turns": rng.uniform(-0.02, 0.02) if rng.random() < 1 / 3 else 0.0,
    }  # fmt: skip


def a_tenth(basis: str, stabilisation: str) -> mpm.Stabilisation:
    """A stabilisation by its name; of the ghost penalty a tenth of what the basis usually has."""
    factor = TENTHS[basis] if stabilisation == "ghost" else None
    return mpm.Stabilisation(stabilisation, factor=factor)


def way_of(p: dict[str, Any]) -> tuple[int, Any]:
    """Number of steps, and the displacement (m) after t of them: down, then to the side."""
    down, aside = (max(1, math.ceil(p[name] / p["step"])) for name in ("depth", "drag"))

    def at(t: float) -> tuple[float, float]:
        first, then = min(t / down, 1.0), max(0.0, (t - down) / aside)
        return then * p["drag"], -first * p["depth"]

    return down + aside, at


def build(p: dict[str, Any], basis: str, stabilisation: str, comm: MPI.Comm) -> Example:
    """Make the problem ready. Collective."""
    grid = rectangle(comm, (WIDTH * H, p["top"] + 5 * H), H)
    points = mpm.fill(grid, mpm.Box((0, 0), (WIDTH * H, p["top"])), p["per_cell"], DENSITY)
    V = mpm.Space(grid, basis, domains="volume")
    u, v = V.increment, V.test
    law, gravity = law_of(p), fem.Constant(grid, (0.0, -GRAVITY))
    K0 = p["nu"] / (1 - p["nu"])
    if p["friction"]:
        K0 = max(K0, 1.0 - math.sin(math.radians(p["friction"])))
    mpm.set_stress(law, points, mpm.geostatic_stress(p["top"], DENSITY * GRAVITY, K0))
    corners = np.array(p["shape"]["corners"])
    centre = np.array([p["x"], p["top"] - corners[:, 1].min() + 0.01 * H])
    steps, way = way_of(p)
    body = mpm.RigidBody(
        shape_of(p["shape"], centre), displacement=way, fillet=p["fillet"], name="body",
        **({"rotation_increment": math.degrees(p["turns"])} if p["turns"] else {}),
    )  # fmt: skip
    F = mpm.momentum(law, points, u, v) - ufl.inner(points.density * gravity, v) * points.dX
    F += mpm.contact(body, points, u, v, friction=p["rubs"], penalty=p["penalty"])
    bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
    problem = mpm.QuasiStatic(
        F, u, points, bcs, stabilisation=a_tenth(basis, stabilisation), tolerance=2e-4
    )
    outline = rounded(corners - (body.position - centre), p["fillet"])
    return Example(
        problem, steps, lambda _: problem.step(), {0: law}, H, equal=0.05,
        rigid=[Rigid(body, outline, DEEPEST * H)],
        keeps_volume=p["law"] in ("von Mises", "Tresca"),
    )  # fmt: skip
