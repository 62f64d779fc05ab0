"""Points that follow the leaves of refined spaces: they split where leaves are finer, and merge."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm._platform.uncopied import FOUND, unchanged
from dolfinmpm.basis.refinement import Refinement
from dolfinmpm.basis.space import Space
from dolfinmpm.body.familyids import MERGES, SPLITS
from dolfinmpm.body.pointfamilies import FamilyChange, families, merge, split
from dolfinmpm.body.points import MaterialPoints

if TYPE_CHECKING:
    from dolfinmpm.solve.problem import Problem

__all__ = ["Adaptation", "adapt"]

Array = npt.NDArray[np.float64]

# Largest difference of logarithmic strains, and of internal variables, of siblings that merge
_ALIKE = 0.02


@unchanged(FOUND)
@dataclass(frozen=True)
class Adaptation:
    """What following the leaves has changed, on all ranks.

    Attributes:
        split: Number of points that split.
        merged: Number of families that merged.
        leaves: Number of leaves of the displacement.
        kinetic_energy: Change of the kinetic energy (J).
        elastic_energy: Change of the stored elastic energy (J), see `dolfinmpm.split`.
    """

    split: int = 0
    merged: int = 0
    leaves: int = 0
    kinetic_energy: float = 0.0
    elastic_energy: float = 0.0


def adapt(problem: Problem) -> Adaptation:
    """Let leaves and points follow the sizes wanted now; see `Problem.adapt`. Collective."""
    spaces = problem.form.adaptive
    if not spaces:
        return Adaptation()
    points, number, joined, energies = problem.points, 0, 0, np.zeros(2)
    levels = max(refinement.levels for refinement in _refinements(spaces))
    for _ in range(levels + 1):
        which = _sizes(points, spaces) > SPLITS
        if not points.comm.allreduce(bool(which.any()), op=MPI.LOR):
            break
        done = split(points, which)
        number += done.count
        energies += _change(done)
    for _ in range(levels):
        allowed = (2.0 * _sizes(points, spaces) < MERGES) & (families(points).level > 0)
        if not points.comm.allreduce(bool(allowed.any()), op=MPI.LOR):
            break
        done = merge(points, _ALIKE, allowed=allowed)
        joined += done.count
        energies += _change(done)
        if not done.count:
            break
    for refinement in _refinements(spaces):
        refinement.hold()
    found = [r.leaves.node.size for r in _refinements(spaces) if r.leaves is not None]
    return Adaptation(number, joined, sum(found), float(energies[0]), float(energies[1]))


def _refinements(spaces: Sequence[Space]) -> list[Refinement]:
    """The refinements of some spaces, each once."""
    return list({id(s.refinement): s.refinement for s in spaces if s.refinement}.values())


def _change(done: FamilyChange) -> Array:
    """Changes of the kinetic and of the elastic energy (J)."""
    return np.array(
        [
            done.after.kinetic_energy - done.before.kinetic_energy,
            done.after.elastic_energy - done.before.elastic_energy,
        ]
    )


def _sizes(points: MaterialPoints, spaces: Sequence[Space]) -> Array:
    """Size of each point's domain over its part of the leaf at its centre, shape (points,).

    Points of other fields get a size at which they neither split nor merge.
    """
    result = np.full(len(points), 0.5 * (SPLITS + MERGES))
    size = 2.0 * np.prod(points["l"], axis=1) ** (1 / points.gdim)
    for space in spaces:
        assert space.refinement is not None
        assert space.per_cell is not None
        where = points.placement(space.configuration)
        leaves = space.refinement.update_leaves(where, space.basis.averaged)
        own = slice(None) if space.tags is None else np.isin(points["tag"], space.tags)
        x = np.ascontiguousarray(where.x[own])
        _, leaf = leaves.overlapped(x, np.zeros_like(x))
        low, high = leaves.tree.corners(leaves.node)
        edge = np.prod(high - low, axis=1) ** (1 / points.gdim)
        result[own] = size[own] * space.per_cell / edge[leaf]
    return result
