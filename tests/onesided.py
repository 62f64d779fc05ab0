"""Checks of derivatives at a kink: where it is, that it is told, and the one-sided derivatives."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from dolfinmpm import study

sys.path.append(str(Path(__file__).resolve().parents[1] / "demos" / "studies"))
from derivative_scenes import history_of


def around_kink(state, ends, halvings):
    """Two values on both sides of a kink, by bisection: `state` differs from one to the other."""
    ends = list(ends)
    first = state(ends[0])
    assert state(ends[1]) != first
    for _ in range(halvings):
        middle = sum(ends) / 2
        ends[int(state(middle) != first)] = middle
    return ends


def check_at_kink(scene, name, ends, side, what, share=1e-5, least=0.0):
    """A perturbation from one end passes the kink, is told, and has the derivative of its side.

    Args:
        scene: Function of the parameters that returns a run.
        name: The parameter.
        ends: Values on both sides of the kink.
        side: 0 or 1, the end that the derivative is taken at.
        what: Words of the note.
        share: Error that the derivative may have, relative to the largest one of its figure.
        least: Error that it may have in any case.

    Returns:
        The note.
    """
    value, sign = ends[side], np.sign(ends[1 - side] - ends[side])
    size = max(abs(value), 0.01) * sign
    found = study.differentiate(scene, {name: value}, scales={name: size})
    (note,) = (one for one in found.notes if f"{what} within the perturbation" in one)
    # away from the kink, to second order
    h = -1e-5
    at, near, far = (history_of(scene, {name: value + k * h * size}) for k in (0.0, 0.5, 1.0))
    for key, by in found.derivatives.items():
        exact = (4 * near[key] - far[key] - 3 * at[key]) / h
        allowed = least + share * np.abs(exact).max()
        np.testing.assert_allclose(by[name], exact, rtol=0, atol=allowed)
    return note
