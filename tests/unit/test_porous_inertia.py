"""Soil and water in time with inertia: tangents, refusals, restarts."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from conftest import Linearised
from test_poromechanics import block, held

import dolfinmpm as mpm
from dolfinmpm._platform.errors import FormError, ParameterError


def test_the_tangent_has_the_acceleration_in_darcys_law():
    F, points, V, Q, _ = block(inertia=True, gravity=(1.0, -9.81))
    fields = [V.increment, Q.increment]
    problem = mpm.Newmark(F, fields, points, held(V), stabilisation=["ghost", "ghost"])
    points["velocity"] = 0.1 * points["x"]
    problem.step(0.7)
    assert points.inertia.value == pytest.approx(4 / 0.7**2)
    assert np.abs(points["start_acceleration"]).max() > 0.1
    linearised = Linearised(problem)
    rng = np.random.default_rng(1)
    start, way = (s * rng.uniform(-1, 1, linearised.size) for s in (0.02, 0.1))
    ups = problem.here.unknowns.fields[0].size
    start[ups:] *= 1e3
    way[ups:] *= 1e3
    linearised.tangent(start)
    exact, t = linearised.product(way), 1e-5
    ahead, behind = linearised.residual(start + t * way), linearised.residual(start - t * way)
    numerical = (ahead - behind) / (2 * t)
    for part in (slice(0, ups), slice(ups, None)):
        np.testing.assert_allclose(
            exact[part], numerical[part], atol=2e-5 * np.abs(exact[part]).max()
        )


@pytest.mark.parametrize("kind", [mpm.QuasiStatic, mpm.Transient])
def test_without_inertial_forces_there_is_no_acceleration(kind):
    F, points, V, Q, _ = block(inertia=True)
    with pytest.raises(FormError, match=rf"the acceleration of the body, and {kind.__name__} has"):
        kind(F, [V.increment, Q.increment], points, held(V))


def test_what_is_no_acceleration_is_refused():
    with pytest.raises(ParameterError, match="inertia = 1 must be True or False"):
        block(inertia=1)
    F, points, V, Q, _ = block()
    with pytest.raises(ParameterError, match="displacement"):
        mpm.acceleration(points, Q.increment)
    F = mpm.momentum(mpm.materials.Hencky(E=1e4, nu=0.3), points, V.increment, V.test)
    F += ufl.dot(mpm.acceleration(points, V.increment), V.test) * points.dX
    with pytest.raises(FormError, match="acceleration of the body, and Explicit has"):
        mpm.Explicit(F, V.increment, points, held(V))
