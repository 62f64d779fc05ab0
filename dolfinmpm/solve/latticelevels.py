"""Geometric multigrid on every second, fourth, ... line of the lattice.

The functions of a coarser lattice are sums of functions of the finer lattice. So the spaces are
nested, and Galerkin products give their stiffness. Points, penalties and constraints C need no
treatment: the tangent Cᵀ K C contains them, and the independent nodes of C are the finest level.
"""

from __future__ import annotations

import functools
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt
from mpi4py import MPI
from petsc4py import PETSc

from dolfinmpm.basis import LeafBasis, LinearBasis
from dolfinmpm.basis.knotinsertion import knot_insertion
from dolfinmpm.cut.activation import Activation
from dolfinmpm.solve.interpolations import (
    LatticeLevel,
    interpolations,
    lattice_family,
    next_level,
)
from dolfinmpm.solve.leaflevels import FamilyOf, leaf_families, spline_families

__all__ = ["finest_level", "lattice_families", "levels_of", "set_levels"]

Array = npt.NDArray[np.float64]

# A level with at most this number of unknowns is the coarsest one, which factors solve
_COARSEST = 500


def finest_level(here: Activation) -> LatticeLevel:
    """The unknowns of the first field as the finest level. Collective."""
    unknowns = here.unknowns
    field, basis = unknowns.fields[0], here.fields[0].basis
    assert not isinstance(basis, LinearBasis)
    nodes = field.owned_nodes
    free = ~field.fixed[nodes]
    if isinstance(basis, LeafBasis):
        ijk = (basis.fine if basis.degree == 1 else basis.levelled)[nodes]
    else:
        ijk = basis.halo.node_ijk[nodes]
    if unknowns.comm.size == 1:
        return LatticeLevel(ijk, free, field.blocks)
    # rows are not always with the owner of the node
    block = field.components if field.blocks else 1
    rows = np.repeat(ijk, field.components, axis=0)
    component = np.tile(np.arange(field.components), len(nodes))
    columns = np.column_stack([rows, component, free.ravel()]).astype(np.float64)
    if not field.blocks:
        columns = columns[free.ravel()]
    sent = np.column_stack([unknowns.shared_out(np.array(c)) for c in columns.T])
    if field.blocks:
        return LatticeLevel(
            sent[::block, :-2].astype(np.int32), sent[:, -1].reshape(-1, block) > 0, True
        )
    return _from_rows(sent[:, :-2].astype(np.int32), sent[:, -2].astype(int), field.components)


def _from_rows(ijk, component, components: int) -> LatticeLevel:
    """A level from the nodes and components of rows without blocks."""
    first = np.ones(len(ijk), bool)
    first[1:] = np.any(ijk[1:] != ijk[:-1], axis=1)
    node = np.cumsum(first) - 1
    free = np.zeros((int(first.sum()), components), bool)
    free[node, component] = True
    return LatticeLevel(ijk[first], free, False)


def lattice_families(lines: Sequence[Array], degree: int) -> Iterator[FamilyOf]:
    """Functions from the nodes of each level of a lattice to their parents.

    Args:
        lines: Coordinates of the grid lines (m), one array per direction.
        degree: Degree of the functions.
    """
    while any(line.size > 2 for line in lines):
        made = [knot_insertion(line, degree) for line in lines]
        lines = [line for line, _ in made]
        yield functools.partial(lattice_family, parents=[parents for _, parents in made])


def levels_of(
    comm: MPI.Intracomm, finest: LatticeLevel, families: Iterable[FamilyOf]
) -> list[LatticeLevel]:
    """Levels from the finest one to the coarsest one. Collective.

    Args:
        comm: Communicator.
        finest: The unknowns.
        families: Functions from the nodes of each level to their parents.
    """
    levels, count = [finest], comm.allreduce(int(np.count_nonzero(finest.free)))
    for family_of in families:
        if count <= _COARSEST:
            break
        finer = replace(levels[-1], family=family_of(levels[-1].nodes))
        coarser = next_level(comm, finer)
        fewer = comm.allreduce(coarser.size)
        if not 0 < fewer < count:
            break
        levels[-1], count = finer, fewer
        levels.append(coarser)
    return levels


def set_levels(pc: PETSc.PC, here: Activation) -> None:
    """Give PETSc's multigrid the levels of an activation. Collective.

    Other meshes, and several fields, have one level, which factors solve.
    """
    comm, basis = here.unknowns.comm, here.fields[0].basis
    if isinstance(basis, LinearBasis) or len(here.fields) > 1:
        return
    lattice = lattice_families(basis.lattice.lines, basis.degree)
    families: Iterable[FamilyOf] = lattice
    if isinstance(basis, LeafBasis):
        families = leaf_families(basis.leaves)
        if basis.degree > 1:
            families = spline_families(basis.leaves, basis.degree, lattice)
    levels = levels_of(comm, finest_level(here), families)
    pc.setMGLevels(len(levels))
    for k, P in enumerate(interpolations(comm, levels)):
        pc.setMGInterpolation(len(levels) - 1 - k, P)
        P.destroy()
    # options of the levels are read now, because the levels are new
    pc.setFromOptions()
