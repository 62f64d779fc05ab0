"""Boundaries that do not fit the grid, on an activation: their markers, stencils and regions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm.basis import Placement, Stencils
from dolfinmpm.basis.stencils import all_pushed_forward, joined, selected
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.cut.activation import (
    Activation,
    ActiveBoundary,
    ActiveDomain,
    ActiveField,
    ActiveRegion,
    TermsOverBoundary,
)
from dolfinmpm.cut.activecells import active_cells

if TYPE_CHECKING:
    from dolfinmpm.cut.activate import Draft

__all__ = [
    "active_boundary_regions",
    "in_active_cells",
    "present_markers",
    "unmoved",
    "with_regions",
    "with_separate_stencils",
]


def present_markers(terms: Sequence[TermsOverBoundary]) -> dict[int, ActiveBoundary]:
    """The boundaries with the markers that take part, by the number of their markers."""
    found = {}
    for of in terms:
        rows = np.asarray(np.flatnonzero(of.boundary.present()), np.int32)
        found[of.boundary.markers.number] = ActiveBoundary(of.boundary.placement(), rows)
    return found


def in_active_cells(
    terms: Sequence[TermsOverBoundary],
    boundaries: dict[int, ActiveBoundary],
    drafts: Sequence[Draft],
    bodies: Placement,
) -> dict[int, ActiveBoundary]:
    """The boundaries with their active markers: of passive boundaries those in active cells.

    Collective.

    Args:
        terms: Terms over the boundaries.
        boundaries: The boundaries, with all their markers.
        drafts: The fields, with their bases.
        bodies: The points.
    """
    flags = {of.boundary.markers.number: of.boundary.present() for of in terms}
    for draft in drafts:
        cells = active_cells(draft.stencils(bodies, {}), draft.basis.cells)
        for of in terms:
            n = of.boundary.markers.number
            if of.boundary.activates or not draft.has_markers[n]:
                continue
            s = draft.basis.stencils(boundaries[n].seen)
            # a marker without a domain is in one cell
            flags[n][s.order] &= np.repeat(cells[s.cells], np.diff(s.groups))
    rows = {n: np.asarray(np.flatnonzero(chosen), np.int32) for n, chosen in flags.items()}
    return {n: replace(one, rows=rows[n]) for n, one in boundaries.items()}


def with_separate_stencils(
    field: ActiveField, boundaries: dict[int, ActiveBoundary], points: int, markers: int
) -> ActiveField:
    """A field with separate stencils of the points and of each boundary's markers.

    Args:
        field: The field; its stencils are of the points, followed by the active markers.
        boundaries: The boundaries.
        points, markers: Number of the points, and of the active markers of all boundaries.
    """
    number = np.arange(points + markers)

    def part(s: Stencils, first: int, rows: npt.NDArray[np.int32]) -> Stencils:
        own = selected(s, (number >= first) & (number < first + len(rows)))
        return replace(own, order=rows[own.order - first])

    of_markers, first = {}, points
    for n, one in boundaries.items():
        of_markers[n] = part(field.stencils, first, one.rows)
        first += len(one.rows)
    of_points = np.arange(points, dtype=np.int32)
    return replace(
        field,
        full_stencils=part(field.full_stencils, 0, of_points),
        stencils=part(field.stencils, 0, of_points),
        of_markers=of_markers,
    )


def with_regions(
    terms: Sequence[TermsOverBoundary], found: dict[int, ActiveBoundary], domain: ActiveDomain
) -> dict[int, ActiveBoundary]:
    """Boundaries with their active parts."""
    number = {of.boundary.markers.number: of for of in terms}
    return {
        n: replace(one, regions=active_boundary_regions(number[n], domain))
        for n, one in found.items()
    }


def active_boundary_regions(of: TermsOverBoundary, here: ActiveDomain) -> list[ActiveRegion]:
    """The regions of a boundary that does not fit the grid.

    Args:
        of: Terms over the boundary.
        here: Active fields with stencils of the markers, and unknowns.
    """
    within = [(f.basis.nodes, u.nodes) for f, u in zip(here.fields, here.unknowns.fields)]
    markers, made = of.boundary.markers, []
    stencils = [f.of_markers[markers.number] for f in here.fields]
    for region in of.regions:
        chosen = region.chosen(markers["tag"])
        whole = {id(s): s for s in stencils}
        if chosen is not None:
            whole = {key: selected(s, chosen) for key, s in whole.items()}
        once = joined([whole[id(s)] for s in stencils])
        own = once if not here.total else all_pushed_forward(once, of.boundary.deformation())
        made.append(ActiveRegion(own, None, within))
    return made


def unmoved(
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
