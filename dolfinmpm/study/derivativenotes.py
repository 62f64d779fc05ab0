"""Notes for the user on derivatives that do not exist, or have large errors."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm.study.followingruns import FollowedRun, FollowingRuns

__all__ = ["doubtful", "rounded_away", "rounded_contacts", "too_steep", "without_effect"]

Array = npt.NDArray[np.float64]
# Values of the figures after each step, and their derivatives by the parameters
Figures = Mapping[str, Sequence[Array]]
Found = Mapping[str, Mapping[str, Sequence[Array]]]

# Estimated error from which a derivative is doubtful
_DOUBTFUL = 1e-3
# Share of the changes of positions by the perturbation that is told as lost in their rounding
_LOST = 1e-5
# The same for the overlap with a rigid body, whose force has fewer digits than positions
_LOST_FORCE = 1e-4
# Derivative over the figure from which the figure is hardly one of the parameters alone
_STEEP = 1e3


def rounded_away(base: FollowedRun, pairs: Sequence[FollowingRuns]) -> list[str]:
    """Note about changes of positions that are lost in their rounding. Collective.

    Args:
        base: The run.
        pairs: The runs that follow.
    """
    x = [problem.points.fields.read("x") for problem in base.problems]
    place = max(float(np.abs(one).max(initial=0.0)) for one in x)
    place = base.comm.allreduce(place, op=MPI.MAX)
    moved = base.comm.allreduce(max(pair.moved for pair in pairs), op=MPI.MAX)
    lost = np.finfo(float).eps * place
    # without any motion, no figure hangs on rounded motions
    if not moved or lost <= _LOST * moved:
        return []
    return [
        f"positions up to {place:.3g} m are rounded to {lost:.1g} m, and the perturbation changes "
        f"them by {moved:.1g} m: derivatives may have errors of {lost / moved:.0e}; larger "
        "perturbations have more digits, such as central=True with epsilon=1e-5"
    ]


def rounded_contacts(base: FollowedRun, pairs: Sequence[FollowingRuns]) -> list[str]:
    """Notes about stiff contacts, whose overlaps are lost in the rounding of positions. Collective.

    A force is a stiffness times an overlap d. Positions x are rounded by some 1e-16 |x|, and the
    perturbation changes d by some ε d, so that derivatives of forces have errors of the ratio.

    Args:
        base: The run, after its last step.
        pairs: The runs that follow.
    """
    notes, perturbation = [], min(pair.epsilon for pair in pairs)
    for points in {id(problem.points): problem.points for problem in base.problems}.values():
        read = points.fields.read
        for name in [n for n in points.fields if n.endswith("_normal_force")]:
            of = name.removesuffix("_normal_force")
            if f"{of}_stiffness" not in points.fields:
                continue
            force = read(name)
            touches = force.max(axis=1, initial=0.0) > 0.0
            stiffness = np.where(force > 0.0, read(f"{of}_stiffness"), 0.0)
            place = float(np.abs(read("x")[touches]).max(initial=0.0))
            sums = base.comm.allreduce(np.array([force.sum(), stiffness.sum()]), op=MPI.SUM)
            place = base.comm.allreduce(place, op=MPI.MAX)
            if not sums.all():
                continue
            # root mean square of an even rounding, which errs by up to half a last digit
            overlap, lost = sums[0] / sums[1], np.finfo(float).eps * place / math.sqrt(12.0)
            error = lost / (perturbation * overlap)
            if error > _LOST_FORCE:
                notes.append(
                    f"{of}: bodies overlap by {overlap:.1g} m, and positions are rounded to "
                    f"{lost:.1g} m: derivatives of its forces may have errors of {error:.0e}; take "
                    "a smaller stiffness, or central=True with epsilon=1e-5"
                )
    return notes


def without_effect(found: Found, names: Sequence[str]) -> list[str]:
    """Notes about parameters by which all derivatives are exactly zero.

    Args:
        found: Derivatives of the figures.
        names: The parameters.
    """
    return [
        f"{name}: no figure changes, not by a digit; does the scene take it from its argument, and "
        "is the way to the figures above rounding?"
        for name in names
        if not any(np.any(value) for by in found.values() for value in by[name])
    ]


def too_steep(figures: Figures, found: Found, pairs: Sequence[FollowingRuns]) -> list[str]:
    """Notes about derivatives that are far larger than their figures.

    Args:
        figures: The figures.
        found: Their derivatives.
        pairs: The runs that follow.
    """
    notes = []
    for figure, values in figures.items():
        size = max(float(np.abs(value).max(initial=0.0)) for value in values)
        for pair in pairs:
            slopes = [np.abs(value).max(initial=0.0) for value in found[figure][pair.name]]
            if size and _STEEP * size < max(slopes) < np.inf:
                notes.append(
                    f"{pair.name}: the figure '{figure}' has derivatives of {max(slopes):.1g}, and "
                    f"values of {size:.1g}. Either it is zero up to rounding, or the "
                    "scene does not give the same at the same parameters: random numbers need a "
                    "fixed seed, and nothing may count the calls"
                )
    return notes


def doubtful(errors: Mapping[str, float]) -> list[str]:
    """Notes about estimated errors, by parameters."""
    return [_doubt(name, error) for name, error in errors.items() if error > _DOUBTFUL]


def _doubt(name: str, error: float) -> str:
    """Note about an estimated error."""
    if np.isinf(error):
        return f"{name}: derivatives are not finite, because figures are not"
    return f"{name}: two perturbations differ by {error:.1%}, so that the derivative may not exist"
