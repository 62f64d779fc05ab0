"""What takes part in a step, as values: points, fields, parts of the body, unknowns, pattern."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm._platform.errors import ParameterError
from dolfinmpm.basis import LatticeBasis, LinearBasis, Placement, Stencils
from dolfinmpm.basis.space import Space
from dolfinmpm.body.boundary import Boundary
from dolfinmpm.body.points import GHOST_FACETS
from dolfinmpm.cut.active import active_cells
from dolfinmpm.cut.cellmeans import CellCouplings, CellMeans
from dolfinmpm.cut.pattern import Blocks, Pattern
from dolfinmpm.cut.stabilisations import Stabilisation
from dolfinmpm.cut.unknowns import Unknowns
from dolfinmpm.grid.halo import Numbering

if TYPE_CHECKING:
    from scipy import sparse

__all__ = [
    "Activation",
    "ActiveBoundary",
    "ActiveField",
    "ActiveRegion",
    "Basis",
    "BoundaryOf",
    "Coupling",
    "Entities",
    "Field",
    "Later",
    "Participants",
    "Prolongate",
    "RegionTerms",
    "Terms",
    "movers",
    "with_ties",
]

Basis = LatticeBasis | LinearBasis
Prolongate = Callable[[Stencils, npt.NDArray[np.int32]], "sparse.spmatrix"]
Entities = dict[int, npt.NDArray[np.int32]]


class RegionTerms(Protocol):
    """Points that are treated alike by a form."""

    @property
    def averages(self) -> bool:
        """Whether a law takes means over cells."""

    @property
    def by_centres(self) -> bool:
        """Whether the means count each point in the cell of its centre alone."""

    @property
    def tags(self) -> frozenset[int] | None:
        """Tags of its points, or None for all, or for all but some."""

    def chosen(self, tags: npt.NDArray[np.int32]) -> npt.NDArray[np.bool_] | None:
        """Which points belong to it, or None if all do."""


class BoundaryOf(Protocol):
    """Terms over a boundary that does not fit the grid."""

    @property
    def boundary(self) -> Boundary:
        """The boundary."""

    @property
    def regions(self) -> Sequence[RegionTerms]:
        """Parts of it with terms of their own."""

    def sees(self, u: Any) -> bool:
        """Whether its markers are of the field of an increment, of those that have tags."""


class Coupling(Protocol):
    """Nodes that a term couples beside those that the points couple."""

    def lists(self, unknowns: Unknowns) -> tuple[npt.NDArray, npt.NDArray]:
        """Lists of coupled nodes, numbered with the offsets of their fields."""


class Terms(Protocol):
    """What an activation must know of a weak form."""

    @property
    def regions(self) -> Sequence[RegionTerms]:
        """Parts of the body with terms of their own."""

    @property
    def boundaries(self) -> Sequence[BoundaryOf]:
        """Boundaries that do not fit the grid, with the parts that have terms of their own."""

    @property
    def moving(self) -> set[int]:
        """Ids of the facets and cells that it integrates over as they are active."""

    @property
    def layers(self) -> int:
        """Layers of cells around the cells of a rank that its terms look at, at least."""

    def blocks(self, fields: Sequence[ActiveField]) -> dict[str, list[Blocks]]:
        """Blocks that are the same for a whole step, by their kind. Collective."""

    def couple(self, here: Participants) -> list[Coupling]:
        """Which nodes its terms couple beside those that the points couple. Collective."""


@dataclass(frozen=True)
class Field:
    """A field of a problem: its space, and what is done against its small cuts.

    Attributes:
        space: The space.
        stabilisation: The stabilisation.
        prolongate: Function of stencils and active nodes that returns a matrix C, or None.
        beside: What ties nodes beside a stabilisation that ties none, or None.
    """

    space: Space
    stabilisation: Stabilisation
    prolongate: Prolongate | None = None
    beside: Stabilisation | None = None

    @functools.cached_property
    def tying(self) -> Stabilisation | None:
        """What ties nodes to others, or None."""
        return self.stabilisation if self.stabilisation.ties_nodes else self.beside

    @property
    def ties_nodes(self) -> bool:
        """Whether nodes are tied to others."""
        return self.tying is not None


def with_ties(field: Field) -> Field:
    """A field whose hardly supported nodes are tied, whatever its stabilisation."""
    if field.ties_nodes or field.prolongate is not None:
        return field
    return replace(field, beside=Stabilisation("aggregation"))


@dataclass(frozen=True)
class ActiveField:
    """A field on the active cells.

    Attributes:
        space: Its space.
        basis: Its basis, with the overlap of ranks that the step needs.
        seen: Stencils on all active nodes.
        active: Nodes that any rank's points see, increasing.
        stencils: Stencils on the nodes that remain behind C.
        nodes: These nodes, increasing.
        C: Matrix from the nodes that remain to all nodes, or None.
        to_grid: Matrix from the nodes that remain to DOLFINx's Lagrange nodes, or None.
        entities: Ghost facets and active cells, by subdomain id, as far as terms need them.
        whole: Stencils of points and markers on all active nodes.
        of_markers: Stencils of the markers of boundaries on the nodes that remain behind C, by
            the number of the markers.
        level: Share to which a cell must be filled to have no nodes tied to others, or None if
            no stabilisation ties any.
    """

    space: Space
    basis: Basis
    seen: Stencils
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
        """Whether each local cell is active. Collective at first."""
        return active_cells(self.whole, self.basis.cells)


@dataclass(frozen=True)
class ActiveRegion:
    """A part of the body: stencils of its points, and couplings of its cell means.

    Attributes:
        stencils: Stencils in every field, in common groups.
        means: Means over cells, or None if no law takes any.
        within: Numbering of the nodes and active nodes of every field.
    """

    stencils: list[Stencils]
    means: CellMeans | None
    within: list[tuple[Numbering, npt.NDArray[np.int32]]]

    @functools.cached_property
    def couplings(self) -> list[CellCouplings] | None:
        """What cell means couple, in every field, or None if there are none. Collective at first.

        Only a tangent asks.

        Raises:
            ParameterError: Ranks differ in what they tie.
        """
        if self.means is None:
            return None
        found = [
            CellCouplings(self.means, s, numbering, nodes)
            for s, (numbering, nodes) in zip(self.stencils, self.within)
        ]
        if not all(c.complete for c in found):
            raise ParameterError(
                "a prolongation ties nodes at a rank border differently on the two sides; make it "
                "a function of the nodes' positions alone"
            )
        return found


@dataclass(frozen=True)
class Participants:
    """Points, fields and unknowns that take part in a step.

    Attributes:
        where: The points as the stencils see them.
        total: Whether stencils are those at first positions.
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
    """Numbers of the fields that move points: the first, or all displacements that have tags."""
    if spaces[0].tags is None:
        return (0,)
    shape = (spaces[0].grid.geometry.dim,)
    own = (k for k, s in enumerate(spaces) if s.tags and s.increment.ufl_shape == shape)
    return tuple(own)


class Later:
    """The pattern of a matrix, made when it is first asked for.

    Args:
        build: What makes it.
    """

    def __init__(self, build: Callable[[], Pattern]):
        self._build: Callable[[], Pattern] | None = build
        self.known: Pattern | None = None

    @property
    def pattern(self) -> Pattern:
        """The pattern."""
        if self.known is None:
            assert self._build is not None
            # with it goes what it is made of
            self.known, self._build = self._build(), None
        return self.known


@dataclass(frozen=True)
class ActiveBoundary:
    """A boundary that does not fit the grid, in a step.

    Attributes:
        seen: Its markers as the stencils see them.
        rows: Which markers take part, increasing.
        regions: Its parts that have terms of their own.
    """

    seen: Placement
    rows: npt.NDArray[np.int32]
    regions: list[ActiveRegion] = field(default_factory=list)


@dataclass(frozen=True)
class Activation(Participants):
    """What takes part in a step.

    Attributes:
        terms: The weak form that it is made for.
        prescribed: Values of prescribed components, (nodes, components) for each field.
        driven: Whether any of them is not zero.
        regions: The parts of the body.
        boundaries: Boundaries that do not fit the grid, by the number of their markers.
        blocks: What is the same for the whole step between the nodes that remain behind C, by
            kind: "stiffness" of terms over the grid, "penalty" of weak aggregation, "soft" terms
            of the tangent only, "mass" (kg), and "changes", penalties on what a step changes of
            the velocity, as terms of the increments.
        couplings: What terms couple beside the points.
        later: What is made when it is first asked for.
    """

    terms: Terms
    prescribed: list[npt.NDArray[np.float64]]
    driven: bool
    regions: list[ActiveRegion]
    boundaries: dict[int, ActiveBoundary]
    blocks: Mapping[str, list[Blocks]]
    couplings: list[Any]
    later: Later

    def blocks_of(self, kind: str, field: int | None = None) -> list[Blocks]:
        """Blocks of a kind, of all fields or between the nodes of one."""
        found = self.blocks.get(kind, [])
        return [b for b in found if field is None or b.row_field == b.column_field == field]

    @property
    def pattern(self) -> Pattern:
        """Where the matrix has entries, on this rank; explicit steps never ask."""
        return self.later.pattern

    @property
    def active_cells(self) -> int:
        """Number of cells that are active for the first field, on all ranks. Collective."""
        first = self.fields[0]
        own = int(first.cells[: first.basis.cells.owned].sum())
        return self.unknowns.comm.allreduce(own, op=MPI.SUM)

    @property
    def ghost_facets(self) -> int:
        """Number of ghost facets on all ranks that own them, 0 if no term asks. Collective."""
        rows = self.fields[0].entities.get(GHOST_FACETS, np.empty(0, np.int32))
        return self.unknowns.comm.allreduce(rows.size // 4, op=MPI.SUM)
