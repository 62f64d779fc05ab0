"""Stabilisation against small cuts: terms of a few lines of UFL, and the choice of a remedy."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from dolfinx.mesh import Mesh
from scipy import sparse
from ufl.core.expr import Expr

from dolfinmpm._platform.errors import ParameterError
from dolfinmpm.basis import Placement, Stencils
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.cut.aggregation import MeshRoots, ties
from dolfinmpm.cut.fractions import fill_fractions, support_shares
from dolfinmpm.grid.constants import own_constant
from dolfinmpm.grid.lattice import cell_size
from dolfinmpm.materials.base import lame

__all__ = ["Stabilisation", "ghost", "soft"]

KINDS = ("none", "ghost", "aggregation", "weak-aggregation", "extended", "soft")

# Factors of the penalties for linear functions, quadratic and cubic splines
GHOST_FACTORS = {1: 1.0, 2: 1e2, 3: 1e4}
WEAK_FACTORS = {1: 1.0, 2: 0.3, 3: 0.1}
# Fill fractions below which they are tied to others
THRESHOLDS = {1: 0.5, 2: 0.7, 3: 0.9}


def _normal_derivative(w: Expr, side: str, k: int) -> Expr:
    """k-th derivative of w on one side of a facet, along the normal of its first side."""
    derivative = w
    for _ in range(k):
        derivative = ufl.grad(derivative)
    derivative = derivative(side)
    n = ufl.FacetNormal(ufl.domain.extract_unique_domain(w))("+")
    for _ in range(k):
        derivative = ufl.dot(derivative, n)
    return derivative


def ghost(
    points: MaterialPoints,
    u: Expr,
    v: Expr,
    gamma: float | Expr,
    order: int | None = None,
    scaling: str = "scaled",
) -> ufl.Form:
    """Ghost penalty: jumps of the increment's normal derivatives across ghost facets.

    Σ_{k=1..q} γ h^{2k+1} / ((2k+1) (k!)²) ∫ [[∂ₙᵏ u]] · [[∂ₙᵏ v]] dΓ
    (Burman 2010; Coombs 2023, doi 10.1002/nme.7332). It acts on the step's
    increment, so that nothing accumulates. On splines of degree q, which are smooth
    up to the derivative q − 1, only the term k = q is there.

    Args:
        points: Material points; the facets are those of their boundary cells.
        u: Increment of the step.
        v: Test function.
        gamma: γ. For a stiffness E/30 (Pa) works well, for a mass ρ/4 with
            `scaling="literal"`.
        order: q, the degree of the basis by default.
        scaling: "scaled" divides γ by h², so that the term scales with h as a
            stiffness does and conditioning does not depend on units; "literal" is
            the published form, with γ in Pa/m² (or kg/m³ for a mass).

    Raises:
        ParameterError: γ is negative, or the order or the scaling is not known.
    """
    # before γ, always: FFCx tells forms apart by the order in which their constants were made
    size = cell_size(points.grid)
    if isinstance(gamma, (int, float)):
        if not (math.isfinite(gamma) and gamma >= 0):
            raise ParameterError(f"gamma = {gamma} must be finite and not negative")
        gamma = own_constant(points.grid, gamma)
    space = getattr(u, "_dolfinmpm_space", None)
    smooth = space.basis.continuity if space is not None else 0
    if order is None:
        order = space.basis.degree if space is not None else 1
    if not isinstance(order, int) or order < 1:
        raise ParameterError(f"order = {order!r} must be a whole number of at least 1")
    if scaling not in ("scaled", "literal"):
        raise ParameterError(f'scaling = {scaling!r} must be "scaled" or "literal"')
    h = ufl.avg(size) if isinstance(size, fem.Function) else size
    if scaling == "scaled":
        gamma = gamma / h**2

    def jump(w: Expr, k: int) -> Expr:
        return _normal_derivative(w, "+", k) - _normal_derivative(w, "-", k)

    terms = [
        gamma
        * h ** (2 * k + 1)
        / ((2 * k + 1) * math.factorial(k) ** 2)
        * ufl.inner(jump(u, k), jump(v, k))
        for k in range(min(smooth, order - 1) + 1, order + 1)
    ]
    facets = points.dS
    if smooth:
        # exact on the rectangular grids of splines, where UFL would reckon with any shape
        facets = facets.reconstruct(metadata={"quadrature_degree": 2 * order})
    return sum(terms[1:], start=terms[0]) * facets


def soft(points: MaterialPoints, u: Expr, v: Expr, E: float, nu: float, eta: float) -> ufl.Form:
    """Soft stiffness: η times the linear elastic stiffness of the whole of all active cells.

    It belongs into the tangent alone, not among the forces (Wang, Vardon, Hicks &
    Chen 2016, doi 10.1016/j.compgeo.2016.05.003): Newton's method ends in the same
    state, more slowly.

    Args:
        points: Material points, whose cells are meant.
        u: Increment of the step.
        v: Test function.
        E: Young's modulus (Pa).
        nu: Poisson's ratio.
        eta: η, the share, about 1e-5 ... 1e-2.

    Raises:
        ParameterError: η is not positive.
    """
    if not (math.isfinite(eta) and eta > 0):
        raise ParameterError(f"eta = {eta} must be finite and positive")
    lmbda, mu = (own_constant(points.grid, eta * modulus) for modulus in lame(E, nu))
    strain = ufl.sym(ufl.grad(u))
    stress = lmbda * ufl.tr(strain) * ufl.Identity(points.gdim) + 2 * mu * strain
    return ufl.inner(stress, ufl.grad(v)) * points.dC


@dataclass(frozen=True)
class Stabilisation:
    """A remedy against small cuts and its parameters.

    Args:
        kind: "none"; "ghost" (penalty on jumps across ghost facets);
            "aggregation" (nodes of ill-filled cells follow the nearest well-filled
            cell); "weak-aggregation" (the distance from that is penalised); "extended"
            (as extended B-splines choose their inner functions); "soft" (a share
            of the elastic stiffness of whole cells, in the tangent only).
        E: Young's modulus (Pa) that penalties are scaled with; the law's by default.
        nu: Poisson's ratio, likewise.
        gamma: Penalty in units of E/30 for "ghost" and of E for "weak-aggregation". By
            default 1; on quadratic and cubic splines 100 and 10⁴ for a ghost penalty,
            because their last functions are so much smaller where a body ends, and 0.3
            and 0.1 for weak aggregation, whose continuations weigh the more.
        scaling: Of the ghost penalty; see `ghost`.
        threshold: Share to which a cell must be filled to need no help; 0.5 by default,
            0.7 and 0.9 for quadratic and cubic splines. See `ties` in
            `dolfinmpm.cut.aggregation` for what this means for splines.
        eta: Share of the elastic stiffness of "soft".

    Raises:
        ParameterError: A parameter is not what it may be; the message names it.
    """

    kind: str = "none"
    E: float | None = None
    nu: float | None = None
    gamma: float | None = None
    scaling: str = "scaled"
    threshold: float | None = None
    eta: float = 1e-3

    def __post_init__(self):
        if self.kind not in KINDS:
            known = ", ".join(f'"{kind}"' for kind in KINDS)
            raise ParameterError(f"stabilisation = {self.kind!r} must be one of {known}")
        if self.threshold is not None and not 0 < self.threshold <= 1:
            raise ParameterError(f"threshold = {self.threshold} must be in (0, 1]")
        if self.gamma is not None and not (math.isfinite(self.gamma) and self.gamma >= 0):
            raise ParameterError(f"gamma = {self.gamma} must be finite and not negative")

    @property
    def needs_modulus(self) -> bool:
        """Whether it cannot do without E."""
        return self.kind in ("ghost", "weak-aggregation", "soft")

    def force_terms(self, points: MaterialPoints, u: Expr, v: Expr) -> ufl.Form | None:
        """What it adds to the weak form."""
        if self.kind != "ghost":
            return None
        assert self.E is not None
        return ghost(points, u, v, self.factor(u) * self.E / 30, scaling=self.scaling)

    def factor(self, u: Expr) -> float:
        """The ghost penalty's factor for an increment."""
        if self.gamma is not None:
            return self.gamma
        space = getattr(u, "_dolfinmpm_space", None)
        return GHOST_FACTORS[space.basis.degree if space is not None else 1]

    def tangent_terms(self, points: MaterialPoints, u: Expr, v: Expr) -> ufl.Form | None:
        """What it adds to the tangent only."""
        if self.kind != "soft":
            return None
        assert self.E is not None
        return soft(points, u, v, self.E, self.nu or 0.0, self.eta)

    @property
    def ties_nodes(self) -> bool:
        """Whether nodes follow others, or are drawn to where they would be if they did."""
        return self.kind in ("aggregation", "weak-aggregation", "extended")

    def level(self, degree: int) -> float:
        """Share to which a cell must be filled to need no help, for functions of that degree."""
        return THRESHOLDS[degree] if self.threshold is None else self.threshold

    def measure(self, where: Placement, stencils: Stencils, basis) -> npt.NDArray[np.float64]:
        """Fill fractions of cells, or for splines the shares of functions. Collective."""
        if basis.degree == 1:
            return fill_fractions(where, stencils, basis)
        return support_shares(where, stencils, basis)

    def ties(
        self, where: Placement, basis, stencils: Stencils, nodes, fixed, roots: MeshRoots | None
    ) -> sparse.csr_matrix:
        """The matrix C by which nodes follow others, u = C x. Collective."""
        filled = self.measure(where, stencils, basis)
        level, extended = self.level(basis.degree), self.kind == "extended"
        return ties(basis, nodes, filled, level, extended, fixed, roots)

    def penalty(
        self, grid: Mesh, degree: int, C: sparse.csr_matrix, nodes, components: int
    ) -> tuple[npt.NDArray, npt.NDArray, npt.NDArray]:
        """Weak aggregation: γ E h^{d−2} Σ (u − C u)_a · (v − C v)_a over the tied nodes.

        The distance of a node from the continued polynomial is penalised in place
        of being made zero (after Badia, Neiva & Verdugo 2022, doi
        10.1016/j.cma.2021.114093). The continuation is taken to have the scale of a
        stiffness, E h^{d−2}.

        Returns:
            Rows, columns and blocks, as the ordinary terms give them.
        """
        assert self.E is not None
        h = cell_size(grid)
        size = float(h.value) if not isinstance(h, fem.Function) else float(h.x.array.mean())
        own = np.zeros(C.shape[0], bool)
        own[nodes] = True
        D = sparse.identity(C.shape[0], format="csr") - C
        # so that a far continuation, whose weights are large, does not outweigh the body
        norms = np.asarray(D.multiply(D).sum(axis=1)).ravel()
        share = own / np.maximum(norms, 1.0)
        gamma = WEAK_FACTORS[degree] if self.gamma is None else self.gamma
        weights = sparse.diags(share * gamma * self.E * size ** (grid.geometry.dim - 2))
        product = sparse.coo_matrix(D.T @ weights @ D)
        blocks = product.data[:, None, None] * np.eye(components)
        return product.row.astype(np.int32), product.col.astype(np.int32), blocks
