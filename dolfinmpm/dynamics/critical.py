"""The critical step of explicit integration, from wave speed and grid or by the eigenproblem."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm._platform.errors import ParameterError
from dolfinmpm.assembly.stencilsums import Matrix
from dolfinmpm.basis import LatticeBasis
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.cut.activation import Activation
from dolfinmpm.dynamics.mass import MassTerms
from dolfinmpm.dynamics.nodalmass import Mass
from dolfinmpm.grid.lattice import smallest_height
from dolfinmpm.solve import spectra
from dolfinmpm.solve.operator import Operator
from dolfinmpm.solve.weakform import WeakForm

__all__ = ["cell_sizes_at", "critical_step", "exact_step", "wave_speed"]

Array = npt.NDArray[np.float64]

# Smallest stable step of a bar with any cut, in h/c, by degree of the functions and by averaging
# over domains. Lumped linear functions have no lower bound: their step goes to 0 with the share of
# a point in a node; 1 is the step of full cells. In two dimensions, at ν = 0.45, quadratic and
# cubic splines have 3 % and 12 % less; a Courant number of 0.8 covers this. GIMP has no lower bound
# either if domains of points are trimmed to slivers.
_LUMPED = {(1, False): 1.0, (1, True): 0.66, (2, False): 0.88, (3, False): 1.4}
_LUMPED |= {(2, True): 1.1, (3, True): 1.4}
# Consistent mass with the usual ghost penalty, in a bar; linear functions in full cells have 1/√3
_CONSISTENT = {1: 0.5, 2: 0.42, 3: 0.25}
# Linear functions and GIMP in two and three dimensions: full free cells with 2² and 2³ points have
# 0.41 and 0.35, blocks that end at a side of the grid and are cut elsewhere 0.27 to 0.5. A Courant
# number of 0.8 covers these.
_CONSISTENT_BLOCK = 0.34
# The same with constraints C between nodes, which enlarge the spectrum. The values are below the
# minimum of some hundred cuts of bars, and of discs and blocks with ν = 0 ... 0.45 and 2² to 4²
# points per cell: consistent 0.23 (GIMP), 0.19 and 0.13; lumped 0.81, 1.06 and 1.25. Linear
# functions have no lower bound here either: a well-filled cell may have a single point at its edge.
# With cuts that leave points a tenth of a cell, they have 0.57 with a lumped mass. With a
# consistent mass they need a ghost penalty, or GIMP.
_TIED_CONSISTENT = {1: 0.2, 2: 0.18, 3: 0.11}
_TIED_LUMPED = {(1, False): 0.5, (1, True): 0.66, (2, False): 0.88, (2, True): 1.0}
_TIED_LUMPED |= {(3, False): 1.2, (3, True): 1.2}


def factor(basis: Any, mass: str, tied: bool = False, dimension: int = 1) -> float:
    """The critical step in units of h/c.

    Args:
        basis: Basis of the displacement.
        mass: "lumped" or "consistent".
        tied: Whether constraints C act between nodes.
        dimension: Dimension of space.
    """
    if mass == "consistent" and not tied and basis.degree == 1 and dimension > 1:
        return _CONSISTENT_BLOCK
    if mass == "consistent":
        return (_TIED_CONSISTENT if tied else _CONSISTENT)[basis.degree]
    averaged = isinstance(basis, LatticeBasis) and basis.averaged
    return (_TIED_LUMPED if tied else _LUMPED)[basis.degree, averaged]


def wave_speed(points: MaterialPoints, declarations: Sequence[Any]) -> Array:
    """Speed of pressure waves at the points, √(M/ρ₀) (m/s), shape (n,).

    M is the largest stiffness along one axis of the tangent of the Kirchhoff stress. Kirchhoff
    stress belongs to the mass per initial volume. For laws with Young's modulus and Poisson's
    ratio M is the elastic λ + 2μ.
    """
    stiffness = np.zeros(len(points))
    for declaration in declarations:
        stiffness[declaration.rows] = declaration.elastic.stiffness()
    return np.sqrt(stiffness / points.fields.read("density"))


def cell_sizes_at(points: MaterialPoints, space: Any) -> Array | None:
    """Size of the smallest leaf at each point (m), shape (n,); None without leaves. Collective."""
    if space.refinement is None:
        return None
    where = points.placement(space.configuration)
    leaves = space.refinement.update_leaves(where, space.basis.averaged)
    return np.asarray(leaves.smallest(where.x, where.half))


def critical_step(
    points: MaterialPoints,
    basis: Any,
    declarations: Sequence[Any],
    mass: str,
    tied: bool = False,
    sizes: Array | None = None,
) -> float:
    """min h / (c + |v|) times the factor of the basis (s). Collective.

    Args:
        points: Material points.
        basis: Basis of the displacement.
        declarations: Laws in the form.
        mass: "lumped" or "consistent".
        tied: Whether constraints C act between nodes.
        sizes: Size of the smallest cell at each point (m), shape (n,), for cells of several
            sizes; None for the smallest cell of the grid.

    Raises:
        ParameterError: No law has a stiffness.
    """
    speed = wave_speed(points, declarations)
    v = points.fields.read("velocity")
    # NumPy's norm of rows takes several times as long
    speed = speed + np.sqrt(np.einsum("pi,pi->p", v, v))
    fastest = points.comm.allreduce(float(speed.max(initial=0.0)), op=MPI.MAX)
    h = smallest_height(points.grid)
    if sizes is not None:
        shortest = (speed / sizes).max(initial=0.0)
        h = fastest / max(points.comm.allreduce(float(shortest), op=MPI.MAX), 1e-300)
    if not math.isfinite(fastest) or fastest <= 0.0:
        raise ParameterError(
            f"the fastest wave in the body has {fastest:g} m/s, so there is no critical step: "
            "give the form a law with a stiffness"
        )
    return factor(basis, mass, tied, points.gdim) * h / fastest


def exact_step(form: WeakForm, terms: MassTerms, here: Activation, mass_scaling: float) -> float:
    """2/√λ_max of tangent and mass (s), without penalties on the increment. Collective.

    Args:
        form: The weak form, whose tangent is compiled.
        terms: The terms of the mass.
        here: The activation.
        mass_scaling: Factor of the mass.
    """
    # explicit steps use no tangent, and so no penalties on the increment
    operator = Operator(form, replace(here, blocks={"mass": here.blocks_of("mass")}))
    operator.move_to_zero()
    K, M = (Matrix(here.pattern, here.unknowns) for _ in range(2))
    operator.tangent(K)
    Mass(terms, here, mass_scaling).add_to(M)
    return spectra.critical_step(K.petsc, M.petsc)
