"""Rows of `benchmarks.py` on time, memory and the balance of ranks."""

from __future__ import annotations

from collections.abc import Callable

from benchmark_rows import ALONE, Answer, Row, each, keys


def ratio(name: str) -> Callable[[Answer, Answer], list[float]]:
    """Reads a figure from two answers, and the first over the second."""
    return lambda one, other: [one[name], other[name], one[name] / other[name]]


def cases(key: str, *names: str) -> Callable[[Answer], list[float]]:
    """Reads a figure of several cases of `benchmark.py`."""
    return lambda answer: [answer["cases"][name][key] for name in names]


def pace(basis: str) -> Callable[..., list[float]]:
    """Reads the best million points per second of all laws from every answer in turn."""
    return lambda *answers: [
        case["best"] for answer in answers for name, case in answer["cases"].items()
        if f" {basis} " in name
    ]  # fmt: skip


def exponents(*names: str) -> Callable[[Answer], list[float]]:
    """Reads fitted exponents of series of `benchmark.py`."""
    return lambda answer: [answer["growth"][name]["exponent"] for name in names]


def least_error(answer: Answer) -> list[float]:
    """Least error of each scene of `benchmark.py` among runs of no more than 2 s."""
    errors: dict[str, list[float]] = {}
    for run in answer["runs"]:
        if run["error"] is not None and run["seconds"] <= 2.0:
            errors.setdefault(run["scene"], []).append(run["error"])
    return [100 * min(values) for values in errors.values()]


def peer_ratios(answer: Answer) -> list[float]:
    """Speed relative to Kratos: steps of the columns, and the whole process of the small column."""
    large, small = (answer["peer_cases"][case]["ratios"] for case in ("16x256", "1x64"))
    return [large["gimp"], large["linear"], small["gimp"], small["gimp, whole"]]


def skipped(answer: Answer) -> list[float]:
    """Largest cost of features that are off (%), and calls of their functions."""
    rows = [row for row in answer["rows"] if row["off"] is not None and row["stubbed"]]
    return [100 * max(abs(row["off"]) for row in rows), sum(row["off_calls"] for row in rows)]


def parts(*answers: Answer) -> list[float]:
    """Time per point and Newton iteration (µs) without the linear solver, `benchmark_growth.py`."""
    rows = [row for answer in answers for row in answer["rows"]]
    return [
        1e6 * (row["seconds_processor"] - row["stages"]["solve"]) * row["steps"]
        / (row["points"] * row["iterations"]) for row in rows
    ]  # fmt: skip


def umats(*answers: Answer) -> list[float]:
    """Million points per second: UMAT alone, flux and tangent, explicit steps; built-in law."""
    names = "umat, call", "umat, flux and tangent", "umat, explicit steps"
    others = "built-in, flux and tangent", "built-in, explicit steps"
    return [1e-6 * answer[name] for answer in answers for name in names + others]


def room(*names: str) -> Callable[[Answer], list[float]]:
    """Reads the time of a step on the largest grid over the time on the smallest grid."""
    return lambda answer: [answer["growth"][name]["ratio"] for name in names]


def solids(answer: Answer) -> list[float]:
    """Unknowns, seconds of the first and of later steps, and most iterations, for each run."""
    names = "unknowns", "seconds_first", "seconds_later"
    return [
        figure for run in answer["runs"]
        for figure in (*(run[name] for name in names), max(run["linear_iterations"]))
    ]  # fmt: skip


def one_solid(answer: Answer) -> list[float]:
    """Points, unknowns, seconds per step, halved steps and GB of one run."""
    (run,) = answer["runs"]
    names = "points", "unknowns", "seconds_a_step", "halvings"
    return [*(run[name] for name in names), run["megabytes"] / 1024]


def large_solid(answer: Answer) -> list[float]:
    """Points, unknowns, seconds of the first and of later steps, and GB of one run."""
    (run,) = answer["runs"]
    names = "points", "unknowns", "seconds_first", "seconds_later"
    return [*(run[name] for name in names), run["megabytes"] / 1024]


SPEED, RANKS = "Time and memory", (2, 3, 8)
TIMES = each("benchmark", ALONE)


def launched(*studies: str) -> tuple[str, ...]:
    """Each study on every number of `RANKS`."""
    return tuple(f"mpirun -n {n} python3 demos/studies/{one}" for one in studies for n in RANKS)


ROWS = (
    Row("time-small", SPEED, "column, 64 elements, 256 points, 40 steps, GIMP (s)", TIMES,
        cases("seconds", "gimp 1x64"), "{:.2f}"),
    Row("time-large", SPEED, "column, 16 × 256 elements, 16 384 points, 40 steps: GIMP, standard "
        "MPM (s)", TIMES, cases("seconds", "gimp 16x256", "linear 16x256"), "{:.1f}, {:.1f}"),
    Row("time-point", SPEED, "the same, per point and Newton iteration: GIMP, standard MPM (µs)",
        TIMES,
        cases("microseconds_per_point_and_iteration", "gimp 16x256", "linear 16x256"),
        "{:.1f}, {:.1f}"),
    Row("kratos", SPEED, "speed relative to Kratos MPM 10.4 (neo-Hookean, standard MPM), both in "
        "turn: 16 × 256 elements, GIMP, standard MPM; 64 elements, steps, whole process (GIMP)",
        each("benchmark", f"{ALONE} --peers"), peer_ratios, "{:.1f}, {:.1f}; {:.1f}, {:.1f}"),
    Row("memory", SPEED, "memory beyond a small run, 16 384 points, GIMP (kB per point)", TIMES,
        lambda a: [1e-3 * a["cases"]["gimp 16x256"]["bytes_per_point"]], "{:.1f}"),
    Row("time-laws", SPEED, "laws with their tangents, million points per second, all yielding: "
        "von Mises, Tresca, Mohr–Coulomb, Drucker–Prager, Cam-Clay",
        each("benchmark", f"--cases= {ALONE} --laws"), lambda a: a["laws"].values(),
        "{:.0f}, {:.0f}, {:.0f}, {:.0f}, {:.1f}"),
    Row("time-plastic", SPEED, "implicit Mohr–Coulomb without dilation, 30 720 points, per point "
        "and Newton iteration (µs of processor time): GIMP, linear functions, quadratic splines in "
        "Newmark steps; in quasi-static steps",
        each("benchmark", f"--cases= {ALONE} --plastic 80 --bases gimp,linear,bspline2"),
        lambda a: [a["plastic"][f"{basis} {kind}"]["microseconds_per_point_and_iteration"]
                   for kind in ("newmark", "static") for basis in ("gimp", "linear", "bspline2")],
        "{:.1f}, {:.1f}, {:.1f}; {:.1f}, {:.1f}, {:.1f}"),
    Row("time-facets", SPEED, "ghost penalty, assembly per facet in 2D: linear functions, GIMP, "
        "quadratic, cubic splines (µs)",
        each("benchmark", f"--cases= {ALONE} --facets --bases linear,gimp,bspline2,bspline3"),
        lambda a: a["facets"].values(), "{:.1f}, {:.1f}, {:.1f}, {:.1f}"),
    Row("explicit", SPEED, "explicit steps, quadratic splines, 99 856 points, all points strain "
        "and yield, million points per second: neo-Hookean, Hencky, von Mises, Mohr–Coulomb",
        each("explicit_speed", "--repeat 3"), pace("bspline2"), "{:.1f}, {:.1f}, {:.1f}, {:.1f}"),
    Row("explicit-gimp", SPEED, "the same, GIMP", each("explicit_speed", "--bases gimp --repeat 3"),
        pace("gimp"), "{:.1f}, {:.1f}, {:.1f}, {:.1f}"),
    Row("explicit-rings", SPEED, "the same, GIMP, axisymmetric: neo-Hookean, Mohr–Coulomb",
        each("explicit_speed", "--bases gimp --laws neo-hookean,mohr-coulomb --axisymmetric"),
        pace("gimp"), "{:.1f}, {:.1f}"),
    Row("explicit-3d", SPEED, "the same in 3D, quadratic splines, 97 336 points: neo-Hookean, "
        "Mohr–Coulomb", each("explicit_speed", "--dimension 3 --laws neo-hookean,mohr-coulomb"),
        pace("bspline2"), "{:.1f}, {:.1f}"),
    Row("umat", SPEED, "von Mises as a UMAT with Jaumann's rate, all points yield, million points "
        "per second of processor time, in 2D and in 3D: the UMAT alone, flux and tangent, explicit "
        "steps (quadratic splines); the built-in law: flux and tangent, explicit steps",
        tuple(f"demos/studies/umat_speed.py --dimension {d}" for d in (2, 3)), umats,
        "{:.1f}, {:.1f}, {:.1f}; {:.1f}, {:.1f} (2D); {:.1f}, {:.1f}, {:.1f}; {:.1f}, {:.1f} (3D)"),
    Row("explicit-ranks", SPEED, "the same with 399 424 points in 2D, neo-Hookean, Mohr–Coulomb: "
        "one rank; two ranks",
        tuple(f"{launch}demos/studies/explicit_speed.py --laws neo-hookean,mohr-coulomb "
              "--points 400000 --steps 50" for launch in ("", "mpirun -n 2 python3 ")),
        pace("bspline2"), "{:.1f}, {:.1f}; {:.1f}, {:.1f}"),
    Row("direct-ranks", SPEED, "40 implicit steps with Cholesky factors, column of 65 536 points, "
        "GIMP (s): one rank; two ranks; ratio",
        tuple(f"{launch}demos/studies/column_compaction.py --columns 64 --elements 256"
              for launch in ("", "mpirun -n 2 python3 ")), ratio("seconds_solve"),
        "{:.1f}; {:.1f}; {:.2f}"),
    Row("precision", SPEED, "least errors within 2 s: column, cantilever, footing, collapse, "
        "vortex (%)", each("benchmark", "--cases= --growth= --refinements 3 --densities 1 "
        "--repeat 1 --peers"), least_error, "{:.2g}, {:.2g}, {:.2g}, {:.2g}, {:.2g}",
        picture="benchmark_precision.png"),
    Row("growth", SPEED, "exponents of the processor time per step over the number of points in "
        "2D: explicit, implicit",
        each("benchmark", "--cases= --scenes= --growth points"),
        exponents("points, explicit", "points, implicit"), "{:.2f}, {:.2f}", "1, 1"),
    Row("growth-solid", SPEED, "the same over the number of unknowns of a cube, multigrid: linear "
        "functions, GIMP",
        each("benchmark", "--cases= --scenes= --growth unknowns"),
        exponents("unknowns, solid", "unknowns, solid-gimp"), "{:.2f}, {:.2f}", "1, 1"),
    Row("cells", SPEED, "time of a step on a grid 16 times as large as necessary, 40 000 points, "
        "over the time on the smallest grid: explicit, implicit, implicit with aggregation",
        each("benchmark", "--cases= --scenes= --growth cells"),
        room("cells, explicit", "cells, implicit", "cells, aggregated"),
        "{:.3f}, {:.3f}, {:.3f}", "1"),
    Row("square", SPEED, "elastic square, GIMP, 16 384 points, one implicit step (s of processor "
        "time)", each("benchmark_growth", "--case implicit --points 16384 --calls 15"),
        lambda answer: [answer["rows"][0]["seconds_processor"]], "{:.3f}"),
    Row("parts", SPEED, "implicit elastic steps, per point and Newton iteration without the linear "
        "solver (µs of processor time): 400 000 points in 2D, GIMP; 373 000 points in 3D, "
        "linear functions",
        each("benchmark_growth", "--case implicit --points 400000",
             "--case solid --points 373248"), parts, "{:.2f}, {:.2f}"),
    Row("solid", SPEED, "elastic cube, linear functions, ghost penalty, CG with multigrid, five "
        "steps: unknowns, seconds of the first step, median of later steps, most iterations of a "
        "solution", each("solid_3d", "--cells 20,28,36 --steps 5"), solids,
        "; ".join(3 * ["{:.0f}, {:.1f}, {:.1f}, {:.0f}"])),
    Row("repeat", SPEED, "repeated runs on one rank of a busy machine, 50 processes and 5 runs in "
        "one process: unknowns, number of different results: elastic block in 3D; Mohr–Coulomb "
        "block in 2D",
        each("repeat", *(f"--scene {s} --count 50 --within 5 --busy" for s in ("solid", "sand"))),
        lambda *answers: [f for a in answers for f in (a["runs"][0]["unknowns"], a["results"])],
        "{:.0f}, {:.0f}; {:.0f}, {:.0f}", "the same bits: 1"),
    Row("solid-ranks", SPEED, "elastic cube with multigrid, 76 560 unknowns, per step after "
        "the first (s): one rank; two ranks; ratio",
        tuple(f"{launch}demos/studies/solid_3d.py --cells 28 --steps 4"
              for launch in ("", "mpirun -n 2 python3 ")),
        lambda one, two: ratio("seconds_later")(one["runs"][0], two["runs"][0]),
        "{:.1f}; {:.1f}; {:.2f}"),
    Row("solid-slope", SPEED, "slope of Mohr–Coulomb soil in 3D until the toe yields, ten steps: "
        "points, unknowns, seconds per step, halved steps, memory (GB)",
        each("solid_3d", "--scene slope --cells 34"), one_solid,
        "{:.0f}, {:.0f}, {:.0f}, {:.0f}, {:.1f}"),
    Row("solid-million", SPEED, "elastic cube of a million points, three steps on two ranks: "
        "points, unknowns, seconds of the first step, of a later one, memory (GB)",
        ("mpirun -n 2 python3 demos/studies/solid_3d.py --cells 50 --steps 3",),
        large_solid, "{:.0f}, {:.0f}, {:.0f}, {:.0f}, {:.1f}"),
    Row("balance", SPEED, "largest ratio of a rank's points or unknowns to the mean, over all "
        "steps, on 2, 3 and 8 ranks: column, slope, collapse",
        launched("column_compaction.py --columns 16", "slope_failure.py --h 0.5",
                 "column_collapse.py --integrator implicit --h 0.01 --dt 4e-3 --duration 0.3"),
        keys("imbalance"), "; ".join(3 * ["{:.2f}, {:.2f}, {:.2f}"]), "1"),
    Row("skip", SPEED, "largest share of a step's instructions that optional features take when "
        "they are off (%); calls of their functions", each("skip_table", ""), skipped,
        "{:.3f}, {:.0f}", "0.1, 0"),
    Row("time-start", SPEED, "start to first step, everything compiled before (s)",
        each("column_compaction", ""), keys("seconds_setup"), "{:.1f}"),
    Row("time-process", SPEED, "column of 256 points, 40 steps, the whole process, everything "
        "compiled before (s)", each("column_compaction", "--elements 64"),
        keys("seconds_whole"), "{:.1f}"),
    Row("time-first", SPEED, "the whole first run with all compilation (s)",
        each("column_compaction", ""), keys("seconds_whole"), "{:.0f}", fresh=True),
)  # fmt: skip
