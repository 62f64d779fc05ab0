"""Remedies against small cuts, with what they need across rank borders."""

from __future__ import annotations

import ufl
from dolfinx import fem, mesh

import dolfinmpm as mpm

from .common import COMM, hencky, run


def _remedies(basis, kind_of_cell=mesh.CellType.quadrilateral):
    """A leaning body with small cuts under every remedy, and its conditioning."""
    figures = {}
    for kind in ("none", "ghost", "aggregation", "weak-aggregation", "extended", "soft"):
        grid = mesh.create_rectangle(COMM, [(0, 0), (9, 9)], (9, 9), kind_of_cell)
        points = mpm.fill(grid, mpm.Box((1.3, 0), (6.2, 5.15)), 3, 1.0)
        V = mpm.Space(grid, basis)
        g = fem.Constant(grid, (0.0, 0.0))
        F = hencky(points, V, ghost=False, E=100.0) - ufl.inner(g, V.test) * points.dX
        remedy = mpm.Stabilisation(kind, E=100.0, nu=0.3)
        bcs = mpm.fixed(V, "bottom")
        loads = [(0.1, -0.5), (0.2, -1.0)]
        problem, result = run(points, V, F, bcs, loads, g, stabilisation=remedy)
        result.pop("moved")
        if kind == "soft":
            # its linear systems are solved by iteration: a last step may be needed or not
            result.pop("iterations")
        result["kappa"] = mpm.study.conditioning(problem, 1.0).kappa_K if kind != "none" else 0.0
        figures[kind] = result
    return figures


def remedies_gimp():
    """Remedies with GIMP."""
    return _remedies("gimp")


def remedies_linear():
    """Remedies with linear functions."""
    return _remedies("linear")


def remedies_triangles():
    """Remedies on triangles, where roots are looked for on all ranks."""
    return _remedies("linear", mesh.CellType.triangle)


def remedies_bspline2():
    """Remedies with quadratic splines, whose facet terms act through their extraction."""
    return _remedies("bspline2")
