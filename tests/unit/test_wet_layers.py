"""Layers of several soils with water: one call of `poromechanics` per tag."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI

import dolfinmpm as mpm
from dolfinmpm._platform.errors import FormError, ParameterError
from dolfinmpm.forms.termqueries import penalty_of

N, HEIGHT, INTERFACE = 8, 1.0, 0.5
STIFF, SOFT = mpm.materials.Hencky(1e8, 0.0), mpm.materials.Hencky(1e6, 0.2)


def layers(refine=None):
    """A column of two layers, its spaces, and its upper face."""
    h = HEIGHT / N
    lines = [np.arange(0, 2.5 * h, h), np.arange(0, HEIGHT + 2.5 * h, h)]
    grid = mpm.create_lattice(MPI.COMM_WORLD, lines)
    more = {} if refine is None else {"refine": refine, "levels": 1}
    V, Q = mpm.Space(grid, "gimp", **more), mpm.Space(grid, "gimp", shape=(), **more)
    own = {} if refine is None else {"refine": V}
    low = mpm.Box((0, 0), (2 * h, INTERFACE))
    points = mpm.fill(grid, low, per_cell=2, density=2000.0, tag=1, **own)
    high = mpm.Box((0, INTERFACE), (2 * h, HEIGHT))
    points = points + mpm.fill(grid, high, per_cell=2, density=1800.0, tag=2, **own)
    return points, V, Q, mpm.Surface(points, lambda x: np.isclose(x[1], HEIGHT), (0, 1))


@pytest.mark.parametrize("stabilisation", ["ghost", "aggregation"])
@pytest.mark.parametrize("refine", [None, lambda x: np.where(x[1] > 0.6, 0.5 / N, 1.0)])
def test_two_soils_conduct_the_same_water(stabilisation, refine):
    points, V, Q, top = layers(refine)
    fields, tests = (V.increment, Q.increment), (V.test, Q.test)
    F = mpm.poromechanics(
        STIFF, points, fields, tests, permeability=1e-9, porosity=0.3, tag=1
    )  # fmt: skip
    F += mpm.poromechanics(
        SOFT, points, fields, tests, permeability=4e-9, porosity=0.5, tag=2, drained=top
    )
    bcs = mpm.rollers(V, "left", "right", "bottom") + mpm.prescribed(Q, "bottom", 0, value=100.0)
    problem = mpm.Transient(F, fields, points, bcs, stabilisation=[stabilisation] * 2)
    np.testing.assert_array_equal(points["porosity"], np.where(points["tag"] == 1, 0.3, 0.5))
    problem.step(1e9)
    # the pressure at the interface: the head falls by L/k in each layer
    y, middle = points["x"][:, 1], 100.0 / (1 + 4)
    exact = np.interp(y, [0, INTERFACE, HEIGHT], [100.0, middle, 0.0])
    np.testing.assert_allclose(points["pressure"], exact, atol=0.02)
    soil = points["tag"] == 1
    np.testing.assert_allclose(points["porosity"], np.where(soil, 0.3, 0.5), atol=1e-4)


def test_the_weight_of_two_soils_and_their_water_is_at_rest():
    points, V, Q, top = layers()
    fields, tests = (V.increment, Q.increment), (V.test, Q.test)
    given = {"gravity": fem.Constant(points.grid, (0.0, -9.81)), "theta": 0.5}
    F = mpm.poromechanics(
        STIFF, points, fields, tests, permeability=1e-9, porosity=0.3, tag=1, **given
    )
    F += mpm.poromechanics(
        SOFT, points, fields, tests, permeability=1e-7, porosity=0.5, tag=2, drained=top, **given
    )
    soils = [
        mpm.Layer(bottom, density * 9.81, K0=0.5)
        for bottom, density in ((INTERFACE, 1800.0), (0.0, 2000.0))
    ]
    ground = mpm.Deposit(HEIGHT, soils, water_table=HEIGHT)
    bcs = mpm.rollers(V, "left", "right", "bottom")
    problem = mpm.Transient(F, fields, points, bcs, stabilisation=["ghost"] * 2)
    for law, tag in ((STIFF, 1), (SOFT, 2)):
        mpm.set_stress(law, points, ground.stress, tag=tag)
    points["pressure"] = ground.pore_pressure(points["x"].T)
    problem.step(1e3)
    assert np.abs(points["x"] - points["x0"]).max() < 1e-9


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_dry_soil_beside_wet_soil_has_no_pressure_gradient():
    """It had been NaN after given pressures, and steps of GeneralisedAlpha failed."""
    points, V, _, _ = layers()
    Q = mpm.Space(points.grid, "gimp", shape=(), tag=1)
    gravity = fem.Constant(points.grid, (0.0, -9.81))
    F = mpm.poromechanics(
        STIFF, points, (V.increment, Q.increment), (V.test, Q.test), permeability=1e-5,
        porosity=0.3, gravity=gravity, rho_inf=0.8, tag=1,
    )  # fmt: skip
    F += mpm.momentum(SOFT, points, V.increment, V.test, tag=2)
    F -= ufl.inner(points.density * gravity, V.test) * points.dX(2)
    bcs = mpm.rollers(V, "left", "right", "bottom")
    problem = mpm.GeneralisedAlpha(F, [V.increment, Q.increment], points, bcs, rho_inf=0.8)
    wet = points["tag"] == 1
    points["pressure"] = np.where(wet, 9810.0 * (INTERFACE - points["x"][:, 1]), 0.0)
    for k in range(2):
        problem.step(1e-3 * (k + 1))
    wet = points["tag"] == 1
    assert abs(points["pressure_gradient"][wet]).min(axis=0)[1] > 1e3
    assert not points["pressure_gradient"][~wet].any()


def test_facets_have_a_penalty_between_those_of_both_soils():
    points, V, Q, _ = layers()
    fields, tests = (V.increment, Q.increment), (V.test, Q.test)
    forms = [
        mpm.poromechanics(law, points, fields, tests, permeability=1e-9, porosity=0.3, tag=tag)
        for law, tag in ((STIFF, 1), (SOFT, 2))
    ]
    one, other = (penalty_of(form, Q.increment) for form in forms)
    both = penalty_of(forms[0] + forms[1], Q.increment)
    assert both == 2 / (1 / one + 1 / other)


def test_points_carry_one_expression_under_a_name():
    points, _, Q, _ = layers()
    p, q = Q.increment, Q.test
    terms = [(p - 1.0 - mpm.carried(points, "heat", a * p)) * q for a in (2.0, 3.0)]
    problem = mpm.Transient(terms[0] * points.dX(1) + terms[1] * points.dX(2), p, points)
    problem.step(1.0)
    np.testing.assert_allclose(points["heat"], np.where(points["tag"] == 1, 2.0, 3.0))
    for tags in (1, (1, 2)):
        with pytest.raises(FormError, match=r"name 'heat' by the same points \(tag=.*its own tag="):
            mpm.Transient(terms[0] * points.dX(1) + terms[1] * points.dX(tags), p, points)


def test_a_surface_belongs_to_one_soil():
    points, V, Q, top = layers()
    fields, tests = (V.increment, Q.increment), (V.test, Q.test)
    given = {"permeability": 1e-9, "porosity": 0.4, "tag": 1}
    for what in ({"drained": top}, {"inflow": (top, 1e-9)}, {"ponded": [(top, 2.0)]}):
        with pytest.raises(ParameterError, match="a Surface for the part of each soil"):
            mpm.poromechanics(STIFF, points, fields, tests, **given, **what)
