"""Function spaces of the step's increments: a DOLFINx space, and the basis that points see."""

from __future__ import annotations

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.mesh import Mesh

from dolfinmpm._compat import geometry_degree
from dolfinmpm.basis import LatticeBasis, LinearBasis
from dolfinmpm.errors import ParameterError, UnsupportedGridError
from dolfinmpm.grid import lattice_of, once_per_grid, require_lattice

__all__ = ["Space"]

Basis = LatticeBasis | LinearBasis
_BASES = ("linear", "gimp")


@once_per_grid
def basis_of(grid: Mesh, name: str) -> Basis:
    """The basis of that name on the grid, one for all fields that use it. Collective."""
    scalar = fem.functionspace(grid, ("Lagrange", 1))
    node_map = scalar.dofmap.index_map
    gimp = name == "gimp"
    lattice = require_lattice(grid, 'basis="gimp"') if gimp else lattice_of(grid)
    if lattice is None:
        return LinearBasis(grid, node_map, scalar.dofmap.list)
    x = scalar.tabulate_dof_coordinates()[:, : grid.geometry.dim]
    return LatticeBasis(grid, lattice, gimp, node_map, x)


class Space:
    """A field on the background grid: the increment that a step solves for, and its test function.

    Args:
        grid: Background grid.
        basis: "linear" (standard material point method, any grid) or "gimp"
            (generalised interpolation, rectangular grids).
        shape: Shape of the field's value; a vector of the dimension of space by
            default, () for a scalar such as a pore pressure.

    Attributes:
        increment: The step's increment, a function for UFL.
        test: The test function.
        function_space: The DOLFINx space that both live in.

    Raises:
        ParameterError: The basis is not known.
        UnsupportedGridError: The basis cannot be built on this grid.
    """

    def __init__(self, grid: Mesh, basis: str = "linear", shape: tuple[int, ...] | None = None):
        if basis not in _BASES:
            known = ", ".join(f'"{name}"' for name in _BASES)
            raise ParameterError(f"basis = {basis!r} must be one of {known}")
        if geometry_degree(grid) != 1 or grid.topology.dim != grid.geometry.dim:
            raise UnsupportedGridError(
                f"basis={basis!r} needs straight-sided cells of the dimension of space, got degree "
                f"{geometry_degree(grid)}, dimension {grid.topology.dim} in {grid.geometry.dim}D"
            )
        self.grid = grid
        self.basis = basis_of(grid, basis)
        gdim = grid.geometry.dim
        shape = (gdim,) if shape is None else tuple(shape)
        element = ("Lagrange", 1, shape) if shape else ("Lagrange", 1)
        self.function_space = fem.functionspace(grid, element)
        self.components = int(np.prod(shape, dtype=int))
        self.increment = fem.Function(self.function_space, name="increment")
        self.increment._dolfinmpm_space = self
        self.test = ufl.TestFunction(self.function_space)
        # points, DOLFINx's assemblers and the solver share one numbering of the nodes
        nodes = self.function_space.dofmap.index_map
        numbered_alike = nodes.size_local == self.basis.nodes.owned and np.array_equal(
            self.function_space.dofmap.list, fem.functionspace(grid, ("Lagrange", 1)).dofmap.list
        )
        if not numbered_alike:
            raise UnsupportedGridError("DOLFINx numbers scalar and vector nodes differently here")
