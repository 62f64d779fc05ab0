"""Laws that do not go with mean volume changes (F-bar)."""

from __future__ import annotations

from typing import Any

from dolfinx.mesh import CellType

from dolfinmpm._platform.errors import ParameterError, SoftVolumeWarning, raise_together, warn
from dolfinmpm.body.points import MaterialPoints

__all__ = ["refuse_dilation", "refuse_simplices", "warn_of_compaction"]


def refuse_simplices(points: MaterialPoints) -> None:
    """Raise ParameterError where the volume change is constant in each cell already."""
    kind = points.grid.topology.cell_type
    if kind in (CellType.triangle, CellType.tetrahedron) and not points.axisymmetric:
        raise ParameterError(
            f"fbar = True would do nothing on a grid of cells of the kind {kind.name}: linear "
            "functions have one volume change in each of them, and lock for all that. Take "
            "quadrilaterals or hexahedra"
        )


def refuse_dilation(formulation: Any, comm) -> None:
    """Raise ParameterError if the law has a dilation angle that is not 0. Collective."""
    names = list(getattr(formulation.law, "parameters", ()))
    name = next((name for name in names if name.startswith("dilation")), None)
    if name is None:
        return
    angle = formulation.parameters(formulation.rows)[:, names.index(name)]
    error = None
    if angle.max(initial=0.0) > 0.0:
        error = ParameterError(
            f"fbar = True: {type(formulation.law).__name__} has {name} = {angle.max():g} degrees, "
            "only 0 is possible. F-bar shares the volume change of a cell, but not the shear that "
            "dilates: pressures in the cell drift apart, and the load falls or no equilibrium "
            f'is left. Take basis="bspline2" and finer cells without fbar, or {name} = 0'
        )
    raise_together(comm, error)


def warn_of_compaction(formulation: Any, points: MaterialPoints, degree: int) -> None:
    """Warn of cubic splines with a law of plastic compaction. Collective."""
    if degree > 2 and "compression" in getattr(formulation.law, "parameters", ()):
        warn(
            points.comm,
            f"fbar = True with splines of degree {degree}: the mean hides volume changes that "
            "alternate from cell to cell. Ground that compacts plastically, as with "
            f"{type(formulation.law).__name__}, then has no stiffness against these changes, and "
            'steps fail soon after it yields. Take basis="bspline2", or fbar=False',
            SoftVolumeWarning,
        )
