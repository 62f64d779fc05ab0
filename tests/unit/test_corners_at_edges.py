"""Edges of rigid bodies in line with corners of domains."""

import numpy as np
import pytest
from mpi4py import MPI

import dolfinmpm as mpm

COMM = MPI.COMM_WORLD
E = 1e6


def pressed(body, low, high, held, way, basis="gimp", nu=0.3, penalty=5.0):
    """Force on a smooth rigid body that goes down by a way in one step (N)."""
    h, d = 0.25, len(low)
    lines = [np.arange(a - h, b + 1.5 * h, h) for a, b in zip(low, high)]
    lines[0] = np.arange(low[0], high[0] + 1.5 * h, h)
    points = mpm.fill(mpm.create_lattice(COMM, lines), mpm.Box(low, high), 2, 1.0)
    V = mpm.Space(points.grid, basis)
    u, v = V.increment, V.test
    tool = mpm.RigidBody(body, increment=(0.0,) * (d - 1) + (-way,))
    F = mpm.momentum(mpm.materials.Hencky(E, nu), points, u, v)
    F += mpm.contact(tool, points, u, v, penalty=penalty)
    bcs = mpm.fixed(V, held)
    record = mpm.QuasiStatic(F, u, points, bcs, stabilisation="ghost").step()
    assert record.iterations <= 8
    return tool.force


@pytest.mark.parametrize("d", [2, 3])
def test_an_edge_bends_a_cantilever(d):
    """Timoshenko's beam under its end; it had twice the force, and five times that along it."""
    edge, length, way = 3.5, 4.0, 1e-3
    box = mpm.Box((edge,) + (-1,) * (d - 2) + (1,), (length + 1,) + (2,) * (d - 1))
    high = (length,) + (1,) * (d - 1)
    force = pressed(box, (0,) * d, high, "left", way, nu=0.0, penalty=100.0)
    exact = way / (edge**3 / 3 / (E / 12) + edge / (5 / 12 * E))
    assert force[-1] == pytest.approx(exact, rel=0.03)
    np.testing.assert_allclose(force[:-1], 0.0, atol=1e-6 * exact)


@pytest.mark.parametrize("basis", ["gimp", "bspline2"])
def test_a_box_on_a_part_of_a_block(basis):
    """It had 3 to 8 % of its force along the smooth surface."""
    way, forces = 1e-3, []
    for side in (2.0, 2.0 - 1e-6):
        box = mpm.Box((side, 2), (5, 3))
        force = pressed(box, (0, 0), (4, 2), lambda x: x[1] < 1e-9, way, basis)
        assert abs(force[0]) < 1e-9 * force[1]
        forces.append(force[1])
    # with its side beside the line
    assert forces[0] == pytest.approx(forces[1], rel=0.01)


def test_an_edge_that_points_down_touches():
    """Domains on both sides of the edge of a wedge touch it in the first step."""
    wedge = mpm.Polygon([(2, 2), (3, 3), (1, 3)])
    force = pressed(wedge, (0, 0), (4, 2), lambda x: x[1] < 1e-9, 1e-3)
    assert force[1] > 10.0
    assert abs(force[0]) < 1e-4 * force[1]


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize(("basis", "beyond"), [("gimp", 0.0), ("gimp", 1e-4), ("bspline2", 0.0)])
@pytest.mark.parametrize("sides", [True, False])
def test_a_plate_as_wide_as_its_soil_in_steps(d, basis, beyond, sides):
    """It lost half a domain at its edge from the second step on: strains were 29 % off there."""
    h, way, steps, nu = 0.5 if d == 3 else 0.25, 0.01, 4, 0.3
    lines = [np.arange(0.0, (1.0 if sides else 1.0 + h) + h / 2, h)] * (d - 1)
    lines.append(np.arange(0.0, 1.0 + 1.5 * h, h))
    points = mpm.fill(mpm.create_lattice(COMM, lines), mpm.Box((0,) * d, (1,) * d), 2, 1.0)
    V = mpm.Space(points.grid, basis)
    u, v = V.increment, V.test
    wide = (1.0 + beyond,) * (d - 1)
    box = mpm.Box((-beyond,) * (d - 1) + (1,), (*wide, 2))
    plate = mpm.RigidBody(box, increment=(0.0,) * (d - 1) + (-way / steps,))
    F = mpm.momentum(mpm.materials.Hencky(E, nu), points, u, v)
    F += mpm.contact(plate, points, u, v)
    held = ["left", "bottom"] + ["front"] * (d == 3)
    held += (["right"] + ["back"] * (d == 3)) * sides
    problem = mpm.QuasiStatic(F, u, points, mpm.rollers(V, *held), stabilisation="ghost")
    for _ in range(steps):
        assert problem.step().iterations <= 3
    np.testing.assert_allclose(points["F"] - points["F"][0], 0.0, atol=1e-10)
    np.testing.assert_allclose(plate.force[:-1], 0.0, atol=1e-9 * plate.force[-1])
