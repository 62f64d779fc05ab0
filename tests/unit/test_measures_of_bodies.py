"""A body goes on under the strain formulation that it has moved under."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from test_laws_in_forms import (
    GHOST,
    CamClay,
    Hencky,
    NeoHookean,
    VonMises,
    agree,
    moved_under,
    settle,
)

import dolfinmpm as mpm
from dolfinmpm._platform.errors import StateError

MEASURES = ("large", "small", "jaumann", "energy")


@pytest.mark.parametrize("second", MEASURES)
@pytest.mark.parametrize("first", MEASURES)
def test_a_body_goes_on_under_its_own_measure_only(first, second):
    points, V, _ = moved_under(first)
    u, v = V.increment, V.test
    law = NeoHookean(1e3, 0.3) if second == "energy" else Hencky(1e3, 0.3)
    strain = "large" if second == "energy" else second
    form = mpm.momentum(law, points, u, v, strain=strain)
    form -= ufl.inner(points.density * ufl.as_vector((0.08, -0.4)), v) * points.dX
    bcs = mpm.fixed(V, "bottom")
    # what goes on by itself, for points that have moved on the grid are a little out of balance
    alone, _, problem = moved_under(first)
    settled = np.abs(alone["x"] - alone["x0"]).max()
    problem.step()
    if first == second:
        mpm.QuasiStatic(form, u, points, bcs, stabilisation=GHOST).step()
        agree(points, alone, rtol=1e-9)
        return
    what = "an energy in UFL" if first == "energy" else f'strain="{first}"'
    stabilisation = "new points" if second == "energy" else "mpm.set_stress"
    n = len(points)
    with pytest.raises(
        StateError, match=f"(?s)of its {n} points have moved {n} under {what}.*{stabilisation}"
    ):
        mpm.QuasiStatic(form, u, points, bcs)
    if second == "energy":
        return
    mpm.set_stress(law, points, points["stress"], strain=strain)
    mpm.QuasiStatic(form, u, points, bcs, stabilisation=GHOST).step()
    # nothing settles a second time; small strain takes the balance on first volumes
    assert np.abs(points["x"] - alone["x"]).max() < 0.1 * settled
    assert settled > 0.01


def test_elastic_gravity_then_plasticity():
    points, V, _ = moved_under("large")
    u, v = V.increment, V.test
    largest = np.abs(points["stress"]).max()
    assert "plastic_strain" not in points.fields
    law = VonMises(1e3, 0.3, radius=10 * largest)
    settle(points, V, mpm.momentum(law, points, u, v), load=0.4, steps=1)
    alone, _, problem = moved_under("large")
    problem.step()
    agree(points, alone, rtol=1e-9)
    assert (points["plastic_strain"] == 0).all()
    clay = CamClay(
        swelling=0.018,
        compression=0.13,
        M=1.05,
        mu0=5.4e6,
        alpha=0.0,
        reference_pressure=2e4,
        preconsolidation=4e4,
    )
    mpm.QuasiStatic(mpm.momentum(clay, points, u, v), u, points)
    assert (points["preconsolidation_pressure"] == 4e4).all()


def test_only_the_law_s_own_points_count():
    points, V, _ = moved_under("large")
    u, v = V.increment, V.test
    lower = points["tag"] == 0
    form = mpm.momentum(Hencky(1e3, 0.3), points, u, v, strain="small", tag=1)
    form += mpm.momentum(Hencky(1e3, 0.3), points, u, v, tag=0)
    n = int((~lower).sum())
    with pytest.raises(StateError, match=f"tag=1: of its {n} points"):
        mpm.QuasiStatic(form, u, points)
    be = points["be"].copy()
    law = Hencky(1e3, 0.3)
    mpm.set_stress(law, points, points["stress"], strain="small", tag=1)
    np.testing.assert_array_equal(points["be"], be)
    assert (points["elastic_strain"][lower] == 0).all()
    assert np.abs(points["elastic_strain"][~lower]).max() > 1e-4
    mpm.QuasiStatic(form, u, points, mpm.fixed(V, "bottom"))


def test_f_bar_may_begin_later():
    """Its history begins with the volume that there is, so that nothing settles again."""
    points, V, _ = moved_under("large")
    u, v = V.increment, V.test
    J = np.linalg.det(points["F"])
    mpm.QuasiStatic(mpm.momentum(Hencky(1e3, 0.3), points, u, v, fbar=True), u, points)
    np.testing.assert_allclose(points["J_bar"], J, rtol=1e-12)
    assert np.abs(J - 1).max() > 1e-3
