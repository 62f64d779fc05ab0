"""Bodies of points that touch rigid bodies, in explicit steps."""

from __future__ import annotations

import numpy as np
import ufl
from dolfinx import mesh
from mpi4py import MPI

import dolfinmpm as mpm
from dolfinmpm.grid.lattice import smallest_height

COMM = MPI.COMM_WORLD
ELASTIC = mpm.materials.Hencky(E=1e5, nu=0.3)
CLAY = mpm.materials.VonMises(E=1e6, nu=0.3, radius=5e3)


def grid_of(low, high, n):
    """A rectangular grid."""
    if len(n) == 2:
        return mesh.create_rectangle(COMM, [low, high], n, mesh.CellType.quadrilateral)
    return mesh.create_box(COMM, [low, high], n, mesh.CellType.hexahedron)


def body(grid, shape, law, basis, averaged=None, tags=False, weight=True):
    """Points of a shape, their space, and the form of their momentum and weight."""
    points = mpm.fill(grid, shape, 2, 1000.0)
    V = mpm.Space(grid, basis, **({} if averaged is None else {"averaged": averaged}))
    if tags:
        points["tag"][:] = np.where(points["x"][:, 0] < 0.0, 1, 2)
    F = mpm.momentum(law, points, V.increment, V.test)
    g = (0.0,) * (points.gdim - 1) + (-10.0 if weight else 0.0,)
    F -= ufl.inner(points.density * ufl.as_vector(g), V.test) * points.dX
    points.add_field("velocity", (points.gdim,), "m/s")
    return points, V, F


def compressed(kind, **options):
    """A plate presses a block between walls by 5 % in a second; and what the block then stores."""
    grid = grid_of((0, 0), (1, 1.25), (4, 5))
    points, V, F = body(grid, mpm.Box((0, 0), (1, 1)), ELASTIC, "gimp", weight=False)
    plate = mpm.RigidBody(
        mpm.Plane((0, 1), (0, -1)), name="plate",
        displacement=lambda t: (0, -0.05 * np.sin(0.5 * np.pi * t) ** 2),
    )  # fmt: skip
    F += mpm.contact(plate, points, V.increment, V.test, penalty=25.0)
    bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
    stored = 0.5 * (1e5 * 0.7 / (1.3 * 0.4)) * np.log(0.95) ** 2
    return kind(F, V.increment, points, bcs, **options), stored


def falls(
    basis="gimp", averaged=None, corners=None, surface=False, graded=False, law=ELASTIC, **options
):  # fmt: skip
    """A disc falls on a slope, and rolls."""
    grid = grid_of((-1, -0.5), (1, 1.5), (16, 16))
    if graded:
        x = np.linspace(-1, 1, 17)
        x = np.sign(x) * np.abs(x) ** 1.3
        grid = mpm.create_lattice(COMM, [x, x + 0.5])
    points, V, F = body(grid, mpm.Disc((0.013, 0.45), 0.4), law, basis, averaged)
    points["velocity"][:] = 0.5, -2.0
    slope = mpm.RigidBody(mpm.Plane((0, 0.03), (0.1, 1)), name="slope")
    face = None
    if surface:
        r = points["x"] - (0.013, 0.45)
        area = np.where(np.linalg.norm(r, axis=1)[:, None] > 0.33, 0.05 * r / 0.4, 0.0)
        face = mpm.Surface.from_arrays(points, np.where(area != 0, 0.06 * r, 0.0), area)
    F += mpm.contact(
        slope,
        points,
        V.increment,
        V.test,
        friction=0.3,
        corners=corners,
        surface=face,
        penalty=50.0 * smallest_height(grid),
    )
    return mpm.Explicit(F, V.increment, points, **options)


def is_hit(law=ELASTIC, **options):
    """A free disc hits a block, turning, between two walls of which one is the block's alone."""
    grid = grid_of((-1, 0), (1, 1.5), (16, 12))
    block = mpm.Box((-0.75, 0), (0.75, 0.75))
    points, V, F = body(grid, block, law, "gimp", tags=True)
    u, v = V.increment, V.test
    ball = mpm.RigidBody(
        mpm.Disc((-0.1, 1.07), 0.3), velocity=(1.0, -3.0), angular_velocity=np.degrees(-4.0),
        mass=400.0, inertia=18.0, gravity=(0.0, -10.0), name="ball",
    )  # fmt: skip
    left = mpm.RigidBody(mpm.Plane((-0.76, 0), (1, 0)), name="left")
    right = mpm.RigidBody(mpm.Box((0.76, -1), (1.5, 3)), velocity=(-0.3, 0.0), name="right")
    F += mpm.contact(ball, points, u, v, friction=0.4, penalty=6.25)
    F += mpm.contact(left, points, u, v, friction=0.1, tag=1, penalty=6.25)
    for side in (right, left):
        F += mpm.contact(side, points, u, v, tag=2, penalty=6.25)
    return mpm.Explicit(F, u, points, mpm.fixed(V, "bottom"), **options)


def is_ploughed(law=CLAY, limit=None, **options):
    """A wedge is pushed into clay and dragged through it, turning; `limit` is that of its shear."""
    grid = grid_of((-1, 0), (1, 1.25), (16, 10))
    points, V, F = body(grid, mpm.Box((-1, 0), (1, 0.75)), law, "gimp")
    wedge = mpm.RigidBody(
        mpm.Wedge((-0.3, 0.76), np.degrees(0.6), 0.6), fillet=0.03,
        angular_velocity=np.degrees(0.5), name="wedge",
        velocity=lambda t: (0.0, -4.0) if t < 0.02 else (4.0, 0.0),
    )  # fmt: skip
    rubs = {"friction": 0.3, "shear_limit": limit}
    F += mpm.contact(wedge, points, V.increment, V.test, penalty=6.25, **rubs)
    bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
    return mpm.Explicit(F, V.increment, points, bcs, **options)


def is_pressed(free=False, basis="gimp", averaged=None, law=CLAY, **options):
    """A box is pressed askew into a block in three dimensions, or falls on it."""
    grid = grid_of((-0.75,) * 3, (0.75, 0.75, 0.5), (6, 6, 5))
    points, V, F = body(grid, mpm.Box((-0.75,) * 3, (0.75, 0.75, 0)), law, basis, averaged)
    mass = {"mass": 300.0, "inertia": (20.0, 25.0, 30.0), "gravity": (0, 0, -10)} if free else {}
    box = mpm.RigidBody(
        mpm.TurnedBox((-0.3, -0.25, 0.07), (0.3, 0.35, 0.5), np.degrees(0.3)), fillet=0.03,
        velocity=(0.4, 0.2, -3.0), angular_velocity=np.degrees((0.3, -0.4, 0.5)), name="box",
        **mass,
    )  # fmt: skip
    F += mpm.contact(box, points, V.increment, V.test, friction=0.3, penalty=12.5)
    return mpm.Explicit(F, V.increment, points, mpm.fixed(V, "bottom"), **options)
