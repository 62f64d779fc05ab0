"""Weak form of a saturated soil: balance of momentum and of the water's volume in one step.

The unknowns are the displacement increment u and the pore pressure p (positive in compression).
Grains are incompressible. The total Kirchhoff stress is τ' − J p I. Per initial volume V0,

    Σ V0 (τ' − J p I) : ∇v − Σ V0 m b·v = 0,
    Σ V0 {q (J − J_n) + q J n (p − p_n)/K_w + Δt J ∇q · (k/γ_w)(∇p − ρ_w b)} = 0.

The second equation is multiplied by M/h, so that both equations are forces. Gradients are spatial
gradients at the end of the step. n = 1 − (1 − n0)/J is the porosity. m = m_n + (J − J_n) ρ_w is
the mass of the mixture, which loses the water that drains (Coussy 2004, "Poromechanics", ch. 2;
Borja & Alarcón 1995, doi 10.1016/0045-7825(94)00720-8).

The pressure is a field of the grid's nodes. It has no memory: every step solves for the pressure
itself. The points carry the last pressure, which enters the storage of compressible water and the
stabilisation. Nothing is projected from the points to the grid, so that nothing diffuses.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from ufl.core.expr import Expr

from dolfinmpm._platform.argumentchecks import as_tags, number, shown, truth
from dolfinmpm._platform.collective import collective
from dolfinmpm._platform.errors import ParameterError
from dolfinmpm.body.formarguments import (
    check_displacement,
    check_increment,
    check_points,
    check_test,
)
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.forms.carriedfields import CARRIED, CarriedField, acceleration, carried
from dolfinmpm.forms.ghostterms import PENALTY
from dolfinmpm.grid.constants import own_constant
from dolfinmpm.kinematics.lawterms import momentum
from dolfinmpm.materials.base import lame
from dolfinmpm.porous.alphalevel import Level
from dolfinmpm.porous.deformation import kinematics
from dolfinmpm.porous.fluid import Fluid, refuse_hollow, refuse_light
from dolfinmpm.porous.projection import factor_of, largest, projected, size_of
from dolfinmpm.porous.waterboundaries import Flow, entering, held, seeping, surfaces

__all__ = ["poromechanics"]

# Factors of storage and flow in the pressure's ghost penalty, by degree. The factor of flow is the
# factor for a stiffness. The factor for a mass, 1/4, is too large for storage: it smears the thin
# layer that drains in the first step (9 % overshoot; 0.8 % with these factors). For splines, the
# stabilisation's own factor of 100 or 10⁴ would smear too, so that it is divided out here.
_STORAGE = {1: 5e-4, 2: 5e-6, 3: 5e-8}
_FLOW = {1: 1 / 90, 2: 1 / 1800, 3: 1 / 90000}


@collective
def poromechanics(
    soil: Any,
    points: MaterialPoints,
    fields: Sequence[Any],
    tests: Sequence[Any],
    *,
    permeability: Any,
    porosity: Any,
    fluid: Fluid | None = None,
    gravity: Any = None,
    theta: float = 1.0,
    rho_inf: float | None = None,
    inertia: bool = False,
    suction: float | None = None,
    projection: str | float = "auto",
    modulus: float | None = None,
    drained: Any = (),
    seepage: Any = (),
    inflow: Any = (),
    ponded: Any = (),
    strain: str = "large",
    fbar: bool | str = False,
    tag: int | tuple[int, ...] | None = None,
) -> ufl.Form:
    """Weak form of one step of a saturated soil: deformation and flow of water.

    The form is plain UFL, to be copied and changed. `points.dt` is the length of the step (s), and
    `mpm.carried` keeps the pressure of the last step. Solve the form with `Transient`, or with
    `Newmark` for problems with inertia. For `QuasiStatic`, set `points.dt.value`; permeability=0
    then gives the undrained analysis in effective stresses.

    The points carry the fields `pressure` (Pa) and `porosity`. `pressure` may be set before the
    problem is made. With gravity, the field `density` (of the mixture, per initial volume) changes
    with the water that drains.

    Args:
        soil: Law of the effective stress, see `momentum`.
        points: Material points; their density is the density of the mixture,
            (1 − n0) ρ_s + n0 ρ_w (kg/m³).
        fields: Increment u of the displacement (m) and pore pressure p (Pa), each the
            `Space.increment` of its space. p is the pressure itself, and no increment.
        tests: Test functions (v, q) of the two spaces.
        permeability: Hydraulic conductivity k (m/s): a number; a symmetric tensor, shape (gdim,
            gdim); a UFL expression; or a function of J and n that returns one of these, such as
            `kozeny_carman`.
        porosity: Porosity n0 at J = 1: a number in (0, 1), or a UFL expression such as a field of
            the points.
        fluid: The fluid, water by default.
        gravity: Acceleration b of both phases (m/s²), a vector for UFL such as a DOLFINx
            constant; None for no gravity.
        theta: Weight of the flow at the end of the step: 1 is backward Euler, ½ is Crank-Nicolson.
        rho_inf: ρ∞ of `GeneralisedAlpha`; give both the same number. The balance of the water's
            volume then uses the generalised-α method for first-order equations, at the level at
            which forces balance; see `dolfinmpm.porous.alphalevel`. None for all other problems.
        inertia: Whether the water is accelerated together with the soil. Darcy's law is then
            w = −(k/γ_w)(∇p − ρ_w (b − a)), with the acceleration a of the soil. The acceleration
            of the water relative to the soil is left out (Zienkiewicz, Chang & Bettess 1980,
            doi 10.1680/geot.1980.30.4.385). With this law waves grow if the water is so
            compressible that n0/K_w > (ρ/ρ_w − 1)/M. Only for problems with inertia; see
            `acceleration`.
        suction: Largest suction (Pa) that acts between grains; None for no bound.
        projection: Factor f of the polynomial pressure projection. The projection prevents
            oscillations in steps shorter than f/12 h²/c_v. Its term is τ (q − q̄)(p − p̄), with the
            pressure's change in the step, means over the points of a cell of size h, and
            τ = (f − 12 θ c_v Δt/h²)₊/M (Dohrmann & Bochev 2004, doi 10.1002/fld.752; White &
            Borja 2008, doi 10.1016/j.cma.2008.02.016). "auto" is 3, or 4.5 to 10 for
            displacements of splines on the pressure's cells; see `dolfinmpm.porous.projection`.
            With 3, a step without drainage does not overshoot in one dimension. "none" leaves the
            projection out.
        modulus: P-wave modulus M (Pa) that scales the stabilisation; the law's modulus by default.
        drained: Surfaces with prescribed pressure: a `Surface` (pressure 0); a pair of a surface
            and its pressure (Pa, for UFL); or several of these. The surfaces move with the body.
            The condition is imposed by Nitsche's method.
        seepage: Surfaces at which water leaves but does not enter. The pressure is 0 where water
            leaves.
        inflow: Pairs of a surface and the volume of water that enters per initial area and time
            (m/s, for UFL; negative for water that leaves).
        ponded: Pairs of a surface and the level of still water above it (m, along the last axis,
            for UFL). The weight of the water acts as a pressure that follows the surface. The pore
            pressure at the surface is the same pressure, and 0 above the level.
        strain, fbar, tag: See `momentum`.

    Returns:
        A form over the points. Loads are subtracted from it.

    Raises:
        ParameterError: An argument is not valid; the law has no elastic constants and `modulus` is
            missing; or, with gravity, the points are not heavier than the water in them.

    Warns:
        UnstablePairWarning: u and p have the same cells and projection is "none"; or u has coarser
            cells than p, or a lower degree; see `dolfinmpm.porous.projection`.
    """
    check_points(points)
    u, p, v, q = _fields(points, fields, tests)
    fluid = Fluid() if fluid is None else fluid
    if not isinstance(fluid, Fluid):
        raise ParameterError(f"fluid = {shown(fluid)} must be a dolfinmpm.Fluid")
    theta = number("theta", theta, 0.0, 1.0, closed=True)
    if theta < 0.5:
        raise ParameterError(f"theta = {theta:g} must be at least 0.5: smaller ones are not stable")
    level = None if rho_inf is None else Level(points, rho_inf)
    if level is not None and theta != 1:
        raise ParameterError(
            f"theta = {theta:g} weights the flow at both ends of a step, but with rho_inf the flow "
            "is balanced at a level within the step: leave theta or rho_inf out"
        )
    form = momentum(soil, points, u, v, strain=strain, fbar=fbar, tag=tag)
    at = kinematics(points, u, strain)
    end = at if level is None else kinematics(points, u, strain, level.whole)
    grid, dt, gdim = points.grid, points.dt, points.gdim
    n0 = _porosity(porosity, points)
    n, n_end = 1 - (1 - n0) / at.J, 1 - (1 - n0) / end.J
    weight = own_constant(grid, fluid.unit_weight)
    water = own_constant(grid, fluid.density)
    K = _permeability(permeability, at.J, n, points) / weight
    K0 = _permeability(permeability, 1.0, n0, points) / weight
    b = _gravity(gravity, points)
    M = _modulus(modulus, soil, points)
    pressure = carried(points, "pressure", p, unit="Pa")
    keeps: list[CarriedField] = [
        carried(points, "porosity", n_end, unit="", first=_first(porosity))
    ]
    keeps[0].bounds = 0.0, 1.0

    # both equations in newtons: M/h times q, so that solvers see equations of similar size
    scale = M / size_of(p)
    q = scale * q

    dX = points.dX("everywhere" if tag is None else tag)
    acts = p if suction is None else ufl.max_value(p, -_suction(suction, points))
    div = ufl.tr(at.grad(v))
    if level is not None:
        pressure.update = level.end(pressure, p)
    storage = end.growth
    if fluid.compressible:
        bulk = own_constant(grid, fluid.bulk_modulus)
        storage += end.J * n_end / bulk * (pressure.update - pressure)
    if level is not None:
        storage, rate = level.change("storage_rate", storage, "1/s")
        keeps.append(rate)
    drive = at.grad(p) if b is None else at.grad(p) - water * b
    if truth("inertia", inertia):
        refuse_light(points, fluid, n0, M)
        drive += water * acceleration(points, u)
    flow = at.J * _times(K, drive)
    terms = -at.J * acts * div + storage * q + theta * dt * ufl.dot(flow, at.grad(q))
    if theta < 1:
        # flow at the start of the step, whose gradients are those of the grid
        before = carried(points, "flow", flow, unit="Pa m/s", first=np.zeros(gdim))
        terms += (1 - theta) * dt * ufl.dot(before, ufl.grad(q))
    if b is not None:
        refuse_hollow(points, fluid, n0, as_tags(tag))
        mass = points.density + at.growth * water
        terms -= mass * ufl.dot(b, v)
        mass = points.density + end.growth * water
        keeps.append(carried(points, "density", mass, unit="kg/m^d"))
    factor = factor_of(projection, u, p)
    if factor:
        slope = carried(points, "pressure_gradient", at.grad(p), unit="Pa/m", first=np.zeros(gdim))
        change, share = at.grad(p) - slope, theta
        if level is not None:
            slope.update = end.spatial(level.end(slope, ufl.grad(p)))
            whole = level.whole * (ufl.grad(p) - slope)
            change, rate = level.change("gradient_rate", whole, "Pa/(m s)")
            share = 1 / level.weight
            keeps += [slope, rate]
        terms += projected(points, factor, change, p, q, M, K, share)
    keeps.append(pressure)
    if level is not None:
        for field in keeps:
            field.level = level.share
    marked = {
        **dX.metadata(),
        CARRIED: tuple(keeps),
        PENALTY: {p: scale * _penalty(M, n0, fluid, K0, points, p)},
    }
    form += terms * dX(metadata=marked)
    through = Flow(points, u, p, q, at, M, K, drive)
    for surface, value in surfaces("drained", drained, points, "Pa", 0.0):
        form += held(through, surface, value)
    for surface, value in surfaces("seepage", seepage, points, "Pa", 0.0):
        form += seeping(through, surface, value)
    for surface, rate in surfaces("inflow", inflow, points, "m/s"):
        form += entering(through, surface, rate)
    for surface, level in surfaces("ponded", ponded, points, "m"):
        depth = ufl.max_value(level - surface.position(u)[gdim - 1], 0.0)
        form += held(through, surface, weight * depth)
        form += surface.pressure(weight * depth, u, v)
    return form


def _fields(points: MaterialPoints, fields: Any, tests: Any) -> tuple[Any, Any, Any, Any]:
    for what, pair in (("fields", fields), ("tests", tests)):
        if not isinstance(pair, (tuple, list)) or len(pair) != 2:
            raise ParameterError(
                f"{what} = {shown(pair)} must be a pair: one for the displacement and one for the "
                "pressure"
            )
    (u, p), (v, q) = fields, tests
    check_displacement(points, u=u, v=v)
    check_increment(points, p)
    if p.ufl_shape != ():
        raise ParameterError(
            f"the pressure has shape {p.ufl_shape} and must be a scalar: Space(..., shape=())"
        )
    check_test(points, p, q)
    return u, p, v, q


def _porosity(porosity: Any, points: MaterialPoints) -> Any:
    if isinstance(porosity, Expr):
        if porosity.ufl_shape != ():
            raise ParameterError(f"porosity has shape {porosity.ufl_shape} and must be a scalar")
        return porosity
    return own_constant(points.grid, number("porosity", porosity, 0.0, 1.0))


def _first(porosity: Any) -> float:
    # the value of an expression is known only in the first step
    return 0.5 if isinstance(porosity, Expr) else float(porosity)


def _permeability(given: Any, J: Any, n: Any, points: MaterialPoints) -> Any:
    """k for UFL, a scalar or a tensor (m/s)."""
    d = points.gdim
    if callable(given) and not isinstance(given, Expr):
        given = _of_porosity(given, J, n)
    if isinstance(given, Expr):
        if given.ufl_shape not in ((), (d, d)):
            raise ParameterError(
                f"permeability has shape {given.ufl_shape} and must be a scalar or of shape "
                f"{(d, d)}"
            )
        return given
    if np.ndim(given) == 0:
        return own_constant(points.grid, number("permeability", given, 0.0, math.inf, "m/s", True))
    tensor = _tensor(given)
    if not np.isfinite(tensor).all():
        raise ParameterError(f"permeability = {shown(given)} must be finite (m/s)")
    symmetric = tensor.shape == (d, d) and np.allclose(tensor, tensor.T, rtol=1e-12, atol=0)
    if not symmetric or np.linalg.eigvalsh(tensor).min() < 0:
        raise ParameterError(
            f"permeability = {shown(given)} must be symmetric, of shape {(d, d)} and without "
            "negative eigenvalues (m/s)"
        )
    return own_constant(points.grid, tensor)


def _of_porosity(function: Any, J: Any, n: Any) -> Any:
    """Result of a user's function of J and n.

    Raises:
        ParameterError: The function fails.
    """
    try:
        return function(J, n)
    except Exception as error:
        raise ParameterError(
            f"permeability, a function, failed with {type(error).__name__}: {error}; it is called "
            "once, with UFL expressions of the volume ratio J and the porosity n; see "
            "kozeny_carman. For a permeability that varies in space give a field, "
            "points.add_field('k', value=lambda x: ...)"
        ) from error


def _tensor(given: Any) -> npt.NDArray[np.float64]:
    try:
        return np.asarray(given, float)
    except (TypeError, ValueError):
        raise ParameterError(
            f"permeability = {shown(given)} must be a number (m/s), a tensor, UFL or a function of "
            "J and n"
        ) from None


def _times(K: Expr, w: Expr) -> Expr:
    return K * w if K.ufl_shape == () else ufl.dot(K, w)


def _gravity(gravity: Any, points: MaterialPoints) -> Any:
    if gravity is None or isinstance(gravity, Expr):
        if gravity is not None and gravity.ufl_shape != (points.gdim,):
            raise ParameterError(
                f"gravity has shape {gravity.ufl_shape} and must be a vector of {points.gdim}"
            )
        return gravity
    components = np.ravel(np.asarray(gravity, object))
    if len(components) != points.gdim:
        raise ParameterError(
            f"gravity = {shown(gravity)} must be a vector of {points.gdim} components (m/s²)"
        )
    return own_constant(points.grid, [number("gravity", c) for c in components])


def _suction(suction: Any, points: MaterialPoints) -> Any:
    return own_constant(points.grid, number("suction", suction, 0.0, math.inf, "Pa", True))


def _modulus(modulus: Any, soil: Any, points: MaterialPoints) -> Any:
    """M for UFL (Pa)."""
    if modulus is not None:
        return own_constant(points.grid, number("modulus", modulus, 0.0, unit="Pa"))
    values = soil.values
    E, nu = values.get("E"), values.get("nu")
    if not (isinstance(E, float) and isinstance(nu, float)):
        raise ParameterError(
            f"{soil!r} has no elastic constants that are the same at all points, but the pressure "
            "stabilisation needs a modulus as scale: give modulus=M, the P-wave modulus (Pa)"
        )
    lmbda, mu = lame(E, nu)
    return own_constant(points.grid, lmbda + 2 * mu)


def _penalty(M, n0, fluid: Fluid, K, points: MaterialPoints, p) -> Expr:
    """γ of the pressure's ghost penalty in literal scaling, from storage and flow."""
    stored = 1 / M
    if fluid.compressible:
        stored = stored + _plain(n0, 1.0) / own_constant(points.grid, fluid.bulk_modulus)
    degree = p._dolfinmpm_space.basis.degree
    flows = points.dt * _plain(largest(K), 0.0)
    return 3 * (_STORAGE[degree] * stored + _FLOW[degree] * flows / size_of(p) ** 2)


def _plain(factor: Any, otherwise: float) -> Any:
    """The factor if it is the same everywhere, else the other value."""
    from ufl.algorithms import extract_coefficients

    return factor if not extract_coefficients(factor) else otherwise
