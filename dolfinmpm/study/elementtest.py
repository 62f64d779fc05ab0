"""Element tests: one law at one point, along a path of strains and stresses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm._platform.argumentchecks import coordinates, number, shown
from dolfinmpm._platform.collective import collective
from dolfinmpm._platform.errors import ParameterError, StateError
from dolfinmpm.io.history import History
from dolfinmpm.study.elementpaths import COMPONENTS, Leg, check_logarithmic, legs_of
from dolfinmpm.study.elementpoint import ElementPoint, matrix

__all__ = ["element_test"]

Array = npt.NDArray[np.float64]

_ITERATIONS = 30
# Out-of-balance stress as a share of the largest stress, or of the change of stress
_CLOSE = 1e-10
# Shortest part of a step
_LEAST = 2.0**-12
# Increment for the derivative of the motion
_DELTA = 1e-7


@collective
def element_test(
    law: Any,
    path: str | Sequence[Mapping[str, Any]],
    to: float | Sequence[float] | None = None,
    *,
    by: str = "strain",
    pressure: float = 0.0,
    stress: Sequence[float] | None = None,
    strain: str | None = None,
    steps: int = 100,
) -> History:
    """Take a law along a path, without a grid; returns all strains, stresses and variables.

    Paths by name, with the axial direction y:

    - "isotropic": equal strains in all directions; `to` is the volume strain or the mean stress.
    - "oedometer": no strain in x and z; `to` is the strain or the stress along y.
    - "triaxial": constant stress along x, equal strains along x and z; `to` is the strain along
      y, or the difference σ_yy − σ_xx.
    - "undrained triaxial": the same with constant volume.
    - "simple shear": shear strain γ_xy or stress σ_xy at constant σ_yy, no strain in x and z.
    - "undrained simple shear": the same without any normal strain.

    Several values of `to` are turning points, as of a cyclic test. Other paths are lists of legs,
    `{"strain": {"yy": -0.01}, "stress": {"xx": -1e5, "zz": -1e5}, "steps": 50}`: values at the end
    of the leg by component. A difference such as "yy-xx", the strain "volume" and the stress "mean"
    are possible too; None keeps the value. Components that nothing names keep their strain.

    Strains and stresses are positive in tension. Stresses are Cauchy stresses. Normal strains are
    the sums of the increments: logarithmic strains under large strain. Shear moves x along y, with
    engineering shear strains. Stresses are in fixed axes.

    Args:
        law: A law of `mpm.materials`.
        path: Name of a path, or legs.
        to: Last value, or turning points, of the leading strain (-) or stress (Pa).
        by: "strain" or "stress": which of the two leads.
        pressure: First isotropic stress (Pa), positive in compression.
        stress: First normal stresses xx, yy, zz (Pa), in place of a pressure.
        strain: Strain formulation; by default "large", and "jaumann" for a UMAT.
        steps: Steps of each leg.

    Returns:
        A history with `strain_xx` ... `strain_xz`, `stress_xx` ... `stress_xz`, `volume_strain`,
        `p` (mean stress, positive in compression), `q` (√3 J₂), `pore_pressure` (Pa, at constant
        volume with the first total stress along x, or along y in simple shear), and the law's
        internal variables.

    Raises:
        ParameterError: An argument is out of range.
        StateError: No strain gives the stress that is prescribed, as beyond a peak; or the law
            finds no stress.

    Drained compression of sand, a Mohr–Coulomb material:

    >>> import dolfinmpm as mpm
    >>> sand = mpm.materials.MohrCoulomb(E=20e6, nu=0.3, cohesion=1e3, friction_angle=30.0)
    >>> test = mpm.study.element_test(sand, "triaxial", -0.05, pressure=100e3)
    >>> round(test["q"][-1])
    203478
    >>> import tempfile
    >>> test.plot(f"{tempfile.mkdtemp()}/triaxial.png", "strain_yy", "q")
    """
    legs = legs_of(path, to, by, steps)
    point = ElementPoint(law, strain, _first(pressure, stress))
    if point.kind != "small":
        check_logarithmic(legs)
    history = History(MPI.COMM_WORLD)
    # the side whose total stress a test of this kind keeps
    side = 1 if isinstance(path, str) and path.endswith("simple shear") else 0
    start = point.stress[side]
    _record(history, point, side, start)
    for one in legs:
        begin = _present(one, point)
        end = np.where(np.isnan(one.targets), begin, one.targets)
        for k in range(one.steps):
            values = begin + (end - begin) * np.array([k, k + 1])[:, None] / one.steps
            _go(one, point, *values)
            _record(history, point, side, start)
    return history


def _first(pressure: float, stress: Any) -> Array:
    number("pressure", pressure)
    if stress is None:
        return np.full(3, -float(pressure))
    found = coordinates("stress", stress)
    if found.shape != (3,) or pressure != 0.0:
        raise ParameterError(
            f"stress = {shown(stress)} must be three normal stresses (Pa), without a pressure"
        )
    return found


def _present(leg: Leg, point: ElementPoint) -> Array:
    """Present values of the conditions of a leg, shape (6,)."""
    values = np.where(leg.of_stress[:, None], point.stress, point.strain)
    return np.einsum("ck,ck->c", leg.weights, values)


def _go(leg: Leg, point: ElementPoint, begin: Array, end: Array) -> None:
    """Take one step, in parts where a whole step does not converge."""
    done, share = 0.0, 1.0
    guess: Array = np.zeros(6)
    while done < 1.0 - 1e-12:
        target = begin + (end - begin) * min(done + share, 1.0)
        found = _solve(leg, point, target, guess)
        if isinstance(found, str):
            share *= 0.5
            guess = np.zeros(6)
            if share < _LEAST:
                names = dict(zip(COMPONENTS, map(float, point.strain.round(9))))
                raise StateError(
                    f"the element test of {point.law!r} ends at the strain {names} and the stress "
                    f"{point.stress.tolist()} Pa: {found}. Prescribe strains instead of stresses "
                    "beyond a peak, or take more steps"
                )
            continue
        point.commit(found)
        done, guess = done + share, found


def _motion(kind: str, G: Array) -> Array:
    """Gradient H of the increment for the strain increments, shape (3, 3)."""
    tensor = matrix(G)
    if kind == "small":
        return tensor
    if kind == "large":
        from scipy.linalg import expm

        return np.asarray(expm(tensor)) - np.eye(3)
    return tensor @ np.linalg.inv(np.eye(3) - 0.5 * tensor)


def _solve(leg: Leg, point: ElementPoint, target: Array, guess: Array) -> Array | str:
    """Strain increments for which all conditions hold, shape (6,), or the reason of a failure."""
    G = guess.copy()
    # conditions for strains are linear: they hold from the first iteration on
    fixed = ~leg.of_stress
    G += np.linalg.lstsq(
        leg.weights[fixed], (target - _strained(leg, point, G))[fixed], rcond=None
    )[0]  # fmt: skip
    given = target[leg.of_stress]
    size = max(float(np.abs(point.stress).max()), float(np.abs(given).max(initial=0.0)))
    for _ in range(_ITERATIONS):
        H = _motion(point.kind, G)
        response = point.respond(H)
        if isinstance(response, str):
            return response
        sigma, slope = response
        found = np.where(leg.of_stress, leg.weights @ sigma, _strained(leg, point, G))
        gap = target - found
        close = _CLOSE * max(size, float(np.abs(sigma).max()))
        if np.abs(gap[leg.of_stress]).max(initial=0.0) <= close:
            point.motion[:] = H
            return G
        by_G = np.empty((9, 6))
        for k in range(6):
            sides = [_motion(point.kind, G + s * _DELTA * np.eye(6)[k]) for s in (1, -1)]
            by_G[:, k] = (sides[0] - sides[1]).ravel() / (2 * _DELTA)
        rows = np.where(leg.of_stress[:, None], leg.weights @ (slope @ by_G), leg.weights)
        try:
            change = np.linalg.solve(rows, gap)
        except np.linalg.LinAlgError:
            return "the tangent is singular"
        if not np.isfinite(change).all() or np.abs(change).max() > 1.0:
            return "the law resists no further"
        G = G + change
    return f"no balance in {_ITERATIONS} iterations"


def _strained(leg: Leg, point: ElementPoint, G: Array) -> Array:
    return np.asarray(leg.weights @ (point.strain + G), np.float64)


def _record(history: History, point: ElementPoint, side: int, first: float) -> None:
    sigma = matrix(point.stress)
    sigma = sigma + np.triu(sigma, 1).T
    mean = np.trace(sigma) / 3
    deviator = sigma - mean * np.eye(3)
    row = {f"strain_{name}": value for name, value in zip(COMPONENTS, point.strain)}
    row |= {f"stress_{name}": value for name, value in zip(COMPONENTS, point.stress)}
    row["volume_strain"] = point.strain[:3].sum()
    row["p"], row["q"] = -mean, np.sqrt(1.5 * np.sum(deviator**2))
    row["pore_pressure"] = point.stress[side] - first
    history.record(**{name: float(value) for name, value in (row | point.variables()).items()})
