"""What the problems of the stability atlas have in common: a family draws one from a seed."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from dolfinx import mesh
from mpi4py import MPI

__all__ = ["Example", "Rigid", "culmann", "random_of", "rectangle"]


@dataclass
class Rigid:
    """A rigid body with its outline, by which the checks find points that are inside.

    Attributes:
        body: The body as the library has it.
        corners: Corners of its outline by its centre, as it is at first (m), shape (n, 2).
        bound: Depth of a point's centre below the outline (m) that is taken for wrong.
    """

    body: Any
    corners: Any
    bound: float


@dataclass
class Example:
    """A problem that is ready for its first step.

    Attributes:
        problem: What takes the steps.
        steps: How many there are.
        go: Function that takes step k, from 1 on.
        laws: Law of each tag of the points; None of those without a kernel.
        rigid: Rigid bodies that the points must stay out of.
        dynamic: Whether energy is to be kept.
        made: Energy, by all that came, that may come from nowhere.
        keeps_volume: Whether plastic strain has no volume, in compression at least.
        size: Size of the cells (m).
        equal: Share by which the mean displacement may hang on the number of ranks.
    """

    problem: Any
    steps: int
    go: Callable[[int], None]
    laws: dict[int, Any]
    size: float
    rigid: list[Rigid] = field(default_factory=list)
    dynamic: bool = False
    made: float = 0.05
    keeps_volume: bool = False
    equal: float = 1e-3


def random_of(family: str, seed: int) -> np.random.Generator:
    """Random numbers of a problem: its family and its seed are all that they hang on."""
    return np.random.default_rng([seed, *family.encode()])


def rectangle(comm: MPI.Comm, size: tuple[float, float], h: float) -> mesh.Mesh:
    """A grid of squares of the size h (m) from the origin, at least `size` (m) large."""
    n = [math.ceil(length / h - 1e-9) for length in size]
    ends = [(0.0, 0.0), (n[0] * h, n[1] * h)]
    return mesh.create_rectangle(comm, ends, n, mesh.CellType.quadrilateral)


def culmann(angle: float, friction: float) -> float:
    """Stability number γH/c at which a plane wedge of a slope slides (-).

    No slope stands that is higher: other slips are as likely (Culmann 1875; Taylor 1937,
    Fundamentals of Soil Mechanics). 4 sin β cos φ/(1 − cos(β − φ)).

    Args:
        angle: Of the slope, β (degrees).
        friction: Angle of friction φ (degrees), below β.
    """
    beta, phi = math.radians(angle), math.radians(friction)
    return 4.0 * math.sin(beta) * math.cos(phi) / (1.0 - math.cos(beta - phi))
