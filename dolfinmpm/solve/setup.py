"""Preparation of a problem's form: stabilisations with moduli, updates of fields, and a check."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import ufl
from ufl.core.expr import Expr

from dolfinmpm._platform.argumentchecks import Tags
from dolfinmpm._platform.errors import ParameterError
from dolfinmpm.assembly.pointupdates import PointUpdates
from dolfinmpm.assembly.uflstress import UFLStress
from dolfinmpm.basis.space import Space
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.cut.activation import Field, movers
from dolfinmpm.cut.stabilisations import Stabilisation
from dolfinmpm.forms.carriedfields import CarriedField
from dolfinmpm.forms.declarations import declared
from dolfinmpm.forms.hoop import check_hoop
from dolfinmpm.forms.termqueries import penalty_of
from dolfinmpm.kinematics.fbar import VOLUMES
from dolfinmpm.kinematics.footing import motions_under_footings
from dolfinmpm.kinematics.strainhistory import ENERGY, MARKS
from dolfinmpm.solve.weakform import WeakForm

__all__ = [
    "Stabilisations",
    "refuse_held_faces",
    "updates_of",
    "with_moduli",
    "with_stabilisations",
]

Stabilisations = Stabilisation | str | Sequence[Stabilisation | str]


def with_moduli(
    stabilisations: Sequence[Stabilisation],
    spaces: Sequence[Space],
    form: ufl.Form,
    points: MaterialPoints,
) -> list[Stabilisation]:
    """The fields' stabilisations, with moduli of the form's laws by default. Collective.

    The largest modulus of all laws and points is taken. A penalty that is too stiff costs less than
    a penalty that leaves the stiffest cells ill-conditioned.

    Raises:
        ParameterError: A stabilisation needs a modulus, and no law in the form has one, or the
            field is no displacement.
    """
    made = []
    for k, (stabilisation, space) in enumerate(zip(stabilisations, spaces)):
        if (
            stabilisation.needs_modulus or stabilisation.follows_tangent
        ) and stabilisation.E is None:
            if stabilisation.kind == "ghost" and penalty_of(form, space.increment) is not None:
                made.append(stabilisation)
                continue
            if space.increment.ufl_shape != (points.gdim,):
                raise ParameterError(
                    f'stabilisation="{stabilisation.kind}" of field {k + 1} needs a modulus: it '
                    "is no displacement, whose law would have one; give mpm.Stabilisation("
                    f'"{stabilisation.kind}", E=...) in a list with one entry per field, or "none"'
                )
            if stabilisation.needs_modulus:
                stabilisation = _with_modulus(stabilisation, form, points, space)
        made.append(stabilisation)
    return made


def _with_modulus(
    stabilisation: Stabilisation, form: ufl.Form, points: MaterialPoints, space: Space
) -> Stabilisation:
    moduli = []
    for declaration in declared(form, points):
        own = space.tags is None or declaration.u is space.increment
        if own and "E" in declaration.law.values:
            declaration.bind()
            moduli.append((declaration.largest("E"), declaration.largest("nu")))
    if not moduli:
        raise ParameterError(
            f'stabilisation="{stabilisation.kind}" needs a modulus, and no law in the form '
            f'has one: give mpm.Stabilisation("{stabilisation.kind}", E=...)'
        )
    E, nu = max(moduli)
    return replace(stabilisation, E=E, nu=nu)


def with_stabilisations(
    form: ufl.Form, fields: Sequence[Field], points: MaterialPoints
) -> tuple[ufl.Form, ufl.Form | None, ufl.Form | None]:
    """The form with the forces of the fields' stabilisations, and further terms of them.

    Returns:
        The form; the soft stiffness; and ghost penalties on the change of velocity in a step, for
        fields with constraints besides their stabilisation.
    """
    soft = changes = None
    for field in fields:
        trial, stabilisation = (field.space.increment, field.space.test), field.stabilisation
        known = penalty_of(form, trial[0]) if stabilisation.E is None else None
        if (
            field.second is not None
            and stabilisation.kind == "ghost"
            and stabilisation.factor is None
        ):
            # constraints have the effect of the larger factors for splines already
            stabilisation = replace(stabilisation, factor=1.0)
        extra = stabilisation.force_terms(points, *trial, known)
        if field.second is not None:
            changes, extra = _sum(changes, extra), None
        form = form if extra is None else form + extra
        soft = _sum(soft, stabilisation.tangent_terms(points, *trial))
    return form, soft, changes


def _sum(first: ufl.Form | None, second: ufl.Form | None) -> ufl.Form | None:
    return first if second is None else second if first is None else first + second


def updates_of(form: WeakForm, given: Mapping[str, Expr]) -> list[PointUpdates | UFLStress]:
    """Fields set by a converged step: those of laws and terms, and the user's. Collective.

    Raises:
        FormError: An expression lacks the hoop term of axisymmetric points.
    """
    made: list[PointUpdates | UFLStress] = [
        PointUpdates(declaration.updates, form.regions, form.spaces, form.points, declaration.tags)
        for declaration in form.parts.declarations
        if declaration.updates
    ]
    kept = [f for f in form.parts.carried if isinstance(f, CarriedField) and f.name not in given]
    faces, kept = [f for f in kept if f.surface], [f for f in kept if not f.surface]
    several = {f.name for f in kept if sum(f.name == other.name for other in kept) > 1}
    groups: dict[tuple[Tags, bool], dict[str, Expr]] = {(None, True): {}, (None, False): {}}
    for f in kept:
        # points without terms take part where there is no choice
        tags = f.tags if f.name in several else None
        groups.setdefault((tags, f.level is not None), {})[f.name] = f.update
    groups[None, False] |= given
    for (tags, carried), updates in groups.items():
        for expression in updates.values():
            check_hoop(form.points, expression)
        if updates:
            made.append(
                PointUpdates(updates, form.regions, form.spaces, form.points, tags, carried)
            )
    for one in faces:
        term = next(t for t in form.surfaces if t.surface is one.surface)
        update = {one.name: one.surface.without_way(one.update)}
        made.append(PointUpdates(update, form.regions, form.spaces, form.points, term=term))
    return [*made, *_own_stresses(form, given)]


def _own_stresses(form: WeakForm, given: Mapping[str, Expr]) -> list[UFLStress]:
    """Stresses of points without a law, from terms in UFL. They are stored in the form.

    The list is empty if the form or the user sets the field `stress`.
    """
    moving = movers(form.spaces)
    without = [r for r in form.regions if not r.ruled(form.parts.declarations)]
    regions = [r for r in without if any(r.strains(k) for k in moving)]
    seen = any(
        ("field", "stress") in region.placeholders.sources.values() for region in form.regions
    )
    if not regions or seen or "stress" in given:
        return []
    integrals, mark = form.parts.tagged.integrals, MARKS[ENERGY]
    shape = (form.points.gdim,)
    if any(form.spaces[k].increment.ufl_shape != shape for k in moving):
        return []
    made = [UFLStress(r, integrals, form.spaces, moving, form.points, mark) for r in regions]
    form.ufl_stresses = [one for one in made if one.known]
    return form.ufl_stresses


def refuse_held_faces(given: ufl.Form, form: WeakForm) -> None:
    """Raise if a form with fbar="volumes" holds faces of the body at a place.

    Args:
        given: Weak form of the user.
        form: The same, prepared.

    Raises:
        ParameterError: Mean volumes scale F after a step, which moves the faces F R without a
            motion. A stiff footing makes large forces of that.
    """
    kept = next((d for d in form.parts.declarations if d.fbar == VOLUMES), None)
    holders = [f"the footing with the field {name}" for name in motions_under_footings(given)]
    holders += [str(term) for term in form.terms if term.holds_faces]
    if kept is not None and holders:
        raise ParameterError(
            f'fbar = "{VOLUMES}" of {kept.law!r} and {holders[0]}: mean volumes change F after a '
            "step, which shifts the faces of points, and what holds these faces would resist. "
            "Take fbar=True, or a RigidBody with mpm.contact"
        )
