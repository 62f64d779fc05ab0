"""The block that `skip_table.py` and its features load with its weight."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import ufl
from dolfinx import fem
from grids import box_grid

import dolfinmpm as mpm


@dataclass
class Block:
    """A block in one problem, with the next step ready to be taken.

    Attributes:
        before, after: What is done around a step, besides taking it.
    """

    problem: Any
    gravity: Any
    after: Callable[[], Any] | None = None
    taken: int = 0

    def step(self) -> None:
        """One step."""
        self.gravity.value[-1] = -0.05 * (self.taken + 1)
        self.taken += 1
        self.problem.step()
        if self.after is not None:
            self.after()


def block(cells, dimension=2, law=None, fbar=False, stabilisation="none", tags=False) -> Block:
    """A block with a feature, or with none."""
    if dimension == 3:
        cells = max(2, round(cells ** (2 / 3)))
    high = (1.0,) * (dimension - 1) + (1.25,)
    n = [cells] * (dimension - 1) + [round(1.25 * cells)]
    grid = box_grid([(0.0,) * dimension, high], n)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    law = law or mpm.materials.Hencky(E=1e4, nu=0.3)
    low, top = (0.0,) * dimension, (1.0,) * dimension
    if tags:
        half = (*top[:-1], 0.5)
        points = mpm.fill(grid, mpm.Box(low, half), 2, 80.0, tag=1)
        points = points + mpm.fill(grid, mpm.Box((*low[:-1], 0.5), top), 2, 80.0, tag=2)
        F = mpm.momentum(law, points, u, v, tag=1) + mpm.momentum(law, points, u, v, tag=2)
    else:
        points = mpm.fill(grid, mpm.Box(low, top), 2, 80.0)
        F = mpm.momentum(law, points, u, v, fbar=fbar)
    gravity = fem.Constant(grid, (0.0,) * dimension)
    F -= ufl.inner(points.density * gravity, v) * points.dX
    bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
    return Block(mpm.QuasiStatic(F, u, points, bcs, stabilisation=stabilisation), gravity)
