"""Terms over the active cells of a refined space: DOLFINx assembles them on the leaves.

The leaves of this rank are the cells of a mesh of their own, without common vertices. A form that
FFCx has compiled for the grid goes over the leaves as it is. Hanging nodes join them afterwards.
"""

from __future__ import annotations

from typing import Any, ClassVar

import basix.ufl
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem, mesh
from dolfinx.fem import IntegralType
from mpi4py import MPI

from dolfinmpm._platform.compat import compile_form, create_form
from dolfinmpm._platform.errors import UnsupportedGridError
from dolfinmpm.assembly.leaffacetblock import only_over
from dolfinmpm.basis import LeafBasis
from dolfinmpm.basis.space import Space
from dolfinmpm.body.points import ACTIVE_CELLS

__all__ = ["LeafCellBlock"]

Array = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int32]


class LeafCellBlock:
    """A bilinear form over the active cells of a refined space. Collective.

    Args:
        form: The form.
        space: Space of both arguments, refined.

    Attributes:
        constants: Constants of the form.
        rows, columns: Nodes of the entries of `matrix`.

    Raises:
        UnsupportedGridError: The form is no form over active cells alone, or has coefficients.
    """

    # subdomain ids of the cells in the form
    moving: ClassVar[set[int]] = {ACTIVE_CELLS}

    def __init__(self, form: ufl.Form, space: Space):
        if space.basis.degree > 1:
            raise UnsupportedGridError(
                "a form over active cells (points.dC) does not know splines on leaves: leave the "
                'form, such as soft stiffness, out, or take basis="gimp"'
            )
        if not only_over(form, "cell", ACTIVE_CELLS) or form.coefficients():
            raise UnsupportedGridError(
                "a form over cells of a refined space must be over active cells (points.dC) alone, "
                "and have no coefficients: give constants, or leave refine out"
            )
        self._space, self.constants = space, form.constants()
        self._compiled = compile_form(space.grid.comm, form)
        self.coefficients: list[fem.Function] = []
        self.rows = self.columns = np.empty(0, np.int32)
        self._form: Any = None
        self._basis: LeafBasis | None = None

    def renew(self) -> None:
        """Forget the cells of the integration."""
        self._basis = None

    def regrid(self) -> None:
        """Forget the cells of the integration."""
        self._basis = None

    def attach(self, entities: dict[int, Ints], basis: LeafBasis) -> None:
        """Set the cells of the integration.

        Args:
            entities: Under the key ACTIVE_CELLS, this rank's active leaves.
            basis: Basis on the leaves.
        """
        if basis is self._basis:
            return
        self._basis, cells = basis, entities[ACTIVE_CELLS]
        self._form, self.rows, self.columns = None, np.empty(0, np.int32), np.empty(0, np.int32)
        if not cells.size:
            return
        low, high = basis.cell_corners()
        d = low.shape[1]
        # corners in the order of DOLFINx, the first direction fastest
        corner = np.array(list(np.ndindex(*(2,) * d)))[:, ::-1]
        x = np.where(corner[None], high[cells][:, None], low[cells][:, None])
        nodes = basis.corner_nodes[cells][:, corner @ (2 ** np.arange(d)[::-1])]
        element = basix.ufl.element(
            "Lagrange", self._space.grid.topology.cell_name(), 1, shape=(d,)
        )
        leaves = mesh.create_mesh(
            MPI.COMM_SELF,
            cells=np.arange(nodes.size, dtype=np.int64).reshape(nodes.shape),
            x=x.reshape(-1, d),
            e=element,
        )
        V = fem.functionspace(leaves, self._space.function_space.ufl_element())
        node_of = np.empty(nodes.size, np.int32)
        node_of[V.dofmap.list] = nodes[leaves.topology.original_cell_index]
        every = np.arange(len(cells), dtype=np.int32)
        self._form = create_form(
            self._compiled, [V, V], leaves, {IntegralType.cell: [(ACTIVE_CELLS, every)]}, [],
            self.constants,
        )  # fmt: skip
        self._matrix = fem.create_matrix(self._form)
        row_of = np.repeat(np.arange(len(node_of)), np.diff(self._matrix.indptr))
        pairs = node_of[row_of].astype(np.int64) * basis.nodes.size + node_of[self._matrix.indices]
        keys, self._entry = np.unique(pairs, return_inverse=True)
        rows, columns = np.divmod(keys, basis.nodes.size)
        self.rows, self.columns = rows.astype(np.int32), columns.astype(np.int32)

    def matrix(self) -> Array:
        """This rank's share of the matrix, one block per entry of `rows` and `columns`."""
        c = self._space.components
        sums = np.zeros((self.rows.size, c, c))
        if self._form is not None:
            self._matrix.set_value(np.float64(0.0))
            fem.assemble_matrix(self._matrix, self._form)
            np.add.at(sums, self._entry, self._matrix.data.reshape(-1, c, c)[: self._entry.size])
        return sums
