"""Frictional and absorbing sides of the grid, in steps in time."""

from __future__ import annotations

import weakref
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from dolfinx import fem
from mpi4py import MPI

from dolfinmpm._platform.argumentchecks import check_kind, number, shown
from dolfinmpm._platform.collective import collective
from dolfinmpm._platform.errors import ParameterError, UnsupportedGridError
from dolfinmpm._platform.units import friction_coefficient
from dolfinmpm.basis.conditions import Condition, prescribed
from dolfinmpm.basis.space import Space
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.cut.activation import Field
from dolfinmpm.dynamics.facesatnodes import Faces
from dolfinmpm.dynamics.groundcolumn import GroundColumn
from dolfinmpm.dynamics.incomingwaves import checked_incoming
from dolfinmpm.grid.lattice import require_lattice
from dolfinmpm.grid.sides import side_of

__all__ = [
    "Face",
    "Faces",
    "Sides",
    "absorbing",
    "check_sides",
    "face_at",
    "frictional",
    "ghost_mass_at",
    "refuse_constraints",
    "refuse_leaves",
    "set_velocities",
    "split_conditions",
]

Array = npt.NDArray[np.float64]
# Ghost penalty of the mass at free-field sides, by degree. Level ground then moves as its column
# does to 0.5 % (waves of 12 cells); the usual penalty makes 6 %.
_GHOST_BESIDE = {1: 1e-3, 2: 1e-2, 3: 1e-1}


@dataclass(frozen=True)
class Face:
    """A side of the grid that acts on the body.

    Attributes:
        space: Space of the displacement.
        nodes: Local nodes, shape (n,).
        axis, end: Direction of its normal, and 0 for the lower or 1 for the upper end.
        friction: Coulomb's coefficient, or None.
        impedance: Impedances of pressure and shear waves, ρ c (Pa s/m), or None.
        where: Name of the side in messages.
        incoming: Velocities by time of waves that come in (m/s), one per direction, or None.
        column: Ground beside the side, or None.
    """

    space: Space
    nodes: npt.NDArray[np.int32]
    axis: int
    end: int
    friction: float | None
    impedance: tuple[float, float] | None
    where: str
    incoming: tuple[Any, ...] | None = None
    column: GroundColumn | None = None

    @property
    def kind(self) -> str:
        """Kind of the face in messages."""
        return "absorbing" if self.friction is None else "frictional"

    def same_as(self, other: Face) -> bool:
        """Whether another face is at the same side."""
        mine = self.space, self.axis, self.end
        return mine == (other.space, other.axis, other.end)

    def damps(self, component: int) -> bool:
        """Whether it has dashpots in a direction."""
        rates = self.impedance or (0.0, 0.0)
        return rates[0 if component == self.axis else 1] > 0.0


@collective
def frictional(space: Space, *sides: str, friction: float) -> list[Face]:
    """Sides of the grid with Coulomb friction: the body may leave them, not pass. Collective.

    They are for explicit steps. A node that would move out loses its outward velocity v_n. It also
    loses at most μ v_n of its velocity along the side.

    Args:
        space: Space of the displacement.
        sides: Names of sides; see `prescribed`.
        friction: Coefficient μ; 0 is a smooth side that the body may leave.

    Raises:
        ParameterError: A side is unknown, or μ is negative.

    A body slides along the bottom, and is slowed down:

    >>> import dolfinmpm as mpm
    >>> from mpi4py import MPI
    >>> grid = mpm.create_lattice(MPI.COMM_WORLD, [range(5), range(5)])
    >>> points = mpm.fill(grid, mpm.Box((0, 0), (4, 2)), per_cell=2, density=2000.0)
    >>> V = mpm.Space(grid, "gimp")
    >>> F = mpm.momentum(mpm.materials.Hencky(1e6, 0.3), points, V.increment, V.test)
    >>> sides = mpm.frictional(V, "bottom", friction=0.4)
    >>> problem = mpm.Explicit(F, V.increment, points, sides)
    >>> points["velocity"] = (1.0, -0.1)
    >>> before, record = problem.momentum()[0], problem.step(0.05)
    >>> bool(problem.momentum()[0] < before)
    True
    """
    check_sides(space, sides)
    mu = friction_coefficient(friction)
    return [face_at(space, side, mu) for side in sides]


@collective
def absorbing(
    space: Space,
    *sides: str,
    density: float,
    p_speed: float,
    s_speed: float = 0.0,
    incoming: Sequence[Any] | None = None,
) -> list[Face]:
    """Sides of the grid with dashpots that let waves out, and waves in. Collective.

    The tractions are −ρ c_p v_n and −ρ c_s v_t. They absorb waves at normal incidence completely
    (Lysmer & Kuhlemeyer 1969, J. Eng. Mech. Div. ASCE 95, 859).

    Args:
        space: Space of the displacement, on a rectangular grid.
        sides: Names of sides; see `prescribed`.
        density: ρ (kg/m^d).
        p_speed, s_speed: Speeds of pressure and shear waves (m/s).
        incoming: Waves that come in through the sides: per direction of motion a function of time
            that returns the velocity of the wave (m/s), such as an `InputMotion`, or None. The
            tractions are then ρ c (2 v_up − v). The upward wave v_up is half of the motion at an
            outcrop of the ground beyond the sides.

    Raises:
        ParameterError: A side is unknown, a number is outside its range, s_speed exceeds p_speed,
            or a wave comes in where the sides have no dashpots.
        UnsupportedGridError: The grid is not rectangular, or the space is refined.

    A wave leaves at the bottom, and takes energy with it:

    >>> import dolfinmpm as mpm
    >>> from mpi4py import MPI
    >>> grid = mpm.create_lattice(MPI.COMM_WORLD, [range(5), range(5)])
    >>> points = mpm.fill(grid, mpm.Box((0, 0), (4, 2)), per_cell=2, density=2000.0)
    >>> V = mpm.Space(grid, "gimp")
    >>> F = mpm.momentum(mpm.materials.Hencky(1e6, 0.3), points, V.increment, V.test)
    >>> sides = mpm.absorbing(V, "bottom", density=2000.0, p_speed=26.0, s_speed=14.0)
    >>> problem = mpm.Newmark(F, V.increment, points, sides)
    >>> points["velocity"] = (0.0, -1.0)
    >>> record = problem.step(0.1)
    >>> bool(points["velocity"][:, 1].mean() > -1.0)
    True
    """
    check_sides(space, sides)
    require_lattice(space.grid, "absorbing")
    refuse_leaves(space, "absorbing")
    rho = number("density", density, 0.0)
    p = number("p_speed", p_speed, 0.0, closed=True)
    s = number("s_speed", s_speed, 0.0, closed=True)
    if s > p > 0:
        raise ParameterError(
            f"s_speed = {s:g} m/s must be at most p_speed = {p:g} m/s: shear waves are slower than "
            "pressure waves; were they swapped?"
        )
    if p == s == 0.0:
        raise ParameterError(
            "p_speed = 0 m/s and s_speed = 0 m/s: such sides let no wave out; give the speeds of "
            "the ground, √(M/ρ) and √(G/ρ)"
        )
    d = space.grid.geometry.dim
    axes = [side_of(side, d)[1] for side in sides]
    waves = checked_incoming(incoming, (rho * p, rho * s), axes, d)
    return [face_at(space, side, None, (rho * p, rho * s), waves) for side in sides]


def check_sides(space: Any, sides: tuple[Any, ...]) -> None:
    """Raise ParameterError unless the space has a displacement, and each side is given once.

    Args:
        space: The space.
        sides: The sides, by axis or name.
    """
    check_kind("space", space, Space, "make it with mpm.Space(grid)")
    gdim = space.grid.geometry.dim
    if space.increment.ufl_shape != (gdim,):
        raise ParameterError(
            f"faces act on a displacement; the field has shape {space.increment.ufl_shape}, not "
            f"{(gdim,)}"
        )
    if not sides:
        raise ParameterError('no side is given: name the sides that it acts on, such as "bottom"')
    names = [side_of(side, gdim)[0] for side in sides]
    again = [side for k, side in enumerate(sides) if names[k] in names[:k]]
    if again:
        raise ParameterError(f"the side {shown(again[0])} is given twice; it would act twice")


def refuse_leaves(space: Space, what: str) -> None:
    """Raise UnsupportedGridError if a space is refined: dashpots need areas of its nodes.

    Args:
        space: The space.
        what: Kind of the sides in the message.
    """
    if space.refinement is not None:
        raise UnsupportedGridError(
            f"{what} sides need cells of one size along them, and the space is refined up to "
            f"levels = {space.refinement.levels}: leave out refine=, or give create_lattice "
            "smaller cells where they are wanted"
        )


def face_at(
    space: Space, side: str, friction=None, impedance=None, incoming=None, column=None
) -> Face:
    """A face at a side of the grid; see `Face`."""
    name, axis, end = side_of(side, space.grid.geometry.dim)
    (condition,) = prescribed(space, name, axis)
    return Face(space, condition.nodes, axis, end, friction, impedance, name, incoming, column)


def split_conditions(bcs: Sequence[Any]) -> tuple[list[Condition], list[Face]]:
    """Separate a list into conditions and faces. The problem checks other arguments."""
    if not isinstance(bcs, (list, tuple)):
        return bcs, []  # type: ignore[return-value]
    faces = [one for one in bcs if isinstance(one, Face)]
    return [one for one in bcs if not isinstance(one, Face)], faces


def ghost_mass_at(
    faces: Sequence[Face], space: Space, mass: str, ghost_mass: float | None
) -> float | None:
    """The argument `ghost_mass`, or its default where a face is beside a column of ground.

    Nodes that constraints tie to others take no forces of faces. So a small ghost penalty takes the
    place of constraints: it hardly acts on a motion that is the same along a level.
    """
    if mass != "consistent" or ghost_mass is not None or not _beside(faces):
        return ghost_mass
    return _GHOST_BESIDE[space.basis.degree]


def refuse_constraints(faces: Sequence[Face], fields: Sequence[Field]) -> None:
    """Raise ParameterError if constraints act between nodes and a face is beside a column."""
    tied = any(field.constrains_nodes or field.prolongate is not None for field in fields)
    if _beside(faces) and tied:
        raise ParameterError(
            "free-field sides push nodes, and constraints between nodes would drop the pushes: "
            'leave out prolongation= and stabilisation="aggregation", and take "ghost"'
        )


def _beside(faces: Sequence[Face]) -> bool:
    return any(face.column is not None for face in faces)


def set_velocities(
    conditions: Sequence[Condition], value: Callable[[Callable[[float], float]], float]
) -> None:
    """Set the increments of conditions that prescribe velocities.

    Args:
        conditions: Conditions. Conditions without a velocity stay unchanged.
        value: Function from a velocity by time (m/s) to the increment (m).
    """
    for condition in conditions:
        if condition.velocity is not None:
            assert isinstance(condition.value, fem.Constant)
            condition.value.value = value(condition.velocity)


def _refuse_held(face: Face, condition: Condition) -> None:
    """Raise ParameterError if a condition constrains all dashpots of a face. Collective."""
    if condition.space is not face.space or not face.damps(condition.component):
        return
    free = bool(np.setdiff1d(face.nodes, condition.nodes).size)
    if not face.space.grid.comm.allreduce(free, op=MPI.LOR):
        raise ParameterError(
            f"the absorbing face at '{face.where}' damps velocities in the direction "
            f"{condition.component}, and the condition at '{condition.where}' holds them there, so "
            "that it would do nothing: leave out one of both"
        )


def _refuse_stuck(face: Face, conditions: Sequence[Condition]) -> None:
    """Raise ParameterError if conditions prevent all sliding along a face. Collective."""
    if not face.friction:
        return
    held = set()
    for condition in conditions:
        if condition.space is face.space:
            free = bool(np.setdiff1d(face.nodes, condition.nodes).size)
            if not face.space.grid.comm.allreduce(free, op=MPI.LOR):
                held.add(condition.component)
    if held >= set(range(face.space.components)) - {face.axis}:
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

    Raises:
        ParameterError: A condition constrains all nodes of a face in a direction of its damping.
            Or two faces are at one side.
    """

    def __init__(
        self, faces: Sequence[Face], points: MaterialPoints, conditions: Sequence[Condition] = ()
    ):
        for k, face in enumerate(faces):
            others = {other.kind for other in faces[:k] if face.same_as(other)}
            if others:
                where = "twice" if face.kind in others else f"beside the {others.pop()} one"
                raise ParameterError(
                    f"the {face.kind} face at '{face.where}' is there {where}, and both would "
                    "act: leave one out"
                )
            for condition in conditions:
                _refuse_held(face, condition)
            _refuse_stuck(face, conditions)
        self._faces, self._d, self._axisymmetric = list(faces), points.gdim, points.axisymmetric
        self._box: Array = np.zeros((2, points.gdim))
        if _beside(faces):
            self._box = _ends(points)
        # a basis belongs to one partition of the lattice
        self._on: weakref.WeakKeyDictionary[Any, Faces] = weakref.WeakKeyDictionary()

    def __len__(self):
        return len(self._faces)

    @property
    def rubbing(self) -> bool:
        """Whether bodies touch and leave a face, and rub along it."""
        return any(face.friction is not None for face in self._faces)

    @property
    def incoming(self) -> bool:
        """Whether waves come in through a face."""
        return any(face.incoming is not None for face in self._faces) or _beside(self._faces)

    def regrid(self) -> None:
        """Discard areas that depend on the old grid lines."""
        self._on.clear()

    def on(self, basis: Any, t: float | None = None) -> Faces | None:
        """The faces in a basis's numbering, or None without faces. The first call is collective.

        Args:
            basis: The basis.
            t: Start of a step (s), or None within a step.
        """
        if not self._faces:
            return None
        if basis not in self._on:
            own = self._d, self._axisymmetric, self._box
            self._on[basis] = Faces(self._faces, basis, *own)
        if t is not None:
            self._on[basis].follow(t)
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
