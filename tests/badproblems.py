"""Bad inputs to spaces, conditions and problems; part of `badinputs`."""

from __future__ import annotations

import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI

import dolfinmpm as mpm

COMM = MPI.COMM_WORLD

# name → what is done with the scene of `badinputs`, and what the message has
PROBLEMS = {
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
}
