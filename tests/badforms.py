"""Bad inputs to weak forms, surfaces and footings; part of `badinputs`."""

from __future__ import annotations

import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI

import dolfinmpm as mpm

COMM = MPI.COMM_WORLD

# name → what is done with the scene of `badinputs`, and what the message has
FORMS = {
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
        "fbar = 'yes' must be True, False, 'centres' or 'volumes'",
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
}
