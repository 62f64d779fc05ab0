"""Derivatives of a run by its parameters."""

from __future__ import annotations

import sys
from pathlib import Path

import dolfinmpm as mpm

sys.path.append(str(Path(__file__).resolve().parents[3] / "demos" / "studies"))
from derivative_scenes import CASES as SCENES
from derivative_scenes import sizes_of


def _found(*names, central=None):
    """Figures and derivatives of some examples, with their notes."""
    figures = {}
    for name in names:
        scene, parameters = SCENES[name]
        found = mpm.study.differentiate(scene, parameters, scales=sizes_of(name), central=central)
        assert not found.notes
        figures[name] = {
            k: {"values": values.tolist(), "derivatives": [d.tolist() for d in of.values()]}
            for k, values in found.figures.items()
            for of in [found.derivatives[k]]
        }
    return figures


def derivatives():
    """An elastic column, one that yields, and an arch beyond its limit point."""
    return _found("elastic", "von Mises", "arc length")


def derivatives_in_contact():
    """A rigid body that rubs on a block, a layer that drains, and a bar that swings."""
    # rounding differs from rank to rank, so two runs per parameter
    return _found("contact with friction", "consolidation", "Newmark", "explicit", central=True)
