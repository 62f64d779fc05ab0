"""Evaluation of point terms: from nodal increments to forces and tangents."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager

import numpy as np
import numpy.typing as npt

from dolfinmpm.assembly.functionvalues import function_values
from dolfinmpm.assembly.region import PointFailure, Region
from dolfinmpm.assembly.stencilsums import Entries
from dolfinmpm.assembly.term import ActiveTerm
from dolfinmpm.basis.stencils import gather
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.cut.activation import ActiveRegion
from dolfinmpm.cut.unknowns import Unknowns
from dolfinmpm.forms.operators import PointOperator
from dolfinmpm.forms.placeholders import Placeholders
from dolfinmpm.forms.pointterms import PointTerms
from dolfinmpm.forms.pointwise import Program

__all__ = ["Evaluation"]

Array = npt.NDArray[np.float64]


class Evaluation(ActiveTerm):
    """The point terms of a weak form on an activation.

    Fluxes and tangents are pure functions of the points' state and the nodal increments.
    `move` sets the increments for the other methods. Results of laws are kept until the
    next `move` or `end_state`. A tangent, or the end of a step, at the increments of the last
    residual therefore calls no law again. The state must not change in between.

    Args:
        regions: Terms of the parts of the body.
        points: Material points.
        unknowns: Numbering of the unknowns.
        parts: Stencils of the parts of the body.

    Attributes:
        value: Increments of each field at the points, shape (points, components).
        gradient: Gradients of the increments at the points, shape (points, components, gdim).
        failure: The point at which a law found no stress in the last call, or None.
    """

    kind = "points"

    def __init__(
        self,
        regions: Sequence[PointTerms],
        points: MaterialPoints,
        unknowns: Unknowns,
        parts: Sequence[ActiveRegion],
    ):
        n, d = len(points), points.gdim
        components = [field.components for field in unknowns.fields]
        self.value = [np.zeros((n, c)) for c in components]
        self.gradient = [np.zeros((n, c, d)) for c in components]
        self.failure: PointFailure | None = None
        self._points = points
        self._shared: dict[tuple, Array] = {}
        shared = self._shared
        for name, values in points.fields.items():
            if values.dtype == np.float64:
                shared["field", name] = values
        for k, (value, gradient) in enumerate(zip(self.value, self.gradient)):
            shared["value", k] = value
            shared["gradient", k] = gradient.reshape(n, components[k] * d)
        self.regions = [
            Region(t, points, unknowns, part, shared) for t, part in zip(regions, parts)
        ]

    def move(self, u: Sequence[Array]) -> None:
        """See `ActiveTerm`. Collective if a law takes means over cells."""
        for region in self.regions:
            for s, nodal, value, gradient in zip(
                region.part.stencils, u, self.value, self.gradient
            ):
                gather(s, nodal, value, gradient)
            region.prepare()

    def motion(self, movers: Sequence[int]) -> tuple[Array, Array]:
        """Displacements of the points (m) and their gradients, from the fields that move points.

        Args:
            movers: Numbers of these fields. Each point is moved by one field only.

        Returns:
            Displacements, shape (points, gdim), and gradients, shape (points, gdim, gdim).
        """
        first, *others = movers
        value, gradient = self.value[first], self.gradient[first]
        if others:
            value = np.sum([self.value[k] for k in movers], axis=0)
            gradient = np.sum([self.gradient[k] for k in movers], axis=0)
        return value, gradient

    def internal(self, out: Sequence[Array]) -> bool:
        """See `ActiveTerm`."""
        self.failure = None
        for region in self.regions:
            region.add_flux(region.terms.internal, out)
            if region.failure is not None:
                self.failure = region.failure
                return False
        return True

    def renew(self) -> None:
        """See `ActiveTerm`."""
        for region in self.regions:
            region.update_constants()

    def external(self, out: Sequence[Array]) -> None:
        """See `ActiveTerm`. DOLFINx constants and functions are taken as they are now."""
        self.renew()
        for region in self.regions:
            region.add_flux(region.terms.external, out)
            self.failure = self.failure or region.failure

    def tangent(self, entries: Mapping[tuple[int, int], Entries]) -> None:
        """See `ActiveTerm`. Collective if a law takes means over cells."""
        for region in self.regions:
            region.add_tangent(entries)

    @contextmanager
    def sampled(self) -> Iterator[None]:
        """Take tangents of a sample of the points of each region, within the context."""
        for region in self.regions:
            region.sampled = True
        try:
            yield
        finally:
            for region in self.regions:
                region.sampled = False

    def keep_results(self) -> None:
        """Keep the laws' results for the end of the step, though no tangent is asked for."""
        for region in self.regions:
            region.keeps = True

    def moduli(self) -> Array:
        """Moduli of the laws' present tangents; see `dolfinmpm.cut.facetmoduli`.

        Returns:
            Moduli M and G per volume at the start of the step (Pa), shape (points, 2); 0 at points
            of laws that are energies in UFL.
        """
        out = np.zeros((len(self._points), 2))
        for region in self.regions:
            region.moduli(out)
        return out

    def end_state(self) -> dict[str, Array]:
        """New values of the laws' fields at the end of the step, by name.

        If a value is not finite, `failure` has the point.
        """
        self.failure = None
        new: dict[str, Array] = {}
        for region in self.regions:
            region.add_end_state(new)
            self.failure = self.failure or region.failure
        return new

    def blame(self, point: int) -> None:
        """Set a point of this rank as the point that failed.

        Args:
            point: Number of the point.
        """
        self.failure = PointFailure(point, "")

    def not_finite(self) -> PointFailure | None:
        """A point of this rank whose increments are finite, and its terms are not, or None."""
        known = np.ones(len(self._points), bool)
        for values in (*self.value, *self.gradient):
            known &= np.isfinite(values.reshape(known.size, -1)).all(axis=1)
        for region in self.regions:
            order, groups = region.part.stencils[0].order, region.part.stencils[0].groups
            for program in filter(None, (region.terms.external, region.terms.internal)):
                for first, last, (flux,) in region.run([program], False):
                    rows = order[groups[first] : groups[last]]
                    bad = rows[known[rows] & ~np.isfinite(flux).all(axis=1)]
                    if bad.size:
                        cause = (
                            "a term of the form is not finite there: look at its divisions, roots "
                            "and logarithms, and at fields of the points"
                        )
                        return PointFailure(int(bad[0]), cause)
        return None

    def run(
        self, placeholders: Placeholders, program: Program, rows: npt.NDArray[np.integer]
    ) -> Array:
        """Run a program of state and increments at some points.

        Args:
            placeholders: Placeholders of the program. A law is zero at points with other laws.
            program: The program.
            rows: Numbers of the points, shape (n,).

        Returns:
            The values, shape (n, program.size).
        """
        data: dict[tuple, Array] = {}
        for key in program.inputs:
            if key[0] == "constant":
                data[key] = np.array(placeholders.constants[key[1]].value, float).reshape(1, -1)
            elif key[0] == "function":
                function, gradient = placeholders.functions[key[1]]
                values = function_values(function, gradient, self._points)
                data[key] = values.take(rows, axis=0)
            elif key[0] == "operator":
                data[key] = self._asked(placeholders.operators[key[1]], rows)
            else:
                data[key] = self._shared[key].take(rows, axis=0)
        values = np.empty((len(rows), program.size))
        program.run(data, values)
        return values

    def _asked(self, operator: PointOperator, rows: npt.NDArray[np.integer]) -> Array:
        """Values of an operator at some points; NaN if its law finds no stress."""
        size = int(np.prod(operator.ufl_shape))
        everywhere = np.zeros((len(self._points), size))
        for region in self.regions:
            if operator in region.terms.operators:
                region.ask(region.terms.operators.index(operator), everywhere)
        return everywhere[rows]
