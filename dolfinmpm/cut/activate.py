"""Activation of a step: stencils, active cells, ghost facets, C, unknowns, pattern.

An activation belongs to the present positions of the points. It is made anew or reused, and never
changed. Before any stencil is made, the overlap of the ranks grows to the size required by
domains, roots and cell means. So numberings do not change after data have been computed in them.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from dolfinmpm.basis import LatticeBasis, LeafBasis, LinearBasis, Placement, Stencils
from dolfinmpm.basis.space import extraction
from dolfinmpm.basis.stencils import all_pushed_forward, concatenated, joined, selected, spread
from dolfinmpm.body.axisymmetry import in_section
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.body.tags import check_body_left
from dolfinmpm.cut.activation import (
    Activation,
    ActiveBoundary,
    ActiveDomain,
    ActiveField,
    ActiveRegion,
    Basis,
    Field,
    LazyPattern,
    Terms,
)
from dolfinmpm.cut.activeboundaries import (
    in_active_cells,
    present_markers,
    unmoved,
    with_regions,
    with_separate_stencils,
)
from dolfinmpm.cut.activecells import active_nodes, entities
from dolfinmpm.cut.aggregation import SEARCH_RADIUS, MeshRoots, mesh_roots
from dolfinmpm.cut.cellaverages import (
    averages_of,
    averaging_field,
    layers_needed,
    sharing_stencils,
)
from dolfinmpm.cut.constraints import constraints_of
from dolfinmpm.cut.essentialconditions import EssentialConditions
from dolfinmpm.cut.pattern import Blocks, KeptCouplings, Pattern, lists_of, pairs_of
from dolfinmpm.cut.prolongation import Prolongation
from dolfinmpm.cut.unknowns import Unknowns
from dolfinmpm.forms.pointterms import PointTerms
from dolfinmpm.grid.partition import Partition

__all__ = ["Draft", "activate", "active_region"]

Mask = npt.NDArray[np.bool_]


def activate(
    points: MaterialPoints,
    fields: Sequence[Field],
    conditions: EssentialConditions,
    terms: Terms,
    share: float = 1.0,
    old: Activation | None = None,
    kept: KeptCouplings | None = None,
    blocks_from: float = math.inf,
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
        blocks_from: Number of unknowns from which they are stored in blocks, see `Unknowns`.
    """
    total = fields[0].space.configuration == "total"
    bodies = points.placement(fields[0].space.configuration)
    if total and old is not None and unmoved(points, bodies, terms.boundaries, old):
        return _renewed(points, conditions, terms, share, old)
    builder = _Builder(points, fields, terms, bodies)
    active, fixed, prescribed = builder.fields(conditions, share)
    unknowns = None if old is None else old.unknowns
    remaining = [f.nodes for f in active]
    in_blocks = _in_blocks(active, fixed, blocks_from)
    if unknowns is None or not unknowns.same(remaining, fixed, in_blocks):
        unknowns = Unknowns([f.basis.nodes for f in active], remaining, fixed, in_blocks)
        old = None
    of_terms = {"penalty": builder.penalties, **terms.blocks(active)}
    domain = ActiveDomain(bodies, total, tuple(active), unknowns)
    regions = [active_region(region, points, domain) for region in terms.regions]
    boundaries = builder.boundaries
    if boundaries:
        boundaries = with_regions(terms.boundaries, boundaries, domain)
    pairs = pairs_of([b for blocks in of_terms.values() for b in blocks], unknowns)
    pairs += [] if kept is None else kept.pairs(unknowns)
    former = None if old is None else old.lazy.made
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


def _in_blocks(fields: Sequence[ActiveField], fixed: Sequence[Mask], blocks_from: float) -> bool:
    """Whether the unknowns of one field with several components are stored in blocks. Collective.

    Args:
        fields: The active fields.
        fixed: Masks of their prescribed components.
        blocks_from: Number of unknowns from which they are.
    """
    if blocks_from == math.inf or len(fields) > 1 or fields[0].space.components == 1:
        return False
    nodes, numbering = fields[0].nodes, fields[0].basis.nodes
    owned = nodes[: np.searchsorted(nodes, numbering.owned)]
    free = int(np.count_nonzero(~fixed[0][owned]))
    return bool(numbering.comm.allreduce(free) >= blocks_from)


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
    boundaries = with_regions(terms.boundaries, old.boundaries, old)
    blocks = {**old.blocks, **terms.blocks(old.fields)}
    return replace(
        old, prescribed=prescribed, regions=regions, boundaries=boundaries, blocks=blocks,
        driven=conditions.changing and conditions.driven,
    )  # fmt: skip


def _overlapping_bases(
    fields: Sequence[Field],
    where: Placement,
    averages: bool,
    partition: Partition | None,
    least: int = 0,
) -> list[Basis]:
    """The bases of a step, with the overlap for domains, roots and cell means. Collective.

    Args:
        fields: Fields of the problem.
        where: Points of the body.
        averages: Whether the weak form has means over cells.
        partition: Cells of each rank, where they are not the grid's.
        least: Fewest layers of cells around each rank's own.
    """
    reach = {id(f.space.basis): f.space.basis for f in fields}
    reaches = {key: basis.reach(where) for key, basis in reach.items()}
    layers: dict[int, int] = {}
    averaged = any(f.space.basis.averaged for f in fields if f.space.refinement is not None)
    # cell means use the nodes of all fields around the cells of the first field's domains
    span = max(count for _, count in reaches.values())
    for one in fields:
        basis = one.space.basis
        need = max(reaches[id(basis)][0], least)
        if averages:
            need = max(need, layers_needed(span, basis))
        need = max(need, getattr(one.prolongate, "layers", 0))
        if one.constrains_nodes:
            need += SEARCH_RADIUS + basis.degree + 1
            # whether a cell of splines is a root depends on the cells around it
            need += SEARCH_RADIUS if basis.degree > 1 else 0
        layers[id(basis)] = max(layers.get(id(basis), 0), need)
    found: list[Basis] = []
    for one in fields:
        base, refinement = one.space.basis, one.space.refinement
        need = layers[id(base)]
        if refinement is None:
            found.append(base.grown(need, partition))
        else:
            assert isinstance(base, LatticeBasis)
            refinement.update_leaves(where, averaged)
            found.append(refinement.basis(base, need, partition))
    return found


@dataclass
class Draft:
    """Fields with the same points, markers and basis, while they are built.

    Attributes:
        basis: The basis, with the overlap for the step.
        chosen: Mask of the points, or None for all points.
        has_markers: Whether they have the markers of each boundary, by the boundary's number.
        full_stencils: Stencils of points and markers on all active nodes.
        of_points: The same of the points alone.
        nodes: Active nodes.
        entities: Ghost facets and active cells.
    """

    basis: Basis
    chosen: Mask | None
    has_markers: dict[int, bool]
    full_stencils: Any = None
    of_points: Any = None
    nodes: Any = None
    entities: Any = None

    def stencils(self, where: Placement, boundaries: dict[int, ActiveBoundary]) -> Stencils:
        """Stencils in the basis; points of other fields get empty stencils. Collective.

        Args:
            where: The points, followed by the active markers of each boundary.
            boundaries: The boundaries, by the number of their markers.
        """
        if self.chosen is None:
            return self.basis.stencils(where)
        of_markers = [np.full(len(one.rows), self.has_markers[n]) for n, one in boundaries.items()]
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
        self._points, self._fields, self._terms, self._bodies = points, fields, terms, bodies
        self.penalties: list[Blocks] = []
        self.boundaries = present_markers(terms.boundaries) if terms.boundaries else {}
        # markers activate cells like points without volume
        where = concatenated([bodies, *(one.seen for one in self.boundaries.values())])
        averages = any(region.averages for region in terms.regions)
        bases = _overlapping_bases(fields, where, averages, points.partition, terms.layers)
        drafts: dict[Hashable, Draft] = {}
        # the draft of each field
        self._drafts: list[Draft] = []
        for field, basis in zip(fields, bases):
            space = field.space
            markers = {
                of.boundary.markers.number: space.tags is None or of.sees(space.increment)
                for of in terms.boundaries
            }
            key = id(basis), space.tags, tuple(markers.values())
            if key not in drafts:
                drafts[key] = self._draft(field, basis, markers)
            self._drafts.append(drafts[key])
        self._once = list(drafts.values())
        if not all(of.boundary.activates for of in terms.boundaries):
            both = self.boundaries, self._once
            self.boundaries = in_active_cells(terms.boundaries, *both, bodies)
        if any(len(one.rows) < len(one.seen.x) for one in self.boundaries.values()):
            seen = (one.seen.of(one.rows) for one in self.boundaries.values())
            where = concatenated([bodies, *seen])
        self._where = where

    def _draft(self, field: Field, basis: Basis, has_markers: dict[int, bool]) -> Draft:
        """The draft of a field. Collective."""
        tags = field.space.tags
        chosen = None if tags is None else np.isin(self._points["tag"], tags)
        if any(has_markers.values()):
            of_field = [of.boundary for of in self._terms.boundaries
                        if has_markers[of.boundary.markers.number]]  # fmt: skip
            check_body_left(self._points, tags, of_field)
        return Draft(basis, chosen, has_markers)

    def fields(
        self, conditions: EssentialConditions, share: float
    ) -> tuple[list[ActiveField], list[Mask], list[npt.NDArray[np.float64]]]:
        """The active fields, with constrained components and prescribed increments. Collective.

        Args:
            conditions: The essential conditions. Constrained nodes do not follow other nodes.
                Nodes that only markers reach may be free, see `within_reach`.
            share: Share of the step's prescribed increments.
        """
        is_point = np.arange(len(self._where.x)) < len(self._bodies.x)
        for draft in self._once:
            draft.full_stencils = draft.stencils(self._where, self.boundaries)
            draft.of_points = selected(draft.full_stencils, is_point)
            draft.nodes = active_nodes(draft.full_stencils, draft.basis)
        roots = self._find_roots()
        fixed, prescribed = conditions.at([d.basis for d in self._drafts], share)
        if self.boundaries:
            fixed = [
                conditions.within_reach(mask, f.space, d.basis, d.full_stencils, d.of_points)
                for f, d, mask in zip(self._fields, self._drafts, fixed)
            ]
        grid, moving = self._points.grid, self._terms.moving
        for draft in self._once:
            both = draft.full_stencils, draft.of_points
            draft.entities = entities(grid, moving, self._where, *both, draft.basis)
        active = [self._active(k, mask, roots.get(k)) for k, mask in enumerate(fixed)]
        if self.boundaries:
            number = len(self._bodies.x)
            sizes = number, len(self._where.x) - number
            active = [with_separate_stencils(f, self.boundaries, *sizes) for f in active]
        return active, fixed, prescribed

    def _find_roots(self) -> dict[int, MeshRoots]:
        """Roots of ill-filled cells on meshes that are no lattices, by field. Collective.

        Bases get to know the roots on other ranks.
        """
        found: dict[int, MeshRoots] = {}
        for k, (field, draft) in enumerate(zip(self._fields, self._drafts)):
            constraining, basis = field.constraining, draft.basis
            if constraining is None or not isinstance(basis, LinearBasis):
                continue
            filled = constraining.measure(self._where, draft.full_stencils, basis)
            found[k] = mesh_roots(basis, draft.nodes, filled, constraining.level(basis.degree))
            wider = basis.knowing(*found[k].unknown)
            for other in self._once:
                # fields that share a basis must still share it
                other.basis = wider if other.basis is basis else other.basis
        for draft in self._once if found else ():
            draft.nodes = active_nodes(draft.full_stencils, draft.basis)
        return found

    def _active(self, k: int, fixed: Mask, roots: MeshRoots | None) -> ActiveField:
        """The k-th field on the active cells, with points and markers together. Collective."""
        field, draft = self._fields[k], self._drafts[k]
        basis, seen, nodes = draft.basis, draft.full_stencils, draft.nodes
        C = level = None
        follows = field.constrains_nodes or field.prolongate is not None
        if follows or isinstance(basis, LeafBasis):
            placed = self._where, seen, nodes
            C, level, penalty = constraints_of(field, basis, *placed, fixed, roots)
            if penalty is not None:
                self.penalties.append(Blocks(k, k, *penalty))
        to_grid, stencils, independent = extraction(field.space, basis), seen, nodes
        if C is not None:
            prolongation = Prolongation(C)
            C = prolongation.matrix
            to_grid = C if to_grid is None else to_grid @ C
            stencils = prolongation.stencils(seen)
            independent = nodes[~prolongation.constrained[nodes]]
        return ActiveField(
            field.space, basis, seen, nodes, stencils, independent, C, to_grid, draft.entities,
            seen, level=level,
        )  # fmt: skip


def active_region(region: PointTerms, points: MaterialPoints, here: ActiveDomain) -> ActiveRegion:
    """Stencils and means of a region of the body. Collective if it has means over cells.

    Args:
        region: The region.
        points: Material points.
        here: Points, active fields and unknowns.
    """
    chosen = None if region.everywhere else region.chosen(points["tag"])
    stencils, averages = [f.stencils for f in here.fields], None
    if region.averages:
        field = averaging_field(region, here)
        sharing = sharing_stencils(here.where, field.full_stencils, field.basis)
        *stencils, shared = _of_points([*stencils, sharing], chosen)
        averages = averages_of(region, points, here.where, shared, field.basis)
    else:
        stencils = _of_points(stencils, chosen)
    if here.total:
        stencils = all_pushed_forward(stencils, in_section(points, points["F"]))
    within = [(f.basis.nodes, u.nodes) for f, u in zip(here.fields, here.unknowns.fields)]
    return ActiveRegion(stencils, averages, within)


def _of_points(stencils: Sequence[Stencils], chosen: Mask | None) -> list[Stencils]:
    """Stencils of the chosen points, or of all, in common groups. Common objects stay common."""
    if chosen is not None:
        once = {id(s): selected(s, chosen) for s in stencils}
        stencils = [once[id(s)] for s in stencils]
    return joined(stencils)
