"""Points that split and merge: what is kept, what comes back, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import unit_grid
from dolfinx import mesh
from mpi4py import MPI

import dolfinmpm as mpm

KINDS = ("plane", "axisymmetric", "solid")


def body(kind, seed=0, affine=""):
    """Points in a random state, in the middle of a grid."""
    rng = np.random.default_rng(seed)
    if kind == "solid":
        grid = mesh.create_unit_cube(MPI.COMM_WORLD, 4, 4, 4, mesh.CellType.hexahedron)
    else:
        grid = unit_grid("quadrilateral", 6)
    d = grid.geometry.dim
    shape = mpm.Box((0.25,) * d, (0.75,) * d)
    points = mpm.fill(grid, shape, 1, 2.0, axisymmetric=kind == "axisymmetric")
    n, e = len(points), points.strain_dim
    points["density"] = rng.uniform(1.0, 3.0, n)
    F = np.eye(e) + rng.uniform(-0.15, 0.15, (n, e, e))
    if kind == "axisymmetric":
        F[:, 2, :2] = F[:, :2, 2] = 0.0
    points["F"] = F
    points["V"] = np.linalg.det(F) * points["V0"]
    points["stress"] = rng.normal(size=(n, 3, 3))
    points.add_field("velocity", (d,), "m/s")
    points["velocity"] = rng.normal(size=(n, d))
    if affine:
        name, unit = (
            ("velocity_moment", "m^2/s") if affine == "apic" else ("velocity_gradient", "1/s")
        )
        points.add_field(name, (d, d), unit)
        points[name] = rng.normal(size=(n, d, d))
    return points


def copied(points):
    return {name: a.copy() for name, a in points.fields.items()}


def agrees(points, fields):
    assert set(points.fields) == set(fields)
    here, there = np.argsort(points["id"]), np.argsort(fields["id"])
    for name, expected in fields.items():
        size = np.abs(expected).max()
        np.testing.assert_allclose(
            points[name][here], expected[there], rtol=0, atol=2e-14 * size, err_msg=name
        )


def same_sums(change):
    for name in ("mass", "volume", "momentum", "angular_momentum", "kinetic_energy"):
        before, after = (np.asarray(getattr(one, name)) for one in (change.before, change.after))
        size = max(1.0, float(np.abs(before).max(initial=0.0)))
        np.testing.assert_allclose(after, before, rtol=0, atol=1e-13 * size, err_msg=name)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("affine", ["", "apic", "tpic"])
def test_a_split_keeps_the_sums_and_a_merge_returns_the_points(kind, affine):
    points = body(kind, affine=affine)
    before = copied(points)
    chosen = np.random.default_rng(1).random(len(points)) < 0.6
    change = mpm.split(points, chosen)
    assert change.count == chosen.sum()
    assert points.total == len(points) == len(chosen) + (2**points.gdim - 1) * chosen.sum()
    assert np.unique(points["id"]).size == points.total
    if kind == "axisymmetric":
        # the velocity within a ring's section weighs by the radius
        assert change.after.mass == pytest.approx(change.before.mass, rel=1e-14)
        np.testing.assert_allclose(change.after.momentum, change.before.momentum, atol=1e-14)
    else:
        same_sums(change)
    assert points.fault() is None
    back = mpm.merge(points, 1e-6)
    assert back.count == change.count
    agrees(points, before)
