"""Bad inputs that Python, NumPy or UFL would tell of in words of their own; part of `badinputs`."""

from __future__ import annotations

import functools

import numpy as np
from dolfinx import fem, mesh
from mpi4py import MPI

import dolfinmpm as mpm

G = (0.0, -9.81)


@functools.cache
def rings():
    """Points that are rings, and their spaces of a vector and of a scalar."""
    kind = mesh.CellType.quadrilateral
    grid = mesh.create_rectangle(MPI.COMM_WORLD, [(0, 0), (4, 2)], (8, 4), kind)
    points = mpm.fill(grid, mpm.Box((0, 0), (2, 1)), 2, 1000.0, axisymmetric=True)
    return points, mpm.Space(grid), mpm.Space(grid, shape=())


def soil(s, **given):
    V, Q = mpm.Space(s.grid, "bspline2"), mpm.Space(s.grid, shape=())
    fields, tests = (V.increment, Q.increment), (V.test, Q.test)
    given = {"permeability": 1e-5, "porosity": 0.4, **given}
    return mpm.poromechanics(s.law, s.fill(), fields, tests, **given)


def heavy(gravity):
    return mpm.RigidBody(mpm.Disc((0, 0), 1.0), mass=1.0, inertia=1.0, gravity=gravity)


def deposit(**given):
    ground = mpm.Deposit(0.0, mpm.Layer(-5.0, 18e3, 0.5))
    return ground.density(np.array([[0.0], [-1.0]]), **given)


def boundary(s, *corners, **given):
    return mpm.Boundary.from_polygon(s.points, corners, **given)


# name → what is done with the scene of `badinputs`, and what the message has
RAW = {
    # -- shapes
    "box: words": (lambda s: mpm.Box("ab", "cd"), "low = 'ab' must be numbers"),
    "ball: words": (lambda s: mpm.Ball("ab", 1.0), "centre = 'ab' must be numbers"),
    "disc: radius a word": (lambda s: mpm.Disc((0, 0), "a"), "radius = 'a' must be a number"),
    "polygon: words": (lambda s: mpm.Polygon(["ab", "cd", "ef"]), "vertices = .* must be numbers"),
    "turned box: words": (lambda s: mpm.TurnedBox("ab", "cd", 5.0), "low = 'ab' must be numbers"),
    "turned box: angle": (lambda s: mpm.TurnedBox((0, 0), (1, 1), "a"), "angle = 'a' must be a n"),
    "plane: words": (lambda s: mpm.Plane("ab", "cd"), "point = 'ab' must be numbers"),
    "cone: words": (lambda s: mpm.Cone("abc", 1, 30, 10), "tip = 'abc' must be numbers"),
    "wedge: words": (lambda s: mpm.Wedge("ab", 30, 10), "tip = 'ab' must be 2 finite numbers"),
    # -- forms
    "gradient: a number": (lambda s: mpm.gradient(s.points, 3.0), r"w = 3\.0 must be a field of U"),
    "gradient: no points": (lambda s: mpm.gradient(None, s.u), "points = None must be material p"),
    "gradient: of axisymmetric bodies": (
        lambda s: mpm.gradient(rings()[0], mpm.Space(rings()[0].grid, shape=(3,)).increment),
        r"the shape \(3,\), and at axisymmetric points",
    ),
    "cell_size: points": (lambda s: mpm.cell_size(s.points), "grid = a MaterialPoints must be a M"),
    "cell_size: none": (lambda s: mpm.cell_size(None), r"give the background grid, points\.grid"),
    "cell_size: a space": (lambda s: mpm.cell_size(s.V), "grid = a Space must be a Mesh"),
    "gravity: a tuple": (lambda s: s.points.density * G, r"points\.density times \(0\.0, -9\.81\)"),
    "gravity: from the left": (lambda s: list(G) * s.points.density, r"dolfinx\.fem\.Constant\(p"),
    "gravity: an array": (lambda s: s.points.density * np.array(G), "knows no tuples and arrays"),
    "gravity: before it": (lambda s: np.array(G) * s.points.density, "knows no tuples and arrays"),
    "gravity: of 3D": (
        lambda s: s.points.density * fem.Constant(s.grid, (0.0, 0.0, -9.81)),
        "a vector of 3 components, and the points are in 2D",
    ),
    "gravity: of a body": (lambda s: heavy((0, 0, -9.81)), r"gravity = \(0, 0, -9\.81\) must be 2"),
    "gravity: a number": (lambda s: heavy(-9.81), r"gravity = -9\.81 must be 2 finite numbers"),
    "gravity: a word": (lambda s: heavy("down"), "gravity = 'down' must be 2 finite numbers"),
    "gravity: of a deposit": (lambda s: deposit(gravity=G), r"gravity = \(0\.0, -9\.81\) must"),
    "gravity: downwards": (lambda s: deposit(gravity=-9.81), r"gravity = -9\.81 m/s² must be"),
    "permeability: of positions": (
        lambda s: soil(s, permeability=lambda x: x[0]),
        "permeability, a function, failed with TypeError.* volume ratio J and the porosity n",
    ),
    "permeability: nan": (lambda s: soil(s, permeability=np.nan), "nan is the result of a failed"),
    "permeability: nan in it": (
        lambda s: soil(s, permeability=((1.0, 0.0), (0.0, np.nan))), "must be finite",
    ),
    # -- laws
    "law: a constant": (
        lambda s: mpm.materials.Hencky(s.c, 0.3), r"E = a Constant is an expression of UFL.*float",
    ),
    "law: a function of DOLFINx": (
        lambda s: mpm.materials.VonMises(1e4, 0.3, radius=s.u), "radius = a Function is an express",
    ),
    "respond: two strains": (lambda s: s.law.respond([1e-3, 0]), r"strain = \[0\.001, 0\] must be"),
    "respond: words": (lambda s: s.law.respond("ab"), "strain = 'ab' must be three principal"),
    "respond: none": (lambda s: s.law.respond(None), "strain = None must be three principal"),
    "respond: internal": (
        lambda s: mpm.materials.Tresca(1e4, 0.3, 10.0).respond([0, 0, 0], internal=np.zeros(5)),
        r"internal has the shape \(5,\) and must have a row for each strain: plastic_strain",
    ),
    # -- points
    "points: velocity": (lambda s: s.fill()["velocity"], "'velocity'; .*mpm.Newmark, .* gives it"),
    "points: set velocity": (
        lambda s: s.fill().__setitem__("velocity", 0.0), r"or add it .* points\.add_field",
    ),
    "points: velocity in UFL": (lambda s: s.fill().velocity, "'velocity'; .*mpm.Newmark"),
    "points: what yields": (lambda s: s.fill()["plastic_strain"], "a law gives it to them"),
    "points: near miss": (lambda s: s.fill()["stres"], "did you mean 'stress'"),
    # -- problems
    "newmark: collision": (
        lambda s: s.motion(collision=mpm.Collision()),
        "Newmark has no argument collision: .*Explicit",
    ),
    "static: collision": (
        lambda s: s.solver(collision=mpm.Collision()), r"mpm\.contact in the form",
    ),
    "newmark: dt": (lambda s: s.motion(dt=0.1), r"Newmark has no argument dt: step\(t\)"),
    "static: near miss": (lambda s: s.solver(toleranc=0.1), "toleranc; did you mean tolerance"),
    "explicit: tolerance": (
        lambda s: s.motion(mpm.Explicit, tolerance=0.1), "Explicit has no argument tolerance",
    ),
    # -- rigid bodies and boundaries
    "rigid: free a word": (
        lambda s: mpm.RigidBody(mpm.Disc((0, 0), 1), free="abc", force=(0, 1)), "free = 'abc' must",
    ),
    "rigid: inertia a word": (
        lambda s: mpm.RigidBody(mpm.Disc((0, 0), 1), mass=1.0, inertia="a"), "inertia = 'a' must b",
    ),
    "boundary: clockwise at the edge": (
        lambda s: boundary(s, (0, 0), (0, 1), (2, 1), (2, 0)),
        r"lies on the grid's edge .* points into the grid.* give vertices",
    ),
    "boundary: backwards at the edge": (
        lambda s: boundary(s, (4, 0), (0, 0), closed=False), r"vertices\[::-1\]",
    ),
}  # fmt: skip
