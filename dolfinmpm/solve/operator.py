"""The equations of a step: residual and tangent of a weak form on an activation."""

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
from dolfinmpm.contact.contactpoints import ActiveContact
from dolfinmpm.cut.activation import Activation
from dolfinmpm.cut.merging import one_block_per_pair
from dolfinmpm.cut.pattern import Blocks
from dolfinmpm.cut.unknowns import Nodal
from dolfinmpm.solve.weakform import WeakForm

__all__ = ["Operator", "Residual"]

Array = npt.NDArray[np.float64]

# Constant entries, as a share of the matrix, that are added anew to each tangent
_FEW = 0.3


@dataclass(frozen=True)
class Residual:
    """The out-of-balance force.

    Attributes:
        values: Internal plus external forces on the owned unknowns (N), shape (owned,).
        norm: Norm of the values, over all ranks.
        reference: Norm of the external forces and the reactions.
        by_field: Norm and reference per field, shape (fields, 2), because units differ between
            fields. None for a single field.
    """

    values: Array
    norm: float
    reference: float
    by_field: Array | None = None


class Operator:
    """Residual and tangent of a weak form as functions of the unknowns.

    The operator holds the present increments. It changes no point and no body.

    Args:
        form: The weak form.
        here: The activation.
        more: Terms outside the form, such as the inertia of a step in time.

    Attributes:
        form, here: The arguments.
        points: The terms of the points.
        others: All other terms.
        contacts: The contacts among them.
        loads: External forces of loads (N), shape (nodes, components) per field.
    """

    @stages.assemble
    def __init__(self, form: WeakForm, here: Activation, more: Sequence[ActiveTerm] = ()):
        self.form, self.here = form, here
        self.points, self._active = form.on(here)
        self.others: list[ActiveTerm] = [*self._active.values(), *more]
        self.contacts = [term for term in self.others if isinstance(term, ActiveContact)]
        self._u, self._force, self._lift = (here.unknowns.nodal() for _ in range(3))
        self._external = here.unknowns.nodal()
        self.loads: Sequence[Array] = ()
        # internal forces at prescribed components of owned nodes, by the last residual
        self._reactions: Array | None = None
        # present increments relative to the increments at the level where forces balance
        self._scale = 1.0
        # entries of the constant blocks: those of the matrix, and those of prescribed columns
        self._base: tuple[Array, list[Array]] | None = None
        self.update_external()

    @property
    def terms(self) -> list[ActiveTerm]:
        """All terms, the points first."""
        return [self.points, *self.others]

    def active(self, term: Term) -> Any:
        """A term of the form on the activation.

        Raises:
            KeyError: The term has no forces there.
        """
        return self._active[term]

    # -- vectors --------------------------------------------------------------

    @stages.assemble
    def update_external(self) -> None:
        """Evaluate external forces with the present constants and functions. Collective."""
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
        """Add the external forces of loads, or those of other terms. Collective."""
        for term in self.terms:
            if term.is_load == loads:
                term.external(out.arrays)
        out.add_up()

    @property
    def external(self) -> Sequence[Array]:
        """Forces that do not depend on the increments (N), shape (nodes, components) per field."""
        return self._external.arrays

    @stages.evaluate
    def move(self, x: Array, scale: float = 1.0) -> None:
        """Set the increments of nodes and points from the unknowns. Collective.

        Args:
            x: Owned unknowns, shape (owned,).
            scale: Factor of all increments, also the prescribed ones. Fields whose values the form
                carries from step to step are not scaled.
        """
        self.here.unknowns.expand(x, self.here.prescribed, self._u)
        self._scale, self._reactions = scale, None
        if scale != 1.0:
            for u, name in zip(self._u.arrays, self.form.values):
                u *= scale if name is None else 1.0
        self._interpolate()

    @stages.evaluate
    def move_to_start(self) -> None:
        """Set the state at the start of a step. Collective.

        Increments are zero. Fields that the form carries have their values at the points.
        """
        self.move_to_zero()
        for value, name in zip(self.points.value, self.form.values):
            if name is not None:
                value[...] = self.form.points[name].reshape(value.shape)

    def _interpolate(self) -> None:
        """Pass the nodal increments to all terms."""
        for term in self.terms:
            term.move(self._u.arrays)

    @property
    def increments(self) -> Sequence[Array]:
        """The present increments, shape (nodes, components) per field."""
        return self._u.arrays

    @stages.assemble
    def forces(self, without: Collection[str] = ()) -> list[Array]:
        """Internal plus external forces at the present increments (N). Collective.

        Args:
            without: Kinds of terms without internal forces in the sum, see `ActiveTerm`.

        Returns:
            Shape (nodes, components) per field, summed over ranks at the nodes' owners.
        """
        internal = self._internal(without).arrays
        return [a + b for a, b in zip(internal, self.external)]

    @stages.evaluate
    def set_increments(self, u: Sequence[Array]) -> None:
        """Set nodal increments, and evaluate them at the points.

        Args:
            u: Increments at all nodes of this rank, shape (nodes, components) per field.
        """
        for mine, given in zip(self._u.arrays, u):
            mine[...] = given
        self._interpolate()

    @stages.evaluate
    def move_to_zero(self) -> None:
        """Set all increments to zero, also the prescribed ones. Collective."""
        self.here.unknowns.clear(self._u)
        self._interpolate()

    def _internal(self, without: Collection[str] = ()) -> Nodal:
        """Internal forces at the present increments, summed over ranks. Collective."""
        here, out = self.here, self._force
        here.unknowns.clear(out)
        every = [term for term in self.terms if term.kind not in without]
        if "contact" not in without:
            self.update_contact()
        for term in every:
            if not term.internal(out.arrays):
                self._set_nan(out)
                break
        for blocks in () if "penalty" in without else self._constant:
            add_product(blocks, self._u.arrays, out.arrays)
        out.add_up()
        return out

    def _set_nan(self, out: Nodal) -> None:
        """Set forces to NaN after a law has failed. The norm is then NaN on all ranks."""
        for field, force in zip(self.here.unknowns.fields, out.arrays):
            force[field.nodes] = math.nan

    def update_contact(self, u: Sequence[Array] | None = None) -> None:
        """Find the forces of contact at the present increments, or at given ones.

        Args:
            u: Increments at all nodes of this rank, shape (nodes, components) per field, or None.
        """
        for contact in self.contacts:
            contact.touch(self._u.arrays if u is None else u, self._scale)

    def has(self, kind: str) -> bool:
        """Whether a term has this kind, see `ActiveTerm`."""
        return any(term.kind == kind for term in self.terms)

    @stages.assemble
    def forces_of(self, kind: str, renewed: bool = False) -> Sequence[Array]:
        """Internal forces of the terms of one kind, at the increments of these terms. Collective.

        Contacts return the forces of the last `update_contact`.

        Args:
            kind: The kind.
            renewed: Whether constants and functions are taken as they are now.

        Returns:
            Nodal forces (N), shape (nodes, components) per field, at the nodes' owners. They are
            NaN after a law has failed.
        """
        forces = self.here.unknowns.nodal()
        if self.has(kind):
            terms = [term for term in self.terms if term.kind == kind]
            for term in terms if renewed else ():
                term.renew()
            if not all(term.internal(forces.arrays) for term in terms):
                self._set_nan(forces)
            forces.add_up()
        return forces.arrays

    @stages.evaluate
    def set_increments_of(self, kind: str, u: Sequence[Array]) -> None:
        """Set nodal increments in the terms of one kind only.

        Args:
            kind: The kind.
            u: Increments at all nodes of this rank, shape (nodes, components) per field.
        """
        for term in self.terms:
            if term.kind == kind:
                term.move(u)

    def residual(self, x: Array) -> Residual:
        """The out-of-balance force at the unknowns. Collective.

        Args:
            x: Owned unknowns, shape (owned,).
        """
        with stages.assemble:
            unknowns = self.here.unknowns
            self.move(x)
            internal = self._internal().arrays
            external = unknowns.entries(self.external)
            values = unknowns.entries(internal) + external
            self._reactions = reactions = unknowns.reactions(internal)
            sums = np.array([values @ values, external @ external + reactions @ reactions])
            if len(unknowns.fields) == 1:
                norm, reference = np.sqrt(unknowns.comm.allreduce(sums))
                return Residual(unknowns.shared_out(values), float(norm), float(reference))
            each = [unknowns.squares(values), unknowns.squares(external)]
            each[1] += [float(np.sum(r.reshape(-1)[f.places[1]] ** 2))
                        for f, r in zip(unknowns.fields, internal)]  # fmt: skip
            found = np.sqrt(unknowns.comm.allreduce(np.vstack([sums, np.stack(each, axis=1)])))
            (norm, reference), by_field = found[0], found[1:]
            return Residual(unknowns.shared_out(values), float(norm), float(reference), by_field)

    def holding_forces(self) -> Array:
        """Forces at prescribed components that hold the present increments (N). Collective.

        Returns:
            Those of nodes that this rank owns, one field after the other.
        """
        unknowns, internal = self.here.unknowns, self._reactions
        if internal is None:
            return unknowns.reactions(self.forces())
        return internal + unknowns.reactions(self.external)

    def sizes(self, matrix: PETSc.Mat, x: PETSc.Vec) -> Array:
        """Size of the contribution of each field's unknowns to each field's equations. Collective.

        Args:
            matrix: The tangent.
            x: The unknowns.

        Returns:
            Norms of the products with the tangent, shape (fields of the unknowns, fields of the
            equations).
        """
        unknowns, found = self.here.unknowns, []
        part, product = x.duplicate(), x.duplicate()
        for k in range(len(unknowns.fields)):
            part.getArray()[:] = unknowns.only(k, x.getArray(readonly=True))
            matrix.mult(part, product)
            back = unknowns.given_back(product.getArray(readonly=True))
            found.append(unknowns.squares(back))
        return np.sqrt(unknowns.comm.allreduce(np.array(found)))

    @stages.assemble
    def predictor_residual(self) -> Array:
        """Residual of the linear step from zero under the prescribed increments. Collective.

        Returns:
            f + K g on the owned unknowns, shape (owned,), with the last assembled tangent K and
            the prescribed increments g.
        """
        unknowns = self.here.unknowns
        internal = self._internal().arrays
        self._lift.add_up()
        parts = internal, self.external, self._lift.arrays
        return unknowns.shared_out(np.sum([unknowns.entries(part) for part in parts], axis=0))

    # -- tangent --------------------------------------------------------------

    @functools.cached_property
    def _constant(self) -> list[Blocks]:
        """Blocks of constant stiffness, one per pair of fields."""
        of_form = len(self._active)
        blocks = [b for term in self.others[:of_form] for b in term.stiffness]
        blocks += self._blocks_of("stiffness") + self._blocks_of("penalty")
        blocks += [b for term in self.others[of_form:] for b in term.stiffness]
        return blocks if len(blocks) < 2 else one_block_per_pair(blocks)

    @property
    def soft(self) -> list[Blocks]:
        """Blocks of soft stiffness: they are in the matrix, and not in the forces."""
        return self._blocks_of("soft")

    def _blocks_of(self, kind: str) -> list[Blocks]:
        """Blocks of a kind of the activation, which holds those of its own form only."""
        return self.here.blocks_of(kind) if self.here.terms is self.form else []

    @stages.assemble
    def tangent(self, matrix: Matrix) -> None:
        """Assemble the tangent at the present increments. Collective.

        Args:
            matrix: Output, with the activation's pattern.
        """
        here = self.here
        fields = list(zip(here.unknowns.fields, self._lift.arrays))
        entries = {
            (i, j): Entries(rows, columns, here.pattern, matrix.data, here.prescribed[j], lift)
            for i, (rows, lift) in enumerate(fields)
            for j, columns in enumerate(here.unknowns.fields)
        }
        self._begin(matrix, entries)
        self.update_contact()
        for term in self.terms:
            term.tangent(entries)
        matrix.finish()

    def _begin(self, matrix: Matrix, entries: Mapping[tuple[int, int], Entries]) -> None:
        """Set the constant part of the tangent. Many entries of it are kept for later calls."""
        fields, lifts = self.here.unknowns.fields, self._lift.arrays
        if self._base is not None:
            matrix.data[:] = self._base[0]
            for field, lift, kept in zip(fields, lifts, self._base[1]):
                lift[field.nodes] = kept
            return
        matrix.data[:] = 0.0
        self.here.unknowns.clear(self._lift)
        blocks = [*self._constant, *self.soft]
        for b in blocks:
            add_blocks(b, entries[b.row_field, b.column_field])
        # a copy of the matrix takes more time and memory than the few entries of a ghost penalty
        if sum(b.values.size for b in blocks) > _FEW * matrix.data.size:
            kept_lifts = [lift[field.nodes] for field, lift in zip(fields, lifts)]
            self._base = np.array(matrix.data), kept_lifts
