"""Contact with rigid bodies on several ranks."""

from __future__ import annotations

import numpy as np
import ufl
from contactscenes import falls, is_hit, is_ploughed, is_pressed
from dolfinx import fem, mesh

import dolfinmpm as mpm

from .common import COMM, sums
from .restart import REPEATABLE, goes_on


def ploughed(**options):
    """A wedge with a round tip is pressed into a block with friction, and then drawn aside."""
    grid = mesh.create_rectangle(COMM, [(0, 0), (6, 4)], (12, 8), mesh.CellType.quadrilateral)
    points = mpm.fill(grid, mpm.Box((0, 0), (6, 2)), 2, 1000.0)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    tool = mpm.RigidBody(
        mpm.Wedge((2.4, 1.85), np.degrees(0.7), 1.5), fillet=0.1, name="tool",
        rotation_increment=np.degrees(-0.01),
        increment=lambda t: (0.05, 0.0) if t > 4 else (0.0, -0.05),
    )  # fmt: skip
    F = mpm.momentum(mpm.materials.VonMises(E=1e6, nu=0.3, radius=2e4), points, u, v)
    F -= ufl.inner(points.density * ufl.as_vector((0.0, -10.0)), v) * points.dX
    F += mpm.contact(tool, points, u, v, friction=0.3, penalty=25.0)
    bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
    problem = mpm.QuasiStatic(F, u, points, bcs, stabilisation="ghost", **options)
    return problem, problem.step


def figures(problem):
    body = problem.bodies.all[0]
    names = "x", "F", "stress", "contact1_tangential_force", "contact1_normal_force"
    return {
        "force": body.force.tolist(), "moment": body.moment.tolist(),
        "position": body.position.tolist(), "angle": body.angle.tolist(),
        "dissipated": problem.bodies.contacts[0].dissipated,
        **sums(problem.points, *names),
    }  # fmt: skip


def contact_quasistatic():
    """Penetration and ploughing: the tool's force, slips that points carry from rank to rank."""
    problem, step = ploughed(tolerance=1e-12)
    for _ in range(8):
        step()
    assert problem.bodies.all[0].force[1] > 0
    return figures(problem)


def contact_restart():
    """A run that is broken off while the tool is in the ground."""
    return goes_on(lambda: ploughed(petsc_options=REPEATABLE, tolerance=1e-12), 7, moves=False)


def _penetrated(**options):
    """A cone on a shaft goes on into clay that its rings flow past, on a zoned grid."""
    out, up = np.r_[0:1.6:4j, 2.4, 4.0, 8.0], np.r_[-9, -6, -4.5:0.5:11j, 1.0]
    grid = mpm.create_lattice(COMM, [out, up])
    meridian = [(0, -2.7), (1, -1), (1, 9), (-1, 9), (-1, -1)]
    cone = mpm.RigidBody(mpm.Polygon(meridian), increment=(0, -0.1), fillet=0.5, name="cone")

    def beside(x):
        return (cone.surface.probe(np.ascontiguousarray(x.T))[0] > 0.15) & (x[1] < 0)

    ground = mpm.Where(beside, low=np.array([0.0, -9.0]), high=np.array([8.0, 0.0]))
    points = mpm.fill(grid, ground, 2, 1000.0, axisymmetric=True)
    V = mpm.Space(grid, "gimp", domains="volume")
    clay = mpm.materials.Tresca(E=3e6, nu=0.45, cohesion=1e4)
    F = mpm.momentum(clay, points, V.increment, V.test, fbar=True)
    F += mpm.contact(cone, points, V.increment, V.test, friction=0.1)
    bcs = mpm.prescribed(V, "left", 0) + mpm.prescribed(V, "right", 0) + mpm.fixed(V, "bottom")
    problem = mpm.QuasiStatic(F, V.increment, points, bcs, stabilisation="ghost", **options)
    return problem, problem.step


def contact_of_revolution():
    """A cone in mid-penetration that goes on from there, on each number of ranks."""
    options = {"petsc_options": REPEATABLE, "tolerance": 1e-11}
    found = goes_on(lambda: _penetrated(**options), 6, moves=False)
    problem, step = _penetrated(tolerance=1e-11)
    for _ in range(6):
        step()
    force = problem.bodies.all[0].force
    assert force[1] > 5e4 * np.pi
    assert force[0] == 0.0
    return {"going_on": found, **figures(problem)}


def _turned(**options):
    """A turned block between two plates, which touches with its own faces."""
    grid = mesh.create_rectangle(COMM, [(-1, -1), (1, 1)], (10, 10), mesh.CellType.quadrilateral)
    turn = np.radians(25.0)
    Q = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    corners = 0.5 * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) @ Q.T
    points = mpm.fill(grid, mpm.Polygon(corners), 2, 1000.0, exact=True)
    V, up = mpm.Space(grid, "gimp"), Q[:, 1]
    F = mpm.momentum(mpm.materials.VonMises(1e6, 0.3, radius=2e4), points, V.increment, V.test)
    edge = mpm.Boundary.from_polygon(points, corners)
    for name, side in (("top", 1.0), ("bottom", -1.0)):
        plane, motion = mpm.Plane(0.5 * side * up, -side * up), tuple(-0.005 * side * up)
        plate = mpm.RigidBody(plane, increment=motion, name=name)
        F += mpm.contact(plate, points, V.increment, V.test, friction=0.3, surface=edge)
    problem = mpm.QuasiStatic(F, V.increment, points, [], stabilisation="ghost", **options)
    return problem, problem.step


def contact_along_a_boundary():
    """Faces of a body's boundary, whose points are on several ranks, and a restart."""
    options = {"petsc_options": REPEATABLE, "tolerance": 1e-11}
    found = goes_on(lambda: _turned(**options), 4, moves=False)
    problem, step = _turned(tolerance=1e-12)
    for _ in range(3):
        step()
    return {"going_on": found, **figures(problem)}


def free_body_at_an_edge():
    """A footing under a load, whose edge leaves a corner of the points: secants over both."""
    grid = mpm.create_lattice(COMM, [np.arange(-4, 4.1, 0.25), np.arange(-2, 0.6, 0.25)])
    points = mpm.fill(grid, mpm.Box((-4, -2), (4, 0)), 2, 1700.0)
    V = mpm.Space(grid, "gimp")
    load = fem.Constant(grid, (0.0, 0.0))
    box, free = mpm.Box((-1, 0), (1, 0.5)), (False, True, False)
    footing = mpm.RigidBody(box, free=free, force=load, name="footing")
    F = mpm.momentum(mpm.materials.Tresca(1e7, 0.3, cohesion=2e4), points, V.increment, V.test)
    F += mpm.contact(footing, points, V.increment, V.test)
    bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
    problem = mpm.QuasiStatic(F, V.increment, points, bcs, tolerance=1e-11)
    for pressed in (25e3, 50e3):
        load.value[1] = -pressed
        record = problem.step()
    assert record.halvings == 0
    # the moment is zero but for rounding
    found = {"force": footing.force.tolist(), "position": footing.position.tolist()}
    return {**found, **sums(problem.points, "x", "stress", "contact1_normal_force")}


def _thrown(kind, free=True, **options):
    """A ball falls on a block, turning: it is free, or it goes on as it came."""
    grid = mesh.create_rectangle(COMM, [(0, 0), (6, 3)], (12, 6), mesh.CellType.quadrilateral)
    points = mpm.fill(grid, mpm.Box((0, 0), (6, 1.5)), 2, 1000.0)
    V = mpm.Space(grid, "gimp")
    mass = {"mass": 2000.0, "inertia": 100.0, "gravity": (0.0, -10.0)} if free else {}
    ball = mpm.RigidBody(
        mpm.Disc((2.9, 2.0), 0.5), velocity=(0.5, -1.0), name="ball",
        angular_velocity=np.degrees(-1.0), **mass,
    )  # fmt: skip
    F = mpm.momentum(mpm.materials.Hencky(E=1e5, nu=0.3), points, V.increment, V.test)
    F += mpm.contact(ball, points, V.increment, V.test, friction=0.2)
    return kind(F, V.increment, points, mpm.fixed(V, "bottom"), **options), ball


def faces_of_few_ranks():
    """A face of a long block is pressed by a wall: only one rank has markers of the face."""
    grid = mpm.create_lattice(COMM, [0.125 * np.arange(-4, 28), 0.125 * np.arange(-1, 6)])
    points = mpm.fill(grid, mpm.Box((0, 0), (3, 0.5)), 2, 1000.0)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    face = mpm.Boundary.from_polygon(points, [(0, 0.5), (0, 0)], closed=False)
    wall = mpm.RigidBody(mpm.Plane((0, 0), (1, 0)), increment=(3e-3, 0.0), name="wall")
    F = mpm.momentum(mpm.materials.Hencky(1e6, 0.0), points, u, v)
    F += mpm.contact(wall, points, u, v, friction=0.3, penalty=1000.0, surface=face)
    bcs = mpm.prescribed(V, lambda x: np.isclose(x[0], 3.0), 0)
    bcs += mpm.prescribed(V, lambda x: np.isclose(x[1], 0.0), 1)
    mpm.QuasiStatic(F, u, points, bcs, stabilisation="ghost", tolerance=1e-12).step()
    assert abs(wall.force[0] / (-1e6 * 1e-3 * 0.5) - 1) < 2e-3
    return {"force": list(wall.force), **sums(points, "x", "stress")}


def contact_in_time():
    """A free ball, by implicit and explicit steps."""
    found = {}
    for kind, options in (
        (mpm.Newmark, {"mass": "lumped", "tolerance": 1e-12}),
        (mpm.GeneralisedAlpha, {"mass": "lumped", "tolerance": 1e-12}),
        (mpm.Explicit, {}),
    ):
        problem, ball = _thrown(kind, **options)
        for t in mpm.times(0.2, dt=0.01):
            problem.step(t)
        assert ball.force[1] > 0 or kind is mpm.Explicit
        assert np.isfinite(ball.freedom.velocity).all()
        velocity = ball.freedom.velocity.tolist()
        found[kind.__name__] = {"velocity": velocity, **figures(problem)}
    return found


def _moved_on(build, times):
    """A scene of fused steps, and how one goes to each of some times in turn."""
    problem = build()
    assert problem.unfused == ""
    return problem, lambda: problem.step(times[len(problem.history)])


def contact_in_fused_steps():
    """Points that touch bodies and change rank, in two and three dimensions."""
    scenes = {
        "falls": (lambda: falls(scheme="musl"), 0.2),
        "falls on splines": (lambda: falls("bspline2", False, scheme="usf", courant=0.6), 0.2),
        "is hit": (is_hit, 0.12),
        "is ploughed": (is_ploughed, 0.08),
        "is pressed": (lambda: is_pressed(free=True, courant=0.4), 0.05),
    }
    found, moved = {}, 0
    for name, (build, end) in scenes.items():
        problem, step = _moved_on(build, [0.3 * end, 0.7 * end, end])
        for _ in range(3):
            step()
        moved += sum(record.migrated for record in problem.history)
        energies = problem.energies()
        first = problem.bodies.contacts[0]
        found[name] = {
            "parts": [record.parts for record in problem.history],
            "energies": [energies.kinetic, energies.strain, energies.external],
            "bodies": {
                body.name: [*body.position, *body.angle, *body.force, *body.moment]
                for body in problem.bodies.all
            },
            "dissipated": [c.dissipated for c in problem.bodies.contacts],
            **sums(problem.points, "x", "velocity", "F", "stress", *first.names[:2]),
        }
        assert max(found[name]["dissipated"]) > 0
    return {"moved": moved, **found}


def contact_restart_in_fused_steps():
    """Runs of fused steps that are broken off in contact go on with the same bits."""
    found = {}
    for name, build, end in (
        ("falls", lambda: falls(scheme="musl"), 0.2),
        ("is hit", is_hit, 0.12),
        ("is pressed", lambda: is_pressed(free=True, courant=0.4), 0.05),
    ):
        times = [end * (k + 1) / 5 for k in range(5)]
        found[name] = goes_on(lambda b=build, t=times: _moved_on(b, t), 5, moves=False)
    return found
