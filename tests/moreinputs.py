"""Bad inputs as a user writes them, to be added to those of `badinputs`; the tables have words."""

from __future__ import annotations

import functools
import re

import numpy as np
import ufl
from dolfinx import fem, mesh
from inputs_of_bodies import INPUTS as OF_BODIES
from inputs_of_kinds import INPUTS as OF_KINDS
from inputs_of_problems import INPUTS as OF_PROBLEMS
from mpi4py import MPI

import dolfinmpm as mpm
from dolfinmpm import materials

COMM = MPI.COMM_WORLD
LINE = [0.0, 1.0, 2.0]
SQUARE = mesh.CellType.quadrilateral
TOOL = mpm.Disc((1.0, 1.7), 0.5)
ROWS = [{"h": 0.4, "error": 0.1}, {"h": 0.2, "error": 0.025}]


@functools.cache
def solid():
    """A grid in 3D."""
    return mesh.create_box(COMM, [(0, 0, 0), (2, 2, 2)], (2, 2, 2), mesh.CellType.hexahedron)


@functools.cache
def tri():
    """A grid of triangles."""
    return mesh.create_rectangle(COMM, [(0, 0), (4, 2)], (4, 2), mesh.CellType.triangle)


def up(x):
    return x[1] > 0.99


def energy(e, K):
    return K * ufl.inner(e, e) / 2


def cam_clay(**given):
    usual = {"swelling": 0.01, "compression": 0.1, "M": 1.0, "mu0": 1e5, "alpha": 0.0}
    pressures = {"reference_pressure": -1e4, "preconsolidation": -5e4}
    return materials.CamClay(**(usual | pressures | given))


def lattice(*lines):
    return mpm.create_lattice(COMM, lines)


def points_at(s, x=((0.5, 0.5), (1.0, 0.5)), V=0.1, rho=1.0, **given):
    return mpm.MaterialPoints.from_arrays(s.grid, np.array(x, float), V, rho, **given)


def fill(s, **given):
    usual = {"grid": s.grid, "shape": mpm.Box((0, 0), (2, 1)), "per_cell": 2, "density": 1.0}
    return mpm.fill(**(usual | given))


def newmark(s, **given):
    return s.motion(**given)


def explicit(s, **given):
    return s.motion(mpm.Explicit, **given)


def transient(s, **given):
    return s.motion(mpm.Transient, **given)


def absorbing(s, *sides, **given):
    usual = {"density": 1.0, "p_speed": 2.0, "s_speed": 1.0}
    return mpm.absorbing(s.V, *(sides or ("left",)), **(usual | given))


def carried(s, *arguments, **given):
    return mpm.carried(s.fill(), *arguments, **given)


def paraview(s, *arguments, **given):
    return mpm.ParaView("a.pvd", s.points, *arguments, **given)


def touch(s, body=None, **given):
    usual = {"points": s.points, "u": s.u, "v": s.v}
    return mpm.contact(body or s.tool, **(usual | given))


def hold(s, **given):
    usual = {"law": s.law, "boundary": s.side, "u": s.u, "v": s.v}
    return mpm.dirichlet(**(usual | given))


def wall(s, **given):
    usual = {"law": s.law, "boundary": s.wall, "u": s.u, "v": s.v}
    return mpm.signorini(**(usual | given))


def new_side(s):
    return mpm.Boundary.from_polygon(s.points, [(2, 0), (2, 1)], closed=False)


def footing(s):
    return mpm.RigidFooting(s.top, s.c, E=1e4).contact(s.u, s.v)


def facing(s, change, **given):
    """The contact of two bodies, of changed boundaries, increments and test functions."""
    lower, upper = mpm.Box((0, 0), (2, 1)), mpm.Box((0, 1), (2, 2))
    points = mpm.fill(s.grid, lower, 2, 1.0, tag=1) + mpm.fill(s.grid, upper, 2, 1.0, tag=2)
    spaces = [mpm.Space(s.grid, tag=k) for k in (1, 2)]
    ends = [[(2.0, 1.0), (0.0, 1.0)], [(0.0, 1.0), (2.0, 1.0)]]
    sides = [mpm.Boundary.from_polygon(points, x, closed=False, rule=1) for x in ends]
    u, v = [x.increment for x in spaces], [x.test for x in spaces]
    return mpm.contact_between(*change(points, sides, u, v), **given)


def soil(s, **given):
    V, Q = mpm.Space(s.grid, "bspline2"), mpm.Space(s.grid, shape=())
    usual = {"soil": s.law, "points": s.fill(), "permeability": 1e-5, "porosity": 0.4}
    fields = {"fields": (V.increment, Q.increment), "tests": (V.test, Q.test)}
    made = usual | fields | given
    for name in fields:
        made[name] = made[name](V, Q) if callable(made[name]) else made[name]
    return mpm.poromechanics(**made)


def scaled():
    """A grid whose unit was changed when the body was on it already."""
    grid = mesh.create_rectangle(COMM, [(0, 0), (4, 2)], (8, 4), mesh.CellType.quadrilateral)
    points, V = mpm.fill(grid, mpm.Box((0, 0), (2, 1)), 2, 1.0), mpm.Space(grid)
    grid.geometry.x[:] *= 1000
    F = mpm.momentum(materials.Hencky(1e4, 0.3), points, V.increment, V.test)
    return mpm.QuasiStatic(F, V.increment, points, mpm.fixed(V, "bottom"))


def leaky(s, k):
    """A mixture whose permeability is a field of its points."""
    points = s.fill()
    return soil(s, points=points, permeability=points.add_field("k", np.shape(k), "m/s", k))


def flat():
    """Level ground at height 0."""
    return mpm.Terrain([LINE, LINE], np.zeros((3, 3)))


def curve():
    """A history of two numbers."""
    found = mpm.History()
    found.record(a=1.0, b=2.0)
    return found


def axes():
    from matplotlib.figure import Figure

    return Figure().add_subplot()


def evaluated(text, s):
    names = {"s": s, "fem": fem, "nan": np.nan, "inf": np.inf, "study": mpm.study}
    return eval(text, globals() | names)


# text of an input → what is done with the scene, and what the message has
MORE = {
    text: (functools.partial(evaluated, text), re.escape(words))
    for text, words in (OF_BODIES | OF_KINDS | OF_PROBLEMS).items()
}
