"""A step, the record of a step, and the reason of a failure."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from dolfinmpm._platform.html import listing
from dolfinmpm._platform.uncopied import FOUND, unchanged
from dolfinmpm.solve.bodyrecords import BodyRecords

__all__ = ["Failed", "Step", "StepRecord"]


@dataclass(frozen=True)
class Step:
    """A step, or a substep of a halved step.

    Attributes:
        t: End of the step: the time (s), or in problems without time the share of the change of
            load since the last converged step.
        dt: Length of the step, in the unit of t.
        share: Share of the whole step and of the prescribed increments.
    """

    t: float = 1.0
    dt: float = 1.0
    share: float = 1.0

    @property
    def start(self) -> float:
        """Start of the step, in the unit of t."""
        return self.t - self.dt


@dataclass(frozen=True)
class Failed:
    """Reason of a failed step.

    Attributes:
        reason: The reason, in a few words.
        worst: The point whose law failed, or the most compressed point.
        advice: Advice to the user, or an empty string.
        remark: A sentence more of advice, with a full stop before it, or an empty string.
    """

    reason: str
    worst: str
    advice: str = ""
    remark: str = ""


@unchanged(FOUND)
@dataclass
class StepRecord:
    """Report of one call of `step`.

    Attributes:
        iterations: Newton iterations, with those of failed attempts.
        residuals: Relative out-of-balance force before and after each iteration
            of the last substep.
        linear_iterations: Iterations of each solution of a linear system. Empty where a direct
            solver was used.
        parts: Number of converged substeps.
        halvings: Number of halvings.
        unknowns: Number of unknowns in the last substep.
        migrated: Number of points that changed rank.
        imbalance: Largest number of points per rank over the mean number, in the next step. Or
            the same ratio of the unknowns in this step, if it is larger.
        seconds: Wall time of this process (s).
        stages: Stage → wall time of this process (s). PETSc's log has the same names, with "mpm:"
            before them. "output" is the time of writing files before the next step. The stages
            add up to the whole step, except for reading the loads and choosing the length of
            steps. Empty unless `measure_stages` or PETSc's log is on.
        split, merged: Numbers of points that split, and of families that merged, before the step;
            see `Problem.adapt`.
        bodies: Name of a rigid body → "position" of its centre (m), "angle" (degrees), and "force"
            (N) and "moment" (N m) of the points on the body. Also name of a contact between
            deformable bodies → "force" (N) on the first body. They are lists that calculate as
            arrays.
    """

    iterations: int = 0
    residuals: list[float] = field(default_factory=list)
    linear_iterations: list[int] = field(default_factory=list)
    parts: int = 0
    halvings: int = 0
    unknowns: int = 0
    migrated: int = 0
    imbalance: float = 1.0
    seconds: float = 0.0
    stages: dict[str, float] = field(default_factory=dict)
    split: int = 0
    merged: int = 0
    bodies: dict[str, dict[str, Any]] = field(default_factory=BodyRecords)

    def __post_init__(self) -> None:
        # a checkpoint has plain lists
        self.bodies = BodyRecords(self.bodies)

    def add(self, iterations: int, residuals: list[float], linear_iterations: list[int]) -> None:
        """Add a solution of a substep.

        Args:
            iterations: Its Newton iterations.
            residuals, linear_iterations: See the class.
        """
        self.iterations += iterations
        self.residuals = residuals
        self.linear_iterations += linear_iterations

    def _repr_html_(self) -> str:
        """The figures of the step as a table, for notebooks."""
        names = "iterations", "parts", "halvings", "unknowns", "imbalance", "seconds"
        return listing({name: getattr(self, name) for name in names}, "step")
