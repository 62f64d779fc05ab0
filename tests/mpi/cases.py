"""Scenes that give the same figures on any number of ranks; run as `cases.py NAME`."""

from __future__ import annotations

import json
import sys

import numpy as np
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

import dolfinmpm as mpm
from dolfinmpm import errors

COMM = MPI.COMM_WORLD


def sums(points, *names):
    """Weighted sums over all points of the fields and their squares."""
    figures = {}
    for name in names:
        values = points[name].reshape(len(points), int(np.prod(points[name].shape[1:])))
        weight = points["V0"] * (1 + points["x0"].sum(axis=1))
        total = COMM.allreduce(weight @ values)
        square = COMM.allreduce(weight @ values**2)
        figures[name] = [*np.ravel(total), *np.ravel(square)]
    return figures


def hencky(points, V, ghost=True, E=1e4, nu=0.3):
    """Momentum balance, with ghost penalty."""
    u, v = V.increment, V.test
    F = mpm.momentum(mpm.materials.Hencky(E=E, nu=nu), points, u, v)
    return F + mpm.ghost(points, u, v, gamma=E / 30) if ghost else F


def run(points, V, form, bcs, loads, gravity, **options):
    """Steps to the given loads; returns figures."""
    problem = mpm.QuasiStatic(form, V.increment, points, bcs, **options)
    count, mass = points.total, COMM.allreduce(points["density"] @ points["V0"])
    for load in loads:
        gravity.value[:] = load
        problem.step()
        assert points.total == count
        assert abs(COMM.allreduce(points["density"] @ points["V0"]) - mass) < 1e-12 * mass
    moved = sum(record.migrated for record in problem.history)
    return problem, {
        "iterations": [record.iterations for record in problem.history],
        "unknowns": [record.unknowns for record in problem.history],
        "active_cells": problem.system.active_cells,
        "count": count,
        "moved": (moved > 0) if COMM.size > 1 else None,
        **sums(points, "x", "F", "stress", "l", "V"),
    }


def column():
    """A column across all ranks that compacts, with points that change rank."""
    grid = mesh.create_rectangle(COMM, [(0, 0), (12.5, 50)], (4, 16), mesh.CellType.quadrilateral)
    points = mpm.fill(grid, mpm.Box((0, 0), (12.5, 50)), 2, 80.0)
    V = mpm.Space(grid, "gimp")
    g = fem.Constant(grid, (0.0, 0.0))
    F = hencky(points, V, nu=0.0) - ufl.inner(points.density * g, V.test) * points.dX
    bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
    return run(points, V, F, bcs, [(0, -10 * k / 20) for k in range(1, 21)], g)[1]


def triangles():
    """Linear functions on triangles, whose cells have no lattice."""
    grid = mesh.create_rectangle(COMM, [(0, 0), (8, 8)], (8, 8), mesh.CellType.triangle)
    points = mpm.fill(grid, mpm.Box((1.5, 0), (6.2, 5.1)), 3, 80.0)
    V = mpm.Space(grid, "linear")
    g = fem.Constant(grid, (0.0, 0.0))
    F = hencky(points, V) - ufl.inner(points.density * g, V.test) * points.dX
    loads = [(0.5 * k, -1.5 * k) for k in range(1, 5)]
    return run(points, V, F, mpm.fixed(V, "bottom"), loads, g)[1]


def _carried(dimension):
    """A body moved bodily along the diagonal, so that it passes rank borders and their corners."""
    n = 12 if dimension == 2 else 6
    if dimension == 2:
        grid = mesh.create_unit_square(COMM, n, n, mesh.CellType.quadrilateral)
    else:
        grid = mesh.create_unit_cube(COMM, n, n, n, mesh.CellType.hexahedron)
    points = mpm.fill(grid, mpm.Ball((0.3,) * dimension, 0.2), 2, 3.0)
    label = points.add_field("label", (2,), "m")
    label.array[:] = points["x0"][:, :2] * 7
    ids = COMM.allreduce(float(np.sum(points["id"] ** 2)))
    V = mpm.Space(grid, "gimp")
    step = 0.4 / 12

    def anywhere(x):
        return np.full(x.shape[1], True)

    bcs = [c for i in range(dimension) for c in mpm.prescribed(V, anywhere, i, step)]
    g = fem.Constant(grid, (0.0,) * dimension)
    F = hencky(points, V, ghost=False) - ufl.inner(g, V.test) * points.dX
    start = points["x"].copy(), COMM.allreduce(points["V"] @ points["x"])
    _, figures = run(points, V, F, bcs, [(0.0,) * dimension] * 12, g)
    assert np.allclose(points["x"] - points["x0"], 0.4, atol=1e-12)
    assert np.array_equal(points["label"], points["x0"][:, :2] * 7)
    assert COMM.allreduce(float(np.sum(points["id"] ** 2))) == ids
    assert np.abs(points["stress"]).max(initial=0.0) < 1e-7
    # momentum of the motion
    moment = COMM.allreduce(points["V"] @ points["x"]) - start[1]
    assert np.allclose(moment, 0.4 * COMM.allreduce(points["V"].sum()), atol=1e-12)
    return figures | sums(points, "label")


def carried_2d():
    """Along the diagonal of a square."""
    return _carried(2)


def carried_3d():
    """Along the diagonal of a cube."""
    return _carried(3)


def stencils_across_corners():
    """Wide domains see the same nodes as on one rank: nodal volumes and their gradients agree."""
    grid = mesh.create_unit_square(COMM, 9, 9, mesh.CellType.quadrilateral)
    points = mpm.fill(grid, mpm.Box((0.1, 0.1), (0.9, 0.9)), 2, 1.0)
    points["l"] = (0.21, 0.17)  # more than one layer of cells: the halo must grow
    V = mpm.Space(grid, "gimp")
    from dolfinx.la import InsertMode

    from dolfinmpm.assemble import add_vector

    s = V.basis.stencils(points)
    sums_ = V.basis.nodes.vector(1)
    flux = np.column_stack([points["V"], 2 * points["V"], 3 * points["V"]])
    nodal = sums_.array.reshape(-1, 1)
    add_vector(s, 0, s.groups.size - 1, np.ascontiguousarray(flux[s.order]), nodal)
    sums_.scatter_reverse(InsertMode.add)
    mine = nodal[: V.basis.nodes.owned, 0]
    x = V.function_space.tabulate_dof_coordinates()[: V.basis.nodes.owned]
    weights = (1 + x[:, 0] + 2 * x[:, 1] ** 2, np.sin(5 * x[:, 0] + x[:, 1]))
    return {"nodal": [COMM.allreduce(float(w @ mine)) for w in weights]}


def tall():
    """More ranks than cells in places: ranks without a cell and without a point."""
    grid = mesh.create_rectangle(COMM, [(0, 0), (1, 2)], (1, 2), mesh.CellType.quadrilateral)
    points = mpm.fill(grid, mpm.Box((0, 0), (1, 0.75)), 2, 80.0)
    cells = COMM.allgather(grid.topology.index_map(2).size_local)
    assert COMM.size < 3 or min(cells) == 0
    assert COMM.size < 2 or min(COMM.allgather(len(points))) == 0
    V = mpm.Space(grid, "gimp")
    g = fem.Constant(grid, (0.0, 0.0))
    F = hencky(points, V) - ufl.inner(points.density * g, V.test) * points.dX
    bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
    return run(points, V, F, bcs, [(0, -5.0), (0, -10.0)], g)[1]


def two_fields():
    """Displacement and pressure, with a law in UFL, facet, cell and boundary terms."""
    grid = mesh.create_rectangle(COMM, [(0, 0), (6, 6)], (6, 6), mesh.CellType.quadrilateral)
    points = mpm.fill(grid, mpm.Box((1, 0), (5, 4.5)), 2, 1.0)
    V, Q = mpm.Space(grid, "gimp"), mpm.Space(grid, "gimp", shape=())
    u, v, p, q = V.increment, V.test, Q.increment, Q.test
    g = fem.Constant(grid, (0.0, 0.0))
    F = mpm.momentum(mpm.materials.NeoHookean(E=100.0, nu=0.3), points, u, v)
    F -= p * ufl.div(v) * points.dx + ufl.inner(g, v) * points.dX
    F += (ufl.div(u) + p**2) * q * points.dx + ufl.inner(ufl.grad(p), ufl.grad(q)) * points.dX
    F += mpm.ghost(points, u, v, gamma=3.0) + mpm.ghost(points, p, q, gamma=0.2)
    F += 1e-3 * (1 + ufl.inner(u, u)) * ufl.inner(u, v) * ufl.dx
    F -= 0.05 * v[0] * ufl.ds
    bcs = mpm.fixed(V, "bottom") + mpm.prescribed(Q, "bottom", 0)
    problem = mpm.QuasiStatic(F, [u, p], points, bcs)
    for k in range(1, 4):
        g.value[:] = 0.5 * k, -1.0 * k
        problem.step()
    return {
        "iterations": [record.iterations for record in problem.history],
        **sums(points, "x", "F", "stress"),
    }


def driven():
    """Prescribed increments, halved where they are too large, and points that change rank."""
    grid = mesh.create_rectangle(COMM, [(0, 0), (8, 8)], (8, 8), mesh.CellType.quadrilateral)
    points = mpm.fill(grid, mpm.Box((0, 0), (8, 4)), 2, 1.0)
    V = mpm.Space(grid, "gimp")
    push = fem.Constant(grid, -0.25)
    bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
    bcs += mpm.prescribed(V, lambda x: np.isclose(x[1], 4) & (x[0] < 4.5), 1, push)
    g = fem.Constant(grid, (0.0, 0.0))
    F = hencky(points, V) - ufl.inner(g, V.test) * points.dX
    return run(points, V, F, bcs, [(0.0, 0.0)] * 3, g)[1]


def _remedies(basis):
    """A leaning body with small cuts under every remedy, and its conditioning."""
    figures = {}
    for kind in ("none", "ghost", "aggregation", "weak-aggregation", "extended", "soft"):
        grid = mesh.create_rectangle(COMM, [(0, 0), (9, 9)], (9, 9), mesh.CellType.quadrilateral)
        points = mpm.fill(grid, mpm.Box((1.3, 0), (6.2, 5.15)), 3, 1.0)
        V = mpm.Space(grid, basis)
        g = fem.Constant(grid, (0.0, 0.0))
        F = hencky(points, V, ghost=False, E=100.0) - ufl.inner(g, V.test) * points.dX
        remedy = mpm.Stabilisation(kind, E=100.0, nu=0.3)
        bcs = mpm.fixed(V, "bottom")
        # soft stiffness makes Newton's method slow near the end
        tolerance = 1e-5 if kind == "soft" else 1e-9
        options = {"stabilisation": remedy, "max_iterations": 60, "tolerance": tolerance}
        loads = [(0.1, -0.5), (0.2, -1.0)]
        problem, result = run(points, V, F, bcs, loads, g, **options)
        result.pop("moved")
        if kind == "soft":
            result = {"unknowns": result["unknowns"]}
        result["kappa"] = mpm.study.conditioning(problem, 1.0).kappa_K if kind != "none" else 0.0
        figures[kind] = result
    return figures


def remedies_gimp():
    """Remedies with GIMP."""
    return _remedies("gimp")


def remedies_linear():
    """Remedies with linear functions."""
    return _remedies("linear")


def remedies_bspline2():
    """Remedies with quadratic splines, whose facet terms act through their extraction."""
    return _remedies("bspline2")


def errors_on_all_ranks():
    """What goes wrong on one rank is raised on all, and nobody waits."""

    def expect(kind, call):
        try:
            call()
        except kind as error:
            return str(error)
        raise AssertionError(f"rank {COMM.rank} saw no {kind.__name__}")

    grid = mesh.create_unit_square(COMM, 6, 6, mesh.CellType.quadrilateral)
    box = mpm.Box((0, 0), (1, 1))

    def bad_density(x):
        return np.where((x[0] > 0.9) & (x[1] > 0.9), np.nan, 1.0)

    expect(errors.ParameterError, lambda: mpm.fill(grid, box, 2, bad_density))
    expect(errors.ShapeOutsideGridError, lambda: mpm.fill(grid, mpm.Box((0, 0), (2, 1)), 2, 1.0))
    expect(errors.EmptyShapeError, lambda: mpm.fill(grid, mpm.Disc((0.5, 0.5), 1e-5), 2, 1.0))
    triangles_ = mesh.create_unit_square(COMM, 3, 3, mesh.CellType.triangle)
    expect(errors.UnsupportedGridError, lambda: mpm.Space(triangles_, "gimp"))

    # functions that fail where a rank has no point, or on one rank alone
    corner = mpm.Box((0, 0), (0.1, 0.1))
    mpm.fill(grid, corner, 2, lambda x: 80 + 0 * x[1] / x[1].max())
    failing = COMM.rank == COMM.size - 1

    def raises(x):
        if failing:
            raise ValueError("no answer here")
        return np.full(x.shape[1], True)

    expect(ValueError, lambda: mpm.fill(grid, mpm.Where(raises), 2, 1.0))
    expect(ValueError, lambda: mpm.fixed(mpm.Space(grid, "gimp"), raises))
    expect(errors.ParameterError, lambda: mpm.fill(grid, box, 2, lambda x: np.ones(3)))

    points = mpm.fill(grid, box, 2, 1.0)
    V = mpm.Space(grid, "gimp")
    F = hencky(points, V, ghost=False)
    clash = mpm.fixed(V, "bottom")
    clash += mpm.prescribed(V, lambda x: (x[0] < 0.1) & (x[1] < 0.1), 0, 0.5)
    expect(
        errors.ConflictingConditionsError, lambda: mpm.QuasiStatic(F, V.increment, points, clash)
    )
    expect(errors.ParameterError, lambda: mpm.fixed(V, lambda x: x[0] > 5))

    # one corner is pulled out of the grid
    bcs = [
        c for i in (0, 1)
        for c in mpm.prescribed(
            V, lambda x: np.full(x.shape[1], True), i, lambda x: 0.3 * (x[0] * x[1]) ** 2
        )
    ]  # fmt: skip
    problem = mpm.QuasiStatic(F, V.increment, points, bcs)
    before = points["x"].copy()
    first = expect(errors.PointsOutsideGridError, problem.step)
    assert np.array_equal(points["x"], before)
    # a step that cannot converge
    g = fem.Constant(grid, (0.0, 0.0))
    heavy = F - ufl.inner(g, V.test) * points.dX
    problem = mpm.QuasiStatic(
        heavy, V.increment, points, mpm.fixed(V, "bottom"), max_iterations=1, max_halvings=2
    )
    g.value[1] = -1e6
    message = expect(errors.ConvergenceError, problem.step)
    assert len(set(COMM.allgather(message))) == 1
    assert np.array_equal(points["x"], before)
    return {"first": "enlarge the grid" in first}


if __name__ == "__main__":
    result = globals()[sys.argv[1]]()
    if COMM.rank == 0:
        print(json.dumps(result))
