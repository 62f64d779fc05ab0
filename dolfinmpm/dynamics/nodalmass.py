"""The mass of a field at the nodes: products, energies and solutions."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np
import numpy.typing as npt
from mpi4py import MPI
from petsc4py import PETSc

from dolfinmpm._platform import stages
from dolfinmpm._platform.errors import (
    ConvergenceError,
    SingularMassWarning,
    raise_together,
    warn,
)
from dolfinmpm.assembly.stencilsums import Entries, Matrix, add_blocks, add_product
from dolfinmpm.cut.activation import Activation
from dolfinmpm.cut.pattern import Blocks, Pattern
from dolfinmpm.cut.unknowns import FieldUnknowns, Nodal, Unknowns
from dolfinmpm.dynamics.mass import MassTerms, point_masses
from dolfinmpm.dynamics.singularmass import solution_without_null_vectors
from dolfinmpm.dynamics.transfer import scatter
from dolfinmpm.grid.halo import Numbering
from dolfinmpm.solve.linearsolver import FACTORISATION
from dolfinmpm.solve.method import Tangent, crossover
from dolfinmpm.solve.substructures import set_cholesky

__all__ = ["Mass"]

Array = npt.NDArray[np.float64]

# CG ends at this share of the right-hand side: an affine velocity is recovered to ten digits
_TOLERANCE, _MOST = 1e-14, 2000
# Limit of velocities of nodes by those of points: noise gives up to 100 on cubic splines, else 10
_PROPORTION = 1e3
# Limit of f · M⁻¹ f over f · D⁻¹ f with the diagonal D: sound masses give up to 50, and mostly less
# than 20; bodies with fewer points than free nodes give 500 to 20 000
_GAIN = 200.0
# Share of the forces that may be left out because no mass carries them
_LOST = 0.02
# PETSc options of the factors of a mass
_PREFIX = "dolfinmpm_mass_"


class Mass:
    """The mass of a field on an activation. Collective.

    Args:
        terms: The terms of the mass.
        here: The activation.
        mass_scaling: Factor of the mass.
        k: Number of the field.

    Attributes:
        mass_scaling: The argument.
        lumped: Row sums of the mass (kg), shape (nodes,), on all ranks that know the nodes.
        iterations: CG iterations of the last solution.
        singular: Whether a solution met vectors with next to no mass.
        lost: Largest share of a right-hand side that acts on vectors without mass.
    """

    @stages.assemble
    def __init__(self, terms: MassTerms, here: Activation, mass_scaling: float = 1.0, k: int = 0):
        self._terms, self._here, self._k = terms, here, k
        self._field, self.mass_scaling = here.fields[k], mass_scaling
        self.singular, self.lost = False, 0.0
        self.blocks = here.blocks_of("mass", k)
        if mass_scaling != 1.0:
            self.blocks = [replace(b, values=mass_scaling * b.values) for b in self.blocks]
        self.iterations = 0
        single = terms.kind == "lumped" and all(
            np.array_equal(b.rows, b.columns) for b in self.blocks
        )
        self._diagonal: bool = self.comm.allreduce(single, op=MPI.LAND)
        sums = Nodal([self._field.basis.nodes], [1])
        for b in self.blocks:
            if terms.kind == "lumped":
                np.add.at(sums.arrays[0][:, 0], b.rows, b.values[:, 0, 0])
        if terms.kind != "lumped":
            ones = np.ones((len(terms.points), 1))
            m = mass_scaling * point_masses(terms.points)
            scatter(self._field.stencils, m, ones, sums.arrays[0])
        sums.add_up()
        sums.spread()
        self.lumped = sums.arrays[0][:, 0]
        self._solver: PETSc.KSP | None = None

    @property
    def comm(self) -> MPI.Intracomm:
        """Communicator of the problem."""
        return self._here.unknowns.comm

    @property
    def nodes(self) -> Numbering:
        """Numbering of the nodes."""
        return self._field.basis.nodes

    def nodal(self) -> Nodal:
        """Zeros at the nodes. Collective."""
        return Nodal([self._field.basis.nodes], [self._field.space.components])

    def add_to(self, matrix: Matrix, unknowns: Unknowns | None = None) -> None:
        """Write the mass into a matrix of the unknowns. Collective.

        Args:
            matrix: Output, with the activation's pattern.
            unknowns: Unknowns of the matrix; by default those of the activation.
        """
        matrix.data[:] = 0.0
        own = self._own_of(unknowns or self._here.unknowns)
        zero = np.zeros(own.row_of.shape)
        entries = Entries(own, own, matrix.pattern, matrix.data, zero, np.zeros_like(zero))
        for b in self.blocks:
            add_blocks(b, entries)
        matrix.finish()

    def times(self, v: Array) -> Nodal:
        """Product with nodal values, summed over ranks at the nodes' owners. Collective.

        Args:
            v: Shape (nodes, components).
        """
        return self._product(self.blocks, v)

    def _product(self, blocks: Sequence[Blocks], v: Array) -> Nodal:
        """Product of blocks between the field's nodes with nodal values. Collective."""
        out = self.nodal()
        for b in blocks:
            add_product(replace(b, row_field=0, column_field=0), [v], out.arrays)
        out.add_up()
        return out

    def inner(self, v: Array, blocks: Sequence[Blocks], w: Array) -> float:
        """v · B w of nodal values, for blocks between the field's nodes. Collective."""
        if not blocks:
            return 0.0
        product, owned = self._product(blocks, w).arrays[0], self.nodes.owned
        return self.comm.allreduce(float(np.sum(product[:owned] * v[:owned])), op=MPI.SUM)

    def kinetic(self, V: Array) -> tuple[float, float]:
        """½ V · M V of the points' mass, and of the ghost penalty (J). Collective."""
        # the points' mass is the first block, see `MassTerms.blocks`
        return 0.5 * self.inner(V, self.blocks[:1], V), 0.5 * self.inner(V, self.blocks[1:], V)

    def _own_of(self, unknowns: Unknowns) -> FieldUnknowns:
        """The field's unknowns, in the unknowns of all fields or of this field alone."""
        return unknowns.fields[self._k if len(unknowns.fields) > 1 else 0]

    @stages.solve
    def velocities(self, momenta: Nodal, prescribed: Array, fastest: float) -> Nodal:
        """Velocities of the nodes from momenta (kg m/s) of the points. Collective.

        Args:
            momenta: Momenta, summed at the nodes' owners.
            prescribed: Velocities of prescribed components (m/s), shape (nodes, components).
            fastest: Largest component of a velocity of this rank's points (m/s).

        Warns once if a node is far faster than the points. A consistent mass allows this where a
        node has very few points. The new velocities of the points may still be correct, such as in
        a bar, or the step may fail.

        Raises:
            ConvergenceError: The mass is singular.
        """
        V = self.solve(momenta, prescribed)
        if self._diagonal:
            return V
        own = self._own_of(self._here.unknowns)
        nodes, given = own.nodes, np.where(own.fixed, prescribed, 0.0)
        found = [np.abs(V.arrays[0][nodes]).max(initial=0.0), np.abs(given).max(initial=0.0)]
        both = np.array([*found, fastest])
        self.comm.Allreduce(MPI.IN_PLACE, both, op=MPI.MAX)
        largest, moved, fastest = both
        bound = _PROPORTION * max(moved, fastest)
        if not largest <= bound:
            text = (
                f"the consistent mass is next to singular: a node has the velocity {largest:.3g} "
                f"m/s where points have at most {fastest:.3g} m/s, and {_PROPORTION:g} times that "
                f"is what a sound mass may give; give {self._advice()}"
            )
            if not math.isfinite(largest):
                raise ConvergenceError(text)
            if not self._terms.warned:
                self._terms.warned = True
                warn(self.comm, text, SingularMassWarning)
        return V

    def own_velocities(self, momenta: Nodal) -> Array:
        """Momenta of the points over the row sums of the mass (m/s), shape (nodes, d). Collective.

        Args:
            momenta: Momenta (kg m/s), or forces (N) for accelerations, summed at the nodes' owners.
        """
        found = self.nodal()
        found.arrays[0][:] = (
            momenta.arrays[0] / np.where(self.lumped > 0, self.lumped, np.inf)[:, None]
        )
        found.spread()
        return found.arrays[0]

    def _advice(self) -> str:
        """What would make the mass sound, without what it has already, for messages."""
        found = [] if self._terms.ghost else ["a ghost_mass above 0, such as 0.25"]
        found += ['mass="lumped"']
        found += [] if self._field.C is not None else ['stabilisation="aggregation"']
        return ", or ".join([*found, "more points per cell"])

    @stages.solve
    def solve(self, right: Nodal, prescribed: Array) -> Nodal:
        """Nodal values v with M v = right, with given values of prescribed components. Collective.

        Args:
            right: Right-hand side, summed at the nodes' owners.
            prescribed: Values of prescribed components, shape (nodes, components).

        Returns:
            The values, on all ranks that know the nodes.

        Raises:
            ConvergenceError: The mass is singular.
        """
        unknowns, out = self._unknowns, self.nodal()
        # as in the fused loops, a node without mass does not move
        m = np.where(self.lumped > 0, self.lumped, np.inf)[:, None]
        (p,) = right.arrays
        if not self._diagonal:
            # at nodes of very small mass p/m is arbitrary: they start from zero
            m = np.where(self.lumped > 0, self.lumped, 1.0)[:, None]
            m = np.maximum(m, 1e-3 * self.lumped.max(initial=0.0))
        guess = unknowns.restrict([p / m])
        if not self._diagonal:
            fixed = np.where(unknowns.fields[0].fixed, prescribed, 0.0)
            given = unknowns.restrict([p]) - unknowns.restrict(self.times(fixed).arrays)
            guess = self._cg(given, guess)
        unknowns.expand(guess, [prescribed], out)
        return out

    def accelerations(self, forces: Nodal) -> Array:
        """Accelerations of the nodes by forces (m/s²), shape (nodes, d). Collective.

        A `SingularMassWarning` tells once that forces along motions without mass are left out.
        Explicit steps have no stiffness to balance them, and such a body is too stiff: with one
        row of quadratic splines and two rows of points it swung at twice its frequency.

        Args:
            forces: Forces (N), summed at the nodes' owners.
        """
        found = self.solve(forces, np.zeros_like(forces.arrays[0])).arrays[0]
        if self.lost > _LOST and not self._terms.warned:
            self._terms.warned = True
            warn(
                self.comm,
                f"the consistent mass is singular, and {100 * min(self.lost, 1.0):.0f} % of the "
                "forces act along motions of nodes that move no point. Steps leave these forces "
                f"out, and the body is too stiff; give {self._advice()}",
                SingularMassWarning,
            )
        return found

    @cached_property
    def _unknowns(self) -> Unknowns:
        here = self._here
        if len(here.fields) == 1:
            return here.unknowns
        one = here.unknowns.fields[self._k]
        return Unknowns([one.numbering], [one.nodes], [one.fixed])

    def _cg(self, right: Array, guess: Array) -> Array:
        """Conjugate gradients with the diagonal of the matrix, or with its factors. Collective."""
        unknowns = self._unknowns
        if unknowns.total == 0:
            return guess
        if self._solver is None:
            self._solver = self._solver_of(unknowns)
        ksp = self._solver
        matrix, _ = ksp.getOperators()
        b, x = matrix.createVecRight(), matrix.createVecRight()
        b.getArray()[:], x.getArray()[:] = right, guess
        rest = b.duplicate()
        matrix.mult(x, rest)
        rest.aypx(-1.0, b)
        if rest.norm() > b.norm():
            # forces over the lumped mass are a bad guess at nodes with very few points
            x.set(0.0)
        ksp.solve(b, x)
        self.iterations = ksp.getIterationNumber()
        if ksp.getConvergedReason() > 0:
            self.singular |= _gain(matrix, b, x) > _GAIN
            return np.array(x.getArray(readonly=True))
        self.singular, error = True, None
        found = solution_without_null_vectors(matrix, b)
        if found is None:
            error = ConvergenceError(
                f"the consistent mass is singular to rounding: CG ends after {self.iterations} "
                f"iterations; give {self._advice()}"
            )
        raise_together(unknowns.comm, error)
        assert found is not None
        x.getArray()[:] = found
        matrix.mult(x, rest)
        rest.aypx(-1.0, b)
        self.lost = max(self.lost, rest.norm() / max(b.norm(), np.finfo(float).tiny))
        return found

    def assembled(self) -> Matrix:
        """The mass as a matrix of the field's unknowns. Collective."""
        unknowns = self._unknowns
        matrix = Matrix(self._pattern(unknowns), unknowns)
        self.add_to(matrix, unknowns)
        return matrix

    def _pattern(self, unknowns: Unknowns) -> Pattern:
        """The pattern of the mass alone, without other couplings of the activation. Collective."""
        pairs = [(b.rows, b.columns) for b in self.blocks]
        lists = [(self._field.stencils.node_start, self._field.stencils.nodes)]
        return Pattern.build(lists, unknowns, pairs, None)

    def _solver_of(self, unknowns: Unknowns) -> PETSc.KSP:
        here = self._here
        pattern = here.pattern if unknowns is here.unknowns else self._pattern(unknowns)
        matrix = self._terms.matrix(pattern, unknowns)
        self.add_to(matrix, unknowns)
        ksp = PETSc.KSP().create(unknowns.comm)
        ksp.setType("cg")
        pc = ksp.getPC()
        pc.setType("jacobi")
        mass = Tangent(symmetric=True, definite=True, softened=False)
        many = unknowns.total >= crossover(mass, self._terms.points.gdim)
        ksp.setTolerances(rtol=_TOLERANCE, atol=0.0, max_it=_MOST)
        ksp.setInitialGuessNonzero(True)
        ksp.setOperators(matrix.petsc)
        if self._terms.factorised and not many:
            ksp.setOptionsPrefix(_PREFIX)
            if unknowns.comm.size == 1:
                # a message of CHOLMOD for each step is no help; PETSc tells of options in vain
                PETSc.Options(_PREFIX)["mat_cholmod_print"] = 0
            set_cholesky(pc, matrix.petsc)
            try:
                ksp.setUp()
            except PETSc.Error as error:
                # on one rank CHOLMOD raises; a ghost penalty without cut cells leaves null vectors
                if error.ierr not in FACTORISATION:
                    raise
                pc.setType("jacobi")
        return ksp


def _gain(matrix: PETSc.Mat, b: PETSc.Vec, x: PETSc.Vec) -> float:
    """b · x over b · D⁻¹ b, of the solution x of M x = b. Collective."""
    scaled = b.duplicate()
    scaled.pointwiseDivide(b, matrix.getDiagonal())
    own = b.dot(scaled)
    return float(b.dot(x) / own) if own > 0.0 else 0.0
