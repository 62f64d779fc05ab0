"""Bodies that overlap, and volumes without room: told when they are joined, or make a problem."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import COMM
from dolfinx import mesh

import dolfinmpm as mpm
from dolfinmpm._platform.errors import ParameterError

LAW = mpm.materials.Hencky(1e3, 0.3)
KINDS = ("quadrilateral", "triangle")
MATCH = r"fill the cell at \[.*\] m .* times, and \d+ cells .* points.overlapping = True before"


def grid_of(kind="quadrilateral", n=8):
    if kind in ("hexahedron", "tetrahedron"):
        return mesh.create_box(COMM, [(0, 0, 0), (2, 2, 2)], (4, 4, 4), mesh.CellType[kind])
    return mesh.create_rectangle(COMM, [(0, 0), (2, 2)], (n, n), mesh.CellType[kind])


def problem_of(points, kind=mpm.QuasiStatic, **options):
    V = mpm.Space(points.grid)
    F = mpm.momentum(LAW, points, V.increment, V.test)
    return kind(F, V.increment, points, mpm.fixed(V, "bottom"), **options)


@pytest.mark.parametrize("kind", [*KINDS, "hexahedron", "tetrahedron"])
def test_bodies_that_overlap_are_not_joined(kind):
    grid = grid_of(kind)
    d = grid.geometry.dim
    a = mpm.fill(grid, mpm.Box((0.0,) * d, (2.0,) * d), 2, 1.0)
    b = mpm.fill(grid, mpm.Ball((1.0,) * d, 0.7), 3, 1.0, tag=2)
    count = a.total
    for join in (lambda: a + b, lambda: b + a, lambda: a.add(b)):
        with pytest.raises(ParameterError, match=MATCH):
            join()
    assert a.total == count
    a.overlapping = True
    both = a + b
    assert both.overlapping
    assert both.total == count + b.total
    problem_of(both)
    assert a.add(b).count == b.total


@pytest.mark.parametrize("per_cell", [(1, 1), (1, 3), (2, 1), (2, 2), (2, 3), (3, 3)])
@pytest.mark.parametrize("kind", KINDS)
def test_a_lens_in_the_ground_overlaps_nothing(kind, per_cell):
    grid = grid_of(kind)
    lens, ground = mpm.Disc((1.03, 0.98), 0.61), mpm.Box((0.1, 0.1), (1.9, 1.7))
    for exact in (False, True):
        a = mpm.fill(grid, ground - lens, per_cell[0], 1.0)
        b = mpm.fill(grid, lens, per_cell[1], 1.0, exact=exact)
        problem_of(a + b)
    # side by side, in one row of cells
    low = mpm.fill(grid, mpm.Box((0, 0), (2, 0.6)), per_cell[0], 1.0)
    problem_of(low + mpm.fill(grid, mpm.Box((0, 0.6), (2, 1.1)), per_cell[1], 1.0))


@pytest.mark.parametrize("angle", [0.0, 0.3, 0.7854])
def test_turned_bodies_beside_each_other(angle):
    """Domains along the axes reach over the sides of boxes that are turned."""
    grid = grid_of()
    along = np.array([np.cos(angle), np.sin(angle)])
    made = []
    for side in (-0.25, 0.25):
        middle = np.array([1.0, 1.0]) + side * along
        half = np.array([0.25, 0.4])
        box = mpm.TurnedBox(middle - half, middle + half, np.degrees(angle))
        made.append(mpm.fill(grid, box, 2, 1.0, aligned="body"))
    problem_of(made[0] + made[1])


@pytest.mark.parametrize("axisymmetric", [False, True])
@pytest.mark.parametrize("kind", KINDS)
def test_volumes_have_room(kind, axisymmetric):
    grid = grid_of(kind)
    points = mpm.fill(grid, mpm.Box((0, 0), (2, 1)), 2, 1.0, axisymmetric=axisymmetric)
    rows = points["x"], points["V"]
    for factor in (1.0, 10.0):
        again = mpm.MaterialPoints.from_arrays(
            grid, rows[0], factor * rows[1], 1.0, half_length=points["l"],
            axisymmetric=axisymmetric,
        )  # fmt: skip
        if factor == 1.0:
            problem_of(again)
            continue
        for kind_of in (mpm.QuasiStatic, mpm.Explicit):
            with pytest.raises(ParameterError, match=MATCH):
                problem_of(again, kind_of)
        again.overlapping = True
        problem_of(again)
    # with domains of their own, which reach as far as their volumes
    wide = mpm.MaterialPoints.from_arrays(
        grid, rows[0], 10 * rows[1], 1.0, axisymmetric=axisymmetric
    )
    with pytest.raises(ParameterError, match=MATCH):
        problem_of(wide)
    mere = mpm.MaterialPoints.from_arrays(
        grid, *rows, 1.0, half_length=0.0, axisymmetric=axisymmetric
    )
    problem_of(mere)


def test_bodies_that_collide_do_not_overlap_at_first():
    grid = grid_of()
    x = np.stack(np.meshgrid(*[np.arange(0.05, 1, 0.1)] * 2), -1).reshape(-1, 2)
    x = np.concatenate([x, 0.03 + x])
    tag = np.repeat([1, 2], len(x) // 2)
    points = mpm.MaterialPoints.from_arrays(grid, x, 0.01, 1.0, tag=tag)
    with pytest.raises(ParameterError, match=MATCH):
        problem_of(points, mpm.Explicit, collision=mpm.Collision((1, 2)))
    points.overlapping = True
    problem_of(points, mpm.Explicit, collision=mpm.Collision((1, 2)))


def test_what_has_moved_may_be_dense():
    """Cells are filled more than once where bodies are compressed, or points drift together."""
    grid = grid_of()
    points = mpm.fill(grid, mpm.Box((0, 0), (2, 1)), 2, 1.0)
    points["x"][:, 1] *= 0.5
    points.locate()
    problem_of(points)
    # and what comes beside it finds its room
    points.add(mpm.fill(grid, mpm.Box((0, 1), (2, 1.5)), 2, 1.0))
    # where it was at first
    with pytest.raises(ParameterError, match=MATCH):
        points.add(mpm.fill(grid, mpm.Box((0, 0), (2, 0.5)), 3, 1.0))
    problem_of(points)


def test_each_set_of_points_is_looked_at_once(monkeypatch):
    from dolfinmpm.body import overlapchecks

    looked = []
    filled = overlapchecks._Filled
    monkeypatch.setattr(overlapchecks, "_Filled", lambda bodies: looked.append(1) or filled(bodies))
    points = mpm.fill(grid_of(), mpm.Box((0, 0), (2, 1)), 2, 1.0)
    for _ in range(3):
        problem_of(points)
    assert len(looked) == 1
