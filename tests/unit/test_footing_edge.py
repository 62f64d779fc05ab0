"""The edge of a rigid footing stays where it is while soil flows out from under it."""

import numpy as np
import pytest
from dolfinx import fem
from mpi4py import MPI

import dolfinmpm as mpm


def pressed(settlement, steps, *, width=3.0, grows=1.0):
    """Loads (N/m) of a smooth footing on clay, c = 10 kPa at its top, by steps; points, face."""
    h = 0.125
    grid = mpm.create_lattice(MPI.COMM_WORLD, [np.arange(0.0, n * h + 0.01, h) for n in (24, 14)])
    points = mpm.fill(grid, mpm.Box((0, 0), (width, 1.5)), per_cell=2, density=1e3)
    V = mpm.Space(grid, "gimp")
    clay = mpm.materials.Tresca(1e8, 0.33, cohesion=lambda x: 10e3 * (1 + grows * (1.5 - x[1])))
    F = mpm.momentum(clay, points, V.increment, V.test, fbar=True)
    under = mpm.Surface(points, lambda x: np.isclose(x[1], 1.5) & (x[0] < 1), normal=(0, 1))
    s = fem.Constant(grid, 0.0)
    footing = mpm.RigidFooting(under, s, rough=False, E=1e8)
    F += footing.contact(V.increment, V.test)
    bcs = mpm.rollers(V, "left", "bottom")
    if width > 1.0:
        bcs += mpm.fixed(V, "bottom") + mpm.rollers(V, "right")
    problem = mpm.QuasiStatic(F, V.increment, points, bcs, stabilisation="aggregation")
    loads = []
    for k in range(1, steps + 1):
        s.value = settlement * k / steps
        problem.step()
        loads.append(footing.load())
    return np.array(loads), points, under


def reach(points, under):
    """How far faces reach (m)."""
    at = points[under.area.name][:, 1] > 0
    return points.comm.allreduce((points["x"] + points["l"])[at, 0].max(initial=0.0), op=MPI.MAX)


def test_faces_beyond_the_edge_do_not_widen_the_footing():
    """They held the nodes of the next cell, and the load grew from 7.1 to 8.3 c within 6 mm."""
    loads, points, under = pressed(0.01, 5)
    assert reach(points, under) > 1.01
    assert loads[-1] == pytest.approx(loads[1], rel=0.05)
    assert 7.0 < loads[1] / 10e3 < 7.3


def test_faces_that_have_left_have_no_force():
    loads, points, under = pressed(0.03, 6)
    left = (points["x"][:, 0] > 1.0) & (points[under.area.name][:, 1] > 0)
    assert points.comm.allreduce(int(left.sum())) == 1
    # with gaps of millimetres these faces would carry thousands of times this load
    assert 7.0 < loads[-1] / 10e3 < 7.8


def test_a_platen_that_covers_the_body_has_no_edge():
    """The block becomes wider, and all of its top carries 2c."""
    loads, points, under = pressed(0.15, 3, width=1.0, grows=0.0)
    assert reach(points, under) == pytest.approx(1.5 / 1.35, rel=1e-3)
    assert loads[-1] == pytest.approx(2 * 10e3 * 1.5 / 1.35, rel=1e-2)
