"""Refined spaces: ranks without leaves, and leaves without points of a field."""

from __future__ import annotations

import numpy as np
import ufl
from dolfinx import fem

import dolfinmpm as mpm

from .common import COMM, sums
from .restart import remove, temporary_folder


def _small_body(basis, stabilisation):
    """A small body on a long grid, and its step: leaves, which change, are on one rank."""
    grid = mpm.create_lattice(COMM, [np.linspace(0, 4, 9), np.linspace(0, 1, 3)])
    points = mpm.fill(grid, mpm.Box((0, 0), (0.45, 0.4)), 4, 1.0)
    middle = [0.0]
    V = mpm.Space(
        grid, basis, levels=1,
        refine=lambda x: np.where(abs(x[0] - middle[0]) < 0.3, 0.25, 0.5),
    )  # fmt: skip
    g = fem.Constant(grid, (0.0, 0.0))
    F = mpm.momentum(mpm.materials.Hencky(1e3, 0.3), points, V.increment, V.test)
    F -= ufl.inner(points.density * g, V.test) * points.dX
    problem = mpm.QuasiStatic(
        F, V.increment, points, mpm.fixed(V, "bottom"), stabilisation=stabilisation,
        tolerance=1e-12,
    )  # fmt: skip

    def step():
        k = len(problem.history)
        g.value[1], middle[0] = -20.0 * (k + 1), 0.25 * k
        problem.step()

    return problem, step


def leaves_of_few_ranks():
    """Ranks without leaves take part."""
    figures = {}
    for basis in ("gimp", "bspline2"):
        problem, step = _small_body(basis, "aggregation")
        for _ in range(3):
            step()
        figures[basis] = sums(problem.points, "x", "stress")
    return figures


def restart_with_leaves_of_few_ranks():
    """Ranks without facets of leaves save and load, too."""
    folder = temporary_folder()
    ghost = mpm.Stabilisation("ghost", factor="adaptive")
    problem, step = _small_body("bspline2", ghost)
    for _ in range(2):
        step()
    problem.save(folder / "middle.npz")
    again, go_on = _small_body("bspline2", ghost)
    again.load(folder / "middle.npz")
    for one in (step, go_on):
        one()
    found = [sums(one.points, "x", "stress") for one in (problem, again)]
    for name, value in found[0].items():
        np.testing.assert_allclose(found[1][name], value, rtol=1e-9)
    remove(folder)
    return found[0]


def water_in_a_part():
    """Pore water in one part of the soil: its leaves hang on those of the dry part."""
    grid = mpm.create_lattice(COMM, [np.arange(5.0)] * 2)
    refined = {"refine": lambda x: np.where(x[0] > 1.01, 0.5, 1.0), "levels": 1}
    V = mpm.Space(grid, "bspline2", **refined)
    Q = mpm.Space(grid, "linear", shape=(), tag=1, **refined)

    def part(low, high, tag):
        return mpm.fill(grid, mpm.Box(low, high), 2, 1e3, tag=tag, refine=V)

    points = part((1, 0.5), (3, 2), 1) + part((0, 0), (1, 0.5), 2)
    points = points + part((1, 0), (3, 0.5), 2) + part((0, 0.5), (1, 2), 2)
    law = mpm.materials.Hencky(1e6, 0.3)
    top = mpm.Surface(points, lambda x: np.isclose(x[1], 2) & (x[0] > 1), normal=(0, 1))
    F = mpm.poromechanics(
        law, points, (V.increment, Q.increment), (V.test, Q.test), porosity=0.4,
        permeability=1e-5, drained=(top, 1e3), tag=1,
    )  # fmt: skip
    F += mpm.momentum(law, points, V.increment, V.test, tag=2)
    problem = mpm.Transient(
        F, [V.increment, Q.increment], points, mpm.rollers(V, "left", "right", "bottom"),
        stabilisation=["ghost", "ghost"],
    )  # fmt: skip
    for k in range(3):
        problem.step(1e6 * (k + 1))
    wet = points["tag"] == 1
    # after so long the pressure is that of the drained side
    far = np.abs(points["pressure"][wet] - 1e3).max(initial=0.0)
    return {"even": bool(COMM.allreduce(far) < 0.1), **sums(points, "x", "stress", "pressure")}
