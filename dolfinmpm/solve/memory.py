"""What a solver of steps remembers, so that a run can go on as if it had not been interrupted.

Results do not depend on most of it, but their last bits do: the couplings that the matrix
has kept decide in which order it is factorised.
"""

from __future__ import annotations

from typing import Any

import numpy.typing as npt
from dolfinx import fem

from dolfinmpm.assembly.splinefacets import FacetBlock
from dolfinmpm.cut.couplings import KeptCouplings
from dolfinmpm.cut.participants import Activation
from dolfinmpm.grid.cellvalues import set_values, values_of_cells
from dolfinmpm.solve.linearsolver import WORKSPACE
from dolfinmpm.solve.loads import Loads
from dolfinmpm.solve.newton import Newton
from dolfinmpm.solve.weakform import WeakForm

__all__ = ["memory_of", "saved_loads", "set_loads", "set_memory"]

Arrays = dict[str, npt.NDArray[Any]]
State = dict[str, Any]


def saved_loads(loads: Loads) -> tuple[State, Arrays]:
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
    """Set them to what `saved_loads` returned. Collective."""
    for k, (item, _) in enumerate(loads.converged()):
        if isinstance(item, fem.Function):
            set_values(item, cells[f"load {k}"])
        else:
            item.value = state[f"load {k}"]
    loads.release()


def memory_of(newton: Newton, form: WeakForm, here: Activation | None) -> tuple[State, Arrays]:
    """Line search and workspace; guess, couplings and facets' tensors of this rank.

    Args:
        newton: Newton's method.
        form: The weak form.
        here: What took part in the last step, or None.
    """
    state: State = {
        "search": newton.search if newton.searches else None,
        "workspace": newton.linear.mumps.get(WORKSPACE),
    }
    local: Arrays = {}
    for k, block in enumerate(_spline_blocks(form)):
        local |= {f"facets {k} {name}": values for name, values in block.memory().items()}
    if here is not None:
        kept = KeptCouplings.of(here)
        local |= {"active": kept.active, "rows": kept.rows, "columns": kept.columns}
    local |= newton.guess.memory()
    return state, local


def set_memory(
    newton: Newton, form: WeakForm, state: State, local: Arrays | None
) -> KeptCouplings | None:
    """Let a solver remember what `memory_of` returned, and nothing of its own. Collective.

    Args:
        newton: Newton's method.
        form: The weak form.
        state: Settings.
        local: Arrays of this rank; None if ranks or the partition of the grid are others.

    Returns:
        Couplings that the next pattern is to have, or None.
    """
    newton.linear.forget()
    if newton.searches and state["search"]:
        newton.search = state["search"]
    if state["workspace"]:
        newton.linear.mumps[WORKSPACE] = state["workspace"]
    newton.guess.remember(local or {}, form.points.partition)
    for space in form.spaces:
        space.increment.x.array[:] = 0.0
    for k, block in enumerate(_spline_blocks(form)):
        start = f"facets {k} "
        kept = {n.removeprefix(start): a for n, a in (local or {}).items() if n.startswith(start)}
        block.renew()
        block.remember(kept)
    if local is None or "active" not in local:
        return None
    return KeptCouplings(local["active"], local["rows"], local["columns"])


def _spline_blocks(form: WeakForm) -> list[FacetBlock]:
    return [block for grid in form.grids for block in grid.spline_blocks]
