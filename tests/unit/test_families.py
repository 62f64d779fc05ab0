"""Points that split and merge: what is kept, what comes back, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from dolfinx import mesh
from mpi4py import MPI

import dolfinmpm as mpm
from dolfinmpm._platform.errors import FieldShapeError, ParameterError, PointsOutsideGridError

KINDS = ("plane", "axisymmetric", "solid")


def body(kind, seed=0, affine=""):
    """Points in a random state, in the middle of a grid."""
    rng = np.random.default_rng(seed)
    if kind == "solid":
        grid = mesh.create_unit_cube(MPI.COMM_WORLD, 4, 4, 4, mesh.CellType.hexahedron)
    else:
        grid = mpm.create_lattice(MPI.COMM_WORLD, [np.linspace(0, 1, 9)] * 2)
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
    assert points.error_in_fields() is None
    back = mpm.merge(points, 1e-6)
    assert back.count == change.count
    agrees(points, before)


@pytest.mark.parametrize("kind", KINDS)
def test_a_thousand_random_splits_and_merges_lose_and_grow_nothing(kind):
    points = body(kind)
    rng, limit = np.random.default_rng(7), 6 * len(points)
    first = None
    for _ in range(1000):
        if rng.random() < 0.5 and points.total < limit:
            shallow = mpm.families(points).level < 3
            change = mpm.split(points, shallow & (rng.random(len(points)) < 0.1))
        else:
            change = mpm.merge(points, 1e-6, allowed=rng.random(len(points)) < 0.9)
        first = first or change.before
        step = change.after.number - change.before.number
        assert abs(step) == (2**points.gdim - 1) * change.count
        assert np.unique(points["id"]).size == len(points) == points.total
        assert change.after.mass == pytest.approx(first.mass, rel=1e-12)
        assert change.after.volume == pytest.approx(first.volume, rel=1e-12)
        np.testing.assert_allclose(change.after.momentum, first.momentum, rtol=0, atol=1e-12)
        # no affine part: a split keeps the velocity, and a merge of like siblings too
        assert change.after.kinetic_energy == pytest.approx(first.kinetic_energy, rel=1e-12)
    while mpm.merge(points, 1e-6).count:
        pass
    assert (mpm.families(points).level == 0).all()


def test_numbers_tell_the_family():
    points = body("plane")
    ids = points["id"].copy()
    mpm.split(points, points["id"] == 3)
    known = mpm.families(points)
    young = known.level == 1
    assert known.parent[young].tolist() == [3] * 4
    assert known.place[young].tolist() == [0, 1, 2, 3]
    assert (known.parent[~young] == -1).all()
    assert points["id"][~young].tolist() == ids[ids != 3].tolist()
    mpm.split(points, young & (known.place == 2))
    known = mpm.families(points)
    assert sorted(known.level.tolist()) == [0] * 15 + [1] * 3 + [2] * 4
    assert (known.ancestor[known.level > 0] == 3).all()
    # numbers of points that come later do not meet those of children
    more = mpm.fill(points.grid, mpm.Box((0, 0), (0.2, 0.2)), 1, 1.0)
    points.add(more)
    assert np.unique(points["id"]).size == points.total
    assert mpm.families(points).level.max() == 2


def test_families_that_differ_or_part_or_lack_a_sibling_stay():
    def split_once():
        points = body("plane")
        mpm.split(points, points["id"] == 0)
        return points, np.flatnonzero(mpm.families(points).level == 1)

    points, rows = split_once()
    points["F"][rows[0]] = np.diag([1.02, 1.0]) @ points["F"][rows[0]]
    assert mpm.merge(points, 1e-2).count == 0
    assert mpm.merge(points, 3e-2).count == 1
    points, rows = split_once()
    points["tag"][rows[1]] = 5
    assert mpm.merge(points, 1.0).count == 0
    points, rows = split_once()
    points["x"][rows[2]] += 0.8 * points["l0"][rows[2]]
    assert mpm.merge(points, 1.0).count == 0
    points["x"][rows[2]] -= 0.3 * points["l0"][rows[2]]
    assert mpm.merge(points, 1.0).count == 1
    points, rows = split_once()
    allowed = np.ones(len(points), bool)
    allowed[rows[3]] = False
    assert mpm.merge(points, 1.0, allowed=allowed).count == 0
    points.remove(np.arange(len(points)) == rows[3])
    assert mpm.merge(points, 1.0).count == 0


def test_a_merge_without_affine_velocities_tells_what_it_loses():
    points = body("plane")
    mpm.split(points, points["id"] == 0)
    rows = mpm.families(points).level == 1
    spin = points["x"][rows] - points["x"][rows].mean(axis=0)
    points["velocity"][rows] += spin @ [[0.0, 1.0], [-1.0, 0.0]]
    change = mpm.merge(points, 1.0)
    np.testing.assert_allclose(change.after.momentum, change.before.momentum, atol=1e-14)
    lost = change.before.angular_momentum[0] - change.after.angular_momentum[0]
    m = points["density"][0] * points["V0"][0]
    assert lost == pytest.approx(m * np.mean(np.sum(spin**2, axis=1)), rel=1e-12)
    less = change.before.kinetic_energy - change.after.kinetic_energy
    assert less == pytest.approx(0.5 * lost, rel=1e-12)


@pytest.mark.parametrize("affine", ["apic", "tpic"])
def test_a_merge_keeps_angular_momentum_in_affine_velocities(affine):
    points = body("solid", affine=affine)
    mpm.split(points, np.ones(len(points), bool))
    rng = np.random.default_rng(3)
    points["velocity"] += rng.normal(size=points["velocity"].shape)
    points["x"] += 0.2 * points["l0"] * rng.uniform(-1, 1, points["x"].shape)
    change = mpm.merge(points, 1.0)
    assert change.count == points.total
    for name in ("momentum", "angular_momentum"):
        before, after = getattr(change.before, name), getattr(change.after, name)
        np.testing.assert_allclose(after, before, rtol=0, atol=1e-13 * np.abs(before).max())


def test_strains_and_internal_variables_are_means_by_volume():
    points = body("plane")
    points.add_field("be", (6,), "", (1.0, 1.0, 1.0, 0.0, 0.0, 0.0))
    points.add_field("plastic_strain")
    points.fields["has_plastic_strain"] = np.ones(len(points), np.int8)
    mpm.split(points, points["id"] == 0)
    rows = np.flatnonzero(mpm.families(points).level == 1)
    strain = np.random.default_rng(2).uniform(-0.01, 0.01, (4, 3))
    points["be"][rows, :3] = np.exp(2 * strain)
    points["plastic_strain"][rows] = (0.01, 0.02, 0.03, 0.04)
    points["stress"][rows] = np.arange(4.0)[:, None, None] * np.eye(3)
    assert mpm.merge(points, 0.02).count == 0, "plastic strains differ by 0.03"
    assert mpm.merge(points, 0.031).count == 1
    (p,) = np.flatnonzero(points["id"] == 0)
    np.testing.assert_allclose(0.5 * np.log(points["be"][p, :3]), strain.mean(axis=0), atol=1e-16)
    assert points["plastic_strain"][p] == pytest.approx(0.025)
    np.testing.assert_allclose(points["stress"][p], 1.5 * np.eye(3), atol=1e-15)


def test_volume_stays_where_siblings_have_other_volumes():
    points = body("axisymmetric")
    mpm.split(points, np.ones(len(points), bool))
    F = points["F"]
    F[:, 0, 0] *= 1 + 0.01 * np.random.default_rng(4).uniform(-1, 1, len(F))
    points["V"] = np.linalg.det(F) * points["V0"]
    change = mpm.merge(points, 0.1)
    assert change.count == points.total
    assert change.after.volume == pytest.approx(change.before.volume, rel=1e-14)
    # the next step takes the volume from F
    np.testing.assert_allclose(np.linalg.det(points["F"]) * points["V0"], points["V"], rtol=1e-13)


def test_what_cannot_split_is_refused_and_changes_nothing():
    points = body("plane")
    n, before = len(points), copied(points)
    with pytest.raises(ParameterError, match=r"which = .* must be booleans"):
        mpm.split(points, np.arange(n))
    with pytest.raises(FieldShapeError, match="which should be 16 booleans"):
        mpm.split(points, np.ones(n + 1, bool))
    with pytest.raises(ParameterError, match=r"tolerance = 0 must be above 0"):
        mpm.merge(points, 0.0)
    with pytest.raises(ParameterError, match=r'outside = .* must be one of "raise", "keep"'):
        mpm.split(points, np.ones(n, bool), outside="drop")
    points["x"][0] = (1e-3, 0.4)
    points.locate()
    before = copied(points)
    with pytest.raises(PointsOutsideGridError, match=r"2 children would lie outside .*keep"):
        mpm.split(points, np.ones(n, bool))
    agrees(points, before)
    assert mpm.split(points, np.ones(n, bool), outside="keep").count == n - 1
    assert (mpm.families(points).level == 0).sum() == 1


def test_a_point_splits_until_its_number_can_tell_no_more():
    points = body("plane")
    for _ in range(12):
        mpm.split(points, points["id"] == points["id"].max())
    assert points.total == 16 + 12 * 3
    with pytest.raises(ParameterError, match=r"level 12, .* above the limit of 12 splits in 2D"):
        mpm.split(points, points["id"] == points["id"].max())
    while mpm.merge(points, 1e-6).count:
        pass
    assert points.total == 16
