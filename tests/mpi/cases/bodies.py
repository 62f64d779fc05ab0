"""Bodies from data, joined, cut and filled up: the same on any number of ranks."""

from __future__ import annotations

import tempfile
import warnings
from pathlib import Path

import meshio
import numpy as np
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI
from scenes import expect
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkIOXML import vtkXMLPUnstructuredGridReader

import dolfinmpm as mpm
from dolfinmpm._platform import errors
from dolfinmpm.body.loadbalance import imbalance

from .common import COMM, hencky, sums

from_arrays = mpm.MaterialPoints.from_arrays


def square(n=6, kind="quadrilateral"):
    """A grid of [0, 1]²."""
    return mesh.create_unit_square(COMM, n, n, mesh.CellType[kind])


def numbered(points, *names):
    """Sums over all points that tell whether each has the number that it should."""
    weight = np.sin(1.0 + points["id"])
    return {
        name: list(np.ravel(COMM.allreduce(np.tensordot(weight, points[name], 1))))
        for name in ("x", "V0", "density", "tag", *names)
    } | {"count": points.total, "ids": COMM.allreduce(int(points["id"].sum()))}


def points_from_data():
    """Arrays however they are spread, tables and meshes."""
    rng = np.random.default_rng(5)
    x, volume = rng.uniform(0, 1, (60, 2)), rng.uniform(1e-3, 2e-3, 60)
    # some on the facets between cells, and so between ranks
    x[:20] = np.round(6 * x[:20]) / 6 + 1e-3 * np.arange(20)[:, None] * (0, 1)
    x = np.clip(x, 0, 1)
    everything = np.arange(60)
    spreads = {
        "everywhere": everything,
        "on the first": everything[: 60 if COMM.rank == 0 else 0],
        "on the last": everything[: 60 if COMM.rank == COMM.size - 1 else 0],
        "scattered": everything[COMM.rank :: COMM.size],
        "overlapping": everything[10 * COMM.rank : 60 - 10 * (COMM.size - 1 - COMM.rank)],
    }
    figures = {}
    for kind in ("quadrilateral", "triangle"):
        grid = square(kind=kind)
        for spread, rows in spreads.items():
            points = from_arrays(
                grid, x[rows], volume[rows], lambda x: 1 + x[0], tag=rows % 3,
                fields={"load": 3 * x[rows]},
            )  # fmt: skip
            assert np.array_equal(points["load"], 3 * points["x"])
            figures[f"{kind} {spread}"] = numbered(points, "load")
        assert all(
            np.allclose(figures[f"{kind} {spread}"][name], figures[f"{kind} everywhere"][name])
            for spread in spreads
            for name in ("x", "V0", "density", "tag", "count", "ids", "load")
        )
    folder = COMM.bcast(tempfile.mkdtemp() if COMM.rank == 0 else None)
    path = Path(folder) / "points.csv"
    if COMM.rank == 0:
        rows = [f"{a},{b},{c},{k % 2}" for k, ((a, b), c) in enumerate(zip(x, volume))]
        path.write_text("\n".join(["x,y,volume,tag", *rows]), encoding="utf-8")
    COMM.barrier()
    figures["table"] = numbered(mpm.MaterialPoints.from_csv(square(), path, density=2.0))
    nodes = np.array([[0.1, 0.1], [0.6, 0.15], [0.7, 0.8], [0.1, 0.7], [0.9, 0.2]])
    cells = [("quad", [[0, 1, 2, 3]]), ("triangle", [[1, 4, 2]])]
    soils = meshio.Mesh(nodes, cells, cell_data={"gmsh:physical": [[1], [2]]})
    body = mpm.MaterialPoints.from_mesh(square(), soils, {1: 5.0, 2: 6.0}, degree=4)
    figures["mesh"] = numbered(body)
    return figures


def numbers_of_points():
    """Points are numbered alike; their number is known without a call on all ranks."""
    figures = {}
    shape = mpm.Disc((0.45, 0.5), 0.31)
    for kind in ("quadrilateral", "triangle"):
        for exact in (False, True):
            points = mpm.fill(square(kind=kind), shape, 2, 3.0, exact=exact)
            figures[f"{kind} {exact}"] = numbered(points, "l0")
            figures[f"{kind} {exact} error"] = points.volume_error + 1
    solid = mesh.create_unit_cube(COMM, 3, 3, 3, mesh.CellType.tetrahedron)
    ball = mpm.Ball((0.5,) * 3, 0.4)
    figures["tetrahedra"] = numbered(mpm.fill(solid, ball, 1, 1.0, exact=True), "l0")
    box = mpm.Box((0.05, 0.1), (0.9, 0.7))
    figures["aligned"] = numbered(mpm.fill(square(), box, 2, 1.0, aligned="body"))
    if COMM.rank == 0:
        figures["total"] = points.total
    return figures


def staged():
    """A body of two parts that is dug out and filled up while it moves across rank borders."""
    grid = mesh.create_rectangle(COMM, [(0, 0), (8, 8)], (8, 8), mesh.CellType.quadrilateral)
    points = mpm.fill(grid, mpm.Box((1, 0), (5, 2)), 2, 2.0, tag=1)
    points = points + mpm.fill(grid, mpm.Box((1, 2), (5, 4.5)), 2, 3.0, tag=2)
    V = mpm.Space(grid, "gimp")
    g = fem.Constant(grid, (0.0, 0.0))
    F = hencky(points, V, E=4e3) - ufl.inner(points.density * g, V.test) * points.dX
    problem = mpm.QuasiStatic(F, V.increment, points, mpm.fixed(V, "bottom"))
    changes, moved = [], 0

    def steps(*loads):
        nonlocal moved
        for load in loads:
            g.value[:] = load
            moved += problem.step().migrated

    steps((5.0, -20.0), (10.0, -40.0), (15.0, -60.0), (20.0, -80.0))
    changes.append(points.remove(lambda x: (x[1] > 2.5) & (x[0] > 4)))
    steps((20.0, -80.0), (15.0, -80.0))
    corner = mpm.fill(grid, mpm.Box((7, 5), (8, 7)), 2, 1.0, tag=3)
    corner.add_field("water", (), "Pa", 2.0)
    changes.append(points.add(corner))
    assert points.add_field("water", ()).array.min(initial=2.0) == 2.0
    changes.append(points.remove(tag=3))
    steps((10.0, -70.0))
    assert points.error_in_fields() is None
    ids = np.concatenate(COMM.allgather(points["id"]))
    assert np.unique(ids).size == points.total == COMM.allreduce(len(points))
    return {
        "changes": [[change.count, change.mass] for change in changes],
        "moved": moved > 0 if COMM.size > 1 else None,
        **numbered(points, "F", "stress"),
        **sums(points, "x", "l", "V"),
    }


def errors_of_bodies():
    """What is wrong with a body on one rank is raised on all."""

    grid, last = square(), COMM.rank == COMM.size - 1
    x = np.array([[0.1, 0.1], [0.9, 0.8]])
    bad = np.array([[0.1, 0.1], [0.1, 0.1]])
    expect(errors.ParameterError, lambda: from_arrays(grid, bad if last else x, 1e-3, 1.0))
    message = expect(
        errors.PointsOutsideGridError, lambda: from_arrays(grid, 7 * x if last else [], 1e-3, 1.0)
    )
    if COMM.size > 1:
        volume = 2e-3 if last else 1e-3
        message = expect(errors.ParameterError, lambda: from_arrays(grid, x, volume, 1.0))
        assert "with different values of volume: " in message
        fields = {"load": [1.0, 2.0]} if last else {}
        message = expect(
            errors.FieldShapeError, lambda: from_arrays(grid, x, 1e-3, 1.0, fields=fields)
        )
        assert "load" in message
    missing = Path("/nowhere/points.csv")
    expect(OSError, lambda: mpm.MaterialPoints.from_csv(grid, missing, density=1.0))
    expect(OSError, lambda: mpm.MaterialPoints.from_mesh(grid, missing, 1.0))
    expect(errors.EmptyShapeError, lambda: from_arrays(grid, [], 1e-3, 1.0))

    points = mpm.fill(grid, mpm.Box((0, 0), (1, 0.5)), 2, 1.0)
    other = mpm.fill(grid, mpm.Box((0, 0.4), (0.1, 0.6)), 2, 1.0)
    expect(errors.ParameterError, lambda: points + other)
    expect(errors.ParameterError, lambda: points.add(other))
    short = np.zeros(len(points) + last, bool)
    expect(errors.FieldShapeError, lambda: points.remove(short))

    def raises(x):
        raise ValueError("no answer here")

    expect(ValueError, lambda: points.remove(raises))
    expect(errors.ParameterError, lambda: points.remove(points["x"][:, 0] > -1))

    V = mpm.Space(grid, "gimp")
    F = hencky(points, V, ghost=False)
    problem = mpm.QuasiStatic(F, V.increment, points, mpm.fixed(V, "bottom"))
    first = COMM.allgather(len(points))
    chosen = next(rank for rank, n in enumerate(first) if n)
    for name in ("V0", "V", "l", "l0", "density", "x", "F"):
        before = points[name].copy()
        if COMM.rank == chosen:
            points[name][0] = -1.0
        expect((errors.ParameterError, errors.PointsOutsideGridError), problem.step)
        points[name] = before
    problem.step()
    return {"total": points.total}


def partitioned():
    """Meshes that are cut so that every rank has its share of a small body."""
    figures = {}
    body = mpm.Box((0.1, 0.1), (3.1, 1.1))
    for kind in (mesh.CellType.triangle, mesh.CellType.quadrilateral):
        scene = COMM, [(0, 0), (12, 6)], (24, 12), kind
        first = mesh.create_rectangle(*scene)
        grid = mesh.create_rectangle(*scene, partitioner=mpm.partitioner(body, first))
        index_map = grid.topology.index_map(2)
        assert index_map.size_global == first.topology.index_map(2).size_global
        points = mpm.fill(grid, body, 3, 1.0)
        most = COMM.allreduce(len(points), op=MPI.MAX) * COMM.size / points.total
        assert most < 1.25, most
        V = mpm.Space(grid, "linear")
        F = mpm.momentum(mpm.materials.Hencky(E=1e3, nu=0.3), points, V.increment, V.test)
        F -= ufl.inner(ufl.as_vector((0.3, -1.0)), V.test) * points.dX
        bcs = mpm.fixed(V, "bottom")
        # needs the cells beyond the facets to other ranks
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            problem = mpm.QuasiStatic(F, V.increment, points, bcs, stabilisation="ghost")
        problem.step()
        figures[kind.name] = {"count": points.total, **sums(points, "x", "stress")}
    return figures


def in_a_corner():
    """A small body in a corner of the grid, shared out by a partition of the lattice's own."""
    grid = mesh.create_rectangle(COMM, [(0, 0), (24, 16)], (24, 16), mesh.CellType.quadrilateral)
    points = mpm.fill(grid, mpm.Box((0, 0), (5, 3)), 3, 2.0, tag=1)
    V = mpm.Space(grid, "gimp")
    # a function that lives with DOLFINx's cells, read at points of other ranks
    pull = fem.Function(fem.functionspace(grid, ("Lagrange", 2, (2,))))
    pull.interpolate(lambda x: np.stack([0.1 * x[0] * x[1], -8.0 + 0.2 * x[0] ** 2]))
    F = hencky(points, V, E=2e2) - ufl.inner(points.density * pull, V.test) * points.dX
    F -= 0.3 * ufl.inner(ufl.grad(pull)[0, 1] * V.test[0], 1.0) * points.dX
    problem = mpm.QuasiStatic(F, V.increment, points, mpm.fixed(V, "bottom"))
    folder = COMM.bcast(tempfile.mkdtemp() if COMM.rank == 0 else None)
    with mpm.ParaView(Path(folder) / "corner.pvd", points, active=True) as output:
        problem.step()
        output.write(1.0)
        assert (points.partition is None) == (COMM.size == 1)
        assert imbalance(points) < 1.2
        points.add(mpm.fill(grid, mpm.Box((5, 0), (7, 3)), 3, 2.0, tag=2))
        problem.step()
        output.write(2.0)
    assert points.error_in_fields() is None
    figures = {"added": numbered(points, "F", "stress")}
    both = points + mpm.fill(grid, mpm.Box((0, 8), (2, 9)), 2, 1.0, tag=3)
    figures["joined"] = numbered(both, "F", "stress")
    if COMM.rank == 0:
        figures["active"] = [
            active_cells(path) for path in sorted(Path(folder).rglob("*grid*.pvtu"))
        ]
        assert len(figures["active"]) == 2
    return figures


def active_cells(path):
    """How many cells of a file are active."""
    reader = vtkXMLPUnstructuredGridReader()
    reader.SetFileName(str(path))
    reader.Update()
    cells = reader.GetOutput().GetCellData()
    return int(vtk_to_numpy(cells.GetArray("active")).sum())


def probes():
    """Places that points of several ranks follow, from rank to rank, while points come and go."""
    grid = mesh.create_rectangle(COMM, [(0, 0), (6, 4)], (12, 8), mesh.CellType.quadrilateral)
    points = mpm.fill(grid, mpm.Box((0, 0), (3, 3)), 2, 1000.0)
    V = mpm.Space(grid, "gimp")
    g = fem.Constant(grid, (0.0, 0.0))
    F = hencky(points, V, E=2e5) - ufl.inner(points.density * g, V.test) * points.dX
    problem = mpm.QuasiStatic(F, V.increment, points, mpm.fixed(V, "bottom"))
    # at a corner, at a face between cells and ranks, and at the middle of a cell
    places = {"crest": (3.0, 3.0), "border": (1.5, 1.5), "inside": (2.2, 0.8)}
    every = {name: mpm.probe(points, place) for name, place in places.items()}
    history, figures = mpm.History(), {}
    for k in range(1, 6):
        g.value[:] = 0.4 * k, -0.8 * k
        problem.step()
        history.record(load=k, **every)
        if k == 3:
            points.add(mpm.fill(grid, mpm.Box((4.5, 0), (5, 0.5)), 2, 1000.0))
    figures["history"] = {name: list(history[name]) for name in history.names}
    for name, one in every.items():
        ours = one.displacement.tolist()
        assert COMM.allgather(ours) == [ours] * COMM.size
        figures[name] = {
            "position": list(one.position), "stress": list(one["stress"].ravel()),
            "weights": list(one.weights),
        }  # fmt: skip
    message = expect(errors.ParameterError, lambda: mpm.probe(points, (0.1, 4.0)))
    assert "from the next material point" in message
    if COMM.size > 1:
        other = 0.1, 0.1 + 0.1 * COMM.rank
        message = expect(errors.ParameterError, lambda: mpm.probe(points, other))
        assert "place" in message
        assert "differs between ranks" in message
    points.remove(lambda x: x[0] + x[1] > 5.7)
    message = expect(errors.ParameterError, lambda: every["crest"].settlement)
    assert "have been removed: make a new probe" in message
    figures["left"] = list(every["inside"].displacement)
    return figures | {"moved": sum(record.migrated for record in problem.history)}
