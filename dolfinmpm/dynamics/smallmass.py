"""Filters of light nodes in explicit steps, and bulk viscosity."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt
from mpi4py import MPI
from petsc4py import PETSc

from dolfinmpm._platform.argumentchecks import number
from dolfinmpm._platform.errors import LostMomentumWarning, ParameterError, warn
from dolfinmpm.basis.stencils import Stencils, gather
from dolfinmpm.body.axisymmetry import full_gradient
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.dynamics.critical import cell_sizes_at, wave_speed
from dolfinmpm.dynamics.nodalmass import Mass
from dolfinmpm.grid.lattice import smallest_height

__all__ = ["BulkViscosity", "check_filters", "checked_viscosity", "filters"]

Array = npt.NDArray[np.float64]

# Largest share of a mass cut-off without a warning; nodes at the surface of a body have more
_LARGEST_CUT = 0.01

# Largest coefficient of bulk viscosity; usual ones are about 1
_MOST_VISCOUS = 1e6


class Filter(Protocol):
    """A filter of light nodes."""

    def act(self, V: Array, f: Array, mass: Mass, s: Stencils) -> None:
        """Change velocities (m/s) and forces (N) of the nodes, shape (nodes, d). Collective."""


def _largest(mass: Mass) -> float:
    return mass.comm.allreduce(float(mass.lumped.max(initial=0.0)), op=MPI.MAX)


class MassCutOff:
    """Nodes with too little mass stand still (Sulsky, Zhou & Schreyer 1995).

    Their forces are lost, and with them momentum of the body. A box under a uniform load loses up
    to 0.5 % of it in 200 steps of "musl" with shares from 0.001 to 0.01, and 85 % with 0.1.

    Args:
        share: Share of the largest nodal mass below which nodes stand still.
    """

    def __init__(self, share: float):
        self.share = share

    def act(self, V: Array, f: Array, mass: Mass, s: Stencils) -> None:
        """See `Filter`."""
        light = mass.lumped < self.share * _largest(mass)
        V[light] = f[light] = 0.0


class Redistribution:
    """Light nodes pass a part of their forces to their neighbours.

    A node keeps the share m/m₀ of its force; m₀ is a share of the largest mass. The rest goes to
    the heavier nodes that share a point with it, in proportion to their masses. So the sum of
    forces stays, and no acceleration exceeds f/m₀ (after Ma, Giguere, Jayaraman & Zhang
    2010, J. Comput. Phys. 229).

    Args:
        share: m₀ over the largest nodal mass.
    """

    def __init__(self, share: float):
        self.share = share

    def act(self, V: Array, f: Array, mass: Mass, s: Stencils) -> None:
        """See `Filter`."""
        m, bound = mass.lumped, self.share * _largest(mass)
        light = (m > 0) & (m < bound)
        if not mass.comm.allreduce(bool(light.any()), op=MPI.LOR):
            return
        near, owned = _neighbours(light, mass, s), mass.nodes.owned
        heavy, weights = near.createVecs()
        heavy.getArray()[:] = np.where(light, 0.0, m)[:owned]
        near.mult(heavy, weights)
        total = weights.getArray().copy()
        # a node without heavier neighbours keeps its force
        given = np.where(light[:owned] & (total > 0), 1.0 - m[:owned] / bound, 0.0)
        per_weight, taken = given / np.maximum(total, 1e-300), heavy.duplicate()
        for k in range(f.shape[1]):
            weights.getArray()[:] = per_weight * f[:owned, k]
            near.multTranspose(weights, taken)
            f[:owned, k] += heavy.getArray() * taken.getArray() - given * f[:owned, k]


def _neighbours(light: npt.NDArray[np.bool_], mass: Mass, s: Stencils) -> PETSc.Mat:
    """Matrix with 1 if a light node (row) and a node (column) share a point. Collective."""
    from scipy import sparse

    groups, owned = s.node_start.size - 1, mass.nodes.owned
    ones = np.ones(s.nodes.size)
    seen = sparse.csr_matrix((ones, s.nodes, s.node_start), shape=(groups, light.size))
    at = np.flatnonzero(light)
    near = sparse.csr_matrix(seen.T.tocsr()[at] @ seen)
    to_global = mass.nodes.index_map.local_to_global
    rows = to_global(at.astype(np.int32)).astype(PETSc.IntType)
    columns = to_global(near.indices.astype(np.int32)).astype(PETSc.IntType)
    size = (owned, mass.nodes.index_map.size_global)
    found = PETSc.Mat().createAIJ((size, size), comm=mass.comm)
    found.setOption(PETSc.Mat.Option.NEW_NONZERO_ALLOCATION_ERR, False)
    found.setUp()
    for row, first, last in zip(rows, near.indptr, near.indptr[1:]):
        # a pair known to several ranks counts once
        found.setValues(row, columns[first:last], ones[: last - first], PETSc.InsertMode.INSERT)
    found.assemble()
    return found


def filters(mass_cutoff: Any, redistribution: Any) -> list[Filter]:
    """The filters by the user's arguments.

    Raises:
        ParameterError: A share is not in [0, 1].
    """
    found: list[Filter] = []
    if number("mass_cutoff", mass_cutoff, 0.0, 1.0, closed=True) > 0:
        found.append(MassCutOff(mass_cutoff))
    if number("redistribution", redistribution, 0.0, 1.0, closed=True) > 0:
        found.append(Redistribution(redistribution))
    return found


def check_filters(space: Any, given: Sequence[Filter], collision: Any) -> None:
    """Raise if a refined space comes with what compares masses of nodes with each other.

    The nodes of small leaves are light, wherever they are. LostMomentumWarning tells of a mass
    cut-off that stops bodies. Collective.

    Args:
        space: The space of the displacement.
        given: The filters of light nodes.
        collision: The `Collision`, or None.

    Raises:
        ParameterError: The space is refined, and there is a filter or a collision.
    """
    if space.refinement is None:
        _warn_of_lost_momentum(space.grid.comm, given)
        return
    if given:
        raise ParameterError(
            "mass_cutoff and redistribution are shares of the largest nodal mass, and nodes of "
            "small leaves have less than those of large ones: leave them out, or leave out "
            "refine= of the space"
        )
    if collision is not None:
        raise ParameterError(
            "Collision needs cells of one size, and the space is refined: leave out refine=, or "
            "give each body a field of its own and take mpm.contact_between in implicit steps"
        )


def _warn_of_lost_momentum(comm: MPI.Comm, given: Sequence[Filter]) -> None:
    for one in given:
        if isinstance(one, MassCutOff) and one.share > _LARGEST_CUT:
            warn(
                comm,
                f"mass_cutoff = {one.share:g} is above {_LARGEST_CUT:g}: nodes at the surface of a "
                "body, with this much mass, stand still, and may stop the body; take "
                f"redistribution={one.share:g}, which keeps momentum",
                LostMomentumWarning,
            )


def checked_viscosity(given: Any) -> tuple[float, float]:
    """The two coefficients of bulk viscosity.

    Raises:
        ParameterError: The argument is not a pair of numbers of at least 0, or they are huge.
    """
    if not isinstance(given, (tuple, list)) or len(given) != 2:
        raise ParameterError(f"bulk_viscosity = {given!r} must be two numbers, as (0.06, 1.2)")
    linear, quadratic = (
        number(f"bulk_viscosity[{k}]", b, 0.0, _MOST_VISCOUS, closed=True)
        for k, b in enumerate(given)
    )
    return linear, quadratic


class BulkViscosity:
    """Bulk viscosity: the pressure ρ h (b₁ c |ε̇| + b₂² h ε̇²) in compression.

    Von Neumann & Richtmyer 1950, doi 10.1063/1.1699639. c is the speed of waves, h the size of a
    cell, and ε̇ the rate of the volumetric strain.

    Args:
        points: Material points.
        space: Space of the displacement.
        declarations: Laws in the form.
        coefficients: b₁ and b₂.

    Attributes:
        compression: Largest h |ε̇|/c of the last step; 0 where b₂ is 0.
    """

    compression = 0.0

    def __init__(
        self, points: MaterialPoints, space: Any, declarations: Sequence[Any],
        coefficients: tuple[float, float],
    ):  # fmt: skip
        self._points, self._space, self._declarations = points, space, declarations
        self._linear, self._quadratic = coefficients

    def pressure(self, s: Stencils, V: Array) -> Array:
        """−ρ h (b₁ c |ε̇| + b₂² h ε̇²) I times the points' volumes, in compression. Collective.

        Args:
            s: The points' stencils.
            V: Velocities of the nodes (m/s), shape (nodes, d).

        Returns:
            Shape (points, strain_dim, strain_dim) (N m).
        """
        points, (h, c) = self._points, self._cells_and_speeds()
        n, d = len(points), points.gdim
        velocity, gradient = np.empty((n, d)), np.empty((n, d, d))
        gather(s, V, velocity, gradient)
        whole = full_gradient(points, velocity, gradient)
        rate = np.minimum(np.trace(whole, axis1=1, axis2=2), 0.0)
        if self._quadratic:
            most = float(np.max(-h * rate / c, initial=0.0))
            self.compression = points.comm.allreduce(most, op=MPI.MAX)
        m, b, quadratic = points["density"] * points["V0"], self._linear, self._quadratic
        q = m * h * (b * c * -rate + quadratic**2 * h * rate**2)
        return -q[:, None, None] * np.eye(points.strain_dim)

    def shorten(self, longest: float) -> float:
        """The longest stable step (s), from that without viscosity. Collective.

        Forces by the velocities at the start of a step damp the fastest motion by the ratio ξ. The
        longest step is then Δt (√(1 + ξ²) − ξ) (Belytschko, Liu & Moran 2000, 6.2.5). Here ξ is
        h (b₁ + b₂² h |ε̇|/c)/c over Δt, with the ε̇ of the last step.

        Args:
            longest: Δt (s).
        """
        h, c = self._cells_and_speeds()
        most = self._points.comm.allreduce(float(np.max(h / c, initial=0.0)), op=MPI.MAX)
        ratio = most * (self._linear + self._quadratic**2 * self.compression) / longest
        return longest / (math.sqrt(1.0 + ratio**2) + ratio)

    def _cells_and_speeds(self) -> tuple[Array | float, Array]:
        """Sizes of the cells (m) and speeds of waves (m/s) at the points. Collective."""
        sizes = cell_sizes_at(self._points, self._space)
        speeds = wave_speed(self._points, self._declarations)
        return smallest_height(self._points.grid) if sizes is None else sizes, speeds
