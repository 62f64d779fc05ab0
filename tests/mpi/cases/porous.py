"""Soil and water: the same on any number of ranks."""

from __future__ import annotations

import numpy as np
from dolfinx import fem, mesh

import dolfinmpm as mpm

from .common import COMM, sums
from .restart import REPEATABLE, goes_on


def consolidation():
    """A block in a corner of the grid that is squeezed from one side and drains at its top.

    Cells grow away from the corner, and so differ from rank to rank.
    """
    lines = [mpm.zoned_line(0.0, end, (0.0, 0.5), (0, 4, n)) for end, n in ((3.0, 14), (2.0, 8))]
    grid = mpm.create_lattice(COMM, lines)
    points = mpm.fill(grid, mpm.Box((0, 0), (1.2, 0.8)), 2, 2000.0, exact=True)
    V, Q = mpm.Space(grid, "gimp"), mpm.Space(grid, "linear", shape=())
    top = mpm.Surface(points, lambda x: x[1] > 0.8 - 1e-9, (0, 1))
    F = mpm.poromechanics(
        mpm.materials.Hencky(E=1e5, nu=0.3), points, (V.increment, Q.increment), (V.test, Q.test),
        permeability=mpm.kozeny_carman(1e-3, 0.4), porosity=0.4, gravity=(0.0, -9.81),
        drained=top, fluid=mpm.Fluid(bulk_modulus=1e7),
    )  # fmt: skip
    load = fem.Constant(grid, (0.0, 0.0))
    F += top.traction(load, V.test)
    bcs = mpm.fixed(V, "bottom") + mpm.rollers(V, "left")
    problem = mpm.Transient(
        F, [V.increment, Q.increment], points, bcs, stabilisation=["ghost", "ghost"]
    )
    iterations = []
    for k, t in enumerate((0.1, 1.0, 5.0, 20.0)):
        load.value[1] = -3e3 * (k + 1)
        iterations.append(problem.step(t).iterations)
    weight = np.sin(1.0 + points["id"])
    carried = {
        name: COMM.allreduce(float(weight @ points[name]))
        for name in ("pressure", "porosity", "density")
    }
    return {
        "iterations": iterations,
        "unknowns": [record.unknowns for record in problem.history],
        "count": points.total,
        "carried": list(carried.values()),
        **sums(points, "x", "stress"),
    }


def wet_layers():
    """A layer of each of two soils, with a wall beside them; ranks have points of one or both."""
    lines = [mpm.zoned_line(0.0, end, (0.0, 0.5), (0, 4, n)) for end, n in ((3.0, 14), (2.0, 8))]
    grid = mpm.create_lattice(COMM, lines)
    points = mpm.fill(grid, mpm.Box((0.13, 0), (1.2, 0.5)), 2, 2000.0, exact=True, tag=1)
    points = points + mpm.fill(grid, mpm.Box((0.13, 0.5), (1.2, 0.8)), 2, 1800.0, exact=True, tag=2)
    V, Q = mpm.Space(grid, "gimp"), mpm.Space(grid, "gimp", shape=())
    u, v, p = V.increment, V.test, Q.increment
    top = mpm.Surface(points, lambda x: x[1] > 0.8 - 1e-9, (0, 1))
    wall = mpm.Boundary.from_polygon(points, [(0.13, 0.8), (0.13, 0)], closed=False, name="wall")
    F = top.traction(fem.Constant(grid, (0.0, -3e3)), v)
    for tag, E, k, drained in ((1, 1e6, 1e-4, ()), (2, 1e5, 1e-3, top)):
        law = mpm.materials.Hencky(E=E, nu=0.3)
        water = {"permeability": k, "porosity": 0.2 + 0.1 * tag, "drained": drained, "tag": tag}
        F += mpm.poromechanics(law, points, (u, p), (v, Q.test), gravity=(0.0, -9.81), **water)
        held = {"law": law, "direction": "normal", "pore_pressure": p, "tag": tag}
        F += mpm.dirichlet(wall, u, v, **held)
    problem = mpm.Transient(F, [u, p], points, mpm.fixed(V, "bottom"), stabilisation=["ghost"] * 2)
    iterations = [problem.step(t).iterations for t in (0.1, 1.0, 5.0)]
    weight = np.sin(1.0 + points["id"])
    carried = [COMM.allreduce(float(weight @ points[k])) for k in ("pressure", "porosity")]
    section = mpm.section_forces(points, (0.6, 0.4), (0, 1))
    return {
        "iterations": iterations,
        "count": points.total,
        "carried": carried,
        "force": wall.force().tolist(),
        "outflow": top.outflow(),
        "section": [*section.force, *section.moment, *section.centre, section.area],
        **sums(points, "x", "stress"),
    }


def nested():
    """A body beside cells of several ranks that drains, its pressure on cells of twice the size."""
    return _drained("gimp", "ghost")


def nested_bases():
    """The same with nodes that are tied twice: by joined cells and by the stabilisation."""
    return {basis: _drained(basis, "aggregation") for basis in ("gimp", "bspline2")}


def nested_restart():
    """The same, broken off and gone on with."""
    options = {"petsc_options": REPEATABLE, "tolerance": 1e-12}
    return goes_on(lambda: _nested("gimp", "ghost", **options), 4, moves=False)


def _nested(basis, stabilisation, **options):
    """The problem, and what takes its next step."""
    grid = mesh.create_rectangle(COMM, [(0, 0), (3, 2)], (22, 14), mesh.CellType.quadrilateral)
    points = mpm.fill(grid, mpm.Box((0, 0), (1.3, 0.9)), 2, 2000.0, exact=True)
    V, Q = mpm.Space(grid, basis), mpm.Space(grid, basis, shape=(), coarsen=2)
    top = mpm.Surface(points, lambda x: x[1] > 0.9 - 1e-9, (0, 1))
    F = mpm.poromechanics(
        mpm.materials.Hencky(E=1e5, nu=0.3), points, (V.increment, Q.increment),
        (V.test, Q.test), permeability=1e-3, porosity=0.4, drained=top,
    )  # fmt: skip
    F += top.traction(fem.Constant(grid, (0.0, -3e3)), V.test)
    bcs = mpm.fixed(V, "bottom") + mpm.rollers(V, "left")
    problem = mpm.Transient(
        F, [V.increment, Q.increment], points, bcs, stabilisation=[stabilisation] * 2, **options
    )
    times = 1e-6, 1.0, 20.0, 30.0
    return problem, lambda: problem.step(times[len(problem.history)])


def _drained(basis, stabilisation):
    problem, step = _nested(basis, stabilisation)
    for _ in range(3):
        step()
    points = problem.points
    weight = np.sin(1.0 + points["id"])
    return {
        "unknowns": [record.unknowns for record in problem.history],
        "cells": [problem.here.active_cells, problem.here.ghost_facets],
        "pressure": COMM.allreduce(float(weight @ points["pressure"])),
        **sums(points, "x", "stress", "cell_offset"),
    }


def waves():
    """A block that falls onto its base and drains, by the generalised-α method, with the soil's
    acceleration in Darcy's law."""
    grid = mesh.create_rectangle(COMM, [(0, 0), (3, 2)], (24, 16), mesh.CellType.quadrilateral)
    points = mpm.fill(grid, mpm.Box((0, 0), (1.2, 0.8)), 2, 2000.0, exact=True)
    V, Q = mpm.Space(grid, "gimp"), mpm.Space(grid, "linear", shape=())
    top = mpm.Surface(points, lambda x: x[1] > 0.8 - 1e-9, (0, 1))
    F = mpm.poromechanics(
        mpm.materials.Hencky(E=1e5, nu=0.3), points, (V.increment, Q.increment), (V.test, Q.test),
        permeability=1e-3, porosity=0.4, gravity=(0.0, -9.81), drained=top, rho_inf=0.8,
        inertia=True, fluid=mpm.Fluid(bulk_modulus=1e7),
    )  # fmt: skip
    problem = mpm.GeneralisedAlpha(
        F, [V.increment, Q.increment], points, mpm.fixed(V, "bottom") + mpm.rollers(V, "left"),
        rho_inf=0.8, stabilisation=["ghost", "ghost"],
    )  # fmt: skip
    for t in (0.005, 0.01, 0.02):
        problem.step(t)
    weight = np.sin(1.0 + points["id"])
    names = "pressure", "density", "storage_rate"
    return {
        "iterations": [record.iterations for record in problem.history],
        "carried": [COMM.allreduce(float(weight @ points[name])) for name in names],
        **sums(points, "x", "velocity", "stress", "gradient_rate", "start_acceleration"),
    }


def first_pressures():
    """Water with a table within a body: the gradient before the first step follows from it."""
    figures = {}
    squares, triangles = mesh.CellType.quadrilateral, mesh.CellType.triangle
    for basis, cell in (("gimp", squares), ("bspline2", squares), ("linear", triangles)):
        grid = mesh.create_rectangle(COMM, [(0, 0), (3, 2)], (11, 7), cell)
        points = mpm.fill(grid, mpm.Box((0, 0), (2.5, 1.7)), 2, 2000.0)
        V, Q = mpm.Space(grid, basis), mpm.Space(grid, "linear", shape=())
        points.add_field("pressure", (), "Pa")
        x = points["x"]
        points["pressure"] = 9810.0 * np.maximum(1.2 + 0.1 * x[:, 0] - x[:, 1], 0.0)
        F = mpm.poromechanics(
            mpm.materials.Hencky(E=1e5, nu=0.3), points, (V.increment, Q.increment),
            (V.test, Q.test), permeability=1e-3, porosity=0.4, gravity=(0.0, -9.81), theta=0.5,
        )  # fmt: skip
        bcs = mpm.fixed(V, "bottom") + mpm.rollers(V, "left")
        problem = mpm.Transient(
            F, [V.increment, Q.increment], points, bcs, stabilisation=["ghost", "ghost"]
        )
        problem.operator()
        low = points["x"][:, 1] < 0.5
        slope = points["pressure_gradient"][low] - [981.0, -9810.0]
        worst = float(np.abs(slope).max(initial=0.0))
        assert worst < 1e-7, worst
        assert not points["flow_known"][low].any()
        figures[basis] = sums(points, "pressure_gradient")
    return figures
