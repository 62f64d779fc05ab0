"""Bodies in motion: masses, mappings, energies and momenta on any number of ranks."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from petsc4py import PETSc

import dolfinmpm as mpm
from dolfinmpm.solve import spectra

from .common import COMM, sums
from .restart import REPEATABLE, goes_on


def tumbling(rule=mpm.Newmark, basis="gimp", kind="quadrilateral", **options):
    """An elastic block that turns as it falls across rank borders; `step` takes its next step."""
    grid = mesh.create_rectangle(COMM, [(0, 0), (9, 12)], (9, 12), mesh.CellType[kind])
    points = mpm.fill(grid, mpm.Box((2.3, 7.1), (6.4, 9.7)), 2, 1000.0)
    V = mpm.Space(grid, basis)
    g = fem.Constant(grid, (0.0, 0.0))
    F = mpm.momentum(mpm.materials.Hencky(E=2e5, nu=0.3), points, V.increment, V.test)
    F -= ufl.inner(points.density * g, V.test) * points.dX
    points.add_field("velocity", (2,), "m/s")
    points["velocity"] = (points["x"] - (4.35, 8.4)) @ np.array([[0.0, 2.0], [-2.0, 0.0]])
    options = {"stabilisation": "ghost", "tolerance": 1e-12, **options}
    problem = rule(F, V.increment, points, **options)

    def step():
        # gravity jumps, and a wind changes
        k = len(problem.history)
        g.value[:] = 0.5 * np.sin(0.4 * k), -10.0 if k > 3 else 0.0
        return problem.step(problem.time + 0.04)

    return problem, step


def _figures(build, steps=20):
    """Sums over the points, energies and momenta after some steps."""
    problem, step = build()
    points = problem.points
    count, mass = points.total, COMM.allreduce(points["density"] @ points["V0"])
    for _ in range(steps):
        step()
    assert points.total == count
    assert abs(COMM.allreduce(points["density"] @ points["V0"]) - mass) < 1e-12 * mass
    now = problem.energies()
    moved = sum(record.migrated for record in problem.history)
    return {
        "iterations": [record.iterations for record in problem.history],
        "energies": [now.kinetic, now.strain, now.external],
        "momentum": [float(p) for p in problem.momentum()],
        "turning": [float(p) for p in problem.angular_momentum()],
        "moved": (moved > 0) if COMM.size > 1 else None,
        **sums(points, "x", "F", "stress", "velocity", "acceleration"),
    }


def dynamics():
    """Newmark's rule with a consistent mass and its ghost penalty, on both kinds of cells."""
    return {
        "gimp": _figures(tumbling),
        "triangles": _figures(lambda: tumbling(basis="linear", kind="triangle"), 12),
        "aggregation": _figures(lambda: tumbling(stabilisation="aggregation"), 12),
        "even": _evenly_divided(),
        "critical": _critical_steps(),
    }


def _critical_steps():
    """Critical steps of a free bar of 40 linear elements, whose mass may be lumped."""
    K, M = (PETSc.Mat().createAIJ((41, 41), nnz=3, comm=COMM) for _ in range(2))
    for k in range(40 if COMM.rank == 0 else 0):
        K.setValues([k, k + 1], [k, k + 1], [[1.0, -1.0], [-1.0, 1.0]], PETSc.InsertMode.ADD)
        M.setValues([k, k + 1], [k, k + 1], [[2.0, 1.0], [1.0, 2.0]], PETSc.InsertMode.ADD)
    K.assemble()
    M.assemble()
    steps = []
    with pytest.MonkeyPatch.context() as patch:
        for limit in (spectra.DENSE_LIMIT, 10):
            patch.setattr(spectra, "DENSE_LIMIT", limit)
            steps += [mpm.study.critical_step(K, M, lumped=lumped) for lumped in (True, False)]
    np.testing.assert_allclose(steps, 2 * [np.sqrt(6), np.sqrt(2)], rtol=1e-12)
    return steps


def _evenly_divided():
    """A body that fills its grid: the mesh's own division among the ranks stays."""
    grid = mesh.create_rectangle(COMM, [(0, 0), (12, 6)], (12, 6), mesh.CellType.quadrilateral)
    points = mpm.fill(grid, mpm.Box((0.2, 0.2), (11.8, 5.8)), 2, 1000.0)
    V = mpm.Space(grid, "gimp")
    F = mpm.momentum(mpm.materials.Hencky(E=2e5, nu=0.3), points, V.increment, V.test)
    points.add_field("velocity", (2,), "m/s")
    points["velocity"][:, 0] = np.sin(points["x"][:, 0])
    problem = mpm.Newmark(F, V.increment, points, stabilisation="ghost", tolerance=1e-12)
    for k in range(3):
        problem.step(0.01 * (k + 1))
    assert COMM.size != 2 or points.partition is None
    now = problem.energies()
    return {"energies": [now.kinetic, now.strain], **sums(points, "x", "stress", "velocity")}


def dynamics_lumped():
    """Generalised-α with lumped masses, and mappings with affine parts and with filters."""
    rule = mpm.GeneralisedAlpha
    return {
        "apic": _figures(lambda: tumbling(rule, mass="lumped", mapping="apic"), 12),
        "tpic": _figures(lambda: tumbling(rule, "bspline2", mass="lumped", mapping="tpic"), 12),
        "xpic": _figures(lambda: tumbling(mass="lumped", mapping="xpic"), 12),
        "accel": _figures(lambda: tumbling(mass="lumped", stabilisation="extended"), 12),
    }


def dynamics_restart():
    """A run that goes on in the middle has the same bits."""
    return goes_on(lambda: tumbling(petsc_options=REPEATABLE), 16)
