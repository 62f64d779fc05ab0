"""Loads on surfaces, and a load that is found with the increment."""

from __future__ import annotations

import numpy as np
from dolfinx import fem, mesh
from scenes import arch

import dolfinmpm as mpm

from .common import COMM, sums


def surface_loads():
    """A footing and a follower pressure on a body whose surface points change rank."""
    grid = mesh.create_rectangle(COMM, [(0, 0), (9, 9)], (9, 9), mesh.CellType.quadrilateral)
    points = mpm.fill(grid, mpm.Box((0, 0), (6.3, 5.6)), 2, 1.0)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    top = mpm.Surface(points, lambda x: np.isclose(x[1], 5.6) & (x[0] < 3), (0, 1), name="top")
    side = mpm.Surface(points, lambda x: np.isclose(x[0], 6.3), (1, 0), name="side")
    s, p = fem.Constant(grid, 0.0), fem.Constant(grid, 0.0)
    foot = mpm.RigidFooting(top, s, E=1e3)
    F = mpm.momentum(mpm.materials.Hencky(E=1e3, nu=0.3), points, u, v)
    F += foot.contact(u, v) + side.pressure(p, u, v) + side.force((0.0, -5.0), v)
    bcs = mpm.rollers(V, "left") + mpm.fixed(V, "bottom")
    problem = mpm.QuasiStatic(F, u, points, bcs, stabilisation="ghost")
    loads, moved = [], 0
    for k in range(1, 5):
        s.value, p.value = 0.3 * k, -20.0 * k
        moved += problem.step().migrated
        loads += [foot.load(), *foot.reaction(), *side.mean_displacement()]
    return {
        "moved": moved, "areas": [top.total_area, side.total_area], "loads": loads,
        **sums(points, "x", "F", "stress", "top_offset", "side_area"),
    }  # fmt: skip


def snap_through():
    """A shallow arch past its limit point, the load factor found with the increment."""
    figures = {}
    for control in ("spherical", "displacement"):
        problem, _ = arch(control)
        points = problem.points
        for _ in range(16):
            problem.step()
        records = problem.history
        figures[control] = {
            "moved": sum(record.migrated for record in records),
            "factors": [record.factor for record in records],
            "displacements": [record.displacement for record in records],
            **sums(points, "x", "F", "stress", "arc_increment"),
        }
    figures["moved"] = sum(part["moved"] for part in figures.values())
    return figures
