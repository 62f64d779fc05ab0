"""A weak form on an activation: the sum of its terms, as functions of the unknowns."""

from __future__ import annotations

import functools
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from petsc4py import PETSc

from dolfinmpm._platform import stages
from dolfinmpm.assembly.stencilsums import Entries, Matrix, add_blocks, add_product
from dolfinmpm.assembly.term import ActiveTerm, Term
from dolfinmpm.cut.activation import Activation
from dolfinmpm.cut.merging import merged
from dolfinmpm.cut.pattern import Blocks
from dolfinmpm.cut.unknowns import Nodal
from dolfinmpm.solve.weakform import WeakForm
from dolfinmpm.solve.withoutsoft import WithoutSoftStiffness
from dolfinmpm.terms.gridterm import StepBlocks

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
        more: Terms that stand in no form, such as the inertia of a step in time.

    Attributes:
        form, here: The arguments.
        terms: All terms.
        points: The terms of the points.
        loads: External forces of loads (N), (nodes, components) each field.
    """

    @stages.assemble
    def __init__(self, form: WeakForm, here: Activation, more: Sequence[ActiveTerm] = ()):
        self.form, self.here = form, here
        self.points, self._of = form.on(here)
        # what is the same for a whole step belongs to the form that the activation is made for
        steady = [StepBlocks(here)] if here.terms is form else []
        self.terms: list[ActiveTerm] = [self.points, *self._of.values(), *steady, *more]
        self._u, self._force, self._lift = (here.unknowns.nodal() for _ in range(3))
        self._external = here.unknowns.nodal()
        self.loads: Sequence[Array] = ()
        # increments moved to by those at the level where forces balance
        self._scale = 1.0
        # what a matrix has of blocks, and of their columns of prescribed components
        self._base: tuple[Array, list[Array]] | None = None
        self.renew_external()

    def of(self, term: Term) -> Any:
        """A term of the form on the activation.

        Raises:
            KeyError: It has no forces there.
        """
        return self._of[term]

    # -- vectors --------------------------------------------------------------

    @stages.assemble
    def renew_external(self) -> None:
        """Take the DOLFINx constants and functions as they are now. Collective."""
        out = self._external
        self.here.unknowns.clear(out)
        self._add_external(out, loads=True)
        self.loads = out.arrays
        if all(term.is_load for term in self.terms):
            return
        self.loads = [np.array(values) for values in out.arrays]
        others = self.here.unknowns.nodal()
        self._add_external(others, loads=False)
        for mine, more in zip(out.arrays, others.arrays):
            mine += more

    def _add_external(self, out: Nodal, loads: bool) -> None:
        """Add the forces that do not depend on the increments, of loads or of other terms."""
        for term in self.terms:
            if term.is_load == loads:
                term.external(out.arrays)
        out.add_up()

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

    def _interpolate(self) -> None:
        """Evaluate the nodal increments in all terms."""
        for term in self.terms:
            term.move(self._u.arrays)

    @property
    def increments(self) -> Sequence[Array]:
        """The increments moved to, (nodes, components) each field."""
        return self._u.arrays

    @stages.assemble
    def forces(self, without: Collection[str] = ()) -> list[Array]:
        """Internal and external forces at the increments moved to (N), each field's. Collective.

        Args:
            without: Kinds of terms whose internal forces are left out, see `ActiveTerm`.

        Returns:
            Shapes (nodes, components), summed over ranks at the nodes' owners.
        """
        internal = self._internal(without).arrays
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

    def _internal(self, without: Collection[str] = ()) -> Nodal:
        """Internal forces at the increments moved to, summed over ranks. Collective."""
        here, out = self.here, self._force
        here.unknowns.clear(out)
        every = [term for term in self.terms if term.kind not in without]
        for term in every:
            term.touch(self._u.arrays, self._scale)
        for term in every:
            if not term.internal(out.arrays):
                self._spoil(out)
                break
        for blocks in () if "penalty" in without else self._constant:
            add_product(blocks, self._u.arrays, out.arrays)
        out.add_up()
        return out

    def _spoil(self, out: Nodal) -> None:
        """Where a law fails the norm of the forces is no number on any rank."""
        for field, force in zip(self.here.unknowns.fields, out.arrays):
            force[field.nodes] = math.nan

    def touch(self) -> None:
        """Let contacts find their forces at the increments moved to."""
        for term in self.terms:
            term.touch(self._u.arrays, self._scale)

    @property
    def pushed(self) -> bool:
        """Whether a term moves the points by a motion of its own."""
        return any(term.pushes for term in self.terms)

    def has(self, kind: str) -> bool:
        """Whether there is a term of a kind, see `ActiveTerm`."""
        return any(term.kind == kind for term in self.terms)

    @stages.assemble
    def forces_of(self, kind: str) -> Sequence[Array]:
        """Internal forces of the terms of a kind at the increments that they have. Collective.

        Contacts have the forces that they found last, other terms the increments placed last.

        Returns:
            Nodal forces (N), (nodes, components) each field, at the nodes' owners; no numbers where
            a law fails.
        """
        forces = self.here.unknowns.nodal()
        if self.has(kind):
            if not all(t.internal(forces.arrays) for t in self.terms if t.kind == kind):
                self._spoil(forces)
            forces.add_up()
        return forces.arrays

    @stages.evaluate
    def place_in(self, kind: str, u: Sequence[Array]) -> None:
        """Evaluate nodal increments in the terms of a kind alone.

        Args:
            kind: The kind.
            u: Increments at all nodes known here, (nodes, components) each field.
        """
        for term in self.terms:
            if term.kind == kind:
                term.move(u)

    def residual(self, x: Array) -> Residual:
        """Forces out of balance. Collective.

        Args:
            x: Owned unknowns, shape (owned,).
        """
        with stages.assemble:
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

    def sizes(self, matrix: PETSc.Mat, x: PETSc.Vec) -> Array:
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

    @functools.cached_property
    def _constant(self) -> list[Blocks]:
        """Blocks whose products with the increments are forces, all between two fields in one."""
        return merged([b for term in self.terms for b in term.stiffness])

    @functools.cached_property
    def _soft(self) -> list[Blocks]:
        return [b for term in self.terms for b in term.soft]

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
        self.touch()
        for term in self.terms:
            term.tangent(entries)
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
        blocks = [*self._constant, *self._soft]
        for b in blocks:
            add_blocks(b, entries[b.row_field, b.column_field])
        if blocks:
            kept_lifts = [lift[field.nodes] for field, lift in zip(fields, lifts)]
            self._base = np.array(matrix.data), kept_lifts

    def without_soft(self, matrix: Matrix) -> PETSc.Mat:
        """The tangent without its terms of the tangent only, as PETSc takes it. Collective."""
        if not self._soft:
            return matrix.petsc
        return WithoutSoftStiffness(self.here.unknowns, self._soft).operator(matrix.petsc)
