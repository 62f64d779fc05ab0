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


def vibrating_bar(problem=mpm.Newmark, h=1.0, basis="gimp", v0=0.1, per_cell=2, **options):
    """A bar of 25 m, fixed at the left, that swings in its first mode, linearly in 10 s."""
    grid = mesh.create_interval(MPI.COMM_WORLD, round(35 / h), [0.0, 35.0])
    points = mpm.fill(grid, mpm.Box((0.0,), (25.0,)), per_cell, 1.0)
    V = mpm.Space(grid, basis)
    F = mpm.momentum(mpm.materials.Hencky(E=100.0, nu=0.0), points, V.increment, V.test)
    points.add_field("velocity", (1,), "m/s", lambda x: v0 * np.sin(np.pi * x.T / 50))
    return problem(F, V.increment, points, mpm.fixed(V, "left"), **options)


def disc(
    problem=mpm.GeneralisedAlpha, basis="gimp", velocity=None, E=1e4, dimension=2, per_cell=2,
    stabilisation="none", **options,
):  # fmt: skip
    """A free elastic disc, or ball, eight cells across, in the middle of its grid; it turns."""
    n, comm = (14 if dimension == 2 else 8), MPI.COMM_WORLD
    radius = 4.0 if dimension == 2 else 2.0
    if dimension == 2:
        grid = mesh.create_rectangle(comm, [(0, 0), (n, n)], (n, n), mesh.CellType.quadrilateral)
    else:
        corners = [(0, 0, 0), (n, n, n)]
        grid = mesh.create_box(comm, corners, (n, n, n), mesh.CellType.hexahedron)
    centre = np.full(dimension, 0.5 * n) + np.array([0.13, -0.07, 0.21])[:dimension]
    points = mpm.fill(grid, mpm.Ball(centre, radius), per_cell, 1.0)
    V = mpm.Space(grid, basis)
    F = mpm.momentum(mpm.materials.Hencky(E=E, nu=0.3), points, V.increment, V.test)

    def turning(x):
        x = x - centre[:, None]
        return np.stack([-x[1], x[0], *np.zeros_like(x[2:])], axis=1)

    points.add_field("velocity", (dimension,), "m/s", velocity or turning)
    options = {"stabilisation": stabilisation, **options}
    return problem(F, V.increment, points, (), **options)


def two_blocks(friction=0.0, basis="gimp", upper=(0.4, 2.5), top=2.45, moduli=(1e3, 4e3), nu=0.2,
               **options):  # fmt: skip
    """Two blocks on each other with fields of their own; the interface is off the grid's lines.

    Returns:
        The points, the Spaces, the weak form without loads, and its contact term's boundaries.
    """
    grid = mesh.create_rectangle(
        MPI.COMM_WORLD, [(0, 0), (3.5, 3)], (7, 6), mesh.CellType.quadrilateral
    )
    low, level = (0.0, 3.0), 1.3
    parts = [mpm.Box((low[0], 0), (low[1], level)), mpm.Box((upper[0], level), (upper[1], top))]
    bodies = [
        mpm.fill(grid, part, 2 + k, 1.0, tag=k + 1, aligned="body") for k, part in enumerate(parts)
    ]
    points = bodies[0] + bodies[1]
    spaces = [mpm.Space(grid, basis, tag=k) for k in (1, 2)]
    u, v = [V.increment for V in spaces], [V.test for V in spaces]
    laws = [mpm.materials.Hencky(E=E, nu=nu) for E in moduli]
    F = sum(mpm.momentum(laws[k], points, u[k], v[k]) for k in (0, 1))

    def along(a, b):
        ends = [(a, level), (b, level)]
        return mpm.Boundary.from_polygon(points, ends, closed=False, rule=1, spacing=0.25)

    boundaries = along(*upper), along(*low[::-1])
    F += mpm.contact_between(boundaries, u[::-1], v[::-1], friction=friction, **options)
    return points, spaces, F, boundaries
