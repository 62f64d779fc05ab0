"""Stress as an expression: what it is, its tangent, and derivatives through laws."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import ufl
from conftest import COMM, dense, unit_grid
from dolfinx import fem, mesh
from test_tangent import box, check, strained

import dolfinmpm as mpm
from dolfinmpm._platform.errors import FormError, ParameterError
from dolfinmpm.forms import PointOperator
from dolfinmpm.materials.base import lame

E, NU = 10.0, 0.3
MEASURES = ("large", "small", "jaumann")
KINDS = {1: "interval", 2: "quadrilateral", 3: "hexahedron"}
LAWS = {
    "Hencky": mpm.materials.Hencky(E, NU),
    "VonMises": mpm.materials.VonMises(E, NU, radius=0.3, hardening=2.0),
    "NeoHookean": mpm.materials.NeoHookean(E, NU),
    "NeoHookean varies": mpm.materials.NeoHookean(lambda x: E + x[0], NU),
}


def scene(d=2, n=3):
    grid = unit_grid(KINDS[d], n)
    points = mpm.fill(grid, box(grid), 2, 1.0)
    return grid, points, mpm.Space(grid, "gimp")


@pytest.mark.parametrize(
    ("name", "strain", "fbar", "d"),
    [("Hencky", "large", False, d) for d in (1, 2, 3)]
    + [("NeoHookean", "large", False, d) for d in (1, 2)]
    + [("VonMises", strain, fbar, 2) for strain in MEASURES for fbar in (False, True)][:-1]
    + [("NeoHookean varies", "large", False, 2)],
)
def test_it_is_the_stress_of_the_points(name, strain, fbar, d):
    law = LAWS[name]
    grid, points, V = scene(d, n=2)
    u, v = V.increment, V.test
    kind = {"strain": strain, "fbar": fbar}
    sigma = mpm.stress(law, points, u, **kind)
    assert sigma.ufl_shape == (d, d)
    points.add_field("sigma", (d, d))
    g = fem.Constant(grid, np.zeros(d))
    F = mpm.momentum(law, points, u, v, **kind) - ufl.inner(g, v) * points.dX
    stabilisation = mpm.Stabilisation("ghost", E=E, nu=NU)
    problem = mpm.QuasiStatic(
        F, u, points, mpm.fixed(V, "bottom" if d > 1 else "left"), updates={"sigma": sigma},
        stabilisation=stabilisation,
    )  # fmt: skip
    for load in (0.2, 0.5):
        g.value[:] = 0.3 * load
        g.value[-1] = -load
        problem.step()
        exact = points["stress"][:, :d, :d]
        assert np.abs(exact).max() > 0.05
        np.testing.assert_allclose(points["sigma"], exact, atol=1e-12 * E)
    if name == "VonMises":
        assert (points["plastic_strain"] > 0).any()


def test_f_bar_under_jaumann_s_rate_is_refused():
    _, points, V = scene()
    with pytest.raises(ParameterError, match="fbar=True has no Cauchy stress with Jaumann's rate"):
        mpm.stress(LAWS["Hencky"], points, V.increment, strain="jaumann", fbar=True)


def test_a_stress_that_is_not_in_the_form_has_no_updates():
    _, points, V = scene()
    u, law = V.increment, LAWS["Hencky"]
    points.add_field("sigma", (2, 2))
    F = mpm.momentum(law, points, u, V.test)
    sigma = mpm.stress(law, points, u, strain="small")
    with pytest.raises(FormError, match="which is not in the form; give"):
        mpm.QuasiStatic(F, u, points, updates={"sigma": sigma})


@pytest.mark.parametrize(
    ("name", "fbar"), [("Hencky", False), ("Hencky", True), ("NeoHookean", False)]
)
def test_tangent_of_terms_with_stress(name, fbar):
    """Not only ∇v, and not linear in the stress."""
    _, points, V = scene()
    u, v = V.increment, V.test
    law = LAWS[name]
    sigma = mpm.stress(law, points, u, fbar=fbar)
    F = mpm.momentum(law, points, u, v, fbar=fbar)
    F += ufl.inner(sigma * sigma, ufl.sym(ufl.grad(v))) * points.dx
    F += ufl.tr(sigma) * ufl.inner(u, v) * points.dX
    problem = mpm.QuasiStatic(F, u, points)
    check(strained(points) and problem)


class InNumpy:
    """The neo-Hookean first Piola–Kirchhoff stress of F, and its derivative."""

    def __init__(self, E, nu):
        self.lmbda, self.mu = lame(E, nu)

    def evaluate(self, operand, value, tangent, rows):
        d = int(np.sqrt(operand.shape[1]))
        F = operand.reshape(-1, d, d)
        G = np.linalg.inv(F)
        log_J = np.log(np.linalg.det(F))[:, None, None]
        GT = np.swapaxes(G, 1, 2)
        value[:] = (self.mu * (F - GT) + self.lmbda * log_J * GT).reshape(-1, d * d)
        if tangent is not None:
            one = np.eye(d)
            A = self.mu * np.einsum("ik,jl->ijkl", one, one)[None]
            turn = np.einsum("pjk,pli->pijkl", G, G)
            A = A + (self.mu - self.lmbda * log_J)[..., None, None] * turn
            A = A + self.lmbda * np.einsum("pji,plk->pijkl", G, G)
            tangent[:] = A.reshape(-1, d * d, d * d)
        return -1

    def commit(self, operand, rows):
        return {}


def nitsche(P, u, v, points, g):
    """Internal forces, and the terms of a symmetric Nitsche method as if n were everywhere."""
    n = ufl.as_vector([0.6, 0.8, 0.3][: points.gdim])
    g = g * (1 + ufl.SpatialCoordinate(points.grid)[0] ** 2)
    flux = ufl.dot(P, n)
    F = ufl.inner(P, ufl.grad(v)) * points.dX - ufl.inner(flux, v) * points.dX
    F -= ufl.inner(ufl.derivative(flux, u, v), u - g) * points.dX
    return F + 40 * ufl.inner(u - g, v) * points.dX


@pytest.mark.parametrize("d", [1, 2])
def test_derivatives_through_an_operator_are_those_of_ufl(d):
    """The same law in UFL and in NumPy: the same stiffness, the same steps."""
    found = []
    for in_ufl in (True, False):
        grid, points, V = scene(d, n=2)
        u, v = V.increment, V.test
        F = (ufl.Identity(d) + ufl.grad(u)) * points.F
        law = InNumpy(E, NU)
        if in_ufl:
            G = ufl.inv(F).T
            P = law.mu * (F - G) + law.lmbda * ufl.ln(ufl.det(F)) * G
        else:
            P = PointOperator(points, law, F, (d, d), "NeoHookean in NumPy")
        g = fem.Constant(grid, 0.0 * np.ones(d))
        problem = mpm.QuasiStatic(nitsche(P, u, v, points, g), u, points)
        strained(points)
        g.value[:] = 0.03
        K = dense(problem.stiffness())
        strained(points)["F"] = np.eye(d)
        records = []
        for k in (1, 2):
            g.value[:] = 0.015 * k
            records.append(problem.step())
        found.append((K, points["F"].copy(), [r.iterations for r in records]))
    (K, F, iterations), (other_K, other_F, other_iterations) = found
    np.testing.assert_allclose(other_K, K, atol=1e-8 * np.abs(K).max())
    assert np.abs(F - np.eye(d)).max() > 1e-3
    np.testing.assert_allclose(other_F, F, atol=1e-10)
    assert other_iterations == iterations


@pytest.mark.parametrize("strain", MEASURES)
def test_the_derivative_of_a_law_s_stress_at_small_strain_is_hooke_s(strain):
    """From rest: (∂σ/∂∇u : ∇v) is the linear law of v, exactly, and so is its stiffness."""
    K = []
    for linear in (True, False):
        _, points, V = scene()
        u, v = V.increment, V.test
        law, (lmbda, mu) = LAWS["Hencky"], lame(E, NU)

        def hooke(w, lmbda=lmbda, mu=mu):
            return lmbda * ufl.div(w) * ufl.Identity(2) + 2 * mu * ufl.sym(ufl.grad(w))

        if linear:
            form = ufl.inner(hooke(u), ufl.grad(v)) * points.dX
            form += ufl.inner(hooke(v), ufl.outer(u, ufl.as_vector((0.6, 0.8)))) * points.dX
        else:
            form = mpm.momentum(law, points, u, v, strain=strain)
            slope = ufl.derivative(mpm.stress(law, points, u, strain=strain), u, v)
            form += ufl.inner(slope, ufl.outer(u, ufl.as_vector((0.6, 0.8)))) * points.dX
        K.append(dense(mpm.QuasiStatic(form, u, points).stiffness()))
    np.testing.assert_allclose(K[1], K[0], atol=1e-12 * np.abs(K[0]).max())


@pytest.mark.parametrize(
    ("name", "strain"), [("NeoHookean", "large"), *(("Hencky", strain) for strain in MEASURES)]
)
def test_tangent_of_terms_with_a_derivative_through_a_law(name, strain):
    grid, points, V = scene()
    u, v = V.increment, V.test
    g = fem.Constant(grid, (0.03, -0.02))
    law = LAWS[name]
    sigma = mpm.stress(law, points, u, strain=strain)
    n = ufl.as_vector((0.6, 0.8))
    F = mpm.momentum(law, points, u, v, strain=strain)
    F -= ufl.inner(ufl.derivative(sigma * n, u, v), u - g) * points.dX
    # of a form, with what depends on u itself as well
    F += ufl.derivative(ufl.inner(u, u) * ufl.tr(sigma) * points.dx, u, v)
    problem = mpm.QuasiStatic(F, u, points)
    check(strained(points) and problem, tolerance=1e-5)


def test_newton_keeps_its_order():
    """With the derivative of the stress in the residual, at strains of some ten per cent."""
    grid = mesh.create_rectangle(COMM, [(0, 0), (2, 2)], (4, 4), mesh.CellType.quadrilateral)
    points = mpm.fill(grid, mpm.Box((0, 0), (1.6, 1.5)), 3, 1.0)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    g = fem.Constant(grid, (0.0, 0.0))
    sigma = mpm.stress(LAWS["Hencky"], points, u)
    n = ufl.as_vector((0.0, 1.0))
    F = mpm.momentum(LAWS["Hencky"], points, u, v)
    F -= 0.3 * ufl.inner(ufl.derivative(sigma * n, u, v), u - g) * points.dX
    F -= 0.3 * ufl.inner(sigma * n, v) * points.dX
    F += 20 * ufl.inner(u - g, v) * points.dX
    problem = mpm.QuasiStatic(F, u, points, mpm.fixed(V, "bottom"), tolerance=1e-12)
    g.value[:] = 0.15, -0.25
    record = problem.step()
    assert record.parts == 1
    near = [r for r in record.residuals if r < 1e-2]
    assert len(near) >= 3
    for one, other in itertools.pairwise(near):
        assert other < max(30 * one**2, 1e-11)
    assert np.abs(points["F"] - np.eye(2)).max() > 0.1
