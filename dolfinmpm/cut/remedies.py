"""Stabilisation against small cuts: terms of a few lines of UFL, and the choice of a remedy."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from ufl.algorithms import extract_arguments
from ufl.core.expr import Expr
from ufl.domain import extract_unique_domain

from dolfinmpm._platform.checks import choice, number, shown, whole
from dolfinmpm._platform.errors import ParameterError
from dolfinmpm.basis import Placement, Stencils
from dolfinmpm.basis.space import Space
from dolfinmpm.body.acting import resisting
from dolfinmpm.body.arguments import (
    check_displacement,
    check_increment,
    check_points,
    check_test,
)
from dolfinmpm.body.axisymmetry import gradient, ring
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.cut.aggregation import MeshRoots, ties
from dolfinmpm.cut.facetmoduli import FacetModulus, FacetRing
from dolfinmpm.cut.fractions import fill_fractions, support_shares
from dolfinmpm.grid.constants import own_constant
from dolfinmpm.grid.lattice import cell_size, mean_size
from dolfinmpm.materials.base import lame

if TYPE_CHECKING:
    from scipy import sparse

__all__ = ["Stabilisation", "ghost", "soft"]

_SCALINGS = ("scaled", "literal", "tangent")
ADAPTIVE = "adaptive"
# Local constant aimed at: from 20 to 50 neither conditioning nor locking is worth a word
TARGET = 30.0
KINDS = ("none", "ghost", "aggregation", "weak-aggregation", "extended", "soft")

# Factors of the penalties for linear functions, quadratic and cubic splines
GHOST_FACTORS = {1: 1.0, 2: 1e2, 3: 1e4}
WEAK_FACTORS = {1: 1.0, 2: 0.3, 3: 0.1}
# Fill fractions below which they are tied to others
THRESHOLDS = {1: 0.5, 2: 0.7, 3: 0.9}


def _penalty_factor(what: str, value: Any) -> float:
    """A penalty's factor, finite and not negative.

    Raises:
        ParameterError: It is anything else.
    """
    if number(what, value) < 0:
        raise ParameterError(f"{what} = {value:g} must be finite and not negative")
    return float(value)


def _check_word(what: str, value: str) -> None:
    """Raise ParameterError unless a factor given as a word is "adaptive"."""
    if value != ADAPTIVE:
        raise ParameterError(f'{what} = {value!r} must be a number or "{ADAPTIVE}"')


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
    gamma: float | Expr | str,
    order: int | None = None,
    scaling: str = "scaled",
    target: float | None = None,
) -> ufl.Form:
    """Ghost penalty: jumps of the increment's normal derivatives across ghost facets.

    Σ_{k=1..q} γ h^{2k+1} / ((2k+1) (k!)²) ∫ [[∂ₙᵏ u]] · [[∂ₙᵏ v]] dΓ
    (Burman 2010; Coombs 2023, doi 10.1002/nme.7332). It acts on the step's
    increment, so that nothing accumulates. On splines of degree q, which are smooth
    up to the derivative q − 1, only the term k = q is there. Of points that are rings facets
    are rings too, with areas of 2π r times their lengths.

    Args:
        points: Material points; the facets are those of their boundary cells.
        u: Increment of the step.
        v: Test function.
        gamma: γ. For a stiffness E/30 (Pa) works well, or 1/30 with `scaling="tangent"`; for a
            mass ρ/4 with `scaling="literal"`. "adaptive" is, facet by facet, the least by
            which the local constant of its two cells is no more than `target`, under
            the tangent of the laws there; see `dolfinmpm.assembly.facetpairs`.
        order: q, the degree of the basis by default.
        scaling: "scaled" divides γ by h², so that the term scales with h as a
            stiffness does and conditioning does not depend on units; "literal" is
            the published form, with γ in Pa/m² (or kg/m³ for a mass). "tangent" is "scaled"
            with γ in units of the P-wave modulus of the laws' tangent at the facet, a mean
            over the points of its two cells (see `dolfinmpm.cut.facetmoduli`): a penalty in
            units of E loses its hold near incompressibility, where the local constant
            rises from 414 to 7340 (ν = 0, 0.49), against 441 with this one.
        target: Local constant that "adaptive" aims at, 30 by default; no less than twice the
            constant of functions without jumps, which no γ can lower: 10 to 14 of linear
            functions on squares and cubes, 180 to 250 of quadratic and thousands of cubic
            splines.

    Raises:
        ParameterError: γ is negative or no number, the order, the scaling or the target is not
            what it may be, or u and v are no increment and no test function of one field.
    """
    check_points(points)
    check_increment(points, u)
    check_test(points, u, v)
    adaptive = isinstance(gamma, str)
    scaling = choice("scaling", scaling, _SCALINGS)
    if isinstance(gamma, str):
        _check_word("gamma", gamma)
        target = TARGET if target is None else number("target", target, 1.0)
    elif target is not None:
        raise ParameterError(f'target = {shown(target)} is of gamma="adaptive" alone')
    elif not isinstance(gamma, Expr):
        gamma = _penalty_factor("gamma", gamma)
    elif gamma.ufl_shape != () or extract_arguments(gamma):
        raise ParameterError(f"gamma = {shown(gamma)} must be a number or a scalar of UFL")
    elif extract_unique_domain(gamma) not in (None, points.grid.ufl_domain()):
        raise ParameterError("gamma lives on another grid than the points; make it on points.grid")
    order = None if order is None else whole("order", order, 1)
    # before γ, always: FFCx tells forms apart by the order in which their constants were made
    space = getattr(u, "_dolfinmpm_space", None)
    size = cell_size(points.grid) if space is None else space.cell_size
    factor: Expr
    if adaptive or scaling == "tangent":
        check_displacement(points, u=u, v=v)
        factor = FacetModulus(points, u, target, scaling)("+")
        if not adaptive:
            factor *= gamma if isinstance(gamma, Expr) else own_constant(points.grid, gamma)
    else:
        factor = gamma if isinstance(gamma, Expr) else own_constant(points.grid, gamma)
        if points.axisymmetric:
            factor *= FacetRing(points, u)("+")
    smooth = space.basis.continuity if space is not None else 0
    if order is None:
        order = space.basis.degree if space is not None else 1
    h = ufl.avg(size) if isinstance(size, fem.Function) else size
    if scaling != "literal":
        factor = factor / h**2

    def jump(w: Expr, k: int) -> Expr:
        return _normal_derivative(w, "+", k) - _normal_derivative(w, "-", k)

    terms = [
        factor
        * h ** (2 * k + 1)
        / ((2 * k + 1) * math.factorial(k) ** 2)
        * ufl.inner(jump(u, k), jump(v, k))
        for k in range(min(smooth, order - 1) + 1, order + 1)
    ]
    facets = points.dS
    if smooth:
        # exact on the rectangular grids of splines, where UFL would reckon with any shape
        metadata = {**facets.metadata(), "quadrature_degree": 2 * order}
        facets = facets.reconstruct(metadata=metadata)
    jumps = sum(terms[1:], start=terms[0])
    if u.ufl_shape != (points.gdim,):
        # the sign of a scalar's equation is the user's
        return jumps * facets
    return resisting(jumps, facets, "the ghost penalty (mpm.ghost)")


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
        ParameterError: A number is not what it may be, or u and v are no increment and no test
            function of a displacement.
    """
    check_points(points)
    check_displacement(points, u=u, v=v)
    number("E", E, 0.0, unit="Pa"), number("nu", nu, -1.0, 0.5), number("eta", eta, 0.0, 1.0)
    lmbda, mu = (own_constant(points.grid, eta * modulus) for modulus in lame(E, nu))
    radius = ufl.SpatialCoordinate(points.grid)[0]
    strain = ufl.sym(gradient(points, u, radius))
    stress = lmbda * ufl.tr(strain) * ufl.Identity(points.strain_dim) + 2 * mu * strain
    energy = ufl.inner(stress, gradient(points, v, radius))
    return (ring(radius, energy) if points.axisymmetric else energy) * points.dC


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
        gamma: Penalty in units of E/30, or M/30, for "ghost" and of E for "weak-aggregation";
            or "adaptive", see `ghost`. By default 1; on quadratic and cubic splines 100 and 10⁴
            for a ghost penalty, because their last functions are so much smaller where a
            body ends, and 0.3 and 0.1 for weak aggregation, whose continuations weigh the more.
        scaling: Of the ghost penalty, see `ghost`; by default "tangent", M being the P-wave
            modulus of the laws' tangent at the facet, and "scaled" where E is given.
        target: Local constant of an adaptive ghost penalty; see `ghost`.
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
    gamma: float | str | None = None
    scaling: str | None = None
    threshold: float | None = None
    eta: float = 1e-3
    target: float | None = None

    def __post_init__(self):
        # frozen: the words are kept as they are spelt here
        object.__setattr__(self, "kind", choice("stabilisation", self.kind, KINDS))
        if self.scaling is not None:
            scaling = choice("stabilisation's scaling", self.scaling, _SCALINGS)
            object.__setattr__(self, "scaling", scaling)
        if self.E is not None:
            number("stabilisation's E", self.E, 0.0, unit="Pa")
        if self.nu is not None:
            number("stabilisation's nu", self.nu, -1.0, 0.5)
        if isinstance(self.gamma, str) and self.kind == "ghost":
            _check_word("stabilisation's gamma", self.gamma)
        elif self.gamma is not None:
            _penalty_factor("stabilisation's gamma", self.gamma)
        if self.target is not None:
            number("stabilisation's target", self.target, 1.0)
        if self.threshold is not None:
            share = number("stabilisation's threshold", self.threshold)
            if not 0 < share <= 1:
                raise ParameterError(f"stabilisation's threshold = {share:g} must be in (0, 1]")
        number("stabilisation's eta", self.eta, 0.0, 1.0)
        if self.target is not None and self.gamma != ADAPTIVE:
            raise ParameterError(
                f'stabilisation\'s target = {self.target:g} is of gamma="{ADAPTIVE}" alone'
            )

    @property
    def needs_modulus(self) -> bool:
        """Whether it cannot do without E."""
        if self.kind == "ghost":
            return not self.follows_tangent
        return self.kind in ("weak-aggregation", "soft")

    @property
    def follows_tangent(self) -> bool:
        """Whether it is a ghost penalty in units of the laws' tangent."""
        if self.kind != "ghost":
            return False
        usual = "tangent" if self.E is None else "scaled"
        return self.gamma == ADAPTIVE or (self.scaling or usual) == "tangent"

    def force_terms(
        self, points: MaterialPoints, u: Expr, v: Expr, known: Expr | None = None
    ) -> ufl.Form | None:
        """What it adds to the weak form.

        Args:
            points, u, v: See `ghost`.
            known: γ in literal scaling, where a term of the form tells it.
        """
        if self.kind != "ghost":
            return None
        if known is not None:
            return ghost(points, u, v, self.factor(u) * known, scaling="literal")
        if self.gamma == ADAPTIVE:
            literal = self.scaling or "scaled"
            return ghost(points, u, v, ADAPTIVE, scaling=literal, target=self.target)
        if self.follows_tangent:
            return ghost(points, u, v, self.factor(u) / 30, scaling="tangent")
        assert self.E is not None
        return ghost(points, u, v, self.factor(u) * self.E / 30, scaling=self.scaling or "scaled")

    def factor(self, u: Expr) -> float:
        """The ghost penalty's factor for an increment."""
        if self.gamma is not None:
            assert not isinstance(self.gamma, str)
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
        self,
        space: Space,
        C: sparse.csr_matrix,
        nodes,
        radius: npt.NDArray[np.float64] | None = None,
    ) -> tuple[npt.NDArray, npt.NDArray, npt.NDArray]:
        """Weak aggregation: γ E h^{d−2} Σ (u − C u)_a · (v − C v)_a over the tied nodes.

        The distance of a node from the continued polynomial is penalised in place
        of being made zero (after Badia, Neiva & Verdugo 2022, doi
        10.1016/j.cma.2021.114093). The continuation is taken to have the scale of a
        stiffness, E h^{d−2}; of rings, which have a radius, with the factor 2π r, r being no less
        than half a cell.

        Returns:
            Rows, columns and blocks, as the ordinary terms give them.
        """
        from scipy import sparse

        assert self.E is not None
        size = mean_size(space.cell_size)
        own = np.zeros(C.shape[0], bool)
        own[nodes] = True
        D = sparse.identity(C.shape[0], format="csr") - C
        # so that a far continuation, whose weights are large, does not outweigh the body
        norms = np.asarray(D.multiply(D).sum(axis=1)).ravel()
        share = own / np.maximum(norms, 1.0)
        gamma = WEAK_FACTORS[space.basis.degree] if self.gamma is None else self.gamma
        assert not isinstance(gamma, str)
        if radius is not None:
            share *= ring(np.maximum(radius, 0.5 * size), 1.0)
        weights = sparse.diags(share * gamma * self.E * size ** (space.grid.geometry.dim - 2))
        product = sparse.coo_matrix(D.T @ weights @ D)
        blocks = product.data[:, None, None] * np.eye(space.components)
        return product.row.astype(np.int32), product.col.astype(np.int32), blocks
