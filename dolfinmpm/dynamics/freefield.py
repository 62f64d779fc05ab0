"""Free-field sides: the ground beside a body in an earthquake, as a column of its own."""

from __future__ import annotations

from dolfinmpm._platform.argumentchecks import check_kind
from dolfinmpm._platform.collective import collective
from dolfinmpm._platform.errors import ParameterError
from dolfinmpm.basis.space import Space
from dolfinmpm.dynamics.faces import Face, check_sides, face_at, refuse_leaves
from dolfinmpm.dynamics.groundcolumn import GroundColumn
from dolfinmpm.grid.lattice import require_lattice
from dolfinmpm.grid.sides import side_of

__all__ = ["free_field"]


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
    not hold it. Both clocks have the same time.

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
