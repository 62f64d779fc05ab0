"""Weak form of a saturated soil: balance of momentum, and of the water's volume, in one step.

With displacement increment u and pore pressure p (positive in compression), incompressible grains
and total Kirchhoff stress τ' − J p I, per initial volume V0,

    Σ V0 (τ' − J p I) : ∇v − Σ V0 m b·v = 0,
    Σ V0 {q (J − J_n) + q J n (p − p_n)/K_w + Δt J ∇q · (k/γ_w)(∇p − ρ_w b)} = 0,

(the second times M/h, so that both are forces), gradients being spatial ones at the end of the
step, n = 1 − (1 − n0)/J the porosity and
m = m_n + (J − J_n) ρ_w the mass of the mixture, which loses the water that drains (Coussy 2004,
"Poromechanics", ch. 2; Borja & Alarcón 1995, doi 10.1016/0045-7825(94)00720-8).

The pressure is that of the grid's nodes and starts anew in every step; what it was is carried by
the points and enters where water is compressible, and the stabilisation. Nothing is projected
from the points to the grid, so that nothing diffuses.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from ufl.core.expr import Expr

from dolfinmpm._platform.checks import as_tags, number, shown, truth
from dolfinmpm._platform.errors import ParameterError
from dolfinmpm._platform.together import together
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
from dolfinmpm.porous.fluid import Fluid, refuse_hollow, refuse_light
from dolfinmpm.porous.kinematics import kinematics
from dolfinmpm.porous.levels import Level
from dolfinmpm.porous.projection import factor_of, largest, projected, size_of
from dolfinmpm.porous.waterfaces import Flow, entering, held, seeping, surfaces

__all__ = ["poromechanics"]

# Shares of storage and flow in the pressure's ghost penalty. That of flow is a stiffness's; a
# mass's 1/4 for storage would smear the layer in which a first step drains (9 % overshoot, with
# this 0.8 %). Of splines the stabilisation's factor of 100 or 10⁴ would do that too, and is taken
# back
_STORAGE = {1: 5e-4, 2: 5e-6, 3: 5e-8}
_FLOW = {1: 1 / 90, 2: 1 / 1800, 3: 1 / 90000}


@together
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
    """Deformation of a saturated soil and flow of its water, as a weak form of one step.

    Plain UFL, to be copied and changed: `points.dt` is the length of the step, and
    `mpm.carried` keeps the pressure of the last one. Solve it with `Transient`, or with inertia
    with `Newmark`. In `QuasiStatic`, set `points.dt.value`; with permeability=0 it is the
    undrained analysis in effective stresses.

    The points carry `pressure` (Pa), which may be set before the problem is made, and
    `porosity`; with gravity, `density` (of the mixture, per initial volume) loses the water
    that drains.

    Args:
        soil: Law of the effective stress, for `momentum`.
        points: Material points; their density is that of the mixture, (1 − n0) ρ_s + n0 ρ_w.
        fields: Increment u of the displacement and the pore pressure p (Pa), `Space.increment`
            each; p is the pressure itself, no increment.
        tests: Their test functions (v, q).
        permeability: Hydraulic conductivity k (m/s): a number, a symmetric tensor, shape (gdim,
            gdim), a UFL expression, or a function of J and n that returns one, such as
            `kozeny_carman`.
        porosity: n0 at J = 1: a number in (0, 1), or a UFL expression such as a field of the
            points.
        fluid: The fluid, water by default.
        gravity: Acceleration b of both phases (m/s²), a vector for UFL such as a DOLFINx
            constant; None for none.
        theta: Share of the flow at the end of the step: 1 is backward Euler's rule, ½ Crank and
            Nicolson's.
        rho_inf: ρ∞ of `GeneralisedAlpha`, which is to be given the same: the water's volume is
            then balanced by the generalised-α method of first-order equations, see
            `dolfinmpm.porous.levels`, at the level where forces are. None for all other problems.
        inertia: Whether the water is accelerated as the soil is, which takes the pressure's slope
            ρ_w a: Darcy's law for w = −(k/γ_w)(∇p − ρ_w (b − a)), with the acceleration a of the
            soil; that of the water relative to it is left out (Zienkiewicz, Chang & Bettess 1980,
            doi 10.1680/geot.1980.30.4.385), with which waves grow where the water is so easily
            compressed that n0/K_w > (ρ/ρ_w − 1)/M. Of problems with inertia; see `acceleration`.
        suction: Largest suction (Pa) that holds grains together; None for no bound.
        projection: Factor f of the polynomial pressure projection by which a step shorter than
            f/12 h²/c_v does not oscillate: τ (q − q̄)(p − p̄) of the pressure's increments, means
            being those of a cell's points (Dohrmann & Bochev 2004, doi 10.1002/fld.752; White &
            Borja 2008, doi 10.1016/j.cma.2008.02.016), with τ = (f − 12 θ c_v Δt/h²)₊/M.
            "auto" is 3, with which a step without drainage does not overshoot in one dimension,
            and from 4.5 to 10 where the displacement is of splines on the pressure's cells, see
            `dolfinmpm.porous.projection`; "none" leaves it out. h is the size of these cells.
        modulus: P-wave modulus M (Pa) that stabilisation is scaled by; the law's by default.
        drained: Surfaces at which the pressure is held: a `Surface`, a pair of one and its
            pressure (Pa, for UFL), or several of these. They move with the body; the condition
            is Nitsche's.
        seepage: Surfaces at which water leaves but does not enter, and the pressure is 0 where
            it leaves.
        inflow: Pairs of a surface and the volume of water that enters through its first area
            (m/s, for UFL; negative where it leaves).
        ponded: Pairs of a surface and the level, along the last axis, of still water that stands on
            it (m, for UFL): its weight acts as a pressure that follows the surface, and is the pore
            pressure there, 0 above the level.
        strain, fbar, tag: See `momentum`.

    Returns:
        A form over the points, to which loads are added.

    Raises:
        ParameterError: An argument is not what it may be, the law has no elastic constants and
            modulus is missing, or, with gravity, the points are lighter than the water in them.

    Warns:
        UnstablePairWarning: u and p are on the same cells and projection is "none", or u has
            coarser cells than p, or is of a lower order; see `dolfinmpm.porous.projection`.
    """
    check_points(points)
    u, p, v, q = _fields(points, fields, tests)
    fluid = Fluid() if fluid is None else fluid
    if not isinstance(fluid, Fluid):
        raise ParameterError(f"fluid = {shown(fluid)} must be a dolfinmpm.Fluid")
    theta = number("theta", theta, 0.0, 1.0, closed=True)
    if theta < 0.5:
        raise ParameterError(f"theta = {theta:g} must be at least 0.5: less is not stable")
    level = None if rho_inf is None else Level(points, rho_inf)
    if level is not None and theta != 1:
        raise ParameterError(
            f"theta = {theta:g} is of flow that is balanced over a step, and with rho_inf it is at "
            "a level within: leave theta out, or rho_inf"
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

    # volumes in newtons, as forces are: M/h times q, so that solvers see equations alike
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
                f"{what} = {shown(pair)} must be a pair, that of the displacement and that of the "
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
    # of an expression the first step tells
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
    """What a function of J and n gives.

    Raises:
        ParameterError: It fails, as one of positions does.
    """
    try:
        return function(J, n)
    except Exception as error:
        raise ParameterError(
            f"permeability, a function, failed with {type(error).__name__}: {error}; it is called "
            "once, in UFL, with the ratio of volumes J and the porosity n, as kozeny_carman gives "
            "one; for one that varies in space give a field, points.add_field('k', value=lambda x: "
            "...)"
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
            f"{soil!r} has no elastic constants that are the same everywhere, and the pressure's "
            "stabilisation is scaled by a modulus: give modulus=M, its P-wave modulus (Pa)"
        )
    lmbda, mu = lame(E, nu)
    return own_constant(points.grid, lmbda + 2 * mu)


def _penalty(M, n0, fluid: Fluid, K, points: MaterialPoints, p) -> Expr:
    """γ of the pressure's ghost penalty, in its literal scaling: by what is stored and flows."""
    stored = 1 / M
    if fluid.compressible:
        stored = stored + _plain(n0, 1.0) / own_constant(points.grid, fluid.bulk_modulus)
    degree = p._dolfinmpm_space.basis.degree
    flows = points.dt * _plain(largest(K), 0.0)
    return 3 * (_STORAGE[degree] * stored + _FLOW[degree] * flows / size_of(p) ** 2)


def _plain(factor: Any, otherwise: float) -> Any:
    """A factor that is the same everywhere, or else what is given."""
    from ufl.algorithms import extract_coefficients

    return factor if not extract_coefficients(factor) else otherwise
