"""Where an explicit step is not smooth: what touches, slips, closes or turns round in it."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from dolfinmpm.basis import LatticeBasis, LeafBasis, LinearBasis
from dolfinmpm.contact.activerigidcontact import ActiveRigidContact
from dolfinmpm.contact.contactlaw import FREE, SHEARS, SLIPS

__all__ = ["Kinks"]

Array = npt.NDArray[np.float64]
Numbers = npt.NDArray[np.int64]

# What counts as rounding: velocities relative to the fastest node, gaps to their closing, viscous
# pressures to the largest one
_ROUNDING = 1e-12

COLLIDING = "nodes of colliding bodies begin or end to touch or slip"
AT_SIDES = "nodes at frictional sides begin or end to touch or slip"
CORNERS = "contact points begin or end to touch or slip"
AT_LIMIT = "contact points reach or leave their largest shear stress"
DAMPED = "nodes under local damping change the direction of their velocity"
CLOSING = "points under bulk viscosity begin or end to close"


class Kinks:
    """What is on which side of a kink, in all explicit steps since `begin`.

    Two runs with the same sets go the same smooth way. Every exchange of momentum has kinks of its
    own, also one that a later exchange takes back.

    Attributes:
        sets: Words for what may change → sets of numbers of nodes, points or corners, in the order
            of the steps. Each rank has its own nodes and points.
    """

    def __init__(self) -> None:
        self.sets: dict[str, list[Numbers]] = {}
        self._numbers: Numbers = np.empty(0, np.int64)

    def begin(self) -> None:
        """Forget the sets."""
        self.sets = {}

    def begin_step(self, basis: LatticeBasis | LinearBasis | LeafBasis) -> None:
        """Number the nodes of a step.

        Args:
            basis: The basis.
        """
        self._numbers = np.arange(basis.nodes.size, dtype=np.int64)
        if isinstance(basis, LatticeBasis):
            # the same on any partition of the grid
            shape = np.add(basis.lattice.shape, basis.degree)
            ijk = tuple(basis.halo.node_ijk.T.astype(np.int64))
            self._numbers = np.asarray(np.ravel_multi_index(ijk, tuple(shape)), np.int64)
        # nodes of other ranks
        self._numbers[basis.nodes.owned :] = -1

    def add_nodes(
        self, what: str, nodes: npt.NDArray[np.intp], approach: Array, slip: Array, speed: float
    ) -> None:
        """Add the nodes at which momentum is exchanged.

        Args:
            what: `COLLIDING` or `AT_SIDES`.
            nodes: The nodes, shape (m,).
            approach: Speed that the normal impulse stops (m/s), shape (m,).
            slip: Speed that friction leaves (m/s), shape (m,); 0 without friction, where nodes
                slip at all times.
            speed: Largest component of a velocity at the nodes (m/s).
        """
        numbers, least = self._numbers[nodes], _ROUNDING * speed
        touch = (approach > least) & (numbers >= 0)
        self._add(what, numbers[touch], numbers[touch & (slip > least)])

    def add_corners(self, active: ActiveRigidContact, ends: bool) -> None:
        """Add the corners that touch a rigid body, that touch for part of a step, and that slip.

        Args:
            active: The contact.
            ends: Whether its forces are those at the end of a step. At the start, corners that
                slipped before are at the limit of friction.
        """
        points, corners, now = active.contact.points, active.corners, active.now
        per_point = points[active.contact.names.normal_force].shape[1]
        numbers = points["id"][corners.rows].astype(np.int64) * per_point + corners.which
        # a corner just outside at the end of a step touches for all of the next one but rounding
        with np.errstate(invalid="ignore"):
            partly = np.abs(now.gap) < (1.0 + _ROUNDING) * np.abs(now.closed)
        touch = (now.states != FREE) & (np.abs(now.gap) > _ROUNDING * np.abs(now.closed))
        self._add(CORNERS, numbers[touch], numbers[touch & partly])
        if ends:
            self._add(CORNERS, numbers[touch & (now.states >= SLIPS)])
            self._add(AT_LIMIT, numbers[touch & (now.states == SHEARS)])

    def add_damped(self, V: Array) -> None:
        """Add the velocities of nodes that local damping resists (m/s), shape (nodes, d)."""
        d = V.shape[1]
        least = _ROUNDING * float(np.abs(V).max(initial=0.0))
        rows, k = np.nonzero(V + least < 0.0)
        numbers = self._numbers[rows]
        self._add(DAMPED, (numbers * d + k)[numbers >= 0])

    def add_closing(self, ids: Numbers, pressure: Array) -> None:
        """Add the points with a viscous pressure.

        Args:
            ids: Numbers of the points, shape (n,).
            pressure: Viscous pressure times volume (N m), shape (n,).
        """
        size = np.abs(pressure)
        self._add(CLOSING, ids[size > _ROUNDING * size.max(initial=0.0)])

    def _add(self, what: str, *sets: Numbers) -> None:
        self.sets.setdefault(what, []).extend(np.sort(numbers) for numbers in sets)
