"""Points that follow the leaves of refined spaces: they split where leaves are finer, and merge."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm.basis.refinement import Refinement
from dolfinmpm.body.pointfamilies import FamilyChange, families, merge, split

if TYPE_CHECKING:
    from dolfinmpm.solve.problem import Problem

__all__ = ["Adaptation", "adapt"]

Array = npt.NDArray[np.float64]

# A point splits if its domain is larger than this share of its part of a leaf, and siblings merge
# if their parent's domain is smaller than the second share. Between them nothing changes.
_SPLITS, _MERGES = math.sqrt(2.0), 1.1
# Largest difference of logarithmic strains, and of internal variables, of siblings that merge
_ALIKE = 0.02


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
    space = problem.form.spaces[0]
    refinement, points = space.refinement, problem.points
    if refinement is None or space.per_cell is None:
        return Adaptation()
    number, families_merged, energies = 0, 0, np.zeros(2)
    for _ in range(refinement.levels + 1):
        which = _sizes(problem, refinement) > _SPLITS
        if not points.comm.allreduce(bool(which.any()), op=MPI.LOR):
            break
        done = split(points, which)
        number += done.count
        energies += _change(done)
    for _ in range(refinement.levels):
        allowed = (2.0 * _sizes(problem, refinement) < _MERGES) & (families(points).level > 0)
        if not points.comm.allreduce(bool(allowed.any()), op=MPI.LOR):
            break
        done = merge(points, _ALIKE, allowed=allowed)
        families_merged += done.count
        energies += _change(done)
        if not done.count:
            break
    if number or families_merged:
        problem.here = None
    leaves = refinement.leaves
    refinement.hold()
    found = 0 if leaves is None else leaves.node.size
    return Adaptation(number, families_merged, found, float(energies[0]), float(energies[1]))


def _change(done: FamilyChange) -> Array:
    """Changes of the kinetic and of the elastic energy (J)."""
    return np.array(
        [
            done.after.kinetic_energy - done.before.kinetic_energy,
            done.after.elastic_energy - done.before.elastic_energy,
        ]
    )


def _sizes(problem: Problem, refinement: Refinement) -> Array:
    """Size of each point's domain over its part of the leaf at its centre, shape (points,)."""
    space, points = problem.form.spaces[0], problem.points
    where = points.placement(space.configuration)
    # points of linear functions have domains too, which tell their sizes
    leaves = refinement.leaves_for(where, space.basis.averaged)
    x = np.ascontiguousarray(where.x)
    _, leaf = leaves.overlapped(x, np.zeros_like(x))
    low, high = leaves.tree.corners(leaves.node)
    edge = np.prod(high - low, axis=1) ** (1 / x.shape[1])
    size = 2.0 * np.prod(points["l"], axis=1) ** (1 / x.shape[1])
    assert space.per_cell is not None
    return np.asarray(size * space.per_cell / edge[leaf])
