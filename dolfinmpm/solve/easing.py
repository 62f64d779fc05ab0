"""Release of forces out of balance by shares, where smaller substeps do not lessen them.

Points that cross cells put the state out of balance: with linear functions by a quarter of the
loads. The first substep must make up for all of it, however small the substep is. So halving alone
does not help. Here a substep releases as much of these forces as its share of the way to the end of
the step, and leaves the others out of balance. At the end of the step all forces balance.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from dolfinmpm.solve.newton import Newton
from dolfinmpm.solve.operator import Operator

__all__ = ["FIRST", "begins_unbalanced", "ease"]

# Share of the first substep
FIRST = 0.125
# Relative force out of balance at the start of the smallest substep, by its share of the load, that
# is not the load's own
_UNBALANCED = 4.0


def begins_unbalanced(problem: Any, residuals: Sequence[float]) -> bool:
    """Whether the state is out of balance at the start of the smallest substep, which failed.

    Args:
        problem: The problem. Inertia balances forces in its own way, and free bodies add equations.
        residuals: Relative forces out of balance before and after each iteration.
    """
    if problem.scheme.inertia or not isinstance(problem.solver, Newton):
        return False
    least = 0.5**problem.max_halvings
    return least < FIRST and bool(residuals) and residuals[0] > _UNBALANCED * least


def ease(operator: Operator, share: float) -> None:
    """Leave the forces that are out of balance at rest so, but for a share. Collective."""
    operator.move_to_zero()
    for mine, force in zip(operator.external, operator.forces()):
        mine -= (1.0 - share) * force
