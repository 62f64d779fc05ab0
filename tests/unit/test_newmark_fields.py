"""Steps in time of several fields."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from conftest import COMM
from dolfinx import fem, mesh
from test_newmark import QUADRILATERAL

import dolfinmpm as mpm


def test_several_fields_in_one_form():
    """A scalar that the displacement does not feel leaves it alone, and is what it was in rest."""
    grid = mesh.create_rectangle(COMM, [(0, 0), (5, 5)], (5, 5), QUADRILATERAL)
    law, found = mpm.materials.Hencky(E=1e5, nu=0.3), {}
    for kind in ("displacement", "both", "scalar"):
        points = mpm.fill(grid, mpm.Box((1.1, 0), (3.53, 2.6)), 2, 1000.0)
        points.add_field("heat")
        U, P = mpm.Space(grid, "gimp"), mpm.Space(grid, "linear", shape=())
        u, v, p, q = U.increment, U.test, P.increment, P.test
        motion = mpm.momentum(law, points, u, v) + points.density * 10.0 * v[1] * points.dX
        warming = ((points.heat + p) * q - points.x0[1] * q) * points.dX
        warming += 0.1 * ufl.inner(ufl.grad(p), ufl.grad(q)) * points.dX
        if kind == "scalar":
            points.add_field("velocity", (2,), "m/s")
            problem = mpm.QuasiStatic(
                warming, p, points, updates={"heat": points.heat + p}, stabilisation="none"
            )
            problem.step()
        else:
            both = kind == "both"
            problem = mpm.Newmark(
                motion + warming if both else motion, [u, p] if both else u, points,
                mpm.fixed(U, "bottom"), updates={"heat": points.heat + p} if both else None,
                stabilisation=["ghost", "none"] if both else "ghost", tolerance=1e-12,
            )  # fmt: skip
            for t in mpm.times(0.05, dt=0.01):
                problem.step(t)
                if t < 0.011:
                    found["first " + kind] = points["heat"].copy()
        found[kind] = points["heat"].copy(), points["velocity"].copy(), points["x"].copy()
    for k in (1, 2):
        np.testing.assert_allclose(found["both"][k], found["displacement"][k], rtol=0, atol=1e-10)
    np.testing.assert_allclose(found["first both"], found["scalar"][0], rtol=1e-7)
    assert np.abs(found["both"][1]).max() > 0.1


def test_fields_that_are_coupled():
    """A pressure that resists the change of volume makes a falling block stiffer."""
    kept = {}
    for bulk in (1.0, 1e7):
        grid = mesh.create_rectangle(COMM, [(0, 0), (5, 5)], (5, 5), QUADRILATERAL)
        points = mpm.fill(grid, mpm.Box((0, 0), (3.0, 2.0)), 2, 1000.0)
        U, P = mpm.Space(grid, "gimp"), mpm.Space(grid, "linear", shape=())
        u, v, p, q = U.increment, U.test, P.increment, P.test
        points.add_field("pressure")
        F = mpm.momentum(mpm.materials.Hencky(E=1e5, nu=0.0), points, u, v)
        F += points.density * 10.0 * v[1] * points.dX
        F -= (points.pressure + p) * ufl.div(v) * points.dX
        F -= (ufl.div(u) * q + p * q / bulk) * points.dX
        bcs = mpm.rollers(U, "left", "bottom") + mpm.prescribed(
            U, lambda x: np.isclose(x[0], 3.0), 0
        )
        problem = mpm.Newmark(
            F, [u, p], points, bcs, updates={"pressure": points.pressure + p},
            stabilisation=["ghost", "none"],
        )  # fmt: skip
        for t in mpm.times(0.1, dt=0.01):
            problem.step(t)
        kept[bulk] = np.abs(points["x"] - points["x0"]).max()
    assert kept[1e7] < 0.2 * kept[1.0]


@pytest.mark.filterwarnings("ignore:the weight .* acts upward")
@pytest.mark.parametrize("mass", ["consistent", "lumped"])
def test_a_mass_that_a_term_adds(mass):
    """Of as much mass as the body has: the acceleration is half as large in every later step."""
    grid = mesh.create_rectangle(COMM, [(0, 0), (5, 8)], (5, 8), QUADRILATERAL)
    points = mpm.fill(grid, mpm.Box((1.1, 2.3), (3.53, 4.9)), 2, 1000.0)
    V = mpm.Space(grid, "gimp")
    u, v, g = V.increment, V.test, fem.Constant(grid, (0.0, 10.0))
    F = mpm.momentum(mpm.materials.Hencky(E=1e5, nu=0.3), points, u, v)
    F += 1000.0 * ufl.inner(mpm.acceleration(points, u), v) * points.dX
    F -= ufl.inner(points.density * g, v) * points.dX
    problem = mpm.Newmark(F, u, points, mass=mass, stabilisation="ghost")
    speeds = []
    for k in range(10):
        # the load jumps in the sixth step
        g.value[1] = 10.0 if k < 5 else -10.0
        problem.step(0.01 * (k + 1))
        speeds.append(points["velocity"][:, 1].copy())
    gains = np.diff(speeds, axis=0)
    np.testing.assert_allclose(gains[[0, 1, 2, 3]], 0.05, rtol=1e-6)
    np.testing.assert_allclose(gains[5:], -0.05, rtol=1e-6)
