"""Factors of safety of bodies that carry their loads already."""

from __future__ import annotations

import functools

import numpy as np
import pytest
import ufl
from conftest import COMM
from dolfinx import fem, mesh
from scipy import sparse
from scipy.optimize import brentq
from test_factor_of_safety import HEIGHT, UNIT_WEIGHT, slope

import dolfinmpm as mpm
from dolfinmpm import study


def loaded(h=1.0):
    """Griffiths & Lane's slope, its weight put on in ten steps."""
    for problem in slope(1.0, h):
        problem.step()
    return problem


def at_rest(h=1.0):
    """The same slope under the stress of level ground, brought into balance."""
    (problem,) = slope(1.0, h, steps=1)

    def surface(x):
        return np.clip(0.5 * (32 - x[0]), 0.0, HEIGHT)

    (of,) = problem.form.parts.declarations
    mpm.set_stress(of.law, problem.points, mpm.geostatic_stress(surface, UNIT_WEIGHT, 0.5))
    mpm.equilibrate(problem)
    return problem


@pytest.mark.parametrize("make", [loaded, at_rest])
def test_the_state_says_what_loading_says(make):
    """From weight put on step by step it is 1.406, between 1.3875 and 1.425."""
    found = study.factor_of_safety(make(), 1.2, 1.8, tolerance=0.04)
    assert found.bracket == pytest.approx((1.3875, 1.425))
    assert found.factor == pytest.approx(1.4, rel=0.03)
    trials = {trial.factor: trial for trial in found.trials}
    assert all(trial.stands == (trial.factor <= found.bracket[0]) for trial in found.trials)
    assert trials[1.2].reason == "" != trials[1.8].reason
    # what one step more tells where the weight is put on: 1.13 and 1.55 of the elastic settlement
    assert trials[1.2].growth == pytest.approx(1.13, abs=0.02)
    assert 1.4 < trials[found.bracket[0]].growth < 2.0
    assert "since the state" in found.criterion


def test_a_body_that_fails_at_its_own_strength():
    """A larger strength acts at once: strengths between both, at which it flows, gave 0.71."""
    for problem in slope(1.6, 2.0, steps=4):
        problem.step()
    assert abs(problem.points["x"] - problem.points["x0"]).max() > 0.1  # it has begun to flow
    found = [
        study.factor_of_safety(problem, low, 1.2, tolerance=0.02, steps=steps).factor
        for low, steps in [(0.3, 5), (0.7, 5), (0.7, 1)]
    ]
    assert found == pytest.approx([0.935] * 3, abs=0.02)


# -- infinite slopes -----------------------------------------------------------------------

BETA, DEPTH, SOIL, WATER = np.radians(20.0), 4.0, 20e3, 10e3
COHESION, PHI, CELL = 10e3, 30.0, 1.0
# depth (m), across the slope, of the middle of the lowest cells, in which it fails
AT = DEPTH - 0.5 * CELL


def strip():
    """Grid, points, space and prolongation of a strip across a slope whose sides move alike."""
    n = round(DEPTH / CELL)
    box = [(0, 0), (CELL, DEPTH)]
    grid = mesh.create_rectangle(COMM, box, (1, n), mesh.CellType.quadrilateral)
    points = mpm.fill(grid, mpm.Box(*box), 2, SOIL / 10)
    V = mpm.Space(grid, "linear", configuration="total")
    x = V.basis.node_coordinates()

    def periodic(stencils, nodes):
        C = sparse.lil_matrix((len(x), len(x)))
        for a in nodes:
            C[a, np.argmin(abs(x[:, 0] - CELL) + abs(x[:, 1] - x[a, 1]))] = 1.0
        return C.tocsr()

    return grid, points, V, periodic


def stress(x, water=1.0):
    """Effective stress of the slope with seepage along it (Pa), and as much along as across."""
    depth, sigma = DEPTH - x[1], np.zeros((x.shape[1], 3, 3))
    across = -(SOIL - water * WATER) * depth * np.cos(BETA)
    for i in range(3):
        sigma[:, i, i] = across
    sigma[:, 0, 1] = sigma[:, 1, 0] = SOIL * depth * np.sin(BETA)
    return sigma


GRAVITY = 10 * np.sin(BETA), -10 * np.cos(BETA)


def infinite(dilation, wet=1.0, written=False):
    """A slope without end, with water that flows along it; and the constant that makes it wet."""
    grid, points, V, periodic = strip()
    u, v = V.increment, V.test
    soil = mpm.materials.MohrCoulomb(1e7, 0.3, COHESION, PHI, dilation_angle=dilation)
    water = fem.Constant(grid, wet)
    pressure = water * WATER * np.cos(BETA) * (DEPTH - points.x0[1])
    F = mpm.momentum(soil, points, u, v) - pressure * ufl.div(v) * points.dX
    F -= ufl.inner(points.density * ufl.as_vector(GRAVITY), v) * points.dX
    if written:
        points["stress"] = stress(points["x"].T, wet)
    else:
        mpm.set_stress(soil, points, functools.partial(stress, water=wet))
    problem = mpm.QuasiStatic(F, u, points, mpm.fixed(V, "bottom"), prolongation=periodic)
    return problem, water


def closed_form():
    """F = (c + (σ − p) tan φ)/τ on planes along the slope: its flow needs ψ = φ."""
    across, along = (SOIL - WATER) * AT * np.cos(BETA), SOIL * AT * np.sin(BETA)
    return (COHESION + across * np.tan(np.radians(PHI))) / along


def of_constant_volume():
    """Simple shear at ψ = 0: τ = c cos φ + (σ − p) sin φ, with c and tan φ over F (Davis 1968)."""
    across, along = (SOIL - WATER) * AT * np.cos(BETA), SOIL * AT * np.sin(BETA)

    def missing(F):
        angle = np.arctan(np.tan(np.radians(PHI)) / F)
        return COHESION / F * np.cos(angle) + across * np.sin(angle) - along

    return brentq(missing, 0.5, 3.0)


@pytest.mark.parametrize(
    ("dilation", "exact", "rises"),
    [
        (PHI, closed_form(), False),
        # of associated flow it does not hang on the stress that was there first
        (PHI, closed_form(), True),
        (0.0, of_constant_volume(), False),
    ],
)
def test_an_infinite_slope_with_seepage(dilation, exact, rises):
    problem, water = infinite(dilation, wet=0.0 if rises else 1.0)
    if rises:
        # stages: a dry slope, whose water table rises then
        water.value = 0.5
        problem.step()
        water.value = 1.0
        problem.step()
    found = study.factor_of_safety(problem, 0.9, 1.6, tolerance=0.01)
    assert found.bracket[0] - 1e-3 < exact < found.bracket[1] + 1e-3


def test_a_stress_that_was_written_counts_as_one_that_was_set():
    """Neither is there on the elastic body, by whose settlement displacements are measured."""
    problems = [infinite(PHI, written=written)[0] for written in (False, True)]
    one, other = (study.factor_of_safety(p, 0.9, 1.6, tolerance=0.4) for p in problems)
    assert [t.growth for t in one.trials] == pytest.approx([t.growth for t in other.trials])


def test_water_that_flows_in_a_problem_in_time():
    grid, points, V, periodic = strip()
    Q = mpm.Space(grid, "linear", configuration="total", shape=())
    soil = mpm.materials.MohrCoulomb(1e7, 0.3, COHESION, PHI, dilation_angle=0.0)
    fields, tests = (V.increment, Q.increment), (V.test, Q.test)
    F = mpm.poromechanics(
        soil, points, fields, tests, permeability=1e-6, porosity=0.4, gravity=GRAVITY,
        fluid=mpm.Fluid(gravity=10.0),
    )  # fmt: skip
    mpm.set_stress(soil, points, stress)
    points.add_field("pressure", (), "Pa")
    points["pressure"] = WATER * np.cos(BETA) * (DEPTH - points["x"][:, 1])
    bcs = mpm.fixed(V, "bottom") + mpm.prescribed(Q, "top", 0, value=0.0)
    problem = mpm.Transient(F, fields, points, bcs, prolongation=periodic)
    problem.step(1e3)
    before = points["pressure"].copy()
    found = study.factor_of_safety(problem, 0.9, 1.6, tolerance=0.01, over=1e9)
    assert found.bracket[0] - 1e-3 < of_constant_volume() < found.bracket[1] + 1e-3
    assert problem.time == 1e3
    np.testing.assert_array_equal(points["pressure"], before)


# -- clay, in stages -----------------------------------------------------------------------

CLAY, CUT, BELOW = 25e3, 4.0, 2.0


def clay(law, shape, h):
    """Problem and gravity of clay on a rigid base."""
    cells = round(14 / h), round(7 / h)
    grid = mesh.create_rectangle(COMM, [(0, 0), (14, 7)], cells, mesh.CellType.quadrilateral)
    points = mpm.fill(grid, shape, 2, SOIL / 10)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    gravity = fem.Constant(grid, (0.0, -10.0))
    F = mpm.momentum(law, points, u, v, fbar=True)
    F -= ufl.inner(points.density * gravity, v) * points.dX
    bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
    problem = mpm.QuasiStatic(F, u, points, bcs, stabilisation="ghost", max_halvings=4)
    return problem, gravity


def excavated(h=0.5, law=None):
    """A slope of 45° cut in two stages out of level ground at rest."""
    law = law or mpm.materials.Tresca(1e7, 0.45, CLAY)
    problem, _ = clay(law, mpm.Box((0, 0), (14, BELOW + CUT)), h)
    mpm.set_stress(law, problem.points, mpm.geostatic_stress(BELOW + CUT, SOIL, 1.0))
    for floor in (BELOW + 0.5 * CUT, BELOW):
        problem.points.remove(lambda x: (x[1] > floor) & (x[0] > 7 + BELOW + CUT - x[1]))  # noqa: B023
        problem.step()
    return problem


def from_nothing(factor, h=0.5):
    """The same slope under weight put on in ten steps, of the clay's strength over the factor."""
    toe, top = 7 + CUT, BELOW + CUT
    shape = mpm.Polygon([(0, 0), (14, 0), (14, BELOW), (toe, BELOW), (7, top), (0, top)])
    problem, gravity = clay(mpm.materials.Tresca(1e7, 0.45, CLAY / factor), shape, h)
    for k in range(1, 11):
        gravity.value[1] = -k
        yield problem


def test_a_cut_in_clay_after_its_stages():
    """Taylor (1937): c/(F γ H) = .174 at 45° where a rigid base is at 1.5 times the height."""
    found = study.factor_of_safety(excavated(), 1.0, 2.6, tolerance=0.05)
    assert found.factor == pytest.approx(CLAY / (0.174 * SOIL * CUT), rel=0.04)
    assert 0.0 < found.bracket[1] - found.bracket[0] <= 0.05 + 1e-9
    loading = study.factor_of_safety(from_nothing, 1.6, 2.0, tolerance=0.05)
    assert found.factor == pytest.approx(loading.factor, abs=0.05)


def test_strength_that_varies_is_divided_where_it_is():
    """Numbers, an array and a function of the same strength give the same factors."""
    found = []
    for strength in (CLAY, lambda x: np.full(x.shape[1], CLAY)):
        law = mpm.materials.Tresca(1e7, 0.45, strength)
        problem = excavated(1.0, law)
        fields = set(problem.points.fields)
        found.append(study.factor_of_safety(problem, 1.0, 3.0, tolerance=0.1))
        assert set(problem.points.fields) == fields
        assert problem.form.parts.declarations[0].parameters()[:, 2] == pytest.approx(CLAY, abs=0)
    assert found[0].bracket == found[1].bracket
    assert [t.displacement for t in found[0].trials] == pytest.approx(
        [t.displacement for t in found[1].trials], rel=1e-9
    )
