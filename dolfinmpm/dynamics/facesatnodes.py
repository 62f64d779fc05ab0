"""Faces of the grid in the numbering of a basis: friction, dashpots and waves at nodes.

Beyond an absorbing side the ground goes on as an elastic half-space. An upward wave in it with the
velocity v_up pushes the side, so that the traction of the dashpots becomes ρ c (2 v_up − v)
(Lysmer & Kuhlemeyer 1969; Joyner & Chen 1975, Bull. Seism. Soc. Am. 65, 1315).
"""

from __future__ import annotations

import weakref
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm._platform.errors import ParameterError
from dolfinmpm.basis import LeafBasis
from dolfinmpm.basis.conditions import Condition
from dolfinmpm.body.axisymmetry import ring
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.cut.conditionsonleaves import nodes_at_side
from dolfinmpm.cut.essentialconditions import renumbered
from dolfinmpm.cut.tiedsides import TiedSides
from dolfinmpm.dynamics.groundcolumn import ColumnAtSide
from dolfinmpm.dynamics.kinks import AT_SIDES, Kinks
from dolfinmpm.dynamics.sideareas import CoveredSide, areas, at_independent, check_beyond, radii
from dolfinmpm.grid.userfunctions import VelocityByTime
from dolfinmpm.solve.step import Step

__all__ = ["Faces", "Sides", "has_columns"]

Array = npt.NDArray[np.float64]
Nodes = npt.NDArray[np.intp]


def has_columns(faces: Sequence[Any]) -> bool:
    """Whether a column of ground is beside one of some faces."""
    return any(face.column is not None for face in faces)


def _refuse_idle(face: Any, conditions: Sequence[Condition]) -> None:
    """Raise ParameterError if conditions hold all that a face would act on. Collective."""
    constrained: dict[int, str] = {}
    for condition in conditions:
        if condition.space is face.space:
            free = bool(np.setdiff1d(face.nodes, condition.nodes).size)
            if not face.space.grid.comm.allreduce(free, op=MPI.LOR):
                constrained.setdefault(condition.component, condition.where)
    for component, where in constrained.items():
        if face.damps(component):
            raise ParameterError(
                f"the absorbing face at '{face.where}' damps velocities in the direction "
                f"{component}, and the condition at '{where}' holds them there, so that it would "
                "do nothing: leave out one of both"
            )
    if face.friction and constrained.keys() >= set(range(face.space.components)) - {face.axis}:
        raise ParameterError(
            f"the frictional face at '{face.where}' rubs against what slides along it, and "
            "conditions hold the nodes there, so that it would do nothing: leave out one of both"
        )


class Sides:
    """Faces of the grid in any numbering of the nodes.

    Args:
        faces: The faces.
        points: Material points on which the faces act.
        conditions: Essential conditions of the problem.
        prolongation: The argument of the problem.
        form: The compiled weak form of the problem.

    Raises:
        ParameterError: A condition constrains all nodes of a face in a direction of its damping.
            Or two faces are at one side. Or a column of ground has other heights than the body. Or
            the ground beyond an absorbing side is far lighter than the body, or its waves are far
            slower.
    """

    def __init__(
        self, faces: Sequence[Any], points: MaterialPoints, conditions: Sequence[Condition] = (),
        prolongation: Any = None, form: Any = None,
    ):  # fmt: skip
        for k, face in enumerate(faces):
            others = {other.kind for other in faces[:k] if face.same_as(other)}
            if others:
                where = "twice" if face.kind in others else f"beside the {others.pop()} one"
                raise ParameterError(
                    f"the {face.kind} face at '{face.where}' is there {where}, and both would "
                    "act: leave one out"
                )
            _refuse_idle(face, conditions)
        check_beyond(faces, points, () if form is None else form.parts.declarations)
        self._faces, self._points = list(faces), points
        self._tied = prolongation if isinstance(prolongation, TiedSides) else None
        self._box: Array = np.zeros((2, points.gdim))
        if has_columns(faces):
            self._box = _ends(points)
            for face in faces:
                if face.column is not None:
                    face.column.check_beside(points, face, self._box)
        # a basis belongs to one partition of the lattice
        self._on: weakref.WeakKeyDictionary[Any, Faces] = weakref.WeakKeyDictionary()

    def __len__(self):
        return len(self._faces)

    @property
    def frictional(self) -> bool:
        """Whether bodies touch and leave a face, and rub along it."""
        return any(face.friction is not None for face in self._faces)

    @property
    def incoming(self) -> bool:
        """Whether waves come in through a face."""
        return any(face.incoming is not None for face in self._faces) or has_columns(self._faces)

    @property
    def waves(self) -> list[tuple[str, Any]]:
        """Name and velocity by time (m/s) of each wave that comes in."""
        return [
            (f"wave {k + 1} at '{face.where}'", wave)
            for face in self._faces
            for k, wave in enumerate(face.incoming or ())
            if wave is not None
        ]

    def regrid(self) -> None:
        """Discard areas that depend on the old grid lines."""
        self._on.clear()

    def on(self, basis: Any, step: Step | None = None, C: Any = None) -> Faces | None:
        """The faces in a basis's numbering, or None without faces. The first call is collective.

        Args:
            basis: The basis.
            step: A step that begins, which is collective, or None within a step.
            C: For a step that begins: matrix from the independent nodes to all nodes, or None.
        """
        if not self._faces:
            return None
        if basis not in self._on:
            own = self._points.gdim, self._points.axisymmetric, self._box
            repeated = {} if self._tied is None else {self._tied.axis: self._tied.count}
            self._on[basis] = Faces(self._faces, basis, *own, repeated)
        if step is not None:
            # nodes of tied sides have whole areas, whichever of them is independent
            self._on[basis].begin(step, self._points, C if self._tied is None else None)
        return self._on[basis]


def _ends(points: MaterialPoints) -> Array:
    """Ends of a body (m), shape (2, d). Collective.

    Raises:
        ParameterError: The points are axisymmetric.
    """
    if points.axisymmetric:
        raise ParameterError("free-field sides are for plane strain and 3D, not axisymmetry")
    x, half = points["x"], points["l"]
    ends = np.array([-(x - half), x + half]).max(axis=1, initial=-np.inf)
    points.comm.Allreduce(MPI.IN_PLACE, ends, op=MPI.MAX)
    ends[0] *= -1.0
    return ends


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
        repeated: Cells in a period of the body, by direction in which it repeats itself.

    Attributes:
        dashpots: Coefficients of the dashpots (N s/m), shape (nodes, d), or None without any.
    """

    def __init__(
        self, faces: Sequence[Any], basis: Any, d: int, axisymmetric: bool = False,
        box: Array | None = None, repeated: Mapping[int, int] | None = None,
    ):  # fmt: skip
        self._d, self._basis, self._axisymmetric = d, basis, axisymmetric
        self._frictional: list[tuple[Nodes, int, float, float]] = []
        self._absorbing: list[tuple[Any, Nodes]] = []
        self.dashpots: Array | None = None
        # direction, dashpots at all nodes and velocity of each wave
        self._waves: list[tuple[int, Array, VelocityByTime]] = []
        self._columns: list[tuple[int, int, ColumnAtSide]] = []
        self._covered: list[CoveredSide] = []
        self._shares: list[Array | None] = []
        for face in faces:
            nodes = _nodes(face, basis)
            if face.friction is not None:
                outward = 1.0 if face.end else -1.0
                self._frictional.append((nodes, face.axis, outward, face.friction))
            if face.impedance is not None:
                self._absorbing.append((face, nodes))
                self._covered.append(CoveredSide(basis, face.axis, face.end, repeated or {}))
                self._shares.append(None)
            if face.column is not None:
                assert box is not None
                column = ColumnAtSide(face.column, basis, face.axis, face.end, box)
                self._columns.append((face.axis, face.end, column))
        self._damp({})

    def _damp(self, within: dict[int, tuple[float, float]]) -> None:
        """Compute dashpots and waves of absorbing faces; see `areas` for the argument."""
        size = self._basis.nodes.size
        if self._absorbing or self._columns:
            self.dashpots = np.zeros((size, self._d))
        self._waves.clear()
        for (face, nodes), side, shares in zip(self._absorbing, self._covered, self._shares):
            if shares is None:
                area = areas(self._basis, nodes, face.axis, within)
            else:
                area = side.areas(shares, nodes)
            if self._axisymmetric:
                area = ring(radii(self._basis, nodes, face.axis, face.end), area)
            for k in range(self._d):
                rate = face.impedance[0 if k == face.axis else 1]
                assert self.dashpots is not None
                self.dashpots[nodes, k] += rate * area
                if face.incoming is not None and face.incoming[k] is not None:
                    c = np.zeros(size)
                    c[nodes] = rate * area
                    self._waves.append((k, c, face.incoming[k]))

    @property
    def incoming(self) -> bool:
        """Whether waves come in, or columns of ground push."""
        return bool(self._waves or self._columns)

    def wave_forces(self, t: float) -> Array:
        """Forces 2 c v_up of the waves, and of columns, at time t (N), shape (nodes, d)."""
        out = np.zeros((self._basis.nodes.size, self._d))
        for k, c, wave in self._waves:
            out[:, k] += 2.0 * c * wave(t)
        for _, _, column in self._columns:
            nodes, pushes = column.forces(t)
            out[nodes] += pushes
        return out

    def cover(self, points: MaterialPoints, C: Any = None) -> bool:
        """Give dashpots to what the body covers of absorbing faces. Collective.

        Args:
            points: Material points.
            C: Matrix from the independent nodes to all nodes, or None.

        Returns:
            Whether dashpots have changed.
        """
        if self._d == 1 or not self._absorbing:
            return False
        shares = [side.shares(points) for side in self._covered]
        same = all(map(_equal, shares, self._shares))
        if C is None and same:
            return False
        self._shares = shares
        self._damp({})
        if C is not None:
            assert self.dashpots is not None
            self.dashpots = at_independent(self.dashpots, self._basis, C)
            self._waves = [
                (k, at_independent(c[:, None], self._basis, C)[:, 0], wave)
                for k, c, wave in self._waves
            ]
        return True

    def begin(self, step: Step, points: MaterialPoints, C: Any = None) -> None:
        """Begin a step: find what the body covers, check what it misses of waves. Collective.

        Sides beside columns of ground move. Other sides then end where that ground begins.

        Args:
            step: The step.
            points, C: See `cover`.
        """
        start = step.start
        for _, _, wave in self._waves:
            wave.check_step(start, step.t)
        if not self._columns:
            self.cover(points, C)
            return
        within = {}
        for axis in {axis for axis, _, _ in self._columns}:
            line = self._basis.lattice.lines[axis]
            ends = [float(line[0]), float(line[-1])]
            for k, end, column in self._columns:
                if k == axis:
                    ends[end] = column.edge(start)
            within[axis] = ends[0], ends[1]
        self._damp(within)
        assert self.dashpots is not None
        for _, _, column in self._columns:
            nodes, rates = column.place(start)
            self.dashpots[nodes] += rates

    def by_nodes(
        self, place: npt.NDArray[np.intp], size: int
    ) -> tuple[npt.NDArray[np.uint64], Array, Array, Array, Array]:
        """The faces for compiled loops over nodes in another order.

        Args:
            place: Position of each node in the other order, shape (nodes,); -1 if unknown.
            size: Number of nodes in the other order.

        Returns:
            Frictional faces at each node, as bits, shape (size,), or (0,) without such faces.
            Axis, outward sign and friction of each face, shape (faces, 3). Coefficients of the
            dashpots (N s/m), shape (size, d), or (0, d) without dashpots. Room for the momentum
            that frictional faces take in a step (kg m/s), likewise. Room for half of the momentum
            that damping and dashpots take (kg m/s), shape (size, d).
        """
        marks = np.zeros(size if self._frictional else 0, np.uint64)
        friction = np.array([one[1:] for one in self._frictional]).reshape(-1, 3)
        for k, (nodes, *_) in enumerate(self._frictional):
            rows = place[nodes]
            marks[rows[rows >= 0]] |= np.uint64(1 << k)
        dashpots = np.zeros((0 if self.dashpots is None else size, self._d))
        if self.dashpots is not None:
            dashpots[place[place >= 0]] = self.dashpots[place >= 0]
        taken, resisted = (np.zeros((n, self._d)) for n in (marks.size, size))
        return marks, friction, dashpots, taken, resisted

    def apply_friction(self, V: Array, kinks: Kinks | None = None) -> None:
        """Stop nodes that would move out, and apply friction to sliding nodes.

        Args:
            V: Velocities at the end of a step (m/s), shape (nodes, at least d). Changed.
            kinks: Where the nodes that touch and slip are kept, or None.
        """
        speed = 0.0 if kinks is None else float(np.abs(V).max(initial=0.0))
        for rows, axis, outward, mu in self._frictional:
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

    def constrain_stopped(self, taken: Array, mapped: Array, kinks: Kinks | None = None) -> None:
        """Hold nodes that the faces have stopped.

        Points around a stopped node move, and map a velocity to it. A body that strained by this
        velocity would make energy: the node's forces and the face balance, and do no work. A face
        holds by no more than the impulse that it has given, and friction by what it has left.

        Args:
            taken: What `apply_friction` has taken from the velocities of the nodes (m/s), shape
                (nodes, d).
            mapped: Velocities of the points, mapped to the nodes (m/s), likewise. Changed.
            kinks: See `apply_friction`.
        """
        speed = 0.0 if kinks is None else float(np.abs(mapped).max(initial=0.0))
        for rows, axis, outward, mu in self._frictional:
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


def _equal(a: Array | None, b: Array | None) -> bool:
    """Whether two sides have the same shares of cells."""
    return a is b if a is None or b is None else bool(np.array_equal(a, b))
