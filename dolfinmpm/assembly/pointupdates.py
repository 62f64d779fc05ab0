"""Fields of the points that a converged step sets to UFL expressions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt
from ufl.algorithms import expand_derivatives
from ufl.core.expr import Expr

from dolfinmpm._platform.argumentchecks import Tags
from dolfinmpm._platform.errors import FieldShapeError, FormError
from dolfinmpm.assembly.evaluation import Evaluation
from dolfinmpm.assembly.term import Term
from dolfinmpm.basis.space import Space
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.forms.declarations import rows_within
from dolfinmpm.forms.placeholders import Placeholders
from dolfinmpm.forms.pointterms import PointTerms
from dolfinmpm.forms.pointwise import Program, compile_program

__all__ = ["PointUpdates"]

Array = npt.NDArray[np.float64]


class PointUpdates:
    """Fields that a converged step sets to UFL expressions of state and increment. Collective.

    Args:
        updates: Expressions by name of the field.
        regions: Terms of the problem.
        spaces: Spaces of the increments.
        points: Material points.
        tags: Tags of the points to set, or None for all points.
        carried: Whether the form carries the fields, see `dolfinmpm.carried`.
        term: Term with the increments in the expressions, or None for those at the points.

    Attributes:
        carried, term: The arguments.

    Raises:
        FieldShapeError: The shapes of an expression and of its field differ.
        FormError: An expression cannot be evaluated at the points, or contains the stress of a law
            that is not in the form.
    """

    def __init__(
        self,
        updates: Mapping[str, Expr],
        regions: Sequence[PointTerms],
        spaces: Sequence[Space],
        points: MaterialPoints,
        tags: Tags = None,
        carried: bool = False,
        term: Term | None = None,
    ):
        self.carried, self.term = carried, term
        self._placeholders = Placeholders(spaces, points)
        self._programs: dict[str, Program] = {}
        self._points, self._tags = points, tags
        for name, expression in updates.items():
            shape = points[name].shape[1:]
            if expression.ufl_shape != shape:
                raise FieldShapeError(
                    f"field '{name}' has shape {shape} at a point, but the expression that updates "
                    f"it has shape {expression.ufl_shape}"
                )
            mapped = self._placeholders.map(expand_derivatives(expression))
            parts = [mapped[i] if i else mapped for i in np.ndindex(*shape)]
            self._programs[name] = compile_program(points.grid, parts, self._placeholders.sources)
        known = [operator for region in regions for operator in region.operators]
        for operator in self._placeholders.operators:
            if operator not in known:
                raise FormError(
                    f"the updates contain the stress of '{operator}', which is not in the form; "
                    "give mpm.stress the same law, strain, fbar and tag as mpm.momentum"
                )

    def run(self, evaluation: Evaluation, new: dict[str, Array]) -> None:
        """Write the fields' new values into new arrays.

        Args:
            evaluation: Evaluation of the point terms, at the step's increments.
            new: New arrays of fields by name; extended.
        """
        if not self._programs:
            return
        points = self._points
        rows = rows_within(points, self._tags)
        for name, program in self._programs.items():
            if name not in new:
                new[name] = points[name].copy()
            values = evaluation.run(self._placeholders, program, rows)
            new[name][rows] = values.reshape(len(rows), *points[name].shape[1:])
