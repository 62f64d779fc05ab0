"""Bodies that collide in the stability atlas, in implicit and in explicit steps.

Two bodies fly at each other in the plane, in cells of 0.1 m, from 0.05 to 0.5 cells apart. Drawn
evenly between these bounds; a rigid body that would start inside of points moves back:

- discs, boxes, turned boxes, bars, blobs and convex polygons within circles of 0.2 to 0.35 m; one
  may be up to half its radius aside of the other's line; 2 or 3 points per cell and direction;
- Hencky, neo-Hookean or von Mises (radius of 2 to 10 % of Young's modulus), E from 0.3 to
  3 MPa by its logarithm, ν from 0 to 0.4, 1000 kg/m³; speeds 1 to 5 % of the waves' for each;
- they fly for 1 to 1.5 times as long as they need to meet, and a wave to cross a body four times;
- implicit (`impacts`, Newmark): in one field of displacements, with fields of their own
  (`contact_between`, friction 0 to 0.5), or the first is rigid and free (`contact`); 30 steps;
- explicit: in one field of velocities, or, without a stabilisation, with contact at the nodes
  (`Collision` with a gap test); steps of 0.3 to 0.8 of the critical one, a lumped mass. No ghost
  penalty: it is of a consistent mass, and takes two bodies that share a cell for one whose velocity
  has a bend, see `colliding_discs`.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from atlas_example import Example, Rigid, random_of
from atlas_shapes import ALL, corners_of, random_shape, shape_of
from dolfinx import mesh
from mpi4py import MPI

import dolfinmpm as mpm

__all__ = ["BASES", "build", "draw"]

BASES = "linear", "gimp", "bspline2", "bspline3"
H, SIZE, DENSITY, STEPS = 0.1, (2.4, 1.6), 1000.0, 30  # m, m, kg/m³
LAWS = "Hencky", "neo-Hookean", "von Mises"
WAYS = "one field", "fields", "rigid"


def draw(seed: int, family: str = "impacts") -> dict[str, Any]:
    """The numbers of a problem (m, m/s, Pa)."""
    rng = random_of(family, seed)
    E, nu = 10 ** rng.uniform(5.5, 6.5), rng.uniform(0.0, 0.4)
    wave = math.sqrt(E * (1 - nu) / ((1 + nu) * (1 - 2 * nu)) / DENSITY)
    shapes = [random_shape(rng, rng.uniform(0.2, 0.35), ALL) for _ in range(2)]
    middle = np.array(SIZE) / 2 + rng.uniform(-0.05, 0.05, 2)
    aside = rng.uniform(-0.5, 0.5) * min(shape["radius"] for shape in shapes)
    gap = rng.uniform(0.05, 0.5) * H
    right = max(x for x, _ in shapes[0]["corners"])
    left = min(x for x, _ in shapes[1]["corners"])
    first = middle - [right + 0.5 * gap, 0.5 * aside]
    second = middle - [left - 0.5 * gap, -0.5 * aside]
    speed = rng.uniform(0.01, 0.05) * wave
    crossing = 4 * max(shape["radius"] for shape in shapes) / wave
    return {
        "law": LAWS[rng.integers(3)], "E": E, "nu": nu, "strength": rng.uniform(0.02, 0.1) * E,
        "wave": wave, "shapes": shapes, "centres": [first.tolist(), second.tolist()],
        "speed": speed, "per_cell": int(rng.integers(2, 4)),
        "time": gap / (2 * speed) * rng.uniform(1.0, 1.5) + 2 * crossing,
        "way": WAYS[rng.integers(3)], "friction": rng.uniform(0.0, 0.5),
        "courant": rng.uniform(0.3, 0.8), "mass": rng.uniform(0.5, 3.0),
    }  # fmt: skip


def law_of(p: dict[str, Any]) -> Any:
    """The law of a problem."""
    if p["law"] == "neo-Hookean":
        return mpm.materials.NeoHookean(E=p["E"], nu=p["nu"])
    if p["law"] == "Hencky":
        return mpm.materials.Hencky(p["E"], p["nu"])
    return mpm.materials.VonMises(p["E"], p["nu"], radius=p["strength"])


def squares(comm: MPI.Comm) -> mesh.Mesh:
    """The grid."""
    n = [round(length / H) for length in SIZE]
    return mesh.create_rectangle(comm, [(0.0, 0.0), SIZE], n, mesh.CellType.quadrilateral)


def moving(p: dict[str, Any], grid: mesh.Mesh, which: Any) -> Any:
    """Points of the bodies of some numbers, 0 and 1, that fly at each other. Collective."""
    parts = [
        mpm.fill(grid, shape_of(p["shapes"][k], p["centres"][k]), p["per_cell"], DENSITY, tag=k + 1)
        for k in which
    ]
    points = parts[0] if len(parts) == 1 else parts[0] + parts[1]
    points.add_field("velocity", (2,), "m/s")
    points["velocity"] = np.where(points["tag"][:, None] == 1, 1.0, -1.0) * [p["speed"], 0.0]
    return points


def free_centre(shape: dict[str, Any], centre: Any, points: Any) -> Any:
    """The centre of a rigid body (m), moved back if it would start inside of points' domains.

    Domains at an edge reach beyond it by parts of a cell, and their corners are what touches.
    Collective.
    """
    half, centre = points["l0"], np.array(centre)
    corners = np.concatenate([points["x"] + half * signs for signs in ((-1, -1), (-1, 1))])
    surface, back = mpm.RigidBody(shape_of(shape, centre), name="trial").surface, 0.0
    for _ in range(20):
        gap = surface.probe(corners + np.array([back, 0.0]))[0].min(initial=np.inf)
        gap = points.comm.allreduce(float(gap), op=MPI.MIN)
        if gap >= 0.0:
            break
        back += 0.05 * H
    return centre - [back, 0.0]


def build(p: dict[str, Any], basis: str, stabilisation: str, comm: MPI.Comm) -> Example:
    """Make the problem ready. Collective."""
    grid, way, law = squares(comm), p["way"], law_of(p)
    points = moving(p, grid, (1,) if way == "rigid" else (0, 1))
    own = way == "fields"
    spaces = [mpm.Space(grid, basis, **({"tag": k + 1} if own else {})) for k in range(1 + own)]
    u, v = [V.increment for V in spaces], [V.test for V in spaces]
    F = sum(mpm.momentum(law, points, u[k], v[k]) for k in range(1 + own))
    rigid: list[Rigid] = []
    if way == "rigid":
        shape = p["shapes"][0]
        centre = free_centre(shape, p["centres"][0], points)
        m = p["mass"] * DENSITY * shape["radius"] ** 2
        body = mpm.RigidBody(
            shape_of(shape, centre), mass=m, inertia=0.5 * m * shape["radius"] ** 2,
            velocity=(p["speed"], 0.0), name="body",
        )  # fmt: skip
        F += mpm.contact(body, points, u[0], v[0], friction=p["friction"])
        rigid.append(Rigid(body, corners_of(shape, centre) - body.position, 0.3 * H))
    if own:
        rims = [
            mpm.Boundary.from_polygon(points, corners_of(s, c), rule=1, spacing=H / 4)
            for s, c in zip(p["shapes"], p["centres"])
        ]
        F += mpm.contact_between(rims, u, v, friction=p["friction"])
    problem = mpm.Newmark(F, u if own else u[0], points, stabilisation=stabilisation)

    def go(k: int) -> None:
        problem.step(p["time"] * k / STEPS)

    kernel = None if p["law"] == "neo-Hookean" else law
    return Example(problem, STEPS, go, {1: kernel, 2: kernel}, H, rigid=rigid, dynamic=True)
