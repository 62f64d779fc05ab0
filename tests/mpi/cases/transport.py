"""Bodies that pass rank borders, and what ranks must know of each other's nodes and cells."""

from __future__ import annotations

import numpy as np
import ufl
from dolfinx import fem, mesh

import dolfinmpm as mpm

from .common import COMM, hencky, run, sums


def column():
    """A column across all ranks that compacts, with points that change rank, and even shares."""
    grid = mesh.create_rectangle(COMM, [(0, 0), (12.5, 50)], (4, 16), mesh.CellType.quadrilateral)
    points = mpm.fill(grid, mpm.Box((0, 0), (12.5, 50)), 2, 80.0)
    V = mpm.Space(grid, "gimp")
    g = fem.Constant(grid, (0.0, 0.0))
    F = hencky(points, V, nu=0.0) - ufl.inner(points.density * g, V.test) * points.dX
    bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
    problem, figures = run(points, V, F, bcs, [(0, -10 * k / 20) for k in range(1, 21)], g)
    assert max(record.imbalance for record in problem.history) <= 1.1
    assert COMM.size == 1 or points.partition is not None
    return figures


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

    bcs = [c for i in range(dimension) for c in mpm.prescribed(V, anywhere, i, increment=step)]
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
    # nothing but rounding is left of these
    for name in ("stress", "stress squared"):
        figures.pop(name)
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

    from dolfinmpm.assembly.stencilsums import add_vector

    where = points.placement()
    basis = V.basis.grown(V.basis.reach(where)[0])
    s = basis.stencils(where)
    sums_ = basis.nodes.vector(1)
    flux = np.column_stack([points["V"], 2 * points["V"], 3 * points["V"]])
    nodal = sums_.array.reshape(-1, 1)
    add_vector(s, 0, s.groups.size - 1, np.ascontiguousarray(flux[s.order]), 0, nodal)
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
    bcs += mpm.prescribed(V, lambda x: np.isclose(x[1], 4) & (x[0] < 4.5), 1, increment=push)
    g = fem.Constant(grid, (0.0, 0.0))
    F = hencky(points, V) - ufl.inner(g, V.test) * points.dX
    return run(points, V, F, bcs, [(0.0, 0.0)] * 3, g)[1]
