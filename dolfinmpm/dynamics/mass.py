"""Terms of the mass: lumped or consistent, with a ghost penalty, with any constraints C."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm._platform.argumentchecks import number
from dolfinmpm._platform.errors import ParameterError
from dolfinmpm.assembly.stencilsums import Matrix
from dolfinmpm.assembly.term import Term
from dolfinmpm.basis.space import Space
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.cut.activation import ActiveField, Field, movers
from dolfinmpm.cut.pattern import Blocks, Pattern
from dolfinmpm.cut.penalties import GHOST_FACTORS, ghost
from dolfinmpm.cut.prolongation import reduce_blocks
from dolfinmpm.cut.unknowns import Unknowns
from dolfinmpm.dynamics.transfer import mass_entries, scatter
from dolfinmpm.forms.declarations import rows_within
from dolfinmpm.solve.weakform import WeakForm

__all__ = ["KINDS", "MassTerms", "mass_terms", "point_masses"]

Array = npt.NDArray[np.float64]
KINDS = ("consistent", "lumped")


def point_masses(points: MaterialPoints) -> Array:
    """Masses of this rank's points (kg), shape (points,)."""
    return points["density"] * points["V0"]


class MassTerms(Term):
    """Terms of the mass of the fields that move points, on any activation.

    Args:
        points: Material points.
        kind: "consistent", or "lumped" by row sums: M_L, diagonal in all active nodes. With
            constraints C it is Cᵀ M_L C, which couples independent nodes. (Row sums of the
            constrained mass could be small or negative.) With the functions N of all active
            nodes and the points' masses m, N C (Cᵀ M_L C)⁻¹ Cᵀ Nᵀ m has no eigenvalue above 1, and
            keeps rigid velocities. So the mapping to the nodes and back gives points no energy.
        spaces: Spaces of the problem's fields; needed for a ghost penalty.
        direct: Whether the problem factorises tangents. Splines need a ghost penalty that slows
            down diagonally preconditioned iterations to hundreds. Then the mass is factorised too.

    Attributes:
        points, kind: The arguments.
        ghost: Ghost penalty of the mass, γ_M J, or None; see `penalise`.
        factorised: Whether the mass is factorised.
    """

    def __init__(
        self,
        points: MaterialPoints,
        kind: str,
        spaces: Sequence[Space] = (),
        direct: bool = False,
    ):
        self.points, self.kind, self._spaces, self._direct = points, kind, spaces, direct
        self.ghost: WeakForm | None = None
        #: Largest density of each space when a run gave itself a ghost penalty (kg/m^d), or empty.
        self.densities: list[float] = []
        self.factorised = False
        self._matrix: Matrix | None = None
        #: Whether a warning about a nearly singular mass has been given.
        self.warned = False

    def __repr__(self) -> str:
        return f"{self.kind} mass" + ("" if self.ghost is None else " with a ghost penalty")

    @property
    def moving(self) -> set[int]:
        """See `Term`."""
        return set() if self.ghost is None else self.ghost.moving

    def penalise(
        self, factors: Mapping[Space, float] | None = None, densities: Sequence[float] = ()
    ) -> None:
        """Give the mass a ghost penalty, γ_M J. Collective.

        Args:
            factors: γ_M of each space that moves points, in units of the largest density; the
                defaults of `Newmark` if None.
            densities: Largest density of each space (kg/m^d); by default that of the points. That
                of a mixture with water changes from step to step, so a run that goes on from a
                checkpoint takes the density at which its penalty began.
        """
        late = factors is None
        if factors is None:
            own = [self._spaces[k] for k in movers(self._spaces)]
            factors = {space: _penalty_factor(space) for space in own}
        found = [space for space, factor in factors.items() if factor]
        if len(densities) != len(found):
            densities = [_largest_density(space, self.points) for space in found]
        J = [
            ghost(self.points, space.increment, space.test, factors[space] * one, scaling="literal")
            for space, one in zip(found, densities)
        ]
        self.densities = list(densities) if late else []
        if J:
            self.ghost = WeakForm(sum(J[1:], start=J[0]), self._spaces, self.points)
            self.factorised = self._direct and any(space.basis.degree > 1 for space in factors)

    def release(self) -> None:
        """Take a ghost penalty away that a run gave itself."""
        if self.densities:
            self.ghost, self.densities, self.factorised = None, [], False

    def blocks(self, fields: Sequence[ActiveField]) -> dict[str, list[Blocks]]:
        """See `Term`: the mass between the independent nodes of C. Collective."""
        own = movers([field.space for field in fields])
        found = [self._of(k, fields[k]) for k in own]
        if self.ghost is not None:
            grid = self.ghost.blocks(fields).get("stiffness", [])
            found += [b for b in grid if b.row_field == b.column_field and b.row_field in own]
        return {"mass": found}

    def regrid(self) -> None:
        """See `Term`."""
        if self.ghost is not None:
            self.ghost.regrid()

    def _of(self, k: int, field: ActiveField) -> Blocks:
        """The mass of the k-th field, without a penalty."""
        mass = point_masses(self.points)
        unit = np.eye(field.space.components)
        if self.kind == "lumped":
            sums = np.zeros((field.basis.nodes.size, 1))
            scatter(field.full_stencils, mass, np.ones((len(mass), 1)), sums)
            nodes = field.active
            single = Blocks(k, k, nodes, nodes, sums[nodes, :, None] * unit)
            return single if field.C is None else reduce_blocks(field.C, field.C, single)
        rows, columns, values = mass_entries(field.stencils, mass)
        return Blocks(k, k, rows, columns, values[:, None, None] * unit)

    def matrix(self, pattern: Pattern, unknowns: Unknowns) -> Matrix:
        """A matrix with a pattern. The same pattern gives the same matrix object. Collective."""
        kept = self._matrix is not None and self._matrix.pattern is pattern
        if self._matrix is None or not unknowns.comm.allreduce(kept, op=MPI.LAND):
            self._matrix = Matrix(pattern, unknowns)
        return self._matrix


def mass_terms(
    form: WeakForm,
    fields: Sequence[Field],
    mass: str,
    ghost_mass: float | None,
    direct: bool = False,
) -> MassTerms:
    """The terms of the mass of a problem. Collective.

    Args:
        form: The weak form.
        fields: The problem's fields.
        mass: "consistent" or "lumped".
        ghost_mass: γ_M in units of the largest density, see `Newmark`; None for the default.
        direct: See `MassTerms`.

    Raises:
        ParameterError: A ghost penalty is given with a lumped mass, or is negative.
    """
    points = form.points
    moving = [fields[k] for k in movers([field.space for field in fields])]
    if mass == "lumped":
        if ghost_mass:
            raise ParameterError(
                f"ghost_mass = {ghost_mass} is of a consistent mass, and lumping takes away what a "
                'ghost penalty adds; give mass="consistent"'
            )
        return MassTerms(points, mass)
    if ghost_mass is not None:
        number("ghost_mass", ghost_mass, 0.0, closed=True)
    terms = MassTerms(points, mass, form.spaces, direct)
    terms.penalise({f.space: _default(f) if ghost_mass is None else ghost_mass for f in moving})
    return terms


def _default(field: Field) -> float:
    """The factor of the ghost penalty of a field's mass, see `Newmark`."""
    tied = field.constrains_nodes and field.stabilisation.kind != "weak-aggregation"
    # cells beside tied sides look like cut cells, and are whole ones
    tied = tied or hasattr(field.prolongate, "of_basis")
    return 0.0 if tied else _penalty_factor(field.space)


def _penalty_factor(space: Space) -> float:
    """Default γ_M of a space: 1/4 as in Coombs (2023), times the factor of its basis."""
    return 0.25 * GHOST_FACTORS[space.basis.degree]


def _largest_density(space: Space, points: MaterialPoints) -> float:
    """Largest density of the points of a space (kg/m^d). Collective."""
    own = points["density"][rows_within(points, space.tags)]
    return points.comm.allreduce(float(own.max(initial=0.0)), op=MPI.MAX)
