"""The method for the linear systems of a problem, by the properties of the tangent."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from mpi4py import MPI
from petsc4py import PETSc

from dolfinmpm.forms.termqueries import depends_on, summands, term_of
from dolfinmpm.solve.weakform import WeakForm

__all__ = [
    "LATTICE",
    "SUBSTRUCTURES",
    "Method",
    "Tangent",
    "as_used",
    "choose",
    "crossover",
    "only_momentum",
    "symmetric",
]

# Number of unknowns from which conjugate gradients with multigrid are faster than factors, by
# dimension of space, measured on blocks of elastic soil (docs/benchmarks.md). Functions wider than
# two cells make rows four times as long. This costs iterations more than factors.
_CROSSOVER = {1: 10**9, 2: 250_000, 3: 9_000}
_CROSSOVER_OF_WIDE = {1: 10**9, 2: 250_000, 3: 60_000}
# The same with the lattice's own levels, by the degree of the functions. With cubic splines a sweep
# of Gauss–Seidel smooths little.
_CROSSOVER_ON_LATTICE = {
    1: {1: 10**9, 2: 50_000, 3: 7_000},
    2: {1: 10**9, 2: 50_000, 3: 20_000},
    3: _CROSSOVER_OF_WIDE,
}

# Number of unknowns from which factors may be kept for the next tangent, or incomplete factors may
# be tried. Below this number the decision costs more than new factors.
_KEPT = {1: 10**9, 2: 4_000, 3: 2_000}

# Smoothed aggregation (Vaněk, Mandel & Brezina 1996, doi 10.1007/BF02238511) on blocks with
# rigid modes. The graph is squared once, which makes coarse levels small. Couplings below the
# threshold do not aggregate.
_MULTIGRID = {
    "pc_gamg_type": "agg",
    "pc_gamg_agg_nsmooths": 1,
    "pc_gamg_threshold": 0.01,
    "pc_gamg_reuse_interpolation": True,
    "mg_levels_ksp_type": "chebyshev",
    "mg_levels_pc_type": "jacobi",
}

# Wide functions in 3D overlap so much that Jacobi's method does not smooth oscillations. Cycles
# with Gauss–Seidel need a tenth of the iterations. Rows are long, and no coupling is dropped. In 2D
# Gauss–Seidel needs half of the iterations, but more time.
_MULTIGRID_OF_WIDE = {**_MULTIGRID, "mg_levels_pc_type": "sor", "pc_gamg_threshold": 0.0}


# Multigrid on the lattice's own levels (`dolfinmpm.solve.latticelevels`). One symmetric sweep of
# Gauss–Seidel smooths. It needs no estimate of eigenvalues, and takes wide functions as well.
LATTICE = {
    "pc_mg_galerkin": "pmat",
    "mg_levels_ksp_type": "richardson",
    "mg_levels_ksp_max_it": 1,
    "mg_levels_pc_type": "sor",
}

# A displacement and a pressure: the upper factor of the block LDU decomposition, with one cycle of
# multigrid per block (White & Borja 2011, doi 10.1007/s10596-011-9233-7). `dolfinmpm.solve.schur`
# approximates S. Incomplete factors smooth in the multigrid of S: with Jacobi or Gauss–Seidel, cut
# cells need two to three times the iterations. Products use the approximate S, because a product
# with the true S needs a cycle for the first block.
_BLOCKS = {
    "pc_fieldsplit_type": "schur",
    "pc_fieldsplit_schur_fact_type": "upper",
    "fieldsplit_u_ksp_type": "preonly",
    "fieldsplit_u_pc_type": "gamg",
    **{f"fieldsplit_u_{name}": value for name, value in _MULTIGRID.items()},
    "fieldsplit_p_ksp_type": "preonly",
    "fieldsplit_p_pc_type": "gamg",
    "fieldsplit_p_pc_use_amat": False,
    "fieldsplit_p_pc_gamg_agg_nsmooths": 1,
    "fieldsplit_p_pc_gamg_threshold": 0.01,
    "fieldsplit_p_mg_levels_ksp_type": "richardson",
    "fieldsplit_p_mg_levels_pc_type": "bjacobi",
}


# Factors by CHOLMOD on several ranks, with one substructure per rank
SUBSTRUCTURES = "substructures"
_NAMES = {SUBSTRUCTURES: "CHOLMOD in substructures"}
# PETSc's names of factorisations
_FACTORISE = ("lu", "cholesky")


@dataclass(frozen=True)
class Tangent:
    """Known properties of a tangent.

    Attributes:
        symmetric: Whether the tangent is symmetric.
        definite: Whether a symmetric tangent counts as positive definite.
        softened: Whether the matrix also has soft stiffness, and so only preconditions.
        fields: Number of fields.
        porous: Whether the fields are a displacement and a scalar.
        wide: Whether functions of the displacement are wider than two cells (splines), or averaged
            over domains (GIMP).
        degree: Degree of the functions if the lattice's own levels make multigrid, else 0.
    """

    symmetric: bool
    definite: bool
    softened: bool
    fields: int = 1
    porous: bool = False
    wide: bool = False
    degree: int = 0


@dataclass(frozen=True)
class Method:
    """A linear solver.

    Attributes:
        ksp, pc, package: PETSc's names. Only factors have a package; it is `SUBSTRUCTURES` for
            `dolfinmpm.solve.substructures`.
        why: Reason of the choice, in words.
        keeps: Whether the preconditioner may be kept for a later tangent.
        options: Further PETSc options by name, without prefix.
    """

    ksp: str
    pc: str
    package: str
    why: str
    keeps: bool = False
    options: dict[str, object] = field(default_factory=dict)

    @property
    def factors(self) -> bool:
        """Whether the method factorises the tangent."""
        return self.pc in _FACTORISE

    @property
    def incomplete(self) -> bool:
        """Whether incomplete factors precondition."""
        return self.pc in ("ilu", "bjacobi")

    def like(self, other: Method) -> bool:
        """Whether another method is the same, perhaps for another reason."""
        return (self.ksp, self.pc, self.package) == (other.ksp, other.pc, other.package)

    def __str__(self) -> str:
        name = {
            "lu": "LU", "cholesky": "Cholesky", "gamg": "GAMG", "ilu": "incomplete LU",
            "bjacobi": "incomplete LU per rank", "mg": "multigrid of the lattice",
        }.get(self.pc, self.pc)  # fmt: skip
        package = f" by {_NAMES.get(self.package, self.package.upper())}" if self.package else ""
        outer = "" if self.ksp == "preonly" else f"{self.ksp.upper()} with "
        return f"{outer}{name}{package}: {self.why}"


def as_used(method: Method, ksp: PETSc.KSP) -> Method:
    """The method with the changes by options, for reports.

    Args:
        method: The chosen method.
        ksp: PETSc's solver after it has read the options.
    """
    pc = ksp.getPC()
    kind = pc.getType()
    if kind == "python":
        # PETSc calls factors of substructures "python"
        kind = method.pc
    package = pc.getFactorSolverType() if kind in _FACTORISE and pc.getType() == kind else None
    if package is None and kind == method.pc:
        package = method.package
    found = replace(method, ksp=ksp.getType(), pc=kind, package=package or "")
    return method if found.like(method) else replace(found, why="chosen by options")


def only_momentum(form: WeakForm, boundaries: bool = True) -> bool:
    """Whether momentum terms alone make the internal forces, so that the points' stress gives them.

    Penalties on the increment do not count, because they vanish for zero increments. Contacts do
    not count, because they are no integrals over the points.

    Args:
        form: The weak form.
        boundaries: Whether terms over boundaries, and over faces of points, count.
    """
    own = [term for d in form.parts.declarations for term in d.terms]
    increments = [space.increment for space in form.spaces]
    for integral in form.given.integrals():
        if term_of(integral) or any(integral.integrand() is term for term in own):
            continue
        metadata = integral.metadata() or {}
        if not boundaries and ("boundary" in metadata or "surface" in metadata):
            continue
        inside = metadata.get("points")
        for term in summands(integral.integrand()):
            if inside is not None and depends_on(term, increments):
                return False
    return bool(own) and form.parts.grid.linear


def symmetric(form: WeakForm) -> bool:
    """Whether the tangent of a form is symmetric, by its laws and terms. Collective.

    No other term may depend on the increment, such as a follower pressure. (A follower pressure of
    zero would pass a test of the matrix.) Terms over the grid are linear: any tangent shows them.
    """
    laws = form.parts.declarations
    if not all(term.symmetric for term in form.terms):
        return False
    found = only_momentum(form) and all(
        d.law.symmetric and d.strain != "jaumann" and not d.fbar for d in laws
    )
    # parameters of a law may be arrays that differ from rank to rank
    return bool(form.points.comm.allreduce(found, op=MPI.LAND))


def crossover(tangent: Tangent, gdim: int) -> int:
    """Number of unknowns from which iterations are faster than factors."""
    if tangent.degree and tangent.fields == 1:
        return _CROSSOVER_ON_LATTICE[tangent.degree][gdim]
    return (_CROSSOVER_OF_WIDE if tangent.wide and tangent.fields == 1 else _CROSSOVER)[gdim]


def choose(
    tangent: Tangent,
    count: int,
    gdim: int,
    ranks: int,
    direct: bool = False,
    incomplete: bool = False,
    substructures: bool = False,
) -> Method:
    """The method for a tangent.

    Incomplete factors without fill (Meijerink & van der Vorst 1977, doi
    10.1090/S0025-5718-1977-0438681-4) cost a tenth of factors if few iterations are enough, such
    as with much inertia. `dolfinmpm.solve.solverchoice` finds out whether they are enough.

    Args:
        tangent: Known properties of the tangent.
        count: Unknowns on all ranks.
        gdim: Dimension of space.
        ranks: Number of ranks.
        direct: Whether only factors remain, because iterations have failed.
        incomplete: Whether incomplete factors may precondition an unsymmetric tangent.
        substructures: Whether each of several ranks may factorise a substructure.
    """
    kind = "symmetric" if tangent.symmetric else "unsymmetric"
    if tangent.symmetric and tangent.definite:
        kind += " positive definite"
    if tangent.fields > 1:
        direct = direct or not tangent.porous
        kind += f" of {tangent.fields} fields"
    if (
        incomplete
        and not tangent.symmetric
        and not tangent.softened
        and tangent.fields == 1
        and count >= _KEPT[gdim]
    ):
        pc = "ilu" if ranks == 1 else "bjacobi"
        return Method("gmres", pc, "", f"{count} unknowns, {kind}, at the least cost so far", True)
    least = crossover(tangent, gdim)
    if count >= least and not direct:
        why = f"{count} unknowns, {kind} in {gdim}D, from {least} on"
        if tangent.fields > 1:
            return Method("gmres", "fieldsplit", "", why, True, _BLOCKS)
        krylov = (
            "cg" if tangent.symmetric and tangent.definite and not tangent.softened else "gmres"
        )
        if tangent.degree:
            return Method(krylov, "mg", "", why, True, LATTICE)
        cycles = _MULTIGRID_OF_WIDE if tangent.wide and gdim == 3 else _MULTIGRID
        return Method(krylov, "gamg", "", why, True, cycles)
    why = f"{count} unknowns, {kind}"
    ksp = "gmres" if tangent.softened else "preonly"
    keeps = count >= _KEPT[gdim] and not tangent.softened
    if keeps:
        # with new factors a Krylov method needs one iteration
        ksp = "cg" if tangent.symmetric and tangent.definite else "gmres"
    if not tangent.symmetric:
        return Method(ksp, "lu", "mumps", why, keeps)
    if tangent.definite and ranks == 1:
        return Method(ksp, "cholesky", "cholmod", why, keeps)
    if tangent.definite and substructures:
        return Method(ksp, "cholesky", SUBSTRUCTURES, why, keeps)
    return Method(ksp, "cholesky", "mumps", why, keeps)
