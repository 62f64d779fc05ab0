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
