"""Bases of a step, known so far around each rank's cells as the step's stencils and roots reach."""

from __future__ import annotations

from collections.abc import Sequence

from dolfinmpm.basis import LatticeBasis, Placement
from dolfinmpm.cut.activation import Basis, Field
from dolfinmpm.cut.aggregation import SEARCH_RADIUS
from dolfinmpm.cut.cellaverages import layers_needed
from dolfinmpm.grid.partition import Partition

__all__ = ["overlapping_bases"]


def overlapping_bases(
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
            refinement.leaves_for(where, averaged)
            found.append(refinement.basis(base, need, partition))
    return found
