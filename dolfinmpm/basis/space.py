"""Function spaces of the step's increments: a DOLFINx space, and the basis at the points."""

from __future__ import annotations

import weakref
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from dolfinx.mesh import Mesh

from dolfinmpm._platform.argumentchecks import as_tags, choice, refuse_idle, shown, truth, whole
from dolfinmpm._platform.collective import collective
from dolfinmpm._platform.compat import geometry_degree
from dolfinmpm._platform.errors import ParameterError, UnsupportedGridError
from dolfinmpm._platform.uncopied import Settled
from dolfinmpm.basis import LatticeBasis, LinearBasis
from dolfinmpm.basis.bspline import functions_of
from dolfinmpm.basis.latticebasis import first_parts
from dolfinmpm.basis.leafbasis import LeafBasis
from dolfinmpm.basis.refinement import Refinement, refinement_of
from dolfinmpm.grid.cellkinds import check_cells
from dolfinmpm.grid.lattice import (
    Lattice,
    cell_edges,
    cell_size,
    coarse_cell_size,
    lattice_of,
    leaf_size,
    once_per_grid,
    require_lattice,
    smallest_height,
)
from dolfinmpm.grid.serialnumbers import next_number

if TYPE_CHECKING:
    from scipy import sparse

__all__ = ["Space", "extraction", "lattice_basis", "splines_at"]

Basis = LatticeBasis | LinearBasis
_DEGREES = {"linear": 1, "gimp": 1, "bspline2": 2, "bspline3": 3}


@once_per_grid
def _basis_of(grid: Mesh, name: str, averaged: bool, coarsen: int) -> tuple[Basis, Any]:
    """The basis with this name, shared by all fields on the grid that use it, and the scalar space.

    The space is DOLFINx's of the same degree. Collective.
    """
    degree = _DEGREES[name]
    scalar = fem.functionspace(grid, ("Lagrange", degree))
    if name != "linear":
        require_lattice(grid, f'basis="{name}"')
    if coarsen > 1:
        _check_multiples(require_lattice(grid, f"coarsen={coarsen}"), coarsen)
    node_map, x = scalar.dofmap.index_map, scalar.tabulate_dof_coordinates()
    lattice = lattice_of(grid)
    if lattice is None:
        return LinearBasis(grid, node_map, scalar.dofmap.list, x), scalar
    if degree > 1 or coarsen > 1:
        return lattice_basis(grid, degree, averaged, coarsen), scalar
    ijk = lattice.index(x[:, : grid.geometry.dim])
    return LatticeBasis(grid, lattice, degree, averaged, node_map, ijk), scalar


def _check_multiples(lattice: Lattice, coarsen: int) -> None:
    if any(n % coarsen for n in lattice.shape):
        cells = " × ".join(map(str, lattice.shape))
        raise UnsupportedGridError(
            f"coarsen = {coarsen} joins {coarsen} cells per direction to one, and the grid has "
            f"{cells} cells: make the grid with multiples of {coarsen}"
        )


def lattice_basis(grid: Mesh, degree: int, averaged: bool, coarsen: int) -> LatticeBasis:
    """A basis on the grid's lattice, or on a coarsened one, with its own numbering. Collective.

    Args:
        grid: Background grid, rectangular.
        degree: Degree of the functions.
        averaged: Whether functions are averaged over the points' domains.
        coarsen: Number of cells of the grid per cell of the basis and direction.
    """
    fine = lattice_of(grid)
    assert fine is not None
    lattice = fine.coarsened(coarsen)
    own = fine.cell_ijk[: grid.topology.index_map(grid.topology.dim).size_local]
    own = own if coarsen == 1 else first_parts(own, coarsen)
    node_map, ijk = functions_of(grid.comm, own, lattice.shape, degree)
    return LatticeBasis(grid, lattice, degree, averaged, node_map, ijk, coarsen)


def splines_at(
    basis: LatticeBasis, x: npt.NDArray[np.float64], cells: npt.NDArray[np.int32]
) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.float64]]:
    """Values of the functions of a given cell at each position.

    Args:
        basis: Splines, or linear functions of a coarser lattice. For a coarser lattice the cell is
            the coarse cell that contains the given cell.
        x: Positions (m), shape (n, gdim). A position may be on the edge of its cell.
        cells: Local cells of the positions, shape (n,).

    Returns:
        Nodes and values (-), both of shape (n, functions per cell).
    """
    low = np.ascontiguousarray(basis.lattice.cell_ijk[cells] - basis.halo.origin, np.int32)
    s = basis.stencils_in(x, np.zeros_like(x), low, np.ones_like(low))
    assert s is not None
    each = (basis.degree + 1) ** x.shape[1]
    nodes, N = np.empty((len(x), each), np.int32), np.empty((len(x), each))
    nodes[s.order] = np.repeat(s.nodes.reshape(-1, each), np.diff(s.groups), axis=0)
    N[s.order] = s.N.reshape(-1, each)
    return nodes, N


def extraction(space: Space, basis: Basis | LeafBasis) -> sparse.csr_matrix | None:
    """Extraction matrix E of the basis: u_Lagrange = E u_basis at the nodes of the Lagrange space.

    In every cell of the grid, a spline is a polynomial of the space's degree, and E is exact. The
    same holds for functions of coarser cells. UFL terms over cells and facets act through E.

    Args:
        space: The space.
        basis: The basis of the space, with any number of layers of overlap.

    Returns:
        E, shape (Lagrange nodes, nodes of the basis) in local numberings, or None where
        the nodes are the same.
    """
    if isinstance(basis, LinearBasis):
        return None
    if (
        isinstance(basis, LatticeBasis)
        and basis.degree == 1
        and basis.coarsen == 1
        and basis.partition is None
    ):
        return None
    kept = space.__dict__.setdefault("_extractions", weakref.WeakKeyDictionary())
    if basis not in kept:
        if isinstance(basis, LeafBasis):
            kept[basis] = _from_leaves(space, basis)
        else:
            kept[basis] = _extract(space, basis)
    return kept[basis]


def _from_leaves(space: Space, basis: LeafBasis) -> sparse.csr_matrix:
    """Values at the nodes of the grid's Lagrange functions, 0 without a leaf."""
    from scipy import sparse

    base = space.basis
    assert isinstance(base, LatticeBasis)
    if basis.degree > 1:
        x = space.function_space.tabulate_dof_coordinates()[:, : space.grid.geometry.dim]
        rows, N = basis.values_at(np.ascontiguousarray(x))
        whole = sparse.csr_matrix((np.ones(rows.size), (rows, np.arange(rows.size))),
                                  shape=(len(x), rows.size))  # fmt: skip
        return sparse.csr_matrix(whole @ N)
    levels = basis.leaves.tree.levels
    shape = tuple((np.array(basis.lattice.shape, np.int64) << levels) + 1)
    keys = np.ravel_multi_index(tuple(basis.fine.T), shape)
    wanted = np.ravel_multi_index(tuple(base.halo.node_ijk.T.astype(np.int64) << levels), shape)
    _, rows, columns = np.intersect1d(wanted, keys, assume_unique=True, return_indices=True)
    size = wanted.size, basis.nodes.size
    return sparse.csr_matrix((np.ones(rows.size), (rows, columns)), shape=size)


def _extract(space: Space, basis: LatticeBasis) -> sparse.csr_matrix:
    from scipy import sparse

    if basis.degree == 1 and basis.coarsen == 1:
        columns = basis.grid_nodes
        assert columns is not None
        shape = columns.size, basis.nodes.size
        return sparse.csr_matrix((np.ones(columns.size), columns, np.arange(shape[0] + 1)), shape)
    V = space.function_space
    x = np.ascontiguousarray(V.tabulate_dof_coordinates()[:, : space.grid.geometry.dim])
    cells = V.dofmap.list
    # splines are continuous: any cell that contains the node gives the same values
    cell_of = np.zeros(len(x), np.int32)
    cell_of[cells.ravel()] = np.repeat(np.arange(len(cells), dtype=np.int32), cells.shape[1])
    nodes, N = splines_at(basis, x, cell_of)
    rows = np.repeat(np.arange(len(x)), nodes.shape[1])
    return sparse.csr_matrix((N.ravel(), (rows, nodes.ravel())), shape=(len(x), basis.nodes.size))


def _check_grid(grid: Any) -> None:
    if not isinstance(grid, Mesh):
        advice = "give the mesh, such as dolfinx.mesh.create_rectangle makes"
        if isinstance(grid, tuple) or hasattr(grid, "mesh") or hasattr(grid, "grid"):
            advice = "give the mesh of it"
        raise ParameterError(f"grid = {shown(grid)} must be a dolfinx.mesh.Mesh: {advice}")
    check_cells(grid)
    if grid.geometry.x.dtype != np.float64:
        raise UnsupportedGridError(
            f"the grid's coordinates are {grid.geometry.x.dtype} and must be float64; create the "
            "mesh with dtype=np.float64"
        )


def _shape(shape: Any, gdim: int) -> tuple[int, ...]:
    """The shape of a field's value; by default the field is a vector in space."""
    if shape is None:
        return (gdim,)
    if not isinstance(shape, (tuple, list)):
        raise ParameterError(
            f"shape = {shown(shape)} must be a tuple: () for a scalar, ({gdim},) for a vector"
        )
    return tuple(whole(f"shape[{k}]", size, 1) for k, size in enumerate(shape))


class Space(Settled):
    """A field on the background grid: the increment that a step solves for, and its test function.

    Args:
        grid: Background grid.
        basis: "linear" (standard material point method, any grid), "gimp"
            (linear functions averaged over the points' domains), "bspline2" or
            "bspline3" (quadratic or cubic B-splines); all but the first need a
            rectangular grid.
        shape: Shape of the field's value; a vector of the dimension of space by
            default, () for a scalar such as a pore pressure.
        averaged: Whether B-splines are averaged over the points' domains, as GIMP
            averages linear functions. Domains tile the body. The stiffness of a body under
            constant stress is then integrated exactly, wherever the points lie.
            False evaluates B-splines at the points (Steffen, Kirby & Berzins
            2008, doi 10.1002/nme.2360).
        configuration: "updated" or "total". "updated" takes stencils and gradients at the
            positions of the points at the start of every step. "total" takes them at the first
            positions of the points, so that no point crosses a cell as long as the body does not
            separate (Coombs, Petit & Ghaffari Motlagh 2020, doi 10.1016/j.cma.2019.112622).
        coarsen: Number of cells of the grid per cell of this field and direction. With 2, the
            field has the functions of a grid with cells of twice the size. The coarse functions
            are exact sums of finer ones. A pressure and a displacement on such nested grids are a
            stable pair. Ghost facets, fill fractions and roots are those of the coarse cells.
            Needs a rectangular grid, graded or not.
        domains: Growth of the points' domains if the basis averages. With linear functions,
            corners of "volume" and "fixed" domains touch rigid bodies. "stretch" stretches them by
            diag U with U = √(FᵀF), so that they go on to tile a stretched body. "volume"
            stretches them by J^(1/d). "fixed" keeps them. The last two are for flow: there F
            grows without bound and no longer tells the shape of a point's volume.
        tag: Tags of the points of the field, one or several; None means all points. A field with
            tags exists only where its points are. It has its own active cells, ghost facets and
            constraints. Several displacement fields that divide the points by tags each move
            their own points: bodies with separate velocities on one grid.
        refine: Sizes of cells wanted (m), for cells that are halved where smaller ones are wanted:
            a function of positions, shape (gdim, n), that returns n sizes; `near(body, size)`;
            `where_it_yields(points, size)`; or a list of these, of which the least size counts, of
            all ranks. The grid itself stays. Its cells are the roots of
            trees, whose leaves are the cells of the field. Splines are then truncated hierarchical
            B-splines. Needs a rectangular grid. Points should follow: see `Problem.adapt`.
        levels: Largest number of times that a cell of the grid is halved, 0 to 10. With 0 the
            cells are those of the grid.
        per_cell: Points per leaf and direction that points follow: they split where leaves are
            finer, and merge where leaves are larger again. None leaves the points as they are.
            Counts with `refine` only.

    Attributes:
        increment: The step's increment, a function for UFL.
        test: The test function.
        function_space: The DOLFINx space of increment and test function: Lagrange functions of
            the basis's degree.
        coarsen: Number of cells of the grid per cell of this field and direction.
        tags: Tags of the points of the field, or None for all points.
        refinement: Sizes wanted and leaves, or None without `refine`.

    Raises:
        ParameterError: The grid, the basis, the shape or a tag is not valid.
        UnsupportedGridError: The basis cannot be built on this grid, or the grid's numbers of
            cells are no multiples of `coarsen`.

    >>> from dolfinx.mesh import CellType, create_unit_square
    >>> from mpi4py import MPI
    >>> grid = create_unit_square(MPI.COMM_WORLD, 4, 4, CellType.quadrilateral)
    >>> Space(grid, "bspline2").increment.ufl_shape
    (2,)
    >>> Space(grid, "linear", shape=()).increment.ufl_shape
    ()
    """

    @collective
    def __init__(
        self,
        grid: Mesh,
        basis: str = "linear",
        *,
        shape: tuple[int, ...] | None = None,
        averaged: bool = True,
        configuration: str = "updated",
        domains: str = "stretch",
        coarsen: int = 1,
        tag: int | tuple[int, ...] | None = None,
        refine: Any = None,
        levels: int | None = None,
        per_cell: int | None = 2,
    ):
        basis = choice("basis", basis, _DEGREES)
        _check_grid(grid)
        shape = _shape(shape, grid.geometry.dim)
        averaged = truth("averaged", averaged)
        self.domains = choice("domains", domains, ("stretch", "volume", "fixed"))
        self.configuration = choice("configuration", configuration, ("updated", "total"))
        if basis == "gimp" and not averaged:
            raise ParameterError(
                'basis="gimp" averages over domains; use basis="linear" for averaged=False'
            )
        if geometry_degree(grid) != 1 or grid.topology.dim != grid.geometry.dim:
            raise UnsupportedGridError(
                f"basis={basis!r} needs straight-sided cells of the dimension of space, got degree "
                f"{geometry_degree(grid)}, dimension {grid.topology.dim} in {grid.geometry.dim}D"
            )
        self.grid = grid
        self.coarsen = whole("coarsen", coarsen, 1)
        self.tags = as_tags(tag)
        self.per_cell = None if per_cell is None else whole("per_cell", per_cell, 1)
        self.refinement = None
        if refine is not None or levels is not None:
            self.refinement = self._refined(refine, levels)
        elif per_cell is not None:
            refuse_idle("per_cell", per_cell, 2, "it is of leaves: give refine= and levels=")
        self.basis: Basis
        self.basis, scalar = _basis_of(grid, basis, averaged and basis != "linear", self.coarsen)
        element = (
            ("Lagrange", self.basis.degree, shape) if shape else ("Lagrange", self.basis.degree)
        )
        self.function_space = fem.functionspace(grid, element)
        self.components = int(np.prod(shape, dtype=int))
        self.increment = fem.Function(self.function_space, name="increment")
        self.increment._dolfinmpm_space = self
        self.test = ufl.TestFunction(self.function_space)
        self.number = next_number(grid, "spaces")
        # points, DOLFINx's assemblers and the solver share one numbering of the nodes
        if not np.array_equal(self.function_space.dofmap.list, scalar.dofmap.list):
            raise UnsupportedGridError("DOLFINx numbers scalar and vector nodes differently here")

    def _refined(self, refine: Any, levels: Any) -> Refinement | None:
        """The refinement, checked."""
        if refine is None or levels is None:
            raise ParameterError(
                f"refine = {shown(refine)} and levels = {shown(levels)} go together: the sizes "
                "wanted (m), and how often a cell of the grid may be halved"
            )
        if self.coarsen > 1 or self.configuration == "total":
            raise ParameterError(
                f'refine needs coarsen=1 and configuration="updated", got coarsen={self.coarsen}, '
                f"configuration={self.configuration!r}; leave refine and levels out, or take these"
            )
        return refinement_of(self.grid, refine, levels)

    @property
    @collective
    def finest_cell(self) -> float:
        """Least height of a cell, or of the leaves that refinement can make (m). Collective."""
        depth = 0 if self.refinement is None else self.refinement.depth
        return smallest_height(self.grid) / 2**depth

    @property
    def cell_size(self) -> fem.Constant | fem.Function:
        """Size of this field's cells for UFL (m), see `dolfinmpm.cell_size`. Collective.

        In a refined space it has the sizes of leaves in terms over ghost facets only. In sums over
        points it has the sizes of the grid's own cells.
        """
        if self.refinement is not None:
            return leaf_size(self.grid)
        if self.coarsen == 1:
            return cell_size(self.grid)
        return coarse_cell_size(self.grid, self.coarsen)

    @property
    def cell_edges(self) -> fem.Function | None:
        """Lengths of the edges of this field's cells for UFL (m). Collective.

        None if all cells are equal squares or cubes, or no boxes; see `cell_size`. In a refined
        space, terms over ghost facets replace them by the lengths of the smaller leaf.
        """
        return cell_edges(self.grid, self.coarsen)
