"""Derivatives of a run by its parameters."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from mpi4py import MPI

import dolfinmpm as mpm

COMM = MPI.COMM_WORLD

sys.path.append(str(Path(__file__).resolve().parents[3] / "demos" / "studies"))
from derivative_scenes import CASES as SCENES
from derivative_scenes import grid_of, sizes_of


def _found(*names, central=None, restarted=()):
    """Figures and derivatives of some examples; some go on from a checkpoint."""
    figures = {}
    for name in names:
        scene, parameters = SCENES[name]
        options = {"scales": sizes_of(name), "central": central}
        if name in restarted:
            folder = COMM.bcast(tempfile.mkdtemp() if COMM.rank == 0 else None)
            options |= {"restart": folder, "every": 2}
            mpm.study.differentiate(scene, parameters, **options)
        found = mpm.study.differentiate(scene, parameters, **options)
        assert not found.notes
        figures[name] = {
            k: {"values": values.tolist(), "derivatives": [d.tolist() for d in of.values()]}
            for k, values in found.figures.items()
            for of in [found.derivatives[k]]
        }
    return figures


def derivatives():
    """An elastic column, one that yields, and an arch beyond its limit point."""
    return _found("elastic", "von Mises", "arc length", restarted=["von Mises", "arc length"])


def derivatives_in_contact():
    """A rigid body that rubs on a block, a layer that drains, and a bar that swings."""
    # rounding differs from rank to rank, so two runs per parameter
    return _found(
        "contact with friction", "consolidation", "Newmark", "explicit",
        "sliding block, explicit", central=True,
    )  # fmt: skip


def sampling():
    """Runs side by side on groups of one rank, and one of a sample that fails on a rank."""

    def bar(m, comm):
        grid = grid_of((1.0, 4.0), (1, 4), comm)
        points = mpm.fill(grid, mpm.Box((0, 0), (1, 4)), 2, 2000.0)
        V = mpm.Space(grid, "gimp")
        F = mpm.momentum(mpm.materials.Hencky(m["E"], 0.0), points, V.increment, V.test)
        bcs = mpm.fixed(V, "bottom") + mpm.prescribed(V, "top", 1, increment=-0.01)
        problem = mpm.QuasiStatic(F, V.increment, points, bcs)
        margin = {"margin": lambda: 3e3 + points["stress"][:, 1, 1].mean()}
        return mpm.study.Run(problem, [problem.step], margin)

    given = {"E": mpm.study.Normal(1e6, 2e5)}
    found = mpm.study.monte_carlo(bar, given, runs=7, ranks=1)

    def failing(m, comm):
        if m["E"] > 1.1e6:
            raise mpm.errors.ConvergenceError("too stiff")
        return bar(m, comm)

    try:
        mpm.study.monte_carlo(failing, given, runs=7, ranks=1)
    except mpm.errors.ConvergenceError as error:
        told = str(error).splitlines()[0]
    return {"values": found.values.tolist(), "told": told}
