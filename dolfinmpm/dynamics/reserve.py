"""What a ghost penalty on changes of velocity may give back to a body: no more than it has taken.

The penalty acts on u − Δt v. By the trapezoidal rule its work in a step is a difference, that of
Φ(v) = ¼ Δt² v · K v before the step and after it: what it takes it stores as a mass would. Between
steps points move, and their velocities make others at the nodes, with another Φ. If it is larger
then the penalty gives back what it has not taken. So it acts on u − θ Δt v with θ ≤ 1. Its work on
the body is then −u · K (u − θ Δt v) ≤ θ² Φ(v) whatever the step does, and θ is 1 unless Φ(v) is
more than what is left of the energy that it has taken so far.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from dolfinmpm.cut.activation import Activation
from dolfinmpm.cut.pattern import Blocks
from dolfinmpm.dynamics.mass import Mass

__all__ = ["Reserve"]

Array = npt.NDArray[np.float64]


class Reserve:
    """Energy that penalties on changes of velocity have taken and not given back.

    Each field that moves points has its own, so that bodies apart do not know of each other.

    Attributes:
        energy: That energy (J), by the number of the field.
        share: θ in the present step, likewise.
    """

    def __init__(self) -> None:
        self.energy: defaultdict[int, float] = defaultdict(float)
        self.share: defaultdict[int, float] = defaultdict(lambda: 1.0)

    def begin(
        self, here: Activation, nodes: Sequence[tuple[int, Mass, Array]], dt: float, weight: float
    ) -> None:
        """Find θ of a step. Collective.

        Args:
            here: What is active.
            nodes: Number, mass, and nodal velocities at the start of the step (m/s), shape
                (nodes, d), of each field that moves points.
            dt: Length of the step (s).
            weight: Share of the penalty's force in the step's mean force.
        """
        self.share.clear()
        for k, mass, V in nodes:
            changes = changes_of(here, k)
            most = 0.25 * weight * dt**2 * mass.inner(V, changes, V) if changes else 0.0
            # of rounding both may be a little less than nothing
            left = max(self.energy[k], 0.0)
            if most > left:
                self.share[k] = math.sqrt(left / most)


def changes_of(here: Activation, k: int) -> list[Blocks]:
    """Penalties on changes of velocity that act on a field."""
    return here.blocks_of("changes", k)
