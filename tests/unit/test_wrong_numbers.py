"""Numbers in another unit or order than they must be in, and pieces of other bodies: all told."""

from __future__ import annotations

import functools
import re
import warnings

import numpy as np
import pytest
import ufl
from conftest import COMM
from dolfinx import fem, mesh
from scipy import sparse

import dolfinmpm as mpm
from dolfinmpm._platform.errors import (
    ConvergenceError,
    DegreesWarning,
    FormError,
    IdleConditionWarning,
    ParameterError,
)
from dolfinmpm.study import observed_orders, overall_order

LAW = mpm.materials.Hencky(1e4, 0.3)


def grid_of(n=4):
    return mesh.create_rectangle(COMM, [(0, 0), (2, 2)], (n, n), mesh.CellType.quadrilateral)


def body(grid=None, high=(1.5, 1.0), density=1000.0, **options):
    return mpm.fill(grid or grid_of(), mpm.Box((0, 0), high), 2, density, **options)


# -- friction, angles, speeds ------------------------------------------------------


def touching(friction):
    points = body()
    V = mpm.Space(points.grid)
    tool = mpm.RigidBody(mpm.Plane((0.0, 1.2), (0.0, -1.0)))
    return mpm.contact(tool, points, V.increment, V.test, friction=friction)


def wall(friction):
    points = body()
    V = mpm.Space(points.grid)
    right = mpm.Boundary.from_side(points, "right")
    return mpm.signorini(right, V.increment, V.test, law=LAW, friction=friction)


def facing(friction):
    lower = mpm.Box((0, 0), (2, 1))
    grid = grid_of()
    points = mpm.fill(grid, lower, 2, 1.0, tag=1)
    points = points + mpm.fill(grid, mpm.Box((0, 1), (2, 2)), 2, 1.0, tag=2)
    spaces = [mpm.Space(grid, tag=k) for k in (1, 2)]
    ends = [[(2.0, 1.0), (0.0, 1.0)], [(0.0, 1.0), (2.0, 1.0)]]
    sides = [mpm.Boundary.from_polygon(points, x, closed=False, rule=1) for x in ends]
    increments, tests = zip(*((s.increment, s.test) for s in spaces))
    return mpm.contact_between(sides, increments, tests, friction=friction)


FRICTION = {
    "contact": touching,
    "signorini": wall,
    "contact_between": facing,
    "frictional": lambda mu: mpm.frictional(mpm.Space(grid_of()), "bottom", friction=mu),
    "Collision": lambda mu: mpm.Collision((1, 2), friction=mu),
}


@pytest.mark.parametrize("name", FRICTION)
def test_a_coefficient_of_friction_is_no_angle(name):
    with pytest.warns(DegreesWarning, match=r"friction = 30 .* degrees were meant give 0\.5774"):
        FRICTION[name](30)
    with pytest.raises(ParameterError, match="friction = -1 must be at least 0"):
        FRICTION[name](-1)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for mu in (0.0, 0.6, 3.0, 1e3):
            FRICTION[name](mu)


def test_angles_of_shapes_are_in_degrees():
    box = functools.partial(mpm.TurnedBox, (0, 0), (1, 2))
    for angle in (0.5, -0.5, 0.02):
        with pytest.warns(DegreesWarning, match=f"angle = {angle:g} degrees .* meant give"):
            box(angle)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for angle in (0.0, 1, 3, -3.0, 45.0, -90, 720.0, 0.01):
            box(angle)
    for bad in (np.nan, "45", None):
        with pytest.raises(ParameterError, match="angle = "):
            box(bad)
    with pytest.raises(ParameterError, match=r"semi_angle = 120 degrees must be .* below 90"):
        mpm.Wedge((0, 0), 120, 1.0)


def test_shear_waves_are_the_slower_ones():
    V = mpm.Space(grid_of())
    with pytest.raises(ParameterError, match=r"s_speed = 3000 .* at most p_speed = 1500 .*swapped"):
        mpm.absorbing(V, "left", density=2e3, p_speed=1500.0, s_speed=3000.0)
    mpm.absorbing(V, "left", density=2e3, p_speed=3000.0, s_speed=1500.0)
    # of shear alone
    mpm.absorbing(V, "left", density=2e3, p_speed=0.0, s_speed=1500.0)


# -- lists ---------------------------------------------------------------------------


@pytest.mark.parametrize("orders", [observed_orders, overall_order])
def test_orders_are_of_as_many_errors_as_sizes(orders):
    for sizes, errors in (([1, 2, 3], [1, 2]), ([0.4, 0.2], [0.1]), ([1.0], [[1.0]]), (1.0, 2.0)):
        with pytest.raises(ParameterError, match="give one error for each size"):
            orders(sizes, errors)
    orders([0.4, 0.2, 0.1], [0.1, None, 0.01])


def test_times_are_given_or_divided():
    with pytest.raises(ParameterError, match=r"dt = 0\.1 is of a single .* times = \[1, 2\]"):
        list(mpm.times([1, 2], dt=0.1))
    assert [float(t) for t in mpm.times([1, 2])] == [1, 2]
    assert len(list(mpm.times(2, dt=0.1))) == 20


# -- water -----------------------------------------------------------------------------


def soil(density=2000.0, gravity=(0.0, -10.0), **options):
    points = body(high=(2.0, 2.0), density=density)
    V, Q = mpm.Space(points.grid), mpm.Space(points.grid, shape=())
    given = {"permeability": 1e-5, "porosity": 0.5, "projection": "none"} | options
    F = mpm.poromechanics(
        LAW, points, (V.increment, Q.increment), (V.test, Q.test), gravity=gravity, **given
    )
    bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
    return points, (F, [V.increment, Q.increment], points, [*bcs, *mpm.prescribed(Q, "top", 0)])


@pytest.mark.filterwarnings("ignore::dolfinmpm._platform.errors.UnstablePairWarning")
def test_a_mixture_is_heavier_than_its_water():
    for density in (300.0, 500.0, lambda x: np.where(x[0] < 1, 300.0, 2000.0)):
        with pytest.raises(ParameterError, match=r"mixture is [35]00 kg/m³ at .* alone has 500"):
            soil(density)
    soil(501.0)
    # where nothing weighs anything it may be
    soil(300.0, gravity=None)
    points = body()
    n = points.add_field("n0", (), "", 0.6)
    V, Q = mpm.Space(points.grid), mpm.Space(points.grid, shape=())
    points["density"] = 550.0
    with pytest.raises(ParameterError, match=r"porosity 0\.6 the water alone has 600"):
        mpm.poromechanics(
            LAW, points, (V.increment, Q.increment), (V.test, Q.test), permeability=1e-5,
            porosity=n, gravity=(0.0, -10.0), projection="none",
        )  # fmt: skip


@pytest.mark.filterwarnings("ignore::dolfinmpm._platform.errors.UnstablePairWarning")
def test_rates_need_a_length_of_the_step():
    points, arguments = soil()
    problem = mpm.QuasiStatic(*arguments)
    for _ in range(2):
        with pytest.raises(FormError, match=r"QuasiStatic knows no time: .* set points\.dt\.value"):
            problem.step()
    points.dt.value = 1.0
    problem.step()
    # nothing flows where nothing can
    mpm.QuasiStatic(*soil(permeability=0.0)[1]).step()
    mpm.Transient(*soil()[1]).step(1.0)


def test_rates_of_the_user_s_own_need_it_too():
    points = body()
    V = mpm.Space(points.grid)
    u, v = V.increment, V.test
    F = mpm.momentum(LAW, points, u, v) + 10.0 / points.dt * ufl.inner(u, v) * points.dX
    g = fem.Constant(points.grid, (0.0, -1e-3))
    F -= ufl.inner(points.density * g, v) * points.dX
    bcs = mpm.fixed(V, "bottom")
    problem = mpm.QuasiStatic(F, u, points, bcs, stabilisation="aggregation")
    with pytest.raises(FormError, match=r"rates over points\.dt"):
        problem.step()
    points.dt.value = 0.5
    problem.step()


# -- pieces of other bodies, and normals ---------------------------------------------------


def test_penalties_of_other_points():
    grid = grid_of()
    points, other = body(grid), body(grid)
    V = mpm.Space(grid)
    u, v = V.increment, V.test
    F = mpm.momentum(LAW, points, u, v)
    jump = ufl.inner(ufl.jump(ufl.grad(u)), ufl.jump(ufl.grad(v)))
    scalar = mpm.Space(grid, shape=())
    p, q = scalar.increment, scalar.test
    for term in (
        mpm.ghost(other, u, v, 1.0),
        jump * other.dS,
        ufl.inner(u, v) * other.dC,
        mpm.soft(other, u, v, E=1.0, nu=0.3, eta=1e-3),
    ):
        with pytest.raises(FormError, match="cells or facets of other material points"):
            mpm.QuasiStatic(F + term, u, points)
    F += mpm.ghost(points, u, v, 1.0) + jump * points.dS + ufl.inner(u, v) * points.dC
    mpm.QuasiStatic(F, u, points)
    G = F + p * q * points.dX + mpm.ghost(other, p, q, 1.0)
    with pytest.raises(FormError, match="of other material points"):
        mpm.QuasiStatic(G, [u, p], points)


def test_boundaries_inside_out():
    points = mpm.fill(grid_of(8), mpm.Box((0.3, 0.3), (1.7, 1.7)) - mpm.Disc((1, 1), 0.4), 2, 1.0)
    square = [(0.3, 0.3), (1.7, 0.3), (1.7, 1.7), (0.3, 1.7)]
    turn = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    hole = 1 + 0.4 * np.stack([np.cos(turn), -np.sin(turn)], axis=1)
    make = mpm.Boundary.from_polygon
    for x in (np.array(square), hole):
        for follows in (True, False):
            boundary = make(points, x, follows=follows)
            with pytest.raises(ParameterError, match=r"is inside out: .* anticlockwise around a b"):
                make(points, x[::-1], follows=follows)
            turned = boundary.markers["x"], -boundary.markers["area"]
            with pytest.raises(ParameterError, match="is inside out"):
                mpm.Boundary(points, *turned, follows=follows)

    def phi(x):
        return 0.4 - np.hypot(*(x - 1))

    mpm.Boundary.from_level_set(points, phi)
    with pytest.raises(ParameterError, match="is inside out"):
        mpm.Boundary.from_level_set(points, lambda x: -phi(x))
    # through the body, and far from it, either way is one
    for line in ([(0.5, 0.4), (1.5, 0.4)], [(0.1, 1.9), (0.1, 0.1)]):
        for x in (line, line[::-1]):
            make(points, x, closed=False, follows=False)


def test_triangles_inside_out():
    grid = mesh.create_box(COMM, [(0, 0, 0), (2, 2, 2)], (4, 4, 4), mesh.CellType.hexahedron)
    points = mpm.fill(grid, mpm.Box((0, 0, 0), (2, 2, 1)), 2, 1.0)
    corners = [(0, 0, 1), (2, 0, 1), (2, 2, 1), (0, 2, 1)]
    triangles = np.array([(0, 1, 2), (0, 2, 3)])
    mpm.Boundary.from_triangles(points, corners, triangles)
    with pytest.raises(ParameterError, match="triangles whose right-handed turn points outwards"):
        mpm.Boundary.from_triangles(points, corners, triangles[:, ::-1])


# -- what is set between steps ---------------------------------------------------------------


def settling():
    points = body()
    V = mpm.Space(points.grid, "gimp")
    F = mpm.momentum(LAW, points, V.increment, V.test)
    F -= ufl.inner(points.density * fem.Constant(points.grid, (0.0, -1e-3)), V.test) * points.dX
    return points, (F, V.increment, points, mpm.fixed(V, "bottom"))


def test_a_stress_that_follows_from_the_strain_is_not_set():
    points, arguments = settling()
    problem = mpm.QuasiStatic(*arguments)
    points["stress"] = -np.eye(3)
    points["stress"] = 0.0 * np.eye(3)
    problem.step()
    with pytest.raises(ParameterError, match=r"'stress' cannot be set any more.*mpm\.set_stress"):
        points["stress"] = -np.eye(3)


@pytest.mark.parametrize("rule", [mpm.QuasiStatic, mpm.Newmark, mpm.Explicit])
def test_volumes_and_stresses_of_single_points_are_not_set(rule):
    points, arguments = settling()
    problem = rule(*arguments)
    step = problem.step if rule is mpm.QuasiStatic else lambda: problem.step(problem.time + 1e-3)
    points["V"][1] *= 2.0
    told = r"'V'\] of point 1 .* set to 0\.125 .*= 0\.0625, as .*\(1 such"
    with pytest.raises(ParameterError, match=told):
        step()
    # a first volume that fits to the new one
    points["V0"][1] *= 2.0
    step()
    V, stress = points["V"].copy(), points["stress"].copy()
    points["V"][0] *= 1.01
    with pytest.raises(ParameterError, match=r"set points\['V0'\] too, before the first step"):
        step()
    points["V"] = V
    points["stress"][0, 0, 0] += 1.0
    with pytest.raises(ParameterError, match=r"changed by hand .*mpm\.set_stress\(law, points"):
        step()
    points["stress"][:] = stress
    step()
    mpm.set_stress(LAW, points, -np.eye(3))
    step()


@pytest.mark.parametrize("rule", [mpm.Newmark, mpm.Explicit])
def test_velocities_are_numbers(rule):
    points, arguments = settling()
    problem = rule(*arguments)
    points["velocity"][-1] = np.nan
    with pytest.raises(ParameterError, match=r"has the velocity \[nan nan\], which must be finite"):
        problem.step(1e-3)


@pytest.mark.parametrize("rule", [mpm.QuasiStatic, mpm.Explicit])
def test_a_grid_that_is_moved_between_steps(rule):
    points, arguments = settling()
    problem = rule(*arguments)
    step = problem.step if rule is mpm.QuasiStatic else lambda: problem.step(problem.time + 1e-3)
    step()
    points.grid.geometry.x[:, 0] += 1.0
    with pytest.raises(ParameterError, match="coordinates have been changed since"):
        step()


def test_a_surface_of_which_a_part_is_removed():
    points, arguments = settling()
    top = mpm.Surface(points, lambda x: x[1] > 0.99, (0, 1))
    mpm.QuasiStatic(*arguments).step()
    points["x"][:, 1] -= np.where(points["x0"][:, 0] < 0.5, 2e-3, 1e-3)
    before = top.displacements()[:, 1]
    right = (points["x0"][:, 0] > 0.5) & (points["x0"][:, 1] > 0.75)
    points.remove(lambda x: x[0] < 0.5)
    assert top.mean_displacement()[1] == pytest.approx(before[right].mean(), rel=1e-12)
    with pytest.warns(IdleConditionWarning, match="all faces of the surface 'surface1' went"):
        points.remove(lambda x: x[1] > 0.6)
    # it is told once
    points.remove(lambda x: x[1] > 0.4)
    with pytest.raises(ParameterError, match=r"no point of the surface .* is left"):
        top.mean_displacement()


# -- twice -------------------------------------------------------------------------


def test_two_ghost_penalties_of_one_kind():
    points, (F, u, _, bcs) = settling()
    v = u._dolfinmpm_space.test
    one = mpm.ghost(points, u, v, gamma=300.0)
    with pytest.raises(FormError, match=r"the ghost penalty \(mpm\.ghost\) twice: leave one out"):
        mpm.QuasiStatic(F + one + mpm.ghost(points, u, v, gamma=300.0), u, points, bcs)
    # of another order or strength, and of a mass
    F += one + mpm.ghost(points, u, v, gamma=300.0, order=2)
    F += mpm.ghost(points, u, v, gamma=250.0, scaling="literal") + mpm.ghost(points, u, v, 30.0)
    mpm.QuasiStatic(F, u, points, bcs).step()
    assert np.isfinite(points["x"]).all()


def test_a_prolongation_of_zeros():
    points, arguments = settling()

    def nothing(stencils, nodes):
        n = points.grid.geometry.x.shape[0]
        return sparse.csr_matrix((n, n))

    problem = mpm.QuasiStatic(*arguments, prolongation=nothing)
    with pytest.raises(ParameterError, match="zeros for all 25 nodes, which would hold the whole"):
        problem.step()


# -- terms that are not finite -------------------------------------------------------


@pytest.mark.parametrize("linear", [True, False])
def test_a_term_over_the_grid_that_is_not_finite_tells_its_node(linear):
    points = body()
    V = mpm.Space(points.grid)
    u, x = V.increment, ufl.SpatialCoordinate(points.grid)
    root = ufl.sqrt(1.4 - x[0]) * (1 if linear else 1 + ufl.inner(u, u))
    F = mpm.momentum(LAW, points, u, V.test) + root * ufl.inner(u, V.test) * ufl.dx
    problem = mpm.QuasiStatic(F, u, points, mpm.fixed(V, "bottom"), max_halvings=0)
    with pytest.raises(ConvergenceError) as caught:
        problem.step()
    told = re.search(
        r"the worst is the node at \[([\d.]+) +[\d.]+\] m, where forces", str(caught.value)
    )
    assert told is not None
    # the root is not real in the cells from 1 to 1.5, whose nodes are these
    assert float(told[1]) in (1.0, 1.5)
    assert "terms over the grid" in str(caught.value)
