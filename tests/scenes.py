"""Scenes and helpers that tests in serial and on several ranks share."""

from __future__ import annotations

import numpy as np
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

import dolfinmpm as mpm


def arch(control="spherical", **options):
    """A shallow arch under a load that is found with the increment."""
    comm, cells = MPI.COMM_WORLD, mesh.CellType.quadrilateral
    grid = mesh.create_rectangle(comm, [(0, -2), (10, 2)], (20, 8), cells)
    shape = mpm.Where(lambda x: np.abs(x[1] - np.sin(0.05 * np.pi * x[0]) ** 2) < 0.4)
    points = mpm.fill(grid, shape, 4, 1.0)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    weight = fem.Constant(grid, (0.0, -100.0))
    F = mpm.momentum(mpm.materials.Hencky(E=1e6, nu=0.2), points, u, v)
    F -= ufl.inner(weight, v) * points.dX
    path = {"control": control, "first": 1.0, "max_length": 0.08}
    if control == "displacement":
        volume = comm.allreduce(float(points["V0"].sum()))
        down = -v[1] / volume * points.dX
        path = {"control": down, "length": 0.06, "max_length": 0.06}
    bcs = mpm.fixed(V, "left") + mpm.rollers(V, "right")
    path |= {"load": weight, "stabilisation": "ghost"} | options
    problem = mpm.ArcLength(F, u, points, bcs, **path)
    return problem, problem.step


def expect(kind, call):
    """The message of the error of that kind that a call must end with."""
    try:
        call()
    except kind as error:
        return str(error)
    raise AssertionError(f"rank {MPI.COMM_WORLD.rank} saw no {kind.__name__}")
