"""What a solver of steps remembers, so that a run can go on as if it had not been interrupted.

Results do not depend on most of it, but their last bits do: the couplings that the matrix
has kept decide in which order it is factorised.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from dolfinx import fem
from mpi4py import MPI

from dolfinmpm.assembly.points import Pattern
from dolfinmpm.assembly.splinefacets import FacetBlock
from dolfinmpm.basis.lattice import LatticeBasis
from dolfinmpm.basis.stencils import Stencils
from dolfinmpm.grid.cellvalues import set_values, values_of_cells
from dolfinmpm.solve.linesearch import set_search
from dolfinmpm.solve.loads import Loads
from dolfinmpm.solve.newton import NewtonSystem
from dolfinmpm.solve.solver import WORKSPACE

__all__ = ["loads_of", "memory_of", "set_loads", "set_memory"]

Arrays = dict[str, npt.NDArray[Any]]
State = dict[str, Any]


def loads_of(loads: Loads) -> tuple[State, Arrays]:
    """Constants and functions of the form as at the last converged step, the latter by cells."""
    state: State = {}
    cells: Arrays = {}
    for k, (item, value) in enumerate(loads.converged()):
        if isinstance(item, fem.Function):
            cells[f"load {k}"] = values_of_cells(item, value)
        else:
            state[f"load {k}"] = value
    return state, cells


def set_loads(loads: Loads, state: State, cells: Arrays) -> None:
    """Set them to what `loads_of` returned. Collective."""
    for k, (item, _) in enumerate(loads.converged()):
        if isinstance(item, fem.Function):
            set_values(item, cells[f"load {k}"])
        else:
            item.value = state[f"load {k}"]
    loads.release()


def memory_of(system: NewtonSystem) -> tuple[State, Arrays]:
    """Line search, workspace and overlap of the ranks; unknowns and couplings of this rank."""
    basis = system.basis
    state: State = {
        "search": system._search if system._searches else None,
        "workspace": system._mumps._settings.get(WORKSPACE),
        "layers": basis.halo.layers if isinstance(basis, LatticeBasis) else None,
    }
    numbering, local = basis.nodes, {}
    if not isinstance(basis, LatticeBasis):
        first = system.spaces[0].function_space.dofmap.index_map.num_ghosts
        local["learned"] = numbering.index_map.ghosts[first:]
        local["learned_owner"] = numbering.index_map.owners[first:]
        local["learned_x"] = basis.node_coordinates()[numbering.owned + first :]
    for k, block in enumerate(_spline_blocks(system)):
        local |= {f"facets {k} {name}": values for name, values in block.memory().items()}
    pattern = system._pattern
    if pattern is not None:
        number, nodes = _numbers(numbering), system.unknowns.nodes
        rows = np.repeat(nodes, np.diff(pattern.start))
        local["active"] = number[nodes]
        local["rows"], local["columns"] = number[rows], number[nodes[pattern.neighbours]]
    return state, local


def set_memory(system: NewtonSystem, state: State, local: Arrays | None) -> None:
    """Let a system remember what `memory_of` returned, and nothing of its own. Collective.

    Args:
        system: System of the same problem.
        state: Settings.
        local: Arrays of this rank; None if ranks or the partition of the grid are others.
    """
    system._configure(*system._settings)
    if system._searches and state["search"]:
        system._search = state["search"]
        set_search(system._snes, system._settings[0], system._search)
    if state["workspace"]:
        system._mumps._settings[WORKSPACE] = state["workspace"]
    if local is not None:
        _extend(system, state, local)
    system._set_numbering()
    for values in (system._u, system._r, system._external, system._lift):
        values[:] = 0.0
    for space in system.spaces:
        space.increment.x.array[:] = 0.0
    system._filled = np.empty(0, np.int32)
    system._pattern = system._matrix = system._attached = None
    for k, block in enumerate(_spline_blocks(system)):
        start = f"facets {k} "
        kept = {n.removeprefix(start): a for n, a in (local or {}).items() if n.startswith(start)}
        block.remember(kept)
    if local is not None and "active" in local:
        _couple(system, local)


def _extend(system: NewtonSystem, state: State, local: Arrays) -> None:
    """Know the nodes of other ranks that were known."""
    basis = system.basis
    if isinstance(basis, LatticeBasis):
        if state["layers"] is not None:
            basis.extend(state["layers"])
        return
    if "learned" not in local:
        return
    new = ~np.isin(local["learned"], basis.nodes.index_map.ghosts)
    if system.comm.allreduce(bool(new.any()), op=MPI.LOR):
        basis.learn(local["learned"][new], local["learned_owner"][new], local["learned_x"][new])


def _couple(system: NewtonSystem, local: Arrays) -> None:
    """Number the unknowns as they were, with the couplings that the matrix had kept."""
    number = _numbers(system.basis.nodes)
    order = np.argsort(number)

    def here(numbers):
        at = order[np.searchsorted(number, numbers, sorter=order).clip(max=len(number) - 1)]
        return np.where(number[at] == numbers, at, -1).astype(np.int32)

    unknowns = system.unknowns
    active, rows, columns = (here(local[name]) for name in ("active", "rows", "columns"))
    active = np.sort(active[active >= 0])
    unknowns.activate(active)
    system._touched = active
    known = (rows >= 0) & (columns >= 0)
    system._pattern = Pattern.build(_no_stencils(), unknowns, rows[known], columns[known], None)


def _spline_blocks(system: NewtonSystem) -> list[FacetBlock]:
    return [block for a in system._assemblers for block in a.spline_blocks]


def _numbers(numbering) -> npt.NDArray[np.int64]:
    """Global numbers of the nodes known here."""
    owned = np.arange(*numbering.index_map.local_range, dtype=np.int64)
    return np.concatenate([owned, numbering.index_map.ghosts])


def _no_stencils() -> Stencils:
    none, zero = np.empty(0, np.int32), np.zeros(1, np.int32)
    return Stencils(
        none, zero, zero, none, np.zeros(1, np.int64), np.empty(0), np.empty((0, 1)), zero, none
    )
