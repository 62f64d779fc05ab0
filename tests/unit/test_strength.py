"""Strength that is divided by a factor, and states that trials leave as they were."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from conftest import COMM
from dolfinx import fem, mesh
from test_checkpoint import arch, bits, block, hollow, pressed

import dolfinmpm as mpm
from dolfinmpm import study
from dolfinmpm._platform.errors import ParameterError
from dolfinmpm.materials.strength import weakened
from dolfinmpm.solve.restart import SavedState
from dolfinmpm.study import reduced_strength

MAKE = mpm.materials
C, PHI, PSI, F = 7e3, 30.0, 20.0, 1.4
C_F, PHI_F = reduced_strength(C, PHI, F)
C_R, PHI_R = reduced_strength(0.4 * C, 25.0, F)
LAWS = {
    "MohrCoulomb": (
        MAKE.MohrCoulomb(1e6, 0.3, C, PHI, dilation_angle=PSI),
        MAKE.MohrCoulomb(1e6, 0.3, C_F, PHI_F, dilation_angle=PSI),
    ),
    # a dilation angle is never larger than the friction angle
    "associated": (
        MAKE.MohrCoulomb(1e6, 0.3, C, PHI, dilation_angle=PHI),
        MAKE.MohrCoulomb(1e6, 0.3, C_F, PHI_F, dilation_angle=PHI_F),
    ),
    "softening": (
        MAKE.MohrCoulomb(
            1e6, 0.3, C, PHI, residual_cohesion=0.4 * C, residual_friction_angle=25.0, rate=3.0,
        ),
        MAKE.MohrCoulomb(1e6, 0.3, C_F, PHI_F, residual_cohesion=C_R, residual_friction_angle=PHI_R,
                         rate=3.0),
    ),
    "DruckerPrager": (
        MAKE.DruckerPrager(1e6, 0.3, C, PHI, dilation_angle=PSI, fit="plane strain", hardening=1e4),
        MAKE.DruckerPrager(
            1e6, 0.3, C_F, PHI_F, dilation_angle=PSI, fit="plane strain", hardening=1e4 / F,
        ),
    ),
    "Tresca": (
        MAKE.Tresca(1e6, 0.3, C, ultimate_cohesion=0.5 * C),
        MAKE.Tresca(1e6, 0.3, C_F, ultimate_cohesion=0.5 * C_F),
    ),
    "VonMises": (
        MAKE.VonMises(1e6, 0.3, radius=C, hardening=1e4, saturation=2 * C, rate=3.0),
        MAKE.VonMises(1e6, 0.3, radius=C_F, hardening=1e4 / F, saturation=2 * C_F, rate=3.0),
    ),
    "Hencky": (MAKE.Hencky(1e6, 0.3), MAKE.Hencky(1e6, 0.3)),
}  # fmt: skip


@pytest.mark.parametrize("name", LAWS)
def test_a_law_is_that_of_the_reduced_strength(name):
    law, reduced = LAWS[name]
    own = law.parameter_array()
    np.testing.assert_allclose(weakened(law, own, F), reduced.parameter_array(), rtol=1e-14)
    np.testing.assert_array_equal(own, law.parameter_array())
    # what the points have, one row each
    many = np.repeat(own, 3, axis=0)
    np.testing.assert_allclose(
        weakened(law, many, F), np.repeat(reduced.parameter_array(), 3, axis=0), rtol=1e-14
    )
    stress = -1e5 * np.array([[1.0, 2.0, 30.0], [3.0, -0.4, 1.0]])
    endless = weakened(law, own, 0.0)
    assert (law.yield_function(stress, np.zeros((2, len(law.internal))), endless) < 0).all()


def test_a_law_in_ufl():
    law = MAKE.EnergyWithYield(
        lambda e, K, G: 0.5 * K * sum(e) ** 2 + G * sum(x**2 for x in e), K=1e6, G=5e5,
        yield_stress=2e4,
    )  # fmt: skip
    own = law.parameter_array()
    assert weakened(law, own, 2.0)[0].tolist() == [1e6, 5e5, 1e4]


def test_what_does_not_tell_its_strength():
    clay = MAKE.CamClay(
        swelling=0.018,
        compression=0.13,
        M=1.05,
        mu0=5.4e6,
        alpha=0.0,
        reference_pressure=2e4,
        preconsolidation=4e4,
    )
    with pytest.raises(
        ParameterError,
        match=r"CamClay has no strength .* mpm\.materials\.Tresca.*M/√3 p \(pc",
    ):
        weakened(clay, clay.parameter_array(), 1.5)

    class Own(mpm.materials.Hencky):
        strengths = None

    law = Own(1e6, 0.3)
    with pytest.raises(ParameterError, match=r'strengths = \("cohesion",\)'):
        weakened(law, law.parameter_array(), 1.5)


# -- states ------------------------------------------------------------------------------

STATES = {
    "yielding with ghost penalty": block,
    "adaptive penalties": lambda: block(
        stabilisation=mpm.Stabilisation("ghost", factor="adaptive")
    ),
    "splines": lambda: block(MAKE.Hencky(E=1e6, nu=0.3), "bspline2"),
    "a tool": pressed,
    "couplings kept": hollow,
    "arc length": arch,
}


@pytest.mark.parametrize("name", STATES)
def test_what_was_tried_leaves_no_trace(name):
    problem, step = STATES[name]()
    other, step_of_other = STATES[name]()
    for _ in range(2):
        step(), step_of_other()
    state = bits(problem)
    kept = SavedState(problem)
    for _ in range(2):
        step()
        problem.points.fields["more"] = np.zeros(len(problem.points))
    assert bits(problem) != state
    kept.restore()
    assert bits(problem) == state
    for _ in range(2):
        step(), step_of_other()
    assert bits(problem) == bits(other)


def heap(law=None, weight=10.0, rule=mpm.QuasiStatic, **options):
    """A small steep heap that stands under its weight; its problem and the weight."""
    grid = mesh.create_rectangle(COMM, [(0, 0), (6, 3)], (12, 6), mesh.CellType.quadrilateral)
    shape = mpm.Polygon([(0, 0), (4, 0), (2, 2), (0, 2)])
    points = mpm.fill(grid, shape, 2, 2000.0)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    law = law or MAKE.MohrCoulomb(1e7, 0.3, 8e3, 25.0, dilation_angle=0.0)
    g = fem.Constant(grid, (0.0, -weight))
    F = mpm.momentum(law, points, u, v) - ufl.inner(points.density * g, v) * points.dX
    bcs = mpm.rollers(V, "left") + mpm.fixed(V, "bottom") + options.pop("bcs", [])
    options = {"stabilisation": "ghost", **options}
    return rule(F, u, points, bcs, **options), g


def test_a_factor_of_safety_leaves_no_trace():
    (one, g), (other, g_of_other) = heap(), heap()
    one.step(), other.step()
    here, solver, increment = one.here, one.solver, one.form.spaces[0].increment.x.array.copy()
    # what is to come next
    g.value[1] = -11.0
    state = bits(one)
    g.value[1] = -10.0
    found = study.factor_of_safety(one, 1.0, 4.0, tolerance=0.5)
    assert 1.0 < found.factor < 4.0
    g.value[1] = -11.0
    assert bits(one) == state
    assert (one.here, one.solver) == (here, solver)
    np.testing.assert_array_equal(one.form.spaces[0].increment.x.array, increment)
    assert one.max_halvings == 10
    g_of_other.value[1] = -11.0
    one.step(), other.step()
    assert bits(one) == bits(other)


def test_a_trial_that_raises_leaves_no_trace_either():
    problem, _ = heap()
    problem.step()
    state = bits(problem)
    with pytest.raises(ParameterError, match=r"fails at low = 4 already, with strength over"):
        study.factor_of_safety(problem, 4.0, 5.0)
    assert bits(problem) == state
    with pytest.raises(ParameterError, match=r"stands at high = 1\.1 still"):
        study.factor_of_safety(problem, 1.0, 1.1)
    assert bits(problem) == state


def test_loads_to_come_are_loads():
    """What the user has set since the last step acts in the trials, and waits after them."""
    problem, g = heap(weight=2.0)
    problem.step()
    light = study.factor_of_safety(problem, 1.0, 12.0, tolerance=0.1)
    g.value[1] = -10.0
    heavy = study.factor_of_safety(problem, 1.0, 12.0, tolerance=0.1)
    assert g.value[1] == -10.0
    assert heavy.factor < 0.8 * light.factor
    problem.step()
    after = study.factor_of_safety(problem, 1.0, 12.0, tolerance=0.1)
    assert after.factor == pytest.approx(heavy.factor, rel=0.05)


def test_prescribed_increments_rest():
    """A wall that has been moved stays where it is."""
    push = None

    def build():
        nonlocal push
        problem, _ = heap(law=MAKE.Tresca(1e7, 0.45, 1e4))
        V = problem.form.spaces[0]
        push = fem.Constant(problem.points.grid, 1e-4)
        wall = mpm.prescribed(V, lambda x: (x[0] < 1e-9) & (x[1] > 1e-9), 0, increment=push)
        bcs = mpm.fixed(V, "bottom") + wall
        return mpm.QuasiStatic(
            problem.form.given, V.increment, problem.points, bcs, stabilisation="none"
        )

    problem = build()
    problem.step()
    found = study.factor_of_safety(problem, 1.0, 4.0, tolerance=0.2)
    assert push.value == 1e-4
    push.value = 0.0
    assert study.factor_of_safety(problem, 1.0, 4.0, tolerance=0.2).bracket == found.bracket


def test_strength_at_boundaries_that_do_not_fit_the_grid():
    """Laws there are the same, numbers or not; what is kept of the points is not left behind."""
    found = []
    for cohesion in (8e3, lambda x: np.full(x.shape[1], 8e3)):
        law = MAKE.MohrCoulomb(1e7, 0.3, cohesion, 25.0, dilation_angle=0.0)
        problem, _ = heap(law)
        points, V = problem.points, problem.form.spaces[0]
        base = mpm.Boundary.from_polygon(points, [(0, 0.02), (4, 0.02)], closed=False)
        F = problem.form.given
        F += mpm.dirichlet(base, V.increment, V.test, law=law)
        weak = mpm.QuasiStatic(F, V.increment, points, mpm.rollers(V, "left", "bottom"))
        weak.step()
        fields = set(base.markers.fields)
        found.append(study.factor_of_safety(weak, 1.0, 4.0, tolerance=0.5))
        assert set(base.markers.fields) == fields
    assert found[0].bracket == found[1].bracket


def test_a_footing_that_weighs_on_it_is_a_load():
    """A free body that the points carry; its force is the whole load of a body without weight."""
    law = MAKE.Tresca(1e7, 0.45, 10e3)
    brackets = []
    for force in (2e3, 6e3):
        problem, _ = heap(law, weight=0.0)
        V, points = problem.form.spaces[0], problem.points
        block = mpm.RigidBody(
            mpm.Box((0.0, 1.995), (1.0, 2.5)), free=(False, True, False), force=(0.0, -force),
            name="footing",
        )  # fmt: skip
        F = problem.form.given + mpm.contact(block, points, V.increment, V.test, penalty=25.0)
        loaded = mpm.QuasiStatic(F, V.increment, points, problem.bcs, stabilisation="ghost")
        loaded.step()
        place = block.position.copy()
        brackets.append(study.factor_of_safety(loaded, 1.0, 24.0, tolerance=0.5))
        np.testing.assert_array_equal(block.position, place)
    assert brackets[0].factor == pytest.approx(3 * brackets[1].factor, rel=0.15)


WRONG = {
    "no problem": (lambda p: 3, {}, "loading = 3 must be an mpm.QuasiStatic"),
    "one that returns": (lambda p: lambda factor: p, {}, "must be a generator"),
    "one that returns nothing": (lambda p: lambda factor: None, {}, "not `return problem`"),
    "one that yields steps in time": (
        lambda p: lambda factor: iter([heap(rule=mpm.Transient)[0]]), {},
        "mpm.Transient, whose steps take time",
    ),
    "a time for a function": (
        lambda p: lambda factor: iter([p]), {"over": 1.0}, "not for a function of the factor",
    ),
    "steps": (lambda p: p, {"steps": 0}, "steps = 0"),
    "time that steps have not": (lambda p: p, {"over": 1.0}, "for mpm.Transient only"),
    "Newmark": (
        lambda p: heap(rule=mpm.Newmark)[0], {}, "Newmark.*strength is reduced in quasi-static",
    ),
    "Explicit": (
        lambda p: heap(rule=mpm.Explicit, stabilisation="none")[0], {},
        "loading = .*Explicit.* must be an mpm.QuasiStatic",
    ),
    "Transient without a time": (lambda p: heap(rule=mpm.Transient)[0], {}, "over = None: give"),
    "over is no time": (lambda p: heap(rule=mpm.Transient)[0], {"over": -1.0}, "over = -1"),
    "no strength": (lambda p: heap(MAKE.Hencky(1e7, 0.3))[0], {}, "no law .* has a strength"),
    "no load": (lambda p: heap(weight=0.0)[0], {}, "move its elastic body by 0 m"),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG)
def test_what_has_no_factor_of_safety(name):
    make, options, words = WRONG[name]
    body = make(heap()[0])
    with pytest.raises(ParameterError, match=words):
        study.factor_of_safety(body, 1.0, 2.0, **options)


def test_a_body_that_goes_on_moving_is_refused():
    problem, step = pressed()
    step()
    with pytest.raises(ParameterError, match="'tool' goes on moving"):
        study.factor_of_safety(problem)
