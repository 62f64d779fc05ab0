"""Stress of internal forces that are written in UFL alone, without a law of the library.

The factor of the test function's gradient is the flux S per initial volume, with the power S : ∇̃v.
The Cauchy stress at the end of the step is

    σ = S ΔFᵀ / det F.

Components out of the plane are not known. If a term is the derivative of an energy, the energy is
known too.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from ufl.algorithms import expand_derivatives, extract_arguments, extract_coefficients
from ufl.algorithms.analysis import extract_constants
from ufl.classes import CoefficientDerivative, Division, Product, Sum, Zero
from ufl.constantvalue import zero
from ufl.core.expr import Expr
from ufl.corealg.traversal import unique_pre_traversal

from dolfinmpm.assembly.evaluation import Evaluation
from dolfinmpm.basis.space import Space
from dolfinmpm.body.formsigns import MARK
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.forms.placeholders import Placeholders
from dolfinmpm.forms.pointterms import PointTerms, derive
from dolfinmpm.forms.pointwise import compile_program
from dolfinmpm.forms.termqueries import SPATIAL_DERIVATIVES, depends_on, summands, tags_of

__all__ = ["STORED", "UFLStress"]

Array = npt.NDArray[np.float64]

# Name of the points' field of the energy of such terms, per initial volume (J/m^d)
STORED = "stored_energy"


class UFLStress:
    """Stress from the internal forces of a region without a law. Collective.

    Args:
        region: Terms of the region.
        integrals: Integrals over the points, as the user wrote them.
        spaces: Spaces of the increments.
        movers: Numbers of the fields that move points.
        points: Material points.
        mark: Value for the points' field `moved_under` after a converged step.

    Attributes:
        known: Whether the internal forces define a stress.
        strain: Name of the strain formulation, as for a law.
        carried, term: See `PointUpdates`.
    """

    strain, carried, term = "large", False, None

    def __init__(
        self,
        region: PointTerms,
        integrals: Sequence,
        spaces: Sequence[Space],
        movers: Sequence[int],
        points: MaterialPoints,
        mark: int,
    ):
        self._region, self._points, self._mark = region, points, mark
        self._placeholders = placeholders = Placeholders(spaces, points)
        own = [i for i in integrals if region.integrates(tags_of(i)) and MARK not in i.metadata()]
        flux, hoop = self._flux(own, movers)
        self.known = not isinstance(flux, Zero)
        if not self.known:
            return
        d = points.strain_dim
        sigma = ufl.dot(_full(flux, hoop, points), self._stretch(spaces, movers).T)
        sigma = sigma / ufl.det(self._stretch(spaces, movers) * self._field("F", (d, d)))
        parts = [sigma[i, j] for i in range(d) for j in range(d)]
        density = self._density(own, spaces, movers)
        self._stores = density is not None
        if density is not None:
            points.add_field(STORED, (), "J/m^d")
            parts.append(density)
        parts = [placeholders.map(part) for part in parts]
        self._program = compile_program(points.grid, parts, placeholders.sources)

    def _field(self, name: str, shape: tuple[int, ...]) -> Expr:
        return self._placeholders.placeholder(("field", name), shape)

    def _flux(self, integrals: Sequence, movers: Sequence[int]) -> tuple[Expr, Expr]:
        """Flux per initial volume, and its hoop component for axisymmetric bodies."""
        placeholders, gdim = self._placeholders, self._points.gdim
        flux, hoop = zero((gdim, gdim)), zero()
        for integral in expand_derivatives(ufl.Form(list(integrals))).integrals():
            share = self._field(integral.metadata()["volume"], ()) / self._field("V0", ())
            for term in summands(integral.integrand()):
                mapped = placeholders.map(term)
                for k in movers:
                    slope = derive(mapped, placeholders.test_gradient[k])
                    if isinstance(slope, Zero):
                        continue
                    flux = flux + share * slope
                    # the factor of v_r/r is a stress
                    value = derive(mapped, placeholders.test_value[k])
                    hoop = hoop + share * self._field("x", (gdim,))[0] * value[0]
        return flux, hoop

    def _stretch(self, spaces: Sequence[Space], movers: Sequence[int]) -> Expr:
        """Deformation gradient ΔF of the step."""
        points, placeholders = self._points, self._placeholders
        H = sum(
            (placeholders.gradient[k] for k in movers[1:]), start=placeholders.gradient[movers[0]]
        )
        u = sum((placeholders.value[k] for k in movers[1:]), start=placeholders.value[movers[0]])
        around = u[0] / self._field("x", (points.gdim,))[0]
        return ufl.Identity(points.strain_dim) + _full(H, around, points)

    def _density(
        self, integrals: Sequence, spaces: Sequence[Space], movers: Sequence[int]
    ) -> Expr | None:
        """Stored energy per initial volume, or None if it is not known."""
        total = zero()
        for integral in integrals:
            for k in movers:
                found = _density_of(integral.integrand(), spaces[k])
                if found is None or self._points.dt in extract_constants(found):
                    return None
                if isinstance(found, Zero):
                    continue
                share = self._field(integral.metadata()["volume"], ()) / self._field("V0", ())
                total = total + share * self._placeholders.map(expand_derivatives(found))
        return total

    @property
    def rows(self) -> npt.NDArray[np.intp]:
        """Numbers of the region's points on this rank, shape (n,)."""
        chosen = self._region.chosen(self._points["tag"])
        return np.arange(len(self._points)) if chosen is None else np.flatnonzero(chosen)

    def energy(self) -> Array | None:
        """Stored energy per initial volume at the region's points (J/m^d); None if not known."""
        return self._points.fields.read(STORED)[self.rows] if self._stores else None

    def run(self, evaluation: Evaluation, new: dict[str, Array]) -> None:
        """Write stress and energy at the end of the step into new arrays.

        Args:
            evaluation: Evaluation of the point terms, at the step's increments.
            new: New arrays of fields by name; extended.
        """
        rows, points, d = self.rows, self._points, self._points.strain_dim
        for name in ("stress", "moved_under", *((STORED,) if self._stores else ())):
            if name not in new:
                new[name] = points[name].copy()
        values = evaluation.run(self._placeholders, self._program, rows)
        sigma = values[:, : d * d].reshape(-1, d, d)
        new["stress"][rows] = 0.0
        new["stress"][rows, :d, :d] = 0.5 * (sigma + np.swapaxes(sigma, 1, 2))
        new["moved_under"][rows] = self._mark
        if self._stores:
            new[STORED][rows] = values[:, -1]


def _full(tensor: Expr, around: Expr, points: MaterialPoints) -> Expr:
    """A tensor of shape (gdim, gdim), extended by its hoop component at axisymmetric points."""
    if not points.axisymmetric:
        return tensor
    rows = [[tensor[i, j] for j in range(2)] + [0] for i in range(2)]
    return ufl.as_tensor([*rows, [0, 0, around]])


def _density_of(term: Expr, space: Space) -> Expr | None:
    """Strain energy density of a term that is a derivative of an energy (J per unit of measure).

    The density is found in `ufl.derivative(energy * dX, u, v)` before UFL expands the derivative.
    Parts of the energy without the gradient of u, such as the potential of a load, are left out.
    The density is 0 for a term without the gradient of the test function.

    Args:
        term: The term.
        space: Space of the increment u and the test function v.

    Returns:
        The density, or None if the term is no derivative of an energy.
    """
    if isinstance(term, Sum):
        total: Expr = zero()
        for one in term.ufl_operands:
            part = _density_of(one, space)
            if part is None:
                return None
            total = total + part
        return total
    if isinstance(term, (Product, Division)):
        return _scaled(term, space)
    if isinstance(term, CoefficientDerivative):
        energy, variables, directions = term.ufl_operands[:3]
        if list(variables.ufl_operands) != [space.increment]:
            return _other(term, space)
        if list(directions.ufl_operands) != [space.test]:
            return None
        strained = [one for one in summands(energy) if _has_slope(one, [space.increment])]
        return sum(strained, start=zero())
    return _other(term, space)


def _scaled(term: Expr, space: Space) -> Expr | None:
    """Density of a derivative times a factor that does not depend on the increment."""
    first, second = term.ufl_operands
    for part, factor in ((first, second), (second, first)):
        of_test = any(a == space.test for a in extract_arguments(part))
        if not of_test or depends_on(factor, [space.increment]):
            continue
        density = _density_of(part, space)
        if density is None:
            return None
        return density / factor if isinstance(term, Division) else density * factor
    return _other(term, space)


def _other(term: Expr, space: Space) -> Expr | None:
    """0 for a term without the test function's gradient, else None: its energy is not known."""
    tests = [a for a in extract_arguments(term) if a == space.test]
    return None if tests and _has_slope(term, tests) else zero()


def _has_slope(expression: Expr, of: Sequence[Any]) -> bool:
    """Whether an expression contains a gradient of one of the functions."""
    return any(
        isinstance(node, SPATIAL_DERIVATIVES)
        and any(c in of for c in (*extract_coefficients(node), *extract_arguments(node)))
        for node in unique_pre_traversal(expression)
    )
