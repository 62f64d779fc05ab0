"""Bodies that collide at the nodes of the grid: Bardenhagen's contact.

Each body has masses and momenta of its own at the nodes. Where two of them share a node, fill what
its function has room for, and come nearer to each other along the normal n, they exchange the
momentum by which both have the velocity of their common centre of mass along n, and rub:

    v_a −= [(v_a − v̄)·n] (n + μ' t),    μ' = min(μ, |(v_a − v̄)_t| / (v_a − v̄)·n),

t being the direction of the slip (Bardenhagen et al. 2001, CMES 2, 509). Momentum is kept, for n is
common to both: that of V_a ∇m_a/m_a − V_b ∇m_b/m_b, where ∇m_a = Σ m ∇N points out of a body.

Without the second condition bodies feel each other as soon as they share a node, up to two cells
before they touch. With it they do where the volumes that they have at a node, Σ V N of both,
are the integral of its function: a gap leaves room there, on whichever side of the node it is.

Bodies move and strain by the velocities that their points map to the nodes at the end of a step
("musl"), and these come nearer still: a node's impulse reaches them through the points, which
share it with nodes around. Bodies so run into each other as they are pressed, and where they part
again the impulses would drive them: collisions of coarse bodies made up to 20 % of their energy.
So impulses are sought by which the mapped velocities v* do not come nearer, in passes that each
add the momentum above as of v*, and that converge since the points' mass matrix is at most the
lumped one. Impulses J change the points' energy by J · (v + v*)/2 of the bodies' relative
velocities, v of the step's begin: they dissipate where bodies meet, and make none where they stay.
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

__all__ = ["BodyAtNodes", "Collision", "Touching"]

Array = npt.NDArray[np.float64]

# Share of a node's room that may be left where bodies touch: their surfaces are curved
_ROOM = 0.02
# ... and at most this share of the volume that the lesser body has there
_LEFT = 0.25


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


class Touching:
    """Where bodies touch at the nodes in a step, and what they have exchanged there.

    Args:
        bodies: The bodies.
        room: Integrals of the nodes' functions (m^d), shape (nodes,), or None without a gap test.
        friction: μ.
    """

    def __init__(self, bodies: Sequence[BodyAtNodes], room: Array | None, friction: float):
        self._bodies, self._friction = bodies, friction
        self._pairs: list[tuple[int, int, npt.NDArray[np.intp], Array, Array, Array]] = []
        for i, j in combinations(range(len(bodies)), 2):
            a, b = bodies[i], bodies[j]
            both = (a.mass > 0.0) & (b.mass > 0.0)
            if room is not None:
                left = room - sum(body.volume for body in bodies)
                # beside the surface a node has next to nothing of one body: no gap is small there
                both &= left <= np.minimum(_ROOM * room, _LEFT * np.minimum(a.volume, b.volume))
            k = np.flatnonzero(both)
            # by volume: where one body ends beside the node, the other's surface counts for more
            share = [body.slope[k] * (body.volume[k] / body.mass[k])[:, None] for body in (a, b)]
            n = _unit(share[0] - share[1])
            self._pairs.append((i, j, k, n, np.zeros_like(n), np.zeros_like(n)))

    @property
    def nodes(self) -> npt.NDArray[np.bool_]:
        """At which nodes bodies touch, shape (nodes,)."""
        found = np.zeros(len(self._bodies[0].mass), bool)
        for _, _, k, *_ in self._pairs:
            found[k] = True
        return found

    @property
    def got(self) -> Array:
        """Momentum that the first body of all has got (kg m/s), shape (nodes, d)."""
        found = np.zeros_like(self._bodies[0].slope)
        for i, _, k, _, impulse, _ in self._pairs:
            if i == 0:
                found[k] -= impulse
        return found

    def push(self, velocities: Sequence[Array], ahead: float = 0.0) -> list[Array]:
        """Exchange the momentum that stops bodies from coming nearer; changes the velocities.

        Pushes of one step add up: a later one may take back momentum that an earlier one gave, but
        no sum of them draws bodies together or rubs more than friction may.

        Args:
            velocities: Of each body (m/s), shape (nodes, d).
            ahead: Share of the impulses' change by which velocities go beyond it, for the next
                push to find more (Nesterov 1983); 0 in the last one.

        Returns:
            How much the velocities have changed (m/s), likewise.
        """
        before = [V.copy() for V in velocities]
        for i, j, k, n, impulse, at in self._pairs:
            a, b = self._bodies[i].mass[k, None], self._bodies[j].mass[k, None]
            wanted = at + a * b / (a + b) * (velocities[i][k] - velocities[j][k])
            normal = np.sum(wanted * n, axis=1, keepdims=True)
            along = wanted - normal * n
            normal = np.maximum(normal, 0.0)
            size = np.linalg.norm(along, axis=1, keepdims=True)
            rubs = np.minimum(self._friction * normal, size)
            new = normal * n + along * (rubs / np.where(size > 0.0, size, 1.0))
            more = new + ahead * (new - impulse) - at
            impulse[:] = new
            at += more
            # what one body does at a node, the other does with the opposite sign
            velocities[i][k] -= more / a
            velocities[j][k] += more / b
        return [V - old for V, old in zip(velocities, before)]


def _unit(vectors: Array) -> Array:
    size = np.linalg.norm(vectors, axis=1)[:, None]
    return vectors / np.where(size > 0.0, size, 1.0)
