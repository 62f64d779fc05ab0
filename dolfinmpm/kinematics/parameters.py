"""A law's parameters at the points: numbers, or a field of the points."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from dolfinmpm._platform.argumentchecks import Tags
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

    If a parameter varies, all parameters are a field of the points, `<law>_parameters`, or
    `<law>_parameters_2` for the second law of the same class. Arrays of values are in the order of
    the points at the time of binding; later, points can move to other ranks.

    Attributes:
        field: Name of the field; empty if no parameter varies.

    Args:
        law: The law.
        points: Material points.
        tags: Tags of the points with this law; None means all points.
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
        """Set the parameters of the law's points that have no parameters yet. Collective.

        Raises:
            ParameterError: A value is out of range, or the number of values is not the number of
                points.
        """
        if not self.field:
            return
        points = self.points
        new = self.field not in points.fields
        rows = rows_within(points, self.tags)
        if not new:
            rows = rows[np.isnan(points[self.field][rows, 0])]
        # an array has values only for the first points: later calls need it only for new points
        asked = new or rows.size > 0
        values = call_together(
            points.comm, lambda: self.law.parameter_array(points["x0"][rows]) if asked else None
        )
        if values is not None:
            # the arrays may have more columns: numbers that a kernel derives from the parameters
            points.add_field(self.field, values.shape[1:], "", np.nan)
            points[self.field][rows] = values

    def weaken(self, factor: float | None) -> None:
        """Divide the strength of the law by a factor, see `weakened`. Collective.

        If parameters vary, a further field of the points keeps the first values until a call with
        None.

        Args:
            factor: The factor; 0 for a body that does not yield, None for the full strength.

        Raises:
            ParameterError: The law does not tell its strength, or the reduced parameters
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
        """Parameters at some points, shape (1, parameters), or (len(rows), parameters) if varying.

        Args:
            rows: Numbers of the points on this rank, or a slice.
        """
        return self.points[self.field][rows] if self.field else self._numbers
