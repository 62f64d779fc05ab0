"""Regions of the body and of boundaries on an activation: stencils and means over cells."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from dolfinmpm.basis import Stencils
from dolfinmpm.basis.stencils import joined, pushed_forward, selected
from dolfinmpm.body.axisymmetry import in_section
from dolfinmpm.body.location import bounds
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.cut.activation import ActiveDomain, ActiveRegion, RegionTerms, TermsOverBoundary
from dolfinmpm.cut.cellaverages import CellAverages, sharing_stencils

__all__ = ["active_boundary_regions", "active_region"]


def active_region(region: RegionTerms, points: MaterialPoints, here: ActiveDomain) -> ActiveRegion:
    """Stencils and means of a region of the body. Collective if it has means over cells.

    Args:
        region: The region.
        points: Material points.
        here: Points, active fields and unknowns.
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
        *stencils, shared = made(
            [*own, sharing_stencils(here.where, first.full_stencils, first.basis)]
        )
        stencils = pushed(stencils)
        where = here.where
        if region.by_centres:
            # a point on the grid's upper edge is in the last cell
            inside = np.nextafter(bounds(points.grid)[1], -np.inf)
            x = np.minimum(where.x, inside)
            where = replace(where, x=x, half=np.zeros_like(where.half))
        means = CellAverages(points["V"], where, shared, first.basis)
    within = [(f.basis.nodes, u.nodes) for f, u in zip(fields, unknowns.fields)]
    return ActiveRegion(stencils, means, within)


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
        own = once if not here.total else _pushed(once, of.boundary.deformation())
        made.append(ActiveRegion(own, None, within))
    return made


def _pushed(stencils: Sequence[Stencils], F: npt.NDArray[np.float64]) -> list[Stencils]:
    """Stencils with gradients by present positions. Common objects stay common."""
    now = {id(s): pushed_forward(s, F) for s in stencils}
    return [now[id(s)] for s in stencils]
