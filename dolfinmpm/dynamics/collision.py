"""Bodies that collide at the nodes of the grid: Bardenhagen's contact.

Each body has masses and momenta of its own at the nodes. Where two of them share a node, fill what
its function has room for, and come nearer to each other along the normal n, they exchange the
momentum by which both have the velocity of their common centre of mass along n, and rub:

    v_a −= [(v_a − v̄)·n] (n + μ' t),    μ' = min(μ, |(v_a − v̄)_t| / (v_a − v̄)·n),

t being the direction of the slip (Bardenhagen et al. 2001, CMES 2, 509). Momentum is kept, for n is
common to both: that of n_a − n_b, where n_a = Σ m ∇N/|Σ m ∇N| points out of a body.

Without the second condition bodies feel each other as soon as they share a node, up to two cells
before they touch. With it they do where the volumes that they have at a node, Σ V N of both,
are the integral of its function: a gap leaves room there, on whichever side of the node it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass
from itertools import combinations

import numpy as np
import numpy.typing as npt

from dolfinmpm._platform.checks import shown, truth
from dolfinmpm._platform.errors import ParameterError
from dolfinmpm._platform.units import friction_coefficient

__all__ = ["BodyAtNodes", "Collision", "collide"]

Array = npt.NDArray[np.float64]

# Share of a node's room that may be left where bodies touch: their surfaces are curved
_ROOM = 0.02


@dataclass(frozen=True)
class Collision:
    """Bodies that touch each other at the grid's nodes, for `Explicit`.

    Args:
        tags: Tags of the points of each body, at least two; a tuple where a body has several.
        friction: Coefficient μ of Coulomb's friction.
        gap_test: Whether bodies touch only where they leave no room between them at a node; if
            not, as soon as they share one, where energy may grow on coarse grids.

    Raises:
        ParameterError: An argument is not what it may be.
    """

    tags: Sequence[int | tuple[int, ...]] = (1, 2)
    _: KW_ONLY
    friction: float = 0.0
    gap_test: bool = True

    def __post_init__(self):
        given = self.tags if isinstance(self.tags, (tuple, list)) else ()
        bodies = [t if isinstance(t, tuple) else (t,) for t in given]
        every = [t for body in bodies for t in body]
        whole = all(isinstance(t, (int, np.integer)) and not isinstance(t, bool) for t in every)
        if len(bodies) < 2 or not all(bodies) or not whole or len(set(every)) < len(every):
            raise ParameterError(
                f"tags = {shown(self.tags)} must be the tags of two bodies or more, such as (1, 2) "
                "or ((1, 3), 2), and no point is in two of them"
            )
        friction_coefficient(self.friction)
        truth("gap_test", self.gap_test)

    def bodies(self, tags: npt.NDArray[np.integer]) -> list[npt.NDArray[np.bool_]]:
        """Which points belong to each body, by their tags."""
        return [np.isin(tags, body) for body in self.tags]


@dataclass
class BodyAtNodes:
    """What one body has at the nodes.

    Attributes:
        mass: Mass (kg), shape (nodes,).
        volume: Volume (m^d), likewise.
        slope: Σ m ∇N (kg/m), shape (nodes, d), which points out of the body.
    """

    mass: Array
    volume: Array
    slope: Array


def collide(
    bodies: Sequence[BodyAtNodes], velocities: Sequence[Array], room: Array | None, friction: float
) -> Array:
    """Let bodies exchange momentum at the nodes that they share; changes the velocities.

    Args:
        bodies: The bodies.
        velocities: Theirs (m/s), shape (nodes, d) each.
        room: Integrals of the nodes' functions (m^d), shape (nodes,), or None without a gap test.
        friction: μ.

    Returns:
        Momentum that the first body of all has got (kg m/s), shape (nodes, d).
    """
    got = np.zeros_like(velocities[0])
    for i, j in combinations(range(len(bodies)), 2):
        a, b = bodies[i], bodies[j]
        both = (a.mass > 0.0) & (b.mass > 0.0)
        if room is not None:
            filled = sum(body.volume for body in bodies)
            both &= filled >= (1.0 - _ROOM) * room
        k = np.flatnonzero(both)
        if not k.size:
            continue
        n = _unit(_unit(a.slope[k]) - _unit(b.slope[k]))
        # what one body does at a node, the other does with the opposite sign
        reduced = a.mass[k] * b.mass[k] / (a.mass[k] + b.mass[k])
        w = velocities[i][k] - velocities[j][k]
        nearing = np.sum(w * n, axis=1)
        nearing[nearing < 0.0] = 0.0
        slip = w - np.sum(w * n, axis=1)[:, None] * n
        size = np.linalg.norm(slip, axis=1)
        rubs = np.minimum(friction * nearing, size)
        along = slip * (rubs / np.where(size > 0.0, size, 1.0))[:, None]
        impulse = reduced[:, None] * (nearing[:, None] * n + along)
        velocities[i][k] -= impulse / a.mass[k][:, None]
        velocities[j][k] += impulse / b.mass[k][:, None]
        if i == 0:
            got[k] -= impulse
    return got


def _unit(vectors: Array) -> Array:
    size = np.linalg.norm(vectors, axis=1)[:, None]
    return vectors / np.where(size > 0.0, size, 1.0)
