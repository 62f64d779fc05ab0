"""Terms over cells and facets of the grid, assembled by DOLFINx."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain
from typing import Any

import numba
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from dolfinx.fem import IntegralType

from dolfinmpm._platform.compat import compile_form, create_form, create_matrix, integration_domains
from dolfinmpm.assembly.splinefacets import FacetBlock, are_alike
from dolfinmpm.basis.space import Space
from dolfinmpm.body.points import ACTIVE_CELLS, GHOST_FACETS
from dolfinmpm.forms.splitting import OrdinaryTerms

__all__ = ["OrdinaryAssembler"]

_KINDS = {
    "cell": IntegralType.cell,
    "exterior_facet": IntegralType.exterior_facet,
    "interior_facet": IntegralType.interior_facet,
    "vertex": IntegralType.vertex,
}

Array = npt.NDArray[np.float64]
Entities = dict[int, npt.NDArray[np.int32]]


@numba.njit(cache=True, error_model="numpy")
def _entries(indptr, indices, rows, columns):
    at = 0
    for row in range(indptr.size - 1):
        for k in range(indptr[row], indptr[row + 1]):
            rows[at], columns[at] = row, indices[k]
            at += 1


class _Block:
    """One compiled form: linear in a test function, or bilinear."""

    def __init__(self, form: ufl.Form, grid, spaces: list[Space]):
        self._grid = grid
        self._spaces = spaces
        self._ufl = form
        self._compiled = compile_form(grid.comm, form)
        self.coefficients = form.coefficients()
        self.constants = form.constants()
        (data,) = form.subdomain_data().values()
        self._fixed: dict[Any, list] = {}
        for integral in form.integrals():
            kind, given = integral.integral_type(), integral.subdomain_id()
            ids = given if isinstance(given, tuple) else (given,)
            own = ("everywhere", "otherwise", GHOST_FACETS, ACTIVE_CELLS)
            numbers = sorted({i for i in ids if i not in own})
            domains = self._fixed.setdefault(_KINDS[kind], [])
            if numbers:
                found = integration_domains(_KINDS[kind], data[kind][0], numbers)
                known = {number for number, _ in domains}
                domains += [(number, rows) for number, rows in found if number not in known]
        groups = [integral.subdomain_id() for integral in form.integrals()]
        flat = {i for group in groups for i in (group if isinstance(group, tuple) else (group,))}
        self.moving = flat & {GHOST_FACETS, ACTIVE_CELLS}
        self._form: Any = None
        self._matrix: Any = None

    def attach(self, entities: Entities) -> None:
        """Integrate over these ghost facets and active cells from now on."""
        if self._form is not None and not self.moving:
            return
        domains = {kind: list(rows) for kind, rows in self._fixed.items()}
        for number in self.moving:
            facets = number == GHOST_FACETS
            kind = IntegralType.interior_facet if facets else IntegralType.cell
            domains.setdefault(kind, []).append((number, entities[number]))
        spaces = [space.function_space for space in self._spaces]
        self._form = create_form(
            self._compiled, spaces, self._grid, domains, self.coefficients, self.constants
        )
        if len(spaces) == 2:
            self._matrix = create_matrix(self._form)
            A, n = self._matrix, int(self._matrix.indptr[-1])
            self.rows, self.columns = np.empty(n, np.int32), np.empty(n, np.int32)
            _entries(A.indptr, A.indices, self.rows, self.columns)
            # beyond the known nodes stand columns of what other ranks add to rows owned here
            nodes = spaces[1].dofmap.index_map
            self._keep = None
            if self._grid.comm.size > 1:
                self._keep = self.columns < nodes.size_local + nodes.num_ghosts
                self.rows, self.columns = self.rows[self._keep], self.columns[self._keep]

    def add_vector(self, out: Array) -> None:
        """Add this rank's share of the assembled vector, shape (nodes, components)."""
        values = np.zeros(out.size)
        fem.assemble_vector(values, self._form)
        out += values.reshape(out.shape)

    def matrix(self) -> Array:
        """This rank's share of the assembled matrix, as blocks between `rows` and `columns`."""
        self._matrix.set_value(0.0)
        fem.assemble_matrix(self._matrix, self._form)
        shape = tuple(self._matrix.block_size)
        size = int(self._matrix.indptr[-1])
        blocks = self._matrix.data[: size * shape[0] * shape[1]].reshape(-1, *shape)
        return blocks if self._keep is None else blocks[self._keep]


class OrdinaryAssembler:
    """Assembles the ordinary terms of a split form. Collective in what it compiles.

    Args:
        terms: The terms.
        spaces: Spaces of the fields, whose components are stacked at the nodes.

    Attributes:
        on_splines: Whether the Jacobian stands between splines, not between Lagrange nodes.
    """

    def __init__(self, terms: OrdinaryTerms, spaces: Sequence[Space]):
        self._spaces = spaces
        self._starts = np.cumsum([0] + [space.components for space in spaces])
        self.components = int(self._starts[-1])
        grid = spaces[0].grid

        def block(form, *fields) -> _Block | None:
            return None if form is None else _Block(form, grid, [spaces[k] for k in fields])

        def bilinear(form, *fields) -> _Block | FacetBlock | None:
            if self.on_splines and form is not None:
                return FacetBlock(form, spaces[0])
            return block(form, *fields)

        bilinear_form = terms.jacobian[0][0]
        self.on_splines = (
            len(spaces) == 1 and bilinear_form is not None and are_alike(bilinear_form, spaces[0])
        )

        count = range(len(spaces))
        self._external = [block(terms.external[i], i) for i in count]
        self._internal = [block(terms.internal[i], i) for i in count]
        self._jacobian = [[bilinear(terms.jacobian[i][j], i, j) for j in count] for i in count]
        self.linear = terms.linear
        self._all = [
            b for b in chain(self._external, self._internal, *self._jacobian) if b is not None
        ]
        self.moving = set().union(*(b.moving for b in self._all))

    def constants(self) -> list[fem.Constant]:
        """DOLFINx constants in the terms."""
        return [c for b in self._all for c in b.constants]

    def functions(self) -> list[fem.Function]:
        """DOLFINx functions in the terms."""
        return [c for b in self._all for c in b.coefficients]

    @property
    def spline_blocks(self) -> list[FacetBlock]:
        """The blocks that keep tensors of classes of facets."""
        return [b for b in self._all if isinstance(b, FacetBlock)]

    def attach(self, entities: Entities) -> None:
        """Integrate over these ghost facets and active cells, by subdomain id, from now on."""
        for b in self._all:
            b.attach(entities)
        structure = [
            (i, j, b)
            for i, row in enumerate(self._jacobian)
            for j, b in enumerate(row)
            if b is not None
        ]
        self._parts = structure
        empty = [np.empty(0, np.int32)]
        self.rows = np.concatenate([b.rows for _, _, b in structure] or empty)
        self.columns = np.concatenate([b.columns for _, _, b in structure] or empty)

    def add_external(self, out: Array) -> None:
        """Add the vector that does not depend on the increments to (nodes, components)."""
        self._add(self._external, out)

    def add_internal(self, out: Array) -> None:
        """Add the vector that does."""
        self._add(self._internal, out)

    def _add(self, blocks: list[_Block | None], out: Array) -> None:
        for k, b in enumerate(blocks):
            if b is None:
                continue
            first, last = self._starts[k], self._starts[k + 1]
            nodes = self._spaces[k].function_space.dofmap.index_map
            part = np.zeros((nodes.size_local + nodes.num_ghosts, last - first))
            b.add_vector(part)
            out[: len(part), first:last] += part

    def jacobian(self) -> Array:
        """Blocks between `rows` and `columns`, shape (n, components, components)."""
        if len(self._parts) == 1 and len(self._spaces) == 1:
            return self._parts[0][2].matrix()
        blocks = np.zeros((self.rows.size, self.components, self.components))
        at = 0
        for i, j, b in self._parts:
            values = b.matrix()
            rows = slice(self._starts[i], self._starts[i + 1])
            columns = slice(self._starts[j], self._starts[j + 1])
            blocks[at : at + len(values), rows, columns] = values
            at += len(values)
        return blocks
