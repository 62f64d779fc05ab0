"""Griffiths & Lane's homogeneous slope (1999, doi 10.1680/geot.1999.49.3.387) on coarse grids."""

from __future__ import annotations

import functools

import pytest
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

import dolfinmpm as mpm
from dolfinmpm import study
from dolfinmpm._platform.errors import ParameterError

HEIGHT, E, UNIT_WEIGHT = 10.0, 1e8, 20e3
SCALE = UNIT_WEIGHT * HEIGHT**2 / E


def slope(factor, h=2.0, fbar=True, steps=10, share=1.0):
    """Gravity on the slope, φ = 20° and c/(γH) = 0.05, both over the factor."""
    grid = mesh.create_rectangle(
        MPI.COMM_WORLD, [(0, 0), (36, 12)], (round(36 / h), round(12 / h)),
        mesh.CellType.quadrilateral,
    )  # fmt: skip
    outline = mpm.Polygon([(0, 0), (32, 0), (12, HEIGHT), (0, HEIGHT)])
    points = mpm.fill(grid, outline, 2, UNIT_WEIGHT / 10)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    cohesion, friction = study.reduced_strength(0.05 * UNIT_WEIGHT * HEIGHT, 20.0, factor)
    soil = mpm.materials.MohrCoulomb(E, 0.3, cohesion, friction, dilation_angle=0.0)
    gravity = fem.Constant(grid, (0.0, 0.0))
    F = mpm.momentum(soil, points, u, v, fbar=fbar)
    F -= ufl.inner(points.density * gravity, v) * points.dX
    bcs = mpm.rollers(V, "left") + mpm.fixed(V, "bottom")
    problem = mpm.QuasiStatic(F, u, points, bcs, stabilisation="ghost", max_halvings=4)
    for step in range(1, steps + 1):
        gravity.value[1] = -10.0 * share * step / steps
        yield problem


@functools.cache
def found(h, fbar):
    loading = functools.partial(slope, h=h, fbar=fbar)
    return study.factor_of_safety(loading, 1.2, 1.8, tolerance=0.04)


def test_the_published_factor():
    safety = found(1.0, True)
    assert safety.factor == pytest.approx(1.4, rel=0.03)
    low, high = safety.bracket
    assert 0 < high - low <= 0.04
    assert low < safety.factor < high
    trials = {trial.factor: trial for trial in safety.trials}
    assert list(trials) == sorted(trials)
    assert all(trial.stands == (trial.factor <= low) for trial in safety.trials)
    assert trials[low].reason == "" != trials[high].reason
    # below failure the slope settles nearly as an elastic one does
    assert trials[1.2].displacement / SCALE == pytest.approx(0.42, abs=0.02)
    assert trials[1.2].steps == 10
    assert trials[1.8].steps < 10
    assert "times the displacement in proportion to the load" in safety.criterion


@pytest.mark.long
def test_coarse_grids_and_locking_make_it_seem_safer():
    assert found(1.0, True).factor < found(2.0, True).factor < found(2.0, False).factor
    assert found(2.0, True).factor == pytest.approx(1.4, rel=0.08)


@pytest.mark.parametrize(
    ("low", "high", "message"),
    [(2.0, 3.0, "fails at low = 2 already, in step"), (0.8, 1.0, "stands at high = 1 still")],
)
def test_the_factor_is_not_between(low, high, message):
    with pytest.raises(ParameterError, match=message):
        study.factor_of_safety(functools.partial(slope, fbar=False), low, high)
