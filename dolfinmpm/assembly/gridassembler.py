"""Assembly of terms over cells and facets of the grid, by DOLFINx."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numba
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import cpp, fem
from dolfinx.fem import IntegralType
from dolfinx.fem.forms import get_integration_domains
from mpi4py import MPI

from dolfinmpm._platform.compat import compile_form, create_form
from dolfinmpm.assembly.facetpenalties import INTERVALS, MeshPairs, by_ratio
from dolfinmpm.assembly.facettensors import facet_moduli
from dolfinmpm.assembly.leafcellblock import LeafCellBlock
from dolfinmpm.assembly.leaffacetblock import LeafFacetBlock, check_on_leaves
from dolfinmpm.assembly.splinefacets import FacetBlock, uses_facet_classes
from dolfinmpm.basis.space import Space
from dolfinmpm.body.points import ACTIVE_CELLS, GHOST_FACETS
from dolfinmpm.cut.activation import ActiveField
from dolfinmpm.cut.facetmoduli import FacetModulus
from dolfinmpm.cut.pattern import Blocks
from dolfinmpm.cut.prolongation import reduce_blocks
from dolfinmpm.forms.gridterms import GridTerms

__all__ = ["GridAssembler"]

_KINDS = {
    "cell": IntegralType.cell,
    "exterior_facet": IntegralType.exterior_facet,
    "interior_facet": IntegralType.interior_facet,
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


class _CompiledForm:
    """One compiled form: linear in a test function, or bilinear."""

    def __init__(self, form: ufl.Form, spaces: list[Space]):
        self._spaces = spaces
        self._compiled = compile_form(spaces[0].grid.comm, form)
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
                found = get_integration_domains(_KINDS[kind], data[kind][0], numbers)
                known = {number for number, _ in domains}
                domains += [(number, rows) for number, rows in found if number not in known]
        groups = [integral.subdomain_id() for integral in form.integrals()]
        flat = {i for group in groups for i in (group if isinstance(group, tuple) else (group,))}
        self.moving = flat & {GHOST_FACETS, ACTIVE_CELLS}
        self._form: Any = None
        self._entities: Entities | None = None
        self._matrix: Any = None
        self._moduli = facet_moduli(form)
        # columns of the moduli in packed coefficients, and penalties of facets by ratio of moduli
        self._columns: list[dict[Any, npt.NDArray[np.intp]]] = []
        self._penalties: dict[tuple[int, ...], Array] = {}

    def renew(self) -> None:
        """Forget the integration domains if they move with the body."""
        if self.moving:
            self._form = None

    def regrid(self) -> None:
        """Forget values that belong to the old lines of the grid."""
        self._form, self._penalties = None, {}

    def attach(self, entities: Entities) -> None:
        """Integrate over these ghost facets and active cells. Collective after `renew`."""
        if self._form is not None:
            return
        domains = {kind: list(rows) for kind, rows in self._fixed.items()}
        for number in self.moving:
            facets = number == GHOST_FACETS
            kind = IntegralType.interior_facet if facets else IntegralType.cell
            domains.setdefault(kind, []).append((number, entities[number]))
        self._entities = entities
        spaces, grid = [space.function_space for space in self._spaces], self._spaces[0].grid
        self._form = create_form(
            self._compiled, spaces, grid, domains, self.coefficients, self.constants
        )
        self._columns = [self._columns_of(modulus) for modulus in self._moduli]
        if len(spaces) == 2:
            self._matrix = fem.create_matrix(self._form)
            A, n = self._matrix, int(self._matrix.indptr[-1])
            self.rows, self.columns = np.empty(n, np.int32), np.empty(n, np.int32)
            _entries(A.indptr, A.indices, self.rows, self.columns)
            # columns behind the known nodes belong to other ranks' shares of owned rows
            nodes = spaces[1].dofmap.index_map
            self._keep = None
            if grid.comm.size > 1:
                self._keep = self.columns < nodes.size_local + nodes.num_ghosts
                self.rows, self.columns = self.rows[self._keep], self.columns[self._keep]

    def add_vector(self, out: Array) -> None:
        """Add this rank's share of the assembled vector, shape (nodes, components)."""
        values = np.zeros(out.size)
        fem.assemble_vector(values, self._form, coeffs=self._packed())
        out += values.reshape(out.shape)

    def matrix(self) -> Array:
        """This rank's share of the matrix, one block per entry of `rows` and `columns`."""
        for modulus in self._moduli:
            modulus.values = self._scaled(modulus)
        self._matrix.set_value(0.0)
        fem.assemble_matrix(self._matrix, self._form, coeffs=self._packed())
        shape = tuple(self._matrix.block_size)
        size = int(self._matrix.indptr[-1])
        blocks = self._matrix.data[: size * shape[0] * shape[1]].reshape(-1, *shape)
        return blocks if self._keep is None else blocks[self._keep]

    def _columns_of(self, modulus: FacetModulus) -> dict[Any, npt.NDArray[np.intp]]:
        """Columns of a modulus in the packed coefficients of a facet, by kind and id of integrals.

        DOLFINx packs two rows per facet, and kernels read them as one row: the values of each
        coefficient on both sides, coefficient by coefficient.
        """
        packed = []
        for value in (1.0, 0.0):
            modulus.x.array[:] = value
            packed.append(cpp.fem.pack_coefficients(self._form._cpp_object))
        found = {}
        for key, rows in packed[0].items():
            differs = rows != packed[1][key]
            if differs.any():
                found[key] = np.flatnonzero(differs.reshape(len(rows) // 2, -1).any(axis=0))
        return found

    def _packed(self) -> Any:
        """Packed coefficients with the moduli of the facets; None for a form without moduli."""
        if not self._moduli:
            return None
        packed = cpp.fem.pack_coefficients(self._form._cpp_object)
        for modulus, columns in zip(self._moduli, self._columns):
            for key, at in columns.items():
                rows = packed[key]
                rows.reshape(len(rows) // 2, -1)[:, at] = modulus.values[:, None]
        return packed

    def _scaled(self, modulus: FacetModulus) -> Array:
        """Values of a modulus at the facets."""
        M, G = modulus.moduli.T
        if modulus.target is None:
            return modulus.plain(M, G)
        make = MeshPairs(self._spaces[0], modulus.scaling)
        assert self._entities is not None
        rows = self._entities[GHOST_FACETS].reshape(-1, 4)
        keys = [(id(modulus), *row) for row in rows.tolist()]
        for key in keys:
            self._penalties.setdefault(key, np.full(INTERVALS + 1, np.nan))
        kept = np.array([self._penalties[key] for key in keys]).reshape(-1, INTERVALS + 1)
        ratios = np.divide(G, M, out=np.zeros_like(M), where=M > 0)
        pairs = [functools.partial(make, row) for row in rows]
        values = M * by_ratio(kept, ratios, np.arange(len(rows)), pairs, modulus.target)
        self._penalties.update(zip(keys, kept))
        return values


_OnLeaves = LeafFacetBlock | LeafCellBlock
_Bilinear = _CompiledForm | FacetBlock | LeafFacetBlock | LeafCellBlock


def _on_leaves(form: ufl.Form, space: Space) -> list[_OnLeaves]:
    """Blocks of a bilinear form on a refined space: over facets, and over cells."""
    cells = [i for i in form.integrals() if i.integral_type() == "cell"]
    others = [i for i in form.integrals() if i.integral_type() != "cell"]
    blocks: list[_OnLeaves] = [LeafFacetBlock(ufl.Form(others), space)] if others else []
    return [*blocks, *([LeafCellBlock(ufl.Form(cells), space)] if cells else [])]


class GridAssembler:
    """Assembles the terms of a weak form over the grid. Collective in what it compiles.

    Args:
        terms: The terms.
        spaces: Spaces of the fields.

    Attributes:
        terms: The terms.
        empty: Whether there are none.
        moving: Subdomain ids of ghost facets and active cells in the terms.
    """

    def __init__(self, terms: GridTerms, spaces: Sequence[Space]):
        self.terms, self.empty = terms, not terms
        self._spaces = list(spaces)
        self._external = self._linear_forms(terms.external)
        # terms that are linear in the increments act only by their Jacobian
        self._internal = {} if terms.linear else self._linear_forms(terms.internal)
        # blocks by row field, column field and number
        self._jacobian: dict[tuple[int, int, int], _Bilinear] | None = None
        self._attached: Sequence[Entities] | None = None
        self.moving = set().union(*(b.moving for b in self._vectors))
        if terms.linear:
            self.moving |= set().union(*(b.moving for b in self._blocks().values()))

    @functools.cached_property
    def moduli(self) -> list[FacetModulus]:
        """Moduli of facets in the terms."""
        forms = [form for form in self.terms.internal if form is not None]
        found = {id(m): m for form in forms for m in facet_moduli(form)}
        return list(found.values())

    def _linear_forms(self, forms) -> dict[int, _CompiledForm]:
        given = {k: form for k, form in enumerate(forms) if form is not None}
        for k, form in given.items():
            if self._spaces[k].refinement is not None:
                check_on_leaves(form, self._spaces[k])
        return {k: _CompiledForm(form, [self._spaces[k]]) for k, form in given.items()}

    @property
    def _vectors(self) -> list[_CompiledForm]:
        return [*self._external.values(), *self._internal.values()]

    @property
    def has_vectors(self) -> bool:
        """Whether terms give forces, and not only constant blocks of the tangent."""
        return bool(self._external or self._internal)

    @property
    def loads(self) -> list[fem.Constant | fem.Function]:
        """DOLFINx constants and functions in the terms."""
        every = [*self._vectors, *(self._jacobian or {}).values()]
        return [c for b in every for c in (*b.constants, *b.coefficients)]

    @property
    def splines(self) -> set[tuple[int, int]]:
        """Pairs (row field, column field) whose tangent is a `FacetBlock` between splines."""
        blocks = self._blocks()
        return {(i, j) for (i, j, _), block in blocks.items() if isinstance(block, FacetBlock)}

    @property
    def facet_blocks(self) -> list[FacetBlock | LeafFacetBlock]:
        """Blocks with kept tensors of facets; empty before the first tangent."""
        kinds = FacetBlock, LeafFacetBlock
        return [b for b in (self._jacobian or {}).values() if isinstance(b, kinds)]

    def _blocks(self) -> dict[tuple[int, int, int], _Bilinear]:
        if self._jacobian is None:
            self._jacobian = {}
            for i, row in enumerate(self.terms.jacobian):
                for j, form in enumerate(row):
                    if form is None:
                        continue
                    if i == j and self._spaces[i].refinement is not None:
                        for k, block in enumerate(_on_leaves(form, self._spaces[i])):
                            self._jacobian[i, j, k] = block
                        continue
                    if i == j and uses_facet_classes(form, self._spaces[i]):
                        self._jacobian[i, j, 0] = FacetBlock(form, self._spaces[i])
                        continue
                    spaces = [self._spaces[i], self._spaces[j]]
                    for space in spaces:
                        if space.refinement is not None:
                            check_on_leaves(form, space)
                    self._jacobian[i, j, 0] = _CompiledForm(form, spaces)
        return self._jacobian

    def attach(self, fields: Sequence[ActiveField]) -> None:
        """Set the ghost facets and active cells of the fields as integration domains. Collective.

        Args:
            fields: Active fields.
        """
        if self.empty:
            return
        entities = [field.entities for field in fields]
        old = self._attached
        # a field has ghost facets only while it needs them: a mass that turns out singular does
        # from the next step on
        same = old is not None and all(
            now.keys() == before.keys()
            and all(np.array_equal(rows, before[number]) for number, rows in now.items())
            for now, before in zip(entities, old)
        )
        # every rank keeps its forms or none does: creating them is collective
        comm = self._spaces[0].grid.comm
        if not comm.allreduce(same, op=MPI.LAND):
            for block in self._vectors:
                block.renew()
            for bilinear in (self._jacobian or {}).values():
                bilinear.renew()
            self._attached = entities
        assert self._attached is not None
        for forms in (self._external, self._internal):
            for k, block in forms.items():
                block.attach(self._attached[k])

    def regrid(self) -> None:
        """Forget values that belong to the old lines of the grid."""
        self._attached = None
        for block in [*self._vectors, *(self._jacobian or {}).values()]:
            block.regrid()

    def tangent(self, fields: Sequence[ActiveField], anywhere: bool = False) -> list[Blocks]:
        """Tangent of the internal terms between the solver's nodes. Collective.

        Call `attach` for the fields before. Nonlinear terms take the increments from the DOLFINx
        functions.

        Args:
            fields: Active fields.
            anywhere: Whether blocks have ones wherever a tangent at other increments may have an
                entry. Products of sparse matrices leave out what is zero at the present ones.
        """
        made = []
        entities = self._attached or []
        for (i, j, _), block in self._blocks().items():
            if isinstance(block, _CompiledForm):
                # two fields: take the facets of the field that sees fewer cells, which is a field
                # whose points have no domains
                fewer = min((i, j), key=lambda k: fields[k].basis.averaged)
                block.attach(entities[fewer])
                T = [fields[i].to_grid, fields[j].to_grid]
            else:
                # lattices have blocks of lattices, and leaves have those of leaves
                basis: Any = fields[i].basis
                block.attach(entities[i], basis)
                T = [fields[i].C, fields[j].C]
            whole = Blocks(i, j, block.rows, block.columns, block.matrix())
            if anywhere:
                whole = replace(whole, values=np.ones_like(whole.values))
                T = [None if each is None else abs(each) for each in T]
            same = T[0] is None and T[1] is None
            made.append(whole if same else reduce_blocks(T[0], T[1], whole))
        return made

    def add_external(self, fields: Sequence[ActiveField], out: Sequence[Array]) -> None:
        """Add the forces that do not depend on the increments.

        Args:
            fields: Active fields.
            out: Nodal forces (N) of each field, shape (nodes, components).
        """
        self._add(self._external, fields, out)

    def add_internal(self, fields: Sequence[ActiveField], out: Sequence[Array]) -> None:
        """Add the forces that depend on the increments, at the values of the DOLFINx functions.

        Args:
            fields: Active fields.
            out: Nodal forces (N) of each field, shape (nodes, components).
        """
        self._add(self._internal, fields, out)

    def _add(self, forms: dict[int, _CompiledForm], fields, out: Sequence[Array]) -> None:
        for k, block in forms.items():
            V, T = self._spaces[k].function_space, fields[k].to_grid
            nodes = V.dofmap.index_map
            part = np.zeros((nodes.size_local + nodes.num_ghosts, out[k].shape[1]))
            block.add_vector(part)
            if T is not None:
                whole = np.zeros((T.shape[0], part.shape[1]))
                whole[: len(part)] = part
                part = T.T @ whole
            active = fields[k].nodes[fields[k].nodes < len(part)]
            out[k][active] += part[active]
