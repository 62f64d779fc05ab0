"""Nitsche's method at clay that yields under F-bar."""

from __future__ import annotations

import numpy as np
import pytest
from dolfinx import fem
from mpi4py import MPI

import dolfinmpm as mpm


@pytest.mark.parametrize("strain", ["small", "large"])
def test_the_wall_of_a_cavity_in_clay_does_not_bulge(strain):
    """A long cavity is widened by 1 %: the clay yields to twice its radius.

    Its pressure is p₀ + c (1 + ln(b²/a²)) with the radius b of what yields (Hill 1950, chapter V),
    and b²/a² = 2G u/(c a) for ν → ½. For ν = 0.45, b is 2 % and the pressure 0.4 % lower.
    """
    E, nu, c, p0, a, R, h = 1e7, 0.45, 20e3, 100e3, 1.06, 6.0, 0.125
    G, u_a, height = E / 2 / (1 + nu), 0.012, 4 * h
    grid = mpm.create_lattice(MPI.COMM_WORLD, [np.arange(0, R + 0.51, h), np.arange(5) * h])
    points = mpm.fill(grid, mpm.Box((a, 0), (R, height)), 2, 2000.0, axisymmetric=True)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    clay = mpm.materials.Tresca(E, nu, c)
    mpm.set_stress(clay, points, -p0 * np.eye(3), strain=strain)
    F = mpm.momentum(clay, points, u, v, strain=strain, fbar=True)
    wall = mpm.Boundary.from_polygon(points, [(a, height), (a, 0)], closed=False)
    outwards = fem.Constant(grid, 0.0)
    F += mpm.dirichlet(wall, u, v, -outwards, law=clay, direction="normal", strain=strain)
    outer = mpm.Surface(points, lambda x: np.isclose(x[0], R), (1, 0))
    F += outer.pressure(p0, u, v) + mpm.springs(outer, u, v, stiffness=2 * G / R)
    bcs = mpm.rollers(V, "bottom", "top")
    problem = mpm.QuasiStatic(F, u, points, bcs, stabilisation="ghost", tolerance=1e-8)
    for share in np.arange(1, 13) / 12:
        outwards.value = share * u_a
        problem.step()
    pressure = wall.force()[0] / (2 * np.pi * a * height)
    exact = p0 + c * (1 + np.log(2 * G * u_a / (c * a)))
    assert abs(pressure / exact - 1) < 0.02
    along = (points["x"] - points["x0"])[:, 1]
    assert abs(along).max(initial=0.0) < 1e-9 * u_a


def test_a_strip_is_pressed_into_aggregated_clay():
    """A smooth strip with a penalty of 20 M/h took 32 halvings and 949 iterations."""
    cells, c = 12, 10e3
    h, E = 1.0 / cells, 1e4 * c
    top, width = 2 - 0.37 * h, 1 + 0.3 * h
    lines = [np.arange(4 * cells + 1) * h, np.arange(2 * cells + 3) * h]
    grid = mpm.create_lattice(MPI.COMM_WORLD, lines)
    points = mpm.fill(grid, mpm.Box((0, 0), (4, top)), 2, 1000.0)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    clay = mpm.materials.Tresca(E, 0.33, cohesion=c)
    F = mpm.momentum(clay, points, u, v, fbar=True)
    strip = mpm.Boundary.from_polygon(points, [(width, top), (0, top)], closed=False)
    down = fem.Constant(grid, 0.0)
    F += mpm.dirichlet(strip, u, v, down, law=clay, direction=(0.0, 1.0))
    base = mpm.fixed(V, "bottom")
    bcs = mpm.rollers(V, "left", "right") + base
    options = {"stabilisation": "aggregation", "tolerance": 1e-6}
    problem = mpm.QuasiStatic(F, u, points, bcs, **options)
    for step in range(1, 9):
        down.value = -0.02 * step / 8
        problem.step()
    assert sum(record.halvings for record in problem.history) <= 10
    assert sum(record.iterations for record in problem.history) <= 300
    load = -strip.force()[1]
    assert load == pytest.approx(mpm.reaction(problem, base)[1], rel=1e-5)
    # Prandtl's 2 + π, and a smooth punch in cells of an eighth of its width carries a tenth more
    assert 1.0 < load / ((2 + np.pi) * c * width) < 1.12
