"""What new users get wrong: every entry must end in a dolfinmpm error that says what to do."""

from __future__ import annotations

import numpy as np
import ufl
from badforms import FORMS
from badproblems import PROBLEMS
from badscene import Scene, scene
from moreinputs import MORE
from mpi4py import MPI
from rawinputs import RAW

import dolfinmpm as mpm

__all__ = ["BAD", "Scene", "scene"]

COMM = MPI.COMM_WORLD

# name → what is done with the scene, and what the message has
BAD = {
    **PROBLEMS,
    **FORMS,
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
    "plot: field of UFL": (
        lambda s: s.plot("a.png", s.points.stress),
        "no field a PointField to colour by",
    ),
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
    "plot: dpi": (lambda s: s.plot(dpi=0), "dpi = 0 must be at least 10"),
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
    "history: an array": (lambda s: mpm.History().record(a=np.ones((3, 3))), "2 or 3 components"),
    "history: ranks": (lambda s: mpm.History(3), "comm = 3 must be a Comm"),
    "history: no such name": (lambda s: mpm.History()["a"], "nothing is recorded as 'a'"),
    "history: no path": (lambda s: mpm.History().write(None), "path = None must be a path"),
    "history: format": (lambda s: mpm.History().write("a.xyz"), r"\.csv or \.json"),
}
