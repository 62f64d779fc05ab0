"""Paths of element tests: what is prescribed, component by component.

A path is linear in the six strains and the six stresses: each of six conditions prescribes a
component, a sum or a difference of components (Bardet & Choucair 1991, doi 10.1002/nag.1610151202).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from numbers import Real
from typing import Any

import numpy as np
import numpy.typing as npt

from dolfinmpm._platform.argumentchecks import choice, number, refuse_idle, shown, whole
from dolfinmpm._platform.errors import ParameterError

__all__ = ["COMPONENTS", "Leg", "check_logarithmic", "legs_of"]

Array = npt.NDArray[np.float64]

COMPONENTS = ("xx", "yy", "zz", "xy", "yz", "xz")
# Path → strain or stress that leads, further strains and stresses that keep their value
_PATHS: dict[str, tuple[str, str, tuple[str, ...], tuple[str, ...]]] = {
    "isotropic": ("volume", "mean", ("xx-yy", "yy-zz"), ()),
    "oedometer": ("yy", "yy", (), ()),
    # the same strain along x and z: at an edge of a yield surface stress alone leaves it open
    "triaxial": ("yy", "yy-xx", ("xx-zz",), ("xx",)),
    "undrained triaxial": ("yy", "yy-xx", ("volume", "xx-zz"), ()),
    "simple shear": ("xy", "xy", (), ("yy",)),
    "undrained simple shear": ("xy", "xy", (), ()),
}
# Largest logarithmic strain of a path; larger ones are in per cent
_LARGEST = 3.0


@dataclass(frozen=True)
class Leg:
    """A part of a path, in which six conditions change linearly.

    Attributes:
        of_stress: Whether a condition is for stresses (Pa) and not for strains (-), shape (6,).
        weights: Weights of the components in each condition, shape (6, 6).
        targets: Values at the end; NaN where the first value stays. Shape (6,).
        steps: Number of steps.
    """

    of_stress: npt.NDArray[np.bool_]
    weights: Array
    targets: Array
    steps: int


def _weights(name: Any, is_stress: bool) -> Array:
    """Weights of the components by a name such as "yy", "yy-xx", "volume" or "mean"."""
    result = np.zeros(6)
    if name == ("mean" if is_stress else "volume"):
        result[:3] = 1.0 / 3.0 if is_stress else 1.0
        return result
    parts = name.split("-") if isinstance(name, str) else [""]
    if len(set(parts)) < len(parts) or len(parts) > 2 or not {*parts} <= {*COMPONENTS}:
        raise ParameterError(
            f"a leg prescribes {shown(name)}; it must be one of {', '.join(COMPONENTS)}, a "
            "difference such as 'yy-xx', 'volume' (a strain) or 'mean' (a stress)"
        )
    for part, sign in zip(parts, (1.0, -1.0)):
        result[COMPONENTS.index(part)] += sign
    return result


def leg(strain: Mapping[str, float | None], stress: Mapping[str, float | None], steps: int) -> Leg:
    """A leg of names; components that nothing names keep their strain.

    Raises:
        ParameterError: A name is not known, or the conditions are not six that are independent.
    """
    rows, targets, of_stress = [], [], []
    for is_stress, given in ((False, strain), (True, stress)):
        for name, value in given.items():
            rows.append(_weights(name, is_stress))
            targets.append(np.nan if value is None else number(str(name), value))
            of_stress.append(is_stress)
    named = np.any(np.array(rows).reshape(-1, 6) != 0.0, axis=0)
    for k in np.flatnonzero(~named):
        rows.append(np.eye(6)[k])
        targets.append(np.nan)
        of_stress.append(False)
    what = f"a leg with strain {dict(strain)} and stress {dict(stress)}"
    if len(rows) != 6:
        raise ParameterError(
            f"{what} has {len(rows)} conditions for 6 components: each component needs one; "
            "components that nothing names keep their strain"
        )
    weights, kind = np.array(rows), np.array(of_stress)
    for of in set(of_stress):
        if np.linalg.matrix_rank(weights[kind == of]) < np.count_nonzero(kind == of):
            raise ParameterError(
                f"{what} has conditions for {('strains', 'stresses')[of]} of which one follows "
                "from others: take it out, and name another component"
            )
    return Leg(kind, weights, np.array(targets), whole("steps", steps, 1))


def check_logarithmic(legs: Sequence[Leg]) -> None:
    """Refuse normal strains that are too large for logarithmic ones; shear may be large.

    Raises:
        ParameterError: A normal strain is more than 3.
    """
    for one in legs:
        normal = ~one.of_stress & one.weights[:, :3].any(axis=1)
        for strain in one.targets[normal & (np.abs(one.targets) > _LARGEST)]:
            raise ParameterError(
                f"the normal strain {strain:g} must be between -{_LARGEST:g} and {_LARGEST:g}: "
                "strains are logarithmic, and 10 % is 0.1"
            )


def legs_of(path: Any, to: Any, by: str, steps: int) -> list[Leg]:
    """The legs of a path.

    Args:
        path: Name of a path, or legs as dictionaries; see `element_test`.
        to: Turning points of the leading strain or stress.
        by: "strain" or "stress".
        steps: Steps of each leg.

    Raises:
        ParameterError: An argument is out of range.
    """
    by = choice("by", by, ("strain", "stress"))
    if not isinstance(path, str):
        refuse_idle("by", by, "strain", "legs name strains and stresses themselves")
        return _given_legs(path, to, steps)
    path = choice("path", path, _PATHS)
    single = isinstance(to, Real) or (isinstance(to, np.ndarray) and to.ndim == 0)
    turns = [to] if single else to
    if not isinstance(turns, (Sequence, np.ndarray)) or isinstance(turns, str) or not len(turns):
        raise ParameterError(f"to = {shown(to)} must be a number, or turning points one by one")
    strain, stress, *kept = _PATHS[path]
    found = []
    for turn in turns:
        of_strain, of_stress = (dict.fromkeys(names) for names in kept)
        end = number("to", turn)
        more = ({strain: end}, {}) if by == "strain" else ({}, {stress: end})
        found.append(leg(of_strain | more[0], of_stress | more[1], steps))
    return found


def _given_legs(path: Any, to: Any, steps: int) -> list[Leg]:
    if not isinstance(path, Sequence) or not len(path):
        raise ParameterError(
            f"path = {shown(path)} must be one of {', '.join(_PATHS)}; or a list of legs, such as "
            "{'strain': {'yy': -0.01}, 'stress': {'xx': -1e5, 'zz': -1e5}}"
        )
    found = []
    for part in path:
        known = isinstance(part, Mapping) and not set(part) - {"strain", "stress", "steps"}
        given = [part.get(name, {}) for name in ("strain", "stress")] if known else [None]
        if not all(isinstance(one, Mapping) for one in given):
            raise ParameterError(
                f"the leg {part!r} must be a dictionary with strain, stress and steps; strain and "
                "stress are dictionaries by component, such as {'strain': {'yy': -0.01}}"
            )
        found.append(leg(given[0], given[1], part.get("steps", steps)))
    if to is not None:
        raise ParameterError(
            f"to = {shown(to)} is for paths by name; legs have values of their own"
        )
    return found
