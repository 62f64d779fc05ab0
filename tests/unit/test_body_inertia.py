"""Free rigid bodies that turn in 3D, against Euler's equations solved by SciPy."""

from __future__ import annotations

import numpy as np
import pytest
from dolfinx import mesh
from mpi4py import MPI
from scipy.integrate import solve_ivp

import dolfinmpm as mpm
from dolfinmpm._platform.errors import ParameterError
from dolfinmpm.contact.bodyinertia import inertial_forces, skew

J = np.array([1.0, 2.0, 3.0])
# about the axis of the middle inertia, from which the body tips over
SPIN = np.array([0.05, 3.0, 0.1])
RULES = {
    "newmark": (mpm.Newmark, {}),
    "generalised-α": (mpm.GeneralisedAlpha, {"rho_inf": 0.6}),
    "explicit": (mpm.Explicit, {}),
}


def body(**options):
    """A body far above all points."""
    shape = mpm.Box((0, 0, 11), (1, 1, 12))
    return mpm.RigidBody(shape, mass=6.0, inertia=J, name="top", **options)


def turned(top, rule, dt, end, **options):
    """The rotation matrix of a body after a run beside soil at rest."""
    cells = mesh.CellType.hexahedron
    grid = mesh.create_box(MPI.COMM_WORLD, [(0, 0, 0), (1, 1, 1)], (1, 1, 1), cells)
    points = mpm.fill(grid, mpm.Box((0, 0, 0), (1, 1, 1)), 2, 1000.0)
    V = mpm.Space(grid, "linear")
    # so soft that the penalty does not shorten explicit steps for the light body
    F = mpm.momentum(mpm.materials.Hencky(E=1.0, nu=0.0), points, V.increment, V.test)
    F += mpm.contact(top, points, V.increment, V.test)
    problem = rule(F, V.increment, points, mpm.fixed(V, "bottom"), **options)
    for t in mpm.times(end, dt=dt):
        problem.step(t)
    if rule is not mpm.Explicit:
        assert max(record.iterations for record in problem.history) <= 5
    return top.pose.rotation, problem


def exact(end, held=None, moment=(0.0, 0.0, 0.0)):
    """The same by Euler's equations; `held` has the rate about z, and its derivative."""

    def rates(t, y):
        R, w = y[:9].reshape(3, 3), y[9:].copy()
        a = np.zeros(3)
        if held is not None:
            w[2], a[2] = held[0](t), held[1](t)
        K = R @ np.diag(J) @ R.T
        own = slice(0, 3 if held is None else 2)
        out = moment - np.cross(w, K @ w) - K @ a
        a[own] = np.linalg.solve(K[own, own], out[own])
        return np.concatenate([(skew(w) @ R).ravel(), a])

    first = np.concatenate([np.eye(3).ravel(), SPIN])
    return solve_ivp(rates, (0, end), first, rtol=1e-9, atol=1e-10).y[:9, -1].reshape(3, 3)


def angle(A, B):
    """Angle between two rotations (degrees)."""
    return np.degrees(np.arccos(np.clip(0.5 * (np.trace(A.T @ B) - 1), -1, 1)))


@pytest.mark.parametrize("name", RULES)
def test_a_body_without_moments_tips_over(name):
    """Steps of half the length have a quarter of the error; the momentum stays."""
    rule, options = RULES[name]
    end, errors = 1.5, []
    for dt in (0.05, 0.025):
        top = body(angular_velocity=np.degrees(SPIN))
        R, problem = turned(top, rule, dt, end, **options)
        errors.append(angle(R, exact(end)))
        energies = problem.energies()
        assert energies.bodies == pytest.approx(0.5 * SPIN @ (J * SPIN), rel=1e-3)
        assert abs(energies["integrator"]) < 1e-3 * energies.initial
        spin = top.freedom.velocity[3:]
        momentum = R @ np.diag(J) @ R.T @ spin
        # the velocities of explicit steps are half a step behind the pose
        bound = 2e-2 if rule is mpm.Explicit else 1e-3
        np.testing.assert_allclose(momentum, J * SPIN, atol=bound * np.linalg.norm(J * SPIN))
    assert errors[0] < 0.3
    assert 3.0 < errors[0] / errors[1] < 5.0


@pytest.mark.parametrize("name", ["newmark", "generalised-α"])
def test_a_rotation_that_is_prescribed_acts_on_those_that_are_free(name):
    rate = (lambda t: SPIN[2] + np.sin(3 * t)), (lambda t: 3 * np.cos(3 * t))
    moment, end, errors = np.array([0.4, -0.2, 0.1]), 1.0, []
    rule, options = RULES[name]
    for dt in (0.05, 0.025):
        top = body(
            free=(True,) * 5 + (False,), moment=lambda t: moment,
            angular_velocity=lambda t: np.degrees([*SPIN[:2], rate[0](t)]),
        )  # fmt: skip
        R, _ = turned(top, rule, dt, end, **options)
        errors.append(angle(R, exact(end, rate, moment)))
    assert errors[0] < 0.4
    assert 3.0 < errors[0] / errors[1] < 5.0


def test_the_derivative_of_inertial_forces():
    top = body(angular_velocity=np.degrees(SPIN))
    free = top.freedom
    top.begin(0.01)
    V, A = np.arange(6.0), 10 - np.arange(6.0) ** 2
    slopes = 200.0, 4e4
    start = np.array([0.1, -0.2, 0.3, 1e-3, 2e-3, -1e-3])

    def forces(w):
        free.increment = w.copy()
        motion = V + slopes[0] * (w - start), A + slopes[1] * (w - start)
        return inertial_forces(top, 1.0, motion, slopes)

    found = forces(start)[1]
    for k, w in enumerate(np.eye(6)):
        step = 1e-6
        both = (forces(start + step * w)[0] - forces(start - step * w)[0]) / (2 * step)
        np.testing.assert_allclose(found[:, k], both, atol=1e-3)


@pytest.mark.parametrize("axis", [(1.0,), (1 / 3, 2 / 3, 2 / 3)])
def test_the_work_of_a_moment_is_over_the_whole_angle(axis):
    """A third of a turn in one step, whose sine is not its angle."""
    shape = mpm.Disc((0, 0), 1.0) if len(axis) == 1 else mpm.Ball((0, 0, 0), 1.0)
    rate = 120.0 * np.array(axis)
    wheel = mpm.RigidBody(shape, rotation_increment=rate.tolist())
    wheel.begin(1.0)
    wheel.put(1.0)
    work = wheel.commit(np.zeros(wheel.gdim), -2.0 * rate / 120, mean=True)
    assert work == pytest.approx(2.0 * 2 * np.pi / 3)


@pytest.mark.parametrize("motion", ["displacement", "rotation"])
def test_a_motion_of_free_components_alone_is_refused(motion):
    size = 2 if motion == "displacement" else 1
    options = {motion: lambda t: np.zeros(size)}
    with pytest.raises(ParameterError, match=rf"{motion} prescribes components that are free"):
        mpm.RigidBody(mpm.Disc((0, 0), 1.0), mass=1.0, inertia=1.0, **options)
    held = (False, True, False)
    mpm.RigidBody(mpm.Disc((0, 0), 1.0), mass=1.0, inertia=1.0, free=held, **options)
