"""Terms over a boundary that does not fit the grid. The terms own the boundary's markers."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm._platform.compat import geometry_dofmap
from dolfinmpm._platform.errors import (
    LongPiecesWarning,
    PointsOutsideGridError,
    raise_together,
    warn,
)
from dolfinmpm.assembly.evaluation import Evaluation
from dolfinmpm.assembly.nitschepenalty import trace_constants
from dolfinmpm.assembly.pointupdates import PointUpdates
from dolfinmpm.assembly.state import Local
from dolfinmpm.assembly.term import NewState, Term
from dolfinmpm.basis import LeafBasis
from dolfinmpm.basis.space import Space
from dolfinmpm.body.axisymmetry import deformation, in_section
from dolfinmpm.body.boundary import OWN, Boundary
from dolfinmpm.body.location import Destinations, cells_here, destinations
from dolfinmpm.body.markerdistance import APART
from dolfinmpm.body.markerstate import leave_with_removed, take_state
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.cut.activation import Activation, ActiveField
from dolfinmpm.cut.activeboundaries import active_boundary_regions
from dolfinmpm.forms.declarations import Declaration
from dolfinmpm.forms.splitting import BoundaryTerms
from dolfinmpm.grid.lattice import largest_cell, lattice_of
from dolfinmpm.kinematics.nitsche import TRACE
from dolfinmpm.terms.referencemarkers import reference_wall

__all__ = ["ActiveBoundaryTerm", "BoundaryTerm"]

Array = npt.NDArray[np.float64]
# Constants of cells with a stabilisation are kept while the boundary moves less than this share
_STILL = 0.02
# and while the body in front of a wall moves less than this one. Constants that were never computed
# anew let an aggregated block of quadratic splines fail after a way of 1.8 cells.
_PASSED = 0.1
# Length of a piece, in leaves, from which it is too long; leaves are halves, and may be oblong
_LONG = 1.5
# Least penalty of Nitsche's method where the body has F-bar, in units of M/h. 5 let a cavity in
# yielding clay bulge. With 20 a strip that is pressed into aggregated clay took four times as many
# iterations as with 50. More than that holds round boundaries too stiffly.
_SHARED = 50.0
# and in implicit steps with inertia. Its traction is that of the nearest point, and not quite that
# of the symmetric term, so that bodies make energy: the less, the greater the penalty is. Twice the
# constants let blocks at rest fail after some periods, 30 times those of splines after a hundred.
_IN_TIME = 1000.0


class BoundaryTerm(Term):
    """Terms over a boundary that does not fit the grid.

    Args:
        of: The terms of the form.
        spaces: Spaces of the increments.

    Attributes:
        boundary, regions, tags, declarations, conditions: See `BoundaryTerms`.
    """

    def __init__(self, of: BoundaryTerms, spaces: Sequence[Space]):
        self._of = of
        self.boundary, self.regions, self.tags = of.boundary, of.regions, of.tags
        self.declarations, self.conditions = of.declarations, of.conditions
        self.updates = PointUpdates(
            {name: e for c in of.conditions for name, e in c.updates.items()},
            of.regions, spaces, of.boundary.markers,
        )  # fmt: skip
        self._in_time, self._told = False, False
        self._weights: Any = None

    @property
    def markers(self) -> MaterialPoints:
        """The markers of the boundary."""
        return self.boundary.markers

    def sees(self, u: Any) -> bool:
        """Whether its markers belong to the field of an increment, for fields with tags."""
        return self._of.sees(u)

    def bind(self, declarations: Sequence[Declaration]) -> None:
        """See `Term`. Collective."""
        for declaration in self.declarations:
            declaration.bind()

    def start_in_time(self, weights: Any) -> None:
        """See `Term`."""
        self._in_time, self._weights = True, weights
        self._set_walls()

    def _set_walls(self) -> None:
        """Let walls act as in the steps of this problem; other problems may share them."""
        for condition in self.conditions:
            if condition.pushes:
                condition.act(self._in_time, self._weights)

    def place(self) -> None:
        """Bring markers to the ranks of their cells, with nearby points' state. Collective."""
        markers, points = self.markers, self.boundary.points
        if markers.partition is not points.partition:
            markers.partition = points.partition
            markers.locate()
        if self.boundary.follows:
            leave_with_removed(self.boundary)
        if self._of.stateful:
            take_state(self.boundary, self.tags)
        if markers.configuration == "total" and not self.boundary.follows:
            reference_wall(self.boundary)

    def on(self, here: Activation) -> ActiveBoundaryTerm:
        """See `Term`."""
        mine = any(self is of for of in here.terms.boundaries)
        known = here.boundaries[self.markers.number].regions
        return ActiveBoundaryTerm(
            self, here, known if mine else active_boundary_regions(self, here)
        )

    def set_penalties(
        self,
        here: Activation,
        moduli: Callable[[], Array],
        increments: Sequence[Any],
        stabilised: bool,
        sharing: Sequence[Any] = (),
    ) -> None:
        """Set the penalties of weak conditions for a step. Collective.

        Args:
            here: The activation.
            moduli: Function that returns the elastic moduli M and G at the points (Pa).
            increments: Increments of the fields.
            stabilised: Whether a stabilisation bounds the constants of cells with small cuts. Then
                the constants change little with the cut.
            sharing: Increments of the bodies with F-bar.
        """
        markers = self.markers
        rows = np.sort(here.fields[0].of_markers[markers.number].order)
        first = here.fields[0]
        self._warn_of_long_pieces(first)
        self._set_walls()
        last = {c.stiffness: markers[c.stiffness].copy() for c in self.conditions}
        for condition in self.conditions:
            condition.prepare(rows, _sizes(self.boundary, first))
        # constants are kept for one field only
        fields = {id(c.declaration.u) for c in self.conditions if c.local}
        for k, u in enumerate(increments):
            local = [c for c in self.conditions if c.local and c.declaration.u is u]
            if not local:
                continue
            if not (markers[f"{TRACE}_points"] == self.boundary.points.total).all():
                # faces beside ground that was taken away have other points next to them: they keep
                # their constants, and the way of the body begins anew
                _note_body(markers, self.boundary.points.total)
            if not (stabilised and len(fields) == 1 and _stays(self.boundary, rows, first)):
                at = np.zeros((len(markers), 2))
                for one in self.declarations:
                    at[one.rows] = one.elastic.moduli()
                found = trace_constants(here, k, self.boundary, moduli(), at)
                markers[TRACE], markers[f"{TRACE}_x"] = found, markers["x"]
                markers[f"{TRACE}_cell"] = _middles(self.boundary, first)
                _note_body(markers, self.boundary.points.total)
            for condition in local:
                of_law = condition.declaration.rows
                k = 2.0 * markers[TRACE][of_law]
                if any(u is one for one in sharing):
                    M = condition.declaration.elastic.moduli()[:, 0]
                    k = np.maximum(k, _SHARED * M / _sizes(self.boundary, first)[of_law])
                markers[condition.stiffness][of_law] = k
        if self._weights is not None:
            self._stiffen_in_time(_sizes(self.boundary, first), last)

    def _stiffen_in_time(self, sizes: Array, last: Mapping[str, Array]) -> None:
        """Raise penalties that nobody gave to those of implicit steps with inertia.

        Args:
            sizes: Sizes of the cells at the markers (m), shape (markers,).
            last: Penalties of the last step (Pa/m) by name; the forces in them stay.
        """
        for condition in self.conditions:
            if condition.exact and condition.penalty is None and condition.fixed is None:
                rows, k = condition.declaration.rows, self.markers[condition.stiffness]
                M = condition.declaration.elastic.moduli()[:, 0]
                k[rows] = np.maximum(k[rows], _IN_TIME * M / sizes[rows])
                share = last[condition.stiffness][rows] / k[rows]
                condition.gaps()[rows] *= share[:, None]

    def _warn_of_long_pieces(self, field: ActiveField) -> None:
        """Warn once if leaves are smaller than the pieces of the boundary. Collective.

        Nodes of such leaves get wrong shares of a piece, and stresses beside it swing.
        """
        boundary, comm = self.boundary, self.markers.comm
        lattice = lattice_of(boundary.points.grid)
        if self._told or lattice is None or not isinstance(field.basis, LeafBasis):
            return
        if boundary.longest < _LONG * field.space.finest_cell:
            return
        at = enumerate(lattice.cells_at(boundary.seen).T)
        edges = np.array([np.diff(lattice.lines[d])[cells] for d, cells in at])
        pieces = np.minimum(boundary.longest, np.prod(edges, axis=0) ** (1 / len(edges)))
        sizes = _sizes(boundary, field)
        least = float(sizes[pieces > _LONG * sizes].min(initial=np.inf))
        least = comm.allreduce(least, op=MPI.MIN)
        if least < np.inf:
            self._told = True
            warn(
                comm,
                f"pieces of the boundary '{boundary.name}' are longer than leaves there "
                f"({least:.3g} m): stresses beside it swing. Make it with spacing={least:.3g}",
                LongPiecesWarning,
            )

    def energy(self) -> tuple[float, float]:
        """See `Term`: of its walls. Collective."""
        found = np.zeros(2)
        for condition in self.conditions:
            found += condition.energy()
        self.markers.comm.Allreduce(MPI.IN_PLACE, found, op=MPI.SUM)
        return float(found[0]), float(found[1])

    def summary(self) -> str:
        """See `Term`."""
        return f"boundary of {self.markers.total} markers"

    def state(self) -> dict[str, Any]:
        """State of the markers in the order of their numbers, and local numbers. Collective."""
        markers, names = self.markers, self._kept
        found = markers.comm.bcast(markers.gather(*names))
        placed = markers.partition is self.boundary.points.partition
        order = Local(np.concatenate([[np.int64(placed)], markers["id"]]))
        return {**dict(zip(names, found)), "order": order}

    def needed(self) -> list[str]:
        """See `Term`: fields for boundaries in steps at first positions."""
        return [OWN] if self.boundary.follows else []

    def set_state(self, values: Mapping[str, Any]) -> None:
        """Restore markers from `state`, on any number of ranks. Collective."""
        markers = self.markers
        if APART in values and APART not in markers.fields:
            markers.add_field(APART)
        elif APART in markers.fields:
            markers.fields[APART][...] = 0.0
        self.boundary.removed = []
        names = [name for name in self._kept if name != APART or name in values]
        markers.partition = self.boundary.points.partition
        order = values.get("order")
        if order is not None:
            placed, number = order.values[0], order.values[1:].copy()
            if not placed:
                # the next step finds the ranks of the markers
                markers.partition = None
            for name, old in markers.fields.items():
                # the state of the nearest points is copied below
                markers.fields[name] = np.zeros((len(number), *old.shape[1:]), old.dtype)
            markers.fields["id"] = number
        for name in names:
            markers.fields[name][...] = values[name][markers["id"]]
        if order is None:
            markers.locate()
        else:
            markers.fields["cell"] = cells_here(markers.grid, self.boundary.seen)
            markers.recount()
        if self._of.stateful:
            take_state(self.boundary, self.tags)

    @property
    def _kept(self) -> list[str]:
        """Names of the markers' fields that are not copies of the nearest point's fields."""
        state = {*self.boundary.points.fields, "body_x", "body_l", "body_x0"}
        state = (state - {"x", "V", "x0", "V0"}) | {"cell"}
        return sorted(name for name in self.markers.fields if name not in state)


class ActiveBoundaryTerm(Evaluation):
    """Terms over a boundary on an activation; see `ActiveTerm`."""

    kind = "boundary"

    def __init__(self, of: BoundaryTerm, here: Activation, parts: Any):
        super().__init__(of.regions, of.markers, here.unknowns, parts)
        self._of, self._here = of, here

    def update(self, new: NewState) -> None:
        """See `ActiveTerm`: the displacements of the markers."""
        new.moved[self._of.markers.number] = self.motion(self._here.movers)[0]

    def new_fields(self) -> dict[str, Array]:
        """Fields that conditions set at the markers, for the present increments, by name."""
        fields: dict[str, Array] = {}
        self._of.updates.run(self, fields)
        boundary = self._of.boundary
        if boundary.follows and APART in boundary.markers.fields:
            for name in fields.keys() & set(boundary.forces):
                fields[name][~boundary.present()] = 0.0
        # a pore pressure and a given stiffness are there at markers of other tags, too
        for condition in self._of.conditions:
            tags = None if condition.declaration is None else condition.declaration.tags
            if tags is not None:
                others = ~np.isin(boundary.markers["tag"], tags)
                for name in condition.forces:
                    fields[name][others] = 0.0
        return fields

    def follow(self, new: NewState, step: int) -> None:
        """Add the state of the markers. Collective.

        Raises:
            PointsOutsideGridError: Markers would leave the grid.
        """
        boundary, markers = self._of.boundary, self._of.markers
        fields = self.new_fields()
        to: Destinations | None = None
        if boundary.follows:
            u, gradient = self.motion(self._here.movers)
            dF = deformation(markers, u, gradient)
            J = np.linalg.det(dF)
            # Nanson's formula
            across = np.swapaxes(in_section(markers, dF), 1, 2)
            turned = np.linalg.solve(across, markers["area"][:, :, None])[:, :, 0]
            fields["area"] = J[:, None] * turned
            fields["V"] = np.linalg.norm(fields["area"], axis=1)
            fields["x"] = markers["x"] + u
            if OWN in markers.fields:
                fields[OWN] = dF @ markers[OWN]
            if markers.configuration != "total":
                to = destinations(markers.grid, fields["x"], markers["cell"], markers.partition)
                raise_together(markers.comm, _outside(boundary, fields["x"], to, step))
        new.markers.append((markers, fields, to))


def _sizes(boundary: Boundary, field: ActiveField) -> Array:
    """Sizes of the field's cells at the markers (m), shape (markers,)."""
    sizes = np.full(len(boundary.markers), largest_cell(boundary.markers.grid))
    if isinstance(field.basis, LeafBasis):
        # a marker away from the body is in no leaf
        cells = field.basis.cells_at(boundary.seen)
        sizes[cells >= 0] = field.basis.cell_sizes()[cells[cells >= 0]]
    return sizes


def _middles(boundary: Boundary, field: ActiveField) -> Array:
    """Middles of the markers' cells (m), shape (markers, gdim)."""
    markers, grid, x = boundary.markers, boundary.markers.grid, boundary.seen
    lattice = lattice_of(grid)
    if lattice is None:
        corners = grid.geometry.x[:, : markers.gdim][geometry_dofmap(grid)[markers["cell"]]]
        return np.asarray(corners.mean(axis=1), np.float64)
    ijk = lattice.cells_at(x)
    lines = enumerate(lattice.lines)
    middles = np.column_stack([0.5 * (line[ijk[:, d]] + line[ijk[:, d] + 1]) for d, line in lines])
    if isinstance(field.basis, LeafBasis):
        cells, (low, high) = field.basis.cells_at(x), field.basis.cell_corners()
        known = cells >= 0
        middles[known] = 0.5 * (low + high)[cells[known]]
    return middles


def _body(markers: MaterialPoints) -> str:
    """Name of the markers' field of the place of the body: of walls that of the nearest point."""
    return "body_x" if "body_x" in markers.fields else "x"


def _note_body(markers: MaterialPoints, count: int) -> None:
    """Keep where the body of a number of points is, for `_stays`."""
    markers[f"{TRACE}_body"] = markers[_body(markers)]
    markers[f"{TRACE}_points"] = count


def _stays(boundary: Boundary, rows: npt.NDArray[np.integer], field: ActiveField) -> bool:
    """Whether markers are in the cells of their known constants; they and the body moved little."""
    markers = boundary.markers
    h = field.space.finest_cell
    way = np.abs(markers["x"] - markers[f"{TRACE}_x"])[rows].max(initial=0.0)
    other = np.abs(_middles(boundary, field) - markers[f"{TRACE}_cell"])[rows].max(initial=0.0)
    body = np.abs(markers[_body(markers)] - markers[f"{TRACE}_body"])[rows].max(initial=0.0)
    known = bool((markers[TRACE][rows] > 0).all())
    same = known and way < _STILL * h and other < 1e-6 * h and body < _PASSED * h
    return bool(markers.comm.allreduce(same, op=MPI.LAND))


def _outside(boundary: Boundary, x: Array, to: Destinations, step: int):
    lost = np.flatnonzero(to.rank < 0)
    if lost.size == 0:
        return None
    return PointsOutsideGridError(
        f"{lost.size} markers of {boundary} would leave the grid in step {step}, one from "
        f"{boundary.markers['x'][lost[0]]} m to {x[lost[0]]} m. The state is that before the step: "
        "enlarge the grid, or keep the boundary in space with follows=False"
    )
