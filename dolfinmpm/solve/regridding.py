"""Problems on a grid whose lines are laid anew between steps."""

from __future__ import annotations

from collections.abc import Sequence

import numpy.typing as npt

from dolfinmpm._platform.checks import check_kind
from dolfinmpm._platform.errors import ParameterError
from dolfinmpm._platform.together import together
from dolfinmpm.basis import LatticeBasis
from dolfinmpm.grid.graded import lay_lines
from dolfinmpm.grid.lattice import lattice_of
from dolfinmpm.solve.problem import Problem

__all__ = ["regrid"]


@together
def regrid(problem: Problem, lines: Sequence[npt.ArrayLike]) -> None:
    """Place the lines of a problem's grid anew, between steps, as of a zone that moves. Collective.

    Points and markers find their cells again; nothing is transferred, for the grid has no state.
    Both must be as dense as the finest cells need wherever the zone comes.
    Conditions stay with the nodes that they were made for, and so hold the same sides of the grid.
    A checkpoint of the problem is of the grid as it is then.

    Args:
        problem: A quasi-static problem, or one in time with implicit steps, the only one on its
            grid that goes on: others tell so at their next step.
        lines: Coordinates of as many lines as the grid has, in each direction (m), such as
            `zoned_line` gives. The grid must have had cells of different sizes from the start.

    Raises:
        ParameterError: The lines are not what they may be, or the problem is of another kind.
        UnsupportedGridError: The grid is not rectangular, or was uniform.
        PointsOutsideGridError: Points would be outside the grid.
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
    lay_lines(points.grid, lines)
    lattice = lattice_of(points.grid)
    assert lattice is not None
    for space in form.spaces:
        assert isinstance(space.basis, LatticeBasis)
        space.basis.regrid(lattice)
        space.__dict__.pop("_extractions", None)
    problem.regrid()
    points.locate()
    for of in form.boundaries:
        of.boundary.markers.locate()
