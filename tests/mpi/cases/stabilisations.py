"""Stabilisations against small cuts, with what they need across rank borders."""

from __future__ import annotations

import numpy as np
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

import dolfinmpm as mpm
from dolfinmpm.assembly.stencilsums import add_product
from dolfinmpm.body.location import destinations

from .common import COMM, hencky, run, sums


def _stabilisations(basis, kind_of_cell=mesh.CellType.quadrilateral):
    """A leaning body with small cuts under every stabilisation, and its conditioning."""
    figures = {}
    for kind in ("none", "ghost", "aggregation", "weak-aggregation", "extended", "soft"):
        grid = mesh.create_rectangle(COMM, [(0, 0), (9, 9)], (9, 9), kind_of_cell)
        points = mpm.fill(grid, mpm.Box((1.3, 0), (6.2, 5.15)), 3, 1.0)
        V = mpm.Space(grid, basis)
        g = fem.Constant(grid, (0.0, 0.0))
        F = hencky(points, V, ghost=False, E=100.0) - ufl.inner(g, V.test) * points.dX
        stabilisation = mpm.Stabilisation(kind, E=100.0, nu=0.3)
        bcs = mpm.fixed(V, "bottom")
        loads = [(0.1, -0.5), (0.2, -1.0)]
        problem, result = run(points, V, F, bcs, loads, g, stabilisation=stabilisation)
        result.pop("moved")
        if kind == "soft":
            # its linear systems are solved by iteration: a last step may be needed or not
            result.pop("iterations")
        result["kappa"] = mpm.study.conditioning(problem, 1.0).kappa_K if kind != "none" else 0.0
        figures[kind] = result
    return figures


def stabilisations_gimp():
    """Stabilisations with GIMP."""
    return _stabilisations("gimp")


def stabilisations_linear():
    """Stabilisations with linear functions."""
    return _stabilisations("linear")


def stabilisations_triangles():
    """Stabilisations on triangles, where roots are looked for on all ranks."""
    return _stabilisations("linear", mesh.CellType.triangle)


def stabilisations_bspline2():
    """Stabilisations with quadratic splines, whose facet terms act through their extraction."""
    return _stabilisations("bspline2")


def nonlinear_over_cells():
    """A form over active cells whose tangent is zero at first, and later has entries anywhere."""
    figures = {}
    for basis in ("gimp", "bspline2"):
        grid = mpm.create_lattice(COMM, [np.arange(0.0, 6.1, 0.5)] * 2)
        points = mpm.fill(grid, mpm.Box((0, 0), (4.1, 3.1)), 2, 1.0)
        V = mpm.Space(grid, basis)
        u, v, g = V.increment, V.test, fem.Constant(grid, (0.0, 0.0))
        F = hencky(points, V, ghost=False, E=100.0) - ufl.inner(g, v) * points.dX
        F += 50.0 * ufl.inner(u, u) * ufl.inner(u, v) * points.dC
        _, figures[basis] = run(points, V, F, mpm.fixed(V, "bottom"), [(0.1, -0.5)], g)
        figures[basis].pop("moved")
    return figures


def soft_leaves():
    """Soft stiffness of leaves, whose owners are on several ranks, with hanging nodes."""
    grid = mpm.create_lattice(COMM, [np.arange(10.0), np.arange(10.0)])
    V = mpm.Space(grid, "gimp", refine=lambda x: np.where(x[0] < 3.5, 0.5, 1.0), levels=1)
    points = mpm.fill(grid, mpm.Box((1.3, 0), (6.2, 5.15)), 2, 1.0, refine=V)
    g = fem.Constant(grid, (0.0, 0.0))
    F = hencky(points, V, ghost=False, E=100.0) - ufl.inner(g, V.test) * points.dX
    stabilisation = mpm.Stabilisation("soft", E=100.0, nu=0.3)
    bcs = mpm.fixed(V, "bottom")
    _, result = run(points, V, F, bcs, [(0.1, -0.5)], g, stabilisation=stabilisation)
    result.pop("moved")
    result.pop("iterations")
    return result


def splines_on_leaves():
    """Splines on leaves of three sizes, whose independent ones may belong to another rank."""
    figures = {}
    for basis, kind, fbar in (
        ("bspline2", "ghost", True), ("bspline3", "ghost", False),
        ("bspline2", "aggregation", False),
    ):  # fmt: skip
        grid = mpm.create_lattice(COMM, [np.arange(10.0), np.arange(10.0)])
        V = mpm.Space(grid, basis, refine=lambda x: 0.2 + 0.15 * np.hypot(*(x[:2] - 4.0)), levels=2)
        points = mpm.fill(grid, mpm.Box((1.3, 0), (6.2, 5.15)), 2, 1.0, refine=V)
        g = fem.Constant(grid, (0.0, 0.0))
        law = mpm.materials.VonMises(E=1000.0, nu=0.3, yield_stress=3.0)
        F = mpm.momentum(law, points, V.increment, V.test, fbar=fbar)
        F -= ufl.inner(points.density * g, V.test) * points.dX
        loads = [(0.05, -0.3), (0.1, -0.6)]
        _, result = run(points, V, F, mpm.fixed(V, "bottom"), loads, g, stabilisation=kind)
        result.pop("moved")
        figures[f"{basis} {kind}"] = result
    return figures


def lattice_multigrid():
    """A leaning body by multigrid of the lattice, whose levels span ranks."""
    figures = {}
    for basis, kind, levels in (
        ("gimp", "ghost", 0), ("linear", "aggregation", 0), ("bspline2", "ghost", 0),
        ("gimp", "ghost", 2), ("linear", "aggregation", 2), ("bspline2", "ghost", 2),
    ):  # fmt: skip
        grid = mesh.create_rectangle(COMM, [(0, 0), (9, 9)], (36, 36), mesh.CellType.quadrilateral)
        refined = {"refine": lambda x: 0.05 + 0.1 * np.hypot(*(x[:2] - 4.0)), "levels": levels}
        V = mpm.Space(grid, basis, **(refined if levels else {}))
        points = mpm.fill(
            grid, mpm.Box((1.3, 0), (6.2, 5.15)), 2, 1.0, refine=V if levels else None
        )
        g = fem.Constant(grid, (0.0, 0.0))
        F = hencky(points, V, ghost=False, E=100.0) - ufl.inner(g, V.test) * points.dX
        options = {"ksp_type": "cg", "pc_type": "mg", "ksp_rtol": 1e-12}
        problem, result = run(
            points, V, F, mpm.fixed(V, "bottom"), [(0.1, -0.5)], g, stabilisation=kind,
            petsc_options=options,
        )  # fmt: skip
        result.pop("moved")
        # the smoother differs between ranks, the levels do not
        ksp = problem.newton.linear.snes.getKSP()
        result["levels"] = ksp.getPC().getMGLevels()
        result["few iterations"] = ksp.getIterationNumber() <= 25
        figures[f"{basis} {levels}"] = result
    return figures


def adaptive_penalties():
    """Ghost penalties by the tangent of soil that yields, on lattices and on triangles."""
    figures = {}
    for basis, kind in (("gimp", "quadrilateral"), ("linear", "triangle"), ("bspline2", None)):
        shape = mesh.CellType[kind or "quadrilateral"]
        grid = mesh.create_rectangle(COMM, [(0, 0), (9, 9)], (9, 9), shape)
        points = mpm.fill(grid, mpm.Box((1.3, 0), (6.2, 5.15)), 3, 1.0)
        V = mpm.Space(grid, basis)
        g = fem.Constant(grid, (0.0, 0.0))
        soil = mpm.materials.VonMises(E=100.0, nu=0.3, radius=0.5, hardening=20.0)
        F = mpm.momentum(soil, points, V.increment, V.test)
        F -= ufl.inner(points.density * g, V.test) * points.dX
        stabilisation = mpm.Stabilisation("ghost", factor="adaptive")
        loads = [(0.02, -0.1), (0.05, -0.2), (0.08, -0.3)]
        bcs = mpm.fixed(V, "bottom")
        problem, result = run(
            points, V, F, bcs, loads, g, stabilisation=stabilisation, tolerance=1e-11
        )
        result.pop("moved")
        assert COMM.allreduce(points["plastic_strain"].max(initial=0.0), MPI.MAX) > 1e-4
        problem.activate()
        (modulus,) = problem.form.moduli
        result["penalties"] = COMM.allreduce(float(modulus.values @ modulus.values))
        figures[basis] = result | sums(points, "tangent_moduli")
    return figures


def facets_of_even_ranks():
    """Ghost facets where DOLFINx's own distribution is even, so that the body needs no other.

    Ranks then know more cells than those of DOLFINx's mesh: on three ranks here.
    """
    grid = mpm.create_lattice(COMM, [np.linspace(0, 10, 21), np.linspace(-2, 2, 9)])
    arch = mpm.Where(lambda x: np.abs(x[1] - np.sin(0.05 * np.pi * x[0]) ** 2) < 0.4)
    points = mpm.fill(grid, arch, 4, 1.0)
    V = mpm.Space(grid, "gimp")
    g = fem.Constant(grid, (0.0, -0.01))
    F = hencky(points, V, ghost=False, E=1e3) - ufl.inner(g, V.test) * points.dX
    bcs = mpm.fixed(V, "left") + mpm.rollers(V, "right")
    problem = mpm.QuasiStatic(F, V.increment, points, bcs, stabilisation="ghost")
    problem.step()
    assert points.partition is None or COMM.size != 3
    return {"facets": problem.here.ghost_facets, **sums(points, "x", "F")}


def facets_of_few_ranks():
    """Terms over facets of a lattice as a small body goes along a strip, past rank after rank.

    Most ranks have no facets, and meet classes of facets that others know.
    """
    figures = {}
    for basis in ("linear", "bspline2", "bspline3"):
        grid = mesh.create_rectangle(COMM, [(0, 0), (24, 3)], (24, 3), mesh.CellType.quadrilateral)
        points = mpm.fill(grid, mpm.Box((0, 0), (3.3, 2.2)), 2, 1.0)
        V = mpm.Space(grid, basis)
        u, v, gamma = V.increment, V.test, fem.Constant(grid, 1.0)
        # the second term mixes components; neither depends on which side comes first
        F = hencky(points, V, ghost=False) + mpm.ghost(points, u, v, gamma)
        F += gamma * ufl.avg(ufl.div(u)) * ufl.avg(v[0] + 2.0 * v[1]) * points.dS
        problem = mpm.QuasiStatic(F, u, points)
        assert problem.form.grid.splines == {(0, 0)}
        found, moved, idle = [], 0, 0
        for shift in (0.0, 6.5, 6.5, 6.5):
            new = points["x"] + [shift, shift / 50]
            to = destinations(grid, new, points["cell"])
            points["x"][...] = new
            moved += points.migrate(to)
            here = problem.activate()
            x = here.fields[0].basis.node_coordinates()[:, :2]
            values, forces = np.sin(x) + x[:, ::-1], np.zeros_like(x)
            add_product(here.blocks_of("stiffness")[0], [values], [forces])
            found.append(COMM.allreduce(float(np.sum(forces * np.cos(x))), op=MPI.SUM))
            idle += COMM.allreduce(int(here.blocks_of("stiffness")[0].rows.size == 0), op=MPI.SUM)
            gamma.value += 1.0
            here = problem.activate()
            forces[:] = 0.0
            add_product(here.blocks_of("stiffness")[0], [values], [forces])
            found.append(COMM.allreduce(float(np.sum(forces * np.cos(x))), op=MPI.SUM))
        assert idle > 0 or COMM.size == 1
        figures[basis] = {"forces": found, "moved": (moved > 0) if COMM.size > 1 else None}
    return figures
