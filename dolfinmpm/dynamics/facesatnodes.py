"""Faces of the grid in the numbering of a basis: friction, dashpots and waves at nodes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from dolfinmpm.basis import LeafBasis
from dolfinmpm.body.axisymmetry import ring
from dolfinmpm.cut.essentialconditions import nodes_at_side, renumbered
from dolfinmpm.dynamics.groundcolumn import ColumnAtSide
from dolfinmpm.dynamics.incomingwaves import IncomingWaves
from dolfinmpm.dynamics.kinks import AT_SIDES, Kinks
from dolfinmpm.dynamics.sideareas import areas, radii

__all__ = ["Faces"]

Array = npt.NDArray[np.float64]


def _nodes(face: Any, basis: Any) -> npt.NDArray[np.intp]:
    """Nodes of a basis at a face, among all nodes that this rank knows, shape (n,). Collective."""
    if isinstance(basis, LeafBasis):
        # nodes that hang at the side have no velocities of their own: they follow others there
        return nodes_at_side(basis, face.axis, face.end).astype(np.intp)
    base = face.space.basis
    marks = np.zeros(base.nodes.size)
    marks[face.nodes] = 1.0
    return np.flatnonzero(renumbered(marks, base, basis))


class Faces:
    """Faces of the grid in the numbering of a basis. Collective.

    Args:
        faces: The faces, see `dolfinmpm.dynamics.faces.Face`.
        basis: Basis, with the overlap for steps.
        d: Dimension of space.
        axisymmetric: Whether points and faces are axisymmetric.
        box: Ends of the body at the start (m), shape (2, d), for columns beside it.

    Attributes:
        dashpots: Coefficients of the dashpots (N s/m), shape (nodes, d), or None without any.
        waves: Waves that come in.
    """

    def __init__(
        self, faces: Sequence[Any], basis: Any, d: int, axisymmetric: bool = False,
        box: Array | None = None,
    ):  # fmt: skip
        self._d, self._basis, self._axisymmetric = d, basis, axisymmetric
        self._rubbing: list[tuple[npt.NDArray[np.intp], int, float, float]] = []
        self._absorbing: list[tuple[Any, npt.NDArray[np.intp]]] = []
        self.dashpots: Array | None = None
        self.waves = IncomingWaves(basis.nodes.size, d)
        self._columns: list[tuple[int, int, ColumnAtSide]] = []
        for face in faces:
            nodes = _nodes(face, basis)
            if face.friction is not None:
                outward = 1.0 if face.end else -1.0
                self._rubbing.append((nodes, face.axis, outward, face.friction))
            if face.impedance is not None:
                self._absorbing.append((face, nodes))
            if face.column is not None:
                assert box is not None
                column = ColumnAtSide(face.column, basis, face.axis, face.end, box)
                self._columns.append((face.axis, face.end, column))
        self.waves.beside = [column for _, _, column in self._columns]
        self._damp({})

    def _damp(self, within: dict[int, tuple[float, float]]) -> None:
        """Compute dashpots and waves of absorbing faces; see `areas` for the argument."""
        if self._absorbing or self._columns:
            self.dashpots = np.zeros((self._basis.nodes.size, self._d))
        self.waves.clear()
        for face, nodes in self._absorbing:
            area = areas(self._basis, nodes, face.axis, within)
            if self._axisymmetric:
                area = ring(radii(self._basis, nodes, face.axis, face.end), area)
            for k in range(self._d):
                rate = face.impedance[0 if k == face.axis else 1]
                assert self.dashpots is not None
                self.dashpots[nodes, k] += rate * area
                if face.incoming is not None and face.incoming[k] is not None:
                    self.waves.add(nodes, k, rate * area, face.incoming[k])

    def follow(self, t: float) -> None:
        """Move the sides beside columns of ground to where these are at a time (s).

        Other sides then end where the ground beside them begins.
        """
        if not self._columns:
            return
        within = {}
        for axis in {axis for axis, _, _ in self._columns}:
            line = self._basis.lattice.lines[axis]
            ends = [float(line[0]), float(line[-1])]
            for k, end, column in self._columns:
                if k == axis:
                    ends[end] = column.edge(t)
            within[axis] = ends[0], ends[1]
        self._damp(within)
        assert self.dashpots is not None
        for _, _, column in self._columns:
            nodes, rates = column.place(t)
            self.dashpots[nodes] += rates

    def by_nodes(
        self, place: npt.NDArray[np.intp], size: int
    ) -> tuple[npt.NDArray[np.uint64], Array, Array, Array]:
        """The faces for compiled loops over nodes in another order.

        Args:
            place: Position of each node in the other order, shape (nodes,); -1 if unknown.
            size: Number of nodes in the other order.

        Returns:
            Frictional faces at each node, as bits, shape (size,), or (0,) without such faces.
            Axis, outward sign and friction of each face, shape (faces, 3). Coefficients of the
            dashpots (N s/m), shape (size, d), or (0, d) without dashpots. Room for the momentum
            that frictional faces take in a step (kg m/s), likewise.
        """
        marks = np.zeros(size if self._rubbing else 0, np.uint64)
        rubbing = np.array([one[1:] for one in self._rubbing]).reshape(-1, 3)
        for k, (nodes, *_) in enumerate(self._rubbing):
            rows = place[nodes]
            marks[rows[rows >= 0]] |= np.uint64(1 << k)
        dashpots = np.zeros((0 if self.dashpots is None else size, self._d))
        if self.dashpots is not None:
            dashpots[place[place >= 0]] = self.dashpots[place >= 0]
        return marks, rubbing, dashpots, np.zeros((marks.size, self._d))

    def rub(self, V: Array, kinks: Kinks | None = None) -> None:
        """Stop nodes that would move out, and apply friction to sliding nodes.

        Args:
            V: Velocities at the end of a step (m/s), shape (nodes, at least d). Changed.
            kinks: Where the nodes that touch and slip are kept, or None.
        """
        speed = 0.0 if kinks is None else float(np.abs(V).max(initial=0.0))
        for rows, axis, outward, mu in self._rubbing:
            out = outward * V[rows, axis]
            rows, out = rows[out > 0], out[out > 0]
            V[rows, axis] = 0.0
            along = [k for k in range(V.shape[1]) if k != axis]
            sliding = np.sqrt(sum(V[rows, k] ** 2 for k in along)) if along else out
            left = np.maximum(0.0, 1.0 - mu * out / np.maximum(sliding, 1e-300))
            if kinks is not None:
                kinks.add_nodes(AT_SIDES, rows, out, sliding * left if mu else 0.0 * out, speed)
            for k in along:
                V[rows, k] *= left

    def settle(self, taken: Array, mapped: Array, kinks: Kinks | None = None) -> None:
        """Hold nodes that the faces have stopped.

        Points around a stopped node move, and map a velocity to it. A body that strained by this
        velocity would make energy: the node's forces and the face balance, and do no work. A face
        holds by no more than the impulse that it has given, and friction by what it has left.

        Args:
            taken: What `rub` has taken from the velocities of the nodes (m/s), shape (nodes, d).
            mapped: Velocities of the points, mapped to the nodes (m/s), likewise. Changed.
            kinks: See `rub`.
        """
        speed = 0.0 if kinks is None else float(np.abs(mapped).max(initial=0.0))
        for rows, axis, outward, mu in self._rubbing:
            out = outward * taken[rows, axis]
            rows, out = rows[out > 0], out[out > 0]
            normal = mapped[rows, axis]
            mapped[rows, axis] -= np.clip(normal, -out, out)
            along = [k for k in range(mapped.shape[1]) if k != axis]
            size, rubbed = (np.linalg.norm(v[rows][:, along], axis=1) for v in (mapped, taken))
            grip = np.maximum(mu * out - rubbed, 0.0)
            if kinks is not None:
                kinks.add_nodes(AT_SIDES, rows, out - np.abs(normal), size - grip, speed)
            left = np.maximum(0.0, 1.0 - grip / np.maximum(size, 1e-300))
            for k in along:
                mapped[rows, k] *= left
