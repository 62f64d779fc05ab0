"""Frictional, absorbing and free-field sides of the grid, in steps in time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from dolfinmpm._platform.argumentchecks import check_function, check_kind, number, shown
from dolfinmpm._platform.collective import collective
from dolfinmpm._platform.errors import ParameterError, UnsupportedGridError
from dolfinmpm._platform.uncopied import unchanged
from dolfinmpm._platform.units import friction_coefficient
from dolfinmpm.basis.conditions import Condition, prescribed
from dolfinmpm.basis.space import Space
from dolfinmpm.cut.activation import Field
from dolfinmpm.dynamics.facesatnodes import has_columns
from dolfinmpm.dynamics.groundcolumn import GroundColumn
from dolfinmpm.grid.lattice import require_lattice
from dolfinmpm.grid.sides import side_of
from dolfinmpm.grid.userfunctions import VelocityByTime

__all__ = [
    "Face",
    "absorbing",
    "free_field",
    "frictional",
    "ghost_mass_at",
    "refuse_constraints",
    "split_conditions",
]


# Ghost penalty of the mass at free-field sides, by degree. Level ground then moves as its column
# does to 0.5 % (waves of 12 cells); the usual penalty makes 6 %.
_GHOST_BESIDE = {1: 1e-3, 2: 1e-2, 3: 1e-1}


@unchanged()
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
        density: Density of the ground beyond an absorbing side (kg/m^d), or None.
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
    density: float | None = None

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
    (Lysmer & Kuhlemeyer 1969, J. Eng. Mech. Div. ASCE 95, 859). They act on the part of a side that
    the body covers at the start of a step: on the domains of the points in the cells beside it.
    They carry no weight: a body with gravity on them sinks, unless a traction on its lower face, or
    another condition, holds it.

    Args:
        space: Space of the displacement, on a rectangular grid.
        sides: Names of sides; see `prescribed`.
        density: Density ρ of the ground beyond the sides (kg/m^d).
        p_speed, s_speed: Speeds c_p and c_s of pressure and shear waves there (m/s).
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
    waves = _checked_incoming(incoming, (rho * p, rho * s), axes, d)
    found = [face_at(space, side, None, (rho * p, rho * s), waves) for side in sides]
    return [replace(face, density=rho) for face in found]


def _checked_incoming(
    incoming: Any, impedance: Sequence[float], axes: Sequence[int], d: int
) -> tuple[VelocityByTime | None, ...] | None:
    """Velocities of incoming waves, one per direction, or None without any.

    Args:
        incoming: The argument: None, or one function of time or None per direction.
        impedance: Impedances of pressure and shear waves (Pa s/m).
        axes: Directions of the normals of the sides.
        d: Dimension of space.

    Raises:
        ParameterError: An entry is no function of time, or a side has no dashpots for it.
    """
    if incoming is None:
        return None
    if not isinstance(incoming, (list, tuple)) or len(incoming) != d:
        raise ParameterError(
            f"incoming = {shown(incoming)} must be one velocity per direction, None for none: "
            f"incoming=({', '.join(['record'] + ['None'] * (d - 1))})"
        )
    waves: list[VelocityByTime | None] = [None] * d
    for k, wave in enumerate(incoming):
        if wave is None:
            continue
        check_function("incoming", wave, "of time that returns the velocity of the wave (m/s)")
        waves[k] = by_time = VelocityByTime.of("incoming", wave)
        by_time(0.0)
        for axis in axes:
            if not impedance[0 if k == axis else 1] > 0.0:
                speed = "p_speed" if k == axis else "s_speed"
                raise ParameterError(
                    f"a wave comes in with motion in the direction {k}, and {speed} = 0 m/s gives "
                    f"the side no dashpots there: give {speed} of the ground beyond the side"
                )
    return tuple(waves) if any(waves) else None


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
    if mass != "consistent" or ghost_mass is not None or not has_columns(faces):
        return ghost_mass
    return _GHOST_BESIDE[space.basis.degree]


def refuse_constraints(faces: Sequence[Face], fields: Sequence[Field]) -> None:
    """Raise ParameterError if constraints act between nodes and a face is beside a column."""
    tied = any(field.constrains_nodes or field.prolongate is not None for field in fields)
    if has_columns(faces) and tied:
        raise ParameterError(
            "free-field sides push nodes, and constraints between nodes would drop the pushes: "
            'leave out prolongation= and stabilisation="aggregation", and take "ghost"'
        )


@collective
def free_field(space: Space, *sides: str, column: GroundColumn) -> list[Face]:
    """Sides that move with the ground beside a body, and let its own waves out. Collective.

    The ground beside the body is a column of level ground under the same earthquake. The side feels
    the column's stress, and dashpots on the difference of both velocities, with the impedances of
    the column's elastic laws: t = σ_c n + ρ c (v_c − v). So level ground moves as the column does,
    and waves that a slope or a building adds leave (Lysmer & Kuhlemeyer 1969; Zienkiewicz, Bicanic
    & Shen 1989; Nielsen 2006, doi 10.1016/j.compgeo.2005.12.002).

    The side is the end of the body in this direction at the start, and follows the column. It may
    be within the grid: leave free cells beside the body if the ground moves far. Conditions must
    not hold it. The column and the body have the same time.

    Args:
        space: Space of the body's displacement, on a rectangular grid whose last axis is vertical.
        sides: Names of vertical sides; see `prescribed`.
        column: The ground beside the sides.

    Returns:
        Conditions for `Newmark`, `GeneralisedAlpha` and `Explicit`.

    Raises:
        ParameterError: A side is unknown or not vertical, or the column has another dimension.
        UnsupportedGridError: The grid is not rectangular, or the space is refined.

    A wall beside ground at rest: what swings in it leaves through the side.

    >>> import dolfinmpm as mpm
    >>> from mpi4py import MPI
    >>> law = mpm.materials.Hencky(2.0, 0.0)
    >>> def ground(width, velocity, sides):
    ...     grid = mpm.create_lattice(MPI.COMM_WORLD, [range(8), range(5)])
    ...     points = mpm.fill(grid, mpm.Box((3, 0), (3 + width, 4)), per_cell=2, density=1.0)
    ...     V = mpm.Space(grid, "gimp")
    ...     F = mpm.momentum(law, points, V.increment, V.test)
    ...     points.add_field("velocity", (2,), "m/s")
    ...     points["velocity"] = (velocity, 0.0)
    ...     bcs, options = sides(V)
    ...     return mpm.Newmark(F, V.increment, points, mpm.fixed(V, "bottom") + bcs, **options)
    >>> tied = ground(1, 0.0, lambda V: ([], {"prolongation": mpm.tied(V, period=1.0)}))
    >>> column = mpm.GroundColumn(tied, 4.0, dt=0.5)
    >>> body = ground(2, 1e-3, lambda V: (mpm.free_field(V, "left", "right", column=column), {}))
    >>> first = body.energies().kinetic
    >>> for t in mpm.times(4.0, dt=0.5):
    ...     record = body.step(t)
    >>> now = body.energies()
    >>> now.kinetic + now.strain < 0.1 * first
    True
    """
    check_sides(space, sides)
    require_lattice(space.grid, "free_field")
    refuse_leaves(space, "free-field")
    check_kind("column", column, GroundColumn, "make it with mpm.GroundColumn(problem, end, dt=)")
    d = space.grid.geometry.dim
    if column.gdim != d:
        raise ParameterError(
            f"column = {column!r} is of {column.gdim} dimensions, and the body of {d}: make the "
            "column on a grid of the same dimension"
        )
    level = [side for side in sides if side_of(side, d)[1] == d - 1]
    if level or d == 1:
        raise ParameterError(
            f"the side {(level or sides)[0]!r} is not vertical: a free field is beside the body; "
            "below it take mpm.absorbing"
        )
    return [face_at(space, side, column=column) for side in sides]
