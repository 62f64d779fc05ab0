"""When Newton's method ends: the relative out-of-balance force of its iterations.

The equations of several fields have units of their own, and each its own reference.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from petsc4py import PETSc

from dolfinmpm._platform.compat import DIVERGED_NAN
from dolfinmpm.solve.operator import Operator

__all__ = ["ConvergenceTest", "others_balanced", "references"]

Array = npt.NDArray[np.float64]
Reason = PETSc.SNES.ConvergedReason

# Largest part of out-of-balance forces, over the tolerance of loads and reactions, that forces at
# zero increments allow; with contact, whose last digits may take many iterations, or not come
_LOOSE, _LOOSE_IN_CONTACT = 10.0, 100.0
# Part of the tolerance of forces at zero increments that is enough with contact
_SHARE_IN_CONTACT = 1e-3
# Share of the forces at zero increments below which out-of-balance forces are rounding, and share
# that is enough where iterations do not reduce it further
_ROUNDING, _ENOUGH = 1e-12, 1e-9


class ConvergenceTest:
    """Convergence criterion of Newton's method: the relative out-of-balance force.

    Args:
        tolerance: Bound of the relative out-of-balance force.
        max_iterations: Iterations allowed.

    Attributes:
        residuals: Relative out-of-balance forces so far.
        motion: Norm of the forces that prescribed motions alone would make.
        predicted: Whether a linear step was taken first, so that a tangent is known.
        guessed: Whether the iterations start from increments that no linear step made.
        resumed: Whether SNES begins again with the increments that it had reached.
        rounded: Whether the last change of the increments was lost in the rounding of positions.
    """

    def __init__(self, tolerance: float, max_iterations: int):
        self.tolerance, self.max_iterations = tolerance, max_iterations
        self.residuals: list[float] = []
        self.motion, self.predicted, self.guessed = 0.0, False, False
        self.rounded = self.resumed = False
        self._first = 0.0

    @property
    def made(self) -> int:
        """Iterations so far, also those before another matrix went on."""
        return len(self.residuals) - 1

    @property
    def stalls(self) -> bool:
        """Whether the last four iterations have not halved the least forces before them."""
        return len(self.residuals) > 4 and self.residuals[-1] > 0.5 * min(self.residuals[:-4])

    def resume(self) -> None:
        """Go on with another matrix; SNES measures the last forces once more."""
        self.resumed, self.predicted = True, False
        del self.residuals[-1:]

    @property
    def fulfilled(self) -> bool:
        """Whether the last forces were in balance, or as close to it as rounding allows."""
        balanced = bool(self.residuals) and self.residuals[-1] <= self.tolerance
        return balanced or self.rounded

    def test(
        self,
        norm: float,
        reference: float,
        iteration: int,
        by_field: Array | None = None,
        contact: bool | None = None,
    ) -> int:
        """Reason of SNES to continue or to end.

        Args:
            norm: Norm of the out-of-balance force.
            reference: Norm of external forces and reactions.
            iteration: Number of the iteration, from 0.
            by_field: Norm and reference per field, shape (fields, 2), because units differ between
                fields. None for a single field, or before the references are known.
            contact: Whether rigid bodies may touch. None if forces at zero increments count alone.
                Supports that are much stiffer than the soil make these much larger than loads and
                reactions: those of a rigid footing, 10⁵ times. The load of the footing would be
                wrong by as much. So iterations go on if the forces are in balance only relative to
                those at zero increments. From a guess they go on once more at least, because a
                guess may be so close that the last iteration leaves much. An unloaded body has
                nothing else to compare with: its iterations end at rounding, or where they no
                longer help.
        """
        if not math.isfinite(norm):
            return DIVERGED_NAN
        if iteration == 0 and not (self.guessed or self.resumed):
            self._first = norm
        # an unloaded body has no loads and reactions to compare with at the end
        loads, reference = reference, max(reference, self._first, self.motion)
        relative = norm / reference if reference else 0.0
        for one, own in by_field if by_field is not None else ():
            relative = max(relative, one / own if own else 0.0)
        entered = not self.residuals or self.residuals[-1] > self.tolerance
        self.residuals.append(float(relative))
        loose = contact is not None and self._loose(norm, loads, reference, contact, entered)
        if relative <= self.tolerance and not loose:
            return Reason.CONVERGED_FNORM_RELATIVE
        return Reason.DIVERGED_MAX_IT if self._last else Reason.ITERATING

    @property
    def _last(self) -> bool:
        """Whether no more iterations are allowed."""
        return self.made >= self.max_iterations

    def _loose(
        self, norm: float, loads: float, largest: float, contact: bool, entered: bool
    ) -> bool:
        """Whether forces that are small relative to those at zero increments are not in balance.

        Args:
            norm: Norm of the out-of-balance force.
            loads: Norm of external forces and reactions.
            largest: The same, or the norm of the forces at zero increments if that is larger.
            contact: Whether rigid bodies may touch.
            entered: Whether the forces before this iteration were above the tolerance.
        """
        if norm <= self.tolerance * loads:
            return False
        helpless = self._last or self.stalls
        if contact:
            enough = max(_LOOSE_IN_CONTACT * loads, _SHARE_IN_CONTACT * largest)
            return not helpless and norm > self.tolerance * enough
        share = _ENOUGH if helpless else _ROUNDING
        enough = max(_LOOSE * self.tolerance * loads, share * largest)
        return (self.guessed and entered) or norm > enough


def others_balanced(operator: Operator, by_field: Array, tolerance: float) -> bool:
    """Whether the equations of all fields but displacements are in balance.

    Args:
        operator: The equations.
        by_field: Norms of residual and reference, shape (fields, 2).
        tolerance: Residual over reference that may remain.
    """
    rest = np.delete(by_field, operator.here.movers, axis=0)
    return bool(np.all(rest[:, 0] <= tolerance * rest[:, 1]))


def references(operator: Operator, matrix: PETSc.Mat, x: PETSc.Vec, by_field: Array) -> Array:
    """Norm and reference of each field's residual, by means of a tangent. Collective.

    The reference is the largest term of the field's equations: external forces and reactions, or
    the contribution of a field's unknowns. All of these may be close to zero, such as volumes in a
    body at rest. Then the reference is converted from the first field: the ratio of the
    contributions of a displacement to both fields' equations converts it.

    Args:
        operator: The equations.
        matrix: Their tangent.
        x: The unknowns.
        by_field: Norms of residual, and of external forces and reactions, shape (fields, 2).

    Returns:
        Norms of residual and reference, shape (fields, 2).
    """
    own = np.maximum(by_field[:, 1], operator.sizes(matrix, x).max(axis=0))
    if np.all(by_field[:, 0] <= 1e-9 * own):
        return np.stack([by_field[:, 0], own], axis=1)
    probe = x.duplicate()
    probe.setRandom()
    stiffness = operator.sizes(matrix, probe)[0]
    same = own[0] * np.divide(stiffness, stiffness[0], out=np.zeros_like(own), where=stiffness > 0)
    return np.stack([by_field[:, 0], np.maximum(own, same)], axis=1)
