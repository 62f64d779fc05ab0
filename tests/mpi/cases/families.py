"""Points that split and merge while they move across rank borders."""

from __future__ import annotations

import numpy as np
from dolfinx import mesh
from mpi4py import MPI

import dolfinmpm as mpm

from .common import COMM, sums
from .restart import REPEATABLE, block, goes_on


def by_number(points, k, share):
    """Some of the points, chosen by their numbers: the same on any number of ranks."""
    return np.modf(np.abs(np.sin(1.0 + points["id"] % 99991 + 7.0 * k)) * 1e4)[0] < share


def shared_families(points):
    """Number of families with siblings on several ranks."""
    parents = mpm.families(points).parent
    found = COMM.allgather(np.unique(parents[parents >= 0]))
    return int((np.unique(np.concatenate(found), return_counts=True)[1] > 1).sum())


def splits_and_merges():
    """A thousand splits and merges of a body that goes to and fro: no point is lost or doubled."""
    figures = {}
    for kind, times in (("quadrilateral", 1000), ("triangle", 100)):
        grid = mesh.create_unit_square(COMM, 8, 8, mesh.CellType[kind])
        points = mpm.fill(grid, mpm.Box((0.3, 0.3), (0.7, 0.7)), 1, 2.0)
        points.add_field("velocity", (2,), "m/s")
        points.add_field("velocity_gradient", (2, 2), "1/s")
        points["velocity"] = np.sin(9 * points["x0"])
        points["velocity_gradient"] = np.cos(9 * points["x0"])[:, :, None] * (1.0, -0.5)
        limit, apart, first = 5 * points.total, 0, None
        for k in range(times):
            points["x"] += 0.01 * np.array([np.cos(0.1 * k), np.sin(0.1 * k)])
            points.locate()
            if k % 2 == 0 and points.total < limit:
                shallow = mpm.families(points).level < 3
                change = mpm.split(points, shallow & by_number(points, k, 0.15))
            else:
                apart += shared_families(points)
                change = mpm.merge(points, 1e-6, allowed=by_number(points, k, 0.95))
            first = first or change.before
            assert abs(change.after.number - change.before.number) == 3 * change.count
            ids = np.concatenate(COMM.allgather(points["id"]))
            assert np.unique(ids).size == len(ids) == points.total
            for name in ("mass", "volume", "momentum", "kinetic_energy"):
                now, then = getattr(change.after, name), getattr(first, name)
                assert np.allclose(now, then, rtol=1e-11, atol=1e-12), name
        assert COMM.size == 1 or apart > 10, "no family was on several ranks"
        figures[kind] = {
            "count": points.total,
            "ids": COMM.allreduce(int((points["id"] % 99991).sum()), op=MPI.SUM),
            "spin": first.angular_momentum.tolist(),
            **sums(points, "x", "x0", "l0", "velocity", "velocity_gradient"),
        }
    return figures


def refined_block():
    """A block that yields; its foot splits, and what is alike merges, with a restart between."""

    def build():
        problem, step = block(petsc_options=REPEATABLE, tolerance=1e-12)

        def steps():
            k = len(problem.history)
            if k in (2, 3):
                assert mpm.split(problem.points, lambda x: x[0] + x[1] > 5.5 + k).count
            if k == 6:
                assert mpm.merge(problem.points, 0.02).count
            return step()

        return problem, steps

    return goes_on(build, 9)
