"""A weak form over points and grid, made ready for any activation."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt
import ufl

from dolfinmpm._platform.errors import FormError
from dolfinmpm.assembly.gridassembler import GridAssembler
from dolfinmpm.assembly.ownstress import OwnStress
from dolfinmpm.assembly.updates import PointUpdates
from dolfinmpm.basis.space import Space
from dolfinmpm.body.points import GHOST_FACETS, MaterialPoints
from dolfinmpm.contact.bodies import Bodies
from dolfinmpm.contact.means import Means
from dolfinmpm.contact.touching import LAYERS, Facing
from dolfinmpm.cut.facetmoduli import FIELD, FacetModulus, FacetRing, bounded, update
from dolfinmpm.cut.participants import Activation, ActiveField, Participants
from dolfinmpm.cut.pattern import Blocks
from dolfinmpm.forms.carriedfields import CarriedField
from dolfinmpm.forms.declarations import Declaration, LawConstant
from dolfinmpm.forms.pointterms import PointTerms
from dolfinmpm.forms.splitting import BoundaryTerms, SplitForm, split
from dolfinmpm.grid.graded import times_regridded
from dolfinmpm.solve.boundaries import place_markers, set_penalties

__all__ = ["MassTerm", "WeakForm"]

Array = npt.NDArray[np.float64]


class MassTerm(Protocol):
    """What the mass of a problem is made of.

    Attributes:
        means: How contacts act in the mean over a step, or None where they act at its start.
    """

    means: Means | None

    @property
    def moving(self) -> set[int]:
        """Subdomain ids of the facets that it integrates over."""

    def blocks(self, fields: Sequence[ActiveField]) -> list[Blocks]:
        """The mass between the nodes that remain behind C, this rank's share. Collective."""


class WeakForm:
    """A weak form over points and grid, made ready to be put on activations. Collective.

    Args:
        form: Weak form, linear in the test functions.
        spaces: Spaces of the increments.
        points: Material points.
        soft: Terms of the tangent only, or None.
        changes: Penalties on what a step in time changes of the velocity, as terms of the
            increments, or None.

    Attributes:
        given: The form as it was given.
        parts: The form, split.
        spaces: The spaces.
        points: The material points.
        grid: What DOLFINx assembles.
        moduli: What of it has moduli of the laws' tangents at facets.
        also: Subdomain ids that further forms need on the same activations.
        inertia: What the mass is made of, or None without inertial forces.
        own: What terms in UFL say of the stress of points without a law.
        updates: Fields of each boundary's markers that a step sets.
        bodies: The rigid bodies that its contacts are with.
        laid: How often the grid's lines had been laid anew when it last looked.

    Raises:
        FormError: A term cannot be evaluated where it stands, or a penalty follows the tangent of
            a law and there is none.
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
        self.bodies = Bodies(self.parts.contacts, points.grid)
        self.laid = times_regridded(points.grid)
        self.also: set[int] = set()
        self.inertia: MassTerm | None = None
        self.own: list[OwnStress] = []
        # none before the first step
        self._revision = -1
        self._beside = self._assembler(soft), self._assembler(changes)
        self._facets = self.grid.moduli + ([] if self.changes is None else self.changes.moduli)
        self.moduli = [m for m in self._facets if not isinstance(m, FacetRing)]
        self._first_moduli()
        self.updates = [
            PointUpdates(
                {name: e for c in of.conditions for name, e in c.updates.items()},
                of.regions, spaces, of.boundary.markers,
            )
            for of in self.boundaries
        ]  # fmt: skip
        for region in (*self.regions, *(r for b in self.boundaries for r in b.regions)):
            # what cannot be compiled is to be told now; tangents wait until a solver asks
            region.external, region.internal, region.operands  # noqa: B018

    def _assembler(self, form: ufl.Form | None) -> GridAssembler | None:
        """What assembles terms over the grid that are no forces on the increments, or None."""
        if form is None:
            return None
        return GridAssembler(split(form, self.spaces, self.points).grid, self.spaces)

    @property
    def means(self) -> Means | None:
        """How contacts act in the mean over steps in time, or None."""
        return None if self.inertia is None else self.inertia.means

    @property
    def soft(self) -> GridAssembler | None:
        """What assembles terms of the tangent only, or None."""
        return self._beside[0]

    @property
    def changes(self) -> GridAssembler | None:
        """What assembles penalties on changes of the velocity, or None."""
        return self._beside[1]

    @property
    def grids(self) -> list[GridAssembler]:
        """All that DOLFINx assembles."""
        return [self.grid, *(grid for grid in self._beside if grid is not None)]

    def bind(self) -> None:
        """Let laws give points that came since what they keep at first. Collective.

        Raises:
            FormError: When it is called first, if tags of the form match no points, or points
                have a load and no law.
        """
        first, revision = self._revision < 0, self.points.revision
        if first:
            self.parts.tagged.check()
        # fields may have been set since the problem was made
        if first or self._revision != revision:
            of_markers = [d for b in self.boundaries for d in b.declarations]
            for declaration in (*self.parts.declarations, *of_markers):
                declaration.bind()
            for contact in self.parts.contacts:
                contact.bind(self.parts.declarations)
            self._revision = revision
            self._first_moduli()

    def _laws_of(self, modulus: FacetModulus) -> list[Declaration]:
        """The laws whose tangent a modulus follows.

        Raises:
            FormError: There is none.
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
        """Elastic moduli at the points (Pa), shape (points, 2); 0 where no law is asked."""
        laws = {id(d): d for modulus in self.moduli for d in self._laws_of(modulus)}
        return self._moduli_of(list(laws.values()))

    def _moduli_of(self, laws: Sequence[Declaration]) -> Array:
        out = np.zeros((len(self.points), 2))
        for declaration in laws:
            out[declaration.rows] = declaration.moduli()
        return out

    def place_markers(self) -> None:
        """Make boundaries ready for an activation. Collective."""
        place_markers(self.boundaries)

    def set_penalties(self, here: Activation, ghost: bool = True) -> None:
        """Set the penalties of weak conditions on an activation. Collective.

        Args:
            here: The activation.
            ghost: Whether terms over its ghost facets act.
        """
        increments = [space.increment for space in self.spaces]
        laws = self.parts.declarations
        tied = any(f.C is not None or f.penalty is not None for f in here.fields)
        stabilised = tied or (ghost and GHOST_FACETS in self.moving)
        set_penalties(
            self.boundaries, here, lambda: self._moduli_of(laws), increments, stabilised
        )  # fmt: skip

    def _first_moduli(self) -> None:
        """Give points that have no moduli of a tangent yet the elastic ones."""
        if not self.moduli:
            return
        self.points.add_field(FIELD, (2,), "Pa")
        new = self.points[FIELD][:, 0] == 0
        self.points[FIELD][new] = self._elastic()[new]

    def bounded_moduli(self, moduli: Array) -> Array:
        """Moduli of tangents within bounds; elastic ones where laws are energies (Pa).

        Args:
            moduli: What `Evaluation.moduli` gives.
        """
        elastic = self._elastic()
        found = bounded(moduli, elastic)
        for declaration in self.parts.declarations:
            if declaration.operator is None:
                found[declaration.rows] = elastic[declaration.rows]
        return found

    @property
    def values(self) -> list[str | None]:
        """Field of the points that has what each field was, where the form carries it."""
        kept = [f for f in self.parts.carried if isinstance(f, CarriedField)]
        return [
            next((f.name for f in kept if f.of is space.increment), None) for space in self.spaces
        ]

    @property
    def storing(self) -> list[Declaration | OwnStress]:
        """What stores energy at points: laws, and terms in UFL where there is none."""
        return [*self.parts.declarations, *self.own]

    @property
    def regions(self) -> list[PointTerms]:
        """Parts of the body with terms of their own."""
        return self.parts.regions

    @property
    def boundaries(self) -> list[BoundaryTerms]:
        """Terms over boundaries that do not fit the grid."""
        return self.parts.boundaries

    @property
    def moving(self) -> set[int]:
        """Subdomain ids of the facets and cells that it integrates over as they are active."""
        own: set[int] = set().union(*(grid.moving for grid in self.grids))
        return own | self.also | (self.inertia.moving if self.inertia else set())

    @property
    def loads(self) -> list[Any]:
        """DOLFINx constants and functions in the form."""
        found: list[Any] = []
        for region in (*self.regions, *(r for b in self.boundaries for r in b.regions)):
            # numbers of laws are no loads
            found += [c for c in region.slots.constants if not isinstance(c, LawConstant)]
            found += [function for function, _ in region.slots.functions]
        found += [load for contact in self.parts.contacts for load in contact.body.loads]
        return found + self.grid.loads

    def grid_blocks(
        self, fields: Sequence[ActiveField]
    ) -> tuple[list[Blocks], list[Blocks], list[Blocks]]:
        """Tangent of its terms over the grid, of those of the tangent only, and of penalties on
        changes of the velocity. Collective.
        """
        for modulus in self._facets:
            (field,) = (f for f in fields if f.space.increment is modulus.increment)
            update(modulus, field)
        found: list[list[Blocks]] = []
        for grid in (self.grid, self.soft, self.changes):
            if grid is None or not grid.terms:
                found.append([])
                continue
            grid.attach(fields)
            found.append(grid.tangent(fields))
        blocks, soft, changes = found
        return blocks, soft, changes

    @property
    def beyond(self) -> int:
        """Layers of cells around a rank's own that its terms look at at least."""
        return LAYERS if self.parts.between else 0

    def facing(self, here: Participants) -> list[Facing]:
        """Places where bodies face each other. Collective."""
        numbers = {id(of.boundary): k for k, of in enumerate(self.boundaries)}
        return [
            Facing(contact, here, (numbers[id(first)], numbers[id(second)]))
            for contact in self.parts.between
            for first, second in [contact.boundaries]
        ]

    def regrid(self) -> None:
        """Forget what belongs to where the grid's lines were."""
        self.laid = times_regridded(self.points.grid)
        for grid in self.grids:
            grid.regrid()

    def mass_blocks(self, fields: Sequence[ActiveField]) -> list[Blocks]:
        """The mass, if there are inertial forces. Collective."""
        return [] if self.inertia is None else self.inertia.blocks(fields)
