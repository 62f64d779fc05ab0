"""Newton's method with additional equations: steps that make forces grow are shortened."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from dolfinmpm.solve.bordered import Bordered
from dolfinmpm.solve.operator import Residual


class Stub:
    """Equations whose out-of-balance force is a function of the unknown, and their border."""

    def __init__(self, norm):
        self.norm, self.value, self.updates = norm, np.zeros(1), 0

    def update_external(self):
        self.updates += 1

    def residual(self, x):
        # loads depend on the border's unknowns, and are up to date
        assert self.updates > 0
        norm = self.norm(float(x[0]))
        self.updates = 0
        return Residual(np.array([norm]), norm, 1.0)

    def move(self, change):
        self.value += change


@pytest.mark.parametrize(
    ("norm", "share"),
    [
        # a growth that Newton's method may make good
        (lambda x: 1 + 2.9 * x, 1.0),
        (lambda x: 1 + 100 * x**3, 0.25),
        (lambda x: np.nan if x > 0.3 else 1.0, 0.25),
        (lambda x: 10.0, 1 / 16),
    ],
)
def test_a_step_that_makes_forces_grow_is_shortened(norm, share):
    stub: Any = Stub(norm)
    x = np.zeros(1)
    found = Bordered(stub, stub)._move(stub, x, np.ones(1), np.full(1, -2.0), 1.0)
    assert x[0] == share
    assert stub.value[0] == -2.0 * share
    assert found.norm == norm(share)
