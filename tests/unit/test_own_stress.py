"""Internal forces in UFL alone: the points have their stress, and the energy of a potential."""

from __future__ import annotations

import math

import numpy as np
import pytest
import ufl
from conftest import COMM
from dolfinx import fem, mesh

import dolfinmpm as mpm
from dolfinmpm._platform.errors import StateError
from dolfinmpm.materials.base import lame

LAW = mpm.materials.NeoHookean(1e3, 0.3)
LAMBDA, MU = lame(1e3, 0.3)


def body(axisymmetric=False):
    grid = mesh.create_rectangle(COMM, [(0, 0), (2, 2)], (4, 4), mesh.CellType.quadrilateral)
    points = mpm.fill(grid, mpm.Box((0, 0), (1.5, 1.2)), 2, 1.0, axisymmetric=axisymmetric)
    return points, mpm.Space(grid)


def energy(points, u):
    dF = ufl.Identity(points.strain_dim) + mpm.gradient(points, u)
    return LAW.energy(dF * points.F, 1e3, 0.3)


def kirchhoff(points, u):
    """The same as a stress: S with S : ∇̃v of first volumes."""
    dF = ufl.Identity(points.strain_dim) + mpm.gradient(points, u)
    F = dF * points.F
    tau = MU * (F * F.T - ufl.Identity(points.strain_dim))
    tau += LAMBDA * ufl.ln(ufl.det(F)) * ufl.Identity(points.strain_dim)
    return tau * ufl.inv(dF).T


def as_law(points, u, v):
    return mpm.momentum(LAW, points, u, v)


def as_energy(points, u, v):
    return ufl.derivative(energy(points, u) * points.dX, u, v)


def as_half(points, u, v):
    return 0.5 * ufl.derivative(2 * energy(points, u) * points.dX, u, v)


def as_potential(points, u, v):
    """With the potential of a load, which is no strain energy."""
    psi = energy(points, u) - 2.0 * u[0]
    return ufl.derivative(psi * points.dX, u, v) + 2.0 * v[0] * points.dX


def per_present_volume(points, u, v):
    return ufl.derivative(energy(points, u) / ufl.det(points.F) * points.dx, u, v)


def as_stress(points, u, v):
    return ufl.inner(kirchhoff(points, u), mpm.gradient(points, v)) * points.dX


def moved(terms, kind=mpm.QuasiStatic, axisymmetric=False, steps=2, **options):
    points, V = body(axisymmetric)
    u, v = V.increment, V.test
    F = terms(points, u, v)
    F -= ufl.inner(points.density * fem.Constant(points.grid, (3.0, -60.0)), v) * points.dX
    top = mpm.Surface(points, lambda x: np.isclose(x[1], 1.2), (0, 1))
    F += top.traction((5.0, -20.0), v)
    bcs = mpm.rollers(V, "left") + mpm.fixed(V, "bottom")
    problem = kind(F, u, points, bcs, **options)
    for k in range(steps):
        problem.step(*(() if kind is mpm.QuasiStatic else (2e-3 * (k + 1),)))
    return points, problem


@pytest.mark.parametrize("terms", [as_energy, as_half, as_potential, per_present_volume, as_stress])
@pytest.mark.parametrize(
    ("kind", "axisymmetric"),
    [(mpm.QuasiStatic, False), (mpm.QuasiStatic, True), (mpm.Newmark, False), (mpm.Newmark, True)],
)
def test_the_stress_is_that_of_the_law_it_states(terms, kind, axisymmetric):
    points, problem = moved(terms, kind, axisymmetric, stabilisation="aggregation")
    other, expected = moved(as_law, kind, axisymmetric, stabilisation="aggregation")
    d = points.strain_dim
    np.testing.assert_allclose(points["x"], other["x"], rtol=1e-9)
    scale = np.abs(other["stress"]).max()
    assert scale > 1.0
    np.testing.assert_allclose(
        points["stress"][:, :d, :d], other["stress"][:, :d, :d], atol=1e-7 * scale
    )
    if kind is mpm.QuasiStatic:
        return
    found, right = problem.energies(), expected.energies()
    assert found.kinetic == pytest.approx(right.kinetic, rel=1e-8)
    if terms is as_stress:
        # the stress alone does not tell its potential
        assert math.isnan(found.strain)
        assert "stored_energy" not in points.fields
        return
    assert right.strain > 0
    assert found.strain == pytest.approx(right.strain, rel=1e-6)
    if d == 2:
        assert found.dissipated == pytest.approx(right.dissipated, abs=1e-6 * right.strain)


def test_a_viscosity_stores_nothing():
    def terms(points, u, v):
        D = ufl.sym(ufl.grad(u))
        psi = energy(points, u) + 5.0 / (2 * points.dt) * ufl.inner(D, D)
        return ufl.derivative(psi * points.dX, u, v)

    points, problem = moved(terms, mpm.Newmark)
    assert math.isnan(problem.energies().strain)
    assert np.abs(points["stress"]).max() > 1.0


def test_of_two_parts_one_may_have_a_law():
    points, V = body()
    points["tag"] = points["x"][:, 0] > 0.75
    u, v = V.increment, V.test
    dX = points.dX(1)
    F = mpm.momentum(LAW, points, u, v, tag=0) + ufl.derivative(energy(points, u) * dX, u, v)
    F -= ufl.inner(points.density * fem.Constant(points.grid, (3.0, -60.0)), v) * points.dX
    top = mpm.Surface(points, lambda x: np.isclose(x[1], 1.2), (0, 1))
    F += top.traction((5.0, -20.0), v)
    bcs = mpm.rollers(V, "left") + mpm.fixed(V, "bottom")
    mpm.QuasiStatic(F, u, points, bcs, stabilisation="aggregation").step()
    other, _ = moved(as_law, stabilisation="aggregation", steps=1)
    np.testing.assert_allclose(points["stress"][:, :2, :2], other["stress"][:, :2, :2], atol=1e-6)
    # nobody knows what is across the plane
    assert (points["stress"][points["tag"] == 1, 2, 2] == 0).all()


def test_a_stress_of_the_user_s_own_stays():
    """Where the form reads the field, or an update sets it, it is the user's."""
    points, V = body()
    u, v = V.increment, V.test
    sigma = 1e3 * ufl.sym(ufl.grad(u))
    before = ufl.as_tensor([[points.stress[i, j] for j in range(2)] for i in range(2)])
    F = ufl.inner(before + sigma, ufl.grad(v)) * points.dX + 10 * v[1] * points.dX
    problem = mpm.QuasiStatic(F, u, points, mpm.fixed(V, "bottom"), stabilisation="aggregation")
    problem.step()
    assert (points["stress"] == 0).all()
    x = points["x"].copy()
    points["stress"][:, 1, 1] = 1.0
    problem.step()
    assert (points["stress"][:, 1, 1] == 1.0).all()
    assert np.abs(points["x"] - x).max() > 1e-6
    points, V = body()
    u, v = V.increment, V.test
    own = ufl.as_tensor([[7.0 * (i == j) for j in range(3)] for i in range(3)])
    F = ufl.inner(1e3 * ufl.grad(u), ufl.grad(v)) * points.dX + 10 * v[1] * points.dX
    problem = mpm.QuasiStatic(
        F, u, points, mpm.fixed(V, "bottom"), updates={"stress": own}, stabilisation="aggregation"
    )
    problem.step()
    np.testing.assert_array_equal(points["stress"], [7 * np.eye(3)] * len(points))


def test_a_law_that_follows_asks_for_its_state():
    points, _ = moved(as_energy, stabilisation="aggregation")
    V = mpm.Space(points.grid)
    law = mpm.materials.Hencky(1e3, 0.3)
    F = mpm.momentum(law, points, V.increment, V.test)
    with pytest.raises(StateError, match=r"moved 30 under an energy in UFL; .*mpm\.set_stress"):
        mpm.QuasiStatic(F, V.increment, points)


def test_laws_of_the_library_cost_nothing_more():
    _, problem = moved(as_law, stabilisation="aggregation", steps=0)
    assert problem.form.ufl_stresses == []
    points, V = body()
    points["tag"] = points["x"][:, 0] > 0.75
    F = mpm.momentum(LAW, points, V.increment, V.test, tag=0)
    F += mpm.momentum(LAW, points, V.increment, V.test, tag=1) + 10 * V.test[1] * points.dX
    assert mpm.QuasiStatic(F, V.increment, points).form.ufl_stresses == []
