"""Bound of the energy gained in steps in time with contact, by shorter steps where needed.

Contact by mean forces makes no energy. But the trapezoidal rule may make some: the forces at the
start and at the end of a step act on a body that turns and stretches in between. In a step the
change of kinetic energy, the work of the stresses and the known losses add up to the work of loads
and contact, except for an error of third order in the step. This error becomes large if a step
hardly resolves the waves after an impact.
"""

from __future__ import annotations

from dolfinmpm.dynamics.ledger import Work

__all__ = ["LEAST", "Gains"]

# Share of all energy that steps may make in sum, and what a single one may beyond it
_MOST, _SINGLE = 5e-4, 2e-5
# Share of a step that is parted no more: a quarter of the step makes a sixteenth of the energy
LEAST = 0.25


class Gains:
    """Energy gained without a cause in the steps of a problem with contact.

    Attributes:
        made: Gains less losses of this kind (J).
    """

    def __init__(self) -> None:
        self.made = 0.0

    def judge(self, work: Work, contact: float, whole: float, parts: bool) -> str | None:
        """The reason to halve a step, or None. With None the step's gain is added.

        Args:
            work: Sums of the step.
            contact: Work of contact on the nodes in the step (J).
            whole: First energy plus work of loads (J).
            parts: Whether the step may be halved.
        """
        made = work.grid + work.internal - work.net - contact
        # where there was hardly any, such as before a tool first touches, what the step turns over
        turned = abs(work.internal) + abs(work.external) + abs(contact)
        whole = max(abs(whole), turned)
        if parts and made > _SINGLE * whole and self.made + made > _MOST * whole:
            return f"the step makes {made:.3g} J of energy, of {whole:.3g} J in all"
        self.made += made
        return None
