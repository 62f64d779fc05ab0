"""Regridding: new grid lines for a problem between steps."""

from __future__ import annotations

from collections.abc import Sequence

import numpy.typing as npt

from dolfinmpm._platform.argumentchecks import check_kind
from dolfinmpm._platform.collective import collective
from dolfinmpm._platform.errors import ParameterError
from dolfinmpm.basis import LatticeBasis
from dolfinmpm.basis.refinement import refinements_on
from dolfinmpm.grid.graded import set_lines
from dolfinmpm.grid.lattice import lattice_of
from dolfinmpm.solve.problem import Problem

__all__ = ["regrid"]


@collective
def regrid(problem: Problem, lines: Sequence[npt.ArrayLike]) -> None:
    """Move the grid lines of a problem between steps, such as for a moving fine zone. Collective.

    Points and markers find their cells again. Nothing is transferred, because the grid has no
    state. Points and markers must be dense enough for the finest cells, everywhere on the way of
    the fine zone. Conditions stay on their nodes, and so on the same sides of the grid. A
    checkpoint belongs to the grid at its time.

    Args:
        problem: A quasi-static problem, or a problem in time with implicit steps. It must be the
            only problem on its grid that continues. Other problems raise an error at their next
            step.
        lines: Coordinates of the lines in each direction (m), such as from `zoned_line`. The
            number of lines must stay. The grid must have been graded from the start.

    Raises:
        ParameterError: The lines are invalid, or the problem is of another kind.
        UnsupportedGridError: The grid is not rectangular, or was uniform.
        PointsOutsideGridError: Points would be outside the grid.

    The fine zone moves by one metre to the right:

    >>> import dolfinmpm as mpm
    >>> from mpi4py import MPI
    >>> lines = [mpm.zoned_line(0, 6, (2, 3), (4, 4, 5)), range(4)]
    >>> grid = mpm.create_lattice(MPI.COMM_WORLD, lines)
    >>> points = mpm.fill(grid, mpm.Box((0, 0), (6, 2)), per_cell=4, density=2000.0)
    >>> V = mpm.Space(grid, "gimp")
    >>> F = mpm.momentum(mpm.materials.Hencky(1e6, 0.3), points, V.increment, V.test)
    >>> problem = mpm.QuasiStatic(F, V.increment, points, mpm.fixed(V, "bottom"))
    >>> mpm.regrid(problem, [mpm.zoned_line(0, 6, (3, 4), (4, 4, 5)), range(4)])
    >>> sorted(set(grid.geometry.x[:, 0].round(2).tolist()))[4:9]
    [3.0, 3.25, 3.5, 3.75, 4.0]
    """
    check_kind("problem", problem, Problem, "give an mpm.QuasiStatic")
    if not hasattr(problem, "solver"):
        raise ParameterError(
            f"{type(problem).__name__} steps on a grid that stays; regrid problems with equations"
        )
    if problem.configuration == "total":
        raise ParameterError(
            'a space with configuration="total" keeps the grid of the first positions; take '
            '"updated"'
        )
    points, form = problem.points, problem.form
    set_lines(points.grid, lines)
    lattice = lattice_of(points.grid)
    assert lattice is not None
    for space in form.spaces:
        assert isinstance(space.basis, LatticeBasis)
        space.basis.regrid(lattice)
        space.__dict__.pop("_extractions", None)
    # with the same numbers, the old leaves would be taken for the new ones
    for refinement in refinements_on(points.grid):
        refinement.regrid()
    problem.regrid()
    points.locate()
    for of in form.boundaries:
        of.boundary.markers.locate()
