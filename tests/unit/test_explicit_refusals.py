"""What explicit steps once did in silence: too long steps, terms without force, lost arguments."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from conftest import COMM, unit_grid
from dolfinx import mesh

import dolfinmpm as mpm
from dolfinmpm._platform.errors import (
    DriftingRecordWarning,
    FormError,
    InstabilityError,
    ParameterError,
)


def block(extra=lambda points, u, v: 0, conditions=lambda V: (), kind=mpm.Explicit, **options):
    """A block of 0.5 m × 0.5 m in cells of an eighth; `extra` gives further terms."""
    grid = unit_grid("quadrilateral", 8)
    points = mpm.fill(grid, mpm.Box((0.25, 0), (0.75, 0.5)), 2, 1000.0)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    F = mpm.momentum(mpm.materials.Hencky(1e6, nu=0.0), points, u, v) + extra(points, u, v)
    return kind(F, u, points, conditions(V), **options)


@pytest.mark.parametrize("linear", [0.06, 5.0])
def test_bulk_viscosity_shortens_the_stable_step(linear):
    """A shock in a bar: with b₁ = 5 and the step without viscosity it gained energy."""

    def bar(**options):
        grid = mesh.create_interval(COMM, 40, [0, 10])
        points = mpm.fill(grid, mpm.Box((0,), (10,)), 2, 1.0)
        V = mpm.Space(grid, "bspline2")
        F = mpm.momentum(mpm.materials.Hencky(E=100.0, nu=0.0), points, V.increment, V.test)
        problem = mpm.Explicit(F, V.increment, points, mpm.fixed(V, "left"), **options)
        points["velocity"] = (-0.5,)
        return problem

    plain = bar().critical_step()
    problem = bar(bulk_viscosity=(linear, 0.0))
    # h/c is 0.025 s, and the points have 0.5 m/s
    ratio = linear * 0.025 / plain
    assert problem.critical_step() == pytest.approx(plain * (np.sqrt(1 + ratio**2) - ratio))
    problem.step(1.0)
    energies = problem.energies()
    assert energies["viscosity"] > 0.0
    assert abs(energies["integrator"]) < 0.02 * energies.initial
    assert np.abs(problem.points["velocity"]).max() < 0.4


def test_fast_compression_shortens_the_next_steps(tmp_path):
    """And those of a run that goes on from a file."""
    problem = block(bulk_viscosity=(0.0, 20.0), courant=0.1)
    first = problem.critical_step()
    points = problem.points
    points["velocity"][:, 0] = 0.5 - points["x"][:, 0]
    problem.step(1e-4)
    assert problem.critical_step() < 0.8 * first
    problem.save(tmp_path / "run.npz")
    again = block(bulk_viscosity=(0.0, 20.0), courant=0.1)
    again.load(tmp_path / "run.npz")
    assert again.critical_step() == pytest.approx(problem.critical_step(), rel=1e-12)


def test_a_term_without_force_is_refused():
    """Explicit steps find their forces where the increment is 0."""
    with pytest.raises(FormError, match=r"term '.*10.*' over the points is 0 without the incr"):
        block(lambda points, u, v: 10 * ufl.inner(u, v) * points.dX)
    with pytest.raises(FormError, match="so that it would do nothing; state the force"):
        block(lambda points, u, v: ufl.inner(ufl.sym(ufl.grad(u)), ufl.grad(v)) * points.dX)
    # a force of a displacement acts, also with the increment
    found = []
    for own in (0.0, 1.0):
        problem = block(
            lambda points, u, v, own=own: (
                1e5 * ufl.inner(points.x + own * u - points.x0, v) * points.dX
            )
        )
        problem.points["velocity"] = (0.1, 0.0)
        for t in (0.01, 0.02, 0.03):
            problem.step(t)
        found.append(problem.momentum()[0])
    assert found[0] < 0.99 * 25.0
    assert found[1] == pytest.approx(found[0], rel=1e-12)


def test_a_number_of_steps_at_once_is_checked_with_every_length():
    for given in ({"dt": 0.1}, {}):
        with pytest.raises(ParameterError, match="at_once = 0 must be a whole number"):
            next(mpm.times(1.0, at_once=0, **given))


@pytest.mark.parametrize("kind", [mpm.Newmark, mpm.Explicit])
def test_steps_that_pass_over_incoming_waves_of_a_record(kind):
    t = np.arange(0.0, 0.1, 1e-5)
    record = mpm.InputMotion(t, velocity=np.sin(4e3 * np.pi * t) * np.sin(10 * np.pi * t) ** 2)
    rock = {"density": 1000.0, "p_speed": 32.0, "s_speed": 22.0}

    def side(V):
        return mpm.absorbing(V, "bottom", **rock, incoming=(record, None))

    problem = block(conditions=side, kind=kind)
    # steps of a tenth of the period see all of the waves
    for t in mpm.times(1e-3, dt=5e-5):
        problem.step(t)
    with pytest.warns(DriftingRecordWarning, match="passes over waves of the record"):
        problem.step(0.0521)


def test_a_velocity_set_by_hand_is_half_a_step_behind():
    """As the velocities that points carry: forces change it over half of both steps."""
    problem = block(lambda points, u, v: -2.0 * points.density * v[1] * points.dX)
    points = problem.points
    first = problem.step(0.02).dt
    points["velocity"] = (0.0, 0.5)
    second = problem.step(0.03).dt
    steps = round(0.01 / second)
    expected = 0.5 + 2.0 * (0.5 * (first + second) + (steps - 1) * second)
    assert points["velocity"][:, 1].mean() == pytest.approx(expected, rel=1e-9)


def test_a_wave_in_a_body_under_stress_does_not_grow_without_an_error():
    """The strain energy at first is 1e10 times that of the wave, and the step is too long."""
    grid = mpm.create_lattice(COMM, [np.linspace(0, 1, 17), np.linspace(0, 0.1875, 4)])
    points = mpm.fill(grid, mpm.Box((0, 0), (1, 0.1875)), 2, density=1000.0)
    V, law = mpm.Space(grid, "bspline2"), mpm.materials.Hencky(1e6, 0.0)
    F = mpm.momentum(law, points, V.increment, V.test)
    bcs = mpm.prescribed(V, lambda x: x[0] > -1, 0)
    bcs += mpm.prescribed(V, "left", 1) + mpm.prescribed(V, "right", 1)
    problem = mpm.Explicit(F, V.increment, points, bcs, mass="consistent")
    mpm.set_stress(law, points, np.diag([-2.79e5, 0.0, 0.0]))
    x = points["x"][:, 0]
    points["velocity"] = 1e-4 * np.stack([0 * x, np.sin(np.pi * x)], axis=1)

    def run():
        for k in range(1, 60):
            problem.step(1.2936e-3 * k)

    with pytest.raises(InstabilityError, match="of first strain energy"):
        run()


@pytest.mark.parametrize("courant", [float("nan"), 0.0, -1.0, "fast", None])
def test_a_courant_number_that_is_set_later(courant):
    problem = block()
    problem.step(1e-3)
    problem.courant = courant
    with pytest.raises(ParameterError, match=r"courant = .* must be (above 0|a number)"):
        problem.step(2e-3)
    assert problem.time == 1e-3
