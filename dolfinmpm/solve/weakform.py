"""A weak form over points and grid as a sum of terms, prepared for any activation."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from ufl.algorithms.analysis import extract_constants

from dolfinmpm._platform.errors import FormError
from dolfinmpm.assembly.evaluation import Evaluation
from dolfinmpm.assembly.gridassembler import GridAssembler
from dolfinmpm.assembly.pointupdates import PointUpdates
from dolfinmpm.assembly.term import ActiveTerm, Term
from dolfinmpm.assembly.uflstress import UFLStress
from dolfinmpm.basis.space import Space
from dolfinmpm.body.points import GHOST_FACETS, MaterialPoints
from dolfinmpm.contact.meanforces import MeanForceWeights
from dolfinmpm.cut.activate import active_region
from dolfinmpm.cut.activation import Activation, ActiveDomain, ActiveField, Coupling, movers
from dolfinmpm.cut.celloffsets import cell_offsets
from dolfinmpm.cut.facetmoduli import FIELD, FacetModulus, FacetRing, bounded
from dolfinmpm.cut.firstgradients import set_first_gradient
from dolfinmpm.cut.pattern import Blocks
from dolfinmpm.forms.carriedfields import CarriedField, CellOffset
from dolfinmpm.forms.declarations import Declaration, LawConstant
from dolfinmpm.forms.pointterms import PointTerms
from dolfinmpm.forms.splitting import SplitForm, split
from dolfinmpm.grid.lattice import times_regridded
from dolfinmpm.terms.boundaryterm import BoundaryTerm
from dolfinmpm.terms.gridterm import GridTerm
from dolfinmpm.terms.surfaceterm import SurfaceTerm

__all__ = ["WeakForm"]

Array = npt.NDArray[np.float64]


class WeakForm:
    """A weak form over points and grid, prepared for activations. Collective.

    It is the sum of the points' integrals and of other terms.

    Args:
        form: Weak form, linear in the test functions.
        spaces: Spaces of the increments.
        points: Material points.
        soft: Soft stiffness, which is in the tangent only, or None.
        changes: Penalties on the change of velocity in a step in time, as terms of the increments,
            or None.

    Attributes:
        given: The form of the user.
        parts: The form, split into its parts.
        spaces: The spaces.
        points: The material points.
        boundaries: Terms over boundaries that do not fit the grid.
        grid: Integrals assembled by DOLFINx.
        terms: All terms except the integrals over the points.
        softened: Whether there is soft stiffness.
        moduli: Moduli of the laws' tangents at facets, in terms of the form.
        also: Subdomain ids that other forms need on the same activations.
        contact_mode: Weights of mean contact forces over a step in time, or None; whether contact
            follows gaps in time, or None in steps without time.
        ufl_stresses: Stresses of points without a law, from terms in UFL.
        updates: Fields of the points that a step sets to UFL expressions.
        placed: Number of changes of the grid's lines at the last check.

    Raises:
        FormError: A term cannot be evaluated in its integral, or a penalty follows the tangent of
            a law and the form has no law.
    """

    def __init__(
        self,
        form: ufl.Form,
        spaces: Sequence[Space],
        points: MaterialPoints,
        soft: ufl.Form | None = None,
        changes: ufl.Form | None = None,
    ):
        self.given = form
        self.parts: SplitForm = split(form, spaces, points)
        self.spaces, self.points = list(spaces), points
        self.grid = GridAssembler(self.parts.grid, spaces)
        grids = [GridTerm(self.grid)]
        for kind, more in (("soft", soft), ("changes", changes)):
            if more is not None:
                own = GridAssembler(split(more, spaces, points).grid, spaces)
                grids.append(GridTerm(own, kind))
        self.softened = soft is not None
        self.boundaries = [BoundaryTerm(of, spaces) for of in self.parts.boundaries]
        faces = [SurfaceTerm(of) for of in self.parts.surfaces]
        self.terms: list[Term] = [*self.boundaries, *faces, *self.parts.terms, *grids]
        self.placed = times_regridded(points.grid)
        self.also: set[int] = set()
        self.contact_mode: tuple[MeanForceWeights | None, bool | None] = None, None
        self.ufl_stresses: list[UFLStress] = []
        self.updates: Sequence[PointUpdates | UFLStress] = ()
        # none before the first step
        self._revision = -1
        found = [m for g in grids for m in g.moduli]
        self.moduli = [m for m in found if not isinstance(m, FacetRing)]
        self._first_moduli()
        every = [*self.regions, *(r for b in self.boundaries for r in b.regions)]
        for region in (*every, *(face.terms for face in faces)):
            # errors of compilation must show now; tangents wait until a solver needs them
            region.external, region.internal, region.operands  # noqa: B018

    @property
    def surfaces(self) -> list[SurfaceTerm]:
        """Terms over the faces of points."""
        return [term for term in self.terms if isinstance(term, SurfaceTerm)]

    @property
    def has_boundary_forces(self) -> bool:
        """Whether forces on boundaries or on faces of points depend on the increments."""
        return bool(self.boundaries) or any(term.follows for term in self.surfaces)

    @cached_property
    def has_rates(self) -> bool:
        """Whether forces that move points have rates over `points.dt`, or accelerations."""
        timed = {self.points.dt, self.points.inertia}
        if timed.isdisjoint(extract_constants(self.given)):
            return False
        own = movers(self.spaces)
        others = [space.test for k, space in enumerate(self.spaces) if k not in own]
        rest = ufl.replace(self.given, {q: ufl.zero(q.ufl_shape) for q in others})
        return not timed.isdisjoint(extract_constants(rest))

    def add(self, term: Term) -> None:
        """Add a term outside the UFL form, such as the mass."""
        self.terms.append(term)

    def start_in_time(self, weights: MeanForceWeights | None) -> None:
        """Prepare for steps in time.

        Args:
            weights: Weights of mean contact forces over a step; None if contact acts at the
                start of a step.
        """
        self.contact_mode = weights, True
        for term in self.terms:
            term.start_in_time(weights)
        self.set_contacts()

    def set_contacts(self) -> None:
        """Let contacts act as in the steps of this form; other forms may share them."""
        for term in self.terms:
            term.act(*self.contact_mode)

    @property
    def contact_weights(self) -> MeanForceWeights | None:
        """Weights of mean contact forces over a step in time, or None."""
        return self.contact_mode[0]

    def on(self, here: Activation) -> tuple[Evaluation, dict[Term, ActiveTerm]]:
        """The points' integrals, and the other terms, on an activation. Collective.

        The activation may belong to another form. Then this form makes its own parts of the body.
        """
        for field in self.parts.carried:
            if isinstance(field, CellOffset):
                (of,) = (f for f in here.fields if f.space is field.space)
                self.points[field.name] = cell_offsets(here.where, of)
        self._set_first_gradients(here)
        parts = here.regions
        if here.terms is not self:
            parts = [active_region(r, self.points, here) for r in self.regions]
            if self.parts.grid:
                self.grid.attach(here.fields)
        evaluation = Evaluation(self.regions, self.points, here.unknowns, parts)
        self.set_contacts()
        found = {term: term.on(here) for term in self.terms}
        return evaluation, {term: one for term, one in found.items() if one is not None}

    def _set_first_gradients(self, here: Activation) -> None:
        """Set gradients of values that the user gave to the points. Collective."""
        for slope in self.parts.carried:
            if isinstance(slope, CarriedField) and slope.slope_of is not None:
                at = self.values.index(slope.slope_of)
                set_first_gradient(self.points, slope, here.fields[at])

    def bind(self) -> None:
        """Set initial values of the laws at new points. Collective.

        Raises:
            FormError: In the first call: tags of the form match no points, or points have a load
                and no law.
        """
        first, revision = self._revision < 0, self.points.revision
        if first:
            self.parts.tagged.check()
        # the user may have set fields after making the problem
        if first or self._revision != revision:
            for declaration in self.parts.declarations:
                declaration.bind()
            for term in self.terms:
                term.bind(self.parts.declarations)
            self._revision = revision
            self._first_moduli()

    def check_new_tags(self) -> None:
        """Refuse loads on points whose tags are new, and have no law. Collective.

        Raises:
            FormError: Loaded points have no law.
        """
        if self._revision >= 0 and any(self.parts.tagged.of_laws):
            self.parts.tagged.check_new()

    def _laws_of(self, modulus: FacetModulus) -> list[Declaration]:
        """The laws whose tangent gives a modulus.

        Raises:
            FormError: There is no such law.
        """
        found = [d for d in self.parts.declarations if d.u is modulus.increment]
        if not found:
            raise FormError(
                "a ghost penalty by a factor follows the tangent of a law, and the form has no "
                "mpm.momentum of this increment: give it a γ in Pa, as "
                "mpm.ghost(points, u, v, gamma=E/30), or the modulus, as "
                'mpm.Stabilisation("ghost", E=...)'
            )
        return found

    def _elastic(self) -> Array:
        """Elastic moduli at the points (Pa), shape (points, 2); 0 at points without such a law."""
        laws = {id(d): d for modulus in self.moduli for d in self._laws_of(modulus)}
        return self._moduli_of(list(laws.values()))

    def _moduli_of(self, laws: Sequence[Declaration]) -> Array:
        out = np.zeros((len(self.points), 2))
        for declaration in laws:
            out[declaration.rows] = declaration.elastic.moduli()
        return out

    def set_penalties(self, here: Activation, ghost: bool = True) -> None:
        """Set the penalties of weak conditions on an activation. Collective.

        Args:
            here: The activation.
            ghost: Whether terms over its ghost facets act.
        """
        increments = [space.increment for space in self.spaces]
        laws = self.parts.declarations
        tied = any(f.C is not None for f in here.fields) or bool(here.blocks_of("penalty"))
        stabilised = tied or (ghost and GHOST_FACETS in self.moving)
        sharing = [d.u for d in laws if d.fbar]
        for boundary in self.boundaries:
            boundary.set_penalties(
                here, lambda: self._moduli_of(laws), increments, stabilised, sharing
            )

    def _first_moduli(self) -> None:
        """Set elastic moduli at points without moduli of a tangent."""
        if not self.moduli:
            return
        self.points.add_field(FIELD, (2,), "Pa")
        new = self.points[FIELD][:, 0] == 0
        elastic = self._elastic()
        self.points[FIELD][new] = bounded(elastic, elastic, self._shared())[new]

    def _shared(self) -> npt.NDArray[np.bool_]:
        """Whether points share their volume change (F-bar), shape (points,)."""
        out = np.zeros(len(self.points), bool)
        for declaration in self.parts.declarations:
            out[declaration.rows] = bool(declaration.fbar)
        return out

    def bounded_moduli(self, moduli: Array) -> Array:
        """Moduli of tangents within bounds; elastic ones where laws are energies (Pa).

        Args:
            moduli: Result of `Evaluation.moduli`.
        """
        elastic = self._elastic()
        found = bounded(moduli, elastic, self._shared())
        for declaration in self.parts.declarations:
            if declaration.operator is None:
                found[declaration.rows] = elastic[declaration.rows]
        return found

    @property
    def values(self) -> list[str | None]:
        """Per field: name of the points' field with its values if the form carries it, or None."""
        kept = [f for f in self.parts.carried if isinstance(f, CarriedField)]
        return [
            next((f.name for f in kept if f.of is space.increment), None) for space in self.spaces
        ]

    @property
    def storing(self) -> list[Declaration | UFLStress]:
        """Laws, and terms in UFL of points without a law, which store energy."""
        return [*self.parts.declarations, *self.ufl_stresses]

    @property
    def adaptive(self) -> list[Space]:
        """Refined spaces whose leaves the points follow."""
        found = (self.spaces[k] for k in movers(self.spaces))
        return [s for s in found if s.refinement is not None and s.per_cell is not None]

    @property
    def regions(self) -> list[PointTerms]:
        """Parts of the body, each with its terms."""
        return self.parts.regions

    @property
    def moving(self) -> set[int]:
        """Subdomain ids of the active facets and cells over which it integrates."""
        return self.also.union(*(term.moving for term in self.terms))

    @property
    def loads(self) -> list[Any]:
        """DOLFINx constants and functions in the form."""
        found: list[Any] = []
        for region in (*self.regions, *(r for b in self.boundaries for r in b.regions)):
            # parameters of laws are no loads
            found += [c for c in region.placeholders.constants if not isinstance(c, LawConstant)]
            found += [function for function, _ in region.placeholders.functions]
        return found + [load for term in self.terms for load in term.loads]

    @property
    def layers(self) -> int:
        """Layers of cells around the cells of a rank that its terms need."""
        return max((term.layers for term in self.terms), default=0)

    def blocks(self, fields: Sequence[ActiveField]) -> dict[str, list[Blocks]]:
        """Blocks of its terms that are constant in a step, by kind. Collective."""
        found: dict[str, list[Blocks]] = {}
        for term in self.terms:
            for kind, own in term.blocks(fields).items():
                found.setdefault(kind, []).extend(own)
        return found

    def couple(self, here: ActiveDomain) -> list[Coupling]:
        """Couplings of nodes by its terms, besides the couplings by the points. Collective."""
        return [one for term in self.parts.terms for one in term.couple(here)]

    def regrid(self) -> None:
        """Discard data that depend on the old grid lines."""
        self.placed = times_regridded(self.points.grid)
        for term in self.terms:
            term.regrid()

    def named_terms(self) -> list[tuple[str, Term]]:
        """Its terms with names, for their state."""
        return [(f"term {k}", term) for k, term in enumerate(self.terms)]
