"""Arguments that are assigned to later: looked at, or refused with what works instead."""

from __future__ import annotations

import pytest
from badinputs import Scene, scene

import dolfinmpm as mpm
from dolfinmpm._platform.errors import ConvergenceError, ParameterError

BODY = [
    "shape",
    "increment",
    "velocity",
    "displacement",
    "rotation_increment",
    "angular_velocity",
    "rotation",
    "centre",
    "fillet",
    "name",
    "free",
    "mass",
    "inertia",
    "gravity",
    "force",
    "moment",
]
COMMON = ["form", "increment", "points", "bcs", "updates", "stabilisation", "prolongation"]
IN_TIME = ["mass", "mapping", "ghost_mass", "error", "time"]
EXPLICIT = [
    "scheme",
    "mapping",
    "mass",
    "damping",
    "mass_scaling",
    "bulk_viscosity",
    "fused",
    "collision",
]


@pytest.mark.parametrize("name", BODY)
def test_arguments_of_rigid_bodies_are_read_once(name):
    body = mpm.RigidBody(mpm.Disc((1, 1.5), 0.2), velocity=(0, -1), name="tool")
    before = body.force, body.moment, body.name
    with pytest.raises(ParameterError, match=f"{name} = 3.0: the rigid body 'tool' has read"):
        setattr(body, name, 3.0)
    assert (body.force, body.moment, body.name) == before


def test_messages_tell_what_works():
    body = mpm.RigidBody(mpm.Disc((1, 1.5), 0.2), velocity=(0, -1), name="tool")
    for name, words in (
        ("velocity", r"velocity=lambda t"),
        ("rotation_increment", r"rotation_increment=lambda t"),
        ("displacement", r"displacement=lambda t.*dolfinx\.fem\.Constant"),
        ("force", r"force=lambda t.*dolfinx\.fem\.Constant"),
        ("gravity", r"dolfinx\.fem\.Constant, whose value you set"),
        ("mass", r"a new body with mass=\.\.\., and a new problem"),
    ):
        with pytest.raises(ParameterError, match=words):
            setattr(body, name, (0.0, 1.0))


def test_arguments_of_footings_are_read_once():
    s = scene()
    footing = mpm.RigidFooting(s.top, s.c, E=1e4)
    for name in ("surface", "settlement", "rough", "E", "stiffness"):
        with pytest.raises(ParameterError, match=f"{name} = .* this RigidFooting has read"):
            setattr(footing, name, 0.5)


@pytest.mark.parametrize(
    ("kind", "names"),
    [
        ("QuasiStatic", ["petsc_options", "options_prefix"]),
        ("Newmark", [*IN_TIME, "beta", "gamma"]),
        ("GeneralisedAlpha", [*IN_TIME, "rho_inf"]),
        ("Transient", ["error", "time"]),
        ("ArcLength", ["load", "length", "control", "factor", "max_length"]),
        ("Explicit", EXPLICIT),
    ],
)
def test_arguments_of_problems_are_read_once(kind, names):
    # a path takes the load away, which other tests look at
    s = Scene() if kind == "ArcLength" else scene()
    made = {"ArcLength": lambda: s.path(length=0.1)}
    problem = made.get(kind, lambda: s.motion(getattr(mpm, kind)))()
    for name in (*COMMON, *names):
        with pytest.raises(ParameterError, match=f"{name} = .*this {kind} has read"):
            setattr(problem, name, 0.5)
    assert problem.points is s.points


def test_limits_of_iterations_may_be_changed_between_steps():
    s = Scene()
    points = s.fill()
    F = s.momentum(points=points) - s.g[1] * s.v[1] * points.density * points.dX
    problem = mpm.QuasiStatic(F, s.u, points, s.bcs)
    problem.tolerance, problem.max_iterations, problem.max_halvings = 1e-12, 1, 0
    assert problem.newton.tolerance == 1e-12
    with pytest.raises(ConvergenceError, match="tolerance 1e-12"):
        problem.step()
    problem.tolerance, problem.max_iterations = 1e-3, 20
    residuals = problem.step().residuals
    assert 1e-9 < residuals[-1] <= 1e-3
    for name in ("tolerance", "max_iterations", "max_halvings"):
        with pytest.raises(ParameterError, match=f"{name} = -1"):
            setattr(problem, name, -1)
    assert problem.tolerance == 1e-3


def test_the_border_of_a_free_body_has_the_same_tolerance():
    s = scene()
    ball = mpm.RigidBody(mpm.Disc((1, 1.6), 0.5), force=(0.0, -1.0), name="ball")
    F = s.F + mpm.contact(ball, s.points, s.u, s.v)
    problem = s.solver(form=F, tolerance=1e-7)
    assert problem.solver.border.tolerance == 1e-7
    problem.tolerance = 1e-5
    assert problem.solver.border.tolerance == problem.newton.tolerance == 1e-5
