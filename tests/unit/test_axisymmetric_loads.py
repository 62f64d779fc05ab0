"""Loads, boundaries and stabilisations of axisymmetric bodies."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from conftest import COMM
from dolfinx import fem, mesh
from test_axisymmetry import HENCKY, cylinder, grid_of

import dolfinmpm as mpm
from dolfinmpm._platform.errors import (
    EmptyShapeError,
    ParameterError,
)
from dolfinmpm.assembly.stencilsums import add_product
from dolfinmpm.dynamics.facesatnodes import Faces


def test_the_gradient_of_a_scalar_is_the_same_all_around():
    """Between two pipes a potential is the logarithm of the radius."""
    grid = mesh.create_rectangle(COMM, [(1, 0), (3, 1)], (40, 2), mesh.CellType.quadrilateral)
    points = mpm.fill(grid, mpm.Box((1, 0), (3, 1)), 2, 1.0, axisymmetric=True)
    V = mpm.Space(grid, shape=())
    p, q = V.increment, V.test
    assert mpm.gradient(points, p).ufl_shape == (2,)
    points.add_field("potential")
    F = ufl.inner(mpm.gradient(points, p), mpm.gradient(points, q)) * points.dX
    bcs = mpm.prescribed(V, "left", 0, increment=0.0) + mpm.prescribed(
        V, "right", 0, increment=np.log(3.0)
    )
    mpm.QuasiStatic(F, p, points, bcs, updates={"potential": p}).step()
    np.testing.assert_allclose(points["potential"], np.log(points["x"][:, 0]), atol=1e-3)


def test_areas_and_forces_are_those_of_the_whole_body():
    points = cylinder(low=(0.2, 0))
    side = mpm.Surface(points, lambda x: np.isclose(x[0], 0.8), (1, 0))
    hole = mpm.Surface(points, lambda x: np.isclose(x[0], 0.2), (-1, 0))
    top = mpm.Surface(points, lambda x: np.isclose(x[1], 0.7), (0, 1))
    assert side.total_area == pytest.approx(2 * np.pi * 0.8 * 0.7)
    assert hole.total_area == pytest.approx(2 * np.pi * 0.2 * 0.7)
    assert top.total_area == pytest.approx(np.pi * (0.8**2 - 0.2**2))
    V = mpm.Space(points.grid, "gimp")
    u, v = V.increment, V.test
    F = mpm.momentum(HENCKY, points, u, v) + top.force((0.0, -0.002), v)
    F -= ufl.inner(points.density * ufl.as_vector((0.0, -0.03)), v) * points.dX
    problem = mpm.QuasiStatic(F, u, points, mpm.rollers(V, "bottom"), stabilisation="ghost")
    problem.step()
    # the stresses on the lowest row of cells carry the load and the weight
    weight = 2.0 * 0.03 * top.total_area * 0.7
    lowest = points["x0"][:, 1] < 0.25
    mean = (points["V"] * points["stress"][:, 1, 1])[lowest].sum() / points["V"][lowest].sum()
    area = points["V"][lowest].sum() / 0.25
    assert mean * area == pytest.approx(-0.002 - weight * (0.7 - 0.125) / 0.7, rel=0.02)


def test_a_footing_s_load_is_that_of_the_whole_plate():
    points = cylinder(grid_of((4, 6), high=(1.0, 1.5)), high=(1.0, 1.0))
    V = mpm.Space(points.grid, "gimp")
    u, v = V.increment, V.test
    top = mpm.Surface(points, lambda x: np.isclose(x[1], 1.0), (0, 1))
    s = fem.Constant(points.grid, 0.0)
    plate = mpm.RigidFooting(top, s, rough=False, E=10.0)
    F = mpm.momentum(mpm.materials.Hencky(10.0, 0.0), points, u, v) + plate.contact(u, v)
    problem = mpm.QuasiStatic(F, u, points, mpm.rollers(V, "left", "right", "bottom"))
    s.value = 1e-3
    problem.step()
    # E A s/H with A = π
    assert plate.load() == pytest.approx(10.0 * np.pi * 1e-3, rel=2e-3)


def energy(blocks, u):
    """u·K u of the blocks of a matrix."""
    force = np.zeros_like(u)
    for b in blocks:
        add_product(b, [u], [force])
    return float(np.sum(force * u))


def test_soft_stiffness_is_that_of_whole_rings():
    """u_r = r strains by 1 along r and around: 4 (λ + μ) per volume of the active cells."""
    points = cylinder()
    V = mpm.Space(points.grid, "gimp")
    F = mpm.momentum(HENCKY, points, V.increment, V.test)
    stabilisation = mpm.Stabilisation("soft", eta=0.2)
    bcs = mpm.rollers(V, "left") + mpm.fixed(V, "bottom")
    here = mpm.QuasiStatic(F, V.increment, points, bcs, stabilisation=stabilisation).activate()
    u = here.fields[0].basis.node_coordinates()[:, :2] * [1.0, 0.0]
    both = 10 * 0.3 / (1.3 * 0.4) + 10 / 2.6
    assert energy(here.blocks_of("soft"), u) == pytest.approx(
        0.2 * 4 * both * np.pi * 0.75, rel=1e-10
    )


@pytest.mark.parametrize(
    ("kind", "radius"), [(mesh.CellType.quadrilateral, 1.5), (mesh.CellType.triangle, 1.625)]
)
@pytest.mark.parametrize("scale", ["gamma", "factor"])
def test_ghost_facets_are_rings(scale, kind, radius):
    """Facets with a jump, all of one radius, have 2π r times their energy in a plane."""
    penalties = []
    for axisymmetric in (True, False):
        grid = grid_of((8, 2), high=(2.0, 0.5), kind=kind)
        body = mpm.Box((0, 0), (1.6, 0.5))
        points = mpm.fill(grid, body, 3, 1.0, axisymmetric=axisymmetric)
        V = mpm.Space(grid, "linear")
        u, v = V.increment, V.test
        F = mpm.momentum(HENCKY, points, u, v)
        F += mpm.ghost(points, u, v, **{scale: 0.7})
        here = mpm.QuasiStatic(F, u, points, mpm.rollers(V, "left")).activate()
        r, z = here.fields[0].basis.node_coordinates()[:, :2].T
        # r² bends across verticals, r z across diagonals
        penalties.append(
            energy(here.blocks_of("stiffness"), np.column_stack([0 * r, r**2 + r * z]))
        )
    assert penalties[1] > 1e-3
    assert penalties[0] / penalties[1] == pytest.approx(2 * np.pi * radius, rel=1e-10)


def test_pictures_and_files(tmp_path):
    points = cylinder()
    mpm.plot(points, tmp_path / "rings.png", colour="V")
    assert (tmp_path / "rings.png").stat().st_size > 1000
    V = mpm.Space(points.grid, "gimp")
    F = mpm.momentum(HENCKY, points, V.increment, V.test)
    problem = mpm.QuasiStatic(F, V.increment, points, mpm.rollers(V, "left", "bottom"))
    problem.step()
    with mpm.ParaView(tmp_path / "rings.pvd", points) as out:
        out.write(0.0)
    assert (tmp_path / "rings.pvd").exists()


@pytest.mark.parametrize("basis", ["linear", "bspline2", "bspline3"])
def test_absorbing_faces_are_rings(basis):
    """Dashpots have the areas of the whole sides: of the top, and of the mantle."""
    grid = grid_of((6, 4), low=(0.0, 0.0), high=(3.0, 2.0))
    V = mpm.Space(grid, basis)
    rate, shear = 5.0, 3.0
    for side, axis, area in (("top", 1, np.pi * 9), ("right", 0, 2 * np.pi * 3 * 2)):
        face = mpm.absorbing(V, side, density=1.0, p_speed=rate, s_speed=shear)
        found = Faces(face, V.basis, 2, axisymmetric=True).dashpots
        assert found[:, axis].sum() == pytest.approx(rate * area, rel=1e-12)
        assert found[:, 1 - axis].sum() == pytest.approx(shear * area, rel=1e-12)


def test_boundaries_are_rings_and_pieces_on_the_axis_bound_nothing():
    points = mpm.fill(grid_of(), mpm.Box((0, 0), (0.7, 0.6)), 2, 1.0, axisymmetric=True)
    corners = [(0.0, 0.0), (0.7, 0.0), (0.7, 0.6), (0.0, 0.6)]
    skin = mpm.Boundary.from_polygon(points, corners)
    markers = skin.markers
    assert markers["x"][:, 0].min() > 1e-3
    assert skin.total_area == pytest.approx(2 * np.pi * 0.7 * (0.7 + 0.6), rel=1e-12)
    # Gauss's theorem: the flux of z through the skin is the volume
    flux = np.sum(markers["x"][:, 1] * markers["area"][:, 1])
    assert flux == pytest.approx(np.pi * 0.7**2 * 0.6, rel=1e-8)
    disc = mpm.Boundary.from_side(points, "bottom")
    width = points.grid.geometry.x[:, 0].max()
    assert disc.total_area == pytest.approx(np.pi * width**2, rel=1e-12)
    with pytest.raises(EmptyShapeError, match="not on the axis"):
        mpm.Boundary.from_side(points, "left")
    ball = mpm.Boundary.from_level_set(points, lambda x: np.hypot(x[0], x[1]) - 0.5, subdivisions=6)
    assert ball.total_area == pytest.approx(2 * np.pi * 0.5**2, rel=2e-3)


def test_points_stay_rings_beside_markers():
    """Slopes of GIMP are averaged over rings, whether or not a boundary is in the form."""
    seen = []
    for held in (False, True):
        points = mpm.fill(grid_of(), mpm.Box((0.05, 0), (0.7, 0.6)), 3, 1.0, axisymmetric=True)
        V = mpm.Space(points.grid, "gimp")
        F = mpm.momentum(HENCKY, points, V.increment, V.test)
        if held:
            line = mpm.Boundary.from_polygon(points, [(0.6, 0.0), (0.6, 0.5)], closed=False)
            F += mpm.dirichlet(line, V.increment, V.test, law=HENCKY, method="penalty")
        here = mpm.QuasiStatic(F, V.increment, points).activate()
        seen.append([here.fields[0].stencils.row(p) for p in range(len(points))])
    for without, beside in zip(*seen):
        for first, second in zip(without, beside):
            np.testing.assert_allclose(second, first, rtol=1e-13, atol=1e-15)


def test_deformable_bodies_of_revolution_do_not_touch():
    points = mpm.fill(grid_of(), mpm.Box((0, 0), (0.7, 0.3)), 2, 1.0, tag=1, axisymmetric=True)
    points += mpm.fill(points.grid, mpm.Box((0, 0.3), (0.7, 0.6)), 2, 1.0, tag=2,
                       axisymmetric=True)  # fmt: skip
    ends = [(0.0, 0.3), (0.7, 0.3)]
    sides = [mpm.Boundary.from_polygon(points, e, closed=False) for e in (ends, ends[::-1])]
    spaces = [mpm.Space(points.grid, "gimp", tag=tag) for tag in (1, 2)]
    with pytest.raises(ParameterError, match="these points are axisymmetric"):
        mpm.contact_between(sides, [V.increment for V in spaces], [V.test for V in spaces])
