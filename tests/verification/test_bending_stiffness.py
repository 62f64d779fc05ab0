"""Linear functions are too stiff in bending, by the length of cells over the thickness."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import COMM
from dolfinx import fem

import dolfinmpm as mpm

THICK, LENGTH, E = 0.5, 10.0, 1e8


def bending_stiffness(over, length, per_cell, nu):
    """Bending stiffness of a cantilever by the deflection of its tip, less that of its shear."""
    h = THICK / over
    x = np.arange(-1.0, 1.5 + h / 2, h)
    grid = mpm.create_lattice(COMM, [x, np.arange(0.0, LENGTH + 2.5 * length, length)])
    points = mpm.fill(grid, mpm.Box((0, 0), (THICK, LENGTH)), per_cell=per_cell, density=1.0)
    V = mpm.Space(grid, "gimp")
    top = mpm.Surface(points, lambda x: np.isclose(x[1], LENGTH), normal=(0, 1))
    load = 3e-5 * E / (1 - nu**2) * THICK**3 / 12 / LENGTH**3  # N/m, a deflection of 1e-5 m
    F = mpm.momentum(mpm.materials.Hencky(E, nu), points, V.increment, V.test)
    F += top.force(fem.Constant(grid, (load, 0.0)), V.test)
    bcs = mpm.rollers(V, "bottom")
    bcs += mpm.prescribed(V, lambda x: np.isclose(x[1], 0) & np.isclose(x[0], THICK / 2), 0)
    mpm.QuasiStatic(F, V.increment, points, bcs).step()
    # Timoshenko: a shear stiffness of 5/6 G A
    shear = load * LENGTH / (5 / 6 * E / (2 + 2 * nu) * THICK)
    return 1e-5 / (top.mean_displacement()[0] - shear)


@pytest.mark.parametrize(
    ("over", "length", "per_cell", "nu"),
    [(2, 0.5, 2, 0.0), (4, 0.5, 2, 0.0), (2, 0.5, 3, 0.0), (2, 0.25, 2, 0.3), (4, 0.25, 2, 0.3)],
)
def test_a_beam_has_the_stiffness_that_the_limitations_tell(over, length, per_cell, nu):
    """The shear that a linear function has in a bent cell, and the strain across that it lacks.

    Energy of a bent cell of length l: the shear strain κ s, with the mean of s² = l² (1 − 1/m²)/12
    over m points. Across, a strain −ν/(1 − ν) κ t is missing in each cell of d/n. And n m points
    over d have a second moment that is less by 1/(n m)².
    """
    extra = (1 - nu) / 2 * (length / THICK) ** 2 + nu**2 / (1 - 2 * nu) / over**2
    exact = 1 + (1 - 1 / per_cell**2) * extra - 1 / (over * per_cell) ** 2
    assert bending_stiffness(over, length, per_cell, nu) == pytest.approx(exact, rel=3e-3)
