"""Bodies that collide at the nodes of the grid: Bardenhagen's contact.

Each body has its own masses and momenta at the nodes. Two bodies touch at a node if three
conditions hold: they share the node, they fill the room of its function, and they approach each
other along the normal n. They then exchange momentum until both have the velocity v̄ of their
common centre of mass along n. Friction acts along the slip, with its direction t:

    v_a −= [(v_a − v̄)·n] (n + μ' t),    μ' = min(μ, |(v_a − v̄)_t| / (v_a − v̄)·n)

(Bardenhagen et al. 2001, CMES 2, 509). Momentum is conserved, because both bodies have the same n:
the direction of V_a ∇m_a/m_a − V_b ∇m_b/m_b, where ∇m_a = Σ m ∇N points out of a body.

Without the second condition, bodies feel each other as soon as they share a node, up to two cells
before they touch. With the second condition, the volumes Σ V N of both bodies at the node must
reach the integral of its function. A gap on either side of the node leaves room there.

In "musl", bodies move and strain by the velocities that their points map to the nodes at the end of
a step. These velocities may still approach each other: a node's impulse reaches them only through
the points, and the points share it with nodes around. Pressed bodies would then penetrate each
other, and the impulses would drive them apart later. Collisions of coarse bodies gained up to 20 %
of their energy in this way.

So the impulses are chosen such that the mapped velocities v* do not approach. This takes several
passes. Each pass adds the momentum above, computed from v*. The passes converge because the
points' mass matrix is at most the lumped one. Impulses J change the points' energy by
J · (v + v*)/2, with the bodies' relative velocities v at the start of the step and v* at its end.
They dissipate energy where bodies meet, and make none where bodies stay in contact.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass
from itertools import combinations

import numpy as np
import numpy.typing as npt

from dolfinmpm._platform.argumentchecks import shown, truth
from dolfinmpm._platform.errors import ParameterError
from dolfinmpm._platform.uncopied import unchanged
from dolfinmpm._platform.units import LARGEST_FRICTION, friction_coefficient
from dolfinmpm.cut.activation import Activation
from dolfinmpm.dynamics.facesatnodes import Faces
from dolfinmpm.dynamics.kinks import COLLIDING, Kinks

__all__ = ["BodiesAtSides", "BodyAtNodes", "Collision", "NodalContact"]

Array = npt.NDArray[np.float64]

# Largest empty share of a node's room where bodies touch, because surfaces are curved
_ROOM = 0.02
# ... and at most this share of the volume of the smaller body at the node
_LEFT = 0.25


@unchanged()
@dataclass(frozen=True)
class Collision:
    """Contact of bodies at the grid's nodes, for `Explicit`.

    Args:
        tags: Tag of the points of each body, for at least two bodies. A body with several tags has
            a tuple of tags.
        friction: Coefficient μ of Coulomb's friction.
        gap_test: True: bodies touch only where they leave no room between them at a node. False:
            bodies touch as soon as they share a node. Then energy may grow on coarse grids.

    Raises:
        ParameterError: An argument has the wrong type or a value outside its range.

    The first body pushes the second:

    >>> import dolfinmpm as mpm
    >>> from mpi4py import MPI
    >>> grid = mpm.create_lattice(MPI.COMM_WORLD, [range(5), range(5)])
    >>> first = mpm.fill(grid, mpm.Box((0, 0), (1, 2)), per_cell=2, density=2000.0, tag=1)
    >>> points = first + mpm.fill(grid, mpm.Box((1, 0), (2, 2)), per_cell=2, density=2000.0, tag=2)
    >>> V = mpm.Space(grid, "gimp")
    >>> F = mpm.momentum(mpm.materials.Hencky(1e6, 0.3), points, V.increment, V.test)
    >>> touch = mpm.Collision((1, 2), friction=0.3)
    >>> problem = mpm.Explicit(F, V.increment, points, collision=touch)
    >>> points["velocity"][points["tag"] == 1] = (1.0, 0.0)
    >>> record = problem.step(0.1)
    >>> bool(points["velocity"][points["tag"] == 2, 0].mean() > 0.0)
    True
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
        """Masks of the points of each body, by their tags, shape (points,) each."""
        return [np.isin(tags, body) for body in self.tags]


@dataclass
class BodyAtNodes:
    """Nodal sums of one body.

    Attributes:
        mass: Mass (kg), shape (nodes,).
        volume: Volume (m^d), shape (nodes,).
        slope: Σ m ∇N (kg/m), shape (nodes, d), which points out of the body.
    """

    mass: Array
    volume: Array
    slope: Array

    @property
    def divisor(self) -> Array:
        """What divides momenta to give velocities (kg), shape (nodes, 1): the mass, or infinity."""
        return np.where(self.mass > 0.0, self.mass, np.inf)[:, None]


class NodalContact:
    """Nodes at which bodies touch in a step, and the momentum exchanged there.

    Args:
        bodies: The bodies.
        room: Integrals of the nodes' functions (m^d), shape (nodes,), or None without a gap test.
        friction: μ.
        kinks: Where the nodes that touch and slip are kept, or None.
    """

    def __init__(
        self, bodies: Sequence[BodyAtNodes], room: Array | None, friction: float,
        kinks: Kinks | None = None,
    ):  # fmt: skip
        self._bodies, self._friction, self._kinks = bodies, friction, kinks
        self._pairs: list[tuple[int, int, npt.NDArray[np.intp], Array, Array, Array]] = []
        for i, j in combinations(range(len(bodies)), 2):
            a, b = bodies[i], bodies[j]
            both = (a.mass > 0.0) & (b.mass > 0.0)
            if room is not None:
                left = room - sum(body.volume for body in bodies)
                # beside a surface, a node has very little of one body; then no gap is small enough
                both &= left <= np.minimum(_ROOM * room, _LEFT * np.minimum(a.volume, b.volume))
            k = np.flatnonzero(both)
            # weights by volume: if one body ends beside the node, the other's surface counts more
            share = [body.slope[k] * (body.volume[k] / body.mass[k])[:, None] for body in (a, b)]
            n = _unit(share[0] - share[1])
            self._pairs.append((i, j, k, n, np.zeros_like(n), np.zeros_like(n)))

    @property
    def nodes(self) -> npt.NDArray[np.bool_]:
        """Mask of the nodes at which bodies touch, shape (nodes,)."""
        found = np.zeros(len(self._bodies[0].mass), bool)
        for _, _, k, *_ in self._pairs:
            found[k] = True
        return found

    @property
    def received(self) -> Array:
        """Momentum received by the first body (kg m/s), shape (nodes, d)."""
        found = np.zeros_like(self._bodies[0].slope)
        for i, _, k, _, impulse, _ in self._pairs:
            if i == 0:
                found[k] -= impulse
        return found

    def losses(
        self,
        before: Sequence[Array],
        strains: Sequence[Array],
        share: float,
        owned: slice | npt.NDArray[np.integer],
    ) -> tuple[float, float]:
        """Energy taken by the exchanges of a step at nodes of this rank (J).

        Friction works on the velocities that strain the bodies, as stresses do. All impulses J take
        J · (v + v*)/2, with the relative velocities v and v* of the bodies. The remainder is the
        loss by the impact.

        Args:
            before: Velocities of each body at the start of the step (m/s), shape (nodes, d) each.
            strains: Velocities by which each body strains (m/s), likewise.
            share: Length of the step over the time during which forces act.
            owned: Nodes of this rank.

        Returns:
            Loss by friction, and loss by the impact.
        """
        friction = whole = 0.0
        mine = np.zeros(len(self._bodies[0].mass), bool)
        mine[owned] = True
        for i, j, k, n, impulse, _ in self._pairs:
            own = mine[k]
            J, n = impulse[own], n[own]
            start, end = ((V[i][k] - V[j][k])[own] for V in (before, strains))
            if self._friction:
                along = J - np.sum(J * n, axis=1, keepdims=True) * n
                friction += share * float(np.sum(along * end))
            whole += 0.5 * float(np.sum(J * (start + end)))
        return friction, whole - friction

    def exchange(self, velocities: Sequence[Array], ahead: float = 0.0) -> list[Array]:
        """Exchange the momentum that stops the approach of bodies. Changes the velocities.

        The exchanges of one step add up. A later exchange may take back momentum of an earlier one.
        But their sum never pulls bodies together, and never exceeds the limit of friction.

        Args:
            velocities: Velocities of each body (m/s), shape (nodes, d) each.
            ahead: Share of the impulses' change by which the velocities are extrapolated, to speed
                up the passes (Nesterov 1983); 0 in the last pass.

        Returns:
            Change of the velocities of each body (m/s), shape (nodes, d) each.
        """
        before = [V.copy() for V in velocities]
        for i, j, k, n, impulse, at in self._pairs:
            a, b = self._bodies[i].mass[k, None], self._bodies[j].mass[k, None]
            shared = a * b / (a + b)
            wanted = at + shared * (velocities[i][k] - velocities[j][k])
            normal = np.sum(wanted * n, axis=1, keepdims=True)
            along = wanted - normal * n
            normal = np.maximum(normal, 0.0)
            size = np.linalg.norm(along, axis=1, keepdims=True)
            # nothing rubs where no body pushes, also with an infinite μ
            rubs = np.minimum(min(self._friction, LARGEST_FRICTION) * normal, size)
            if self._kinks is not None:
                speed = max(float(np.abs(V).max(initial=0.0)) for V in before)
                # without friction all nodes slip at all times
                slips = (size - rubs if self._friction else 0.0 * size) / shared
                approach = (normal / shared)[:, 0]
                self._kinks.add_nodes(COLLIDING, k, approach, slips[:, 0], speed)
            new = normal * n + along * (rubs / np.where(size > 0.0, size, 1.0))
            more = new + ahead * (new - impulse) - at
            impulse[:] = new
            at += more
            # impulses on both bodies are opposite
            velocities[i][k] -= more / a
            velocities[j][k] += more / b
        return [V - old for V, old in zip(velocities, before)]


def _unit(vectors: Array) -> Array:
    size = np.linalg.norm(vectors, axis=1)[:, None]
    return vectors / np.where(size > 0.0, size, 1.0)


class BodiesAtSides:
    """What conditions and sides of the grid do to the nodes of each body in an explicit step.

    Args:
        faces: Sides that act on the bodies, or None.
        bodies: Nodal sums of each body.
        here: The activation.
        prescribed: Prescribed velocities (m/s), shape (nodes, d).
        kick: Time during which forces act (s).
        kinks: Where the nodes that touch and slip are kept, or None.
    """

    def __init__(
        self,
        faces: Faces | None,
        bodies: Sequence[BodyAtNodes],
        here: Activation,
        prescribed: Array,
        kick: float,
        kinks: Kinks | None,
    ):
        unknowns = here.unknowns.fields[0]
        self._faces, self._bodies, self._prescribed = faces, bodies, prescribed
        self._kick, self._kinks = kick, kinks
        self._fixed, self._owned = unknowns.fixed, unknowns.owned_nodes
        self._moving = np.zeros_like(self._fixed)
        if here.driven:
            own = self._owned
            self._moving[own] = self._fixed[own] & (prescribed[own] != 0.0)
        # velocities taken by frictional sides, and by dashpots
        self._stopped: list[Array] = [np.zeros_like(prescribed) for _ in bodies]
        self._absorbed: list[Array] = []

    def constrain(self, velocities: Sequence[Array]) -> None:
        """Set the velocities of prescribed components (m/s), shape (nodes, d) per body."""
        for V in velocities:
            V[self._fixed] = self._prescribed[self._fixed]

    def absorb(self, before: Sequence[Array], velocities: Sequence[Array]) -> None:
        """Apply dashpots. Bodies at one node share a dashpot in proportion to their masses.

        Args:
            before: Velocities of each body at the start of the step (m/s), likewise.
            velocities: Velocities of each body (m/s), shape (nodes, d) each. Changed.
        """
        if self._faces is None or self._faces.dashpots is None:
            return
        m = sum(body.mass for body in self._bodies)
        rate = self._kick * self._faces.dashpots / np.where(m > 0.0, m, np.inf)[:, None]
        for V_start, V in zip(before, velocities):
            V -= 0.5 * rate * V_start
            V /= 1.0 + 0.5 * rate
            # no side acts on what a condition holds
            mean = 0.5 * (V_start + V)
            self._absorbed.append(np.where(self._fixed, 0.0, rate * mean))

    def stop(self, velocities: Sequence[Array]) -> float:
        """Apply frictional sides and conditions.

        A second call in a step acts on what both calls have found: its friction may reach the limit
        by the whole impulse of the side.

        Args:
            velocities: Velocities of each body at the end of the step (m/s), shape (nodes, d) each.
                Changed.

        Returns:
            Work of the prescribed motions at nodes of this rank (J).
        """
        work, moving, prescribed = 0.0, self._moving, self._prescribed
        for body, V, stopped in zip(self._bodies, velocities, self._stopped):
            if self._faces is not None:
                V += stopped
                stopped[:] = V
                self._faces.apply_friction(V, self._kinks)
                stopped -= V
                stopped[self._fixed] = 0.0
            m = np.broadcast_to(body.mass[:, None], V.shape)[moving]
            work += float(np.sum(m * (prescribed[moving] - V[moving]) * prescribed[moving]))
        self.constrain(velocities)
        return work

    def constrain_stopped(self, mapped: Sequence[Array]) -> None:
        """Hold nodes that frictional sides have stopped, see `Faces.constrain_stopped`.

        Args:
            mapped: Velocities mapped from the points of each body (m/s), shape (nodes, d) each.
                Changed.
        """
        if self._faces is None:
            return
        for V, stopped in zip(mapped, self._stopped):
            self._faces.constrain_stopped(stopped, V, self._kinks)
        self.constrain(mapped)

    def losses(self, strains: Sequence[Array], dt: float) -> Array:
        """Works taken by frictional sides and by dashpots, at nodes of this rank (J), shape (2,).

        Args:
            strains: Velocities by which each body strains (m/s), shape (nodes, d) each.
            dt: Length of the step (s).
        """
        taken = np.zeros(2)
        for k, arrays in enumerate((self._stopped, self._absorbed)):
            for body, V, one in zip(self._bodies, strains, arrays):
                taken[k] += np.sum((body.mass[:, None] * one * V)[self._owned])
        return dt / self._kick * taken
