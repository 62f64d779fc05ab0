"""Condition numbers and critical time steps of a problem in its present state."""

from __future__ import annotations

from dataclasses import dataclass, replace

import ufl

from dolfinmpm._platform.argumentchecks import check_kind, number
from dolfinmpm._platform.collective import collective
from dolfinmpm.assembly.stencilsums import Matrix
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.cut.activation import Activation
from dolfinmpm.cut.penalties import GHOST_FACTORS, ghost
from dolfinmpm.cut.stabilisations import Stabilisation
from dolfinmpm.dynamics.mass import MassTerms
from dolfinmpm.dynamics.nodalmass import Mass
from dolfinmpm.grid.lattice import cell_size, mean_size
from dolfinmpm.solve.quasistatic import QuasiStatic
from dolfinmpm.solve.spectra import condition_number, critical_step, rigid_modes

__all__ = ["Conditioning", "conditioning"]


@dataclass(frozen=True)
class Conditioning:
    """Condition numbers and critical steps of a body at its present place.

    Attributes:
        kappa_K, kappa_M: Condition numbers (-) of the stiffness, without rigid modes, and of the
            consistent mass.
        dt_consistent: Critical step (s) with the consistent mass.
        dt_lumped: Critical step (s) with the lumped mass of explicit steps: row sums M_L without
            penalty, or Cᵀ M_L C with constraints C.
        unknowns: Number of unknowns.

    >>> import dolfinmpm as mpm
    >>> from mpi4py import MPI
    >>> grid = mpm.create_lattice(MPI.COMM_WORLD, [range(5), range(5)])
    >>> points = mpm.fill(grid, mpm.Box((0, 0), (4, 2)), per_cell=2, density=2000.0)
    >>> V = mpm.Space(grid, "gimp")
    >>> F = mpm.momentum(mpm.materials.Hencky(1e6, 0.3), points, V.increment, V.test)
    >>> bcs = mpm.fixed(V, "bottom")
    >>> problem = mpm.QuasiStatic(F, V.increment, points, bcs, stabilisation="ghost")
    >>> found = mpm.study.conditioning(problem, density=2000.0)
    >>> 0 < found.dt_consistent < found.dt_lumped
    True
    """

    kappa_K: float
    kappa_M: float
    dt_consistent: float
    dt_lumped: float
    unknowns: int


@collective
def conditioning(
    problem: QuasiStatic, density: float, factor: float = 1.0, extra: ufl.Form | None = None
) -> Conditioning:
    """Condition numbers and critical steps of a problem in its present state. Collective.

    The mass gets the stabilisation of the stiffness. A ghost penalty has γ = ρ/4 times the factor
    of the basis. Aggregation has the same constraints. Weak aggregation has the penalty ρ h^d.
    Soft stiffness does not act on the mass.

    Args:
        problem: Problem whose tangent is K.
        density: Density ρ (kg/m^d) that scales the penalties of the mass.
        factor: Factor of the penalties of the mass (-), not negative.
        extra: Form that is added to the consistent mass, such as your own penalty. A penalty of
            the stiffness is in the form of the problem.

    Raises:
        ParameterError: The problem has no tangent; density is not positive; factor is negative; or
            extra is no UFL form.

    >>> import dolfinmpm as mpm
    >>> from mpi4py import MPI
    >>> grid = mpm.create_lattice(MPI.COMM_WORLD, [range(5), range(5)])
    >>> points = mpm.fill(grid, mpm.Box((0, 0), (4, 2)), per_cell=2, density=2000.0)
    >>> V = mpm.Space(grid, "gimp")
    >>> F = mpm.momentum(mpm.materials.Hencky(1e6, 0.3), points, V.increment, V.test)
    >>> bcs = mpm.fixed(V, "bottom")
    >>> problem = mpm.QuasiStatic(F, V.increment, points, bcs, stabilisation="ghost")
    >>> found = mpm.study.conditioning(problem, density=2000.0)
    >>> round(found.kappa_K), found.unknowns
    (49, 20)
    """
    check_kind("problem", problem, QuasiStatic, "give a problem with a tangent")
    number("density", density, 0.0, unit="kg/m^d")
    number("factor", factor, 0.0, closed=True)
    if extra is not None:
        check_kind("extra", extra, ufl.Form, "give a form over points.dX, points.dS or points.dC")
    stiffness, points = problem, problem.points
    space, stabilisation = stiffness.fields[0].space, stiffness.fields[0].stabilisation
    u, v = space.increment, space.test
    form = ufl.inner(points.density * u, v) * points.dX
    if extra is not None:
        form += extra
    tied: Stabilisation | str = "none"
    if stabilisation.kind == "ghost" and factor > 0:
        penalty = factor * GHOST_FACTORS[space.basis.degree] * density / 4
        form += ghost(points, u, v, penalty, scaling="literal")
    elif stabilisation.kind in ("aggregation", "extended"):
        tied = stabilisation
    elif stabilisation.kind == "weak-aggregation" and factor > 0:
        size = mean_size(cell_size(points.grid))
        tied = replace(stabilisation, E=density * size**2, factor=factor)
    inertia = QuasiStatic(
        form, u, points, stiffness.bcs, stabilisation=tied, options_prefix="mass_"
    )
    K, M = stiffness.stiffness(), inertia.stiffness()
    assert stiffness.here is not None
    return Conditioning(
        condition_number(K, kernel=rigid_modes(stiffness.here)),
        condition_number(M),
        critical_step(K, M),
        critical_step(K, _lumped(points, stiffness.here).petsc),
        stiffness.here.unknowns.total,
    )


def _lumped(points: MaterialPoints, here: Activation) -> Matrix:
    """Lumped mass matrix of explicit steps. Collective."""
    terms = MassTerms(points, "lumped")
    return Mass(terms, replace(here, blocks=terms.blocks(here.fields))).assembled()
