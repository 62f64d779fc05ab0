"""Explicit steps of a block that flies, turns and changes rank."""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path

import numpy as np
import ufl
from dolfinx import fem, mesh

import dolfinmpm as mpm

from .common import COMM, sums

END = 0.24
ELASTIC = mpm.materials.Hencky(E=1e6, nu=0.3)
WEAK = mpm.materials.VonMises(E=1e6, nu=0.3, radius=2e3)
SCENES = {
    "usl": {"law": ELASTIC, "scheme": "usl"},
    "usl in general": {"law": ELASTIC, "scheme": "usl", "fused": False},
    "musl": {"law": WEAK, "basis": "gimp", "scheme": "musl"},
    "usf": {"law": WEAK, "scheme": "usf", "mapping": "apic", "damping": 0.05},
    "redistribution": {"law": ELASTIC, "basis": "linear", "redistribution": 0.2},
}


def _block(law, basis="bspline2", **options):
    """A block in flight across a grid that ranks share; it turns, and its weight pulls it."""
    grid = mesh.create_rectangle(COMM, [(0, 0), (2.5, 1.75)], (20, 14), mesh.CellType.quadrilateral)
    points = mpm.fill(grid, mpm.Box((0.4, 0.6), (1.3, 1.3)), 2, 1000.0)
    splines = basis.startswith("bspline")
    V = mpm.Space(grid, basis, averaged=False) if splines else mpm.Space(grid, basis)
    g = fem.Constant(grid, (0.0, -2.0))
    F = mpm.momentum(law, points, V.increment, V.test)
    F -= ufl.inner(points.density * g, V.test) * points.dX
    points.add_field("velocity", (2,), "m/s")
    x = points["x"]
    turn = 2.0 * np.stack([0.95 - x[:, 1], x[:, 0] - 0.85], axis=1)
    points["velocity"] = np.array([3.0, 0.5]) + turn
    bcs = mpm.prescribed(V, lambda x: x[0] > 2.3, 0, increment=0.01)
    return mpm.Explicit(F, V.increment, points, bcs, **options)


def _go(problem, first=0):
    """Four calls of many steps each."""
    for k in range(first, 4):
        problem.step((k + 1) * 0.25 * END)
        yield problem


def _figures(problem):
    points = problem.points
    moved = sum(record.migrated for record in problem.history)
    energies = problem.energies()
    return {
        "parts": [record.parts for record in problem.history],
        "moved": (moved > 0) if COMM.size > 1 else None,
        "count": points.total,
        "momentum": list(problem.momentum()),
        "energies": [energies.kinetic, energies.strain, energies.external],
        **sums(points, "x", "velocity", "F", "stress", "l", "V"),
    }


def explicit_steps():
    """Fused and general ones of every scheme."""
    figures = {}
    for name, scene in SCENES.items():
        problem = _block(**scene)
        fused = scene.get("fused", True) and "redistribution" not in scene
        assert (problem.unfused == "") == fused
        *_, problem = _go(problem)
        figures[name] = _figures(problem)
        assert sum(figures[name]["parts"]) >= 100
    one, other = figures["usl"], figures["usl in general"]
    for key in ("x", "velocity", "stress", "momentum", "energies"):
        size = np.abs(other[key]).max()
        assert np.allclose(one[key], other[key], rtol=0, atol=1e-10 * size), key
    return figures


def explicit_one_by_one():
    """Calls of one step each, between some of which the points of one rank get other velocities."""
    figures = {}
    for name in ("usl", "musl", "usf"):
        problem = _block(**SCENES[name])
        points, dt = problem.points, 0.4 * problem.critical_step()
        for k in range(12):
            if k in (4, 9) and np.any(points["id"] == 7):
                # other ranks do not ask for the field
                points["velocity"][points["id"] == 7] *= 0.5
            problem.step(problem.time + dt)
        figures[name] = _figures(problem)
        # so few steps need not take points across a border
        del figures[name]["moved"]
        assert figures[name]["parts"] == [1] * 12
    return figures


def explicit_restart():
    """A run that goes on in the middle."""
    folder = Path(COMM.bcast(tempfile.mkdtemp() if COMM.rank == 0 else None))
    found = []
    for scene in (SCENES["musl"], SCENES["usl in general"]):
        for k, problem in enumerate(_go(_block(**scene))):
            if k == 1:
                problem.save(folder / "middle.npz")
        again = _block(**scene)
        again.load(folder / "middle.npz")
        *_, again = _go(again, 2)
        found.append([_figures(p) for p in (problem, again)])
        for name in ("x", "velocity", "stress", "energies", "momentum"):
            a, b = (np.array(figures[name]) for figures in found[-1])
            assert np.allclose(a, b, rtol=0, atol=1e-12 * np.abs(a).max()), name
    COMM.barrier()
    if COMM.rank == 0:
        shutil.rmtree(folder)
    return {"musl": found[0][1], "usl in general": found[1][1]}


def explicit_boundaries():
    """Bodies that are thrown at an incline with friction, or carried by their skin, by time."""
    results = {}
    for kind, law, options in (
        ("wall", WEAK, {}),
        ("penalty", ELASTIC, {"mapping": "apic"}),
        ("nitsche", ELASTIC, {"stabilisation": "aggregation"}),
        ("total", ELASTIC, {"scheme": "usl"}),
    ):
        grid = mesh.create_rectangle(
            COMM, [(0, 0), (2.5, 1.75)], (20, 14), mesh.CellType.quadrilateral
        )
        low, high = (0.41, 0.63), (1.33, 1.31)
        points = mpm.fill(grid, mpm.Box(low, high), 2, 1000.0, aligned="body")
        V = mpm.Space(grid, "gimp", configuration="total" if kind == "total" else "updated")
        u, v = V.increment, V.test
        clock = fem.Constant(grid, 0.0)
        F = mpm.momentum(law, points, u, v)
        points.add_field("velocity", (2,), "m/s")
        points["velocity"] = [2.0, -1.0]
        if kind in ("wall", "total"):
            ends = [(0.2, 0.6), (2.4, 0.5)]
            line = mpm.Boundary.from_polygon(points, ends, closed=False, follows=False)
            F += mpm.signorini(line, u, v, law=law, friction=0.3, penalty=10.0)
        else:
            (a, b), (c, d) = low, high
            line = mpm.Boundary.from_polygon(points, [(a, d), (a, b), (c, b)], closed=False)
            way = ufl.as_vector((2.0 * clock, -1.0 * clock + 3.0 * clock**2))
            penalty = 10.0 if kind == "penalty" else None
            F += mpm.dirichlet(line, u, v, way, law=law, method=kind, penalty=penalty)
        problem = mpm.Explicit(F, u, points, time=clock, **options)
        first = problem.critical_step()
        for k in range(2):
            problem.step(0.04 * (k + 1))
        e = problem.energies()
        results[kind] = {
            "critical": [first, problem.critical_step()],
            "steps": [record.parts for record in problem.history],
            "moved": sum(r.migrated for r in problem.history) > 0 if COMM.size > 1 else None,
            "force": list(line.force()),
            "energies": [e.kinetic, e.strain, e.contact, e.external, e["friction"]],
            **sums(points, "x", "velocity", "F", "stress"),
        }
    return results
