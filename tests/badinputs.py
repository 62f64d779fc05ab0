"""What new users get wrong: every entry must end in a dolfinmpm error that says what to do."""

from __future__ import annotations

import functools

import numpy as np
import ufl
from dolfinx import fem, mesh
from moreinputs import MORE
from mpi4py import MPI
from rawinputs import RAW

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


# name → what is done with the scene, and what the message has
BAD = {
    # -- spaces
    "space: shape a number": (lambda s: mpm.Space(s.grid, shape=2), r"shape = 2 .*\(2,\) for a v"),
    "space: shape a word": (lambda s: mpm.Space(s.grid, shape="2"), "shape = '2' must be a tuple"),
    "space: shape of floats": (lambda s: mpm.Space(s.grid, shape=(2.0,)), r"shape\[0\] = 2\.0"),
    "space: shape of zero": (lambda s: mpm.Space(s.grid, shape=(0,)), r"shape\[0\] = 0 .* least 1"),
    "space: negative shape": (lambda s: mpm.Space(s.grid, shape=(-1,)), r"shape\[0\] = -1"),
    "space: degree": (lambda s: mpm.Space(s.grid, 2), 'basis = 2 must be one of "linear"'),
    "space: basis a list": (lambda s: mpm.Space(s.grid, ["linear"]), "basis = .* must be one of"),
    "space: no basis": (lambda s: mpm.Space(s.grid, None), "basis = None must be one of"),
    "space: near miss": (lambda s: mpm.Space(s.grid, "bspline4"), 'did you mean "bspline'),
    "space: DOLFINx's way": (lambda s: mpm.Space(s.grid, "Lagrange", shape=1), '"linear", "gimp"'),
    "space: float32": (lambda s: mpm.Space(s.single), "float32 .*dtype=np.float64"),
    "space: of points": (lambda s: mpm.Space(s.points), "MaterialPoints must be a .*Mesh"),
    "space: of a space": (lambda s: mpm.Space(s.lagrange), "give the mesh of it"),
    "space: averaged a word": (lambda s: mpm.Space(s.grid, "bspline2", averaged="no"), "True or F"),
    # -- conditions
    "fixed: a list": (lambda s: mpm.fixed(s.V, ["left", "right"]), "places one by one"),
    "fixed: a number": (lambda s: mpm.fixed(s.V, 3), "3 is no place"),
    "fixed: no such side": (lambda s: mpm.fixed(s.V, "north"), '"bottom", "top"; or a function'),
    "fixed: on an increment": (lambda s: mpm.fixed(s.u, "left"), "must be a dolfinmpm.Space"),
    "fixed: on DOLFINx's": (lambda s: mpm.fixed(s.lagrange, "left"), "must be a dolfinmpm.Space"),
    "rollers: a function": (lambda s: mpm.rollers(s.V, lambda x: x[0] < 1), r"mpm\.prescribed"),
    "rollers: of a scalar": (lambda s: mpm.rollers(s.S, "left"), r"shape \(\), not \(2,\)"),
    "rollers: 3D side": (lambda s: mpm.rollers(s.V, "front"), "side = 'front' must be one of"),
    "prescribed: component a float": (
        lambda s: mpm.prescribed(s.V, "left", 0.0),
        "component = 0.0",
    ),
    "prescribed: component a word": (lambda s: mpm.prescribed(s.V, "left", "x"), "component = 'x'"),
    "prescribed: component 2": (lambda s: mpm.prescribed(s.V, "left", 2), "must be in 0 ... 1"),
    "prescribed: component -1": (lambda s: mpm.prescribed(s.V, "left", -1), "at least 0"),
    "prescribed: nan": (
        lambda s: mpm.prescribed(s.V, "left", 0, increment=np.nan),
        "'left' = nan must be f",
    ),
    "prescribed: a word": (
        lambda s: mpm.prescribed(s.V, "left", 0, increment="0.1"),
        "must be a number",
    ),
    "prescribed: nothing": (
        lambda s: mpm.prescribed(s.V, "left", 0, increment=None),
        "must be a number",
    ),
    "prescribed: a vector": (
        lambda s: mpm.prescribed(s.V, "left", 0, increment=(0.0, 1.0)),
        "its own condition",
    ),
    "prescribed: a vector constant": (
        lambda s: mpm.prescribed(s.V, "left", 0, increment=s.g),
        "a scalar constant",
    ),
    "prescribed: a function": (
        lambda s: mpm.prescribed(s.V, "left", 0, increment=s.u),
        "UFL expression",
    ),
    "prescribed: UFL": (
        lambda s: mpm.prescribed(s.V, "left", 0, increment=2 * s.g[0]),
        "UFL expression",
    ),
    "prescribed: words": (
        lambda s: mpm.prescribed(s.V, lambda x: x[0] >= 0, 0, increment=lambda x: "a"),
        "should return numbers of shape .* got 'a'",
    ),
    "prescribed: no such coordinate": (
        lambda s: mpm.prescribed(s.V, lambda x: x[0] >= 0, 0, increment=lambda x: x[2]),
        r"IndexError: .*shape \(2, \d+\), one row per coordinate",
    ),
    "prescribed: nan somewhere": (
        lambda s: mpm.prescribed(
            s.V, lambda x: x[0] >= 0, 0, increment=lambda x: np.where(x[0] > 1, np.nan, 0.0)
        ),
        r"is nan at the node at \[",
    ),
    "where: numbers": (lambda s: mpm.fixed(s.V, lambda x: x[0]), "booleans .* got float64"),
    "where: nothing": (lambda s: mpm.fixed(s.V, lambda x: None), "booleans .* got object"),
    "where: one for all": (lambda s: mpm.fixed(s.V, lambda x: True), r"booleans .*of shape \(\)"),
    "where: a row a coordinate": (lambda s: mpm.fixed(s.V, lambda x: x < 1), "compare coordinates"),
    "where: third row in 2D": (lambda s: mpm.fixed(s.V, lambda x: x[2] < 1), "IndexError"),
    "where: x and y": (lambda s: mpm.fixed(s.V, lambda x, y: x < 1), "called with one array"),
    "where: outside": (lambda s: mpm.fixed(s.V, lambda x: x[0] > 7), r"from \[0\. 0\.\] to \[4"),
    # -- solver: what is solved
    "points: several": (lambda s: s.solver(points=[s.points] * 2), "points = .*give one set"),
    "points: none": (lambda s: s.solver(points=None), "points = None must be a MaterialPoints"),
    "increment: a space": (lambda s: s.solver(increment=s.V), r"is a Space; .*Space\.increment"),
    "increment: test function": (lambda s: s.solver(increment=s.v), "test or trial function"),
    "increment: DOLFINx's": (lambda s: s.solver(increment=fem.Function(s.lagrange)), "Space.incr"),
    "increment: none": (lambda s: s.solver(increment=None), "increment = None is not"),
    "increment: no field": (lambda s: s.solver(increment=[]), "no function to solve for"),
    "increment: twice": (lambda s: s.solver(increment=[s.u, s.u]), "increment 2 of 2 is there tw"),
    "increment: other grid": (lambda s: s.solver(increment=s.W.increment), "another grid"),
    "increment: a word": (lambda s: s.solver(increment="u"), "increment = 'u' is not"),
    "increment: by name": (lambda s: s.solver(increment={"u": s.u}), "a dict is not the increment"),
    "bcs: one condition": (lambda s: s.solver(bcs=s.bcs[0]), "a Condition must be a list"),
    "bcs: lists in a list": (lambda s: s.solver(bcs=[s.bcs, s.bcs]), r"join them with \+"),
    "bcs: none": (lambda s: s.solver(bcs=None), "bcs = None must be a list"),
    "bcs: a side": (lambda s: s.solver(bcs="left"), "bcs = 'left' must be a list"),
    "bcs: sides": (lambda s: s.solver(bcs=["left"]), "bcs holds 'left'"),
    "bcs: DOLFINx's": (lambda s: s.solver(bcs=[s.dirichlet]), "DirichletBC, .* use mpm.fixed"),
    "bcs: DOLFINx's alone": (lambda s: s.solver(bcs=s.dirichlet), "must be a list of conditions"),
    "bcs: other space": (lambda s: s.solver(bcs=mpm.fixed(s.W, "left")), "does not solve for"),
    # -- solver: forms
    "form: swapped": (lambda s: s.solver(form=s.u, increment=s.F), "increment = a Form is not"),
    "form: expression": (lambda s: s.solver(form=ufl.inner(s.u, s.v)), r"\* points\.dX"),
    "form: zero": (lambda s: s.solver(form=0), "must be a UFL form, got 0"),
    "form: empty": (lambda s: s.solver(form=ufl.Form([])), "no terms; begin with mpm.momentum"),
    "form: a list": (lambda s: s.solver(form=[s.F]), "must be a UFL form, got a list"),
    "form: equation": (lambda s: s.solver(form=s.F == 0), "give the residual"),
    "form: compiled": (
        lambda s: s.solver(form=fem.form(ufl.inner(s.u, s.v) * ufl.dx)),
        "give the UFL form",
    ),
    "form: trial function": (
        lambda s: s.solver(form=s.add(ufl.inner(ufl.TrialFunction(s.lagrange), s.v) * s.points.dX)),
        "contains a TrialFunction; write Space.increment",
    ),
    "form: test function of another space": (
        lambda s: s.solver(form=s.add(s.S.test * s.points.dX)),
        "use Space.test",
    ),
    "form: not linear": (
        lambda s: s.solver(form=s.add(ufl.inner(s.u, s.u) * s.points.dX)),
        r"ufl\.derivative",
    ),
    "form: loads alone": (
        lambda s: s.solver(form=-ufl.inner(s.g, s.v) * s.points.dX),
        "add internal forces",
    ),
    "form: a field without a term": (
        lambda s: s.solver(increment=[s.u, s.S.increment]),
        "test function of field 2 of 2",
    ),
    "form: unrestricted": (
        lambda s: s.solver(form=s.add(ufl.inner(s.u, s.v) * s.points.dS)),
        r"v\('\+'\), ufl\.jump",
    ),
    "form: half restricted": (
        lambda s: s.solver(form=s.add(ufl.inner(ufl.jump(s.u), s.v) * s.points.dS)),
        "inner facets",
    ),
    "form: restricted twice": (
        lambda s: s.solver(form=s.add(ufl.inner(s.u("+")("-"), s.v("+")) * s.points.dS)),
        "twice",
    ),
    "form: restricted at points": (
        lambda s: s.solver(form=s.add(ufl.inner(s.u("+"), s.v("+")) * s.points.dX)),
        "one side of a facet, but its measure is over points",
    ),
    "form: constant without value": (
        lambda s: s.solver(form=s.add(ufl.inner(ufl.Constant(s.grid, (2,)), s.v) * s.points.dX)),
        r"has no value; use dolfinx\.fem\.Constant",
    ),
    # -- solver: numbers and words
    "tolerance: 0": (lambda s: s.solver(tolerance=0), "tolerance = 0 must be above 0 and below 1"),
    "tolerance: a word": (lambda s: s.solver(tolerance="1e-9"), "tolerance = '1e-9' must be a num"),
    "tolerance: true": (lambda s: s.solver(tolerance=True), "tolerance = True must be a number"),
    "tolerance: nan": (lambda s: s.solver(tolerance=np.nan), "tolerance = nan must be above 0"),
    "tolerance: none": (lambda s: s.solver(tolerance=None), "tolerance = None must be a number"),
    "tolerance: complex": (lambda s: s.solver(tolerance=1e-9j), "must be a number"),
    "max_iterations: a word": (lambda s: s.solver(max_iterations="20"), "'20' must be a whole"),
    "max_iterations: 2.5": (lambda s: s.solver(max_iterations=2.5), "2.5 must be a whole number"),
    "max_iterations: nan": (lambda s: s.solver(max_iterations=np.nan), "nan must be a whole"),
    "max_iterations: true": (lambda s: s.solver(max_iterations=True), "True must be a whole"),
    "max_iterations: 0": (lambda s: s.solver(max_iterations=0), "at least 1"),
    "max_halvings: -1": (lambda s: s.solver(max_halvings=-1), "max_halvings = -1 .* at least 0"),
    "max_halvings: none": (lambda s: s.solver(max_halvings=None), "None must be a whole number"),
    "updates: no such field": (lambda s: s.solver(updates={"foo": s.g}), r"points\.add_field"),
    "updates: a number": (lambda s: s.solver(updates={"density": 3.0}), "'density' to 3.0"),
    "updates: an array": (lambda s: s.solver(updates={"density": np.ones(3)}), "be a UFL express"),
    "updates: a function": (lambda s: s.solver(updates={"density": len}), "be a UFL expression"),
    "updates: a list": (lambda s: s.solver(updates=["density"]), "must be a dictionary"),
    "updates: shape": (lambda s: s.solver(updates={"density": s.g}), "has shape .* at a point"),
    "updates: id": (lambda s: s.solver(updates={"id": s.c}), "'id', which the solver itself keeps"),
    "updates: positions": (lambda s: s.solver(updates={"x": s.g}), "choose another field"),
    "updates: test function": (lambda s: s.solver(updates={"density": s.v[0]}), "test function"),
    "updates: by field": (lambda s: s.solver(updates={s.points.density: s.c}), "no field of the p"),
    "stabilisation: none": (lambda s: s.solver(stabilisation=None), '"none" is no stabilisation'),
    "stabilisation: a number": (lambda s: s.solver(stabilisation=1.0), 'word such as "ghost"'),
    "stabilisation: a list": (lambda s: s.solver(stabilisation=["goo"]), "must be one of"),
    "stabilisation: too many": (
        lambda s: s.solver(stabilisation=["ghost", "none"]),
        "2 entries for 1 fields",
    ),
    "stabilisation: a form": (lambda s: s.solver(stabilisation=s.F), "add it to the weak form"),
    "stabilisation: a class": (lambda s: s.solver(stabilisation=mpm.Stabilisation), "a word such"),
    "stabilisation: near miss": (lambda s: s.solver(stabilisation="ghosts"), 'mean "ghost"'),
    "stabilisation: negative E": (
        lambda s: s.solver(stabilisation=mpm.Stabilisation("ghost", E=-1.0)),
        "E = -1 Pa must be ab",
    ),
    "stabilisation: E a word": (
        lambda s: s.solver(stabilisation=mpm.Stabilisation("ghost", E="1")),
        "must be a number",
    ),
    "stabilisation: nu": (
        lambda s: s.solver(stabilisation=mpm.Stabilisation("soft", E=1.0, nu=0.5)),
        "nu = 0.5",
    ),
    "stabilisation: eta": (
        lambda s: s.solver(stabilisation=mpm.Stabilisation("soft", eta=-1)),
        "eta = -1 must be abo",
    ),
    "stabilisation: scaling": (
        lambda s: s.solver(stabilisation=mpm.Stabilisation("ghost", scaling="h")),
        '"literal"',
    ),
    "prolongation: a number": (lambda s: s.solver(prolongation=3), "prolongation = 3"),
    "options: KSP": (lambda s: s.solver(petsc_options={"ksp_type": "foo"}), "ksp_type = 'foo', wh"),
    "options: PC": (lambda s: s.solver(petsc_options={"pc_type": "foo"}), "pc_type = 'foo', which"),
    "options: SNES": (lambda s: s.solver(petsc_options={"snes_type": "foo"}), "snes_type = 'foo'"),
    "options: line search": (
        lambda s: s.solver(petsc_options={"ksp_type": "cg", "snes_linesearch_type": "foo"}),
        "snes_linesearch_type = 'foo'",
    ),
    "options: package": (
        lambda s: s.solver(petsc_options={"pc_factor_mat_solver_type": "foo"}),
        "built without",
    ),
    "options: dash": (lambda s: s.solver(petsc_options={"-ksp_type": "cg"}), "without a dash"),
    "options: prefix": (lambda s: s.solver(petsc_options={"mpm_ksp_type": "cg"}), "leave the pref"),
    "options: a word": (lambda s: s.solver(petsc_options="ksp_type cg"), "must be a dictionary"),
    "options: nested": (lambda s: s.solver(petsc_options={"ksp": {"type": 1}}), "values are words"),
    "options: numbers": (lambda s: s.solver(petsc_options={1: "a"}), "petsc_options names 1"),
    "options: prefix a number": (lambda s: s.solver(options_prefix=3), "options_prefix = 3"),
    # -- arc length
    "path: no load": (lambda s: s.path(load=None), "must be one or several dolfinx.fem.Constant"),
    "path: load a number": (lambda s: s.path(load=1.0), "must be one or several"),
    "path: load a function": (lambda s: s.path(load=s.u), "must be one or several"),
    "path: length 0": (lambda s: s.path(length=0), "length = 0 must be finite and not zero"),
    "path: length a word": (lambda s: s.path(length="1"), "length = '1' must be a number"),
    "path: first a word": (lambda s: s.path(first="1"), "first = '1' must be a number"),
    "path: first 0": (lambda s: s.path(first=0.0), "first = 0 must be"),
    "path: control": (lambda s: s.path(control="spheric"), "control = 'spheric' must be \"spher"),
    "path: control a number": (lambda s: s.path(control=1), "control = 1 must be"),
    "path: iterations": (lambda s: s.path(target_iterations=0), "target_iterations = 0"),
    "path: iterations a word": (lambda s: s.path(target_iterations="5"), "must be a whole number"),
    "path: factor": (lambda s: s.path(factor="1"), "factor = '1' must be a number"),
    "path: factor nan": (lambda s: s.path(factor=np.nan), "factor = nan must be finite"),
    "path: max_length": (lambda s: s.path(max_length=np.nan), "max_length = nan"),
    "path: a space": (lambda s: s.path(increment=s.V), r"give its function, Space\.increment"),
    "path: no field": (lambda s: s.path(increment=[]), "no function to solve for"),
    "path: points": (lambda s: s.path(points=[s.points]), "give one set"),
    "path: one condition": (lambda s: s.path(bcs=s.bcs[0]), "must be a list of conditions"),
    "path: scalar": (
        lambda s: s.path(increment=s.S.increment, bcs=()),
        "displacement of 2 components",
    ),
    "path: driven": (
        lambda s: s.path(bcs=mpm.prescribed(s.V, "left", 0, increment=0.1)),
        "only zero ones may be",
    ),
    # -- steps in time
    "motion: mass": (lambda s: s.motion(mass="x"), "mass = 'x' must be one of \"consistent\""),
    "motion: mass a number": (lambda s: s.motion(mass=1.0), "mass = 1.0 must be one of"),
    "motion: mapping": (lambda s: s.motion(mapping="y"), "mapping = 'y' must be one of \"pic\""),
    "motion: mapping a near miss": (lambda s: s.motion(mapping="flipp"), 'did you mean "flip"'),
    "motion: mapping a number": (
        lambda s: s.motion(mapping=1),
        "mapping = 1 must be a dolfinmpm.M",
    ),
    "motion: mapping of a lumped mass": (
        lambda s: s.motion(mapping="apic"),
        'mapping = "apic" puts back what a lumped mass smears; .* give mass="lumped"',
    ),
    "mapping: share": (
        lambda s: mpm.Mapping("flip", share=2.0),
        "share = 2 must be at least 0 and",
    ),
    "mapping: order": (lambda s: mpm.Mapping("xpic", order=0), "order = 0 must be a whole number"),
    "mapping: order a float": (
        lambda s: mpm.Mapping("xpic", order=2.0),
        "order = 2.0 must be a wh",
    ),
    "motion: beta": (lambda s: s.motion(beta=0.0), "beta = 0 must be above 0"),
    "motion: gamma a word": (lambda s: s.motion(gamma="1/2"), "gamma = '1/2' must be a number"),
    "motion: ghost_mass": (
        lambda s: s.motion(ghost_mass=-1.0),
        "ghost_mass = -1 must be at least 0",
    ),
    "motion: ghost_mass of a lumped mass": (
        lambda s: s.motion(mass="lumped", ghost_mass=0.25),
        'ghost_mass = 0.25 is of a consistent mass, .* give mass="consistent"',
    ),
    "motion: error": (lambda s: s.motion(error=0.0), "error = 0 must be above 0"),
    "motion: rho_inf": (
        lambda s: s.alpha(rho_inf=2),
        "rho_inf = 2 must be at least 0 and at most 1",
    ),
    "motion: rho_inf negative": (
        lambda s: s.alpha(rho_inf=-0.1),
        "rho_inf = -0.1 must be at least",
    ),
    "motion: rho_inf a word": (lambda s: s.alpha(rho_inf="1"), "rho_inf = '1' must be a number"),
    "motion: total Lagrangian": (lambda s: s.total(), 'configuration="updated"\\), got "total"'),
    "motion: a scalar": (
        lambda s: s.motion(increment=s.S.increment, bcs=()),
        "must be a displacement of 2 components, got shape ",
    ),
    "motion: a space": (lambda s: s.motion(increment=s.V), r"is a Space; .*Space\.increment"),
    "motion: points": (lambda s: s.motion(points=None), "points = None must be a MaterialPoints"),
    "motion: one condition": (lambda s: s.motion(bcs=s.bcs[0]), "must be a list of conditions"),
    "motion: no such option": (lambda s: s.motion(stabilisation="gost"), "'gost' must be one of"),
    "motion: no time": (lambda s: s.motion().step(), r"step\(t\) needs the time to go to \(s\)"),
    "motion: time 0": (lambda s: s.motion().step(0.0), "t = 0 s must be later than .* state, 0 s"),
    "motion: time negative": (lambda s: s.motion().step(-0.1), "t = -0.1 s must be later"),
    "motion: time nan": (lambda s: s.motion().step(np.nan), "t = nan s must be finite"),
    "motion: time a word": (lambda s: s.motion().step("1"), "t = '1' must be a number"),
    "motion: automatic": (
        lambda s: [s.motion().step(t) for t in mpm.times(1.0)],
        "give the problem error=1e-3, or times a dt",
    ),
    "times: dt negative": (lambda s: list(mpm.times(1.0, dt=-0.1)), "dt = -0.1 s must be above 0"),
    "times: dt a word": (lambda s: list(mpm.times(1.0, dt="a")), "dt = 'a' must be a time in s or"),
    "times: end": (lambda s: list(mpm.times(-1.0, dt=0.1)), "end = -1 s must be above 0"),
    # -- loads that are no numbers
    "load: nan": (
        lambda s: s.nan_load(),
        r"constant gravity = \[ 0\. nan\] is not finite in the t",
    ),
    "load: inf": (
        lambda s: s.nan_unnamed(),
        r"constant c_\d+ = \[inf  0\.\] is not finite in the t",
    ),
    "load: nan function": (
        lambda s: s.nan_function(),
        "function pore_pressure is not finite in th",
    ),
    "load: nan increment": (lambda s: s.nan_increment(), "prescribed at 'bottom' is nan"),
    # -- internal forces
    "momentum: law a number": (lambda s: s.momentum(law=3.0), r"law = 3\.0 .*Hencky\(E, nu\)"),
    "momentum: law a class": (lambda s: s.momentum(law=mpm.materials.Hencky), "law = a type"),
    "momentum: no points": (lambda s: s.momentum(points=None), "points = None must be a MaterialP"),
    "momentum: a list of points": (lambda s: s.momentum(points=[s.points]), "give one set"),
    "momentum: u a space": (lambda s: s.momentum(u=s.V), r"u = a Space .* Space\.increment"),
    "momentum: u a word": (lambda s: s.momentum(u="u"), r"u = 'u' must be the increment of a disp"),
    "momentum: u none": (lambda s: s.momentum(u=None), "u = None must be the increment"),
    "momentum: u a list": (lambda s: s.momentum(u=[s.u]), "must be the increment of a displ"),
    "momentum: u a test function": (lambda s: s.momentum(u=s.v), "u = a test function must be"),
    "momentum: u a constant": (lambda s: s.momentum(u=s.g), "u = a Constant must be the increment"),
    "momentum: u a scalar": (
        lambda s: s.momentum(u=s.S.increment),
        r"u has the shape \(\) and must",
    ),
    "momentum: u elsewhere": (lambda s: s.momentum(u=s.W.increment), "u lives on another grid"),
    "momentum: v a space": (lambda s: s.momentum(v=s.V), r"v = a Space must be .*Space\.test"),
    "momentum: v a number": (lambda s: s.momentum(v=1.0), r"v = 1\.0 must be the test function"),
    "momentum: v the increment": (lambda s: s.momentum(v=s.u), "v = a Function must be the test"),
    "momentum: v a trial function": (
        lambda s: s.momentum(v=ufl.TrialFunction(s.V.function_space)),
        "v = a trial function must be the test",
    ),
    "momentum: v elsewhere": (lambda s: s.momentum(v=s.W.test), "v lives on another grid"),
    "momentum: strain a list": (lambda s: s.momentum(strain=["large"]), 'must be one of "large"'),
    "momentum: strain": (lambda s: s.momentum(strain="larg"), 'did you mean "large"'),
    "momentum: fbar a word": (
        lambda s: s.momentum(fbar="yes"),
        "fbar = 'yes' must be True, False or 'centres'",
    ),
    "momentum: fbar a number": (lambda s: s.momentum(fbar=1), "fbar = 1 must be True or False"),
    "momentum: tag a space": (lambda s: s.momentum(tag=s.V), "tag = a Space must be a whole"),
    "momentum: swapped": (
        lambda s: mpm.momentum(s.points, s.law, s.u, s.v),
        "points = a Hencky must be a MaterialPoints",
    ),
    "stress: law a word": (lambda s: mpm.stress("Hencky", s.points, s.u), "law = 'Hencky' has no"),
    "stress: points": (lambda s: mpm.stress(s.law, s.grid, s.u), "points = a Mesh must be a Mate"),
    "stress: u a space": (lambda s: mpm.stress(s.law, s.points, s.V), r"Space\.increment"),
    "stress: u a test function": (lambda s: mpm.stress(s.law, s.points, s.v), "u = a test functi"),
    "stress: fbar an array": (
        lambda s: mpm.stress(s.law, s.points, s.u, fbar=np.ones(2)),
        "must be True or False",
    ),
    "set_stress: swapped": (
        lambda s: mpm.set_stress(s.points, s.law, np.eye(3)),
        "points = a Hencky must be",
    ),
    "set_stress: law none": (lambda s: s.set_stress(law=None), "law = None has no kernel"),
    "set_stress: strain": (lambda s: s.set_stress(strain=["large"]), "strain = .* must be one of"),
    "set_stress: a word": (lambda s: s.set_stress("weight"), r"stress = 'weight', expected \(3, 3"),
    "set_stress: none": (lambda s: s.set_stress(None), "stress has the shape|stress = None"),
    "set_stress: a number": (lambda s: s.set_stress(3.0), r"stress has the shape \(\), expected"),
    "set_stress: ragged": (lambda s: s.set_stress([[1.0], [2.0, 3.0]]), r"expected \(3, 3\)"),
    "set_stress: nan": (lambda s: s.set_stress(np.full((3, 3), np.nan)), "must be finite"),
    "set_stress: a function of words": (
        lambda s: s.set_stress(lambda x: "a"),
        "stress .* should return numbers of shape .* got 'a'",
    ),
    "set_stress: third row": (lambda s: s.set_stress(lambda x: x[2]), "failed with IndexError"),
    "geostatic: a word": (lambda s: mpm.geostatic_stress("1", 1.0, 0.5), "surface = '1' must be"),
    "geostatic: none": (lambda s: mpm.geostatic_stress(1.0, None, 0.5), "weight = None must be a"),
    "geostatic: nan": (lambda s: mpm.geostatic_stress(1.0, 1.0, np.nan), "K0 = nan must be finite"),
    "geostatic: a function of words": (
        lambda s: s.set_stress(mpm.geostatic_stress(1.0, lambda x: "a", 0.5)),
        "weight should return numbers",
    ),
    # -- penalties
    "ghost: gamma a word": (lambda s: s.ghost(gamma="1"), "gamma = '1' must be a number"),
    "ghost: gamma none": (lambda s: s.ghost(gamma=None), "gamma = None must be a number"),
    "ghost: gamma nan": (lambda s: s.ghost(gamma=np.nan), "gamma = nan must be finite"),
    "ghost: gamma inf": (lambda s: s.ghost(gamma=np.inf), "gamma = inf must be finite"),
    "ghost: gamma true": (lambda s: s.ghost(gamma=True), "gamma = True must be a number"),
    "ghost: gamma a list": (lambda s: s.ghost(gamma=[1.0]), r"gamma = \[1\.0\] must be a number"),
    "ghost: gamma an array": (lambda s: s.ghost(gamma=-np.ones(2)), "must be a number"),
    "ghost: gamma a vector": (lambda s: s.ghost(gamma=s.g), "must be a number or a scalar of UFL"),
    "ghost: gamma a function": (lambda s: s.ghost(gamma=len), "must be a number"),
    "ghost: gamma elsewhere": (
        lambda s: s.ghost(gamma=fem.Constant(s.other, 1.0)),
        "gamma lives on another grid",
    ),
    "ghost: order a word": (lambda s: s.ghost(order="1"), "order = '1' must be a whole number"),
    "ghost: order true": (lambda s: s.ghost(order=True), "order = True must be a whole number"),
    "ghost: order 1.5": (lambda s: s.ghost(order=1.5), r"order = 1\.5 must be a whole number"),
    "ghost: scaling an array": (lambda s: s.ghost(scaling=np.ones(2)), "scaling = .* must be one"),
    "ghost: points": (lambda s: s.ghost(points=[s.points]), "give one set"),
    "ghost: u a space": (lambda s: s.ghost(u=s.V), r"u = a Space must be .* Space\.increment"),
    "ghost: u a test function": (lambda s: s.ghost(u=s.v), "u = a test function must be"),
    "ghost: u elsewhere": (lambda s: s.ghost(u=s.W.increment), "u lives on another grid"),
    "ghost: v of another field": (lambda s: s.ghost(v=s.S.test), r"v has the shape \(\) and must"),
    "ghost: v none": (lambda s: s.ghost(v=None), r"v = None must be the test function"),
    "soft: E a word": (lambda s: s.soft(E="1"), "E = '1' must be a number"),
    "soft: E negative": (lambda s: s.soft(E=-1.0), "E = -1 Pa must be above 0"),
    "soft: nu": (lambda s: s.soft(nu=0.5), r"nu = 0\.5 must be above -1 and below 0\.5"),
    "soft: nu none": (lambda s: s.soft(nu=None), "nu = None must be a number"),
    "soft: eta true": (lambda s: s.soft(eta=True), "eta = True must be a number"),
    "soft: eta a list": (lambda s: s.soft(eta=[1e-3]), "must be a number"),
    "soft: eta zero": (lambda s: s.soft(eta=0.0), "eta = 0 must be above 0"),
    "soft: u a space": (lambda s: s.soft(u=s.V), r"Space\.increment"),
    "soft: v the increment": (lambda s: s.soft(v=s.u), r"v = a Function .* Space\.test"),
    "soft: points none": (lambda s: s.soft(points=None), "points = None must be"),
    "stabilisation: factor a word": (lambda s: mpm.Stabilisation("ghost", factor="1"), "a number"),
    "stabilisation: factor": (
        lambda s: mpm.Stabilisation("ghost", factor=-1),
        "factor = -1 must be",
    ),
    "stabilisation: threshold a word": (
        lambda s: mpm.Stabilisation("aggregation", threshold="1"),
        "threshold = '1' must be a number",
    ),
    "stabilisation: threshold": (
        lambda s: mpm.Stabilisation("aggregation", threshold=1.5),
        r"threshold = 1\.5 must be in \(0, 1\]",
    ),
    "stabilisation: kind a list": (lambda s: mpm.Stabilisation(["ghost"]), "must be one of"),
    # -- what Python, NumPy or UFL would tell of
    **RAW,
    **MORE,
    # -- ParaView
    "paraview: no path": (lambda s: mpm.ParaView(None, s.points), "path = None must be a path"),
    "paraview: a number": (lambda s: mpm.ParaView(3, s.points), "path = 3 must be a path"),
    "paraview: ending": (lambda s: mpm.ParaView("a.vtu", s.points), r"ends in \.pvd, got 'a\.vtu'"),
    "paraview: points": (lambda s: mpm.ParaView("a.pvd", [s.points]), "give one set"),
    "paraview: a grid": (lambda s: mpm.ParaView("a.pvd", s.grid), "points = a Mesh must be"),
    "paraview: swapped": (
        lambda s: mpm.ParaView(s.points, "a.pvd"),
        "path = a MaterialPoints must",
    ),
    "paraview: fields a number": (
        lambda s: mpm.ParaView("a.pvd", s.points, fields=3),
        "fields = 3 must be names",
    ),
    "paraview: fields of UFL": (
        lambda s: mpm.ParaView("a.pvd", s.points, fields=[s.points.stress]),
        "must be names of the points' fields",
    ),
    "paraview: no such field": (
        lambda s: mpm.ParaView("a.pvd", s.points, fields=["foo"]),
        "no field 'foo' to write; they have",
    ),
    "paraview: a space": (
        lambda s: mpm.ParaView("a.pvd", s.points, increments=s.V),
        r"increments = a Space must be .*\[Space\.increment\]",
    ),
    "paraview: a test function": (
        lambda s: mpm.ParaView("a.pvd", s.points, increments=[s.v]),
        "must be functions on the grid",
    ),
    "paraview: increments none": (
        lambda s: mpm.ParaView("a.pvd", s.points, increments=None),
        "increments = None must be functions",
    ),
    "paraview: elsewhere": (
        lambda s: mpm.ParaView("a.pvd", s.points, increments=s.W.increment),
        "lives on another grid",
    ),
    "paraview: active": (
        lambda s: mpm.ParaView("a.pvd", s.points, active="yes"),
        "active = 'yes' must be True or False",
    ),
    # -- surfaces and footings
    "surface: a side": (
        lambda s: mpm.Surface(s.points, "top", (0, 1)),
        "must be a function of the",
    ),
    "surface: no normal": (
        lambda s: mpm.Surface(s.points, len, None),
        "normal = None must be an a",
    ),
    "surface: normal a word": (lambda s: mpm.Surface(s.points, len, "up"), "normal = 'up' must be"),
    "surface: of a grid": (lambda s: mpm.Surface(s.grid, len, (0, 1)), "what mpm.fill returns"),
    "surface: name": (
        lambda s: mpm.Surface(s.points, lambda x: x[1] > 0.99, (0, 1), name="a b"),
        "be an identifier",
    ),
    "surface: name a number": (
        lambda s: mpm.Surface(s.points, lambda x: x[1] > 0.99, (0, 1), name=3),
        "name = 3 must be",
    ),
    "surface: third row": (
        lambda s: mpm.Surface(s.points, lambda x: x[2] > 0, (0, 1)),
        "where failed with IndexError",
    ),
    "surface: arrays of words": (
        lambda s: mpm.Surface.from_arrays(s.points, "a", "b"),
        "offset = 'a' must be an array",
    ),
    "traction: a number": (lambda s: s.top.traction(3.0, s.v), "vector of 2 components"),
    "traction: nothing": (lambda s: s.top.traction(None, s.v), "traction = None must be a vector"),
    "traction: three": (lambda s: s.top.traction((1, 2, 3), s.v), "must be a vector of 2"),
    "traction: nan": (lambda s: s.top.traction((0, np.nan), s.v), r"traction\[1\] = nan"),
    "traction: a scalar constant": (lambda s: s.top.traction(s.c, s.v), "pressure acts along"),
    "traction: on a space": (lambda s: s.top.traction((1, 2), s.V), "v = a Space must be the test"),
    "traction: on the increment": (lambda s: s.top.traction((1, 2), s.u), r"Space\.test"),
    "force: a word": (lambda s: s.top.force("ab", s.v), "force = 'ab' must be a vector"),
    "pressure: a vector": (lambda s: s.top.pressure(s.g, s.u, s.v), "must be a scalar"),
    "pressure: nothing": (lambda s: s.top.pressure(None, s.u, s.v), "p = None must be a number"),
    "pressure: swapped": (lambda s: s.top.pressure(s.c, s.v, s.u), r"u = .* Space\.increment"),
    "traction: subtracted": (
        lambda s: s.solver(form=s.F - s.top.traction((0, 1), s.v)),
        r"traction on 'top' is subtracted .* write F \+=",
    ),
    "pressure: subtracted": (
        lambda s: s.solver(form=s.F - s.top.pressure(s.c, s.u, s.v)),
        "pressure on 'top' is subtracted",
    ),
    "force: subtracted, scaled": (
        lambda s: s.solver(form=s.F + 2 * -s.top.force((0, 1), s.v)),
        "force on 'top' is subtracted",
    ),
    "contact: subtracted": (
        lambda s: s.solver(form=s.F - mpm.RigidFooting(s.top, s.c, E=1.0).contact(s.u, s.v)),
        "contact of a footing on 'top' is subtracted",
    ),
    "boundary: pressure subtracted": (
        lambda s: s.solver(form=s.F - s.side.pressure(1.0, s.u, s.v)),
        r"pressure on 'side' is subtracted .* write F \+=",
    ),
    "boundary: traction subtracted": (
        lambda s: s.solver(form=s.F - 2 * s.side.traction((0.0, 1.0), s.v)),
        "traction on 'side' is subtracted",
    ),
    "ghost: subtracted": (
        lambda s: s.solver(form=s.F - s.ghost()),
        r"ghost penalty \(mpm.ghost\) is subtracted .* write F \+=",
    ),
    "dirichlet: subtracted": (
        lambda s: s.solver(form=s.F - mpm.dirichlet(s.side, s.u, s.v, law=s.law)),
        r"\(mpm.dirichlet\) at 'side' is subtracted",
    ),
    "signorini: subtracted": (
        lambda s: s.solver(form=s.F - mpm.signorini(s.wall, s.u, s.v, law=s.law)),
        r"\(mpm.signorini\) at 'right' is subtracted",
    ),
    "contact: swapped": (
        lambda s: mpm.RigidFooting(s.top, s.c, E=1.0).contact(s.v, s.u),
        "must be the increment",
    ),
    "contact: on a space": (
        lambda s: mpm.RigidFooting(s.top, s.c, E=1.0).contact(s.u, s.V),
        r"Space\.test",
    ),
    "footing: no modulus": (lambda s: mpm.RigidFooting(s.top, s.c), "needs the Young's modulus"),
    "footing: modulus a word": (
        lambda s: mpm.RigidFooting(s.top, s.c, E="1"),
        "E = '1' must be a n",
    ),
    "footing: on points": (lambda s: mpm.RigidFooting(s.points, s.c, E=1.0), r"mpm\.Surface\("),
    "footing: a number": (
        lambda s: mpm.RigidFooting(s.top, 0.1, E=1.0),
        "scalar dolfinx.fem.Const",
    ),
    "footing: nan": (
        lambda s: mpm.RigidFooting(s.top, fem.Constant(s.grid, np.nan), E=1.0),
        "nan m must be fin",
    ),
    "footing: other mesh": (
        lambda s: mpm.RigidFooting(s.top, fem.Constant(s.other, 0.0), E=1.0),
        "of another mesh",
    ),
    # -- tags, other bodies' pieces
    "tags: a load of nobody": (
        lambda s: s.solver(form=s.add(s.v[0] * s.points.dX(9))).step(),
        r"is for points with tag=9, and no point has it: the points have the tags 0\. Give",
    ),
    "tags: a contact of nobody": (
        lambda s: s.solver(form=s.add(mpm.contact(s.tool, s.points, s.u, s.v, tag=7))).step(),
        "the contact with 'tool' is for points with tag=7, and no point has it",
    ),
    "tags: a law of nobody": (
        lambda s: s.solver(form=s.momentum(tag=3) - s.v[0] * s.points.dX(3)).step(),
        "no point has a law: the laws are for tag=3",
    ),
    "tags: a stress of nobody": (
        lambda s: s.set_stress(np.eye(3), tag=5),
        "tag = 5: no point has it",
    ),
    "points: the same place twice filled": (
        lambda s: s.points + mpm.fill(s.grid, mpm.Box((0.5, 0), (2, 1)), 3, 1.0),
        "fill the cell at .* bodies overlap, or volumes are too large",
    ),
    "points: stress without a state": (
        lambda s: s.stressed(),
        "only from the deformation gradient",
    ),
    "ghost: of other points": (
        lambda s: s.solver(form=s.F + s.ghost(points=s.fill())),
        "cells or facets of other material points",
    ),
    "boundary: inside out": (
        lambda s: mpm.Boundary.from_polygon(s.points, [(2, 1), (2, 0)], closed=False),
        "is inside out: the body is where its normals point",
    ),
    "axisymmetric: grad": (lambda s: s.rings(), r"hoop term u_r/r .* mpm\.gradient\(points, u\)"),
    "times: several and dt": (
        lambda s: list(mpm.times([1, 2], dt=0.1)),
        r"dt = 0\.1 is of a single time",
    ),
    "absorbing: swapped": (
        lambda s: mpm.absorbing(s.V, "left", density=1.0, p_speed=1.0, s_speed=2.0),
        "s_speed = 2 m/s must be at most p_speed = 1",
    ),
    "rates: no time": (
        lambda s: s.solver(form=s.F + ufl.inner(s.u, s.v) / s.points.dt * s.points.dX).step(),
        "rates over points.dt, .* QuasiStatic knows no time",
    ),
    "layer: lighter when wet": (
        lambda s: mpm.Layer(0.0, 18e3, 0.5, saturated_unit_weight=16e3),
        "saturated_unit_weight = 16000 N/m³ must be at least",
    ),
    "layer: swapped": (lambda s: mpm.Layer(0.0, 0.5, 18e3), "K0 = 18000 .* in this order"),
    "orders: lengths": (
        lambda s: mpm.study.observed_orders([1, 2, 3], [1, 2]),
        "give one error for each size",
    ),
    # -- points
    "fill: density a word": (lambda s: s.fill(density="1000"), "density = '1000' must be a number"),
    "fill: density none": (lambda s: s.fill(density=None), r"density = None must be .*\(kg/m\^d\)"),
    "fill: density true": (lambda s: s.fill(density=True), "density = True must be a number"),
    "fill: density of words": (
        lambda s: s.fill(density=lambda x: "a"),
        "density should return numbers of shape .* got 'a'",
    ),
    "fill: density third row": (
        lambda s: s.fill(density=lambda x: x[2]),
        "density failed with IndexError",
    ),
    "fill: density by rows": (
        lambda s: s.fill(density=lambda x: x.T),
        r"density should return numbers of shape .* got shape \(32, 2\)",
    ),
    "fill: exact a word": (lambda s: s.fill(exact="no"), "exact = 'no' must be True or False"),
    "points: first value of words": (
        lambda s: s.points.add_field("wet", (), "", lambda x: "a"),
        "first value of field 'wet' should return numbers .* got 'a'",
    ),
    "points: first value a word": (
        lambda s: s.points.add_field("wet", (), "", "dry"),
        "field 'wet' has numbers of shape .* first value is 'dry'",
    ),
    # -- laws
    "law: E a word": (
        lambda s: mpm.materials.Hencky("1e4", 0.3),
        r"E = '1e4' must be .*\(Pa\), an",
    ),
    "law: E none": (lambda s: mpm.materials.Hencky(None, 0.3), "E = None must be a number"),
    "law: E true": (lambda s: mpm.materials.Hencky(True, 0.3), "E = True must be a number"),
    "law: E complex": (lambda s: mpm.materials.Hencky(1j, 0.3), "E = 1j must be a number"),
    "law: nu a list": (lambda s: mpm.materials.NeoHookean(1.0, ["a"]), "nu = .* must be a number,"),
    "law: E of words": (
        lambda s: s.solver(form=s.momentum(law=mpm.materials.Hencky(lambda x: "a", 0.3))),
        "Hencky: E should return numbers",
    ),
    "law: E third row": (
        lambda s: s.solver(form=s.momentum(law=mpm.materials.Hencky(lambda x: x[2], 0.3))),
        "Hencky: E failed with IndexError",
    ),
    "law: fit": (
        lambda s: mpm.materials.DruckerPrager(1e4, 0.3, 1.0, 20.0, dilation_angle=0.0, fit="outer"),
        "'outer' must",
    ),
    "law: fit a list": (
        lambda s: mpm.materials.DruckerPrager(1e4, 0.3, 1.0, 20.0, dilation_angle=0.0, fit=[]),
        "must be one of",
    ),
    # -- pictures and tables
    "plot: format": (lambda s: s.plot("a.foo"), r"ends in \.png, .*Matplotlib writes .*svg"),
    "plot: no format": (lambda s: s.plot("a"), r"ends in \.png, \.pdf"),
    "plot: no path": (lambda s: s.plot(None), "path = None must be a path"),
    "plot: empty path": (lambda s: s.plot(""), "path = '' must be a path"),
    "plot: no such field": (lambda s: s.plot("a.png", "foo"), "no field 'foo' to colour by"),
    "plot: field of UFL": (lambda s: s.plot("a.png", s.points.stress), "no field 'points.stress'"),
    "plot: component": (lambda s: s.plot("a.png", "stress", component="xx"), "'xx' does not fit"),
    "plot: component out of range": (
        lambda s: s.plot("a.png", "stress", component=(5, 5)),
        "does not fit",
    ),
    "plot: component 1.5": (lambda s: s.plot("a.png", "x", component=1.5), "1.5 does not fit"),
    "plot: limits a number": (lambda s: s.plot(limits=3), "limits = 3 must be two numbers"),
    "plot: limits falling": (lambda s: s.plot(limits=(1, 0)), r"limits = \(1, 0\) must rise"),
    "plot: limits nan": (lambda s: s.plot(limits=(0, np.nan)), r"limits\[1\] = nan must be finite"),
    "plot: cut in 2D": (lambda s: s.plot(cut=("y", 0.5)), "for points in 3D"),
    "plot: cut a word": (lambda s: s.plot(cut="y"), "for points in 3D"),
    "plot: view": (lambda s: s.plot(view="all"), 'view = \'all\' must be one of "grid", "points"'),
    "plot: view a number": (lambda s: s.plot(view=3), "2 rising ranges"),
    "plot: view ragged": (lambda s: s.plot(view=((0, 1), 2)), "2 rising ranges"),
    "plot: draw": (lambda s: s.plot(draw="foo"), 'must be one of "deformed", "domains", "dots"'),
    "plot: colours": (lambda s: s.plot(cmap="viridus"), 'did you mean "viridis"'),
    "plot: size a number": (lambda s: s.plot(size=3), "size = 3 must be two numbers"),
    "plot: size negative": (lambda s: s.plot(size=(-1, 1)), "two positive numbers"),
    "plot: dpi": (lambda s: s.plot(dpi=0), "dpi = 0 must be above 0"),
    "plot: aspect": (lambda s: s.plot(max_aspect=0), "max_aspect = 0 must be at least 1"),
    "plot: aspect a word": (lambda s: s.plot(max_aspect="a"), "max_aspect = 'a' must be a number"),
    "plot: a grid": (lambda s: mpm.plot(s.grid, "a.png"), r"plot\(points, path\)"),
    "plot: nan": (lambda s: s.nan_field(), "'holes' is nan at 32 of 32 points"),
    "figure: format": (lambda s: mpm.figure("b.foo").__enter__(), r"Matplotlib writes"),
    "figure: width": (lambda s: mpm.figure("b.png", width=-1).__enter__(), "two positive numbers"),
    "figure: no path": (lambda s: mpm.figure(3).__enter__(), "path = 3 must be a path"),
    "figure: axes": (lambda s: mpm.figure("b.png", foo=3).__enter__(), "Figure.subplots"),
    "steps: 0": (lambda s: mpm.steps(0), "number of steps = 0 must be a whole number"),
    "steps: 2.5": (lambda s: mpm.steps(2.5), "2.5 must be a whole number"),
    "history: nothing": (lambda s: mpm.History().record(), "needs a number or more"),
    "history: a word": (lambda s: mpm.History().record(a="x"), "a = 'x' must be a single number"),
    "history: None": (lambda s: mpm.History().record(a=None), "a = None must be a single number"),
    "history: complex": (lambda s: mpm.History().record(a=1j), "a = 1j must be a single number"),
    "history: a vector": (lambda s: mpm.History().record(a=np.ones(3)), "under names of their own"),
    "history: ranks": (lambda s: mpm.History(3), "comm = 3 must be a Comm"),
    "history: no such name": (lambda s: mpm.History()["a"], "nothing is recorded as 'a'"),
    "history: no path": (lambda s: mpm.History().write(None), "path = None must be a path"),
    "history: format": (lambda s: mpm.History().write("a.xyz"), r"\.csv or \.json"),
}
