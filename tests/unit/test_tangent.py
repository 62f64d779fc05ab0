"""The tangent is the derivative of the residual, by finite differences."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from conftest import Linearised, unit_grid
from dolfinx import fem

import dolfinmpm as mpm


def box(grid, top=0.83):
    d = grid.geometry.dim
    return mpm.Box((0.0,) * d, (1.0,) * (d - 1) + (top,))


def check(problem, size=0.02, tolerance=2e-6):
    """Compare K with central differences of f at random increments."""
    linearised = Linearised(problem)
    rng = np.random.default_rng(3)
    start = rng.uniform(-size, size, linearised.size)
    linearised.tangent(start)
    direction = rng.uniform(-1, 1, linearised.size)
    exact, residual, t = linearised.product(direction), linearised.residual, 1e-6
    numerical = (residual(start + t * direction) - residual(start - t * direction)) / (2 * t)
    scale = np.abs(exact).max()
    assert scale > 0
    np.testing.assert_allclose(exact, numerical, atol=tolerance * scale)
    residual(start)
    return linearised


def strained(points):
    """Points with a history: an elastic strain that is not a multiple of the identity."""
    rng = np.random.default_rng(5)
    d = points.gdim
    F = np.eye(d) + rng.uniform(-0.2, 0.2, (len(points), d, d))
    points["F"] = F
    if "be" in points.fields:
        b = np.zeros((len(points), 3, 3))
        b[:] = np.eye(3)
        b[:, :d, :d] = F @ np.swapaxes(F, 1, 2)
        points["be"] = np.stack([b[:, 0, 0], b[:, 1, 1], b[:, 2, 2], b[:, 0, 1], b[:, 1, 2],
                                 b[:, 0, 2]], axis=1)  # fmt: skip
    return points


@pytest.mark.parametrize("law", [mpm.materials.Hencky, mpm.materials.NeoHookean])
def test_laws_on_every_grid(any_grid, law):
    points = mpm.fill(any_grid, box(any_grid), 2, 1.0)
    V = mpm.Space(any_grid, "linear")
    F = mpm.momentum(law(E=10.0, nu=0.3), points, V.increment, V.test)
    problem = mpm.QuasiStatic(F, V.increment, points, mpm.fixed(V, "bottom"))
    strained(points)
    check(problem)


@pytest.mark.parametrize("kind", ["interval", "quadrilateral", "hexahedron"])
def test_gimp_with_ghost_penalty(kind):
    grid = unit_grid(kind)
    points = mpm.fill(grid, box(grid, 0.5), 2, 1.0)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    F = mpm.momentum(mpm.materials.Hencky(E=10.0, nu=0.3), points, u, v)
    F += mpm.ghost(points, u, v, gamma=1 / 3)
    problem = mpm.QuasiStatic(F, u, points, mpm.fixed(V, "bottom"))
    strained(points)
    check(problem)


def test_the_tangent_of_equal_stretches():
    """Divided differences of stress meet the derivative where two or three stretches are equal."""
    for kind in ("quadrilateral", "hexahedron"):
        grid = unit_grid(kind, 2)
        points = mpm.fill(grid, box(grid), 2, 1.0)
        V = mpm.Space(grid, "linear")
        law = mpm.materials.Hencky(E=10.0, nu=0.3)
        F = mpm.momentum(law, points, V.increment, V.test)
        problem = mpm.QuasiStatic(F, V.increment, points, mpm.fixed(V, "bottom"))
        for size in (0.0, 1e-9, 1e-7, 1e-5):
            check(problem, size)


def test_values_gradients_functions_and_nonlinear_facet_terms():
    """A form with everything that may stand in one."""
    grid = unit_grid("quadrilateral")
    points = mpm.fill(grid, box(grid, 0.5), 2, 1.0)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    W = fem.functionspace(grid, ("Lagrange", 1))
    w = fem.Function(W)
    w.interpolate(lambda x: 1 + x[0] + x[1] ** 2)
    k = fem.Constant(grid, 3.0)
    x = ufl.SpatialCoordinate(grid)
    F = mpm.momentum(mpm.materials.Hencky(E=10.0, nu=0.3), points, u, v)
    F += k * w * (1 + ufl.inner(u, u)) * ufl.inner(u, v) * points.dx
    F += ufl.inner(u, ufl.grad(w)) * ufl.inner(ufl.grad(u) * x, v) * points.dX
    F += ufl.exp(u[0]) * ufl.inner(ufl.grad(v), points.F) * points.dX
    n = ufl.FacetNormal(grid)
    j = ufl.jump(ufl.grad(u), n)
    F += (1 + ufl.inner(j, j)) * ufl.inner(j, ufl.jump(ufl.grad(v), n)) * points.dS
    F += ufl.inner(u, u) * v[0] * ufl.dx
    problem = mpm.QuasiStatic(F, u, points, mpm.fixed(V, "bottom"))
    (region,) = problem.form.regions
    assert region.tangent[0, 0].value
    assert not problem.form.parts.grid.linear
    check(problem)


def test_two_fields():
    """Displacement and a scalar, coupled both ways at the points and over facets."""
    grid = unit_grid("quadrilateral")
    points = mpm.fill(grid, box(grid, 0.5), 2, 1.0)
    V, Q = mpm.Space(grid, "gimp"), mpm.Space(grid, "gimp", shape=())
    u, v, p, q = V.increment, V.test, Q.increment, Q.test
    F = mpm.momentum(mpm.materials.Hencky(E=10.0, nu=0.3), points, u, v)
    F -= p * ufl.div(v) * points.dx
    F += (ufl.div(u) + p**2) * q * points.dx + ufl.inner(ufl.grad(p), ufl.grad(q)) * points.dX
    F += mpm.ghost(points, u, v, gamma=0.3) + mpm.ghost(points, p, q, gamma=0.2)
    F += p * v[1] * points.dX
    bcs = mpm.fixed(V, "bottom") + mpm.prescribed(Q, "bottom", 0)
    problem = mpm.QuasiStatic(F, [u, p], points, bcs)
    strained(points)
    check(problem)


def test_a_law_of_another_operand():
    """An operator may act on any expression of the increment."""
    from dolfinmpm.forms import PointOperator

    class Cubic:
        def evaluate(self, operand, value, tangent, rows):
            value[:] = operand**3
            if tangent is not None:
                tangent[:] = 0
                for i in range(operand.shape[1]):
                    tangent[:, i, i] = 3 * operand[:, i] ** 2
            return -1

        def commit(self, operand, rows):
            return {}

    grid = unit_grid("quadrilateral")
    points = mpm.fill(grid, box(grid), 2, 1.0)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    strain = ufl.sym(ufl.grad(u)) + ufl.outer(u, u) + ufl.Identity(2)
    stress = PointOperator(points, Cubic(), strain, (2, 2), "cubic")
    F = ufl.inner(ufl.dot(stress, stress), ufl.grad(v)) * points.dX
    problem = mpm.QuasiStatic(F, u, points, mpm.fixed(V, "bottom"))
    check(problem, tolerance=1e-5)
