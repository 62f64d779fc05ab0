"""Errors of one rank that all ranks must raise."""

from __future__ import annotations

import numpy as np
import ufl
from dolfinx import fem, mesh
from scenes import expect

import dolfinmpm as mpm
from dolfinmpm._platform import errors

from .common import COMM, hencky


def errors_on_all_ranks():
    """What goes wrong on one rank is raised on all, and nobody waits."""

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
    clash += mpm.prescribed(V, lambda x: (x[0] < 0.1) & (x[1] < 0.1), 0, increment=0.5)
    expect(
        errors.ConflictingConditionsError, lambda: mpm.QuasiStatic(F, V.increment, points, clash)
    )
    expect(errors.ParameterError, lambda: mpm.fixed(V, lambda x: x[0] > 5))

    # faces and loads that are wrong on one rank
    expect(errors.EmptyShapeError, lambda: mpm.Surface(points, lambda x: x[0] > 5, (1, 0)))
    expect(ValueError, lambda: mpm.Surface(points, raises, (1, 0)))
    expect(errors.ParameterError, lambda: mpm.Surface(points, lambda x: x[1] < 0.2, (0, 1)))
    zero = np.zeros((len(points), 2))
    bad = zero + (np.nan if failing else 1.0)
    expect(errors.ParameterError, lambda: mpm.Surface.from_arrays(points, zero, bad))
    short = zero[1:] if failing else zero
    expect(errors.FieldShapeError, lambda: mpm.Surface.from_arrays(points, short, zero + 1))

    # one corner is pulled out of the grid
    bcs = [
        c for i in (0, 1)
        for c in mpm.prescribed(
            V, lambda x: np.full(x.shape[1], True), i, increment=lambda x: 0.3 * (x[0] * x[1]) ** 2
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
    # initial stress that the law cannot bear at one corner, and a law without a stress there
    soft = mpm.materials.VonMises(1e4, 0.3, radius=100.0, hardening=-2e3)

    def corner_stress(x):
        stress = np.zeros((x.shape[1], 3, 3))
        stress[:, 0, 0] = np.where((x[0] > 0.9) & (x[1] > 0.9), 1e3, 1.0)
        return stress

    for strain in ("large", "small", "jaumann"):
        message = expect(
            errors.StateError,
            lambda strain=strain: mpm.set_stress(soft, points, corner_stress, strain=strain),
        )
        assert "outside the yield surface" in message
        assert COMM.allreduce(float(np.abs(points["stress"]).sum())) == 0.0
        expect(
            errors.ParameterError,
            lambda strain=strain: mpm.set_stress(
                soft, points, lambda x: np.full((x.shape[1], 3, 3), np.nan), strain=strain
            ),
        )
    F = mpm.momentum(soft, points, V.increment, V.test, strain="small")
    # one corner has moved under another measure
    here = (points["x"] > 0.9).all(axis=1)
    points["moved_under"][here] = 1
    message = expect(errors.StateError, lambda: mpm.QuasiStatic(F, V.increment, points))
    assert f"have moved {COMM.allreduce(int(here.sum()))} under" in message
    assert len(set(COMM.allgather(message))) == 1
    points["moved_under"] = 0
    push = [
        c for i in (0, 1)
        for c in mpm.prescribed(
            V, lambda x: np.full(x.shape[1], True), i, increment=lambda x: -0.1 * (x[0] * x[1]) ** 8
        )
    ]  # fmt: skip
    problem = mpm.QuasiStatic(F, V.increment, points, push, max_halvings=0)
    message = expect(errors.ConvergenceError, problem.step)
    assert "VonMises finds no stress at point" in message, message
    assert len(set(COMM.allgather(message))) == 1
    expect(errors.ParameterError, lambda: mpm.study.write_table([], "table.txt"))
    expect(OSError, lambda: mpm.study.write_table([], "/dev/null/table.csv"))
    expect(OSError, lambda: mpm.study.read_table("/dev/null/table.csv"))
    return {"first": "enlarge the grid" in first}


def sizes_of_one_rank():
    """Sizes of cells that one rank alone refuses, or that depend on the points of the rank."""
    failing = COMM.rank == COMM.size - 1

    def filled(size):
        grid = mpm.create_lattice(COMM, [np.arange(5.0)] * 2)
        points = mpm.fill(grid, mpm.Box((0, 0), (3, 2)), 2, 1.0)
        # all ranks must reach the collective search for points that yield
        sizes = [lambda x: size(x, points["x"]), mpm.where_it_yields(points, 0.5, field="density")]
        return mpm.fill(grid, mpm.Box((0, 0), (4, 2)), 2, 1.0,
                        refine=mpm.Space(grid, "gimp", refine=sizes, levels=2)).total  # fmt: skip

    def raises(x, at):
        if failing:
            raise ValueError("no answer here")
        return np.ones(x.shape[1])

    def nowhere(x, at):
        return np.full(x.shape[1], np.nan if failing else 1.0)

    messages = [expect(errors.ParameterError, lambda f=f: filled(f)) for f in (raises, nowhere)]
    for message in messages:
        assert len(set(COMM.allgather(message.partition(" of shape")[0]))) == 1
    return {"points": filled(lambda x, at: np.where(x[0] < at[:, 0].max(initial=0.0), 0.25, 1.0))}
