"""Terms against small cuts that act in the weak form: the ghost penalty and the soft stiffness."""

from __future__ import annotations

import functools
import math
import operator
from typing import Any

import ufl
from dolfinx import fem
from dolfinx.mesh import Mesh
from ufl.algorithms import extract_arguments
from ufl.core.expr import Expr
from ufl.domain import extract_unique_domain

from dolfinmpm._platform.argumentchecks import choice, number, shown, whole
from dolfinmpm._platform.errors import ParameterError
from dolfinmpm._platform.units import LARGEST_MODULUS, LARGEST_PENALTY
from dolfinmpm.basis.space import Space
from dolfinmpm.body.axisymmetry import gradient, ring
from dolfinmpm.body.formarguments import (
    check_displacement,
    check_increment,
    check_points,
    check_test,
)
from dolfinmpm.body.formsigns import FACETS, signed_form
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.cut.facetmoduli import FacetModulus, FacetRing
from dolfinmpm.grid.constants import own_constant
from dolfinmpm.grid.lattice import cell_edges, cell_size
from dolfinmpm.materials.base import lame

__all__ = ["ghost", "soft"]

SCALINGS = ("scaled", "literal", "tangent")
ADAPTIVE = "adaptive"
# Target of the local constant: from 20 to 50 conditioning and locking hardly change
TARGET = 30.0
# Factors of the ghost penalty for linear functions, quadratic and cubic splines
GHOST_FACTORS = {1: 1.0, 2: 1e2, 3: 1e4}


def penalty_factor(what: str, value: Any, most: float = LARGEST_PENALTY) -> float:
    """The factor of a penalty, finite and not negative.

    Raises:
        ParameterError: The value is not a finite number, or negative, or above the limit.
    """
    if number(what, value) < 0:
        raise ParameterError(f"{what} = {value:g} must be finite and not negative")
    if value > most:
        raise ParameterError(
            f"{what} = {value:g} must be at most {most:g}: beyond that rounding hides all other "
            "forces, and the body cannot move"
        )
    return float(value)


def check_word(what: str, value: str) -> None:
    """Raise ParameterError unless a factor in words is "adaptive"."""
    if value != ADAPTIVE:
        raise ParameterError(f'{what} = {value!r} must be a number or "{ADAPTIVE}"')


def _scalar(what: str, value: Any, points: MaterialPoints) -> Any:
    """A number that is not negative, or a UFL scalar on the points' grid."""
    if isinstance(value, str) and value == ADAPTIVE:
        raise ParameterError(
            f'{what} = "{ADAPTIVE}" must be a number (Pa); "{ADAPTIVE}" is a factor of the laws\' '
            f'own moduli: give factor="{ADAPTIVE}"'
        )
    if not isinstance(value, Expr):
        return penalty_factor(what, value, LARGEST_MODULUS if what == "gamma" else LARGEST_PENALTY)
    if value.ufl_shape != () or extract_arguments(value):
        raise ParameterError(f"{what} = {shown(value)} must be a number or a scalar of UFL")
    if extract_unique_domain(value) not in (None, points.grid.ufl_domain()):
        raise ParameterError(
            f"{what} lives on another grid than the points; make it on points.grid"
        )
    return value


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


def _jump(w: Expr, k: int) -> Expr:
    """Jump of the k-th normal derivative of w across a facet."""
    return _normal_derivative(w, "+", k) - _normal_derivative(w, "-", k)


def _surface_divergence(w: Expr, k: int) -> Expr:
    """Divergence along a facet of the jump of the k-th normal derivative of a vector w."""
    gradient_of = functools.reduce(lambda f, _: ufl.grad(f), range(k + 1), w)
    found = gradient_of("+") - gradient_of("-")
    n = ufl.FacetNormal(ufl.domain.extract_unique_domain(w))("+")
    for _ in range(k):
        # the order of derivatives does not matter
        found = ufl.dot(found, n)
    return ufl.tr(found) - ufl.dot(n, ufl.dot(found, n))


def _energy_of_jumps(u: Expr, v: Expr, k: int, h: Expr, G: Expr, lam: Expr) -> Expr:
    """2 G a·b + λ [a_n b_n + r h² div_Γ a div_Γ b], with the jumps a and b of u and v.

    A function with the jump a of its k-th normal derivative differs by w = a sᵏ/k! from the
    function that its neighbour would continue, at the distance s from the facet. So the divergence
    of w is a_n sᵏ⁻¹/(k−1)! + div_Γ a sᵏ/k!. The ratio r of the integrals of the squares over the
    cell is (2k−1)/((2k+1) k²).
    """
    a, b = _jump(u, k), _jump(v, k)
    n = ufl.FacetNormal(ufl.domain.extract_unique_domain(u))("+")
    ratio = (2 * k - 1) / ((2 * k + 1) * k**2)
    along = ratio * h**2 * _surface_divergence(u, k) * _surface_divergence(v, k)
    return 2 * G * ufl.inner(a, b) + lam * (ufl.dot(a, n) * ufl.dot(b, n) + along)


def _moduli_of_laws(
    points: MaterialPoints, u: Expr, target: float | None, scaling: str
) -> tuple[list[Expr], list[Expr]]:
    """The modulus of all components of a jump; or none, and G and λ for `_energy_of_jumps`."""
    if target is not None or points.gdim == 1:
        return [FacetModulus(points, u, target, scaling)("+")], []
    shear = FacetModulus(points, u, part="G")
    return [], [shear("+"), FacetModulus(points, u, part="lambda", source=shear)("+")]


def _height(grid: Mesh, space: Space | None) -> Expr:
    """Height of the cells at a facet, normal to it (m); of the lower one of two.

    A penalty with the height extends a function over the cut cell as the law would do. The size of
    a long cell is another length, and a mean of two heights is too large for a thin cell.
    """
    size = cell_size(grid) if space is None else space.cell_size
    edges = cell_edges(grid) if space is None else space.cell_edges
    if edges is None:
        return ufl.avg(size) if isinstance(size, fem.Function) else size
    n = ufl.FacetNormal(ufl.domain.extract_unique_domain(edges))("+")
    a, b = (abs(ufl.dot(edges(side), n)) for side in "+-")
    return (a + b - abs(a - b)) / 2


def ghost(
    points: MaterialPoints,
    u: Expr,
    v: Expr,
    gamma: float | Expr | None = None,
    order: int | None = None,
    scaling: str = "scaled",
    target: float | None = None,
    *,
    factor: float | Expr | str | None = None,
) -> ufl.Form:
    """Ghost penalty: jumps of the increment's normal derivatives across ghost facets.

    Σ_{k=1..q} γ h^{2k+1} / ((2k+1) (k!)²) ∫ [[∂ₙᵏ u]] · [[∂ₙᵏ v]] dΓ
    with the height h of the cells normal to the facet, the smaller one of two
    (Burman 2010; Coombs 2023, doi 10.1002/nme.7332). The penalty acts on the step's increment, so
    that no force accumulates. Splines of degree q are smooth up to the derivative q − 1, and have
    only the term k = q. In axisymmetric problems facets go around the axis, with the areas 2π r
    times their lengths.

    Args:
        points: Material points; the ghost facets are those of their boundary cells.
        u: Increment of the step.
        v: Test function.
        gamma: γ (Pa). E/30 works well for a stiffness. For a mass ρ/4 works well, with
            `scaling="literal"`.
        order: q, the degree of the basis by default.
        scaling: "scaled" divides γ by h². The term then scales with h like a stiffness, and
            conditioning does not depend on units. "literal" is the published form, with γ in
            Pa/m² (or kg/m³ for a mass).
        target: Target of the local constant for "adaptive", 30 by default. It must be at least
            twice the constant of functions without jumps, which no γ can lower. This constant is
            10 to 14 for linear functions on squares and cubes, 180 to 250 for quadratic splines,
            and thousands for cubic splines.
        factor: Factor of a penalty by the laws, instead of `gamma`. With the moduli G and λ of the
            laws' tangent at the facet (means over the points of its two cells, see
            `dolfinmpm.cut.facetmoduli`), and the jumps a and b of the derivatives of u and v,
            γ a·b becomes factor/30 · [2 G a·b + λ (a_n b_n + r h² div_Γ a div_Γ b)],
            r = (2k−1)/((2k+1) k²). This is the energy by which a jump resists shear and change of
            volume; M = λ + 2G for all components would resist soil that slips at constant volume.
            A penalty in units of E is too weak near incompressibility: the local constant rises
            from 414 at ν = 0 to 7340 at ν = 0.49; here it falls to 181. With F-bar, M is at
            most 4 times the elastic shear modulus: more would lock. "adaptive" chooses one γ per
            facet for all components: the smallest γ for which the local constant of the two cells
            is at most `target`, with the tangent of the laws; see
            `dolfinmpm.assembly.facetpenalties`.

    Raises:
        ParameterError: γ or the factor is negative or not a number, both are given, or the order,
            the scaling or the target has a wrong value. Or u and v are not increment and test
            function of one field.

    Condition numbers of a body that fills a thousandth of its uppermost cells:

    >>> import dolfinmpm as mpm
    >>> from mpi4py import MPI
    >>> grid = mpm.create_lattice(MPI.COMM_WORLD, [range(5), range(5)])
    >>> points = mpm.fill(grid, mpm.Box((0, 0), (4, 2.001)), per_cell=2, density=2000.0, exact=True)
    >>> V = mpm.Space(grid, "linear")
    >>> F = mpm.momentum(mpm.materials.Hencky(1e6, 0.3), points, V.increment, V.test)
    >>> for form in (F, F + mpm.ghost(points, V.increment, V.test, factor=1.0)):
    ...     problem = mpm.QuasiStatic(form, V.increment, points, mpm.fixed(V, "bottom"))
    ...     print(f"{mpm.study.condition_number(problem.stiffness()):.0e}")
    5e+04
    7e+02
    """
    check_points(points)
    check_increment(points, u)
    check_test(points, u, v)
    scaling = choice("scaling", scaling, SCALINGS[:2])
    if isinstance(factor, str):
        check_word("factor", factor)
        target = TARGET if target is None else number("target", target, 1.0)
    elif target is not None:
        raise ParameterError(f'target = {shown(target)} belongs to factor="{ADAPTIVE}" only')
    of_law, strength = factor is not None, gamma if factor is None else factor
    if of_law and gamma is not None:
        raise ParameterError(
            f"gamma = {shown(gamma)} (Pa) and factor = {shown(factor)} (of the laws' moduli) are "
            "both given; give one of them"
        )
    if not of_law:
        gamma = _scalar("gamma", gamma, points)
    elif target is None:
        gamma = _scalar("factor", factor, points) / 30
    # h always before γ: FFCx identifies forms by the order in which their constants were made
    space = getattr(u, "_dolfinmpm_space", None)
    h = _height(points.grid, space)
    parts: list[Any] = []
    moduli: list[Expr] = []
    if of_law:
        check_displacement(points, u=u, v=v)
        parts, moduli = _moduli_of_laws(points, u, target, scaling)
    if gamma is not None:
        parts.append(gamma if isinstance(gamma, Expr) else own_constant(points.grid, gamma))
    if points.axisymmetric and not of_law:
        parts.append(FacetRing(points, u)("+"))
    weight: Expr = functools.reduce(operator.mul, parts)
    smooth, degree = (0, 1) if space is None else (space.basis.continuity, space.basis.degree)
    order = degree if order is None else whole("order", order, 1)
    if scaling != "literal":
        weight = weight / h**2

    def product(k: int) -> Expr:
        if moduli:
            return _energy_of_jumps(u, v, k, h, *moduli)
        return ufl.inner(_jump(u, k), _jump(v, k))

    terms = [
        weight * h ** (2 * k + 1) / ((2 * k + 1) * math.factorial(k) ** 2) * product(k)
        for k in range(min(smooth, order - 1) + 1, order + 1)
    ]
    facets = points.dS
    if smooth:
        # exact on rectangular grids of splines; UFL would choose a degree for cells of any shape
        metadata = {**facets.metadata(), "quadrature_degree": 2 * order}
        facets = facets.reconstruct(metadata=metadata)
    jumps = sum(terms[1:], start=terms[0])
    if u.ufl_shape != (points.gdim,):
        # the sign of a scalar's equation is the user's
        return jumps * facets
    # the same penalty again is a mistake; others add up, such as those of a stiffness and a mass
    strength = id(strength) if isinstance(strength, Expr) else strength
    kind = order, scaling, of_law, strength, facets.metadata()[FACETS], id(u)
    name = "the ghost penalty (mpm.ghost)"
    return signed_form(jumps, facets, name, once=True, kind=kind)


def soft(points: MaterialPoints, u: Expr, v: Expr, *, E: float, nu: float, eta: float) -> ufl.Form:
    """Soft stiffness: η times the linear elastic stiffness of all active cells, as whole cells.

    It belongs into the tangent alone, not into the forces (Wang, Vardon, Hicks & Chen 2016, doi
    10.1016/j.compgeo.2016.05.003). Newton's method then converges to the same state, but more
    slowly.

    Args:
        points: Material points that make the cells active.
        u: Increment of the step.
        v: Test function.
        E: Young's modulus (Pa).
        nu: Poisson's ratio.
        eta: η, the share, about 1e-5 ... 1e-2.

    Raises:
        ParameterError: A number is outside its range, or u and v are not increment and test
            function of a displacement.

    It is an integral over whole cells, where `points.dX` is a sum over points:

    >>> import dolfinmpm as mpm
    >>> from mpi4py import MPI
    >>> grid = mpm.create_lattice(MPI.COMM_WORLD, [range(5), range(5)])
    >>> points = mpm.fill(grid, mpm.Box((0, 0), (4, 2)), per_cell=2, density=2000.0)
    >>> V = mpm.Space(grid, "gimp")
    >>> term = mpm.soft(points, V.increment, V.test, E=1e6, nu=0.3, eta=1e-3)
    >>> term.integrals()[0].subdomain_id() == points.dC.subdomain_id()
    True
    """
    check_points(points)
    check_displacement(points, u=u, v=v)
    number("E", E, 0.0, unit="Pa"), number("nu", nu, -1.0, 0.5), number("eta", eta, 0.0, 1.0)
    lmbda, mu = (own_constant(points.grid, eta * modulus) for modulus in lame(E, nu))
    radius = ufl.SpatialCoordinate(points.grid)[0]
    strain = ufl.sym(gradient(points, u, radius=radius))
    stress = lmbda * ufl.tr(strain) * ufl.Identity(points.strain_dim) + 2 * mu * strain
    energy = ufl.inner(stress, gradient(points, v, radius=radius))
    return (ring(radius, energy) if points.axisymmetric else energy) * points.dC
