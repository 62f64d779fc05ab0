"""Initial stress: the law returns it, equilibrium holds, and what cannot be is refused."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from conftest import COMM, unit_grid
from dolfinx import fem, mesh
from test_strain_formulations import KINDS, LAWS, MEASURES, each_dimension, each_law, each_measure

import dolfinmpm as mpm
from dolfinmpm._platform.errors import FieldShapeError, ParameterError, StateError
from dolfinmpm.kinematics import strain_formulation
from dolfinmpm.materials.elasticinverse import elastic_strain


def some_points(d, n=2):
    grid = unit_grid(KINDS[d], n)
    return mpm.fill(grid, mpm.Box((0.0,) * d, (1.0,) * d), 2, 1.0)


def stresses(d, n, seed=0, pressure=8e3, shear=1e3):
    """Compression with some shear, all of it within the strength of `LAWS`; Cauchy, Pa."""
    rng = np.random.default_rng(seed)
    sigma = np.zeros((n, 3, 3))
    part = rng.uniform(-shear, shear, (n, d, d))
    sigma[:, :d, :d] = 0.5 * (part + np.swapaxes(part, 1, 2))
    sigma -= np.eye(3) * rng.uniform(0.8 * pressure, 1.2 * pressure, (n, 1, 1))
    sigma[: n // 4] = -pressure * np.eye(3)  # equal principal stresses too
    return sigma


def returned(points, law, strain):
    """Cauchy stress for no increment, and the internal variables after it."""
    d = points.gdim
    operator = strain_formulation(law, points, strain)
    operator.bind()
    new = operator.commit(np.zeros((len(points), d * d)), operator.rows)
    return new["stress"], {name: new[name] for name in law.internal}


@each_dimension
@each_measure
@each_law
def test_the_law_returns_it(law, strain, d):
    points = some_points(d)
    if strain == "large":
        points["F"] = np.eye(d) * 0.98  # the law's stress is Kirchhoff's: J counts
    sigma = stresses(d, len(points))
    mpm.set_stress(law, points, sigma, strain=strain)
    found, internal = returned(points, law, strain)
    np.testing.assert_allclose(found, sigma, atol=1e-9 * np.abs(sigma).max())
    np.testing.assert_array_equal(points["stress"], sigma)
    for name, values in internal.items():
        np.testing.assert_array_equal(values, points[name])


@each_measure
def test_before_or_after_momentum_and_for_every_way_to_give_it(strain):
    law = LAWS["MohrCoulomb"]
    sigma = np.diag([-4e3, -6e3, -5e3])
    states = []
    for when in ("before", "after"):
        points = some_points(2)
        V = mpm.Space(points.grid, "linear")
        given = {
            "before": sigma,
            "after": lambda x: np.broadcast_to(sigma, (x.shape[1], 3, 3)),
        }[when]
        if when == "before":
            mpm.set_stress(law, points, given, strain=strain)
        mpm.momentum(law, points, V.increment, V.test, strain=strain)
        if when == "after":
            mpm.set_stress(law, points, given, strain=strain)
        states.append(points[strain_formulation(law, points, strain).state].copy())
    np.testing.assert_array_equal(*states)
    assert np.ptp(states[0], axis=0).max() == 0.0


@pytest.mark.parametrize("factor", [0.05, 0.9, 30.0, 1e3])
@pytest.mark.parametrize(("mu0", "alpha"), [(5.4e6, 0.0), (0.0, 80.0), (2e5, 60.0)])
def test_pressures_far_from_the_reference(factor, mu0, alpha):
    """Cam-Clay's elasticity is exponential: Newton's method must not run away."""
    law = mpm.materials.CamClay(
        swelling=0.018,
        compression=0.13,
        M=1.05,
        mu0=mu0,
        alpha=alpha,
        reference_pressure=2e4,
        preconsolidation=1e9,
    )
    rng = np.random.default_rng(6)
    p = 2e4 * factor
    stress = -p * (1 + rng.uniform(-0.2, 0.2, (200, 3)))
    parameters = law.parameter_array()
    internal = np.full((200, 1), 1e9)
    strain, good, reached = elastic_strain(law, stress, internal, parameters)
    assert good.all()
    np.testing.assert_allclose(reached, stress, rtol=1e-10)
    np.testing.assert_allclose(law.respond(strain, internal=internal).stress, stress, rtol=1e-10)


@pytest.mark.parametrize("scale", [1.0, 0.999999999999])
def test_a_stress_on_the_yield_surface_is_inside(scale):
    """Normally consolidated clay, and Mohr–Coulomb's active state."""
    clay = LAWS["CamClay"]
    sand = mpm.materials.MohrCoulomb(1e6, 0.3, 0.0, 30.0)
    points = some_points(2)
    sigma = -4e4 * scale * np.eye(3)
    mpm.set_stress(clay, points, sigma)
    np.testing.assert_allclose(returned(points, clay, "large")[0][0], sigma, rtol=1e-9, atol=1e-5)
    points = some_points(2)
    sigma = np.diag([-1e4 / 3 / scale, -1e4, -5e3])
    mpm.set_stress(sand, points, sigma)
    np.testing.assert_allclose(returned(points, sand, "large")[0][0], sigma, rtol=1e-9, atol=1e-5)


def test_internal_variables_count():
    """After hardening a stress outside the first yield surface is admissible."""
    law = LAWS["VonMises"]
    sigma = np.diag([0.0, 2.2e4, 0.0]) * 1.5
    points = some_points(2)
    with pytest.raises(StateError, match="outside the yield surface"):
        mpm.set_stress(law, points, sigma, strain="small")
    points["plastic_strain"] = 0.2
    mpm.set_stress(law, points, sigma, strain="small")
    np.testing.assert_allclose(returned(points, law, "small")[0][0], sigma, rtol=1e-9, atol=1e-5)


def test_parameters_that_vary():
    law = mpm.materials.Hencky(E=lambda x: 1e6 * (1 + x[0]), nu=0.3)
    points = some_points(2)
    sigma = stresses(2, len(points))
    mpm.set_stress(law, points, sigma)
    np.testing.assert_allclose(returned(points, law, "large")[0], sigma, rtol=1e-9, atol=1e-5)
    strain = np.sqrt(((points["be"] - [1, 1, 1, 0, 0, 0]) ** 2).sum(axis=1))
    assert np.corrcoef(strain, 1 / (1 + points["x0"][:, 0]))[0, 1] > 0.8


def test_what_cannot_be_is_refused_and_changes_nothing():
    points = some_points(2)
    n = len(points)
    law = LAWS["VonMises"]
    good = stresses(2, n)
    mpm.set_stress(law, points, good)
    before = {name: values.copy() for name, values in points.fields.items()}
    outside = good.copy()
    outside[5] += np.diag([5e4, 0.0, 0.0])
    with pytest.raises(StateError) as caught:
        mpm.set_stress(law, points, outside)
    message = str(caught.value)
    number, place = points["id"][5], points["x"][5]
    assert f"of point {number} at {place} m lie outside the yield surface (f = " in message
    assert "plastic_strain = 0" in message
    assert "radius = 20000" in message
    for bad, error, match in (
        (np.zeros((3, 2)), FieldShapeError, "shape"),
        (np.zeros((n + 1, 3, 3)), FieldShapeError, "shape"),
        (np.array([[0, 1.0, 0], [0, 0, 0], [0, 0, 0]]), ParameterError, "symmetric"),
        (np.array([[0, 0, 1.0], [0, 0, 0], [1.0, 0, 0]]), ParameterError, "no shear out of"),
        (np.full((3, 3), np.nan), ParameterError, "finite"),
    ):
        with pytest.raises(error, match=match):
            mpm.set_stress(law, points, bad)
    for name, values in points.fields.items():
        assert np.array_equal(values, before[name]), name
    with pytest.raises(StateError, match="cannot be reached"):
        mpm.set_stress(LAWS["CamClay"], points, np.zeros((3, 3)))
    with pytest.raises(ParameterError, match="no kernel"):
        mpm.set_stress(mpm.materials.NeoHookean(1.0, 0.3), points, np.zeros((3, 3)))
    with pytest.raises(ParameterError, match="strain = 'none'"):
        mpm.set_stress(law, points, np.zeros((3, 3)), strain="none")


@each_dimension
def test_geostatic_stress(d):
    x = np.random.default_rng(1).uniform(0, 1, (d, 7))
    stress = mpm.geostatic_stress(0.9, 2e4, 0.5)(x)
    vertical = -2e4 * np.maximum(0.9 - x[-1], 0)
    np.testing.assert_allclose(stress[:, d - 1, d - 1], vertical)
    np.testing.assert_allclose(np.trace(stress, axis1=1, axis2=2), 2 * vertical)
    np.testing.assert_allclose(stress * (1 - np.eye(3)), 0.0)
    varying = mpm.geostatic_stress(lambda x: 1 + x[0], lambda x: 1e4 + x[-1], lambda x: 0.4)(x)
    np.testing.assert_allclose(varying[:, d - 1, d - 1], -(1e4 + x[-1]) * (1 + x[0] - x[-1]))


@pytest.mark.parametrize(
    "values", [(np.nan, 1.0, 0.5), (1.0, -1.0, 0.5), (1.0, 1.0, lambda x: -x[0])]
)
def test_geostatic_stress_checks_its_values(values):
    with pytest.raises(ParameterError, match="must be finite"):
        mpm.geostatic_stress(*values)(np.ones((2, 3)))


@pytest.mark.parametrize("strain", MEASURES)
@pytest.mark.parametrize("name", ["Hencky", "MohrCoulomb", "CamClay"])
def test_ground_at_rest_stays_at_rest(strain, name):
    """Under the weight that the stress belongs to, a step moves little: averages alone differ."""
    grid = mesh.create_rectangle(COMM, [(0, 0), (2, 4)], (2, 8), mesh.CellType.quadrilateral)
    points = mpm.fill(grid, mpm.Box((0, 0), (2, 3)), 2, 1800.0)
    law = LAWS[name]
    # clay needs some pressure everywhere
    load = 3e4 if name == "CamClay" else 0.0
    if load:
        law = mpm.materials.CamClay(
            swelling=0.018,
            compression=0.13,
            M=1.05,
            mu0=5.4e6,
            alpha=0.0,
            reference_pressure=2e4,
            preconsolidation=2e5,
        )
    weight = 1800 * 9.81
    mpm.set_stress(law, points, mpm.geostatic_stress(3 + load / weight, weight, 0.6), strain=strain)
    first = points["stress"].copy()
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    F = mpm.momentum(law, points, u, v, strain=strain)
    F += ufl.inner(points.density * fem.Constant(grid, (0.0, 9.81)), v) * points.dX
    # what lies on top, as the divergence of a stress that is the same everywhere
    F += load * ufl.grad(v)[1, 1] * points.dX
    bcs = mpm.rollers(V, "left", "right", "bottom")
    problem = mpm.QuasiStatic(F, u, points, bcs)
    problem.step()
    moved = np.abs(points["x"] - points["x0"]).max()
    change = np.abs(points["stress"] - first).max()
    assert moved < 2e-3 if name == "Hencky" else moved < 1e-2
    assert change < 0.05 * np.abs(first).max()
