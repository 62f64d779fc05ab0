"""Sweeps, observed orders, tables on disk and their pictures."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import matplotlib.image
import numpy as np
import pytest
from badinputs import scene
from conftest import unit_grid
from mpi4py import MPI
from petsc4py import PETSc

import dolfinmpm as mpm
from dolfinmpm import study
from dolfinmpm._platform.errors import ConvergenceError, ParameterError
from dolfinmpm.solve.quasistatic import StepRecord


def test_sweep_takes_what_a_scene_returns():
    @dataclass
    class Figures:
        kappa: float

    assert study.sweep(Figures, [1.0, 2.0]) == [
        {"place": 1.0, "kappa": 1.0},
        {"place": 2.0, "kappa": 2.0},
    ]
    assert study.sweep(lambda place: {"sum": sum(place)}, [(1, 2)]) == [{"place": (1, 2), "sum": 3}]
    assert study.sweep(lambda place: place / 2, [3]) == [{"place": 3, "error": 1.5}]


def test_convergence_finds_the_orders_of_all_errors():
    def scene(h):
        return {"coarse": 2 * h, "fine": 3 * h**3, "points": round(1 / h)}

    rows = study.convergence(scene, [0.5, 0.25, 0.1])
    assert [row["h"] for row in rows] == [0.5, 0.25, 0.1]
    assert rows[0]["coarse_order"] is rows[0]["fine_order"] is None
    assert [row["coarse_order"] for row in rows[1:]] == pytest.approx([1, 1])
    assert [row["fine_order"] for row in rows[1:]] == pytest.approx([3, 3])
    assert "points_order" not in rows[0]
    rows = study.convergence(scene, [0.5, 0.25], errors=["fine"])
    assert "coarse_order" not in rows[1]
    shifted = study.convergence(lambda h: {"h": h + 0.1, "error": (h + 0.1) ** 2}, [1, 0.5])
    assert shifted[1]["error_order"] == pytest.approx(2)
    assert study.convergence(lambda h: h**2, [1, 0.5])[1]["error_order"] == pytest.approx(2)


def test_runs_that_did_not_finish_have_no_order():
    rows = study.convergence(lambda h: {"error": None if h == 0.5 else h}, [1.0, 0.5, 0.25, 0.125])
    assert [row["error_order"] for row in rows] == [None, None, None, pytest.approx(1)]
    assert np.isnan(study.observed_orders([1, 0.5], [0.0, 0.0])).all()


def test_errors_with_a_sign_have_orders():
    h = np.array([0.4, 0.2, 0.1])
    for errors in (-3 * h**2, 3 * h**2 * [1, -1, 1]):
        assert study.observed_orders(h, errors) == pytest.approx([2, 2])
        assert study.overall_order(h, errors) == pytest.approx(2)


def test_overall_order():
    h = np.array([1.0, 0.5, 0.2, 0.1])
    assert study.overall_order(h, 3 * h**2) == pytest.approx(2)
    assert study.overall_order(h, [1.0, None, 0.04, 0.0]) == pytest.approx(2)
    assert np.isnan(study.overall_order(h, [1.0, None, None, 0.0]))


@pytest.mark.parametrize("sizes", [[], [1.0, 0.0], [-1.0], [np.nan]])
def test_sizes_are_positive(sizes):
    with pytest.raises(ParameterError, match="positive"):
        study.convergence(lambda h: h, sizes)


def test_errors_are_among_the_figures():
    with pytest.raises(ParameterError, match="returned no stress, but h, displacement"):
        study.convergence(lambda h: {"displacement": h}, [1.0, 0.5], errors=["stress"])


ROWS = [
    {"place": [0.1, 2], "kappa": 1.5e-300, "basis": "gimp", "done": True, "order": None},
    {"place": [0.2, 3], "kappa": float("inf"), "basis": "12", "done": False, "order": 0.1 + 0.2},
]


@pytest.mark.parametrize("name", ["table.csv", "new/table.json"])
def test_tables_come_back_as_they_were(tmp_path, name):
    study.write_table(ROWS, tmp_path / name)
    assert study.read_table(tmp_path / name) == ROWS


def test_tables_of_numpys_numbers_and_of_rows_that_differ(tmp_path):
    rows = [{"n": np.int64(3), "x": np.array([1.0, 2.0])}, {"y": np.float64(0.5), "text": "a, b"}]
    study.write_table(rows, tmp_path / "a.csv")
    first, second = study.read_table(tmp_path / "a.csv")
    assert first == {"n": 3, "x": [1.0, 2.0], "y": None, "text": None}
    assert second == {"n": None, "x": None, "y": 0.5, "text": "a, b"}


def test_tables_have_a_known_ending(tmp_path):
    with pytest.raises(ParameterError, match=r"\.csv or \.json"):
        study.write_table(ROWS, tmp_path / "table.txt")
    with pytest.raises(ParameterError, match=r"\.csv or \.json"):
        study.read_table(tmp_path / "table")
    with pytest.raises(OSError, match="nothing"):
        study.read_table(tmp_path / "nothing.csv")
    with pytest.raises(TypeError, match="cannot be written"):
        study.write_table([{"a": object()}], tmp_path / "table.csv")


def test_pictures(tmp_path):
    sweep = [
        {"place": (a, 0.0), "kappa_K": 10 / a, "kappa_M": np.inf if a > 1 else 3}
        for a in (2, 1, 0.1)
    ]
    with mpm.figure(tmp_path / "sweep.png") as (_, axes):
        study.draw_sweep(axes, sweep, x=lambda row: row["place"][0])
    rows = study.convergence(lambda h: {"error": h**2, "other": None}, [0.25, 0.125, 0.0625])
    with mpm.figure(tmp_path / "convergence.png") as (_, axes):
        study.draw_convergence(axes, {"one": rows, "two": rows[:1]})
    with mpm.figure(tmp_path / "empty.png") as (_, axes):
        study.draw_convergence(axes, {"none": rows}, key="other")
    for name in ("sweep", "convergence", "empty"):
        assert matplotlib.image.imread(tmp_path / f"{name}.png").shape[0] > 300


def row(**others):
    """A row of a sweep of condition numbers."""
    return {"kappa_K": 9.0, "kappa_M": 2.0, "dt_consistent": 0.4, "dt_lumped": 0.6, **others}


def test_wrong_sweeps():
    def scene(place):
        return {"kappa_K": 1.0}

    for call, words in (
        (lambda: study.sweep(None, [1]), "scene = None must be a function"),
        (lambda: study.sweep(lambda place: None, [1, 2]), "returned None for 1 .* a return"),
        (lambda: study.sweep(lambda place: "a", [1]), "returned 'a' for 1"),
        (lambda: study.sweep(scene, None), "places = None must be a list"),
        (lambda: study.sweep(scene, []), r"places = \[\] must be a list"),
        (lambda: study.convergence(lambda h: None, [0.1]), "returned None for 0.1"),
        (lambda: study.convergence(scene, ["a"]), r"sizes = \['a'\] must be some positive"),
        (lambda: study.worst([]), r"rows = \[\] must be a list with at least one entry"),
        (lambda: study.worst(study.sweep(scene, [1])), "a row has no kappa_M, dt_consistent"),
        (lambda: study.worst(None), "rows = None must be a list"),
        (lambda: study.worst([row(), row(kappa_K=None)]), "kappa_K = None must be a number: leave"),
        (
            lambda: study.worst([row(place=0.5, dt_lumped=np.nan), row()]),
            r"dt_lumped = nan at the place 0\.5 must be a number: leave out the rows",
        ),
    ):
        with pytest.raises(ParameterError, match=words):
            call()


def test_conditions_of_what_cannot_be():
    problem = scene().solver()
    for arguments, words in (
        ((problem, -1), r"density = -1 kg/m\^d must be above 0"),
        ((problem, "1"), "density = '1' must be a number"),
        ((problem, 1.0, -1.0), "factor = -1 must be at least 0"),
        ((scene().points, 1.0), "problem = a MaterialPoints must be a QuasiStatic"),
        ((problem, 1.0, 1.0, 3.0), "extra = 3.0 must be a Form"),
    ):
        with pytest.raises(ParameterError, match=words):
            study.conditioning(*arguments)


def test_a_penalty_of_ones_own_enters_the_mass():
    grid = unit_grid("quadrilateral", 4)
    points = mpm.fill(grid, mpm.Box((0.0, 0.0), (0.5 + 1e-5, 1.0)), 2, 1.0, aligned="body")
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    F = mpm.momentum(mpm.materials.Hencky(E=1.0, nu=0.0), points, u, v)
    problem = mpm.QuasiStatic(F, u, points)
    penalty = mpm.ghost(points, u, v, 0.25, scaling="literal")
    bare = study.conditioning(problem, 1.0)
    own = study.conditioning(problem, 1.0, extra=penalty)
    # the smallest eigenvalue is known to the rounding of the largest
    rounding = 10 * np.finfo(float).eps * bare.kappa_K
    assert own.kappa_K == pytest.approx(bare.kappa_K, rel=rounding)
    assert own.kappa_M < 1e4 < 1e8 < bare.kappa_M


def test_drawn_sweeps_show_numbers_and_nested_curves_differ(tmp_path):
    with mpm.figure(tmp_path / "drawn.png", 5, 2.5, ncols=2) as (_, (left, right)):
        study.draw_sweep(left, [{"place": k, "kappa": 20.0 + k} for k in range(3)], keys=["kappa"])
        assert left.get_ylim() == pytest.approx((10, 100))
        rows = [{"h": h, "error": h} for h in (1.0, 0.5)]
        study.draw_convergence(right, {"one": rows, "other": rows}, nested=True)
        sizes = [line.get_markersize() for line in right.lines[:2]]
        assert sizes[0] > sizes[1]
    assert (tmp_path / "drawn.png").stat().st_size > 0


def test_small_eigenvalues_keep_their_digits():
    """A graded matrix D A D: condition number 2e24, found to twelve digits on one rank."""
    D = np.diag([1.0, 1e-4, 1e-12])
    A = np.array([[1.0, 0.5, 0.25], [0.5, 1.0, 0.5], [0.25, 0.5, 1.0]])
    matrix = PETSc.Mat().createDense(3, array=(D @ A @ D).ravel(), comm=MPI.COMM_SELF)
    matrix.assemble()
    # to first order in the ratios of D: pivots of the elimination in the order of their size
    expected = 1 / (1e-24 * np.linalg.det(A) / np.linalg.det(A[:2, :2]))
    assert study.condition_number(matrix) == pytest.approx(expected, rel=1e-7)


@pytest.mark.parametrize("kind", ["interval", "triangle", "quadrilateral", "hexahedron"])
def test_rigid_modes_cost_no_force(kind):
    grid = unit_grid(kind, 4)
    d = grid.geometry.dim
    # far from the origin rotations must not drown in translations
    grid.geometry.x[:, 0] += 1e3
    points = mpm.fill(
        grid, mpm.Box((1e3,) + (0,) * (d - 1), (1e3 + 0.6,) + (0.7,) * (d - 1)), 2, 1.0
    )
    V = mpm.Space(grid, "linear")
    F = mpm.momentum(mpm.materials.Hencky(E=1.0, nu=0.2), points, V.increment, V.test)
    problem = mpm.QuasiStatic(F, V.increment, points)
    K = problem.stiffness()
    modes = study.rigid_modes(problem.here)
    products = grid.comm.allreduce(modes.T @ modes, op=MPI.SUM)
    np.testing.assert_allclose(products, np.eye({1: 1, 2: 3, 3: 6}[d]), atol=1e-12)
    x, y = K.createVecs()
    for mode in modes.T:
        x.getArray()[:] = mode
        K.mult(x, y)
        assert y.norm() < 1e-12
    held = mpm.QuasiStatic(F, V.increment, points, mpm.rollers(V, "left"))
    held.stiffness()
    assert study.rigid_modes(held.here).shape[1] == 0


# -- strength reduction -------------------------------------------------------


@functools.cache
def body():
    return mpm.fill(unit_grid("quadrilateral"), mpm.Box((0, 0), (1, 1)), 1, 1.0)


class Spring:
    """A problem whose body moves with its load, and further above a strength."""

    def __init__(self, strength, softness=0.0, breaks=False):
        self.points, self.load = body(), 0.0
        self.strength, self.softness, self.breaks = strength, softness, breaks

    def step(self):
        beyond = max(self.load - self.strength, 0.0)
        if beyond > 0 and self.breaks:
            raise ConvergenceError("step 7 failed")
        self.points["x"][:] = self.points["x0"] + [0, 1e-3 * (self.load + self.softness * beyond)]
        return StepRecord(iterations=2)


def load_spring(factor, steps=4, **options):
    problem = Spring(1.5 / factor, **options)
    for step in range(1, steps + 1):
        problem.load = step / steps
        yield problem


def test_a_run_that_breaks_has_failed():
    loading = functools.partial(load_spring, breaks=True)
    safety = study.factor_of_safety(loading, 1.0, 2.0, tolerance=0.1)
    assert safety.bracket == (1.5, 1.5625)
    assert safety.factor == 1.53125
    assert [t.factor for t in safety.trials] == [1.0, 1.5, 1.5625, 1.625, 1.75, 2.0]
    last = safety.trials[-1]
    assert last == study.Trial(
        2.0, False, "in step 4 of the load: step 7 failed", 3, pytest.approx(0.75e-3),
        pytest.approx(1.0), 6,
    )  # fmt: skip
    assert safety.table()[0]["displacement"] == pytest.approx(1e-3)


def test_a_run_that_leaves_the_line_has_failed():
    """δ = 1 + 100 (1 − 1.5/F) passes 3 at F = 1.5/0.98."""
    loading = functools.partial(load_spring, softness=100.0)
    low, high = study.factor_of_safety(loading, 1.0, 2.0, tolerance=1e-4).bracket
    assert low <= 1.5 / 0.98 <= high <= low + 1e-4
    low, high = study.factor_of_safety(loading, 1.0, 2.0, tolerance=1e-4, growth=5.0).bracket
    assert low <= 1.5 / 0.96 <= high


def test_safety_is_drawn(tmp_path):
    rows = study.factor_of_safety(functools.partial(load_spring, softness=100.0)).table()
    with mpm.figure(tmp_path / "new" / "one.png") as (_, axes):
        study.draw_reduction(axes, rows[:1])
    assert matplotlib.image.imread(tmp_path / "new" / "one.png").shape[0] > 300
    with mpm.figure(tmp_path / "drawn.png") as (_, axes):
        study.draw_reduction(axes, rows, scale=1e-3)
        stands, fails = (line.get_ydata() for line in axes.lines)
        assert stands.max() == pytest.approx(
            max(r["displacement"] for r in rows if r["stands"]) * 1e3
        )
        assert len(stands) + len(fails) == len(rows)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"low": 0.0}, "low = 0.0 and high = 2.0 must be positive"),
        ({"low": 3.0}, "low = 3.0 and high = 2.0 must be positive and increase"),
        ({"tolerance": 0.0}, "tolerance = 0 must be above 0"),
        ({"growth": 1.0}, "growth = 1.0 must be more than 1"),
        ({"high": 1.4}, "stands at high = 1.4 still"),
        ({"low": 1.9}, "fails at low = 1.9 already, in step 4 of the load: step 7 failed"),
        (
            {"loading": lambda F: load_spring(F, steps=1)},
            "at factor 1 has 1 steps, but needs at least two",
        ),
        ({"loading": lambda F: []}, "at factor 1 has 0 steps"),
        ({"loading": lambda F: Spring(1.0)}, r"loading\(1\) returned a Spring .* `yield problem`"),
        ({"loading": lambda F: None}, r"loading\(1\) returned None .* `yield problem`"),
        ({"loading": 3}, "a function of the factor that yields such a problem"),
        ({"loading": lambda F: [1, 2]}, "yields 1, and should yield the problem"),
        ({"low": "1"}, "low = '1' must be a number"),
        ({"growth": None}, "growth = None must be a number"),
        ({"loading": lambda F: [Spring(1.0)] * 2}, "moves nothing"),
    ],
)
def test_wrong_reductions(options, message):
    arguments = {"loading": functools.partial(load_spring, breaks=True), **options}
    with pytest.raises(ParameterError, match=message):
        study.factor_of_safety(**arguments)


def test_reduced_strength():
    cohesion, friction = study.reduced_strength(10e3, 30.0, 1.5)
    assert cohesion == pytest.approx(10e3 / 1.5)
    assert np.tan(np.radians(friction)) == pytest.approx(np.tan(np.radians(30)) / 1.5)
    assert study.reduced_strength(5.0, 0.0, 2.0) == (2.5, 0.0)
    for wrong in ((1.0, 20.0, 0.0), (-1.0, 20.0, 1.0), (1.0, 90.0, 1.0), (1.0, 20.0, np.inf)):
        with pytest.raises(ParameterError, match=r"(factor|cohesion|friction_angle) = "):
            study.reduced_strength(*wrong)
