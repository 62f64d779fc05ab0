"""Activation of a step: stencils, active cells, ghost facets, C, unknowns, pattern.

An activation belongs to the present positions of the points. It is made anew or reused, and never
changed. Before any stencil is made, the overlap of the ranks grows to the size required by
domains, roots and cell means. So numberings do not change after data have been computed in them.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm.basis import LeafBasis, LinearBasis, Placement, Stencils
from dolfinmpm.basis.space import extraction
from dolfinmpm.basis.stencils import concatenated, selected, spread
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.body.tags import check_body_left
from dolfinmpm.cut.activation import (
    Activation,
    ActiveBoundary,
    ActiveDomain,
    ActiveField,
    Basis,
    Field,
    LazyPattern,
    Terms,
    TermsOverBoundary,
)
from dolfinmpm.cut.activecells import active_cells, active_nodes, entities
from dolfinmpm.cut.aggregation import mesh_roots
from dolfinmpm.cut.couplings import KeptCouplings, lists_of, pairs_of
from dolfinmpm.cut.essentialconditions import EssentialConditions
from dolfinmpm.cut.overlap import overlapping_bases
from dolfinmpm.cut.pattern import Blocks, Pattern
from dolfinmpm.cut.prolongation import Prolongation, own_matrix
from dolfinmpm.cut.regions import active_boundary_regions, active_region
from dolfinmpm.cut.unknowns import Unknowns

__all__ = ["activate"]

Fixed = npt.NDArray[np.bool_]


def activate(
    points: MaterialPoints,
    fields: Sequence[Field],
    conditions: EssentialConditions,
    terms: Terms,
    share: float = 1.0,
    old: Activation | None = None,
    kept: KeptCouplings | None = None,
    blocks: Callable[[int], bool] | None = None,
) -> Activation:
    """The activation for the present positions of the points. Collective.

    Args:
        points: Material points.
        fields: Fields of the problem.
        conditions: Its essential conditions.
        terms: Its weak form.
        share: Share of the step's prescribed increments.
        old: A former activation of the same problem. Its unchanged parts are reused.
        kept: Couplings of a checkpoint's pattern, for the same active nodes.
        blocks: Function of the number of unknowns: whether they are stored in blocks, see
            `Unknowns`. None means no blocks.
    """
    total = fields[0].space.configuration == "total"
    bodies = points.placement(fields[0].space.configuration)
    if total and old is not None and _unmoved(points, bodies, terms.boundaries, old):
        return _renewed(points, conditions, terms, share, old)
    builder = _Builder(points, fields, terms, bodies)
    active, fixed, prescribed = builder.fields(conditions, share)
    unknowns = None if old is None else old.unknowns
    remaining = [f.nodes for f in active]
    blocked = blocks is not None and _in_blocks(active, fixed, blocks)
    if unknowns is None or not unknowns.same(remaining, fixed, blocked):
        unknowns = Unknowns([f.basis.nodes for f in active], remaining, fixed, blocked)
        old = None
    of_terms = {"penalty": builder.penalties, **terms.blocks(active)}
    domain = ActiveDomain(bodies, total, tuple(active), unknowns)
    regions = [active_region(region, points, domain) for region in terms.regions]
    boundaries = _boundaries(terms.boundaries, builder.boundaries, domain)
    pairs = pairs_of([b for own in of_terms.values() for b in own], unknowns)
    pairs += [] if kept is None else kept.pairs(unknowns)
    former = None if old is None else old.lazy.known
    every = [*regions, *(region for one in boundaries.values() for region in one.regions)]
    couplings = terms.couple(domain)
    couple = functools.partial(_pattern, every, active, unknowns, couplings, pairs, former)
    return Activation(
        bodies, total, domain.fields, unknowns, terms, prescribed,
        conditions.changing and conditions.driven, regions, boundaries, of_terms, couplings,
        LazyPattern(couple),
    )  # fmt: skip


def _pattern(every, active, unknowns: Unknowns, couplings, pairs, former: Pattern | None):
    """The sparsity pattern of the matrix."""
    lists = lists_of(every, active, unknowns) + [one.lists(unknowns) for one in couplings]
    return Pattern.build(lists, unknowns, pairs, former)


def _boundaries(
    terms: Sequence[TermsOverBoundary], found: dict[int, ActiveBoundary], domain: ActiveDomain
) -> dict[int, ActiveBoundary]:
    """Boundaries with their active parts."""
    number = {of.boundary.markers.number: of for of in terms}
    return {
        n: replace(one, regions=active_boundary_regions(number[n], domain))
        for n, one in found.items()
    }


def _in_blocks(fields: Sequence[ActiveField], fixed, blocks: Callable[[int], bool]) -> bool:
    """Whether the unknowns of one field with several components are stored in blocks."""
    if len(fields) > 1 or fields[0].space.components == 1:
        return False
    nodes, numbering = fields[0].nodes, fields[0].basis.nodes
    owned = nodes[: np.searchsorted(nodes, numbering.owned)]
    return blocks(numbering.comm.allreduce(int(np.count_nonzero(~fixed[0][owned]))))


def _unmoved(
    points: MaterialPoints,
    where: Placement,
    boundaries: Sequence[TermsOverBoundary],
    old: Activation,
) -> bool:
    """Whether points and markers are unchanged at initial positions. Collective."""
    same = where.x is old.where.x and where.cell.size == old.where.cell.size
    for of in boundaries:
        # the position where a wall meets the body is found anew
        former = old.boundaries[of.boundary.markers.number].seen
        same = same and of.boundary.follows and of.boundary.seen is former.x
    return points.comm.allreduce(same, op=MPI.LAND)


def _renewed(
    points: MaterialPoints,
    conditions: EssentialConditions,
    terms: Terms,
    share: float,
    old: Activation,
) -> Activation:
    """An activation at initial positions, with gradients by present positions. Collective."""
    _, prescribed = conditions.at([f.basis for f in old.fields], share)
    regions = [active_region(region, points, old) for region in terms.regions]
    boundaries = _boundaries(terms.boundaries, old.boundaries, old)
    blocks = {**old.blocks, **terms.blocks(old.fields)}
    return replace(
        old, prescribed=prescribed, regions=regions, boundaries=boundaries, blocks=blocks,
        driven=conditions.changing and conditions.driven,
    )  # fmt: skip


@dataclass
class _Draft:
    """A field while it is built. Fields with equal keys share their results.

    Attributes:
        field: The field.
        number: Its number.
        chosen: Mask of its points, or None for all points.
        has_markers: Whether it has the markers of each boundary, by the boundary's number.
        basis: Its basis, with the overlap for the step.
        full_stencils: Stencils of points and markers on all active nodes.
        of_points: The same of the points alone.
        nodes: Active nodes.
        roots: Roots of ill-filled cells on meshes that are no lattices.
        entities: Ghost facets and active cells.
    """

    field: Field
    number: int
    chosen: Fixed | None
    has_markers: dict[int, bool]
    basis: Basis
    full_stencils: Any = None
    of_points: Any = None
    nodes: Any = None
    roots: Any = None
    entities: Any = None

    @property
    def key(self) -> Hashable:
        """Key that is equal for fields with the same points, markers and basis."""
        return id(self.basis), self.field.space.tags, tuple(self.has_markers.values())

    def stencils(self, where: Placement, sets: dict[int, ActiveBoundary]) -> Stencils:
        """Stencils in the basis; points outside the field get empty stencils. Collective.

        Args:
            where: The points, followed by the active markers of each boundary.
            sets: The boundaries, by the number of their markers.
        """
        if self.chosen is None:
            return self.basis.stencils(where)
        of_markers = [np.full(len(one.rows), self.has_markers[n]) for n, one in sets.items()]
        rows = np.flatnonzero(np.concatenate([self.chosen, *of_markers]))
        return spread(self.basis.stencils(where.of(rows)), rows, len(where.x))


class _Builder:
    """Builds the active fields of a step, one after the other. Collective.

    Args:
        points: Material points.
        fields: Fields of the problem.
        terms: The weak form.
        bodies: The points as a placement for stencils.

    Attributes:
        boundaries: Boundaries that do not fit the grid, by the number of their markers.
        penalties: Penalties of weak aggregation.
    """

    def __init__(
        self, points: MaterialPoints, fields: Sequence[Field], terms: Terms, bodies: Placement
    ):
        self._points, self._bodies, self._moving = points, bodies, terms.moving
        self.penalties: list[Blocks] = []
        self._terms, of_all = terms.boundaries, {}
        for of in terms.boundaries:
            rows = np.asarray(np.flatnonzero(of.boundary.present()), np.int32)
            of_all[of.boundary.markers.number] = ActiveBoundary(of.boundary.placement(), rows)
        # markers activate cells like points without volume
        where = concatenated([bodies, *(one.seen for one in of_all.values())])
        averages = any(region.averages for region in terms.regions)
        bases = overlapping_bases(fields, where, averages, points.partition, terms.layers)
        self._drafts = [self._draft(k, *both) for k, both in enumerate(zip(fields, bases))]
        self.boundaries = of_all
        if not all(of.boundary.activates for of in terms.boundaries):
            self.boundaries = self._in_active_cells(of_all)
            seen = (one.seen.of(one.rows) for one in self.boundaries.values())
            where = concatenated([bodies, *seen])
        self._where = where

    def _draft(self, number: int, field: Field, basis: Basis) -> _Draft:
        """A field with its points and markers. Collective."""
        space = field.space
        chosen = None if space.tags is None else np.isin(self._points["tag"], space.tags)
        has_markers = {
            of.boundary.markers.number: space.tags is None or of.sees(space.increment)
            for of in self._terms
        }
        own = [of.boundary for of in self._terms if has_markers[of.boundary.markers.number]]
        check_body_left(self._points, space.tags, own)
        return _Draft(field, number, chosen, has_markers, basis)

    def _in_active_cells(self, sets: dict[int, ActiveBoundary]) -> dict[int, ActiveBoundary]:
        """Active markers: of passive boundaries only markers in active cells. Collective.

        Args:
            sets: The boundaries, with all their markers.
        """
        flags = {of.boundary.markers.number: of.boundary.present() for of in self._terms}
        once = {draft.key: draft for draft in self._drafts}
        for draft in once.values():
            cells = active_cells(draft.stencils(self._bodies, {}), draft.basis.cells)
            for of in self._terms:
                n = of.boundary.markers.number
                if of.boundary.activates or not draft.has_markers[n]:
                    continue
                s = draft.basis.stencils(sets[n].seen)
                # a marker without a domain is in one cell
                flags[n][s.order] &= np.repeat(cells[s.cells], np.diff(s.groups))
        rows = {n: np.asarray(np.flatnonzero(chosen), np.int32) for n, chosen in flags.items()}
        return {n: replace(one, rows=rows[n]) for n, one in sets.items()}

    def fields(
        self, conditions: EssentialConditions, share: float
    ) -> tuple[list[ActiveField], Any, Any]:
        """The active fields, with constrained components and prescribed increments. Collective.

        Args:
            conditions: The essential conditions. Constrained nodes do not follow other nodes.
                Nodes that only markers reach may be free, see `within_reach`.
            share: Share of the step's prescribed increments.
        """
        self._share("full_stencils", lambda d: d.stencils(self._where, self.boundaries))
        own = np.arange(len(self._where.x)) < len(self._bodies.x)
        self._share("of_points", lambda d: selected(d.full_stencils, own))
        self._share("nodes", lambda d: active_nodes(d.full_stencils, d.basis))
        self._find_roots()
        fixed, prescribed = conditions.at([d.basis for d in self._drafts], share)
        if self.boundaries:
            fixed = [
                conditions.within_reach(held, d.field.space, d.basis, d.full_stencils, d.of_points)
                for d, held in zip(self._drafts, fixed)
            ]
        grid, moving = self._points.grid, self._moving
        self._share(
            "entities", lambda d: entities(grid, moving, d.full_stencils, d.of_points, d.basis)
        )
        active = [self._parted(self._active(d, own)) for d, own in zip(self._drafts, fixed)]
        return active, fixed, prescribed

    def _share(self, name: str, make: Callable[[_Draft], Any]) -> None:
        """Compute an attribute per field, once for all fields with the same key. Collective."""
        made: dict[Hashable, Any] = {}
        for draft in self._drafts:
            if draft.key not in made:
                made[draft.key] = make(draft)
            setattr(draft, name, made[draft.key])

    def _find_roots(self) -> None:
        """Add roots on other ranks to bases, for grids that are not rectangular. Collective."""
        found = False
        for draft in self._drafts:
            constraining, basis = draft.field.constraining, draft.basis
            if constraining is None or not isinstance(basis, LinearBasis):
                continue
            found = True
            filled = constraining.measure(self._where, draft.full_stencils, basis)
            draft.roots = mesh_roots(basis, draft.nodes, filled, constraining.level(basis.degree))
            wider = basis.knowing(*draft.roots.unknown)
            for other in self._drafts:
                # fields that share a basis must still share it
                other.basis = wider if other.basis is basis else other.basis
        if found:
            self._share("nodes", lambda d: active_nodes(d.full_stencils, d.basis))

    def _active(self, draft: _Draft, fixed: Fixed) -> ActiveField:
        """One field on the active cells, with points and markers together. Collective."""
        field, basis, seen, nodes = draft.field, draft.basis, draft.full_stencils, draft.nodes
        constraining, active = field.constraining, nodes
        C = None
        if constraining is not None:
            C = constraining.constraint_matrix(self._where, basis, seen, nodes, fixed, draft.roots)
        if C is not None and field.stabilisation.kind == "weak-aggregation":
            owned = nodes[: np.searchsorted(nodes, basis.nodes.owned)]
            radius = basis.node_coordinates()[:, 0] if self._points.axisymmetric else None
            sizes = basis.node_sizes() if isinstance(basis, LeafBasis) else None
            entries = field.stabilisation.penalty(field.space, C, owned, radius, sizes)
            self.penalties.append(Blocks(draft.number, draft.number, *entries))
            C = None
        level = None if C is None or constraining is None else constraining.level(basis.degree)
        if field.prolongate is not None:
            call = functools.partial(field.prolongate, seen, nodes)
            if (of_basis := getattr(field.prolongate, "of_basis", None)) is not None:
                call = functools.partial(of_basis, basis, nodes)
            own = own_matrix(call, basis.nodes.size, self._points.comm)
            C = own if C is None else C @ own
        if isinstance(basis, LeafBasis) and basis.hangs.any():
            H = basis.hanging
            # a node may follow a root with hanging corners
            C = H if C is None else H @ C @ H
        to_grid, stencils = extraction(field.space, basis), seen
        if C is not None:
            prolongation = Prolongation(C)
            C = prolongation.matrix
            to_grid = C if to_grid is None else to_grid @ C
            stencils = prolongation.stencils(seen)
            nodes = nodes[~prolongation.constrained[nodes]]
        return ActiveField(
            field.space, basis, seen, active, stencils, nodes, C, to_grid, draft.entities, seen,
            level=level,
        )  # fmt: skip

    def _parted(self, field: ActiveField) -> ActiveField:
        """A field with separate stencils of the points and of each boundary's markers."""
        if not self.boundaries:
            return field
        n = len(self._bodies.x)

        def part(s: Stencils, first: int, rows: npt.NDArray[np.int32]) -> Stencils:
            number = np.arange(len(self._where.x))
            own = selected(s, (number >= first) & (number < first + len(rows)))
            return replace(own, order=rows[own.order - first])

        of_markers, first = {}, n
        for number, one in self.boundaries.items():
            of_markers[number] = part(field.stencils, first, one.rows)
            first += len(one.rows)
        own = np.arange(n, dtype=np.int32)
        return replace(
            field,
            full_stencils=part(field.full_stencils, 0, own),
            stencils=part(field.stencils, 0, own),
            of_markers=of_markers,
        )
