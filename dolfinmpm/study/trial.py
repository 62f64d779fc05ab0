"""What a reduction of strength found."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

__all__ = ["FactorOfSafety", "Trial"]


@dataclass(frozen=True)
class Trial:
    """A body with its strength reduced, under its load.

    Attributes:
        factor: What the strength was divided by.
        stands: Whether it carried the whole load.
        reason: Why not, in words; empty if it stands.
        steps: Converged steps of the load, or of the reduction of a body that is loaded already.
        displacement: Largest displacement of a material point in them (m).
        growth: That displacement over what the first step foretells; of a body that is loaded
            already, one more than over what the loads would do to it without yielding.
        iterations: Newton iterations of them.
    """

    factor: float
    stands: bool
    reason: str
    steps: int
    displacement: float
    growth: float
    iterations: int


@dataclass(frozen=True)
class FactorOfSafety:
    """What a strength reduction found.

    Attributes:
        factor: Factor of safety, the middle of the bracket.
        bracket: Largest factor at which the body stands, and smallest at which it fails.
        trials: The runs, by increasing factor.
        criterion: What counts as failure, in words.
    """

    factor: float
    bracket: tuple[float, float]
    trials: tuple[Trial, ...]
    criterion: str

    def table(self) -> list[dict[str, Any]]:
        """The trials as rows for `write_table` and `draw_reduction`."""
        return [asdict(trial) for trial in self.trials]
