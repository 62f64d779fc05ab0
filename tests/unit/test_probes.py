"""Probes: places of a body that are followed by the material points nearest to them."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from conftest import COMM, unit_grid
from dolfinx import fem, mesh

import dolfinmpm as mpm
from dolfinmpm._platform.errors import FieldShapeError, ParameterError, UnknownNameError

KINDS = {1: "interval", 2: "quadrilateral", 3: "hexahedron"}


def body(d=2, n=4, per_cell=2, kind=None):
    grid = unit_grid(kind or KINDS[d], n)
    return mpm.fill(grid, mpm.Box((0.0,) * d, (0.75,) * d), per_cell, 1.0)


@pytest.mark.parametrize("d", [1, 2, 3])
@pytest.mark.parametrize("place", [(0.31, 0.44, 0.2), (0.75, 0.3, 0.75), (0.0, 0.0, 0.0)])
def test_linear_fields_have_their_own_values_at_the_place(d, place):
    points = body(d)
    at = np.array(place[:d])
    one = mpm.probe(points, at)
    np.testing.assert_allclose(one.position, at, atol=1e-14)
    np.testing.assert_array_equal(one.displacement, np.zeros(d))
    A = np.random.default_rng(1).normal(size=(d, d))
    points["x"] = points["x0"] @ A.T
    np.testing.assert_allclose(one.position, A @ at, atol=1e-13)
    np.testing.assert_allclose(one.displacement, A @ at - at, atol=1e-13)
    assert one.settlement == pytest.approx(-(A @ at - at)[-1], abs=1e-13)
    points.add_field("heat")
    points["heat"] = 3.0 + points["x0"] @ A[0]
    assert one["heat"] == pytest.approx(3.0 + at @ A[0])
    assert isinstance(one["heat"], float)
    points["stress"][:, 0, 0] = points["heat"]
    assert one["stress"].shape == (3, 3)
    assert one["stress"][0, 0] == pytest.approx(one["heat"])
    # weights at the edge are no larger than the place is away
    assert np.abs(one.weights).max() < 2.5
    assert one.weights.sum() == pytest.approx(1.0)


def test_a_place_at_a_point_is_the_point():
    points = body()
    k = 17
    one = mpm.probe(points, points["x"][k])
    points["x"][k] += (0.01, -0.02)
    np.testing.assert_allclose(one.displacement, [0.01, -0.02], atol=1e-12)
    assert one.settlement == pytest.approx(0.02)


def test_points_of_one_row_tell_what_they_can():
    grid = unit_grid("quadrilateral", 4)
    x = np.column_stack([np.linspace(0.1, 0.9, 9), np.full(9, 0.5)])
    points = mpm.MaterialPoints.from_arrays(grid, x, 0.01, 1.0)
    one = mpm.probe(points, (0.33, 0.6))
    np.testing.assert_allclose(one.position, [0.33, 0.5], atol=1e-12)
    alone = mpm.MaterialPoints.from_arrays(grid, x[:1], 0.01, 1.0)
    np.testing.assert_allclose(mpm.probe(alone, (0.2, 0.5)).position, x[0])
    np.testing.assert_allclose(mpm.probe(alone, x[0]).weights, 1.0)


def test_a_place_some_way_from_the_points():
    """The further it is the more points tell where it goes, and none counts more than twice."""
    points = body(n=2, per_cell=6)
    one = mpm.probe(points, (0.75 + 0.3, 0.4))
    assert len(one.weights) > 10
    assert np.abs(one.weights).max() < 2.0
    np.testing.assert_allclose(one.position, [1.05, 0.4], atol=1e-12)


def test_a_place_in_long_cells_is_told_by_the_points_beside_it():
    """A curve across cells of 40:1; points of ten cells to each side had told it."""
    lines = [np.linspace(0.0, 1.0, 41), [0.0, 1.0, 2.0]]
    points = mpm.fill(mpm.create_lattice(COMM, lines), mpm.Box((0, 0), (1, 1)), 2, 1.0)
    points.add_field("heat", value=lambda x: np.sin(5 * x[0]))
    for at in (0.43, 0.53):
        for height in (0.3, 0.5):
            one = mpm.probe(points, (at, height))
            assert np.ptp(one._x0[:, 0]) < 4 * 0.025
            # 25/2 · 0.05² within two cells
            assert abs(one["heat"] - np.sin(5 * at)) < 0.02
            np.testing.assert_allclose(one.position, [at, height], atol=1e-12)
    with pytest.raises(ParameterError, match=r"no further than a cell \(1 m\)"):
        mpm.probe(points, (0.5, 2.0))


def test_names_are_asked_for_with_in():
    """Python counts numbers from 0 where a class has names and no `__iter__`."""
    points = body()
    V = mpm.Space(points.grid, "gimp")
    F = mpm.momentum(mpm.materials.Hencky(1e6, 0.3), points, V.increment, V.test)
    problem, curve = mpm.Newmark(F, V.increment, points), mpm.History()
    problem.step(1e-3)
    curve.record(t=1.0, load=2.0)
    now, one = problem.energies(), mpm.probe(points, (0.3, 0.3))
    assert "integrator" in now
    assert "kinetic" not in now
    assert list(now) == list(now.losses)
    assert "way" not in curve
    assert list(curve) == ["t", "load"]
    assert "stress" in one
    assert "pressure" not in one


def column(**space):
    """A column that settles under its weight by ρ g H²/(2 E); its problem, probe and load."""
    grid = mesh.create_rectangle(COMM, [(0, 0), (1, 5)], (1, 20), mesh.CellType.quadrilateral)
    points = mpm.fill(grid, mpm.Box((0, 0), (1, 4)), 2, 1000.0)
    V = mpm.Space(grid, "gimp", **space)
    u, v = V.increment, V.test
    g = fem.Constant(grid, (0.0, 0.0))
    F = mpm.momentum(mpm.materials.Hencky(1e7, 0.0), points, u, v)
    F -= ufl.inner(points.density * g, v) * points.dX
    bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
    return mpm.QuasiStatic(F, u, points, bcs), mpm.probe(points, (0.5, 4.0)), g


@pytest.mark.parametrize("configuration", ["updated", "total"])
def test_the_settlement_of_a_column_goes_into_a_history(configuration, tmp_path):
    problem, top, g = column(configuration=configuration)
    history = mpm.History()
    for k in (1, 2):
        g.value[1] = -5.0 * k
        problem.step()
        history.record(load=k, top=top, settlement=top.settlement)
    exact = 1000 * 10 * 4**2 / (2 * 1e7)
    assert top.settlement == pytest.approx(exact, rel=4e-3)
    assert history.names == ("load", "top_x", "top_y", "settlement")
    np.testing.assert_array_equal(history["top_y"], -history["settlement"])
    np.testing.assert_allclose(history["top_x"], 0.0, atol=1e-12)
    assert history["settlement"][0] == pytest.approx(0.5 * exact, rel=4e-3)
    # the stress is the same all over a cell: at its middle it is 1250 Pa
    assert -700.0 < top["stress"][1, 1] < 0.0
    deep = mpm.probe(problem.points, top.position - (0.0, 1.0))
    assert deep["stress"][1, 1] == pytest.approx(-1e4, rel=0.02)
    assert repr(top) == "the probe at [0.5, 4.0] m"
    history.write(tmp_path / "top.csv")
    assert (tmp_path / "top.csv").read_text().splitlines()[0] == "load,top_x,top_y,settlement"


def test_probes_go_on_after_a_checkpoint(tmp_path):
    problem, top, g = column()
    g.value[1] = -5.0
    problem.step()
    problem.save(tmp_path / "one.npz")
    again, top_again, _ = column()
    assert top_again.settlement == 0.0
    again.load(tmp_path / "one.npz")
    assert top_again.settlement == top.settlement > 0
    # of another number of ranks the points have other numbers
    other, top_of_other, _ = column()
    other.load(tmp_path / "one.npz")
    other.points["id"] = other.points["id"][::-1].copy()
    assert top_of_other.settlement == top.settlement
    np.testing.assert_array_equal(top_of_other["stress"], top["stress"])


def test_points_that_come_and_go():
    points = body()
    corner = mpm.probe(points, (0.75, 0.75))
    far = mpm.probe(points, (0.1, 0.1))
    more = mpm.fill(points.grid, mpm.Box((0.75, 0.0), (1.0, 0.75)), 2, 1.0)
    points["x"] += 0.01
    points.add(more)
    np.testing.assert_allclose(corner.displacement, 0.01, rtol=1e-12)
    points.remove(lambda x: x[0] + x[1] > 1.25)
    np.testing.assert_allclose(far.displacement, 0.01, rtol=1e-12)
    for ask in (lambda: corner.settlement, lambda: corner["stress"], lambda: corner.position):
        with pytest.raises(ParameterError, match=r"of the \d+ material points that the probe at"):
            ask()
    # points that are filled in again in the same places are others
    points["x"] -= 0.01
    points.add(mpm.fill(points.grid, mpm.Where(lambda x: (x < 0.75).all(0) & (x.sum(0) > 1.28)), 2,
                        1.0))  # fmt: skip
    with pytest.raises(ParameterError, match="have been removed: make a new probe"):
        corner.displacement  # noqa: B018
    assert mpm.probe(points, (0.75, 0.75)).displacement == pytest.approx([0.0, 0.0])


def test_probes_on_a_grid_whose_lines_are_laid_anew():
    lines = [np.linspace(0, 1, 5), np.r_[0:0.5:4j, 0.7, 1.0]]
    grid = mpm.create_lattice(COMM, lines)
    points = mpm.fill(grid, mpm.Box((0, 0), (1, 0.5)), 3, 1.0)
    V = mpm.Space(grid, "gimp")
    F = mpm.momentum(mpm.materials.Hencky(1e6, 0.3), points, V.increment, V.test)
    problem = mpm.QuasiStatic(F, V.increment, points, mpm.fixed(V, "bottom"))
    top = mpm.probe(points, (0.4, 0.5))
    problem.step()
    mpm.regrid(problem, [lines[0], np.r_[0:0.6:4j, 0.8, 1.0]])
    np.testing.assert_allclose(top.position, [0.4, 0.5], atol=1e-9)


WRONG = {
    "no points": (lambda p: mpm.probe(3, (0, 0)), "points = 3"),
    "a word": (lambda p: mpm.probe(p, "top"), "place = 'top' must be 2 finite numbers"),
    "a number": (lambda p: mpm.probe(p, 0.5), "place = 0.5 must be 2 finite numbers"),
    "too many": (lambda p: mpm.probe(p, (0, 0, 0)), "2 finite numbers"),
    "not finite": (lambda p: mpm.probe(p, (0, np.nan)), "2 finite numbers"),
    "several": (lambda p: mpm.probe(p, [(0, 0), (1, 1)]), "must be 2 finite numbers"),
    "complex": (lambda p: mpm.probe(p, (0, 1j)), "must be 2 finite numbers"),
    "far away": (lambda p: mpm.probe(p, (0.4, 1.4)), r"0\.676 m from the next material point"),
    "no field": (lambda p: mpm.probe(p, (0, 0))["heat"], "no field 'heat'; they have"),
    "displacement": (lambda p: p["displacement"], r"is points\['x'\] - points\['x0'\]"),
    "no name": (lambda p: mpm.probe(p, (0, 0))[3], "no field 3"),
    "numbers": (lambda p: mpm.probe(p, (0, 0))["id"], "whole numbers"),
    "another record": (
        lambda p: _recorded(p), "record has crest_x, crest_y; the first had settlement",
    ),
}  # fmt: skip


def _recorded(points):
    history = mpm.History()
    history.record(settlement=0.0)
    history.record(crest=mpm.probe(points, (0, 0)))


@pytest.mark.parametrize("name", WRONG)
def test_what_is_no_probe(name):
    ask, words = WRONG[name]
    errors = ParameterError, UnknownNameError, FieldShapeError
    with pytest.raises(errors, match=words):
        ask(body())
