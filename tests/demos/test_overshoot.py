"""First steps of all lengths, with a surface anywhere in its cell: pressures do not overshoot."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import figures_of

PAIRS = (
    "bspline2-linear", "bspline2-bspline2", "bspline3-gimp", "linear-linear", "gimp-linear",
    "gimp-gimp", "nested", "nested-linear", "nested-bspline2",
)  # fmt: skip


def overshoots(pair, stabilisation, cuts, shares):
    given = "--sweep", "--json", "-", "--no-plot", "--cuts", cuts, "--shares", shares
    own = "--pair", pair, "--stabilisation", stabilisation
    return np.array(figures_of("demos/studies/consolidation.py", *given, *own)["overshoots"])


def test_quadratic_splines_with_linear_pressures_do_not_overshoot():
    """By 2.8 % with the factor that linear displacements take."""
    assert abs(overshoots("bspline2-linear", "ghost", "0.3", "1e-8").max()) < 1e-3


@pytest.mark.long
@pytest.mark.parametrize("stabilisation", ["ghost", "none", "aggregation"])
@pytest.mark.parametrize("pair", PAIRS)
def test_no_first_step_overshoots(pair, stabilisation):
    found = overshoots(
        pair, stabilisation, "1e-6,0.05,0.2,0.3,0.35,0.49,0.6,0.8,1", "1e-8,0.1,0.24,0.4,1"
    )
    assert found.shape == (5, 9)
    assert found.max() < 0.01
