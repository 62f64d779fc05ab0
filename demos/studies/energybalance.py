"""The balance of energy over a run, as studies draw it."""

from __future__ import annotations

from typing import Any

import numpy as np

__all__ = ["EnergyBalance"]

PARTS = {
    "kinetic": "kinetic",
    "bodies": "of rigid bodies",
    "strain": "stored",
    "contact": "contact",
}
COLOURS = {"kinetic": "C0", "bodies": "C4", "strain": "C1", "contact": "C2"}
LOST = "#7a1f5c", "#4d4d4d", "#c0a000", "#8c564b", "#a6cee3", "#5e3c99", "#b15928", "#000000"


class EnergyBalance:
    """What energies there were after each step."""

    def __init__(self) -> None:
        self._rows: list[tuple[float, Any]] = []

    def note(self, problem: Any) -> None:
        """Take the energies as they are now. Collective."""
        self._rows.append((problem.time, problem.energies()))

    def draw(self, ax: Any, unit: float = 1.0, least: float = 2e-3) -> None:
        """Draw what there is, stacked, and above it what is lost by name, by all that came.

        Args:
            ax: Matplotlib axes.
            unit: Time that counts as one (s).
            least: Share of all energy below which a part is not drawn.
        """
        t = np.array([time for time, _ in self._rows]) / unit
        energies = [e for _, e in self._rows]
        came = np.array([e.initial + e.external for e in energies])
        whole = np.abs(came).max()
        parts = {
            PARTS[name]: ([getattr(e, name) for e in energies], c) for name, c in COLOURS.items()
        }
        names = energies[-1].losses
        for k, name in enumerate(names):
            parts[name] = ([e.losses[name] for e in energies], LOST[k % len(LOST)])
        shown = {
            name: (np.array(values) / whole, colour)
            for name, (values, colour) in parts.items()
            if np.abs(values).max() > least * whole
        }
        # what is given back lies below the rest
        below = np.sum([np.minimum(values, 0.0) for values, _ in shown.values()], axis=0)
        for name, (values, colour) in shown.items():
            above = below + np.abs(values)
            ax.fill_between(t, below, above, color=colour, alpha=0.75, lw=0, label=name)
            below = above
        ax.plot(t, came / whole, "k--", lw=0.9, label="all that came")
        ax.set(ylabel="energy / all that came", xlim=(t[0], t[-1]), ylim=(None, 1.12))
