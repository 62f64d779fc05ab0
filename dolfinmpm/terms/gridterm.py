"""Terms over cells and facets of the grid."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from dolfinmpm.assembly.gridassembler import GridAssembler
from dolfinmpm.assembly.state import Local
from dolfinmpm.assembly.stencilsums import Entries, add_blocks
from dolfinmpm.assembly.term import ActiveTerm, Term
from dolfinmpm.cut.activation import Activation, ActiveField
from dolfinmpm.cut.facetmoduli import FacetModulus, update
from dolfinmpm.cut.pattern import Blocks

__all__ = ["ActiveGridTerm", "GridTerm", "fill_functions"]

Array = npt.NDArray[np.float64]


class GridTerm(Term):
    """Terms assembled by DOLFINx.

    Args:
        assembler: The assembler of the terms.
        kind: "stiffness" for forces on the increments; "soft" for terms of the tangent only;
            "changes" for penalties on the change of velocity in a step in time.

    Attributes:
        assembler: The argument.
    """

    def __init__(self, assembler: GridAssembler, kind: str = "stiffness"):
        self.assembler, self._kind = assembler, kind

    @property
    def moving(self) -> set[int]:
        """See `Term`."""
        return self.assembler.moving

    @property
    def loads(self) -> list[Any]:
        """See `Term`."""
        return self.assembler.loads if self._kind == "stiffness" else []

    @property
    def moduli(self) -> list[FacetModulus]:
        """Moduli of the laws' tangents at facets, in its forces."""
        return self.assembler.moduli if self._kind != "soft" else []

    def blocks(self, fields: Sequence[ActiveField]) -> dict[str, list[Blocks]]:
        """See `Term`. Terms that are not linear in increments are assembled later. Collective."""
        for modulus in self.moduli:
            (field,) = (f for f in fields if f.space.increment is modulus.increment)
            update(modulus, field)
        if self.assembler.empty:
            return {}
        self.assembler.attach(fields)
        linear = self._kind != "stiffness" or self.assembler.terms.linear
        made = self.assembler.tangent(fields, anywhere=not linear)
        return {self._kind if linear else "pattern": made}

    def on(self, here: Activation) -> ActiveGridTerm | None:
        """See `Term`: None where constant blocks are all that it has. Collective."""
        if self._kind != "stiffness" or not self.assembler.has_vectors:
            return None
        return ActiveGridTerm(self.assembler, here)

    def regrid(self) -> None:
        """See `Term`."""
        self.assembler.regrid()

    def summary(self) -> str:
        """See `Term`."""
        counts = self._kind == "stiffness" and not self.assembler.empty
        return "integrals over the grid" if counts else ""

    def state(self) -> dict[str, Any]:
        """Kept facet tensors, see `FacetBlock`."""
        blocks = enumerate(self.assembler.facet_blocks)
        return {f"{k} {n}": Local(v) for k, block in blocks for n, v in block.state().items()}

    def set_state(self, values: Mapping[str, Any]) -> None:
        """Restore a state returned by `state`, and discard other cached data."""
        for k, block in enumerate(self.assembler.facet_blocks):
            start = f"{k} "
            names = [name for name in values if name.startswith(start)]
            block.renew()
            block.set_state({name.removeprefix(start): values[name].values for name in names})


class ActiveGridTerm(ActiveTerm):
    """Terms assembled by DOLFINx, on an activation; see `ActiveTerm`."""

    kind = "grid"

    def __init__(self, assembler: GridAssembler, here: Activation):
        self._assembler, self._here = assembler, here
        self._u: Sequence[Array] = ()

    def external(self, out: Sequence[Array]) -> None:
        """See `ActiveTerm`."""
        self._assembler.add_external(self._here.fields, out)

    def move(self, u: Sequence[Array]) -> None:
        """See `ActiveTerm`."""
        self._u = u

    def internal(self, out: Sequence[Array]) -> bool:
        """See `ActiveTerm`."""
        if not self._assembler.terms.linear:
            fill_functions(self._here.fields, self._u)
            self._assembler.add_internal(self._here.fields, out)
        return True

    def tangent(self, entries: Mapping[tuple[int, int], Entries]) -> None:
        """See `ActiveTerm`. Collective."""
        if not self._assembler.terms.linear:
            fill_functions(self._here.fields, self._u)
            for b in self._assembler.tangent(self._here.fields):
                add_blocks(b, entries[b.row_field, b.column_field])


def fill_functions(fields: Sequence[ActiveField], u: Sequence[Array]) -> None:
    """Copy nodal increments, shape (nodes, components) per field, to the DOLFINx functions."""
    for field, own in zip(fields, u):
        values = field.space.increment.x.array.reshape(-1, field.space.components)
        if field.to_grid is not None:
            values[:] = (field.to_grid @ own)[: len(values)]
            continue
        values[:] = 0.0
        known = field.nodes[field.nodes < len(values)]
        values[known] = own[known]
