"""Soil and water: what is refused or told."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
import ufl
from conftest import unit_grid
from dolfinx import fem
from test_nested_pressure import nested
from test_poromechanics import LAW, block, held, problem_of

import dolfinmpm as mpm
from dolfinmpm._platform.errors import (
    FormError,
    ParameterError,
    UndeterminedFieldError,
    UnstablePairWarning,
)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"permeability": -1e-3}, r"permeability = -0\.001 m/s must be at least 0"),
        ({"permeability": [[1.0, 2.0], [0.0, 1.0]]}, r"must be symmetric"),
        (
            {"permeability": "clay"},
            "permeability = 'clay' must be .* a tensor, UFL or a",
        ),
        ({"porosity": 1.2}, r"porosity = 1\.2 must be above 0 and below 1"),
        ({"porosity": 0.0}, r"porosity = 0 must be above 0"),
        ({"theta": 0.3}, r"theta = 0\.3 must be at least 0\.5"),
        ({"fluid": 1000.0}, r"must be a Fluid"),
        ({"gravity": (0.0, 0.0, -9.81)}, r"2 finite numbers"),
        ({"drained": 3}, r"drained"),
        ({"projection": "some"}, r"projection"),
        ({"modulus": -1.0}, r"modulus = -1 Pa"),
        ({"suction": -1.0}, r"suction = -1 Pa"),
    ],
)
def test_what_is_no_soil_is_refused(wrong, message):
    with pytest.raises(ParameterError, match=message):
        block(**wrong)


def test_a_pressure_that_nothing_determines_is_told():
    F, points, V, Q, _ = block(height=1.0, drained=False, permeability=1e-3)
    everywhere = mpm.rollers(V, "left", "right", "bottom", "top")
    with pytest.raises(UndeterminedFieldError, match=r"field 2 of 2.*up to a constant"):
        problem_of(F, points, V, Q, everywhere).step(1.0)
    assert np.all(points["x"] == points["x0"])
    # any of these determines it
    for bcs in (held(V), everywhere + mpm.fixed(Q, "top")):
        problem_of(F, points, V, Q, bcs).step(1.0)
    water = mpm.Fluid(bulk_modulus=1e6)
    F, points, V, Q, _ = block(height=1.0, drained=False, permeability=1e-3, fluid=water)
    problem_of(F, points, V, Q, mpm.rollers(V, "left", "right", "bottom", "top")).step(1.0)


def test_a_drained_side_away_from_the_body_is_told():
    F, points, V, Q, _ = block(height=0.5, drained=False)
    with pytest.raises(ParameterError, match=r"pressure at 'top' hold no node of the body"):
        problem_of(F, points, V, Q, held(V) + mpm.fixed(Q, "top")).step(1.0)


def test_what_is_no_pair_of_fields_is_refused():
    grid = unit_grid("quadrilateral", 4)
    points = mpm.fill(grid, mpm.Box((0, 0), (1, 0.5)), 2, 1.0)
    V, Q = mpm.Space(grid, "gimp"), mpm.Space(grid, "linear", shape=())
    given = {"permeability": 1e-3, "porosity": 0.4}
    for fields, tests, message in (
        (V.increment, V.test, "pair"),
        ((Q.increment, V.increment), (Q.test, V.test), "displacement"),
        ((V.increment, V.increment), (V.test, V.test), "must be a scalar"),
    ):
        with pytest.raises(ParameterError, match=message):
            mpm.poromechanics(LAW, points, fields, tests, **given)


def test_a_pair_of_equal_order_without_projection_is_told():
    with pytest.warns(UnstablePairWarning, match='projection="auto"'):
        block("gimp", projection="none")
    with pytest.warns(UnstablePairWarning, match=r"shape=\(\), coarsen=2"):
        block("gimp", projection=0.0)
    with pytest.warns(UnstablePairWarning, match=r"degree 2 .* degree 1 with coarsen=1"):
        block("bspline2", projection="none")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        block("bspline2")
        block("gimp")
        nested(projection="none")
    with pytest.warns(UnstablePairWarning, match="coarsen=2, or of twice the size"):
        nested(1, coarse="u")


def test_a_weight_beside_the_weight_of_the_mixture_is_refused():
    g = (0.0, -9.81)
    F, points, V, Q, _ = block(height=1.0, gravity=g, tag=0)

    def with_weight(acceleration, dX=points.dX):
        more = ufl.inner(points.density * acceleration, V.test) * dX
        return problem_of(F - more, points, V, Q)

    for again in (ufl.as_vector(g), fem.Constant(points.grid, g)):
        for dX in (points.dX, points.dX(0)):
            with pytest.raises(FormError, match=r"weight of the mixture is in the form twice"):
                with_weight(again, dX)
    # the acceleration of an earthquake, and the weight of what is not saturated
    points["tag"][:1] = 1
    F += mpm.momentum(LAW, points, V.increment, V.test, tag=1)
    with_weight(fem.Constant(points.grid, (1.0, 0.0)))
    assert with_weight(ufl.as_vector(g), points.dX(1)).form.points is points
