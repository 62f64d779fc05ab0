"""Every study runs small, and its figures hold."""

from __future__ import annotations

import csv

import pytest
from conftest import figures_of


def run(study, *options, ranks=1):
    return figures_of(f"demos/studies/{study}.py", "--json", "-", *options, ranks=ranks)


@pytest.mark.parametrize("ranks", [1, 3])
def test_column_compaction(tmp_path, ranks):
    options = "--no-plot", "--elements", "16", "--columns", "2", "--points", str(tmp_path / "p.csv")
    figures = run("column_compaction", *options, ranks=ranks)
    assert figures["error"] == pytest.approx(3.6589e-3, rel=1e-4)
    assert figures["height"] == pytest.approx(24.0596, rel=5e-3)
    assert figures["max_newton_iterations"] <= 5
    assert (figures["points"], figures["steps"], figures["ranks"]) == (128, 40, ranks)
    for name in ("newton_iterations", "active_cells", "unknowns"):
        assert figures[name] > 0
    assert figures["seconds_setup"] > 0
    assert figures["seconds_solve"] > 0
    with (tmp_path / "p.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 128
    worst = max(abs(float(r["stress_yy"]) + 800 * (50 - float(r["Xy"]))) for r in rows)
    assert worst < 0.05 * 800 * 50


# a column that hangs from its base is meant
@pytest.mark.filterwarnings("ignore:the weight .* acts upward")
@pytest.mark.parametrize(
    "options",
    [
        "--dimension 3 --elements 8 --poisson 0.3 --ghost scaled",
        "--elements 10 --points-per-cell 3 --modulus 2e4 --density 100 --height 30 --steps 20",
        "--basis linear --elements 8 --ghost literal --factor 2",
        "--gravity -0.5 --elements 16",
    ],
)
def test_column_compaction_otherwise(options):
    figures = run("column_compaction", "--no-plot", *options.split())
    assert figures["error"] < (0.2 if figures["basis"] == "linear" else 0.03)
    tolerance = 0.1 if figures["basis"] == "linear" else 0.02
    assert figures["height"] == pytest.approx(figures["height_exact"], rel=tolerance)


def test_pictures_and_files(tmp_path):
    run("column_compaction", "--elements", "8", "--output", str(tmp_path))
    for name in ("column_compaction.png", "column_compaction_points.png", "column_compaction.pvd"):
        assert (tmp_path / name).stat().st_size > 0


def test_conditioning():
    figures = run("conditioning", "--no-plot")
    assert figures["worst"]["kappa_K"] == pytest.approx(287, rel=0.01)
    assert figures["worst"]["kappa_M"] == pytest.approx(37.2, rel=0.01)
    assert figures["worst"]["dt_consistent"] == pytest.approx(0.575, rel=0.01)
    assert len(figures["places"]) == 14
    options = "--dimension 2 --basis linear --stabilisation aggregation --offsets 5 --spacing 0.1"
    turned = run("conditioning", "--no-plot", *options.split())
    assert len({place["angle"] for place in turned["places"]}) == 5
    assert turned["worst"]["kappa_K"] < 1e4


def test_compaction_compared():
    options = "--elements 8 --bases gimp,bspline2 --stabilisations none,ghost,aggregation"
    runs = run("compaction_compared", "--no-plot", *options.split())["runs"]
    assert len(runs) == 6
    errors = {(r["basis"], r["stabilisation"]): r["error"] for r in runs}
    assert all(r["completed"] for r in runs)
    for basis in ("gimp", "bspline2"):
        for stabilisation in ("ghost", "aggregation"):
            assert errors[basis, stabilisation] <= 1.05 * errors[basis, "none"]
    assert errors["bspline2", "none"] < errors["gimp", "none"]


def test_benchmark():
    figures = run("benchmark", "--repeat", "1", "--cases", "1x16", "--scenes=", "--growth=")
    case = figures["cases"]["gimp 1x16"]
    assert case["points"] == 64
    assert case["newton_iterations"] == 125
    assert case["seconds"] > 0


def test_benchmark_of_stabilisations():
    options = "--repeat 1 --cases 1x16 --bases gimp --stabilisations none,ghost --scenes= --growth="
    costs = run("benchmark", *options.split())["stabilisations"]
    # what is asked once, when the problem is made, counts little
    assert costs["gimp 1x16 none"]["stabilisation_calls_per_step"] < 1
    assert costs["gimp 1x16 ghost"]["stabilisation_calls_per_step"] > 1
    assert costs["gimp 1x16 none"]["milliseconds_per_iteration"] > 0


def test_benchmark_of_sand_that_yields():
    options = "--repeat 1 --cases= --bases gimp --plastic 16 --scenes= --growth="
    plastic = run("benchmark", *options.split())["plastic"]
    for kind in ("newmark", "static"):
        figures = plastic[f"gimp {kind}"]
        assert figures["points"] == 1248
        assert figures["yielding"] > 0
        assert abs(sum(figures["shares"].values()) - 1) < 1e-12


@pytest.mark.long
def test_benchmark_of_work_and_precision(tmp_path):
    options = "--quick --cases= --scenes column --growth cells --bases gimp,bspline2"
    figures = run("benchmark", *options.split(), "--output", str(tmp_path))
    errors = {(r["basis"], r["stabilisation"], r["level"]): r["error"] for r in figures["runs"]}
    assert len(errors) == 12
    # the same as the study of the column says
    assert errors["gimp", "none", 16] == pytest.approx(3.65891e-3, rel=1e-4)
    assert errors["bspline2", "ghost", 16] < errors["gimp", "ghost", 16]
    for r in figures["runs"]:
        assert r["stages"]["solve"] > 0
    cells = figures["growth"]["cells, implicit"]["rows"]
    assert [c["unknowns"] for c in cells] == [cells[0]["unknowns"]] * 3
    assert cells[2]["cells"] > 15 * cells[0]["cells"]
    for name in ("precision", "stages", "growth"):
        assert (tmp_path / f"benchmark_{name}.png").stat().st_size > 0


@pytest.mark.long
def test_skip_table():
    options = "--cells 6 --steps 2 --calls --only F-bar,yielding,tangent"
    found = run("skip_table", *options.split())
    rows = {row["feature"]: row for row in found["rows"]}
    assert found["unit"] == "calls"
    for row in rows.values():
        assert row["off_calls"] == 0
    assert rows["F-bar"]["on"] > 0
    assert rows["tangent"]["on"] > 0


def test_manufactured_solution(tmp_path):
    options = "--basis", "gimp", "--cells", "4,8", "--cuts", "0.001", "--output", str(tmp_path)
    figures = run("manufactured_solution", *options)
    assert len(figures["runs"]) == 4
    assert {r["scene"] for r in figures["runs"]} == {"full cells", "cut cells, first 0.001 h"}
    for r in figures["runs"]:
        assert 0 < r["displacement_absolute"] < r["displacement"] < 0.05
        assert r["steps"] >= 5
    for name in ("manufactured_solution.png", "manufactured_solution.csv"):
        assert (tmp_path / name).stat().st_size > 0


def test_manufactured_solution_otherwise():
    options = "--scene full --cells 4,8 --nu 0.1 --law hencky --steps 4 --points-per-cell 2"
    figures = run("manufactured_solution", "--no-plot", *options.split())
    assert {r["basis"] for r in figures["runs"]} == {"linear", "gimp", "bspline2", "bspline3"}
    assert all(r["displacement"] < 0.15 for r in figures["runs"])


def test_new_stabilisation(tmp_path):
    options = "--offsets", "3", "--cells", "4,8", "--output", str(tmp_path)
    figures = run("new_stabilisation", *options)
    table = {row["stabilisation"]: row for row in figures["table"]}
    assert table["none"]["kappa_K"] > 1e10
    for stabilisation in table.keys() - {"none"}:
        assert table[stabilisation]["kappa_K"] < 1e4
        assert table[stabilisation]["kappa_M"] < 1e4
        assert table[stabilisation]["errors"][1] < 0.01
    assert table["derivative jumps"]["own"]
    assert not table["ghost"]["own"]
    for name in ("new_stabilisation_gimp.png", "new_stabilisation_gimp.csv"):
        assert (tmp_path / name).stat().st_size > 0


def test_thick_cylinder(tmp_path):
    options = "--h 0.025 --points-per-cell 2 --basis gimp --stabilisation ghost --steps 8"
    figures = run("thick_cylinder", *options.split(), "--output", str(tmp_path))
    assert figures["limit_load_error"] == pytest.approx(0.0, abs=0.01)
    assert len(figures["pressure"]) == len(figures["last_residuals"]) + 1 == 9
    assert figures["fbar"] == "off"
    assert (tmp_path / "thick_cylinder.png").stat().st_size > 0


def test_elastoplastic_collapse(tmp_path):
    options = "--h 1 --points-per-cell 3 --steps 20 --basis bspline2 --stabilisation ghost"
    figures = run("elastoplastic_collapse", *options.split(), "--output", str(tmp_path))
    assert figures["runout"] == pytest.approx(5.9, abs=0.6)
    assert figures["max_newton_iterations"] <= 10
    assert abs(figures["energy_gap"]) < 0.02
    assert len(figures["last_ratios"]) == 20
    assert (tmp_path / "elastoplastic_collapse.png").stat().st_size > 0


@pytest.mark.parametrize("ranks", [1, pytest.param(2, marks=pytest.mark.long)])
def test_slope_failure(tmp_path, ranks):
    options = "--h", "1", "--ghost", "on", "--output", str(tmp_path)
    figures = run("slope_failure", *options, ranks=ranks)
    assert figures["completed"]
    assert figures["reason"] == ""
    assert (figures["steps_done"], figures["steps"], figures["points"]) == (40, 40, 414)
    assert figures["runout"] == pytest.approx(3.135, abs=0.02)
    assert figures["newton_iterations"] > 100
    assert (tmp_path / "slope_failure.png").stat().st_size > 0


def test_slope_failure_without_a_stabilisation_is_reported_as_it_is():
    figures = run("slope_failure", "--no-plot", "--ghost", "off")
    # whether it comes to the end hangs on rounding; that it says so does not
    completed = figures["completed"]
    assert 0 < figures["steps_done"] <= 40
    assert completed == (figures["steps_done"] == 40) == (figures["gravity_reached"] == 1)
    assert figures["reason"].startswith("" if completed else "ConvergenceError: step ")
    assert completed == (figures["reason"] == "")


def test_slope_failure_of_tresca():
    figures = run("slope_failure", "--no-plot", "--law", "tresca", "--stabilisation", "aggregation")
    assert figures["completed"]
    assert figures["runout"] > 2


@pytest.mark.long
def test_slope_failure_table(tmp_path):
    options = "--table --h 1,0.5 --points-per-cell 2,3"
    figures = run("slope_failure", *options.split(), "--output", str(tmp_path))
    assert figures["all_stabilised_completed"]
    assert len(figures["runs"]) == 12
    bare = [r for r in figures["runs"] if r["stabilisation"] == "none"]
    assert not all(r["completed"] for r in bare)
    assert all(bool(r["reason"]) != r["completed"] for r in figures["runs"])
    with (tmp_path / "slope_failure_table.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [r["stabilisation"] for r in rows[:3]] == ["none", "ghost", "aggregation"]
    assert (tmp_path / "slope_failure_table.png").stat().st_size > 0


@pytest.mark.parametrize("ranks", [1, pytest.param(2, marks=pytest.mark.long)])
def test_footing(tmp_path, ranks):
    options = "--h 1 --points-per-cell 2 --steps 10 --basis bspline2"
    figures = run("footing", *options.split(), "--output", str(tmp_path), ranks=ranks)
    assert figures["completed"]
    assert figures["load"] == pytest.approx(90e3)
    assert figures["deviation_centre"] == pytest.approx(0.0, abs=0.05)
    assert figures["settlement_centre"] > figures["settlement_mean"] > figures["settlement_edge"]
    assert len(figures["last_ratios"]) == 20 + 10
    assert figures["ranks"] == ranks
    with (tmp_path / "footing.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 11
    assert float(rows[-1]["centre"]) == pytest.approx(figures["settlement_centre"])
    assert (tmp_path / "footing_cam-clay.png").stat().st_size > 0


def test_footing_otherwise():
    options = "--law tresca --strain small --basis gimp --h 1 --points-per-cell 2 --steps 20"
    figures = run("footing", "--no-plot", *options.split())
    assert figures["completed"]
    assert (figures["fbar"], figures["rough"]) == ("on", "on")
    assert figures["deviation_centre"] == pytest.approx(0.0, abs=0.3)


@pytest.mark.long
def test_footing_compared(tmp_path):
    options = "--law tresca-perfect --compare --h 0.2 --steps 15"
    runs = run("footing", *options.split(), "--output", str(tmp_path))["runs"]
    errors = {(r["h"], r["fbar"]): r["bearing_error"] for r in runs}
    assert len(errors) == 6
    assert 0 < errors[0.2, "on"] < errors[0.4, "on"] < errors[0.8, "on"] < 0.12
    for h in (0.2, 0.4, 0.8):
        assert errors[h, "off"] > 3 * errors[h, "on"]
    for name in ("footing_tresca-perfect_compared.png", "footing_tresca-perfect_compared.csv"):
        assert (tmp_path / name).stat().st_size > 0


def unknowns_of_a_block(layers):
    """Of linear functions on so many layers of cells in each direction, on rollers, not below."""
    m = layers
    return 2 * m * (m + 1) * m + (m + 1) ** 2 * m


def test_solid_3d_by_factors(tmp_path):
    options = ["--cells", "6,8", "--cuts", "0.5", "--steps", "1"]
    small, large = run("solid_3d", *options, "--output", str(tmp_path))["runs"]
    direct = run("solid_3d", "--no-plot", *options, "--solver", "direct")["runs"]
    for n, found, other in zip((6, 8), (small, large), direct):
        # the upper and outer faces are in a layer of cells of their own
        assert found["unknowns"] == other["unknowns"] == unknowns_of_a_block(n + 1)
        assert found["points"] == (2 * n + 1) ** 3
        assert found["newton_iterations"] == other["newton_iterations"] == [3]
        assert other["linear_iterations"] == []
        assert found["settlement"] == pytest.approx(other["settlement"], rel=1e-8)
        # that of a block free to widen at its base, E = 1 MPa and 10 kN/m³
        free = 10e3 * (1 + 0.5 / n) ** 2 / 2e6
        assert 0.85 * free < found["settlement"] < free
    assert small["linear_iterations"] == []
    # preconditioned with factors that may be those of the tangent before
    assert len(large["linear_iterations"]) == 3
    assert 1 <= max(large["linear_iterations"]) <= 6
    assert (tmp_path / "solid_3d_block.png").stat().st_size > 0


@pytest.mark.parametrize(
    ("scene", "cells"), [pytest.param("solid", "14", marks=pytest.mark.long), ("sand", "45")]
)
def test_runs_repeat_to_the_last_bit(scene, cells):
    """In one process and in another, with multigrid, and with incomplete factors or LU."""
    options = "--cells", cells, "--count", "1", "--within", "2", "--steps", "2", "--busy"
    found = run("repeat", "--scene", scene, *options)
    assert found["results"] == 1
    assert len(found["runs"]) == 3
    assert max(found["runs"][0]["linear_iterations"]) > 1
    # the solver had to choose
    assert found["runs"][0]["unknowns"] >= {"solid": 9000, "sand": 4000}[scene]


@pytest.mark.long
@pytest.mark.parametrize(("stabilisation", "cells"), [("ghost", 13), ("aggregation", 14)])
def test_solid_3d_by_multigrid(stabilisation, cells):
    # both cuts make the same cells active, or the same nodes follow others
    options = f"--cells {cells} --cuts 1e-6,0.3 --steps 1 --stabilisation {stabilisation}"
    tiny, large = run("solid_3d", "--no-plot", *options.split())["runs"]
    direct = run("solid_3d", "--no-plot", *options.split(), "--solver", "direct")["runs"]
    for found, other in zip((tiny, large), direct):
        assert found["unknowns"] == other["unknowns"] == unknowns_of_a_block(14)
        assert found["method"].startswith("CG with multigrid of the lattice: 9030 unknowns")
        assert found["newton_iterations"] == other["newton_iterations"]
        assert len(found["linear_iterations"]) == sum(found["newton_iterations"])
        assert 1 <= min(found["linear_iterations"]) <= max(found["linear_iterations"]) <= 10
        assert other["linear_iterations"] == []
        assert found["settlement"] == pytest.approx(other["settlement"], rel=1e-8)
    most = [max(found["linear_iterations"]) for found in (tiny, large)]
    assert abs(most[0] - most[1]) <= 2


@pytest.mark.long
def test_solid_3d_of_a_slope(tmp_path):
    options = ["--scene", "slope", "--cells", "9", "--steps", "4"]
    (found,) = run("solid_3d", *options, "--output", str(tmp_path))["runs"]
    (other,) = run("solid_3d", "--no-plot", *options, "--solver", "direct")["runs"]
    assert found["unknowns"] == other["unknowns"] == 2532
    assert found["yielding"] == pytest.approx(other["yielding"], abs=5)
    assert found["yielding"] > 0.2 * found["points"]
    assert found["halvings"] == other["halvings"] == 0
    # plastic tangents are not symmetric, and change more than elastic ones
    assert found["method"].startswith("GMRES with incomplete LU")
    assert len(found["linear_iterations"]) == sum(found["newton_iterations"])
    assert sum(found["newton_iterations"]) <= sum(other["newton_iterations"]) + 2
    assert 1 < max(found["linear_iterations"]) <= 30
    assert other["linear_iterations"] == []
    assert found["settlement"] == pytest.approx(other["settlement"], rel=1e-7)
    assert (tmp_path / "solid_3d_slope.png").stat().st_size > 0


def test_your_own_law(tmp_path):
    figures = run("your_own_law", "--h", "0.5", "--steps", "10", "--output", str(tmp_path))
    assert figures["law_lines"] < 60
    laws = figures["laws"]
    assert laws["Swift"]["tangent_error"] < 1e-7
    assert laws["sand"]["tangent_error"] < 1e-5
    assert all(law["plastic"] > 0.1 for law in laws.values())
    # what hardens spreads less
    assert laws["Swift"]["runout"] < laws["perfect"]["runout"] - 0.2
    assert (tmp_path / "your_own_law.png").stat().st_size > 0


def test_footing_with_halved_cells():
    options = "--law tresca-perfect --h 0.5 --coarsest 0.5 --refine 0.125 --growth 0.2 --steps 8"
    figures = run("footing", "--no-plot", *options.split())
    assert figures["completed"]
    assert figures["unknowns"] < 2400  # of a grid of 0.25 m
    # cells of 0.25 m miss by 3.9 %
    assert 0 < figures["bearing_error"] < 0.027


def test_slope_failure_with_leaves_that_follow_the_band(tmp_path):
    figures = run("slope_failure", "--refine", "yield", "--output", str(tmp_path))
    assert figures["completed"]
    # on a grid of half the size it is 3.86 m
    assert figures["runout"] == pytest.approx(3.88, abs=0.1)
    assert figures["split"] > 300
    assert (tmp_path / "slope_failure.png").stat().st_size > 0
