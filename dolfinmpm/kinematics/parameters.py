"""A law's parameters at the points: numbers, or a field that goes with the points."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from dolfinmpm._platform.checks import Tags
from dolfinmpm._platform.errors import call_together
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.forms.declarations import rows_within
from dolfinmpm.materials.base import Law
from dolfinmpm.materials.parametrised import Parametrised
from dolfinmpm.materials.strength import weakened

__all__ = ["PointParameters"]

Array = npt.NDArray[np.float64]


class PointParameters:
    """The parameters of a law at its points.

    If any varies they are the field `<law>_parameters` of the points, `<law>_parameters_2`
    for the second law of that name: arrays are given in the order that the points have when
    the law is bound, and points migrate afterwards.

    Attributes:
        field: Name of the field; empty if no parameter varies.

    Args:
        law: The law.
        points: Material points.
        tags: Tags of the points that the law is for.
    """

    def __init__(self, law: Parametrised, points: MaterialPoints, tags: Tags):
        self.law = law
        self.points = points
        self.tags = tags
        self.field = ""
        if law.varies:
            if not any(law is known for known in points.laws):
                points.laws.append(law)
            same = [known for known in points.laws if type(known) is type(law)]
            number = next(k for k, known in enumerate(same, 1) if known is law)
            self.field = f"{type(law).__name__.lower()}_parameters"
            self.field += f"_{number}" if number > 1 else ""
        else:
            self._numbers = law.parameter_array()

    def adopt(self) -> None:
        """Give parameters to those of the law's points that have none. Collective.

        Raises:
            ParameterError: A value is outside its range, or their number is not that of
                the points.
        """
        if not self.field:
            return
        points = self.points
        new = self.field not in points.fields
        rows = rows_within(points, self.tags)
        if not new:
            rows = rows[np.isnan(points[self.field][rows, 0])]
        # an array is for the points that there are at first, and is asked for no others
        asked = new or rows.size > 0
        values = call_together(
            points.comm, lambda: self.law.parameter_array(points["x0"][rows]) if asked else None
        )
        if values is not None:
            # a kernel may take numbers that follow from the parameters, besides these
            points.add_field(self.field, values.shape[1:], "", np.nan)
            points[self.field][rows] = values

    def weaken(self, factor: float | None) -> None:
        """Divide the strength that the law gives by a factor, see `weakened`. Collective.

        Where parameters vary, the points keep what they were in a further field, until None.

        Args:
            factor: The factor; 0 for a body that does not yield, None for the law's own strength.

        Raises:
            ParameterError: The law does not tell what its strength is, or reduced parameters
                contradict each other.
        """
        law, points = self.law, self.points
        assert isinstance(law, Law)
        if not self.field:
            own = law.parameter_array()
            self._numbers = own if factor is None else weakened(law, own, factor)
            return
        first = f"{self.field}_first"
        if factor is None:
            if first in points.fields:
                points.fields[self.field] = points.fields[first]
                del points.fields[first]
            return
        if first not in points.fields:
            points.fields[first] = points[self.field].copy()
        rows = rows_within(points, self.tags)
        own = points.fields[first][rows]
        found = call_together(points.comm, lambda: weakened(law, own, factor) if len(own) else own)
        points[self.field][rows] = found

    def at(self, rows) -> Array:
        """Their values, shape (1, parameters) or, if any varies, (len(rows), parameters)."""
        return self.points[self.field][rows] if self.field else self._numbers
