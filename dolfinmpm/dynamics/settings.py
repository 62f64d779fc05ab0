"""Settings of explicit steps, checked."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from dolfinx import fem

from dolfinmpm._platform.argumentchecks import choice, number
from dolfinmpm._platform.errors import ParameterError
from dolfinmpm.dynamics.mappings import Mapping, mapping_of
from dolfinmpm.dynamics.smallmass import Filter, checked_viscosity, filters

__all__ = ["Settings", "checked_courant"]

SCHEMES = ("usl", "usf", "musl")


def checked_courant(courant: Any) -> float:
    """The Courant number, a share of the critical step, or infinity.

    Raises:
        ParameterError: The argument is no number, or above 1.
    """
    share = math.inf if courant == math.inf else number("courant", courant, 0.0)
    if 1.0 < share < math.inf:
        raise ParameterError(
            f"courant = {share:g} is a share of the critical step and must be at most 1: longer "
            "steps give wrong figures long before they are seen to be unstable; math.inf leaves "
            "the steps as long as the times of problem.step(t) make them"
        )
    return share


@dataclass(frozen=True)
class Settings:
    """Settings of explicit steps, see `Explicit`.

    Attributes:
        scheme: Order of the stress update.
        mapping: The velocity mapping between points and grid.
        damping: Share of local damping.
        scaling: Factor of the mass in the inertia.
        viscosity: Linear and quadratic coefficients of bulk viscosity.
        filters: Filters of light nodes.
        clock: DOLFINx constant that holds the time (s), or None.
    """

    scheme: str
    mapping: Mapping
    damping: float
    scaling: float
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
            number("mass_scaling", mass_scaling, 0.0),
            checked_viscosity(bulk_viscosity),
            tuple(filters(mass_cutoff, redistribution)),
            clock,
        )

    @property
    def gives_back(self) -> bool:
        """Whether points add the change of the nodes' velocities, and move by the sum ("musl")."""
        return self.scheme == "musl" and self.mapping.kind == "flip" and self.mapping.share == 1.0

    @property
    def plain(self) -> bool:
        """Whether neither bulk viscosity nor filters of light nodes act."""
        return not self.filters and self.viscosity == (0.0, 0.0)
