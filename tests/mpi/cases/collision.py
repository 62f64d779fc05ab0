"""Bodies with velocities of their own that collide across the borders of ranks."""

from __future__ import annotations

import numpy as np
import ufl
from dolfinx import mesh

import dolfinmpm as mpm

from .common import COMM, sums


def colliding_bodies():
    """A disc is thrown aslant at a block that lies on the bottom, and rubs along it."""
    grid = mesh.create_rectangle(COMM, [(0, 0), (2.4, 1.6)], (24, 16), mesh.CellType.quadrilateral)
    points = mpm.fill(grid, mpm.Box((0.3, 0), (2.2, 0.5)), 2, 1000.0, tag=1)
    points += mpm.fill(grid, mpm.Disc((0.7, 0.76), 0.2), 2, 1000.0, tag=2)
    V = mpm.Space(grid, "gimp")
    F = mpm.momentum(mpm.materials.VonMises(E=1e6, nu=0.3, radius=2e4), points, V.increment,
                     V.test)  # fmt: skip
    F -= ufl.inner(points.density * ufl.as_vector((0.0, -10.0)), V.test) * points.dX
    points.add_field("velocity", (2,), "m/s")
    points["velocity"] = np.where(points["tag"][:, None] == 2, (3.0, -1.0), (0.0, 0.0))
    figures = {}
    for gap_test in (True, False):
        collision = mpm.Collision((1, 2), friction=0.3, gap_test=gap_test)
        bcs = mpm.fixed(V, "bottom")
        problem = mpm.Explicit(F, V.increment, points, bcs, collision=collision)
        for k in range(4):
            problem.step(0.04 * (k + 1))
        if gap_test:
            assert problem.collision_force.shape == (2,)
        energies = problem.energies()
        moved = sum(record.migrated for record in problem.history)
        figures[str(gap_test)] = {
            "parts": [record.parts for record in problem.history],
            "moved": (moved > 0) if COMM.size > 1 else None,
            "momentum": list(problem.momentum()), "force": list(problem.collision_force),
            "energies": [energies.kinetic, energies.strain, *energies.losses.values()],
            **sums(points, "x", "velocity", "F", "stress"),
        }  # fmt: skip
    return figures
