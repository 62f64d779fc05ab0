"""Tied sides: level ground without end, against exact motions and against rollers."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from conftest import COMM
from dolfinx import mesh

import dolfinmpm as mpm
from dolfinmpm._platform.errors import (
    InstabilityError,
    ParameterError,
    SingularMassWarning,
    UnsupportedGridError,
)


def layer(basis="bspline2", period=1, height=8, free=3, kind=mpm.Newmark, bcs="bottom", **options):
    """A layer of unit cells with tied sides, ρ = 1, c_s = 1 m/s, ν = 0, and its problem."""
    lines = [np.arange(2.0 * free + period + 1), np.arange(height + 1.0)]
    grid = mpm.create_lattice(COMM, lines)
    points = mpm.fill(grid, mpm.Box((free, 0), (free + period, height)), 2, 1.0)
    V = mpm.Space(grid, basis)
    F = mpm.momentum(mpm.materials.Hencky(E=2.0, nu=0.0), points, V.increment, V.test)
    sides = mpm.tied(V, period=float(period))
    held = mpm.fixed(V, "bottom") if bcs else []
    problem = kind(F, V.increment, points, held, prolongation=sides, **options)
    return points, problem


def mode(points, height=8):
    """The first mode of shear of the layer, with an amplitude in which squares are small."""
    v = np.zeros((len(points), 2))
    v[:, 0] = 1e-6 * np.sin(0.5 * np.pi * points["x"][:, 1] / height)
    return v


@pytest.mark.parametrize(
    ("kind", "height", "options"),
    [
        (mpm.Newmark, 8, {"ghost_mass": 0.0}),
        (mpm.Explicit, 8, {"mass": "consistent", "ghost_mass": 0.0}),
        (mpm.Explicit, 16, {}),
    ],
)
def test_a_layer_swings_in_shear(kind, height, options):
    """After a third of its period 4 H/c_s, the layer has the exact velocity cos(2π/3)."""
    points, problem = layer(height=height, kind=kind, **options)
    points["velocity"] = start = mode(points, height)
    for t in mpm.times(4 * height / 3, dt=0.1):
        problem.step(t)
    exact = np.cos(2 * np.pi / 3) * start
    error = np.linalg.norm(points["velocity"] - exact) / np.linalg.norm(start)
    assert error < 0.02
    # it stays level
    assert np.abs(points["x"][:, 1] - points["x0"][:, 1]).max() < 1e-9


def test_a_singular_mass_under_a_free_surface_says_what_helps():
    """The grid goes on above the surface. Advice to take shorter steps had no effect."""
    lines = [np.arange(6.0), np.arange(11.0)]
    grid = mpm.create_lattice(COMM, lines)
    points = mpm.fill(grid, mpm.Box((2, 0), (3, 8)), 2, 1.0)
    V = mpm.Space(grid, "gimp")
    F = mpm.momentum(mpm.materials.Hencky(E=2.0, nu=0.0), points, V.increment, V.test)
    held, sides = mpm.fixed(V, "bottom"), mpm.tied(V, period=1.0)
    options = {"mass": "consistent", "prolongation": sides}
    problem = mpm.Explicit(F, V.increment, points, held, **options)
    points["velocity"] = mode(points) @ np.ones((2, 2))
    with (
        pytest.warns(SingularMassWarning, match="ghost_mass above 0"),
        pytest.raises(InstabilityError, match="do what the SingularMassWarning says"),
    ):
        problem.step(1.0)


def test_a_longer_period_gives_the_same_motion():
    found = []
    for period in (1, 3):
        points, problem = layer(period=period, height=4, ghost_mass=0.0)
        points["velocity"] = mode(points, 4)
        for t in mpm.times(4.0, dt=0.5):
            problem.step(t)
        order = np.argsort(points["x0"][:, 1], kind="stable")
        found.append(points["velocity"][order, 0].reshape(8, -1))
    short, long = found
    assert long == pytest.approx(np.repeat(short, 3, axis=1), abs=1e-9 * np.abs(short).max())


@pytest.mark.parametrize("basis", ["linear", "gimp", "bspline2", "bspline3"])
@pytest.mark.parametrize("kind", [mpm.Newmark, mpm.Explicit])
def test_a_layer_moves_along_without_stress(basis, kind):
    """A layer on nothing crosses cells: its sides are no boundary, wherever they are."""
    points, problem = layer(basis, height=4, free=5, kind=kind, bcs="", mass="lumped")
    points["velocity"] = (0.4, 0.0)
    for t in mpm.times(4.0, dt=0.25):
        problem.step(t)
    assert points["x"] - points["x0"] == pytest.approx(np.tile((1.6, 0.0), (len(points), 1)))
    assert np.abs(points["stress"]).max() < 1e-10


def test_a_layer_carries_its_weight_like_one_between_rollers():
    """The sides hold each other: σ_xx = ν/(1 − ν) σ_yy, as in the oedometer."""
    found = []
    for tied in (True, False):
        lines = [np.arange(6.0), np.arange(5.0)]
        grid = mpm.create_lattice(COMM, lines if tied else [[0.0, 1.0], lines[1]])
        left = 2.0 if tied else 0.0
        points = mpm.fill(grid, mpm.Box((left, 0), (left + 1, 4)), 2, 1000.0)
        V = mpm.Space(grid, "bspline2")
        F = mpm.momentum(mpm.materials.Hencky(E=1e7, nu=0.3), points, V.increment, V.test)
        F -= ufl.inner(points.density * ufl.as_vector((0.0, -10.0)), V.test) * points.dX
        bcs = mpm.prescribed(V, "bottom", 1)
        bcs += [] if tied else mpm.rollers(V, "left", "right")
        options = {"prolongation": mpm.tied(V, period=1.0)} if tied else {}
        bcs += mpm.prescribed(V, "bottom", 0) if tied else []
        mpm.QuasiStatic(F, V.increment, points, bcs, **options).step()
        order = np.lexsort(points["x0"].T)
        found.append(points["stress"][order])
    assert found[0] == pytest.approx(found[1], abs=1e-6 * np.abs(found[1]).max())
    assert found[0][:, 0, 0] == pytest.approx(0.3 / 0.7 * found[0][:, 1, 1], rel=2e-2)


def test_three_dimensions_and_another_axis():
    """A layer in 3D that repeats itself in y, and is held level in x, swings as in 2D."""
    grid = mpm.create_lattice(COMM, [[0.0, 1.0], np.arange(6.0), np.arange(5.0)])
    points = mpm.fill(grid, mpm.Box((0, 2, 0), (1, 3, 4)), 2, 1.0)
    V = mpm.Space(grid, "gimp")
    F = mpm.momentum(mpm.materials.Hencky(E=2.0, nu=0.0), points, V.increment, V.test)
    bcs = mpm.fixed(V, "bottom") + mpm.rollers(V, "left", "right")
    sides = mpm.tied(V, period=1.0, axis=1)
    problem = mpm.Newmark(F, V.increment, points, bcs, prolongation=sides, ghost_mass=0.0)
    v = np.zeros_like(points["x"])
    v[:, 1] = 1e-6 * np.sin(0.125 * np.pi * points["x"][:, 2])
    points["velocity"] = v
    for t in mpm.times(16.0 / 3.0, dt=0.1):
        problem.step(t)
    exact = np.cos(2 * np.pi / 3) * v
    assert np.abs(points["velocity"] - exact).max() < 0.03 * 1e-6


def test_what_cannot_be_tied():
    grid = mpm.create_lattice(COMM, [range(6), range(4)])
    V = mpm.Space(grid, "gimp")
    with pytest.raises(ParameterError, match="whole number of cells of 1 m: take 2 m"):
        mpm.tied(V, period=1.6)
    with pytest.raises(ParameterError, match="axis = 2 must be a whole number of at most 1"):
        mpm.tied(V, period=1.0, axis=2)
    graded = mpm.create_lattice(COMM, [[0.0, 1.0, 3.0], range(4)])
    with pytest.raises(ParameterError, match="equal cells along the axis 0; they are 1 to 2 m"):
        mpm.tied(mpm.Space(graded), period=1.0)
    triangles = mpm.Space(mesh.create_unit_square(COMM, 3, 3, mesh.CellType.triangle))
    # another basis would not help
    with pytest.raises(UnsupportedGridError, match=r"rectangular; make the grid with mpm\.create"):
        mpm.tied(triangles, period=1.0)
    with pytest.raises(UnsupportedGridError, match=r'rectangular; use basis="linear", or make'):
        mpm.Space(triangles.grid, "gimp")
    box = mpm.RigidBody(mpm.Box((2, 0), (3, 2)), increment=(0, 0))
    refined = mpm.Space(grid, "gimp", refine=mpm.near(box, size=0.5), levels=1)
    with pytest.raises(UnsupportedGridError, match="refined"):
        mpm.tied(refined, period=1.0)


@pytest.mark.parametrize("kind", ["aggregation", "weak-aggregation", "extended"])
def test_nodes_that_follow_one_side_are_refused(kind):
    """Both sides of a body with aggregation had moved apart by 3 % of its displacements."""
    with pytest.raises(
        ParameterError, match=f'"{kind}" makes nodes beside one side .* take "none"'
    ):
        layer("gimp", stabilisation=kind)


@pytest.mark.parametrize(
    ("width", "period", "what"),
    [(2, 3.0, "a gap"), (2, 1.0, "2 times as much"), (3, 2.0, "2 ti")],
)
def test_a_period_that_is_not_the_length_of_the_body(width, period, what):
    grid = mpm.create_lattice(COMM, [range(9), range(5)])
    points = mpm.fill(grid, mpm.Box((3, 0), (3 + width, 4)), 2, 1.0)
    V = mpm.Space(grid, "gimp")
    F = mpm.momentum(mpm.materials.Hencky(E=2.0, nu=0.0), points, V.increment, V.test)
    bcs, sides = mpm.fixed(V, "bottom"), mpm.tied(V, period=period)
    message = f"period = {period:g} m, and the body is {width} m long along the axis 0: .* {what}"
    with pytest.raises(ParameterError, match=message):
        mpm.Newmark(F, V.increment, points, bcs, prolongation=sides)


def test_sides_that_lean_or_cut_cells_are_one_period_apart():
    grid = mpm.create_lattice(COMM, [range(10), range(5)])
    V = mpm.Space(grid, "gimp")
    for shift, lean in ((0.2, 0.0), (0.5, 0.0), (0.0, 2.0)):
        corners = np.array([(3, 0), (5, 0), (5 + lean, 4), (3 + lean, 4)]) + np.array([shift, 0])
        points = mpm.fill(grid, mpm.Polygon(corners), 2, 1.0)
        F = mpm.momentum(mpm.materials.Hencky(E=2.0, nu=0.0), points, V.increment, V.test)
        bcs, sides = mpm.fixed(V, "bottom"), mpm.tied(V, period=2.0)
        assert mpm.Newmark(F, V.increment, points, bcs, prolongation=sides).step(0.1).unknowns > 0


def test_a_body_at_the_end_of_the_grid_is_refused():
    _, problem = layer("gimp", free=0)
    with pytest.raises(ParameterError, match="need free cells beside the body"):
        problem.step(0.1)
