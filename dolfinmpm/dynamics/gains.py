"""Energy that steps in time make where bodies touch: it is bounded, by shorter steps where needed.

Contact by mean forces makes none. What is left is that of the trapezoidal rule: the forces at the
start and at the end of a step act on a body that has turned and stretched in between. In a step the
nodes' kinetic energy, the work of the stresses, and what is lost by name add up to the work of
loads and of contact, but for this error of third order in the step. Waves after an impact that a
step hardly resolves make it large.
"""

from __future__ import annotations

from dolfinmpm.dynamics.ledger import Work

__all__ = ["LEAST", "Gains"]

# Share of all energy that steps may make in sum, and what a single one may beyond it
_MOST, _SINGLE = 5e-4, 2e-5
# Share of a step that is parted no more: a quarter of the step makes a sixteenth of the energy
LEAST = 0.25


class Gains:
    """Energy that the steps of a problem with contact have made, without a cause.

    Attributes:
        made: That energy (J), less what they have lost so.
    """

    def __init__(self) -> None:
        self.made = 0.0

    def judge(self, work: Work, contact: float, whole: float, parts: bool) -> str | None:
        """Why a step is to be parted, or None; then what it makes counts.

        Args:
            work: Sums of the step.
            contact: Work of contact on the nodes in it (J).
            whole: All energy that there was and that loads have brought (J).
            parts: Whether it may be parted.
        """
        made = work.grid + work.internal - work.net - contact
        # where there was hardly any, such as before a tool first touches, what the step turns over
        turned = abs(work.internal) + abs(work.external) + abs(contact)
        whole = max(abs(whole), turned)
        if parts and made > _SINGLE * whole and self.made + made > _MOST * whole:
            return f"the step makes {made:.3g} J of energy, of {whole:.3g} J in all"
        self.made += made
        return None
