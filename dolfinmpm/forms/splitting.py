"""Split a weak form into terms that the points integrate and terms that DOLFINx integrates."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import ufl
from ufl.algorithms import expand_derivatives, extract_coefficients

from dolfinmpm._platform.argumentchecks import Tags
from dolfinmpm._platform.errors import FormError
from dolfinmpm.basis.space import Space
from dolfinmpm.body.boundary import Boundary
from dolfinmpm.body.markerstate import take_state
from dolfinmpm.body.points import GHOST_FACETS, MaterialPoints, PointField
from dolfinmpm.body.surface import Surface
from dolfinmpm.forms.carriedfields import CarriedField, carried_in
from dolfinmpm.forms.declarations import Declaration, declared, rows_within
from dolfinmpm.forms.gridterms import GridTerms
from dolfinmpm.forms.integrals import by_measure, check_derivatives
from dolfinmpm.forms.lawderivatives import differentiate_through_laws
from dolfinmpm.forms.operators import AveragingLaw
from dolfinmpm.forms.pointterms import PointTerms
from dolfinmpm.forms.tagchecks import TagChecks, check_subdomains, tags_by_term
from dolfinmpm.forms.termqueries import brief, operators_in, share_units, tags_of, term_of

__all__ = ["BoundaryTerms", "SplitForm", "SurfaceTerms", "split"]


@dataclass(frozen=True)
class BoundaryTerms:
    """Terms over a boundary that does not fit the grid.

    Attributes:
        boundary: The boundary.
        regions: Terms that the markers integrate, in the way of points.
        declarations: Declarations of the laws in the terms, with data at the markers.
        conditions: Conditions that compute numbers at the markers before each step; see
            `dirichlet`.
        increments: Increments of the fields in the terms.
        stateful: Whether the terms need the state of the body at the markers.
        tags: Tags of the points of the body, or None for all points.
    """

    boundary: Boundary
    regions: list[PointTerms]
    declarations: list[Declaration]
    conditions: list[Any]
    increments: list[Any]
    stateful: bool
    tags: Tags

    def sees(self, u: Any) -> bool:
        """Whether the terms contain the field of an increment."""
        return any(u is one for one in self.increments)


@dataclass(frozen=True)
class SurfaceTerms:
    """Terms over the faces of points.

    Attributes:
        surface: The surface.
        terms: The terms, which the points of the surface integrate.
    """

    surface: Surface
    terms: PointTerms


@dataclass(frozen=True)
class SplitForm:
    """A weak form, split.

    Attributes:
        regions: Terms that points integrate. Parts of the body with different terms have one
            entry each.
        grid: Terms over the grid.
        declarations: Declarations of the laws in the form.
        carried: Fields that terms carry from step to step, or that are set when a step begins.
        boundaries: Terms over boundaries that do not fit the grid.
        surfaces: Terms over the faces of points.
        terms: Terms that are no quadrature of its points, see `dolfinmpm.assembly.term`.
        tagged: The part for points of some tags only.
    """

    regions: list[PointTerms]
    grid: GridTerms
    declarations: list[Declaration]
    carried: list[PointField]
    boundaries: list[BoundaryTerms]
    surfaces: list[SurfaceTerms]
    terms: list[Any]
    tagged: TagChecks


def split(form: ufl.Form, spaces: Sequence[Space], points: MaterialPoints) -> SplitForm:
    """Split a weak form. Collective.

    Args:
        form: Weak form, linear in the spaces' test functions.
        spaces: Spaces of the increments that are solved for.
        points: Material points whose measures the form may contain.

    Raises:
        FormError: A term cannot be evaluated on its measure; the message names the term.
    """
    check_derivatives(form)
    form, terms = _without_terms(form, points)
    declarations = declared(form, points)
    for declaration in declarations:
        declaration.bind()
    kept = carried_in(form)
    share_units(form)
    new = {one.name for one in kept} - set(points.fields)
    for one in kept:
        points.add_field(one.name, one.ufl_shape, one.unit, one.first)
    _set_first(points, [one for one in kept if one.name in new])
    touching = _touching(terms, spaces)
    of_markers = {b.markers.number: b for b in _boundaries(form, points)}
    with_terms = set(of_markers)
    of_markers |= {number: boundary for number, (boundary, _) in touching.items()}
    of_laws = {number: declared(form, b.markers) for number, b in of_markers.items()}
    increments = {
        number: _increments(form, number, spaces, touching.get(number)) for number in of_markers
    }
    tags = {number: _tags_of_fields(found) for number, found in increments.items()}
    for number, boundary in of_markers.items():
        if number in with_terms:
            take_state(boundary, tags[number])
        for declaration in of_laws[number]:
            declaration.bind()
    for term in terms:
        term.bind(declarations)
    as_given = [i for i in form.integrals() if (i.metadata() or {}).get("points") == points.number]
    form = expand_derivatives(differentiate_through_laws(form))
    at_points, at_markers, ordinary = by_measure(form, spaces, points, of_markers)
    at_points, surfaces = _at_faces(at_points, spaces, points)
    check_subdomains(ordinary, points.grid)
    others = [(repr(term), term.tags) for term in terms if not term.sides]
    for number, boundary in of_markers.items():
        name = f"a term over {boundary!r}"
        others += [(name, tags) for _, tags in tags_by_term(at_markers[number])]
    alone = all(i.subdomain_id() == GHOST_FACETS for i in ordinary)
    tagged = TagChecks(points, as_given, others, declarations, spaces, alone)
    return SplitForm(
        _regions(at_points, spaces, points, declarations),
        GridTerms(ordinary, spaces),
        declarations,
        kept,
        [
            BoundaryTerms(
                boundary,
                _regions(at_markers[number], spaces, boundary.markers, of_laws[number]),
                of_laws[number],
                _conditions(at_markers[number]),
                increments[number],
                number in with_terms,
                tags[number],
            )
            for number, boundary in of_markers.items()
        ],
        surfaces,
        terms,
        tagged,
    )


def _at_faces(
    integrals, spaces: Sequence[Space], points: MaterialPoints
) -> tuple[list[Any], list[SurfaceTerms]]:
    """Integrals over points, and terms over faces of points, one entry per surface.

    Raises:
        FormError: A surface belongs to other material points, or a term contains the stress of a
            law.
    """
    rest: list[Any] = []
    found: dict[int, tuple[Surface, list[Any]]] = {}
    for integral in integrals:
        surface = integral.metadata().get("surface")
        if surface is None:
            rest.append(integral)
            continue
        term = integral.integrand()
        if operators_in(term):
            raise FormError(
                f"the term '{brief(term)}' has the stress of a law on the measure of the surface "
                f"'{surface.name}', and laws act at the centres of points: integrate over points.dX"
            )
        own = integral.reconstruct(integrand=surface.without_way(term))
        found.setdefault(id(surface), (surface, []))[1].append(own)
    return rest, [SurfaceTerms(s, PointTerms(own, spaces, points)) for s, own in found.values()]


def _touching(terms, spaces: Sequence[Space]) -> dict[int, tuple[Boundary, Any]]:
    """Boundaries that terms need, and the increments that move them, by their markers' number.

    Raises:
        FormError: The problem does not solve for the increment, two terms differ in it, or are
            of the same boundaries.
    """
    pairs = [{b.markers.number for b, _ in term.sides} for term in terms]
    for k, pair in enumerate(pairs):
        if pair and pair in pairs[:k]:
            raise FormError(
                f"the form has {terms[k]!r} twice, and the bodies would feel its force twice: "
                "leave one out"
            )
    found: dict[int, tuple[Boundary, Any]] = {}
    for term in terms:
        for boundary, u in term.sides:
            if not any(u is space.increment for space in spaces):
                raise FormError(
                    f"{term!r} is for a field that the problem does not solve for; give its "
                    "increment to the problem as an unknown"
                )
            known = found.setdefault(boundary.markers.number, (boundary, u))
            if known[1] is not u:
                raise FormError(
                    f"{boundary} moves with one field in one contact, and with another field in a "
                    "second contact; give both the same field"
                )
    return found


def _boundaries(form: ufl.Form, points: MaterialPoints) -> list[Boundary]:
    """Boundaries in a form, each once.

    Raises:
        FormError: A boundary belongs to other material points.
    """
    found: list[Boundary] = []
    for integral in form.integrals():
        boundary = (integral.metadata() or {}).get("boundary")
        if boundary is None or any(boundary is b for b in found):
            continue
        if boundary.points is not points:
            raise FormError(
                f"the term '{brief(integral.integrand())}' is over a boundary of other material "
                "points than the points that the problem moves"
            )
        found.append(boundary)
    return found


def _conditions(integrals) -> list[Any]:
    """Conditions in the metadata of integrals, each once."""
    found: list[Any] = []
    for integral in integrals:
        condition = integral.metadata().get("condition")
        if condition is not None and not any(condition is c for c in found):
            found.append(condition)
    return found


def _tags_of_fields(increments) -> Tags:
    """Tags of the points of some fields, or None if one of the fields is for all points."""
    tags = [u._dolfinmpm_space.tags for u in increments]
    if not tags or None in tags:
        return None
    return tuple(sorted({tag for own in tags for tag in own}))


def _increments(form, number: int, spaces: Sequence[Space], touching=None) -> list[Any]:
    """Increments of the fields in terms over markers, or of the field in a boundary's contact.

    Args:
        form: The form.
        number: Number of the markers.
        spaces: Spaces of the increments.
        touching: The boundary and its increment, if the boundary is in a contact.
    """
    if touching is not None:
        return [touching[1]]
    integrals = [i for i in form.integrals() if (i.metadata() or {}).get("points") == number]
    found = []
    for space in spaces:
        for integral in integrals:
            term = integral.integrand()
            tests = ufl.algorithms.extract_arguments(term)
            own = any(c is space.increment for c in extract_coefficients(term))
            if own or any(a == space.test for a in tests):
                found.append(space.increment)
                break
    return found


def _set_first(points: MaterialPoints, kept: Sequence[PointField]) -> None:
    """Give new fields the first values of the expressions that points of their tags carry."""
    for one in kept:
        if isinstance(one, CarriedField) and any(o.name == one.name for o in kept if o is not one):
            own = rows_within(points, one.tags)
            points[one.name][own] = one.first_values(points["x0"][own])


def _without_terms(form: ufl.Form, points: MaterialPoints) -> tuple[ufl.Form, list[Any]]:
    """The form's UFL terms, and its other terms, which are no quadrature of its points.

    Raises:
        FormError: A term is not simply added, or is one of other points.
    """
    others, terms = [], []
    for integral in form.integrals():
        term = term_of(integral)
        if term is None:
            others.append(integral)
            continue
        if integral.integrand() != term.integrand:
            raise FormError(
                f"{term!r} is scaled or subtracted in the weak form; it counts as internal "
                "forces do and is added: write F += ..."
            )
        if term.points is not points:
            raise FormError(
                f"{term!r} is of material points that the problem does not move: make it anew "
                "with these points"
            )
        terms.append(term)
    return (ufl.Form(others), terms) if terms else (form, terms)


def _regions(
    integrals, spaces: Sequence[Space], points: MaterialPoints, declarations: list[Declaration]
) -> list[PointTerms]:
    """The points' terms, one entry per set of tags with the same terms and laws. Collective."""
    where = [tags_of(i) for i in integrals]
    laws = sorted(
        {o.tags for i in integrals for o in operators_in(i.integrand()) if o.tags is not None}
    )
    mentioned = sorted({tag for tags in (*where, *laws) for tag in tags or ()})
    # points with different laws in one cell share the mean over the cell: one region for all
    averages = any(
        isinstance(o.law, AveragingLaw) for i in integrals for o in operators_in(i.integrand())
    )
    shape = (points.gdim,)
    bodies = [s.tags for s in spaces if s.tags is not None and s.increment.ufl_shape == shape]
    if averages and bodies:
        # but each body with its own displacement has its own means, also in shared cells
        return [
            PointTerms(
                integrals, spaces, points, frozenset(tags), declarations=declarations, mixed=True
            )
            for tags in bodies
        ]
    if not mentioned or averages:
        return [PointTerms(integrals, spaces, points, declarations=declarations)]
    alike: dict[tuple, set[int]] = {}
    for tag in mentioned:
        terms = tuple(k for k, tags in enumerate(where) if tags is None or tag in tags)
        alike.setdefault((terms, tuple(tag in tags for tags in laws)), set()).add(tag)
    regions = [
        PointTerms(
            [integrals[k] for k in terms], spaces, points, frozenset(tags), False, declarations
        )
        for (terms, _), tags in alike.items()
    ]
    rest = [i for i, tags in zip(integrals, where) if tags is None]
    return [
        *regions, PointTerms(rest, spaces, points, frozenset(mentioned), True, declarations)
    ]  # fmt: skip
