"""Water in the pores does not rub: friction of rigid bodies by the effective pressure."""

import numpy as np
import pytest
from dolfinx import fem
from mpi4py import MPI

import dolfinmpm as mpm
from dolfinmpm._platform.errors import FormError, ParameterError

COMM, MU, LOAD = MPI.COMM_WORLD, 0.3, 100e3
LAW = mpm.materials.Hencky(2e7, 0.3)


def block(first=0.0, gravity=None, wet=True, **motion):
    """A block of 1 m on a rough plane, with water that cannot leave it, and a first x."""
    grid = mpm.create_lattice(COMM, [np.arange(13) * 0.25, np.arange(7) * 0.25 - 0.5])
    points = mpm.fill(grid, mpm.Box((first, 0.0), (first + 1.0, 1.0)), 2, 1900.0)
    V, Q = mpm.Space(grid, "gimp"), mpm.Space(grid, "gimp", shape=())
    u, v, p, q = V.increment, V.test, Q.increment, Q.test
    F = mpm.poromechanics(
        LAW, points, (u, p), (v, q), permeability=1e-13, porosity=0.4, gravity=gravity
    )
    plane = mpm.RigidBody(mpm.Plane((0, 0), (0, 1)), name="plane", **motion)
    F += mpm.contact(
        plane, points, u, v, friction=MU, penalty=20.0, pore_pressure=p if wet else None
    )
    return F, points, V, [u, p], plane


@pytest.mark.parametrize(("share", "wet"), [(0.0, True), (0.4, True), (1.0, True), (0.4, False)])
def test_the_share_of_the_water_does_not_rub(share, wet):
    F, points, V, fields, plane = block(wet=wet, displacement=lambda t: (0.01 * t, 0.0))
    top = mpm.Surface(points, lambda x: np.isclose(x[1], 1.0), (0, 1))
    F += top.traction(fem.Constant(points.grid, (0.0, -LOAD)), V.test)
    bcs = mpm.rollers(V, "left") + mpm.prescribed(V, lambda x: np.isclose(x[0], 1.0), 0)
    problem = mpm.Transient(F, fields, points, bcs, stabilisation=["ghost"] * 2, tolerance=1e-6)
    mpm.set_stress(LAW, points, -(1 - share) * LOAD * np.eye(3))
    points["pressure"] = share * LOAD
    for k in range(3):
        problem.step(k + 1.0)
    rubs = MU * (1 - share if wet else 1.0)
    assert abs(plane.force[0] / plane.force[1]) == pytest.approx(rubs, rel=0.02, abs=1e-6)


def test_water_lessens_the_friction_of_a_slab_that_slides():
    g = (5.0, -8.0)
    moved = {}
    for wet in (True, False):
        F, points, _, fields, _ = block(1.0, g, wet)
        problem = mpm.Newmark(F, fields, points, stabilisation=["ghost"] * 2, tolerance=1e-6)
        points["pressure"] = -1900.0 * g[1] * (1.0 - points["x"][:, 1])
        for t in mpm.times(0.2, dt=0.02):
            problem.step(t)
        way = COMM.allreduce((points["x"] - points["x0"])[:, 0].sum()) / points.total
        moved[wet] = way / (0.02 * g[0])
    assert moved[False] == pytest.approx(1 + MU * g[1] / g[0], rel=0.03)
    assert moved[False] + 0.1 < moved[True] < 1.0


def test_a_pressure_that_does_nothing_is_refused():
    F, points, V, (u, p), plane = block()
    with pytest.raises(ParameterError, match=r"pore_pressure = .* would do nothing: .*friction"):
        mpm.contact(plane, points, u, V.test, pore_pressure=p)
    with pytest.raises(ParameterError, match=r"pore_pressure = 5\.0 must be the pressure"):
        mpm.contact(plane, points, u, V.test, friction=0.3, pore_pressure=5.0)
    dry = mpm.fill(points.grid, mpm.Box((0, 0), (1, 1)), 2, 1900.0)
    F = mpm.momentum(LAW, dry, u, V.test)
    F += mpm.contact(plane, dry, u, V.test, friction=0.3, pore_pressure=p)
    with pytest.raises(FormError, match="has a pore_pressure, and the form has no water"):
        mpm.QuasiStatic(F, u, dry, mpm.fixed(V, "bottom"))
