"""Checks that hold for every law with a return mapping, whatever its yield surface."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from dolfinmpm.materials import (
    CamClay,
    DruckerPrager,
    Hencky,
    Law,
    MohrCoulomb,
    Tresca,
    VonMises,
)
from dolfinmpm.materials.base import Response

Array = npt.NDArray[np.float64]
EPS = np.finfo(float).eps
# One law of each kind, for soil of some 1 MPa
SOILS = {
    "Hencky": Hencky(1e6, 0.3),
    "VonMises": VonMises(1e6, 0.3, radius=2e4, hardening=1e5),
    "Tresca": Tresca(1e6, 0.33, 1e4),
    "MohrCoulomb": MohrCoulomb(1e6, 0.3, 5e3, 25.0, dilation_angle=8.0),
    "DruckerPrager": DruckerPrager(1e6, 0.3, 5e3, 25.0, dilation_angle=8.0),
    "CamClay": CamClay(
        swelling=0.018, compression=0.13, M=1.05, mu0=5.4e6, alpha=0.0, reference_pressure=2e4,
        preconsolidation=4e4,
    ),
}  # fmt: skip


def random_strains(n: int, seed: int, low: float = 1e-12, high: float = 1.0) -> Array:
    """Principal strains of every kind, shape (n, 3).

    Sizes of shear and volume are independent and spread evenly over the decades from
    `low` to `high`, with both signs; among them are strains with two or all three
    values equal, and zeros.
    """
    rng = np.random.default_rng(seed)
    shear, volume = np.exp(rng.uniform(np.log(low), np.log(high), (2, n)))
    strains = rng.uniform(-0.5, 0.5, (n, 3)) * shear[:, None]
    strains += (volume * rng.choice([-1.0, 0.0, 1.0], n) / 2)[:, None]
    kind = rng.integers(0, 12, n)
    for k, (i, j) in enumerate([(0, 1), (1, 2), (2, 0)]):
        strains[kind == k, i] = strains[kind == k, j]
    strains[kind == 3] = strains[kind == 3, :1]
    strains[kind == 4, 1] = 0.0
    return strains


def states(n: int, seed: int = 0) -> Array:
    """Trial strains of all sizes and signs, many with equal values, some zero.

    Unlike `random_strains` it holds a quarter of strains that are all large, and
    sizes of shear and volume go together. Shape (n, 3), values within ±0.2.
    """
    rng = np.random.default_rng(seed)
    strain = rng.uniform(-0.2, 0.2, (n, 3)) * 10 ** rng.uniform(-7, 0, (n, 1))
    strain[: n // 4] = rng.uniform(-0.2, 0.2, (n // 4, 3))
    strain[::7, 1] = strain[::7, 0]
    strain[::21, 2] = strain[::21, 0]
    strain[5::500] = 0.0
    return strain


def default_scale(law: Law, result: Response, parameters: Array) -> Array:
    """Size (Pa) that |f| is measured by: the largest stress, or the strength without stress.

    f is a difference of terms of this size, so that the rounding of the stress alone
    changes it by a few 1e-16 of it, however the stress was found. For a law whose f is
    not a stress give another scale.
    """
    strength = np.abs(law.yield_function(np.zeros_like(result.stress), result.internal, parameters))
    return np.maximum(np.abs(result.stress).max(axis=1), strength)


def check_finite(result: Response) -> None:
    """Every number of a response is one."""
    for values in (result.strain, result.internal, result.stress, result.tangent):
        assert np.isfinite(values).all()


def check_return(
    law: Law,
    strains: Array,
    internal: Array | None = None,
    x: Array | None = None,
    *,
    elastic: Law | None = None,
    scale: Callable[[Law, Response, Array], Array] = default_scale,
    tolerance: float = 1e-9,
) -> Response:
    """Admissible stress, unchanged elastic states, order, dissipation, idempotence.

    Args:
        law: Law under test.
        strains: Principal trial strains, shape (n, 3).
        internal: Internal variables at the start, shape (n, variables).
        x: Positions for parameters that vary.
        elastic: Law without yielding that gives the stress from the elastic strain.
        scale: What |f| is measured by, from the law, its response and the parameters.
        tolerance: Bound on f by its scale, and on stresses by theirs.

    Returns:
        The response, for further checks.
    """
    parameters = law.parameter_array(x)
    old = law.first_internal(parameters) if internal is None else internal
    old = np.broadcast_to(old, (len(strains), len(law.internal)))
    result = law.respond(strains, internal=old, x=x)
    check_finite(result)

    f = law.yield_function(result.stress, result.internal, parameters)
    yielded = (result.strain != strains).any(axis=1) | (result.internal != old).any(axis=1)
    # without strength and without stress there is nothing to round
    worst = f / np.maximum(scale(law, result, parameters), np.finfo(float).tiny)
    assert worst.max() <= tolerance, (strains[worst.argmax()], worst.max())
    assert np.abs(worst[yielded]).max(initial=0.0) <= tolerance, np.abs(worst[yielded]).max()

    size = np.abs(result.stress).max(axis=1)
    stiffness = np.abs(law.respond(np.zeros_like(strains), internal=old, x=x).tangent).max()
    size = np.maximum(size, 1e-12 * stiffness * np.abs(strains).max(axis=1))
    for i, j in itertools.combinations(range(3), 2):
        turned = (strains[:, i] - strains[:, j]) * (result.stress[:, i] - result.stress[:, j])
        assert (turned >= -1e-14 * size * np.abs(strains[:, i] - strains[:, j])).all()
        equal = strains[:, i] == strains[:, j]
        assert (result.stress[equal, i] == result.stress[equal, j]).all()

    plastic = strains - result.strain
    work = (result.stress * plastic).sum(axis=1)
    terms = np.abs(result.stress).max(axis=1) * np.abs(strains).max(axis=1)
    assert (work >= -1e-12 * terms).all(), (work / terms).min()

    again = law.respond(result.strain, internal=result.internal, x=x)
    assert (np.abs(again.stress - result.stress).max(axis=1) <= tolerance * size).all()
    if elastic is not None:
        expected = elastic.respond(result.strain, x=x).stress
        assert (np.abs(expected - result.stress).max(axis=1) <= tolerance * size).all()
    return result


def check_tangent(
    law: Law,
    strains: Array,
    internal: Array | None = None,
    x: Array | None = None,
    *,
    step: float = 1e-6,
    tolerance: float = 1e-5,
    share: float = 0.9,
) -> None:
    """The tangent against central differences, where the stress is smooth.

    A state counts as smooth if differences to either side agree; at least `share` of
    the states must.

    Args:
        law: Law under test.
        strains: Principal trial strains, shape (n, 3).
        internal: Internal variables at the start, shape (n, variables).
        x: Positions for parameters that vary.
        step: Step of the differences by the largest strain of the state.
        tolerance: Bound on the difference by the largest entry of the state's tangent.
        share: Share of states that must be smooth.
    """
    here = law.respond(strains, internal=internal, x=x)
    h = step * np.abs(strains).max(axis=1)
    assert (h > 0).all()
    numeric = np.empty_like(here.tangent)
    sides = np.empty((2, *here.tangent.shape))
    for j in range(3):
        move = np.zeros_like(strains)
        move[:, j] = h
        up, down = strains + move, strains - move
        ahead, behind = (law.respond(e, internal=internal, x=x).stress for e in (up, down))
        sides[0, :, :, j] = (ahead - here.stress) / (up[:, j] - strains[:, j])[:, None]
        sides[1, :, :, j] = (here.stress - behind) / (strains[:, j] - down[:, j])[:, None]
        numeric[:, :, j] = (ahead - behind) / (up[:, j] - down[:, j])[:, None]
    size = np.abs(here.tangent).max(axis=(1, 2))
    size = np.maximum(size, 1e-3 * size.max())
    smooth = np.abs(sides[0] - sides[1]).max(axis=(1, 2)) <= 1e-3 * size
    assert smooth.mean() >= share, smooth.mean()
    error = np.abs(numeric - here.tangent).max(axis=(1, 2))[smooth] / size[smooth]
    assert error.max() <= tolerance, (strains[smooth][error.argmax()], error.max())


def central_differences(
    law: Law, strains: Array, step: float
) -> tuple[Array, list[tuple[Array, Response]]]:
    """The tangent by central differences of one step, whatever lies between their ends.

    Args:
        law: Law under test.
        strains: Principal trial strains, shape (n, 3).
        step: Step in every principal strain.

    Returns:
        The differences (Pa), shape (n, 3, 3), and their six ends: strains and response.
    """
    found = np.empty((len(strains), 3, 3))
    ends = []
    for j in range(3):
        for sign in (1, -1):
            moved = strains + sign * step * np.eye(3)[j]
            ends.append((moved, law.respond(moved)))
        found[:, :, j] = (ends[-2][1].stress - ends[-1][1].stress) / (2 * step)
    return found, ends


def check_permutations(law: Law, strains: Array, internal: Array | None = None) -> None:
    """Another order of the axes reorders the answer and changes no bit of it."""
    here = law.respond(strains, internal=internal)
    for order in itertools.permutations(range(3)):
        turn = list(order)
        there = law.respond(np.ascontiguousarray(strains[:, turn]), internal=internal)
        assert (there.strain == here.strain[:, turn]).all()
        assert (there.stress == here.stress[:, turn]).all()
        assert (there.internal == here.internal).all()
        assert (there.tangent == here.tangent[:, turn][:, :, turn]).all()


def check_maximal_dissipation(law: Law, strains: Array, others: Array | None = None) -> None:
    """(τ − τ*)·Δεᵖ ≥ 0 for every admissible τ*: what associated perfect plasticity means.

    Args:
        law: Associated law without hardening.
        strains: Principal trial strains, shape (n, 3).
        others: Admissible principal stresses τ* (Pa), shape (m, 3); those that the law
            itself returns by default.
    """
    result = law.respond(strains)
    plastic = strains - result.strain
    others = result.stress if others is None else others
    gain = (result.stress * plastic).sum(axis=1)[:, None] - plastic @ others.T
    size = np.abs(plastic).max(axis=1)[:, None] * (
        np.abs(others).max(axis=1) + np.abs(result.stress).max(axis=1)[:, None]
    )
    # the plastic strain is a difference, known to the rounding of the trial strain
    size += np.abs(strains).max(axis=1)[:, None] * np.abs(others).max()
    assert (gain >= -1e-12 * size).all(), (gain / size).min()
