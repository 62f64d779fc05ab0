"""Whole scenes with a UMAT are those of the built-in law, to rounding."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI
from umats import NEEDS_FORTRAN, umat

import dolfinmpm as mpm

pytestmark = NEEDS_FORTRAN
E, NU, COHESION, FRICTION = 5e6, 0.3, 8e3, 30.0
SLOPE = [(0, 0), (8, 0), (8, 3), (5, 3), (3, 5), (0, 5)]


def slope(law):
    grid = mpm.create_lattice(MPI.COMM_WORLD, [np.linspace(0, 8, 9), np.linspace(0, 6, 7)])
    points = mpm.fill(grid, mpm.Polygon(SLOPE), 2, 2000.0)
    V = mpm.Space(grid, "gimp")
    bcs = mpm.fixed(V, "bottom") + mpm.rollers(V, "left", "right")
    return points, V, bcs, mpm.momentum(law, points, V.increment, V.test, strain="jaumann")


def weight(points, V, g):
    return ufl.inner(points.density * g, V.test) * points.dX


def balanced(law):
    points, V, bcs, F = slope(law)
    F -= weight(points, V, ufl.as_vector((0.0, -9.81)))
    mpm.set_stress(law, points, mpm.geostatic_stress(5.0, 2e4, 0.6), strain="jaumann")
    problem = mpm.QuasiStatic(F, V.increment, points, bcs, stabilisation="ghost")
    assert mpm.equilibrate(problem) > 0
    problem.step()
    return points


def along_an_arc(law):
    points, V, bcs, F = slope(law)
    g = fem.Constant(points.grid, (0.0, -9.81))
    F -= weight(points, V, g)
    problem = mpm.ArcLength(F, V.increment, points, bcs, load=g, length=0.05, stabilisation="ghost")
    for _ in range(3):
        problem.step()
    return points


def wet(law):
    points, V, bcs, _ = slope(law)
    Q = mpm.Space(points.grid, "gimp", shape=())
    F = mpm.poromechanics(
        law, points, (V.increment, Q.increment), (V.test, Q.test), porosity=0.4,
        permeability=1e-6, strain="jaumann", gravity=(0.0, -9.81), modulus=1.3 * E,
    )  # fmt: skip
    unknowns, held = [V.increment, Q.increment], bcs + mpm.fixed(Q, "bottom")
    problem = mpm.Transient(
        F, unknowns, points, held, stabilisation=["ghost", "ghost"], tolerance=1e-11
    )
    problem.step(100.0)
    problem.step(200.0)
    return points


@pytest.mark.parametrize("scene", [balanced, along_an_arc, wet])
def test_a_slope_is_that_of_the_built_in_law(scene):
    own = umat("mohr_coulomb.f90", [E, NU, COHESION, FRICTION, 0.0])
    exact = mpm.materials.MohrCoulomb(E, NU, COHESION, FRICTION)
    a, b = scene(own), scene(exact)
    assert scene is not along_an_arc or b["plastic_strain"].max() > 1e-3
    for name in ("x", "stress"):
        assert np.abs(a[name] - b[name]).max() < 1e-10 * np.abs(b[name]).max(), name


def test_a_factor_of_safety_is_refused():
    law = umat("mohr_coulomb.f90", [E, NU, COHESION, FRICTION, 0.0])
    points, V, bcs, F = slope(law)
    F -= weight(points, V, ufl.as_vector((0.0, -9.81)))
    problem = mpm.QuasiStatic(F, V.increment, points, bcs, stabilisation="ghost")
    with pytest.raises(mpm.errors.ParameterError, match="does not tell its strength"):
        mpm.study.factor_of_safety(problem)
