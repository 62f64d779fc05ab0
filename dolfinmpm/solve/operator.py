"""A weak form on an activation: residual, tangent and external forces of the unknowns."""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from petsc4py import PETSc

from dolfinmpm._platform import stages
from dolfinmpm.assembly.evaluation import Evaluation
from dolfinmpm.assembly.stencilsums import Entries, Matrix, add_blocks, add_product
from dolfinmpm.contact.activecontact import ActiveContact
from dolfinmpm.contact.touching import ActiveBetween
from dolfinmpm.cut.activation import region_on, regions_of
from dolfinmpm.cut.celloffsets import cell_offsets
from dolfinmpm.cut.merging import merged
from dolfinmpm.cut.participants import Activation
from dolfinmpm.cut.pattern import Blocks
from dolfinmpm.cut.unknowns import Nodal
from dolfinmpm.forms.carriedfields import CellOffset
from dolfinmpm.solve.weakform import WeakForm
from dolfinmpm.solve.withoutsoft import WithoutSoftStiffness

__all__ = ["Operator", "Residual"]

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Residual:
    """What is out of balance.

    Attributes:
        values: Internal and external forces on the owned unknowns (N), shape (owned,).
        norm: Their norm, over all ranks.
        reference: Norm of external forces, and of reactions where they are what balances
            internal ones.
        parts: Both of each field where there are several, shape (fields, 2): their units differ.
    """

    values: Array
    norm: float
    reference: float
    parts: Array | None = None


class Operator:
    """Residual and tangent of a weak form as functions of the unknowns; nothing else changes.

    Args:
        form: The weak form.
        here: What is active.

    Attributes:
        form, here: The arguments.
        points: The terms of the points.
        markers: The terms over each boundary that does not fit the grid.
        contacts: The contacts with rigid bodies.
        between: The contacts of bodies with fields of their own.
    """

    @stages.assemble
    def __init__(self, form: WeakForm, here: Activation):
        self.form, self.here = form, here
        for field in form.parts.carried:
            if isinstance(field, CellOffset):
                (of,) = (f for f in here.fields if f.space is field.space)
                form.points[field.name] = cell_offsets(here.where, of)
        # a second form on an activation that was made for another has its own parts of the body
        self._main = form is here.terms
        parts, of_boundaries = here.regions, here.of_boundaries
        if not self._main:
            parts = [region_on(r, form.points, here) for r in form.regions]
            of_boundaries = regions_of(form.boundaries, here, here.terms.boundaries)
            if form.parts.grid:
                form.grid.attach(here.fields)
        self.points = Evaluation(form.regions, form.points, here.unknowns, parts)
        self.markers = [
            Evaluation(of.regions, of.boundary.markers, here.unknowns, parts)
            for of, parts in zip(form.boundaries, of_boundaries)
        ]
        self._u, self._force, self._lift = (here.unknowns.nodal() for _ in range(3))
        self._external = here.unknowns.nodal()
        # increments moved to by those at the level where forces balance
        self._scale = 1.0
        # what a matrix has of blocks, and of their columns of prescribed components
        self._base: tuple[Array, list[Array]] | None = None
        in_time, means = form.inertia is not None, form.means
        self.contacts = [
            ActiveContact.on(contact, here, in_time, means) for contact in form.parts.contacts
        ]
        self.between = [ActiveBetween(facing, means) for facing in here.facing if self._main]
        self.renew_external()

    # -- vectors --------------------------------------------------------------

    @stages.assemble
    def renew_external(self) -> None:
        """Take the DOLFINx constants and functions as they are now. Collective."""
        here, out = self.here, self._external
        here.unknowns.clear(out)
        for terms in self._sets:
            terms.update_constants()
            terms.add_external(out.arrays)
        if self.form.parts.grid:
            self.form.grid.add_external(here.fields, out.arrays)
        out.add_up()

    @property
    def loads(self) -> Sequence[Array]:
        """What of the external forces the form's loads make."""
        return self._external.arrays

    @property
    def external(self) -> Sequence[Array]:
        """Nodal forces that do not depend on the increments (N), (nodes, components) each field."""
        return self._external.arrays

    @stages.evaluate
    def move(self, x: Array, scale: float = 1.0) -> None:
        """Evaluate the increments at nodes and points. Collective.

        Args:
            x: Owned unknowns, shape (owned,).
            scale: Factor of increments, prescribed ones too; fields whose own values the form
                carries from step to step are none, and stay.
        """
        self.here.unknowns.expand(x, self.here.prescribed, self._u)
        self._scale = scale
        if scale != 1.0:
            for u, name in zip(self._u.arrays, self.form.values):
                u *= scale if name is None else 1.0
        self._interpolate()

    @stages.evaluate
    def start(self) -> None:
        """Evaluate the state at the start of a step. Collective.

        No increments, and at the points the values of fields that they carry from step to step.
        """
        self.here.unknowns.clear(self._u)
        self._interpolate()
        for value, name in zip(self.points.value, self.form.values):
            if name is not None:
                value[...] = self.form.points[name].reshape(value.shape)

    @property
    def _sets(self) -> list[Evaluation]:
        """The terms of the points and of all boundaries' markers."""
        return [self.points, *self.markers]

    def _interpolate(self) -> None:
        """Evaluate the nodal increments at points and markers."""
        for terms in self._sets:
            terms.interpolate(self._u.arrays)

    @property
    def increments(self) -> Sequence[Array]:
        """The increments moved to, (nodes, components) each field."""
        return self._u.arrays

    @stages.assemble
    def forces(
        self, boundaries: bool = True, penalties: bool = True, contacts: bool = True
    ) -> list[Array]:
        """Internal and external forces at the increments moved to (N), each field's. Collective.

        Args:
            boundaries: Whether with the internal ones of terms over boundaries.
            penalties: Whether with those that are linear in the increments.
            contacts: Whether with those of contacts.

        Returns:
            Shapes (nodes, components), summed over ranks at the nodes' owners.
        """
        sets = self._sets if boundaries else [self.points]
        internal = self._internal(sets, penalties, contacts).arrays
        return [a + b for a, b in zip(internal, self.external)]

    def load_work(self, of: Sequence[Array] | None = None) -> float:
        """Work of loads, as they are now, on increments. Collective.

        Args:
            of: The increments, those moved to by default.
        """
        unknowns, work = self.here.unknowns, 0.0
        increments = self.increments if of is None else of
        for field, load, u in zip(unknowns.fields, self.loads, increments):
            owned = field.owned_nodes
            work -= float(np.sum(load[owned] * u[owned]))
        return unknowns.comm.allreduce(work)

    def held_work(self, forces: Sequence[Array]) -> float:
        """Work of forces at prescribed components on their increments. Collective.

        Args:
            forces: Forces (N), (nodes, components) each field, summed at the nodes' owners.
        """
        unknowns, work = self.here.unknowns, 0.0
        for field, force, u in zip(unknowns.fields, forces, self.increments):
            held = field.places[1]
            work += float(force.reshape(-1)[held] @ u.reshape(-1)[held])
        return unknowns.comm.allreduce(work)

    @stages.evaluate
    def place(self, u: Sequence[Array]) -> None:
        """Evaluate nodal increments at the points.

        Args:
            u: Increments at all nodes known here, (nodes, components) each field.
        """
        for mine, given in zip(self._u.arrays, u):
            mine[...] = given
        self._interpolate()

    @stages.evaluate
    def rest(self) -> None:
        """Evaluate no increment at all, not even those prescribed. Collective."""
        self.here.unknowns.clear(self._u)
        self._interpolate()

    def _internal(
        self,
        sets: Sequence[Evaluation] | None = None,
        penalties: bool = True,
        contacts: bool = True,
    ) -> Nodal:
        """Internal forces at the increments moved to, summed over ranks. Collective."""
        here, out = self.here, self._force
        here.unknowns.clear(out)
        if not all(terms.add_internal(out.arrays) for terms in sets or self._sets):
            # the norm is then no number on any rank
            for field, force in zip(here.unknowns.fields, out.arrays):
                force[field.nodes] = math.nan
        for blocks in self._constant if penalties else ():
            add_product(blocks, self._u.arrays, out.arrays)
        if contacts:
            self.touch()
            self._add_contacts(out.arrays)
        if not self.form.parts.grid.linear:
            self.fill_functions()
            self.form.grid.add_internal(here.fields, out.arrays)
        out.add_up()
        return out

    def touch(self) -> None:
        """Let contacts find their forces at the increments moved to.

        Mean forces over a step are those of the increments at its end.
        """
        if not self.touches:
            return
        u: list[Any] = list(self._u.arrays)
        means = self.form.means
        if means is not None and means.scale != self._scale:
            u = [np.asarray(means.scale / self._scale * values) for values in u]
        for contact in self.contacts:
            contact.move(u[contact.field])
        for one in self.between:
            one.move(u)

    def _add_contacts(self, out: Sequence[Array]) -> None:
        """Add the forces of contacts as they were last found, as internal forces."""
        for contact in self.contacts:
            contact.add_internal(out[contact.field])
        for one in self.between:
            one.add_internal(out)

    @property
    def touches(self) -> bool:
        """Whether any contact is in the form."""
        return bool(self.contacts or self.between)

    @stages.assemble
    def contact_forces(self, out: Sequence[Array]) -> None:
        """Add the forces of contacts as they were last found, as internal forces. Collective.

        Args:
            out: Nodal forces (N), (nodes, components) each field, at the nodes' owners.
        """
        if not self.touches:
            return
        forces = self.here.unknowns.nodal()
        self._add_contacts(forces.arrays)
        forces.add_up()
        for mine, more in zip(out, forces.arrays):
            mine += more

    @stages.evaluate
    def place_markers(self, u: Sequence[Array]) -> None:
        """Evaluate nodal increments at the markers of boundaries alone.

        Args:
            u: Increments at all nodes known here, (nodes, components) each field.
        """
        for terms in self.markers:
            terms.interpolate(u)

    @stages.assemble
    def boundary_forces(self) -> Sequence[Array]:
        """Internal forces of terms over boundaries at the increments there (N). Collective.

        Returns:
            (nodes, components) each field, at the nodes' owners; no numbers where a law fails.
        """
        forces = self.here.unknowns.nodal()
        if not all(terms.add_internal(forces.arrays) for terms in self.markers):
            for field, force in zip(self.here.unknowns.fields, forces.arrays):
                force[field.nodes] = math.nan
        forces.add_up()
        return forces.arrays

    @stages.assemble
    def residual(self, x: Array) -> Residual:
        """Forces out of balance. Collective.

        Args:
            x: Owned unknowns, shape (owned,).
        """
        unknowns = self.here.unknowns
        self.move(x)
        internal = self._internal().arrays
        external = unknowns.entries(self.external)
        values = unknowns.entries(internal) + external
        reactions = unknowns.reactions(internal)
        sums = np.array([values @ values, external @ external + reactions @ reactions])
        if len(unknowns.fields) == 1:
            norm, reference = np.sqrt(unknowns.comm.allreduce(sums))
            return Residual(unknowns.shared_out(values), float(norm), float(reference))
        each = [unknowns.squares(values), unknowns.squares(external)]
        each[1] += [float(np.sum(r.reshape(-1)[f.places[1]] ** 2))
                    for f, r in zip(unknowns.fields, internal)]  # fmt: skip
        found = np.sqrt(unknowns.comm.allreduce(np.vstack([sums, np.stack(each, axis=1)])))
        (norm, reference), parts = found[0], found[1:]
        return Residual(unknowns.shared_out(values), float(norm), float(reference), parts)

    def terms(self, matrix: PETSc.Mat, x: PETSc.Vec) -> Array:
        """How large the terms are that each field's unknowns make in each equation. Collective.

        Args:
            matrix: The tangent.
            x: The unknowns.

        Returns:
            Norms of the entries of the tangent's products, shape (fields of the unknowns, fields
            of the equations).
        """
        unknowns, found = self.here.unknowns, []
        part, made = x.duplicate(), x.duplicate()
        for k in range(len(unknowns.fields)):
            part.getArray()[:] = unknowns.only(k, x.getArray(readonly=True))
            matrix.mult(part, made)
            found.append(unknowns.squares(unknowns.given_back(made.getArray(readonly=True))))
        return np.sqrt(unknowns.comm.allreduce(np.array(found)))

    def vector(self, x: Array) -> Array:
        """All forces on the owned unknowns (N), shape (owned,). Collective."""
        return self.residual(x).values

    @stages.assemble
    def push(self) -> Array:
        """Residual of the linear step from rest under the prescribed increments. Collective.

        Returns:
            f + K g on the owned unknowns, shape (owned,), K being the tangent that was
            assembled last and g the prescribed increments.
        """
        unknowns = self.here.unknowns
        internal = self._internal().arrays
        self._lift.add_up()
        parts = internal, self.external, self._lift.arrays
        return unknowns.shared_out(np.sum([unknowns.entries(part) for part in parts], axis=0))

    # -- tangent --------------------------------------------------------------

    def _linear(self) -> list[Blocks]:
        """Blocks whose products with the increments are internal forces."""
        here = self.here
        if not self._main:
            return []
        penalties = [f.penalty for f in here.fields if f.penalty is not None]
        return [*here.grid, *penalties] if self.form.parts.grid.linear else penalties

    @property
    def penalties(self) -> list[Blocks]:
        """Blocks of penalties on the increments, whose products with them are internal forces."""
        return Operator._linear(self)

    @functools.cached_property
    def _constant(self) -> list[Blocks]:
        """The same, all between two fields in one."""
        return merged(self._linear())

    @stages.assemble
    def tangent(self, matrix: Matrix) -> None:
        """Assemble the tangent at the increments moved to. Collective.

        Args:
            matrix: Written; of the activation's pattern.
        """
        here = self.here
        fields = list(zip(here.unknowns.fields, self._lift.arrays))
        entries = {
            (i, j): Entries(rows, columns, here.pattern, matrix.data, here.prescribed[j], lift)
            for i, (rows, lift) in enumerate(fields)
            for j, columns in enumerate(here.unknowns.fields)
        }
        self._begin(matrix, entries)
        if not self.form.parts.grid.linear:
            self.fill_functions()
            for b in self.form.grid.tangent(here.fields):
                add_blocks(b, entries[b.row_field, b.column_field])
        for terms in self._sets:
            terms.add_tangent(entries)
        self.touch()
        for contact in self.contacts:
            contact.add_tangent(entries[contact.field, contact.field])
        for one in self.between:
            one.add_tangent(entries)
        matrix.finish()

    def _begin(self, matrix: Matrix, entries: Mapping[tuple[int, int], Entries]) -> None:
        """Begin a tangent with what is the same whatever the increments, kept from the first."""
        fields, lifts = self.here.unknowns.fields, self._lift.arrays
        if self._base is not None:
            matrix.data[:] = self._base[0]
            for field, lift, kept in zip(fields, lifts, self._base[1]):
                lift[field.nodes] = kept
            return
        matrix.data[:] = 0.0
        self.here.unknowns.clear(self._lift)
        blocks = [*self._constant, *self.here.soft]
        for b in blocks:
            add_blocks(b, entries[b.row_field, b.column_field])
        if blocks:
            kept_lifts = [lift[field.nodes] for field, lift in zip(fields, lifts)]
            self._base = np.array(matrix.data), kept_lifts

    def without_soft(self, matrix: Matrix) -> PETSc.Mat:
        """The tangent without its terms of the tangent only, as PETSc takes it. Collective."""
        if not self.here.soft:
            return matrix.petsc
        return WithoutSoftStiffness(self.here.unknowns, self.here.soft).operator(matrix.petsc)

    # -- results --------------------------------------------------------------

    def fill_functions(self) -> None:
        """Hand the increments moved to to the DOLFINx functions."""
        for field, u in zip(self.here.fields, self._u.arrays):
            values = field.space.increment.x.array.reshape(-1, field.space.components)
            if field.to_grid is not None:
                values[:] = (field.to_grid @ u)[: len(values)]
                continue
            values[:] = 0.0
            known = field.nodes[field.nodes < len(values)]
            values[known] = u[known]
