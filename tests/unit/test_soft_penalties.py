"""Penalties in Pa/m that are far too small for the body, as in another unit, are named errors."""

from __future__ import annotations

import numpy as np
import pytest
from dolfinx import fem
from mpi4py import MPI

import dolfinmpm as mpm
from dolfinmpm._platform.errors import DoubtfulInputWarning, ParameterError

SOIL = mpm.materials.Hencky(1e7, 0.3)


def block():
    grid = mpm.create_lattice(MPI.COMM_WORLD, [np.arange(0, 4.1, 0.5), np.arange(0, 5.1, 0.5)])
    points = mpm.fill(grid, mpm.Box((0, 0), (4, 4)), 2, 1800.0)
    return grid, points, mpm.Space(grid, "gimp")


def test_the_stiffness_of_a_footing():
    def problem(stiffness):
        grid, points, V = block()
        top = mpm.Surface(points, lambda x: np.isclose(x[1], 4.0), (0, 1), name="top")
        foot = mpm.RigidFooting(top, fem.Constant(grid, 0.01), stiffness=stiffness)
        F = mpm.momentum(SOIL, points, V.increment, V.test)
        F += foot.contact(V.increment, V.test)
        return mpm.QuasiStatic(F, V.increment, points, mpm.fixed(V, "bottom"))

    # the default is 1e4 E/h
    problem(1.001e2 * 1e7 / 0.5)
    with pytest.raises(
        ParameterError, match=r"stiffness = 1000 Pa/m, which goes with E = 0.05 Pa.*2e\+08 times"
    ):
        problem(1e3)
    with pytest.raises(ParameterError, match=r"more than 100 times.*a larger stiffness= \(Pa/m\)"):
        problem(0.999e2 * 1e7 / 0.5)


@pytest.mark.parametrize("tag", [None, 0])
def test_the_stiffness_of_a_contact(tag):
    def problem(**penalty):
        _, points, V = block()
        plate = mpm.RigidBody(mpm.Plane((0, 4), (0, -1)), increment=(0, -0.01), name="plate")
        F = mpm.momentum(SOIL, points, V.increment, V.test)
        F += mpm.contact(plate, points, V.increment, V.test, tag=tag, **penalty)
        return mpm.QuasiStatic(F, V.increment, points, mpm.fixed(V, "bottom"))

    # the default is 5 E/h
    problem(stiffness_per_area=0.0501 * 1e7 / 0.5)
    with pytest.warns(DoubtfulInputWarning, match="penalty = 0.001"):
        problem(penalty=1e-3)
    with pytest.raises(
        ParameterError, match=r"usual 5 E/h = 1e\+08 Pa/m \(E = 1e\+07 Pa.*give penalty=0.005"
    ):
        problem(stiffness_per_area=1e5)


def test_the_stiffness_of_a_contact_of_two_bodies():
    def problem(**penalty):
        grid = mpm.create_lattice(MPI.COMM_WORLD, [np.arange(5.0), np.arange(5.0)])
        points = mpm.fill(grid, mpm.Box((0, 0), (4, 2)), 2, 1800.0, tag=1)
        points += mpm.fill(grid, mpm.Box((1, 2), (3, 3)), 2, 1800.0, tag=2)
        spaces = [mpm.Space(grid, "gimp", tag=tag) for tag in (1, 2)]
        lines = [(4, 2), (0, 2)], [(1, 2), (3, 2)]
        faces = [mpm.Boundary.from_polygon(points, line, closed=False) for line in lines]
        u, v = [V.increment for V in spaces], [V.test for V in spaces]
        F = mpm.contact_between(faces, u, v, **penalty)
        for k in (0, 1):
            F += mpm.momentum(SOIL, points, u[k], v[k], tag=k + 1)
        return mpm.QuasiStatic(F, u, points, mpm.fixed(spaces[0], "bottom"))

    problem(stiffness_per_area=0.0501 * 1e7)
    with pytest.raises(ParameterError, match=r"less than a hundredth of the usual 5 E/h = 5e\+07"):
        problem(stiffness_per_area=1e5)
