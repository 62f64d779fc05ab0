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

from collections.abc import Sequence
from typing import Any

import numpy as np
import ufl
from ufl.core.expr import Expr

from dolfinmpm._platform.argumentchecks import Tags, as_tags, truth
from dolfinmpm._platform.collective import collective
from dolfinmpm.body.formarguments import check_points
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.body.surface import Surface
from dolfinmpm.forms.carriedfields import CARRIED, CarriedField, acceleration, carried
from dolfinmpm.forms.termqueries import PENALTY, UNIT
from dolfinmpm.grid.constants import own_constant
from dolfinmpm.kinematics.lawterms import momentum
from dolfinmpm.porous.fluid import Fluid, refuse_hollow, refuse_light
from dolfinmpm.porous.mixturearguments import (
    first_porosity,
    fluid_of,
    gravity_of,
    modulus_of,
    permeability_of,
    porosity_of,
    suction_of,
    time_weights,
    unknowns,
)
from dolfinmpm.porous.mixturestep import Kinematics, Level, kinematics
from dolfinmpm.porous.projection import factor_of, largest, projected, size_of
from dolfinmpm.porous.waterboundaries import (
    Flow,
    outflow,
    prescribed_inflow,
    prescribed_pressure,
    refuse_two_pressures,
    seepage_face,
    surfaces,
    warn_of_levels,
)

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

    A problem that is made of the form gives the points the fields `pressure` (Pa) and `porosity`.
    `pressure` may be set before the first step, such as the pressure of water at rest. Its
    gradient follows from it. With gravity, the field `density` (of the mixture, per initial
    volume) changes with the water that drains.

    Args:
        soil: Law of the effective stress, see `momentum`.
        points: Material points; their density is the density of the mixture,
            (1 − n0) ρ_s + n0 ρ_w (kg/m³).
        fields: Increment u of the displacement (m) and pore pressure p (Pa), each the
            `Space.increment` of its space. p is the pressure itself, and no increment.
        tests: Test functions (v, q) of the two spaces.
        permeability: Hydraulic conductivity k (m/s): a number; a symmetric tensor, shape (gdim,
            gdim); a UFL expression, also of p; or a function of J and n that returns one of these,
            such as `kozeny_carman`. Soil under suction conducts as saturated soil does, unless the
            expression falls with suction.
        porosity: Porosity n0 at J = 1: a number in (0, 1), or a UFL expression such as a field of
            the points.
        fluid: The fluid, water by default.
        gravity: Acceleration b of both phases (m/s²), a vector for UFL such as a DOLFINx
            constant; None for no gravity. With gravity the form contains the weight of the mixture:
            do not subtract it again.
        theta: Weight of the flow at the end of the step: 1 is backward Euler, ½ is Crank-Nicolson.
        rho_inf: ρ∞ of `GeneralisedAlpha`; give both the same number. The balance of the water's
            volume then uses the generalised-α method for first-order equations, at the level at
            which forces balance; see `dolfinmpm.porous.mixturestep`. None for all other problems.
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
            pressure at the surface is the same pressure. Above the level, water leaves but does
            not enter, as at `seepage`.
        strain, fbar, tag: See `momentum`. Layers of several soils have one call per tag, with the
            same fields. A surface belongs to the call of its points.

    Returns:
        A form over the points. Loads are subtracted from it.

    Raises:
        ParameterError: An argument is not valid; the law has no elastic constants and `modulus` is
            missing; a surface has points of other tags; or, with gravity, the points are not
            heavier than the water in them.

    Warns:
        UnstablePairWarning: u and p have the same cells and projection is "none"; or u has coarser
            cells than p, or a lower degree; see `dolfinmpm.porous.projection`.

    A load of 10 kPa goes to the water at first:

    >>> import dolfinmpm as mpm
    >>> from mpi4py import MPI
    >>> grid = mpm.create_lattice(MPI.COMM_WORLD, [range(2), range(5)])
    >>> points = mpm.fill(grid, mpm.Box((0, 0), (1, 4)), per_cell=2, density=1800.0)
    >>> V, Q = mpm.Space(grid, "gimp"), mpm.Space(grid, "gimp", shape=())
    >>> u, v, p, q = V.increment, V.test, Q.increment, Q.test
    >>> clay = mpm.materials.Hencky(E=1e6, nu=0.3)
    >>> F = mpm.poromechanics(clay, points, (u, p), (v, q), permeability=1e-9, porosity=0.4)
    >>> F += mpm.Surface(points, lambda x: x[1] > 3.9, (0, 1)).pressure(1e4, u, v)
    >>> bcs = mpm.fixed(V, "bottom") + mpm.rollers(V, "left", "right") + mpm.fixed(Q, "top")
    >>> record = mpm.Transient(F, [u, p], points, bcs).step(1.0)
    >>> points["pressure"][:4].round(-2).tolist()
    [10000.0, 10000.0, 10000.0, 10000.0]
    """
    check_points(points)
    u, p, v, q = unknowns(points, fields, tests)
    fluid, (theta, level) = fluid_of(fluid), time_weights(points, theta, rho_inf)
    form = momentum(soil, points, u, v, strain=strain, fbar=fbar, tag=tag)
    at = kinematics(points, u, strain)
    end = at if level is None else kinematics(points, u, strain, level.whole)
    n0 = porosity_of(porosity, points)
    n, n_end = 1 - (1 - n0) / at.J, 1 - (1 - n0) / end.J
    weight, water = (own_constant(points.grid, a) for a in (fluid.unit_weight, fluid.density))
    K = permeability_of(permeability, at.J, n, points) / weight
    K0 = permeability_of(permeability, 1.0, n0, points) / weight
    b, M = gravity_of(gravity, points), modulus_of(modulus, soil, points)
    pressure = carried(points, "pressure", p, unit="Pa")
    pressure.pores = True
    pores = carried(points, "porosity", n_end, unit="", first=first_porosity(porosity))
    pores.bounds = 0.0, 1.0
    keeps: list[CarriedField] = [pores]
    # both equations in newtons: M/h times q, so that solvers see equations of similar size
    unit = own_constant(points.grid, M.value)
    scale = unit / size_of(p)
    q = scale * q
    dX = points.dX("everywhere" if tag is None else tag)
    acts = p if suction is None else ufl.max_value(p, -suction_of(suction, points))
    if level is not None:
        pressure.update = level.end(pressure, p)
    storage = _stored(points, fluid, end, n_end, pressure.update - pressure)
    if level is not None:
        storage, rate = level.change("storage_rate", storage, "1/s")
        keeps.append(rate)
    drive = at.grad(p) if b is None else at.grad(p) - water * b
    if truth("inertia", inertia):
        refuse_light(points, fluid, n0, M)
        drive += water * acceleration(points, u)
    through = Flow(points, u, p, q, at, M, K, drive)
    flow = at.J * through.rate
    terms = -at.J * acts * ufl.tr(at.grad(v)) + storage * q
    terms += theta * points.dt * ufl.dot(flow, at.grad(q))
    slope = _slope(points, at.grad(p))
    if theta < 1:
        terms += (1 - theta) * points.dt * _flow_before(points, flow, at, q, slope)
        keeps.append(slope)
    if b is not None:
        refuse_hollow(points, fluid, n0, as_tags(tag))
        # the weight at the start is a load, whose work is known
        terms += -points.density * ufl.dot(b, v) - at.growth * water * ufl.dot(b, v)
        heavy = carried(points, "density", points.density + end.growth * water, unit="kg/m^d")
        heavy.gravity = b
        keeps.append(heavy)
    if factor := factor_of(projection, u, p):
        terms += _projection(through, factor, theta, level, end, keeps, slope)
    on = {"drained": drained, "seepage": seepage, "inflow": inflow, "ponded": ponded}
    at_surfaces, outflows = _surface_terms(through, weight, v, as_tags(tag), on)
    keeps += [pressure, *outflows]
    if level is not None:
        for field in keeps:
            field.level = level.share
    penalty = {p: scale * _penalty(M, n0, fluid, K0, points, p)}
    marks = {**dX.metadata(), CARRIED: tuple(keeps), PENALTY: penalty, UNIT: {p: unit}}
    return sum(at_surfaces, form + terms * dX(metadata=marks))


def _slope(points: MaterialPoints, gradient: Expr) -> CarriedField:
    """The gradient of the pressure at the end of the last step (Pa/m)."""
    first = np.zeros(points.gdim)
    slope = carried(points, "pressure_gradient", gradient, unit="Pa/m", first=first)
    slope.slope_of = "pressure"
    return slope


def _stored(
    points: MaterialPoints, fluid: Fluid, end: Kinematics, porosity: Expr, change: Expr
) -> Expr:
    """Volume of water that a step stores, per initial volume.

    Args:
        points: Material points.
        fluid: The fluid.
        end: Volume changes at the end of the step.
        porosity: Porosity at the end of the step.
        change: Change of the pressure in the step (Pa).
    """
    if not fluid.compressible:
        return end.growth
    bulk = own_constant(points.grid, fluid.bulk_modulus)
    return end.growth + end.J * porosity / bulk * change


def _surface_terms(
    through: Flow, weight: Any, v: Any, tags: Tags, given: dict[str, Any]
) -> tuple[list[ufl.Form], list[CarriedField]]:
    """Terms at the surfaces of four arguments of `poromechanics` by name, and their outflows."""
    points = through.points
    forms: list[ufl.Form] = []
    leaving: dict[Surface, Expr] = {}

    def of(what: str, *unit: Any) -> list[tuple[Surface, Any]]:
        return surfaces(what, given[what], points, tags, *unit)

    def leaves(surface: Surface, volume: Expr) -> None:
        forms.append(volume * through.q * surface.dX)
        leaving[surface] = leaving[surface] + volume if surface in leaving else volume

    held = {"drained": of("drained", "Pa", 0.0), "seepage": of("seepage", "Pa", 0.0)}
    held["ponded"] = of("ponded", "m")
    warn_of_levels(points, weight, held["ponded"])
    refuse_two_pressures(held)
    for surface, value in held["drained"]:
        leaves(surface, prescribed_pressure(through, surface, value))
    for surface, value in held["seepage"]:
        leaves(surface, seepage_face(through, surface, value))
    for surface, rate in of("inflow", "m/s"):
        leaves(surface, prescribed_inflow(through, surface, rate))
    for surface, level in held["ponded"]:
        depth = ufl.max_value(level - surface.position(through.u)[points.gdim - 1], 0.0)
        wet = prescribed_pressure(through, surface, weight * depth)
        # a face above the water has no water to give: there the condition is that of seepage
        dry = seepage_face(through, surface, own_constant(points.grid, 0.0))
        leaves(surface, ufl.conditional(ufl.gt(depth, 0.0), wet, dry))
        forms.append(surface.pressure(weight * depth, through.u, v))
    return forms, [outflow(points, surface, volume) for surface, volume in leaving.items()]


def _flow_before(
    points: MaterialPoints, flow: Expr, at: Kinematics, q: Expr, slope: CarriedField
) -> Expr:
    """Flow at the start of a step, times the gradient of a test function at the start.

    Where pressures were given and no step has computed their flow, the flow at the end of the step
    takes its place: a single implicit step, which does not lower the order.

    Args:
        points: Material points.
        flow: Flow at the end of the step (Pa m/s).
        at: Volume changes and gradients at the end of the step.
        q: Test function.
        slope: The carried gradient of the pressure.
    """
    before = carried(points, "flow", flow, unit="Pa m/s", first=np.zeros(points.gdim))
    known = carried(points, "flow_known", own_constant(points.grid, 1.0), first=1.0)
    slope.unknown = known.name
    return known * ufl.dot(before, ufl.grad(q)) + (1 - known) * ufl.dot(flow, at.grad(q))


def _projection(
    through: Flow,
    factor: float,
    theta: float,
    level: Level | None,
    end: Kinematics,
    keeps: list[CarriedField],
    slope: CarriedField,
) -> Expr:
    """Polynomial pressure projection; see `projected`. Fields that it carries join `keeps`."""
    points, p, at = through.points, through.p, through.at
    change, share = at.grad(p) - slope, theta
    if level is not None:
        slope.update = end.spatial(level.end(slope, ufl.grad(p)))
        whole = level.whole * (ufl.grad(p) - slope)
        change, rate = level.change("gradient_rate", whole, "Pa/(m s)")
        share = 1 / level.weight
        keeps += [slope, rate]
    return projected(points, factor, change, p, through.q, through.M, through.K, share)


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
