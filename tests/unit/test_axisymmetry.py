"""Points that are rings: volumes, gradients, tangents, loads, and what they cannot be."""

from __future__ import annotations

import meshio
import numpy as np
import pytest
import ufl
from conftest import COMM, Linearised
from dolfinx import fem, mesh

import dolfinmpm as mpm
from dolfinmpm._platform.errors import (
    CheckpointError,
    EmptyShapeError,
    FreeAxisWarning,
    ParameterError,
    UnsupportedGridError,
)
from dolfinmpm.assembly.stencilsums import add_product
from dolfinmpm.basis.conditionchecks import free_motions
from dolfinmpm.dynamics.faces import Faces

HENCKY = mpm.materials.Hencky(10.0, 0.3)


def grid_of(cells=(4, 4), low=(0.0, 0.0), high=(1.0, 1.0), kind=mesh.CellType.quadrilateral):
    return mesh.create_rectangle(COMM, [low, high], cells, kind)


def cylinder(grid=None, low=(0, 0), high=(0.8, 0.7), density=2.0, **options):
    body = mpm.Box(low, high)
    return mpm.fill(grid or grid_of(), body, 2, density, axisymmetric=True, **options)


# -- volumes ----------------------------------------------------------------------


@pytest.mark.parametrize("kind", [mesh.CellType.quadrilateral, mesh.CellType.triangle])
def test_volumes_are_those_of_whole_rings(kind):
    high = (0.8, 0.7) if kind == mesh.CellType.quadrilateral else (0.75, 0.5)
    points = cylinder(grid_of(kind=kind), high=high)
    whole = np.pi * high[0] ** 2 * high[1]
    assert points["V0"].sum() == pytest.approx(whole, rel=1e-13)
    assert points.shape_volume == pytest.approx(whole, rel=1e-13)
    assert abs(points.volume_error) < 1e-12
    assert points["F"].shape == (len(points), 3, 3)
    assert (points.gdim, points.strain_dim, points.F.ufl_shape) == (2, 3, (3, 3))
    assert points.fault() is None
    # the grid sees their sections
    area = 0.25**2 / (4 if kind == mesh.CellType.quadrilateral else 8)
    assert points.placement().volume.max() == pytest.approx(area, rel=1e-12)


def test_a_torus_is_filled_exactly():
    ball = mpm.Ball((0.5, 0.5), 0.3)
    points = mpm.fill(grid_of((8, 8)), ball, 2, 1.0, exact=True, axisymmetric=True)
    torus = 2 * np.pi * 0.5 * np.pi * 0.3**2
    assert points["V0"].sum() == pytest.approx(torus, rel=1e-12)
    assert points.shape_volume == pytest.approx(torus, rel=1e-12)
    unknown = mpm.Where(lambda x: x[0] + x[1] < 0.9)
    assert mpm.fill(grid_of(), unknown, 2, 1.0, axisymmetric=True).shape_volume is None


def test_points_of_arrays_tables_and_meshes_may_be_rings(tmp_path):
    grid = grid_of()
    x, area = np.array([[0.1, 0.2], [0.4, 0.6]]), np.array([0.01, 0.02])
    V = 2 * np.pi * x[:, 0] * area
    points = mpm.MaterialPoints.from_arrays(grid, x, V, 1.0, axisymmetric=True)
    np.testing.assert_allclose(points["l"], np.repeat(0.5 * np.sqrt(area[:, None]), 2, axis=1))
    path = tmp_path / "points.csv"
    path.write_text("x,y,volume\n" + "".join(f"{a},{b},{v}\n" for (a, b), v in zip(x, V)))
    read = mpm.MaterialPoints.from_csv(grid, path, density=1.0, axisymmetric=True)
    np.testing.assert_allclose(read["l"], points["l"])
    assert read.axisymmetric
    corners = np.array([[0.1, 0.1], [0.7, 0.1], [0.7, 0.5], [0.1, 0.5]])
    body = meshio.Mesh(corners, [("quad", [[0, 1, 2, 3]])])
    of_mesh = mpm.MaterialPoints.from_mesh(grid, body, 1.0, degree=3, axisymmetric=True)
    whole = np.pi * (0.7**2 - 0.1**2) * 0.4
    assert of_mesh["V0"].sum() == pytest.approx(whole, rel=1e-13)


def test_rings_are_joined_and_added():
    grid = grid_of()
    a, b = cylinder(grid, high=(0.5, 0.5)), cylinder(grid, low=(0, 0.5), high=(0.5, 1), tag=1)
    both = a + b
    assert both.axisymmetric
    assert both["F"].shape == (len(a) + len(b), 3, 3)
    assert both["V0"].sum() == pytest.approx(np.pi * 0.25)
    assert a.add(b).mass == pytest.approx(2.0 * np.pi * 0.125)
    assert a.total == both.total
    plane = mpm.fill(grid, mpm.Box((0.5, 0), (1, 1)), 2, 1.0)
    for first, second in ((both, plane), (plane, both)):
        with pytest.raises(ParameterError, match="axisymmetric points and points of plane strain"):
            first + second
        with pytest.raises(ParameterError, match="axisymmetric = "):
            first.add(second)


# -- what cannot be ---------------------------------------------------------------


def test_grids_that_reach_beyond_the_axis_are_refused():
    grid = grid_of(low=(-0.25, 0))
    with pytest.raises(UnsupportedGridError, match=r"reaches from x\[0\] = -0.25 m"):
        mpm.fill(grid, mpm.Box((0, 0), (0.5, 0.5)), 2, 1.0, axisymmetric=True)
    line = mesh.create_interval(COMM, 4, [0.0, 1.0])
    with pytest.raises(UnsupportedGridError, match="2 dimensions"):
        mpm.fill(line, mpm.Box((0,), (1,)), 2, 1.0, axisymmetric=True)
    with pytest.raises(UnsupportedGridError, match="reaches from"):
        mpm.MaterialPoints.from_arrays(grid, [[0.1, 0.1]], 1.0, 1.0, axisymmetric=True)
    # one that begins off the axis is well
    cylinder(grid_of(low=(0.25, 0), high=(1.25, 1)), low=(0.3, 0))


def test_points_on_the_axis_are_refused():
    with pytest.raises(ParameterError, match="a ring on the axis has no volume"):
        mpm.MaterialPoints.from_arrays(
            grid_of(), [[0.1, 0.1], [0.0, 0.3]], 1e-3, 1.0, axisymmetric=True
        )
    with pytest.raises(ParameterError, match="axisymmetric = 'yes' must be True or False"):
        mpm.fill(grid_of(), mpm.Box((0, 0), (1, 1)), 2, 1.0, axisymmetric="yes")


def test_faces_on_the_axis_are_refused():
    with pytest.raises(ParameterError, match="the axis is no boundary of the body"):
        mpm.Surface(cylinder(), lambda x: np.isclose(x[0], 0.0, atol=1e-9), (-1, 0))


def test_a_body_that_may_leave_its_axis_is_warned_of():
    def activate(inner, *sides):
        points = cylinder(low=(inner, 0))
        V = mpm.Space(points.grid, "gimp")
        F = mpm.momentum(HENCKY, points, V.increment, V.test)
        bcs = mpm.rollers(V, *sides)
        mpm.QuasiStatic(F, V.increment, points, bcs).activate()

    with pytest.warns(FreeAxisWarning, match=r'reaches the axis .* mpm.rollers\(space, "left"\)'):
        activate(0.0, "bottom")
    # held there, or with a hole: warnings are errors in tests
    activate(0.0, "bottom", "left")
    activate(0.1, "bottom")


def test_rings_move_rigidly_along_their_axis_alone():
    points = cylinder()
    V = mpm.Space(points.grid, "gimp")
    active = np.arange(V.basis.nodes.size, dtype=np.int32)
    assert free_motions([], V, active, True) == ["along y"]
    assert free_motions(mpm.rollers(V, "left"), V, active, True) == ["along y"]
    assert free_motions(mpm.rollers(V, "bottom"), V, active, True) == []


def test_a_checkpoint_keeps_rings(tmp_path):
    def problem(axisymmetric):
        grid = grid_of()
        points = mpm.fill(grid, mpm.Box((0, 0), (0.8, 0.7)), 2, 1.0, axisymmetric=axisymmetric)
        V = mpm.Space(grid, "gimp")
        g = fem.Constant(grid, (0.0, -1.0))
        F = mpm.momentum(HENCKY, points, V.increment, V.test)
        F -= ufl.inner(g, V.test) * points.dX
        bcs = mpm.rollers(V, "left") + mpm.fixed(V, "bottom")
        return mpm.QuasiStatic(F, V.increment, points, bcs, stabilisation="ghost"), g

    first, g = problem(True)
    first.step()
    first.save(tmp_path / "rings.npz")
    again, g2 = problem(True)
    again.load(tmp_path / "rings.npz")
    for one, load in ((first, g), (again, g2)):
        load.value[1] = -2.0
        one.step()
    for name, values in first.points.fields.items():
        np.testing.assert_array_equal(again.points[name], values)
    with pytest.raises(CheckpointError, match=r"F float64\(3, 3\)"):
        problem(False)[0].load(tmp_path / "rings.npz")


# -- gradients and tangents -------------------------------------------------------


def strained(points, size=0.1):
    """Points with F of some motion, and the elastic strain that goes with it."""
    rng = np.random.default_rng(5)
    F = np.zeros((len(points), 3, 3))
    F[:, :2, :2] = np.eye(2) + rng.uniform(-size, size, (len(points), 2, 2))
    F[:, 2, 2] = rng.uniform(1 - size, 1 + size, len(points))
    points["F"] = F
    if "be" in points.fields:
        b = F @ np.swapaxes(F, 1, 2)
        points["be"] = b[:, [0, 1, 2, 0, 1, 0], [0, 1, 2, 1, 2, 2]]


def check_tangent(problem, size=0.02, tolerance=2e-6):
    """K against central differences of f."""
    linearised = Linearised(problem)
    rng = np.random.default_rng(3)
    start = rng.uniform(-size, size, linearised.size)
    linearised.tangent(start)
    direction = rng.uniform(-1, 1, linearised.size)
    exact, f, t = linearised.product(direction), linearised.residual, 1e-6
    numerical = (f(start + t * direction) - f(start - t * direction)) / (2 * t)
    assert np.abs(exact).max() > 0
    np.testing.assert_allclose(exact, numerical, atol=tolerance * np.abs(exact).max())


@pytest.mark.parametrize(
    ("law", "options"),
    [
        (HENCKY, {}),
        (mpm.materials.NeoHookean(10.0, 0.3), {}),
        (mpm.materials.VonMises(10.0, 0.3, radius=0.1, hardening=1.0), {"strain": "small"}),
        (mpm.materials.VonMises(10.0, 0.3, radius=0.1, hardening=1.0), {"strain": "jaumann"}),
        (HENCKY, {"fbar": True}),
        (HENCKY, {"fbar": True, "strain": "small"}),
        (mpm.materials.Tresca(10.0, 0.45, 0.1), {"fbar": "centres"}),
    ],
)
def test_tangents(law, options):
    points = cylinder()
    V = mpm.Space(points.grid, "gimp")
    u, v = V.increment, V.test
    F = mpm.momentum(law, points, u, v, **options)
    top = mpm.Surface(points, lambda x: np.isclose(x[1], 0.7), (0, 1))
    side = mpm.Surface(points, lambda x: np.isclose(x[0], 0.8), (1, 0))
    p = fem.Constant(points.grid, 1.0)
    F += top.pressure(p, u, v) + side.pressure(p, u, v)
    problem = mpm.QuasiStatic(F, u, points, mpm.rollers(V, "left", "bottom"))
    if "strain" not in options:
        strained(points)
    check_tangent(problem)


@pytest.mark.parametrize("basis", ["linear", "bspline2"])
def test_tangents_of_total_increments_and_of_stress_in_forms(basis):
    points = cylinder()
    V = mpm.Space(points.grid, basis, configuration="total")
    u, v = V.increment, V.test
    F = mpm.momentum(HENCKY, points, u, v)
    sigma = mpm.stress(HENCKY, points, u)
    assert sigma.ufl_shape == (3, 3)
    F += 0.1 * sigma[2, 2] * v[0] * points.dX
    problem = mpm.QuasiStatic(F, u, points, mpm.rollers(V, "left", "bottom"))
    strained(points)
    check_tangent(problem)


def test_an_energy_of_ones_own_equals_the_built_in_law():
    """Written with mpm.gradient a form holds for rings as it does in three dimensions."""
    results = []
    lmbda, mu = 10 * 0.3 / (1.3 * 0.4), 10 / 2.6
    for own in (False, True):
        points = cylinder()
        V = mpm.Space(points.grid, "gimp")
        u, v = V.increment, V.test
        if own:
            D = (ufl.Identity(3) + mpm.gradient(points, u)) * points.F
            J = ufl.det(D)
            psi = mu / 2 * (ufl.tr(D.T * D) - 3) - mu * ufl.ln(J) + lmbda / 2 * ufl.ln(J) ** 2
            F = ufl.derivative(psi * points.dX, u, v)
        else:
            F = mpm.momentum(mpm.materials.NeoHookean(E=10.0, nu=0.3), points, u, v)
        g = fem.Constant(points.grid, (0.3, -1.0))
        F -= ufl.inner(points.density * g, v) * points.dX
        bcs = mpm.rollers(V, "left") + mpm.fixed(V, "bottom")
        mpm.QuasiStatic(F, u, points, bcs, stabilisation="aggregation").step()
        results.append(points["x"].copy())
    np.testing.assert_allclose(results[0], results[1], atol=1e-12)
    plane = mpm.fill(grid_of(), mpm.Box((0, 0), (1, 1)), 2, 1.0)
    V = mpm.Space(plane.grid, "gimp")
    assert mpm.gradient(plane, V.increment) == ufl.grad(V.increment)


# -- loads ------------------------------------------------------------------------


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
    with pytest.raises(EmptyShapeError, match="off the axis"):
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
