"""Footings and springs hold faces of points, which laws with mean volumes would shift."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import unit_grid
from dolfinx import fem
from mpi4py import MPI
from test_tangent import box

import dolfinmpm as mpm
from dolfinmpm._platform import errors
from dolfinmpm.materials import Hencky


@pytest.mark.parametrize("holds", ["footing", "springs"])
def test_mean_volumes_hold_no_faces(holds):
    """F changes after a step, so that faces shift; what holds them is refused, loads are not."""
    grid = unit_grid("quadrilateral")
    points = mpm.fill(grid, box(grid), 2, 1.0)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    top = mpm.Surface(points, lambda x: x[1] > 0.8, (0, 1), name="top")
    F = mpm.momentum(Hencky(20.0, 0.3), points, u, v, fbar="volumes")
    mpm.QuasiStatic(F + top.pressure(fem.Constant(grid, 1.0), u, v), u, points)
    if holds == "springs":
        F += mpm.springs(top, u, v, stiffness=10.0)
    else:
        F += mpm.RigidFooting(top, fem.Constant(grid, 0.0), E=20.0).contact(u, v)
    with pytest.raises(errors.ParameterError, match=rf'fbar = "volumes" .*{holds}'):
        mpm.QuasiStatic(F, u, points)


def pressed(kind, **options):
    """A footing on a block: the problem, the footing, and its settlement."""
    grid = mpm.create_lattice(MPI.COMM_WORLD, [range(7), range(5)])
    points = mpm.fill(grid, mpm.Box((0.0, 0.0), (6.0, 2.6)), 2, 1.0)
    V, s = mpm.Space(grid, "gimp"), fem.Constant(grid, 0.0)
    top = mpm.Surface(points, lambda x: np.isclose(x[1], 2.6) & (x[0] < 3.0), (0, 1), name="top")
    foot = mpm.RigidFooting(top, s, E=1e3)
    F = mpm.momentum(Hencky(1e3, 0.3), points, V.increment, V.test)
    F += foot.contact(V.increment, V.test)
    bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
    return kind(F, V.increment, points, bcs, **options), foot, s


@pytest.mark.parametrize("rho", [1.0, 0.5])
def test_a_footing_in_time_moves_evenly(rho):
    """Its first step was a jump, after which the load swung between -87 and 160 N, about 37 N."""
    rest, held, quiet = pressed(mpm.QuasiStatic)
    problem, foot, s = pressed(mpm.GeneralisedAlpha, rho_inf=rho, tolerance=1e-11)
    points, R = problem.points, problem.points["top_offset"]
    first = points["x"] + R
    for k in range(1, 21):
        s.value = 0.01 * (1 - np.cos(0.05 * np.pi * k))
        problem.step(0.1 * k)
    quiet.value = 0.02
    rest.step()
    assert foot.load() == pytest.approx(held.load(), rel=0.01)
    # forces balance within a step, and the motion is that at its end
    faces = points["x"] + np.einsum("pij,pj->pi", points["F"][:, :2, :2], R)
    under = np.any(points["top_area"], axis=1)
    # of the last face only the part up to the edge of the footing counts
    inner = under & (points["x0"][:, 0] < 2.5)
    motion = points["top_motion"][under]
    moved = (faces - first)[inner]
    np.testing.assert_allclose(points["top_motion"][inner], moved, rtol=0, atol=1e-14)
    np.testing.assert_allclose(motion[:, 1], -0.02, rtol=0, atol=1e-5)


def test_explicit_steps_refuse_a_footing():
    with pytest.raises(errors.FormError, match=r"field top_motion.* take mpm\.RigidBody with"):
        pressed(mpm.Explicit)
