"""What a step is asked for, and what it reports."""

from __future__ import annotations

from dataclasses import dataclass, field

__all__ = ["Failed", "Step", "StepRecord"]


@dataclass(frozen=True)
class Step:
    """A step, or a part of one.

    Attributes:
        t: Where it ends: the part of the load's way from the last converged step to what is
            set now, or the time (s).
        dt: How far it goes.
        share: Its share of the whole step, and of the increments prescribed for that.
    """

    t: float = 1.0
    dt: float = 1.0
    share: float = 1.0


@dataclass(frozen=True)
class Failed:
    """Why a step was not taken.

    Attributes:
        reason: Why, in a few words.
        worst: The point whose law failed, or that is compressed most.
        advice: What to do about it, if that is known.
    """

    reason: str
    worst: str
    advice: str = ""


@dataclass
class StepRecord:
    """What one call of `step` did.

    Attributes:
        iterations: Newton iterations, those of failed attempts included.
        residuals: Relative out-of-balance force before and after each iteration
            of the last part of the step.
        linear_iterations: Iterations of each solution of a linear system, none where factors
            solve it.
        parts: Converged parts that the step was made of.
        halvings: How often it was halved.
        unknowns: Unknowns in the last part.
        migrated: Points that changed rank.
        imbalance: Largest number of points on a rank over the mean, as the next step has them, or
            of unknowns, as this one had them, if that is more.
        seconds: Wall time (s).
        stages: Wall time of its parts (s), and of what was written before the next step
            ("output"), by the names of PETSc's log, which has them as "mpm:…". Together they
            are all of it but what looks at loads and chooses the length of steps. Of this
            process, as `seconds` are. Empty unless `measure_stages` or PETSc's log asked for it.
        bodies: Of each rigid body by its name: "position" of its centre (m), "angle" (degrees),
            "force" (N) and "moment" (N m) of the points on it. Of each contact between bodies that
            deform the "force" (N) on the first of them.
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
    bodies: dict[str, dict[str, list[float]]] = field(default_factory=dict)
