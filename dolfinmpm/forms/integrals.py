"""Sort the integrals of a weak form: over points, markers of boundaries, cells and facets."""

from collections.abc import Mapping, Sequence
from typing import Any

import ufl
from dolfinx import fem
from ufl.algorithms import extract_coefficients
from ufl.corealg.traversal import unique_pre_traversal

from dolfinmpm._platform.errors import FormError
from dolfinmpm.basis.space import Space
from dolfinmpm.body.formsigns import FACETS
from dolfinmpm.body.points import MaterialPoints, PointField
from dolfinmpm.forms.operators import PointOperator
from dolfinmpm.forms.termqueries import SPATIAL_DERIVATIVES, brief, check_solved_for, summands

__all__ = ["by_measure", "check_derivatives"]


def check_derivatives(form: Any) -> None:
    """Check that a form differentiates only functions that have gradients at the points.

    Raises:
        FormError: The form is no UFL form, or it has the gradient of a field of the points or of
            a law.
    """
    if not isinstance(form, ufl.Form):
        raise FormError(f"the weak form must be a UFL form, got {type(form).__name__}")
    for integral in form.integrals():
        for node in unique_pre_traversal(integral.integrand()):
            if isinstance(node, SPATIAL_DERIVATIVES):
                # UFL treats a field of the points as constant and would drop the term
                inside = extract_coefficients(node)
                for c in inside:
                    if isinstance(c, (PointField, PointOperator)):
                        raise FormError(
                            f"'{brief(node)}' differentiates '{c}', which has values only at the "
                            "points, and no gradient"
                        )


def by_measure(
    form: ufl.Form, spaces: Sequence[Space], points: MaterialPoints, of_markers: Mapping[int, Any]
) -> tuple[list[Any], dict[int, list[Any]], list[Any]]:
    """Sort integrals: over the points, over the markers of each boundary, and over the grid.

    Args:
        form: Weak form.
        spaces: Spaces of the increments.
        points: Material points that the problem moves.
        of_markers: Boundaries by the number of their markers.

    Returns:
        Integrals over the points, over markers by their number, and over the grid.

    Raises:
        FormError: An integral is over other points, or its measure of points has other metadata.
    """
    at_points: list[Any] = []
    at_markers: dict[int, list[Any]] = {number: [] for number in of_markers}
    ordinary: list[Any] = []
    for integral in form.integrals():
        if integral.integral_type() == "custom":
            if "points" not in integral.metadata():
                raise FormError(
                    f"the term '{brief(integral.integrand())}' changes the metadata of a measure "
                    "of points; points take no quadrature degree"
                )
            number = integral.metadata()["points"]
            if number in at_markers:
                at_markers[number].append(integral)
                continue
            if number != points.number:
                raise FormError(
                    f"the term '{brief(integral.integrand())}' is integrated over material points "
                    "that the problem does not move: a form belongs to the points that it was made "
                    "with; make it anew with these points, or give the problem the points of the "
                    "form"
                )
            _check_density(integral)
            at_points.append(integral)
        else:
            _check_ordinary(integral, spaces)
            if integral.metadata().get(FACETS, points.number) != points.number:
                raise FormError(
                    f"the term '{brief(integral.integrand())}' is over cells or facets of other "
                    "material points than those that the problem moves: give mpm.ghost, mpm.soft, "
                    "dS and dC the same points"
                )
            ordinary.append(integral)
    return at_points, at_markers, ordinary


def _check_density(integral) -> None:
    """Refuse the density, mass per first volume, times present volumes: the mass would change."""
    if integral.metadata().get("volume") != "V":
        return
    for term in summands(integral.integrand()):
        names = {c.name for c in extract_coefficients(term) if isinstance(c, PointField)}
        if "density" in names and not names & {"F", "V", "V0"}:
            raise FormError(
                f"the term '{brief(term)}' has points.density, the mass per first volume, over "
                "points.dx, the present volumes: the mass would change as the body is compressed; "
                "integrate over points.dX, or divide by the volume change, ufl.det(points.F)"
            )


def _check_ordinary(integral, spaces: Sequence[Space]) -> None:
    term, kind = integral.integrand(), integral.integral_type()
    if kind not in ("cell", "exterior_facet", "interior_facet"):
        raise FormError(
            f"'{brief(term)}' is integrated over '{kind}'; use dx, ds, dS or a measure of points"
        )
    if integral.ufl_domain() != spaces[0].grid.ufl_domain():
        raise FormError(f"'{brief(term)}' is integrated over another mesh than the grid")
    for a in ufl.algorithms.extract_arguments(term):
        if not any(a == space.test for space in spaces):
            raise FormError(
                f"'{a}' in '{brief(term)}' is not the test function of a space that the problem "
                "solves for; use Space.test"
            )
    for c in extract_coefficients(term):
        if isinstance(c, fem.Function) and c.function_space.mesh is not spaces[0].grid:
            raise FormError(f"the function '{c}' in '{brief(term)}' lives on another mesh")
        check_solved_for(c, spaces)
        if isinstance(c, (PointField, PointOperator)):
            raise FormError(
                f"'{c}' lives at the material points, but '{brief(integral.integrand())}' is "
                f"integrated over the grid ({integral.integral_type()}); use points.dX, the first "
                "volumes, or points.dx, the present ones"
            )
        if not isinstance(c, fem.Function):
            raise FormError(f"the coefficient '{c}' has no values; use dolfinx.fem.Function")
