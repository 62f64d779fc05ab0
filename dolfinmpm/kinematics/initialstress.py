"""Initial stress: the elastic state of the points for a given stress field."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm._platform.argumentchecks import coordinates, floats, number, shown
from dolfinmpm._platform.errors import (
    FieldShapeError,
    ParameterError,
    StateError,
    call_together,
    raise_together,
)
from dolfinmpm.body.pointchecks import seal_stress
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.grid.userfunctions import call_function
from dolfinmpm.kinematics.deposits import Deposit, check_dimension
from dolfinmpm.kinematics.groundunits import warn_of_weights
from dolfinmpm.kinematics.strainformulation import Array, Rows, StrainFormulation
from dolfinmpm.kinematics.strainhistory import GIVEN, MARKS
from dolfinmpm.materials.elasticinverse import belong, elastic_strain

__all__ = ["StressField", "geostatic_stress", "take_stress", "write_stress"]

StressField = npt.ArrayLike | Callable[[Array], npt.ArrayLike]
OfPosition = float | Callable[[Array], npt.ArrayLike]
_ROUNDING = 1e-12
# Relative difference between a stress that was set and the law's stress, above which the stress
# was set for another law
_ANOTHER = 1e-6
# Distance beyond the yield surface, by the largest stress, that is rounding
_ROUND_OFF = 1e-9
# No ground has a larger K0: a larger number is a weight in the wrong place
_MOST_K0 = 20.0


def _array(stress: npt.ArrayLike, n: int) -> Array:
    """A stress for all n points of this rank, shape (3, 3), or one per point, shape (n, 3, 3)."""
    given = floats(stress)
    if given is None or given.shape not in ((3, 3), (n, 3, 3)):
        got = f"= {shown(stress)}" if given is None else f"has the shape {given.shape}"
        raise FieldShapeError(
            f"stress {got}, expected (3, 3), or {(n, 3, 3)} for all points of this rank; with "
            "components out of the plane, in Pa, tension positive"
        )
    return given


def _given(formulation: StrainFormulation, stress: StressField, rows: Rows) -> Array:
    """The stress at some points of this rank, checked and symmetric, shape (rows, 3, 3)."""
    points = formulation.points
    d = points.gdim
    if callable(stress):
        sigma = call_function(
            "stress (Pa, also out of the plane)", stress, points["x"][rows], (3, 3)
        )
    else:
        sigma = np.broadcast_to(_array(stress, len(points)), (len(points), 3, 3))[rows]
    size = np.abs(sigma).max(axis=(1, 2), initial=0.0)
    skew = np.abs(sigma - np.swapaxes(sigma, 1, 2)).max(axis=(1, 2), initial=0.0)
    across = np.abs(sigma[:, d:] * (1 - np.eye(3)[d:])).max(axis=(1, 2), initial=0.0)
    for bad, rule in (
        (~np.isfinite(size), "must be finite"),
        (skew > _ROUNDING * size, "must be symmetric"),
        (across > _ROUNDING * size, f"must have no shear out of the {d} dimensions of the points"),
    ):
        if bad.any():
            k = int(np.argmax(bad))
            p = rows[k]
            raise ParameterError(
                f"the initial stress {sigma[k].tolist()} Pa of point {points['id'][p]} at "
                f"{points['x'][p]} m {rule} ({int(bad.sum())} such points on this rank)"
            )
    return 0.5 * (sigma + np.swapaxes(sigma, 1, 2))


def _state(formulation: StrainFormulation, sigma: Array, rows: Rows) -> Array:
    """Elastic state for Cauchy stresses of shape (n, 3, 3), six components, shape (n, 6)."""
    points, law = formulation.points, formulation.law
    n, d = len(rows), points.gdim
    ratio = np.linalg.det(points["F"][rows]) if formulation.multiplicative else np.ones(n)
    principal = np.diagonal(sigma, axis1=1, axis2=2).copy()
    Q = np.broadcast_to(np.eye(3), (n, 3, 3)).copy()
    principal[:, :d], Q[:, :d, :d] = np.linalg.eigh(sigma[:, :d, :d])
    principal *= ratio[:, None]
    parameters, internal = formulation.parameters(rows), formulation.internal(rows)
    strain, good, reached = elastic_strain(law, principal, internal, parameters)
    if not good.all():
        p = int(np.argmin(good))
        at = slice(p, p + 1)
        used = parameters[at] if len(parameters) > 1 else parameters
        f = float(law.yield_function(principal[at], internal[at], used)[0])
        cause = (
            f"lie outside the yield surface (f = {f:.6g} > 0)" if f > 0 else
            f"cannot be reached (f = {f:.6g}, closest {reached[p].tolist()} Pa)"
        )  # fmt: skip
        kind = "Kirchhoff" if formulation.multiplicative else "Cauchy"
        variables = ", ".join(f"{k} = {v:g}" for k, v in zip(law.internal, internal[p]))
        values = ", ".join(f"{k} = {v:g}" for k, v in zip(law.parameters, used[0]))
        raise StateError(
            f"{type(law).__name__}: the principal {kind} stresses {principal[p].tolist()} Pa of "
            f"point {points['id'][rows[p]]} at {points['x'][rows[p]]} m {cause}; "
            f"{variables or 'no internal variables'}; {values} "
            f"({int((~good).sum())} such points on this rank). Give a stress within the law's "
            "strength, or other parameters"
        )
    with np.errstate(over="ignore", invalid="ignore"):
        value = np.exp(2.0 * strain) if formulation.multiplicative else strain
    # the square of a stretch is 0 where the strain is far below any
    possible = np.isfinite(value) & ((value > 0.0) | (not formulation.multiplicative))
    if not possible.all():
        p = int(np.argmin(possible.all(axis=1)))
        raise StateError(
            f"{type(law).__name__}: the principal stresses {principal[p].tolist()} Pa of point "
            f"{points['id'][rows[p]]} at {points['x'][rows[p]]} m need infinite strains; "
            "check that the unit is Pa"
        )
    tensor = (Q * value[:, None, :]) @ np.swapaxes(Q, 1, 2)
    return tensor[:, [0, 1, 2, 0, 1, 0], [0, 1, 2, 1, 2, 2]]


def _beyond_strength(formulation: StrainFormulation, sigma: Array, rows: Rows) -> StateError | None:
    """The error for stresses beyond the strength of an incremental law, or None.

    Such a law keeps no elastic strain whose inversion would find it out.
    """
    law: Any = formulation.law
    f = law.beyond_strength(sigma)
    bad = f > _ROUND_OFF * np.abs(sigma).max(axis=(1, 2), initial=0.0)
    if not bad.any():
        return None
    p = int(np.argmax(bad))
    return StateError(
        f"{law!r}: the stress {sigma[p].tolist()} Pa of point "
        f"{formulation.points['id'][rows[p]]} at {formulation.points['x'][rows[p]]} m lies outside "
        f"the yield surface (f = {f[p]:.6g} > 0) ({int(bad.sum())} such points on this rank). Give "
        "a stress within the law's strength, such as by a larger K0, or other parameters"
    )


def _derive(formulation: StrainFormulation, rows: Rows) -> None:
    """Set the internal variables that follow from the elastic state."""
    names = formulation.law.derived
    if names and rows.size:
        d = formulation.points.strain_dim
        new = formulation.commit(np.zeros((rows.size, d * d)), rows)
        for name in names:
            formulation.points[name][rows] = new[name]


def write_stress(
    formulation: StrainFormulation, stress: StressField, rows: Rows | None = None
) -> None:
    """Set the elastic state and the field `stress`; see `dolfinmpm.set_stress`. Collective.

    Args:
        formulation: The law at its points.
        stress: The stress (Pa); see `dolfinmpm.set_stress`.
        rows: Points of this rank that get the stress; all points of the law by default.
    """
    points, rows = formulation.points, formulation.rows if rows is None else rows
    sigma = call_together(points.comm, lambda: _given(formulation, stress, rows))
    if callable(stress):
        _refuse_nothing(points, sigma, rows)
        weight = _unit_weights(stress)
        if weight is not None:
            warn_of_weights(points, weight(points["x"][rows].T), rows)
    if formulation.from_stress:
        raise_together(points.comm, _beyond_strength(formulation, sigma, rows))
    else:
        state = call_together(points.comm, lambda: _state(formulation, sigma, rows))
        points[formulation.state][rows] = state
        _derive(formulation, rows)
    points["stress"][rows] = sigma
    points["moved_under"][rows] = MARKS[formulation.strain] + GIVEN
    seal_stress(points)


def _unit_weights(stress: Any) -> Callable[[Array], npt.ArrayLike] | None:
    """Unit weights of the ground (N/m³) by position, if its stress follows from them, or None."""
    ground = getattr(stress, "__self__", None)
    if isinstance(ground, Deposit):
        return ground.effective_weight
    return getattr(stress, "unit_weight", None)


def _refuse_nothing(points: MaterialPoints, sigma: Array, rows: Rows) -> None:
    """Raise ParameterError if a function of positions gives no point a stress. Collective.

    Points above the surface of the ground have none, as where a depth was given for its height.
    """
    up = points["x"][rows, -1]
    ends = np.array(
        [-up.min(initial=np.inf), up.max(initial=-np.inf), np.abs(sigma).max(initial=0.0)]
    )
    points.comm.Allreduce(MPI.IN_PLACE, ends, op=MPI.MAX)
    if ends[2] == 0.0 and np.isfinite(ends[0]):
        raise ParameterError(
            f"the function of the stress gives 0 at all points, which lie from {-ends[0]:.4g} to "
            f"{ends[1]:.4g} m along the last axis. The surface of the ground is a height in the "
            "grid, not a depth; points above it have no stress. For no stress at all give "
            "np.zeros((3, 3))"
        )


def take_stress(formulation: StrainFormulation, law: str) -> None:
    """Take the stress of points that have not moved as the initial stress of their law. Collective.

    A stress that the user wrote into the field `stress` becomes the initial stress. A stress from
    `dolfinmpm.set_stress` must belong to this law.

    Args:
        formulation: The law at its points.
        law: The law and its tags, for messages.

    Raises:
        ParameterError: The stress was set for another law; or a stress is not finite, not
            symmetric, or has shear out of the dimensions of the points.
        StateError: The law has no elastic strain for the stress, or not its strength.
    """
    points, rows = formulation.points, formulation.rows
    marks = points.fields.read("moved_under")[rows]
    if formulation.from_stress:
        still = rows[marks == 0]
        sigma = points.fields.read("stress")[still]
        raise_together(points.comm, _beyond_strength(formulation, sigma, still))
        return
    still, given = rows[marks == 0], rows[marks >= GIVEN]
    stress = points.fields.read("stress")
    # shortcut for the usual case without stress
    written = still[np.any(stress[still], axis=(1, 2))] if stress.any() else still[:0]
    asked = np.array([written.size, given.size])
    if points.comm.size > 1:
        points.comm.Allreduce(MPI.IN_PLACE, asked)
    if asked[0]:
        write_stress(formulation, points["stress"], written)
    if asked[1]:
        raise_together(points.comm, _of_another(formulation, law, given))


def _of_another(formulation: StrainFormulation, law: str, rows: Rows) -> ParameterError | None:
    """The error for stresses that were set for another law, or None."""
    points = formulation.points
    sigma = points.fields.read("stress")[rows]
    if formulation.multiplicative:
        sigma = np.linalg.det(points.fields.read("F")[rows])[:, None, None] * sigma
    # for an isotropic law, stress and strain have the same axes and the same order
    strain, stress = formulation.principal(rows), np.linalg.eigvalsh(sigma)
    internal, parameters = formulation.internal(rows), formulation.parameters(rows)
    same = belong(formulation.law, strain, stress, internal, parameters, _ANOTHER)
    if same.all():
        return None
    p = rows[np.argmin(same)]
    return ParameterError(
        f"{law}: the stress {points.fields.read('stress')[p].tolist()} Pa at {points['x'][p]} m "
        f"was set by mpm.set_stress with another law, or changed since. It differs from this law's "
        f"stress for the elastic strain of the point ({int((~same).sum())} such points on this "
        f'rank): call mpm.set_stress(law, points, stress, strain="{formulation.strain}") with the '
        "law of the problem"
    )


def geostatic_stress(surface: OfPosition, weight: OfPosition, K0: OfPosition):
    """Stress of ground at rest under its own weight, for `dolfinmpm.set_stress`.

    The vertical stress is −weight · (surface − y). Both horizontal stresses are K0 times the
    vertical stress. There is no shear. The last axis points up. Points above the surface have no
    stress. The stress is in equilibrium if the surface is level, and weight and K0 depend only on
    the height.

    Args:
        surface: Height of the ground surface (m).
        weight: Mean weight per volume ρ g of the ground above (N/m³), not negative.
        K0: Ratio of horizontal to vertical stress (-), not negative.

    All three are numbers, or functions of positions x (m), shape (gdim, n), that return n values.

    Returns:
        A function of positions (m), shape (gdim, n), that returns Cauchy stresses (Pa), shape
        (n, 3, 3), positive in tension.

    Raises:
        ParameterError: A number is not finite; weight or K0 is negative; K0 is above 20; or
            surface and weight look swapped. The returned function raises it for values at points.

    >>> import dolfinmpm as mpm
    >>> import numpy as np
    >>> stress = mpm.geostatic_stress(surface=10.0, weight=2e4, K0=0.5)
    >>> stress(np.array([[0.0], [8.0]]))[0].diagonal().tolist()
    [-20000.0, -40000.0, -20000.0]
    """

    def checked(name: str, value: npt.ArrayLike, low: float) -> Array:
        values = coordinates(name, value)
        bad = ~(np.isfinite(values) & (values >= low))
        if bad.any():
            raise ParameterError(
                f"{name} = {values[bad].flat[0]} must be finite"
                + (f" and at least {low:g}" if math.isfinite(low) else "")
            )
        if name == "K0" and (values > _MOST_K0).any():
            raise ParameterError(
                f"K0 = {values.max():g} must be a ratio of stresses, and at most {_MOST_K0:g}: the "
                "order is surface, weight, K0"
            )
        return values

    limits = (("surface", surface, -math.inf), ("weight", weight, 0.0), ("K0", K0, 0.0))
    for name, value, low in limits:
        if not callable(value):
            number(name, value)
            checked(name, value, low)
    both = not (callable(surface) or callable(weight))
    if both and float(surface) > 100 * max(float(weight), 10.0):  # type: ignore[arg-type]
        raise ParameterError(
            f"surface = {surface:g} m with weight = {weight:g} N/m³ look swapped: the order is "
            "surface, weight, K0"
        )

    def stress(x: Array) -> Array:
        x = coordinates("x", x)
        if x.ndim != 2:
            raise ParameterError(
                f"x has the shape {x.shape} and must have (gdim, n): points['x'].T"
            )
        for name, value, _ in limits:
            check_dimension(name, value, len(x))
        top, heavy, ratio = (
            checked(name, call_function(name, value, x.T) if callable(value) else value, low)
            for name, value, low in limits
        )
        vertical = -heavy * np.maximum(top - x[-1], 0.0)
        result = np.zeros((x.shape[1], 3, 3))
        for i in range(3):
            result[:, i, i] = vertical if i == len(x) - 1 else ratio * vertical
        return result

    def unit_weight(x: Array) -> npt.ArrayLike:
        given: Any = weight
        return call_function("weight", given, x.T) if callable(given) else np.asarray(given)

    # an attribute, so that `set_stress` can compare it with the densities of the points
    stress.unit_weight = unit_weight  # type: ignore[attr-defined]
    return stress
