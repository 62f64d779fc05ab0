"""The activation of a step, as values: points, active fields, regions, unknowns, pattern."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm._platform.errors import ParameterError
from dolfinmpm.basis import LatticeBasis, LeafBasis, LinearBasis, Placement, Stencils
from dolfinmpm.basis.space import Space
from dolfinmpm.body.boundary import Boundary
from dolfinmpm.body.points import GHOST_FACETS
from dolfinmpm.cut.activecells import active_cells
from dolfinmpm.cut.cellaverages import CellAverages
from dolfinmpm.cut.cellcouplings import CellCouplings
from dolfinmpm.cut.pattern import Blocks, Pattern
from dolfinmpm.cut.stabilisations import Stabilisation
from dolfinmpm.cut.unknowns import Unknowns
from dolfinmpm.forms.pointterms import PointTerms
from dolfinmpm.grid.halo import Numbering

if TYPE_CHECKING:
    from scipy import sparse

__all__ = [
    "Activation",
    "ActiveBoundary",
    "ActiveDomain",
    "ActiveField",
    "ActiveRegion",
    "Basis",
    "Coupling",
    "Entities",
    "Field",
    "LazyPattern",
    "Prolongate",
    "Terms",
    "TermsOverBoundary",
    "movers",
    "with_constraints",
]

Basis = LatticeBasis | LinearBasis | LeafBasis
Prolongate = Callable[[Stencils, npt.NDArray[np.int32]], "sparse.spmatrix"]
Entities = dict[int, npt.NDArray[np.int32]]


class TermsOverBoundary(Protocol):
    """Terms over a boundary that does not fit the grid."""

    @property
    def boundary(self) -> Boundary:
        """The boundary."""

    @property
    def regions(self) -> Sequence[PointTerms]:
        """Parts of the boundary with separate terms."""

    def sees(self, u: Any) -> bool:
        """Whether its markers belong to the field of an increment, for fields with tags."""


class Coupling(Protocol):
    """Nodes that a term couples, in addition to the couplings by points."""

    def lists(self, unknowns: Unknowns) -> tuple[npt.NDArray, npt.NDArray]:
        """Lists of coupled nodes, numbered with the offsets of their fields."""


class Terms(Protocol):
    """Interface of a weak form for activations."""

    @property
    def regions(self) -> Sequence[PointTerms]:
        """Parts of the body with separate terms."""

    @property
    def boundaries(self) -> Sequence[TermsOverBoundary]:
        """Terms over boundaries that do not fit the grid."""

    @property
    def moving(self) -> set[int]:
        """Ids of the active facets and cells in its integrals."""

    @property
    def layers(self) -> int:
        """Layers of cells around the cells of a rank that its terms need."""

    def blocks(self, fields: Sequence[ActiveField]) -> dict[str, list[Blocks]]:
        """Blocks that are constant during a step, by their kind. Collective."""

    def couple(self, here: ActiveDomain) -> list[Coupling]:
        """Nodes that its terms couple, in addition to the couplings by points. Collective."""


@dataclass(frozen=True)
class Field:
    """A field of a problem: its space, and its stabilisation against small cuts.

    Attributes:
        space: The space.
        stabilisation: The stabilisation.
        prolongate: Function of stencils and active nodes that returns a matrix C, or None.
        second: A second stabilisation that constrains nodes, or None.
    """

    space: Space
    stabilisation: Stabilisation
    prolongate: Prolongate | None = None
    second: Stabilisation | None = None

    @functools.cached_property
    def constraining(self) -> Stabilisation | None:
        """The stabilisation that constrains nodes to others, or None."""
        return self.stabilisation if self.stabilisation.constrains_nodes else self.second

    @property
    def constrains_nodes(self) -> bool:
        """Whether a stabilisation constrains nodes to others."""
        return self.constraining is not None


def with_constraints(field: Field) -> Field:
    """A field whose nodes with little support are constrained, with any stabilisation."""
    if field.constrains_nodes or field.prolongate is not None:
        return field
    return replace(field, second=Stabilisation("aggregation"))


@dataclass(frozen=True)
class ActiveField:
    """A field on the active cells.

    Attributes:
        space: Its space.
        basis: Its basis, with the overlap of ranks for the step.
        full_stencils: Stencils on all active nodes.
        active: Nodes in the stencils of points on any rank, increasing.
        stencils: Stencils on the independent nodes.
        nodes: The independent nodes, increasing.
        C: Matrix from the independent nodes to all nodes, or None.
        to_grid: Matrix from the independent nodes to DOLFINx's Lagrange nodes, or None.
        entities: Ghost facets and active cells, by subdomain id, if terms need them.
        whole: Stencils of points and markers on all active nodes.
        of_markers: Stencils of the markers of boundaries on the independent nodes, by the number
            of the markers.
        level: Fill fraction from which the nodes of a cell are independent, or None if no
            stabilisation constrains nodes.
    """

    space: Space
    basis: Basis
    full_stencils: Stencils
    active: npt.NDArray[np.int32]
    stencils: Stencils
    nodes: npt.NDArray[np.int32]
    C: sparse.csr_matrix | None
    to_grid: sparse.csr_matrix | None
    entities: Entities
    whole: Stencils
    of_markers: Mapping[int, Stencils] = field(default_factory=dict)
    level: float | None = None

    @functools.cached_property
    def cells(self) -> npt.NDArray[np.bool_]:
        """Mask of the active local cells. Collective at its first use."""
        return active_cells(self.whole, self.basis.cells)


@dataclass(frozen=True)
class ActiveRegion:
    """A region of the body: stencils of its points, and couplings of its cell means.

    Attributes:
        stencils: Stencils in each field, in common groups.
        averages: Means over cells, or None if no law uses means.
        within: Numbering of the nodes, and active nodes, of each field.
    """

    stencils: list[Stencils]
    averages: CellAverages | None
    within: list[tuple[Numbering, npt.NDArray[np.int32]]]

    @functools.cached_property
    def couplings(self) -> list[CellCouplings] | None:
        """Nodes that the cell means couple, per field, or None. Collective at its first use.

        Only a tangent needs the couplings.

        Raises:
            ParameterError: Ranks constrain different nodes.
        """
        if self.averages is None:
            return None
        found = [
            CellCouplings(self.averages, s, numbering, nodes)
            for s, (numbering, nodes) in zip(self.stencils, self.within)
        ]
        if not all(c.complete for c in found):
            raise ParameterError(
                "the prolongation constrains nodes at a rank border differently on the two sides; "
                "make it a function of the nodes' positions alone"
            )
        return found


@dataclass(frozen=True)
class ActiveDomain:
    """Points, active fields and unknowns of a step.

    Attributes:
        where: Positions, half-lengths and volumes of the points for the stencils.
        total: Whether stencils are those at initial positions.
        fields: The fields.
        unknowns: Numbering of the unknowns.
    """

    where: Placement
    total: bool
    fields: tuple[ActiveField, ...]
    unknowns: Unknowns

    @property
    def movers(self) -> tuple[int, ...]:
        """Numbers of the fields that move points."""
        return movers([field.space for field in self.fields])


def movers(spaces: Sequence[Space]) -> tuple[int, ...]:
    """Numbers of the fields that move points: the first, or all displacements with tags."""
    if spaces[0].tags is None:
        return (0,)
    shape = (spaces[0].grid.geometry.dim,)
    own = (k for k, s in enumerate(spaces) if s.tags and s.increment.ufl_shape == shape)
    return tuple(own)


class LazyPattern:
    """The pattern of a matrix, made at its first use.

    Args:
        build: Function that makes the pattern.
    """

    def __init__(self, build: Callable[[], Pattern]):
        self._build: Callable[[], Pattern] | None = build
        self.made: Pattern | None = None

    @property
    def pattern(self) -> Pattern:
        """The pattern."""
        if self.made is None:
            assert self._build is not None
            # the function keeps the data of the pattern alive and is released too
            self.made, self._build = self._build(), None
        return self.made


@dataclass(frozen=True)
class ActiveBoundary:
    """A boundary that does not fit the grid, in a step.

    Attributes:
        seen: Positions and half-lengths of its markers for the stencils.
        rows: The active markers, increasing.
        regions: Its parts with separate terms.
    """

    seen: Placement
    rows: npt.NDArray[np.int32]
    regions: list[ActiveRegion] = field(default_factory=list)


@dataclass(frozen=True)
class Activation(ActiveDomain):
    """The active part of a problem in a step.

    Attributes:
        terms: The weak form of the problem.
        prescribed: Values of prescribed components, (nodes, components) for each field.
        driven: Whether a prescribed value is not zero.
        regions: The regions of the body.
        boundaries: Boundaries that do not fit the grid, by the number of their markers.
        blocks: Blocks that are constant during the step, between the independent nodes, by kind:
            "stiffness" of terms over the grid, "penalty" of weak aggregation, "soft" terms of
            the tangent only, "mass" (kg), and "changes", penalties on the change of velocity in
            the step, as terms of the increments.
        couplings: Couplings by terms, in addition to the couplings by points.
        lazy: The pattern, made at its first use.
    """

    terms: Terms
    prescribed: list[npt.NDArray[np.float64]]
    driven: bool
    regions: list[ActiveRegion]
    boundaries: dict[int, ActiveBoundary]
    blocks: Mapping[str, list[Blocks]]
    couplings: list[Any]
    lazy: LazyPattern

    def blocks_of(self, kind: str, field: int | None = None) -> list[Blocks]:
        """Blocks of a kind, of all fields or of one field alone."""
        found = self.blocks.get(kind, [])
        return [b for b in found if field is None or b.row_field == b.column_field == field]

    @property
    def pattern(self) -> Pattern:
        """The sparsity pattern of the matrix on this rank; explicit steps do not need it."""
        return self.lazy.pattern

    @property
    def active_cells(self) -> int:
        """Number of cells that are active for the first field, on all ranks. Collective."""
        first = self.fields[0]
        own = int(first.cells[: first.basis.cells.owned].sum())
        return self.unknowns.comm.allreduce(own, op=MPI.SUM)

    @property
    def ghost_facets(self) -> int:
        """Number of ghost facets on all ranks, 0 if no term needs them. Collective."""
        rows = self.fields[0].entities.get(GHOST_FACETS, np.empty(0, np.int32))
        return self.unknowns.comm.allreduce(rows.size // 4, op=MPI.SUM)
