"""What takes part in a step: stencils, active cells, ghost facets, C, unknowns, pattern.

An activation is made for where the points are, or reused, and never changed. Before
any stencil is made the overlap of the ranks is grown to what domains, roots and cell
means need, so that no numbering changes behind what was computed in it.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Hashable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm.basis import LatticeBasis, Placement, Stencils
from dolfinmpm.basis.space import Space, extraction
from dolfinmpm.basis.stencils import joined, pushed_forward, selected, spread, together
from dolfinmpm.body.axisymmetry import in_section
from dolfinmpm.body.location import bounds
from dolfinmpm.body.points import ACTIVE_CELLS, GHOST_FACETS, MaterialPoints
from dolfinmpm.cut.active import active_cells, active_nodes, ghost_facets
from dolfinmpm.cut.aggregation import SEARCH_RADIUS, mesh_roots
from dolfinmpm.cut.cellmeans import CellMeans, layers_needed, sharing
from dolfinmpm.cut.couplings import KeptCouplings, lists_of, pairs_of
from dolfinmpm.cut.held import Held
from dolfinmpm.cut.participants import (
    Activation,
    ActiveField,
    ActiveRegion,
    Basis,
    BoundaryOf,
    Entities,
    Field,
    Inertia,
    Later,
    Participants,
    RegionTerms,
    Terms,
)
from dolfinmpm.cut.pattern import Blocks, Pattern
from dolfinmpm.cut.prolongation import Prolongation
from dolfinmpm.cut.unknowns import Unknowns
from dolfinmpm.grid.partition import Partition

__all__ = ["activate", "active_on_grid", "regions_of"]


def activate(
    points: MaterialPoints,
    fields: Sequence[Field],
    held: Held,
    terms: Terms,
    share: float = 1.0,
    old: Activation | None = None,
    kept: KeptCouplings | None = None,
    blocks: Callable[[int], bool] | None = None,
) -> Activation:
    """The activation for where the points are now. Collective.

    Args:
        points: Material points.
        fields: Fields of the problem.
        held: Its essential conditions.
        terms: Its weak form.
        share: Share of the step's prescribed increments.
        old: A former activation of the same problem, of which is kept what did not change.
        kept: Couplings that the pattern is to have if the same nodes are active.
        blocks: Whether so many unknowns are to stand in blocks, see `Unknowns`; never without.
    """
    configuration = fields[0].space.configuration
    where = points.placement(configuration)
    total = configuration == "total"
    if total and old is not None and _unmoved(points, where, terms.boundaries, old):
        return _renewed(points, held, terms, share, old)
    averages = any(region.averages for region in terms.regions)
    bodies, sets = where, [b.boundary.placement() for b in terms.boundaries]
    # markers activate cells as points without volume do
    where = together([bodies, *sets])
    bases = _bases(fields, where, averages, points.partition, terms.beyond)
    members: list[npt.NDArray[Any]] = [
        np.asarray(np.flatnonzero(b.boundary.present()), np.int32) for b in terms.boundaries
    ]
    views = [_View(field.space, points["tag"], terms.boundaries) for field in fields]
    if not all(b.boundary.activates for b in terms.boundaries):
        members = _in_active_cells(terms.boundaries, bodies, sets, bases, views)
        where = together([bodies, *(one.of(rows) for one, rows in zip(sets, members))])
    keys = [(id(field.space.basis), view.key) for field, view in zip(fields, views)]
    seen = _shared(keys, lambda k: views[k].stencils(bases[k], where, members))
    nodes = _shared(keys, lambda k: active_nodes(seen[k], bases[k].nodes))
    bases, nodes, roots = _with_roots(fields, keys, bases, where, seen, nodes)
    fixed, prescribed = held.at(bases, share)
    entities = _entities(points, keys, bases, seen, terms.moving)
    active = []
    for k, field in enumerate(fields):
        found = _field(
            field, k, bases[k], where, seen[k], nodes[k], fixed[k], roots[k], entities[k],
            points.axisymmetric,
        )  # fmt: skip
        active.append(found)
    active = _parted(active, len(bodies.x), members)
    unknowns = None if old is None else old.unknowns
    remaining = [f.nodes for f in active]
    blocked = blocks is not None and _in_blocks(active, fixed, blocks)
    if unknowns is None or not unknowns.same(remaining, fixed, blocked):
        unknowns = Unknowns([b.nodes for b in bases], remaining, fixed, blocked)
        old = None
    grid, soft, changes = terms.grid_blocks(active)
    here = Participants(bodies, total, tuple(active), unknowns)
    regions = [region_on(region, points, here) for region in terms.regions]
    of_boundaries = regions_of(terms.boundaries, here, terms.boundaries)
    mass = terms.mass_blocks(active)
    penalties = (f.penalty for f in active if f.penalty)
    pairs = pairs_of([*grid, *soft, *changes, *mass, *penalties], unknowns)
    pairs += [] if kept is None else kept.pairs(unknowns)
    former = None if old is None else old.later.known
    every = [*regions, *(region for parts in of_boundaries for region in parts)]
    facing = terms.facing(here)
    couple = functools.partial(_pattern, every, active, unknowns, facing, pairs, former)
    later = Later(couple)
    driven = held.changing and held.driven
    return Activation(
        bodies, total, here.fields, unknowns, terms, prescribed, driven, regions, grid, soft,
        Inertia(mass, changes), later, of_boundaries, facing, tuple(sets),
    )  # fmt: skip


def _pattern(every, active, unknowns: Unknowns, facing, pairs, former: Pattern | None) -> Pattern:
    """Where the matrix has entries."""
    lists = lists_of(every, active, unknowns) + [one.lists(unknowns) for one in facing]
    return Pattern.build(lists, unknowns, pairs, former)


def active_on_grid(field: ActiveField) -> npt.NDArray[np.int32]:
    """Active nodes that this rank owns, as the field's space numbers them."""
    basis, base = field.basis, field.space.basis
    if basis.grid_nodes is None:
        return field.active[field.active < basis.nodes.owned]
    flags = np.zeros(basis.nodes.size, bool)
    flags[field.active] = True
    return np.flatnonzero(flags[basis.grid_nodes[: base.nodes.owned]]).astype(np.int32)


def _in_blocks(fields: Sequence[ActiveField], fixed, blocks: Callable[[int], bool]) -> bool:
    """Whether the unknowns of one field with several components are to stand in blocks."""
    if len(fields) > 1 or fields[0].space.components == 1:
        return False
    nodes, numbering = fields[0].nodes, fields[0].basis.nodes
    owned = nodes[: np.searchsorted(nodes, numbering.owned)]
    return blocks(numbering.comm.allreduce(int(np.count_nonzero(~fixed[0][owned]))))


def region_on(region: RegionTerms, points: MaterialPoints, here: Participants) -> ActiveRegion:
    """Stencils and means of a part of the body. Collective if it takes means over cells.

    Args:
        region: The part.
        points: Material points.
        here: What is active.
    """
    fields, unknowns = here.fields, here.unknowns
    F = in_section(points, points["F"]) if here.total else None
    chosen = region.chosen(points["tag"])

    def part(s: Stencils) -> Stencils:
        return s if chosen is None else selected(s, chosen)

    def made(stencils: list[Stencils]) -> list[Stencils]:
        once = {id(s): part(s) for s in stencils}
        return joined([once[id(s)] for s in stencils])

    def pushed(stencils: list[Stencils]) -> list[Stencils]:
        return stencils if F is None else _pushed(stencils, F)

    own, means = [f.stencils for f in fields], None
    if not region.averages:
        stencils = pushed(made(own))
    else:
        first = fields[0]
        for mover in (fields[k] for k in here.movers):
            if mover.space.tags is not None and (region.tags or set()) <= set(mover.space.tags):
                first = mover
        *stencils, shared = made([*own, sharing(here.where, first.seen, first.basis)])
        stencils = pushed(stencils)
        where = here.where
        if region.by_centres:
            # a point on the grid's upper edge is in the last cell
            inside = np.nextafter(bounds(points.grid)[1], -np.inf)
            x = np.minimum(where.x, inside)
            where = replace(where, x=x, half=np.zeros_like(where.half))
        means = CellMeans(points["V"], where, shared, first.basis)
    within = [(f.basis.nodes, u.nodes) for f, u in zip(fields, unknowns.fields)]
    return ActiveRegion(stencils, means, within)


def _pushed(stencils: Sequence[Stencils], F: npt.NDArray[np.float64]) -> list[Stencils]:
    """Stencils with gradients by present positions; those that are one object stay one."""
    now = {id(s): pushed_forward(s, F) for s in stencils}
    return [now[id(s)] for s in stencils]


def _unmoved(
    points: MaterialPoints, where: Placement, boundaries: Sequence[BoundaryOf], old: Activation
) -> bool:
    """Whether points and markers are those of an activation at first positions. Collective."""
    same = where.x is old.where.x and where.cell.size == old.where.cell.size
    for of, former in zip(boundaries, old.sets):
        # what a wall meets is found anew
        same = same and of.boundary.follows and of.boundary.seen is former.x
    return points.comm.allreduce(same, op=MPI.LAND)


def _renewed(
    points: MaterialPoints, held: Held, terms: Terms, share: float, old: Activation
) -> Activation:
    """The same activation at first positions, with gradients by the present ones. Collective."""
    bases = [f.basis for f in old.fields]
    _, prescribed = held.at(bases, share)
    regions = [region_on(region, points, old) for region in terms.regions]
    of_boundaries = regions_of(terms.boundaries, old, terms.boundaries)
    grid, soft, changes = terms.grid_blocks(old.fields)
    driven = held.changing and held.driven
    return replace(
        old, prescribed=prescribed, driven=driven, regions=regions, grid=grid, soft=soft,
        inertia=replace(old.inertia, changes=changes), of_boundaries=of_boundaries,
    )  # fmt: skip


class _View:
    """Which points, and markers of which boundaries, a field sees.

    Args:
        space: The field's space.
        tags: Tags of the points, shape (points,).
        boundaries: Boundaries that do not fit the grid.

    Attributes:
        key: What is the same for fields that see the same.
        boundaries: Whether it sees each boundary's markers.
    """

    def __init__(self, space: Space, tags: npt.NDArray[np.int32], boundaries: Sequence[BoundaryOf]):
        self._chosen = None if space.tags is None else np.isin(tags, space.tags)
        self.boundaries = [space.tags is None or b.sees(space.increment) for b in boundaries]
        self.key = space.tags, tuple(self.boundaries)

    def stencils(
        self, basis: Basis, where: Placement, members: Sequence[npt.NDArray[Any]]
    ) -> Stencils:
        """Stencils in a basis; what it does not see is there without nodes. Collective.

        Args:
            basis: The basis.
            where: The points, behind them the markers of each boundary.
            members: Which markers of each boundary take part.
        """
        if self._chosen is None:
            return basis.stencils(where)
        of_markers = [np.full(len(m), sees) for m, sees in zip(members, self.boundaries)]
        rows = np.flatnonzero(np.concatenate([self._chosen, *of_markers]))
        return spread(basis.stencils(where.of(rows)), rows, len(where.x))


def _shared(keys: Sequence[Hashable], make: Callable[[int], Any]) -> list[Any]:
    """What is made for a field, by its number, once for all fields of the same key."""
    made: dict[Hashable, Any] = {}
    for k, key in enumerate(keys):
        if key not in made:
            made[key] = make(k)
    return [made[key] for key in keys]


def _bases(
    fields: Sequence[Field],
    where: Placement,
    averages: bool,
    partition: Partition | None,
    least: int = 0,
) -> list[Basis]:
    """The bases with the overlap that domains, roots and cell means need. Collective."""
    keys = [id(f.space.basis) for f in fields]
    reach = _shared(keys, lambda k: fields[k].space.basis.reach(where))
    layers: dict[int, int] = {}
    # cell means are of all fields' nodes around the cells that the first one's domains overlap
    span = max(count for _, count in reach)
    for field, (beyond, _) in zip(fields, reach):
        basis = field.space.basis
        need = max(beyond, least)
        if averages:
            need = max(need, layers_needed(span, basis))
        if field.ties_nodes:
            need += SEARCH_RADIUS + basis.degree + 1
        layers[id(basis)] = max(layers.get(id(basis), 0), need)
    return [f.space.basis.grown(layers[id(f.space.basis)], partition) for f in fields]


def _with_roots(
    fields: Sequence[Field], keys, bases: list[Basis], where: Placement, seen, nodes
):  # fmt: skip
    """The bases that know roots on other ranks, for grids that are not rectangular. Collective."""
    roots: list[Any] = [None] * len(fields)
    for k, field in enumerate(fields):
        basis = bases[k]
        tying = field.tying
        if tying is None or isinstance(basis, LatticeBasis):
            continue
        filled = tying.measure(where, seen[k], basis)
        roots[k] = mesh_roots(basis, nodes[k], filled, tying.level(basis.degree))
        wider = basis.knowing(*roots[k].unknown)
        # fields of one basis stay fields of one basis
        bases = [wider if b is basis else b for b in bases]
    nodes = _shared(keys, lambda k: active_nodes(seen[k], bases[k].nodes))
    return bases, nodes, roots


def _entities(points: MaterialPoints, keys, bases: Sequence[Basis], seen, moving: set[int]):
    """What terms integrate over, for every field. Collective."""
    tables = ghost_facets(points.grid) if GHOST_FACETS in moving else None

    def find(k: int) -> Entities:
        if not moving:
            return {}
        basis = bases[k]
        cells = active_cells(seen[k], basis.cells)
        entities: Entities = {}
        if tables is not None and isinstance(basis, LatticeBasis) and basis.coarsen > 1:
            entities[GHOST_FACETS] = tables.select_coarse(cells, basis)
        if basis.grid_cells is not None:
            cells = cells[basis.grid_cells]
        if tables is not None and GHOST_FACETS not in entities:
            entities[GHOST_FACETS] = tables.select(cells)
        if ACTIVE_CELLS in moving:
            topology = points.grid.topology
            owned = np.flatnonzero(cells[: topology.index_map(topology.dim).size_local])
            entities[ACTIVE_CELLS] = owned.astype(np.int32)
        return entities

    return _shared(keys, find)


def _field(
    field: Field, number: int, basis: Basis, where: Placement, seen: Stencils, nodes, fixed, roots,
    entities: Entities, axisymmetric: bool,
) -> ActiveField:  # fmt: skip
    """One field on the active cells. Collective."""
    tying, penalty, active = field.tying, None, nodes
    C = None if tying is None else tying.ties(where, basis, seen, nodes, fixed, roots)
    if C is not None and field.stabilisation.kind == "weak-aggregation":
        owned = nodes[: np.searchsorted(nodes, basis.nodes.owned)]
        radius = basis.node_coordinates()[:, 0] if axisymmetric else None
        rows, columns, values = field.stabilisation.penalty(field.space, C, owned, radius)
        penalty, C = Blocks(number, number, rows, columns, values), None
    level = None if C is None or tying is None else tying.level(basis.degree)
    if field.prolongate is not None:
        from scipy import sparse

        own = sparse.csr_matrix(field.prolongate(seen, nodes))
        C = own if C is None else C @ own
    to_grid, stencils = extraction(field.space, basis), seen
    if C is not None:
        prolongation = Prolongation(C)
        C = prolongation.matrix
        to_grid = C if to_grid is None else to_grid @ C
        stencils = prolongation.stencils(seen)
        nodes = nodes[~prolongation.tied[nodes]]
    return ActiveField(
        field.space, basis, seen, active, stencils, nodes, C, to_grid, entities, penalty, seen,
        level=level,
    )  # fmt: skip


def _in_active_cells(
    boundaries: Sequence[BoundaryOf], bodies: Placement, sets: Sequence[Placement], bases, views
) -> list[npt.NDArray[Any]]:
    """Which markers take part: those of passive boundaries in cells that points see. Collective."""
    members = [of.boundary.present() for of in boundaries]
    for view, basis in {(id(b), v.key): (v, b) for b, v in zip(bases, views)}.values():
        cells = active_cells(view.stencils(basis, bodies, ()), basis.cells)
        for of, one, chosen, sees in zip(boundaries, sets, members, view.boundaries):
            if of.boundary.activates or not sees:
                continue
            s = basis.stencils(one)
            # a marker without a domain is in one cell
            chosen[s.order] &= np.repeat(cells[s.cells], np.diff(s.groups))
    return [np.asarray(np.flatnonzero(chosen), np.int32) for chosen in members]


def _parted(
    fields: list[ActiveField], points: int, members: Sequence[npt.NDArray[np.int32]]
) -> list[ActiveField]:
    """Fields with the stencils of the points, and those of each boundary's markers apart.

    Args:
        fields: Fields with stencils of all together.
        points: How many points there are on this rank.
        members: Which markers of each boundary take part.
    """
    if not members:
        return fields
    ends = np.cumsum([points, *(len(rows) for rows in members)])
    number = np.arange(ends[-1])
    rows_of = [np.arange(points, dtype=np.int32), *members]

    def part(s: Stencils, k: int) -> Stencils:
        first = ends[k] - len(rows_of[k])
        own = selected(s, (number >= first) & (number < ends[k]))
        return replace(own, order=rows_of[k][own.order - first])

    return [
        replace(
            field,
            seen=part(field.seen, 0),
            stencils=part(field.stencils, 0),
            of_markers=tuple(part(field.stencils, k) for k in range(1, len(rows_of))),
        )
        for field in fields
    ]


def regions_of(
    boundaries: Sequence[BoundaryOf], here: Participants, of_main: Sequence[BoundaryOf]
) -> list[list[ActiveRegion]]:
    """The parts of boundaries that do not fit the grid, on what is active.

    Args:
        boundaries: Terms over them.
        here: What is active.
        of_main: Those of the form that the activation is made for, among which they are.
    """
    within = [(f.basis.nodes, u.nodes) for f, u in zip(here.fields, here.unknowns.fields)]
    number = {id(of.boundary): k for k, of in enumerate(of_main)}
    made = []
    for of in boundaries:
        parts, k = [], number[id(of.boundary)]
        for region in of.regions:
            chosen = region.chosen(of.boundary.markers["tag"])
            whole = {id(f.of_markers[k]): f.of_markers[k] for f in here.fields}
            if chosen is not None:
                whole = {key: selected(s, chosen) for key, s in whole.items()}
            once = joined([whole[id(f.of_markers[k])] for f in here.fields])
            own = once if not here.total else _pushed(once, of.boundary.deformation())
            parts.append(ActiveRegion(own, None, within))
        made.append(parts)
    return made
