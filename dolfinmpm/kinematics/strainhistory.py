"""Marks of the strain formulation with which points have moved, and checks of these marks."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm._platform.errors import ParameterError, StateError, raise_together
from dolfinmpm.body.points import MaterialPoints

__all__ = ["ENERGY", "GIVEN", "MARKS", "UMAT", "check_history", "refuse_stress"]

ENERGY = "energy"
UMAT = "umat"
# values of the points' field `moved_under`; 0 for points that have not moved
MARKS = {"large": 1, "small": 2, "jaumann": 3, ENERGY: 4, UMAT: 5}
# added to the value if a stress was set and the point has not moved since
GIVEN = 16
_STATE = {
    "large": "the elastic strain in `be`",
    "small": "the elastic strain in `elastic_strain`",
    "jaumann": "the elastic strain in `elastic_strain`",
    ENERGY: "the deformation gradient `F`",
}


def _named(strain: str) -> str:
    words = {ENERGY: "an energy in UFL", UMAT: "a UMAT"}
    return words.get(strain, f'strain="{strain}"')


def check_history(
    points: MaterialPoints, rows: npt.NDArray[np.int32], strain: str, law: str
) -> None:
    """Refuse points that have moved with another strain formulation. Collective.

    Their stress would come from a field that was not updated. A body in equilibrium would then
    settle a second time.

    Args:
        points: Material points.
        rows: Points of the law on this rank.
        strain: Strain formulation of the law, a key of `MARKS`.
        law: The law and its tags, for the message.

    Raises:
        StateError: Points have moved with another formulation. The message tells how many, and
            how to go on.
    """
    marks = points.fields.read("moved_under")
    own = (marks if len(rows) == len(marks) else marks[rows]) % GIVEN
    # usual case: all points have moved with this formulation, or none has moved
    low, high = (int(own.min()), int(own.max())) if own.size else (0, 0)
    fits = high == 0 or (high == MARKS[strain] and (low == high or not np.any(own % high)))
    if points.comm.allreduce(fits, op=MPI.LAND):
        return
    counts = np.bincount(own, minlength=1 + max(MARKS.values()))
    counts = points.comm.allreduce(counts)
    others = [name for name, mark in MARKS.items() if counts[mark] and name != strain]
    if not others:
        return
    done = " and ".join(f"{counts[MARKS[name]]} under {_named(name)}" for name in others)
    advice = (
        "set the state that gives the present stress first, "
        f'mpm.set_stress(law, points, points["stress"], strain="{strain}")'
        if strain != ENERGY else
        "a stress cannot be set for this law: go on with a law that has a kernel, such as Hencky, "
        "or begin with new points"
    )  # fmt: skip
    raise_together(
        points.comm,
        StateError(
            f"{law}: of its {counts.sum()} points have moved {done}; they cannot go on under "
            f"{_named(strain)}, whose stress comes from {_STATE[strain]}: {advice}"
        ),
    )


def refuse_stress(points: MaterialPoints, rows: npt.NDArray[np.int32], law: str) -> None:
    """Refuse an initial stress for a law that cannot have an initial stress. Collective.

    Args:
        points: Material points.
        rows: Points of the law on this rank.
        law: The law and its tags, for the message.

    Raises:
        ParameterError: A point that has not moved has a stress.
    """
    stress, error = points.fields.read("stress"), None
    still = rows[points.fields.read("moved_under")[rows] == 0] if stress.any() else rows[:0]
    stress = stress[still]
    if np.any(stress):
        k = int(np.argmax(np.any(stress, axis=(1, 2))))
        error = ParameterError(
            f"{law} computes its stress only from the deformation gradient, but the field `stress` "
            f"is {stress[k].tolist()} Pa at {points['x'][still[k]]} m before anything moves: set "
            "the field to zero, or take a law with a kernel, such as mpm.materials.Hencky, and "
            "mpm.set_stress"
        )
    raise_together(points.comm, error)
