"""Gradients of vectors in UFL at axisymmetric points: the hoop term is there, or missed aloud."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from conftest import COMM
from dolfinx import fem, mesh

import dolfinmpm as mpm
from dolfinmpm._platform.errors import FormError
from dolfinmpm.body.axisymmetry import in_section


def scene(axisymmetric=True):
    grid = mesh.create_rectangle(COMM, [(0, 0), (1, 1)], (4, 4), mesh.CellType.quadrilateral)
    points = mpm.fill(grid, mpm.Box((0, 0), (1, 1)), 2, 1.0, axisymmetric=axisymmetric)
    return points, mpm.Space(grid)


def energy(strain, change):
    return ufl.tr(strain) * ufl.tr(change) + 2 * ufl.inner(strain, change)


def elastic(points, V, grad):
    strain, change = (ufl.sym(grad(w)) for w in (V.increment, V.test))
    load = 0.01 * V.test[1] * points.dX
    return energy(strain, change) * points.dX + load


BAD = {
    "sym": lambda p, u, v: energy(ufl.sym(ufl.grad(u)), in_section(p, mpm.gradient(p, v))),
    "inner": lambda p, u, v: ufl.inner(ufl.grad(u), ufl.grad(v)),
    "div": lambda p, u, v: ufl.div(u) * ufl.div(v),
    "nabla_grad": lambda p, u, v: ufl.inner(ufl.nabla_grad(u), ufl.nabla_grad(v)),
    "nabla_div": lambda p, u, v: ufl.nabla_div(u) * ufl.nabla_div(v),
    "index": lambda p, u, v: u[ufl.i].dx(ufl.i) * v[0],
    "det": lambda p, u, v: ufl.det(ufl.Identity(2) + ufl.grad(u)) * v[0],
    "function": lambda p, u, v: ufl.div(fem.Function(V_of(p))) * v[0],
}


def V_of(points):
    return fem.functionspace(points.grid, ("Lagrange", 1, (2,)))


@pytest.mark.parametrize("name", BAD)
def test_plane_gradients_of_vectors_are_refused(name):
    points, V = scene()
    u, v = V.increment, V.test
    term = BAD[name](points, u, v) * points.dX
    with pytest.raises(FormError, match=r"hoop term u_r/r .* write mpm\.gradient\(points, u\)"):
        mpm.QuasiStatic(elastic(points, V, lambda w: mpm.gradient(points, w)) + term, u, points)
    # the same is right in plane strain
    plane, V = scene(axisymmetric=False)
    u, v = V.increment, V.test
    mpm.QuasiStatic(elastic(plane, V, ufl.grad) + BAD[name](plane, u, v) * plane.dX, u, plane)


def test_an_energy_with_a_plane_gradient_is_refused():
    points, V = scene()
    u, v = V.increment, V.test
    for grad, fine in ((ufl.grad, False), (lambda w: mpm.gradient(points, w), True)):
        e = ufl.sym(grad(u))
        F = ufl.derivative(energy(e, e) / 2 * points.dX, u, v)
        if fine:
            mpm.QuasiStatic(F, u, points)
            continue
        with pytest.raises(FormError, match="hoop term"):
            mpm.QuasiStatic(F, u, points)


def test_updates_with_a_plane_gradient_are_refused():
    points, V = scene()
    u = V.increment
    points.add_field("growth")
    F = elastic(points, V, lambda w: mpm.gradient(points, w))
    with pytest.raises(FormError, match="hoop term"):
        mpm.QuasiStatic(F, u, points, updates={"growth": ufl.div(u)})
    mpm.QuasiStatic(F, u, points, updates={"growth": ufl.tr(mpm.gradient(points, u))})


def test_scalars_components_and_slopes_along_a_vector_have_no_hoop_term():
    points, V = scene()
    u, v = V.increment, V.test
    F = elastic(points, V, lambda w: mpm.gradient(points, w))
    F += ufl.grad(u)[0, 1] * ufl.grad(v)[1, 0] * points.dX
    F += ufl.dot(ufl.grad(u[0]), ufl.grad(v[0])) * points.dX + u[0].dx(1) * v[0] * points.dX
    along = fem.Constant(points.grid, (0.1, 0.2))
    F += ufl.dot(ufl.dot(ufl.grad(u), along), v) * points.dX
    top = mpm.Surface(points, lambda x: np.isclose(x[1], 1.0), (0, 1))
    F += top.traction((0.0, -0.01), v) + top.pressure(0.01, u, v)
    mpm.QuasiStatic(F, u, points, mpm.rollers(V, "left", "bottom"))


def test_rings_of_ufl_move_as_they_must():
    """A solid cylinder under its weight: radial strains are those of the axis everywhere."""
    points, V = scene()
    F = elastic(points, V, lambda w: mpm.gradient(points, w))
    F -= 0.01 * V.test[1] * points.dX
    tension = fem.Constant(points.grid, 0.01)
    side = mpm.Surface(points, lambda x: np.isclose(x[0], 1.0), (1, 0))
    F += side.traction(ufl.as_vector((tension, 0.0)), V.test)
    mpm.QuasiStatic(F, V.increment, points, mpm.rollers(V, "left", "bottom")).step()
    # λ = μ = 1: σ_r = σ_θ = 4 e_r + e_z, σ_z = 2 e_r + 3 e_z = 0
    radial = 0.01 / (4 - 2 / 3)
    moved = points["x"] - points["x0"]
    np.testing.assert_allclose(moved[:, 0], radial * points["x0"][:, 0], rtol=1e-9)
    np.testing.assert_allclose(moved[:, 1], -2 / 3 * radial * points["x0"][:, 1], rtol=1e-9)
