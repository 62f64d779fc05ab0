"""A block of weightless clay with a rigid body in it, in leaves that follow the body."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import meshio
import numpy as np
from mpi4py import MPI

import dolfinmpm as mpm

__all__ = ["Clay", "closed"]


def closed(x: Any, faces: Sequence[Sequence[int]]) -> meshio.Mesh:
    """A closed surface from convex plane faces, anticlockwise from outside, as triangles."""
    triangles = [(f[0], f[k], f[k + 1]) for f in faces for k in range(1, len(f) - 1)]
    return meshio.Mesh(np.asarray(x, float), [("triangle", np.array(triangles))])


class Clay:
    """Undrained clay around a body in 3D: grid, points, problem.

    Args:
        low, high: Corners of the block of clay (m); its top is `high[2]`.
        root: Size of the cells of the grid (m).
        levels: How often they are halved near the body.
        body: The body. Points are left out if more than half of their domain is in it, so that as
            much clay is missing as the body has volume.
        strength: Undrained strength (Pa).
        stiffness: Young's modulus by strength (-).
        friction: Coefficient of friction of the body's surface (-).
        sides: Sides of the block that rollers hold.
        tolerance: Of Newton's method.
    """

    def __init__(
        self,
        low: Sequence[float],
        high: Sequence[float],
        root: float,
        levels: int,
        body: mpm.RigidBody,
        *,
        strength: float,
        stiffness: float = 100.0,
        friction: float = 0.0,
        sides: Sequence[str] = ("left", "right", "front", "back"),
        tolerance: float = 2e-4,
    ):
        # a cell and a half for what heaves
        ends = [np.array(low, float), np.array(high, float)]
        ends[1][2] += root
        counts = np.rint((ends[1] - ends[0]) / root).astype(int)
        lines = [np.linspace(a, b, n + 1) for a, b, n in zip(*ends, counts)]
        self.grid = grid = mpm.create_lattice(MPI.COMM_WORLD, lines)
        size = root / 2**levels
        near = mpm.near(body, size * 1.0001, reach=size, growth=0.7)
        V = mpm.Space(grid, "gimp", domains="volume", refine=near, levels=levels)
        self.points = points = mpm.fill(grid, mpm.Box(low, high), 2, 1800.0, refine=V)
        gap, normal, _ = body.surface.probe(np.ascontiguousarray(points["x"]))
        points.remove(gap <= 0.25 * (points["l"] * np.abs(normal)).sum(axis=1))
        law = mpm.materials.Tresca(stiffness * strength, 0.45, cohesion=strength)
        u, v = V.increment, V.test
        F = mpm.momentum(law, points, u, v, fbar=True)
        F += mpm.contact(body, points, u, v, friction=friction, penalty=10.0)
        bcs = mpm.rollers(V, *sides) + mpm.fixed(V, "bottom")
        self.problem = mpm.QuasiStatic(
            F, u, points, bcs, stabilisation="ghost", tolerance=tolerance
        )
        self.body, self.space = body, V
