"""Bodies that collide in explicit steps, in the stability atlas; see `atlas_impacts`."""

from __future__ import annotations

from typing import Any

import atlas_impacts
from atlas_example import Example
from atlas_impacts import H, law_of, moving, squares
from mpi4py import MPI

import dolfinmpm as mpm

__all__ = ["BASES", "WITHOUT", "build", "draw"]

BASES, WITHOUT = atlas_impacts.BASES, ("ghost",)
STEPS = 20  # at whose ends the checks look


def draw(seed: int) -> dict[str, Any]:
    """The numbers of a problem (m, m/s, Pa)."""
    return atlas_impacts.draw(seed, "explicit")


def build(p: dict[str, Any], basis: str, stabilisation: str, comm: MPI.Comm) -> Example:
    """Make the problem ready. Collective."""
    grid, law = squares(comm), law_of(p)
    points = moving(p, grid, (0, 1))
    V = mpm.Space(grid, basis)
    F = mpm.momentum(law, points, V.increment, V.test)
    options: dict[str, Any] = {}
    if p["way"] != "one field" and stabilisation == "none":
        options["collision"] = mpm.Collision((1, 2), friction=p["friction"])
    problem = mpm.Explicit(
        F, V.increment, points, courant=p["courant"], stabilisation=stabilisation, **options
    )

    def go(k: int) -> None:
        problem.step(p["time"] * k / STEPS)

    kernel = None if p["law"] == "neo-Hookean" else law
    # bodies in one field of linear functions make more as their points cross cells
    made = 0.02 if options else 0.05
    return Example(problem, STEPS, go, {1: kernel, 2: kernel}, H, dynamic=True, made=made)
