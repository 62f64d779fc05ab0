"""A block, and what a script would make of it with bad inputs; the scene of `badinputs`."""

from __future__ import annotations

import functools

import numpy as np
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

import dolfinmpm as mpm

COMM = MPI.COMM_WORLD


class Scene:
    """A block on a rectangular grid, and what a script would make of it."""

    def __init__(self):
        cells = [(0, 0), (4, 2)], (8, 4), mesh.CellType.quadrilateral
        self.grid = mesh.create_rectangle(COMM, *cells)
        self.other = mesh.create_rectangle(COMM, *cells)
        self.single = mesh.create_rectangle(COMM, *cells, dtype=np.float32)
        self.points = mpm.fill(self.grid, mpm.Box((0, 0), (2, 1)), 2, 1000.0)
        self.V, self.W = mpm.Space(self.grid), mpm.Space(self.other)
        self.S = mpm.Space(self.grid, shape=())
        self.u, self.v = self.V.increment, self.V.test
        self.g = fem.Constant(self.grid, (0.0, -1.0))
        self.c = fem.Constant(self.grid, 0.0)
        self.law = mpm.materials.Hencky(1e4, 0.3)
        self.F = mpm.momentum(self.law, self.points, self.u, self.v)
        self.F -= ufl.inner(self.points.density * self.g, self.v) * self.points.dX
        self.bcs = mpm.rollers(self.V, "left") + mpm.fixed(self.V, "bottom")
        self.top = mpm.Surface(self.points, lambda x: x[1] > 0.99, (0, 1), name="top")
        self.side = mpm.Boundary.from_polygon(
            self.points, [(2, 0), (2, 1)], closed=False, name="side"
        )
        self.wall = mpm.Boundary.from_side(self.points, "right")
        self.tool = mpm.RigidBody(mpm.Disc((1.0, 1.7), 0.5), name="tool")
        self.lagrange = fem.functionspace(self.grid, ("Lagrange", 1, (2,)))
        at = fem.locate_dofs_geometrical(self.lagrange, lambda x: np.isclose(x[0], 0))
        self.dirichlet = fem.dirichletbc(np.zeros(2), at, self.lagrange)

    def add(self, integrand):
        return self.F + integrand

    def solver(self, **given):
        form, u = given.pop("form", self.F), given.pop("increment", self.u)
        points, bcs = given.pop("points", self.points), given.pop("bcs", self.bcs)
        return mpm.QuasiStatic(form, u, points, bcs, **given)

    def path(self, **given):
        form, u = given.pop("form", self.F), given.pop("increment", self.u)
        points, bcs = given.pop("points", self.points), given.pop("bcs", self.bcs)
        return mpm.ArcLength(form, u, points, bcs, **{"load": self.g, **given})

    def fill(self, **given):
        return mpm.fill(self.grid, mpm.Box((0, 0), (2, 1)), 2, **{"density": 1000.0, **given})

    def momentum(self, **given):
        return mpm.momentum(**{"law": self.law, "points": self.points, "u": self.u, "v": self.v,
                               **given})  # fmt: skip

    def ghost(self, **given):
        return mpm.ghost(**{"points": self.points, "u": self.u, "v": self.v, "gamma": 1.0, **given})

    def soft(self, **given):
        return mpm.soft(**{"points": self.points, "u": self.u, "v": self.v, "E": 1.0, "nu": 0.3,
                           "eta": 1e-3, **given})  # fmt: skip

    def set_stress(self, stress=0.0, **given):
        # points of its own, which get the law's fields
        points = mpm.fill(self.grid, mpm.Box((0, 0), (2, 1)), 2, 1000.0)
        return mpm.set_stress(**{"law": self.law, "points": points, "stress": stress, **given})

    def motion(self, rule=None, **given):
        form, u = given.pop("form", self.F), given.pop("increment", self.u)
        points, bcs = given.pop("points", self.points), given.pop("bcs", self.bcs)
        return (rule or mpm.Newmark)(form, u, points, bcs, **given)

    def total(self):
        V = mpm.Space(self.grid, configuration="total")
        F = mpm.momentum(self.law, self.points, V.increment, V.test)
        return self.motion(form=F, increment=V.increment, bcs=())

    def alpha(self, **given):
        return self.motion(mpm.GeneralisedAlpha, **given)

    def plot(self, path="picture.png", *arguments, **given):
        return mpm.plot(self.points, path, *arguments, **given)

    def stressed(self):
        points = self.fill()
        points["stress"] = -np.eye(3)
        law = mpm.materials.NeoHookean(1e4, 0.3)
        return self.solver(form=self.momentum(law=law, points=points), points=points)

    def rings(self):
        points = self.fill(axisymmetric=True)
        form = ufl.inner(ufl.grad(self.u), ufl.grad(self.v)) * points.dX
        return self.solver(form=form, points=points)

    def nan_load(self):
        g = fem.Constant(self.grid, (0.0, np.nan))
        g.name = "gravity"
        F = mpm.momentum(self.law, self.points, self.u, self.v)
        form = F - ufl.inner(self.points.density * g, self.v) * self.points.dX
        return self.solver(form=form).step()

    def nan_unnamed(self):
        F = self.F - ufl.inner(fem.Constant(self.grid, (np.inf, 0.0)), self.v) * self.points.dX
        return self.solver(form=F).step()

    def nan_function(self):
        f = fem.Function(self.S.function_space, name="pore_pressure")
        f.x.array[:] = np.nan
        return self.solver(form=self.F - f * ufl.div(self.v) * self.points.dX).step()

    def nan_increment(self):
        push = fem.Constant(self.grid, np.nan)
        return self.solver(bcs=mpm.prescribed(self.V, "bottom", 1, increment=push)).step()

    def nan_field(self):
        self.points.add_field("holes")
        self.points["holes"] = np.nan
        return self.plot("picture.png", "holes")


@functools.cache
def scene() -> Scene:
    """The scene, made once. Collective."""
    return Scene()
