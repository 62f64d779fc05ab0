"""A free block on a rough wall, which friction alone holds."""

import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI

import dolfinmpm as mpm

h, FRICTION = 0.5, 0.5
STONE = mpm.materials.Hencky(1e7, 0.3)


def tilted(degrees, low=0.0, basis="gimp"):
    """The problem under gravity tilted by an angle, the wall, and the weight (N)."""
    lines = [h * np.arange(-3, 8), h * np.arange(-2, 5)]
    grid = mpm.create_lattice(MPI.COMM_WORLD, lines)
    points = mpm.fill(grid, mpm.Box((0, low), (2, low + 1)), 2, 2000.0, exact=True)
    V = mpm.Space(grid, basis)
    u, v, angle = V.increment, V.test, np.radians(degrees)
    gravity = fem.Constant(grid, 9.81 * np.array([np.sin(angle), -np.cos(angle)]))
    wall = mpm.Boundary.from_polygon(points, [(-1.4, low), (3.4, low)], closed=False, follows=False)
    F = mpm.momentum(STONE, points, u, v) + mpm.signorini(wall, u, v, law=STONE, friction=FRICTION)
    F -= ufl.inner(points.density * gravity, v) * points.dX
    weight = 2 * 2000 * np.asarray(gravity.value)
    return mpm.QuasiStatic(F, u, points, [], stabilisation="ghost"), wall, weight


@pytest.mark.parametrize(
    ("low", "basis"), [(0.0, "gimp"), (0.3 * h, "gimp"), (0.3 * h, "bspline2")]
)
def test_it_stands_below_the_angle_of_friction(low, basis):
    """A block that touches without pressure had slipped in the first iteration, and had failed."""
    for degrees in (0.0, 10.0, 25.0):
        problem, wall, weight = tilted(degrees, low, basis)
        assert problem.step().halvings == 0
        np.testing.assert_allclose(wall.force(), -weight, atol=1e-6 * np.linalg.norm(weight))


def test_it_slides_above_the_angle_of_friction():
    with pytest.raises(mpm.errors.ConvergenceError):
        tilted(np.degrees(np.arctan(FRICTION)) + 0.5)[0].step()


def test_a_disc_rolls_down_a_wall():
    """Markers that a body comes near had taken the gap of markers that it touches already."""
    grid = mpm.create_lattice(MPI.COMM_WORLD, [0.1 * np.arange(-6, 14), 0.1 * np.arange(-2, 10)])
    points = mpm.fill(grid, mpm.Disc((0, 0.4), 0.4), 2, 1000.0, exact=True)
    V, law = mpm.Space(grid, "gimp"), mpm.materials.Hencky(1e6, 0.3)
    u, v = V.increment, V.test
    gravity = 9.81 * np.array([np.sin(np.pi / 9), -np.cos(np.pi / 9)])
    F = mpm.momentum(law, points, u, v)
    F -= ufl.inner(points.density * ufl.as_vector(gravity.tolist()), v) * points.dX
    wall = mpm.Boundary.from_polygon(points, [(-0.6, 0), (1.3, 0)], closed=False, follows=False)
    F += mpm.signorini(wall, u, v, law=law, friction=0.6)
    problem = mpm.Newmark(F, u, points, stabilisation="ghost")
    start = points["x"][:, 0] @ points["V0"]
    for t in mpm.times(0.8, dt=0.01):
        problem.step(t)
    way = (points["x"][:, 0] @ points["V0"] - start) / points["V0"].sum()
    # a disc of squares of an eighth of its radius; it had come to 0.8 of this way
    assert way == pytest.approx(0.5 * 2 / 3 * gravity[0] * 0.8**2, rel=0.05)


@pytest.mark.parametrize("basis", ["gimp", "bspline2"])
def test_a_block_that_yields_hits_a_rough_wall(basis):
    """Whole steps of Newton's method slid back too far: 80 iterations, and halved steps."""
    grid = mpm.create_lattice(MPI.COMM_WORLD, [0.25 * np.arange(-2, 8), 0.25 * np.arange(-1, 6)])
    points = mpm.fill(grid, mpm.Box((0, 0), (0.9, 0.9)), 2, 2000.0, exact=True)
    points.add_field("velocity", (2,), "m/s", (0.8, -0.6))
    V, law = mpm.Space(grid, basis), mpm.materials.VonMises(1e6, 0.0, yield_stress=2e4)
    u, v = V.increment, V.test
    wall = mpm.Boundary.from_polygon(points, [(-0.4, 0), (1.7, 0)], closed=False, follows=False)
    F = mpm.momentum(law, points, u, v) + mpm.signorini(wall, u, v, law=law, friction=0.3)
    F -= ufl.inner(points.density * ufl.as_vector((0.0, -10.0)), v) * points.dX
    problem = mpm.Newmark(F, u, points, stabilisation="ghost")
    records = [problem.step(t) for t in mpm.times(0.12, dt=0.02)]
    assert max(record.iterations for record in records) <= 20
    assert sum(record.halvings for record in records) == 0
    assert points["plastic_strain"].max() > 1e-3


def test_a_saturated_block_hits_a_rough_wall():
    """Its first step took 66 iterations, and was halved twice."""
    grid = mpm.create_lattice(MPI.COMM_WORLD, [0.25 * np.arange(-2, 8), 0.25 * np.arange(-1, 6)])
    points = mpm.fill(grid, mpm.Box((0, 0), (0.9, 0.9)), 2, 2000.0, exact=True)
    points.add_field("velocity", (2,), "m/s", (0.8, -0.6))
    V, Q = mpm.Space(grid, "gimp"), mpm.Space(grid, "gimp", shape=())
    u, p, law = V.increment, Q.increment, mpm.materials.Hencky(1e6, 0.0)
    top = mpm.Surface(points, lambda x: np.isclose(x[1], 0.9), normal=(0, 1))
    F = mpm.poromechanics(
        law, points, (u, p), (V.test, Q.test), permeability=1e-3, porosity=0.4, drained=top,
        gravity=fem.Constant(grid, (0.0, -10.0)),
    )  # fmt: skip
    wall = mpm.Boundary.from_polygon(points, [(-0.4, 0), (1.7, 0)], closed=False, follows=False)
    F += mpm.signorini(wall, u, V.test, law=law, friction=0.3)
    problem = mpm.Newmark(F, [u, p], points, stabilisation=["ghost", "ghost"])
    records = [problem.step(t) for t in mpm.times(0.12, dt=0.02)]
    assert max(record.iterations for record in records) <= 20
    assert sum(record.halvings for record in records) == 0
    force = wall.force()
    assert force[1] > 0.0
    assert force[0] == pytest.approx(-0.3 * force[1], rel=1e-6)


def test_a_thin_point_at_the_edge_does_not_hide_the_point_beside_it():
    """A block of 9 domains and a thin one stands on its outermost marker, too."""
    grid = mpm.create_lattice(
        MPI.COMM_WORLD, [np.linspace(-0.2, 0.8, 11), np.linspace(-0.2, 0.6, 9)]
    )
    points = mpm.fill(grid, mpm.Box((0, 0), (0.452, 0.4)), 2, 1000.0, exact=True)
    V = mpm.Space(grid, "gimp")
    F = mpm.momentum(STONE, points, V.increment, V.test)
    F -= ufl.inner(points.density * ufl.as_vector((0.0, -9.81)), V.test) * points.dX
    wall = mpm.Boundary.from_polygon(points, [(0, 0), (0.452, 0)], closed=False, follows=False)
    F += mpm.signorini(wall, V.increment, V.test, law=STONE, friction=FRICTION)
    mpm.QuasiStatic(F, V.increment, points, stabilisation="ghost").step()
    assert (wall.markers["wall1_on"] > 0).all()


def test_a_disc_slides_down_a_smooth_wall_and_makes_no_energy():
    """Markers had let go beside thin points, and begun again with their neighbours' pressure."""
    cos, sin = np.cos(np.radians(35)), np.sin(np.radians(35))
    along, normal = np.array([cos, -sin]), np.array([sin, cos])
    grid = mpm.create_lattice(MPI.COMM_WORLD, [0.1 * np.arange(-6, 13), 0.1 * np.arange(-9, 10)])
    points = mpm.fill(grid, mpm.Disc(0.4 * normal, 0.4), 2, 1000.0, exact=True)
    V, law = mpm.Space(grid, "gimp"), mpm.materials.Hencky(1e6, 0.3)
    F = mpm.momentum(law, points, V.increment, V.test)
    F -= ufl.inner(points.density * ufl.as_vector((0.0, -9.81)), V.test) * points.dX
    ends = [-0.6 * along, along]
    wall = mpm.Boundary.from_polygon(points, ends, closed=False, follows=False)
    F += mpm.signorini(wall, V.increment, V.test, law=law)
    problem = mpm.Explicit(F, V.increment, points)
    points["velocity"][:] = 2.0 * along
    for t in mpm.times(0.2, dt=0.01):
        problem.step(t)
    energies = problem.energies()
    # it had made 0.9 % of the energy
    assert abs(energies["integrator"]) < 0.004 * (energies.initial + energies.external)
