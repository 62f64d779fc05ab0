"""Conditions on one boundary of several soils: each counts at the markers of its soil."""

from __future__ import annotations

import numpy as np
import pytest
from dolfinx import fem
from mpi4py import MPI

import dolfinmpm as mpm
from dolfinmpm._platform.errors import ParameterError

H, X0, LOAD, G = 2.0, 0.13, 10e3, 9.81
LAWS = {1: mpm.materials.Hencky(2e7, 0.0), 2: mpm.materials.Hencky(1e7, 0.0)}


def layers():
    """Two layers of 1 m beside a wall that stands within cells."""
    grid = mpm.create_lattice(MPI.COMM_WORLD, [np.arange(0, 1.6, 0.25), np.arange(0, 2.3, 0.25)])
    points = mpm.fill(grid, mpm.Box((X0, 0), (1.5, 1)), 2, 1900.0, exact=True, tag=1)
    points = points + mpm.fill(grid, mpm.Box((X0, 1), (1.5, H)), 2, 1900.0, exact=True, tag=2)
    wall = mpm.Boundary.from_polygon(points, [(X0, H), (X0, 0)], closed=False, name="wall")
    return points, mpm.Space(grid, "gimp"), wall


@pytest.mark.parametrize(
    "options",
    [{}, {"method": "penalty"}, {"method": "penalty", "stiffness_per_area": 1e9}],
    ids=lambda options: "-".join(options) or "nitsche",
)
def test_the_force_on_a_wall_counts_once(options):
    points, V, wall = layers()
    u, v = V.increment, V.test
    side = mpm.Surface(points, lambda x: np.isclose(x[0], 1.5), (1, 0))
    F = side.traction(fem.Constant(points.grid, (-LOAD, 0.0)), v)
    for tag, law in LAWS.items():
        F += mpm.momentum(law, points, u, v, tag=tag)
        F += mpm.dirichlet(wall, u, v, law=law, tag=tag, direction="normal", **options)
    problem = mpm.QuasiStatic(F, u, points, mpm.rollers(V, "bottom"), stabilisation="ghost")
    problem.step()
    assert wall.force()[0] == pytest.approx(LOAD * H, rel=1e-3)


def test_water_of_two_layers_presses_a_wall_once():
    points, V, wall = layers()
    Q = mpm.Space(points.grid, "gimp", shape=())
    u, v, p = V.increment, V.test, Q.increment
    top = mpm.Surface(points, lambda x: np.isclose(x[1], H), (0, 1))
    gravity = fem.Constant(points.grid, (0.0, -G))
    F = 0
    for (tag, law), drained in zip(LAWS.items(), ((), top)):
        water = {"permeability": 10.0**-tag, "porosity": 0.3 + 0.1 * tag, "drained": drained}
        F += mpm.poromechanics(law, points, (u, p), (v, Q.test), gravity=gravity, tag=tag, **water)
        held = {"law": law, "tag": tag, "direction": "normal", "pore_pressure": p}
        F += mpm.dirichlet(wall, u, v, **held)
    bcs = mpm.rollers(V, "right", "bottom")
    problem = mpm.Transient(F, [u, p], points, bcs, stabilisation=["ghost", "ghost"])
    ground = mpm.Deposit(H, [mpm.Layer(0.0, 1900 * G, K0=0.5)], water_table=H)
    for tag, law in LAWS.items():
        mpm.set_stress(law, points, ground.stress, tag=tag)
    points["pressure"] = ground.pore_pressure(points["x"].T)
    problem.step(1.0)
    thrust = 0.5 * H**2 * (0.5 * (1900 * G - 9810) + 9810)
    assert wall.force()[0] == pytest.approx(thrust, rel=2e-3)


def test_a_tag_belongs_to_a_law():
    _, V, wall = layers()
    alone = {"method": "penalty", "stiffness_per_area": 1e9, "tag": 1}
    with pytest.raises(ParameterError, match="tag = 1 would do nothing: it is the tag of the law"):
        mpm.dirichlet(wall, V.increment, V.test, **alone)
