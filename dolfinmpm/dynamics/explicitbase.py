"""Settings of explicit steps, checked, and the base of steps that are not fused."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Set
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from dolfinx import fem

from dolfinmpm._platform.argumentchecks import choice, is_endless, number
from dolfinmpm._platform.errors import ParameterError
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.dynamics.facesatnodes import Sides
from dolfinmpm.dynamics.kinks import Kinks
from dolfinmpm.dynamics.mappings import Mapping, mapping_of
from dolfinmpm.dynamics.smallmass import Filter, checked_viscosity, filters
from dolfinmpm.dynamics.worksums import Work
from dolfinmpm.solve.operator import Operator
from dolfinmpm.solve.step import Step

__all__ = ["ExplicitBase", "Settings", "checked_courant", "strain_by", "strain_interval"]

Array = npt.NDArray[np.float64]

SCHEMES = ("usl", "usf", "musl")

# Least and largest mass scaling: beyond them bodies stand still, or steps have no length
_SCALES = 1e-12, 1e12


def checked_courant(courant: Any) -> float:
    """The Courant number, a share of the critical step, or infinity.

    Raises:
        ParameterError: The argument is no number, or above 1.
    """
    share = math.inf if is_endless(courant) else number("courant", courant, 0.0)
    if 1.0 < share < math.inf:
        raise ParameterError(
            f"courant = {share:g} is a share of the critical step and must be at most 1: longer "
            "steps give wrong figures long before they are seen to be unstable; math.inf leaves "
            "the steps as long as the times of problem.step(t) make them"
        )
    return share


@dataclass(frozen=True)
class ExplicitStep(Step):
    """A step between velocities that are half a step behind positions.

    Attributes:
        kick: Time during which forces act (s): half of the step before and half of this one.
    """

    kick: float = 1.0

    @property
    def begins(self) -> bool:
        """Whether a run begins with it: without a step before, forces act for half a step."""
        return 2.0 * self.kick == self.dt

    @property
    def before(self) -> float:
        """Length of the step before (s); 0 where a run begins."""
        return 2.0 * self.kick - self.dt


def strain_interval(step: ExplicitStep, scheme: str) -> tuple[float, float]:
    """Start and length of the time in which the points strain in a step (s), for laws of time.

    In "usf" that is the step before. A run begins with a strain of zero. It counts as that of the
    first step, because a law may divide by the length.

    Args:
        step: The step.
        scheme: Order of the step.
    """
    if scheme == "usf" and not step.begins:
        return step.start - step.before, step.before
    return step.start, step.dt


def strain_by(operator: Operator, points: MaterialPoints, u: Array, scheme: str) -> None:
    """Set the increments that strain the points. Collective.

    In "usf" points have moved by them already. The gradient where the motion began is H (1 − H)⁻¹,
    with the gradient H where it ended. So a motion that turns a body does not strain it.

    Args:
        operator: The equations of the step.
        points: Material points.
        u: Increments at the nodes (m), shape (nodes, d).
        scheme: Order of the step.
    """
    operator.set_increments([u])
    if scheme != "usf" or points.axisymmetric:
        # sections of axisymmetric bodies hardly turn: what differs is the square of a strain
        return
    at = operator.points
    H = at.gradient[0]
    H[...] = H @ np.linalg.inv(np.eye(points.gdim) - H)
    for region in at.regions:
        # means over cells
        region.prepare()


@dataclass(frozen=True)
class Settings:
    """Settings of explicit steps, see `Explicit`.

    Attributes:
        scheme: Order of the stress update.
        mapping: The velocity mapping between points and grid.
        damping: Share of local damping.
        mass_scaling: Factor of the mass in the inertia.
        viscosity: Linear and quadratic coefficients of bulk viscosity.
        filters: Filters of light nodes.
        clock: DOLFINx constant that holds the time (s), or None.
    """

    scheme: str
    mapping: Mapping
    damping: float
    mass_scaling: float
    viscosity: tuple[float, float]
    filters: tuple[Filter, ...]
    clock: fem.Constant | None

    @staticmethod
    def of(
        scheme: Any,
        mapping: Any,
        basis: Any,
        mass: str,
        damping: Any,
        mass_scaling: Any,
        bulk_viscosity: Any,
        mass_cutoff: Any,
        redistribution: Any,
        clock: fem.Constant | None,
    ) -> Settings:
        """Settings by the user's arguments, for a basis and a kind of mass.

        Raises:
            ParameterError: An argument has the wrong type or a value outside its range.
        """
        chosen = mapping_of(mapping, "flip")
        if chosen.kind == "accel":
            raise ParameterError('mapping = "accel" is of implicit steps; use "flip"')
        return Settings(
            choice("scheme", scheme, SCHEMES),
            chosen.on(basis, mass),
            number("damping", damping, 0.0, 1.0, closed=True),
            number("mass_scaling", mass_scaling, *_SCALES, closed=True),
            checked_viscosity(bulk_viscosity),
            tuple(filters(mass_cutoff, redistribution)),
            clock,
        )

    def shorten(self, longest: float, mass: str) -> float:
        """The critical step (s) of the order, from 2/ω_max (s).

        In "usl" points strain by the nodes' velocities before a lumped mass smears their change by
        the factor s. The step then damps the frequency ω if ω Δt < 2/√(2 − s), at the worst √2.

        Args:
            longest: 2/ω_max of stiffness and mass.
            mass: "lumped" or "consistent".
        """
        return longest * (math.sqrt(0.5) if self.scheme == "usl" and mass == "lumped" else 1.0)

    @property
    def gives_back(self) -> bool:
        """Whether points add the change of the nodes' velocities, and move by the sum ("musl")."""
        return self.scheme == "musl" and self.mapping.kind == "flip" and self.mapping.share == 1.0

    @property
    def plain(self) -> bool:
        """Whether neither bulk viscosity nor filters of light nodes act."""
        return not self.filters and self.viscosity == (0.0, 0.0)


class ExplicitBase(ABC):
    """Explicit steps of a problem, one after the other.

    Args:
        problem: The problem.
        settings: Settings of the steps.
        sides: Faces of the grid that act on the body.
        instead: Reason why the steps are not fused.

    Attributes:
        at_once: Largest number of steps per call.
        sides, instead: The arguments.
        kinks: Where the steps are not smooth; None unless somebody asks for it.
        keeps_speed: Whether the critical step follows from the points' fields alone. Steps that
            are not fused find the critical step in every call.
    """

    at_once, keeps_speed = 1, False

    def __init__(self, problem: Any, settings: Settings, sides: Sides, instead: str):
        self._problem, self._settings = problem, settings
        self.sides, self.instead = sides, instead
        self._work = Work()
        self.kinks: Kinks | None = None

    def work(self) -> Work:
        """Works and losses since the last call of this method."""
        done, self._work = self._work, Work()
        return done

    def renew(self) -> None:  # noqa: B027 - nothing is to be done
        """Start the next call like the first call. These steps keep nothing."""

    def start(self, rate: float, touched: Set[str]) -> None:  # noqa: B027 - nothing is to be done
        """Begin a call. These steps read the points anew in every step."""

    def release(self) -> None:  # noqa: B027 - nothing is to be done
        """End a call. These steps keep no arrays of the points."""

    def run(
        self, count: int, more: bool, begin: Callable[[int], ExplicitStep]
    ) -> tuple[int, int, str | None]:
        """Take equal steps. Collective.

        Args:
            count: Number of steps.
            more: Whether further steps follow without a new start.
            begin: Function from the number of a step to the step. It sets the time in form and
                conditions.

        Returns:
            Number of steps taken, number of points that changed rank, and the reason of an early
            end, or None.
        """
        migrated = 0
        for k in range(count):
            found = self._take(begin(k))
            if isinstance(found, str):
                return k, migrated, found
            migrated += found
        return count, migrated, None

    @abstractmethod
    def _take(self, step: ExplicitStep) -> int | str:
        """Take one step. Collective.

        Returns:
            Number of points that changed rank, or the reason of a failure.
        """
