"""Arguments of `poromechanics`: checked, and turned into UFL."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt
from ufl.core.expr import Expr

from dolfinmpm._platform.argumentchecks import check_kind, floats, number, shown, vector
from dolfinmpm._platform.errors import ParameterError, raise_together
from dolfinmpm.body.formarguments import check_displacement, check_increment, check_test
from dolfinmpm.body.points import MaterialPoints, PointField
from dolfinmpm.grid.constants import own_constant
from dolfinmpm.materials.base import lame
from dolfinmpm.porous.fluid import Fluid
from dolfinmpm.porous.mixturestep import Level

__all__ = [
    "first_porosity", "fluid_of", "gravity_of", "modulus_of", "permeability_of", "porosity_of",
    "suction_of", "time_weights", "unknowns",
]  # fmt: skip

# Ratio of a given modulus to that of the law, or its inverse, above which it has another unit
_FAR = 100.0


def unknowns(points: MaterialPoints, fields: Any, tests: Any) -> tuple[Any, Any, Any, Any]:
    """Increment u, pressure p and the test functions v and q.

    Raises:
        ParameterError: An argument is no pair, or has functions of other spaces.
    """
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


def fluid_of(fluid: Any) -> Fluid:
    """The fluid, water by default."""
    fluid = Fluid() if fluid is None else fluid
    check_kind("fluid", fluid, Fluid, "give dolfinmpm.Fluid()")
    return fluid


def time_weights(
    points: MaterialPoints, theta: Any, rho_inf: float | None
) -> tuple[float, Level | None]:
    """Weight of the flow at the end of the step, and the level of the generalised-α method.

    Raises:
        ParameterError: θ is below ½ or above 1, or both arguments are given.
    """
    theta = number("theta", theta, 0.0, 1.0, closed=True)
    if theta < 0.5:
        raise ParameterError(f"theta = {theta:g} must be at least 0.5: smaller ones are not stable")
    level = None if rho_inf is None else Level(points, rho_inf)
    if level is not None and theta != 1:
        raise ParameterError(
            f"theta = {theta:g} weights the flow at both ends of a step, but with rho_inf the flow "
            "is balanced at a level within the step: leave theta or rho_inf out"
        )
    return theta, level


def porosity_of(porosity: Any, points: MaterialPoints) -> Any:
    """Porosity for UFL."""
    if isinstance(porosity, Expr):
        if porosity.ufl_shape != ():
            raise ParameterError(f"porosity has shape {porosity.ufl_shape} and must be a scalar")
        return porosity
    return own_constant(points.grid, number("porosity", porosity, 0.0, 1.0))


def first_porosity(porosity: Any) -> float:
    """Porosity of the points before the first step."""
    # the value of an expression is known only in the first step
    return 0.5 if isinstance(porosity, Expr) else float(porosity)


def permeability_of(given: Any, J: Any, n: Any, points: MaterialPoints) -> Any:
    """Hydraulic conductivity for UFL, a scalar or a tensor (m/s)."""
    d = points.gdim
    if callable(given) and not isinstance(given, Expr):
        given = _of_porosity(given, J, n)
    if isinstance(given, Expr):
        if given.ufl_shape not in ((), (d, d)):
            raise ParameterError(
                f"permeability has shape {given.ufl_shape} and must be a scalar or of shape "
                f"{(d, d)}"
            )
        if isinstance(given, PointField):
            _check_field(given, points)
        return given
    if not isinstance(given, (list, tuple, str)) and np.ndim(given) == 0:
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


def _check_field(given: PointField, points: MaterialPoints) -> None:
    """Refuse a field of permeabilities with a negative one. Collective.

    Raises:
        ParameterError: A permeability is negative or not finite.
    """
    k, error = given.array, None
    k = np.linalg.eigvalsh(k)[:, 0] if k.ndim > 1 and np.isfinite(k).all() else k
    fine = (k >= 0) & np.isfinite(k)
    bad = np.flatnonzero(~fine.all(axis=tuple(range(1, k.ndim))))
    if bad.size:
        error = ParameterError(
            f"permeability = {shown(given.array[bad[0]])} m/s of the point at "
            f"{points['x'][bad[0]]} m must be finite and without negative eigenvalues"
        )
    raise_together(points.comm, error)


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
    tensor = floats(given)
    if tensor is None:
        raise ParameterError(
            f"permeability = {shown(given)} must be a number (m/s), a tensor, UFL or a function of "
            "J and n"
        )
    return tensor


def gravity_of(gravity: Any, points: MaterialPoints) -> Any:
    """Acceleration of gravity for UFL (m/s²), or None."""
    if gravity is None or isinstance(gravity, Expr):
        if gravity is not None and gravity.ufl_shape != (points.gdim,):
            raise ParameterError(
                f"gravity has shape {gravity.ufl_shape} and must be a vector of {points.gdim}"
            )
        return gravity
    return own_constant(points.grid, vector("gravity", gravity, points.gdim, "m/s²"))


def suction_of(suction: Any, points: MaterialPoints) -> Any:
    """Largest suction for UFL (Pa)."""
    return own_constant(points.grid, number("suction", suction, 0.0, math.inf, "Pa", True))


def modulus_of(modulus: Any, soil: Any, points: MaterialPoints) -> Any:
    """P-wave modulus M for UFL (Pa).

    Raises:
        ParameterError: It is not given for a law without elastic constants, or is given in another
            unit than those of the law.
    """
    values = getattr(soil, "values", {})  # a UMAT has none
    E, nu, own = values.get("E"), values.get("nu"), None
    if isinstance(E, float) and isinstance(nu, float):
        lmbda, mu = lame(E, nu)
        own = lmbda + 2 * mu
    if modulus is None:
        if own is None:
            raise ParameterError(
                f"{soil!r} has no elastic constants that are the same at all points, but the "
                "pressure stabilisation needs a modulus as scale: give modulus=M, the P-wave "
                "modulus (Pa)"
            )
        return own_constant(points.grid, own)
    given = number("modulus", modulus, 0.0, unit="Pa")
    # a thousandth, as of kPa for Pa, made the first undrained pressure fifty times too small
    if own is not None and not own / _FAR <= given <= own * _FAR:
        raise ParameterError(
            f"modulus = {given:g} Pa is far from the P-wave modulus of {soil!r}, {own:g} Pa, and "
            "pressures would be wrong: give it in the unit of E, or leave it out"
        )
    return own_constant(points.grid, given)
