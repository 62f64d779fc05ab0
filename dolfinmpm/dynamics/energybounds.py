"""Bounds of energy without a cause: of contact, penalties, and explicit runs."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from dolfinmpm.cut.activation import Activation
from dolfinmpm.dynamics.ledger import Ledger
from dolfinmpm.dynamics.nodalmass import Mass
from dolfinmpm.dynamics.worksums import Work

__all__ = ["SHORTEST", "EnergyBalance", "EnergyGain", "PenaltyEnergy"]

Array = npt.NDArray[np.float64]

# Bounds relative to the whole energy: for the gain of all steps, and for the gain of a single step
_MOST, _SINGLE = 5e-4, 2e-5
# Shortest substep, as a share of the step, to bound the gain: a quarter makes a sixteenth of it
SHORTEST = 0.25


class EnergyGain:
    """Energy gained without a cause in the implicit steps of a problem with contact.

    Contact by mean forces makes no energy. But the trapezoidal rule may make some: the forces at
    the start and at the end of a step act on a body that turns and stretches in between. In a step
    the change of kinetic energy, the work of the stresses and the known losses add up to the work
    of loads and contact, except for an error of third order in the step. This error becomes large
    if a step hardly resolves the waves after an impact. Such a step is halved.

    Attributes:
        made: Sum of the gains, less losses of the same kind (J).
    """

    def __init__(self) -> None:
        self.made = 0.0

    def judge(self, work: Work, contact: float, whole: float, may_halve: bool) -> str | None:
        """The reason to halve a step, or None. With None the step's gain is added.

        Args:
            work: Sums of the step.
            contact: Work of contact on the nodes in the step (J).
            whole: First energy plus work of loads (J).
            may_halve: Whether the step may be halved.
        """
        made = work.grid + work.internal - work.net - contact
        # before the first contact there may be hardly any energy; then the works of the step count
        turned = abs(work.internal) + abs(work.external) + abs(contact)
        whole = max(abs(whole), turned)
        if may_halve and made > _SINGLE * whole and self.made + made > _MOST * whole:
            return f"the step makes {made:.3g} J of energy, of {whole:.3g} J in all"
        self.made += made
        return None


class PenaltyEnergy:
    """Energy that penalties on changes of velocity have taken, and may give back.

    The penalty acts on u − Δt v. By the trapezoidal rule its work in a step is the difference of
    Φ(v) = ¼ Δt² v · K v before and after the step. So the penalty stores energy as a mass does.
    Between steps points move, and map other velocities to the nodes, with another Φ. A larger Φ
    would give back energy that the penalty has not taken. So the penalty acts on u − θ Δt v, with
    θ ≤ 1. Its work on the body is then −u · K (u − θ Δt v) ≤ θ² Φ(v) for any step. θ is 1 unless
    Φ(v) exceeds the energy taken so far and not given back.

    Each field that moves points has its own energy, so that separate bodies stay independent.

    Attributes:
        energy: Number of the field → energy taken and not given back (J).
        share: Number of the field → θ in the present step.
    """

    def __init__(self) -> None:
        self.energy: defaultdict[int, float] = defaultdict(float)
        self.share: defaultdict[int, float] = defaultdict(lambda: 1.0)

    def begin(
        self, here: Activation, nodes: Sequence[tuple[int, Mass, Array]], dt: float, weight: float
    ) -> None:
        """Find θ of a step. Collective.

        Args:
            here: The activation.
            nodes: Number, mass, and nodal velocities at the start of the step (m/s), shape
                (nodes, d), of each field that moves points.
            dt: Length of the step (s).
            weight: Share of the penalty's force in the step's mean force.
        """
        self.share.clear()
        for k, mass, V in nodes:
            changes = here.blocks_of("changes", k)
            most = 0.25 * weight * dt**2 * mass.inner(V, changes, V) if changes else 0.0
            # rounding may make both slightly negative
            left = max(self.energy[k], 0.0)
            if most > left:
                self.share[k] = math.sqrt(left / most)


class EnergyBalance:
    """Check of the energy balance of explicit steps, to find instability.

    Args:
        ledger: The energies of the problem.

    Attributes:
        ledger: The argument.
    """

    def __init__(self, ledger: Ledger):
        self.ledger = ledger
        self._first: float | None = None
        self._last = self._most = self._stored = 0.0
        self._dissipated = -math.inf

    def gain(self, begins: bool = False) -> str | None:
        """Message about energy gained without a cause, or None. Collective.

        A stable run may lose energy to the grid, and may gain a little in "usf". The gain is
        compared with the first energy and with the largest work of loads so far. A gain of more
        than half of the larger one, and of a tenth of the strain energy that a body under stress
        has at first, shows that the step is too long. Half of this energy would be too much: it
        is many times that of a wave in ground at rest.

        Args:
            begins: Whether a call of `step` begins. The user may have changed energy of the points
                before the call. This change is no fault.
        """
        ledger, work = self.ledger, self.ledger.work
        total = ledger.moving() + work.internal - work.external - work.pending
        if self._first is None:
            self._first = self._last = total
            strain = ledger.energies().strain
            self._stored = abs(strain) if math.isfinite(strain) else 0.0
        if begins:
            self._first += total - self._last
        self._last = total
        self._most = max(self._most, abs(self._first), abs(work.external))
        gained = total - self._first
        if math.isfinite(total) and not gained > self._bound > 0.0:
            return None
        return f"{gained:.4g} J have come from nowhere {self._beside}"

    @property
    def _bound(self) -> float:
        """Largest gain (J)."""
        return max(0.5 * self._most, 0.1 * self._stored)

    @property
    def _beside(self) -> str:
        """The energies beside which a gain is too large, for messages."""
        stored = f", and {self._stored:.4g} J of first strain energy" if self._stored else ""
        return f"beside {self._most:.4g} J of first energy and work of loads{stored}"

    def given_back(self) -> str | None:
        """Message about energy that laws with F-bar have given back, or None. Collective.

        The work of their stresses is that of means over cells. Single points may store more than
        that. Then the laws seem to give back what they have dissipated. The bound is that of
        `gain`, which comes first.
        """
        now = self.ledger.dissipated
        self._dissipated = max(self._dissipated, now)
        given = self._dissipated - now
        if not given > self._bound > 0.0:
            return None
        return (
            f"laws with F-bar have given back {given:.4g} J of what they dissipated, "
            f'{self._beside}; fbar="volumes" does not'
        )

    def touched(self) -> None:
        """What laws have dissipated counts from now on: the user has changed the points."""
        self._dissipated = -math.inf

    def forget(self) -> None:
        """Discard the history: the next state is the new first state."""
        self._first, self._last, self._most, self._stored = None, 0.0, 0.0, 0.0
        self.touched()
