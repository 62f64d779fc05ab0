"""Water that leaves through single surfaces of a saturated body."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

import dolfinmpm as mpm
from dolfinmpm._platform.errors import ParameterError

COMM = MPI.COMM_WORLD


def layer(basis="gimp", axisymmetric=False, refined=False, on="drained", inflow=1e-8):
    """A layer of clay of 4 m under a load: water enters at its bottom, and leaves at its top."""
    grid = mpm.create_lattice(COMM, [np.arange(3) * 0.5, np.arange(11) * 0.5])
    points = mpm.fill(grid, mpm.Box((0, 0), (1, 4)), 2, 1900.0, axisymmetric=axisymmetric)
    leaves = {"refine": lambda x: np.where(x[1] > 3, 0.25, 0.5), "levels": 2} if refined else {}
    V, Q = mpm.Space(grid, basis, **leaves), mpm.Space(grid, basis, shape=(), **leaves)
    u, p = V.increment, Q.increment
    top = mpm.Surface(points, lambda x: x[1] > 3.99, (0, 1))
    bottom = mpm.Surface(points, lambda x: x[1] < 1e-6, (0, -1))
    given = {"ponded": [(top, 5.0)]} if on == "ponded" else {on: top}
    F = mpm.poromechanics(
        mpm.materials.Hencky(5e6, 0.3), points, (u, p), (V.test, Q.test), permeability=1e-9,
        porosity=0.4, fluid=mpm.Fluid(bulk_modulus=np.inf), inflow=[(bottom, inflow)], **given,
    )  # fmt: skip
    F += top.pressure(10e3, u, V.test)
    bcs = mpm.fixed(V, "bottom") + mpm.rollers(V, "left", "right")
    problem = mpm.Transient(F, [u, p], points, bcs, stabilisation=["ghost", "ghost"])
    return problem, points, top, bottom


def volume(points):
    return COMM.allreduce(float(points["V"].sum()), op=MPI.SUM)


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"basis": "bspline2"},
        {"axisymmetric": True},
        {"refined": True},
        {"on": "seepage"},
        {"on": "ponded"},
    ],
    ids=["gimp", "splines", "axisymmetric", "refined", "seepage", "ponded"],
)
def test_what_leaves_is_what_the_layer_loses(options):
    problem, points, top, bottom = layer(**options)
    area = np.pi if "axisymmetric" in options else 1.0
    t = 0.0
    for length in (1e4, 1e5, 1e6):
        before, t = volume(points), t + length
        problem.step(t)
        lost = (before - volume(points)) / length
        out = top.outflow()
        assert bottom.outflow() == pytest.approx(-1e-8 * area, rel=1e-12)
        assert out + bottom.outflow() == pytest.approx(lost, rel=1e-9, abs=1e-9 * out)
    assert out > 0


def test_in_the_end_all_water_that_enters_leaves():
    problem, _, top, _ = layer(inflow=2e-9)
    for t in np.geomspace(1e6, 1e9, 7):
        problem.step(t)
    assert top.outflow() == pytest.approx(2e-9, rel=1e-4)


def test_a_surface_without_a_condition_for_water_has_no_outflow():
    _, points, _, _ = layer()
    side = mpm.Surface(points, lambda x: x[0] > 0.99, (1, 0))
    with pytest.raises(ParameterError, match="drained=, seepage=, inflow= or ponded="):
        side.outflow()


def test_a_surface_with_two_conditions_has_their_sum():
    grid = mpm.create_lattice(COMM, [np.arange(3), np.arange(5)])
    points = mpm.fill(grid, mpm.Box((0, 0), (2, 3)), 2, 1900.0)
    V, Q = mpm.Space(grid, "gimp"), mpm.Space(grid, "gimp", shape=())
    top = mpm.Surface(points, lambda x: x[1] > 2.99, (0, 1))
    F = mpm.poromechanics(
        mpm.materials.Hencky(5e6, 0.3), points, (V.increment, Q.increment), (V.test, Q.test),
        permeability=1e-6, porosity=0.4, drained=top, inflow=[(top, 3e-9)],
    )  # fmt: skip
    bcs = mpm.fixed(V, "bottom") + mpm.rollers(V, "left", "right")
    problem = mpm.Transient(F, [V.increment, Q.increment], points, bcs)
    problem.step(1.0)
    # what enters leaves at the same place, but for what the ground takes in a second
    assert top.outflow() == pytest.approx(0.0, abs=0.02 * 3e-9)
    assert COMM.allreduce(abs(points["pressure"]).max(initial=0.0), MPI.MAX) < 0.1


def test_a_face_above_the_level_takes_no_water():
    """Ground that drains at its base, beside an empty basin: suction holds its water."""
    grid = mpm.create_lattice(COMM, [np.arange(4), np.arange(5)])
    points = mpm.fill(grid, mpm.Box((0, 0), (2, 4)), 2, 1900.0)
    V, Q = mpm.Space(grid, "gimp"), mpm.Space(grid, "gimp", shape=())
    side = mpm.Surface(points, lambda x: x[0] > 1.99, (1, 0))
    F = mpm.poromechanics(
        mpm.materials.Hencky(5e7, 0.3), points, (V.increment, Q.increment), (V.test, Q.test),
        permeability=1e-6, porosity=0.4, ponded=[(side, -1.0)], gravity=(0.0, -9.81),
    )  # fmt: skip
    bcs = mpm.fixed(V, "bottom") + mpm.rollers(V, "left") + mpm.fixed(Q, "bottom")
    problem = mpm.Transient(F, [V.increment, Q.increment], points, bcs)
    for t in (1e9, 2e9):
        problem.step(t)
    # with a pressure of 0 there, 1.9e-6 m²/s had entered
    assert abs(side.outflow()) < 1e-12
    np.testing.assert_allclose(points["pressure"], -9810 * points["x"][:, 1], atol=100)
