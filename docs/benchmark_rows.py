"""Rows of `benchmarks.py`: one row per claim, with its commands and a reader of their JSON."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

Answer = dict[str, Any]


@dataclass(frozen=True)
class Row:
    """A claim, and the commands that measure it.

    Attributes:
        name: Name on the command line.
        part: Heading of the table with this row.
        claim: The measured quantity, in words.
        commands: Studies with their options; `--no-plot --json -` is added.
        read: Function that returns the figures from the JSON of the studies, one argument per
            command.
        shown: Format of the figures.
        reference: Figures to compare with, and their source.
        quick: Whether the row takes only seconds and does not measure time.
        fresh: Whether everything must be compiled again.
        picture: Name of a picture of the study to keep next to this file.
    """

    name: str
    part: str
    claim: str
    commands: tuple[str, ...]
    read: Callable[..., Iterable[float]]
    shown: str
    reference: str = ""
    quick: bool = False
    fresh: bool = False
    picture: str = ""


def keys(*names: str) -> Callable[..., list[float]]:
    """Reads figures by name from every answer in turn."""
    return lambda *answers: [answer[name] for answer in answers for name in names]


def each(study: str, *options: str) -> tuple[str, ...]:
    """One command per set of options."""
    return tuple(f"demos/studies/{study}.py {option}".strip() for option in options)


def spread(*answers: Answer) -> list[float]:
    """Worst over best condition number of the stiffness in every sweep."""
    kappa = [[place["kappa_K"] for place in answer["places"]] for answer in answers]
    return [max(values) / min(values) for values in kappa]


def worst(*names: str) -> Callable[..., list[float]]:
    """Reads the worst figures of every sweep."""
    return lambda *answers: [answer["worst"][name] for answer in answers for name in names]


def orders(*scenes: str) -> Callable[..., list[float]]:
    """Reads overall orders of displacement and stress."""
    return lambda answer: [
        next(o for name, o in answer["overall"].items() if name.startswith(scene))[key]
        for scene in scenes
        for key in ("displacement", "stress")
    ]


def displacement_orders(*answers: Answer) -> list[float]:
    """Overall orders of displacement in all scenes of every answer."""
    return [order["displacement"] for answer in answers for order in answer["overall"].values()]


def column_errors(basis: str, stabilisation: str) -> Callable[[Answer], list[float]]:
    """Reads the errors of the column with one basis and one stabilisation."""
    return lambda answer: [
        run["error"]
        for run in answer["runs"]
        if (run["basis"], run["stabilisation"]) == (basis, stabilisation)
    ]


def kappa_of(*stabilisations: str) -> Callable[[Answer], list[float]]:
    """Reads κ(K) of some stabilisations from `new_stabilisation.py`."""
    return lambda answer: [
        next(row["kappa_K"] for row in answer["table"] if row["stabilisation"] == stabilisation)
        for stabilisation in stabilisations
    ]


def finished(answer: Answer) -> list[float]:
    """Number of finished slopes: ghost penalty, aggregation, no stabilisation."""
    return [
        sum(run["completed"] for run in answer["runs"] if run["stabilisation"] == name)
        for name in ("ghost", "aggregation", "none")
    ]


def settlements(answer: Answer) -> list[float]:
    """Settlement in the centre (m) with three bases, each without and with F-bar."""
    found = {(run["basis"], run["fbar"]): run["settlement_centre"] for run in answer["runs"]}
    return [found[b, f] for b in ("linear", "gimp", "bspline2") for f in ("off", "on")]


def beam(depth: int) -> Callable[[Answer], list[float]]:
    """Reads relative deflections of a cantilever of a given depth in cells, for six penalties."""

    def read(answer: Answer) -> list[float]:
        found = next(one for one in answer["beams"] if one["depth"] == depth)
        return [*found["share"][1:5], found["default_by_hundredth"], found["adaptive"]]

    return read


def local_constants(answer: Answer) -> list[float]:
    """Local constants for γ = E/30, γ = M/30, the default and the adaptive γ, ν = 0 and 0.49."""
    found = {row["nu"]: row for row in answer["constants"]}
    ends = found[0.0], found[0.49]
    return [
        *(row["by_E"][0] for row in ends),
        *(row["by_M"][0] for row in ends),
        *(row["by_law"] for row in ends),
        *(row["adaptive"] for row in ends),
    ]


def of_impacts(*answers: Answer) -> list[float]:
    """For every impact: energy at its end, and largest energy in between (%)."""
    return [answer[key] for answer in answers for key in ("kept", "most")]


def of_friction(*answers: Answer) -> list[float]:
    """For every impact: energy that friction took, and energy that the integrator lost (%)."""
    return [answer["losses"][name] for answer in answers for name in ("friction", "integrator")]


def linear_iterations(*answers: Answer) -> list[float]:
    """Most linear iterations of a solution at the worst cut and at the best cut, per answer."""
    figures = []
    for answer in answers:
        most = [max(run["linear_iterations"]) for run in answer["runs"]]
        figures += [max(most), min(most)]
    return figures


COLUMN, BEAM, ORDER = "The compacting column", "Elasticity", "A manufactured solution"
CUTS, PLASTIC, FOOTING = "Small cuts", "Plasticity", "Footings"
MOTION, ENERGY = "Motion", "Conservation of energy"
SIZES = tuple(f"--elements {n}" for n in (4, 16, 64, 256))
TWO_D = "--dimension 2 --offsets 200"
ALONE = "--scenes= --growth="

ROWS = (
    Row("column-gimp", COLUMN, "error of the stress, GIMP, 2² points, 4, 16, 64, 256 elements",
        each("column_compaction", *SIZES), keys("error"), "{:.5e}, {:.5e}, {:.5e}, {:.5e}",
        "AMPLE: 4.13333e-2, 3.65891e-3, 4.35724e-4, 1.02910e-4", quick=True),
    Row("column-linear", COLUMN, "the same, standard MPM",
        each("column_compaction", *(f"--basis linear {n}" for n in SIZES)), keys("error"),
        "{:.5e}, {:.5e}, {:.5e}, {:.5e}",
        "AMPLE: 6.32522e-2, 8.66965e-2, 8.28870e-2, 8.94597e-2", quick=True),
    Row("column-3d", COLUMN, "the same in 3D, GIMP, 16 elements",
        each("column_compaction", "--dimension 3 --elements 16"), keys("error"), "{:.5e}",
        "2D: 3.65891e-3", quick=True),
    Row("column-newton", COLUMN, "Newton iterations per step to 1e-9, GIMP, 64 elements",
        each("column_compaction", "--elements 64"), keys("max_newton_iterations"),
        "at most {:.0f}", quick=True),
    Row("column-ghost", COLUMN, "error with ghost penalty, scaled; literal, 64 elements",
        each("column_compaction", "--ghost scaled", "--ghost literal"), keys("error"),
        "{:.3e}, {:.3e}", "without: 4.357e-4", quick=True),
    Row("column-splines", COLUMN, "error, quadratic splines, ghost penalty, 8, 16, 32 elements",
        each("compaction_compared",
             "--elements 8,16,32 --bases gimp,bspline2 --stabilisations none,ghost,aggregation"),
        column_errors("bspline2", "ghost"), "{:.2e}, {:.2e}, {:.1e}",
        "GIMP with ghost penalty: 1.13e-2, 3.15e-3, 9.7e-4", quick=True),
    Row("column-splines-aggregation", COLUMN, "the same with aggregation",
        each("compaction_compared",
             "--elements 8,16,32 --bases gimp,bspline2 --stabilisations none,ghost,aggregation"),
        column_errors("bspline2", "aggregation"), "{:.2e}, {:.1e}, {:.1e}", quick=True),
    Row("cantilever", BEAM, "cantilever at PL²/EI = 10, h = 0.25 m: u/L, v/L",
        each("cantilever", ""), lambda a: [a["u_L"][-1], a["v_L"][-1]], "{:.4f}, {:.4f}",
        "elastica 0.5550, 0.8106; conforming Q2 elements 0.5534, 0.8264", quick=True),
    Row("cantilever-fine", BEAM, "the same, h = 0.125 m",
        each("cantilever", "--h 0.125"), lambda a: [a["u_L"][-1], a["v_L"][-1]],
        "{:.4f}, {:.4f}", "the same"),
    Row("disc", BEAM, "growing disc, energy in UFL: error of displacement; worst κ(K) with and "
        "without the study's own penalty", each("hyperelastic_in_ufl", ""),
        keys("displacement_error", "condition_number", "bare_condition_number"),
        "{:.1e}; {:.1e}, {:.0e}", "exact solution by Ritz's method"),
    Row("orders-gimp", ORDER, "overall orders of displacement and stress, GIMP, 4² points, 8 to 64 "
        "cells: full cells; cut cells, first 0.001 of a cell; cut cells, first 0.37 of a cell",
        each("manufactured_solution", "--basis gimp"),
        orders("full", "cut cells, first 0.001", "cut cells, first 0.37"),
        "{:.2f}, {:.2f}; {:.2f}, {:.2f}; {:.2f}, {:.2f}", "linear finite elements: 2, 1"),
    Row("orders-one-step", ORDER, "the same in one step, full cells",
        each("manufactured_solution", "--basis gimp --steps 1 --scene full"), orders("full"),
        "{:.2f}, {:.2f}", "2, 1"),
    Row("orders-splines", ORDER, "overall orders of displacement in the same three scenes: "
        "quadratic splines; cubic",
        each("manufactured_solution", "--basis bspline2", "--basis bspline3"),
        displacement_orders, "{:.2f}, {:.2f}, {:.2f}; {:.2f}, {:.2f}, {:.2f}", "at least 1.9"),
    Row("cuts-none", CUTS, "bar pushed through a 1D grid, worst of 14 places, no stabilisation: "
        "κ(K), κ(M), Δt c/h", each("conditioning", "--stabilisation none"),
        worst("kappa_K", "kappa_M", "dt_consistent"), "{:.1e}, {:.1e}, {:.1e}",
        "exact: 3e12, 3e25, 2e-7", quick=True),
    Row("cuts-ghost", CUTS, "the same with ghost penalty", each("conditioning", ""),
        worst("kappa_K", "kappa_M", "dt_consistent"), "{:.1f}, {:.1f}, {:.3f}",
        "exact: 287, 37.2, 0.575; a bar without cut cells: 0.577", quick=True),
    Row("cuts-aggregation", CUTS, "the same with aggregation to full cells; and Δt c/h with lumped "
        "mass", each("conditioning", "--stabilisation aggregation"),
        worst("kappa_K", "kappa_M", "dt_consistent", "dt_lumped"),
        "{:.2f}, {:.2f}, {:.3f}, {:.3f}", "at most 9.5, 12.7; at least 0.50, 0.765", quick=True),
    Row("cuts-units", CUTS, "κ(K) at h = 0.01 m: ghost penalty scaled, literal",
        each("conditioning", "--spacing 0.01", "--spacing 0.01 --scaling literal"),
        worst("kappa_K"), "{:.1f}, {:.1e}", "287, 2.7e6", quick=True),
    *(
        Row(f"cuts-2d-{basis}", CUTS, f"block in 200 places of a 2D grid, worst over best κ(K), "
            f"{words}: {', '.join(stabilisations)}",
            each("conditioning",
                 *(f"{TWO_D} --basis {basis} --stabilisation {r}" for r in stabilisations)),
            spread, ", ".join(["{:.3g}"] * len(stabilisations)), "at most 20")
        for basis, words, stabilisations in (
            ("linear", "linear functions", ("ghost", "aggregation", "soft")),
            ("gimp", "GIMP", ("ghost", "aggregation", "weak-aggregation", "soft")),
            ("bspline2", "quadratic splines", ("ghost", "aggregation", "weak-aggregation", "soft")),
            ("bspline3", "cubic splines", ("ghost", "aggregation", "weak-aggregation", "soft")),
        )
    ),
    Row("cuts-own", CUTS, "block in 20 places of a 2D grid, worst κ(K): ghost penalty, "
        "aggregation, jumps of all derivatives in UFL", each("new_stabilisation", ""),
        kappa_of("ghost", "aggregation", "derivative jumps"), "{:.2g}, {:.2g}, {:.3g}",
        "without: singular"),
    Row("ghost-constant", CUTS, "local constant of a full and an empty cell, linear functions, "
        "ν = 0 and 0.49: γ = E/30; γ = M/30; by the law (default); adaptive",
        each("ghost_parameter", ""),
        local_constants, "{:.0f}, {:.0f}; {:.0f}, {:.0f}; {:.0f}, {:.0f}; {:.1f}, {:.1f}",
        "target of the adaptive γ: 30", quick=True),
    Row("ghost-yielding", CUTS, "the same, adaptive γ, tangents of yielding soil: largest factor "
        "between the constant and its target 30", each("ghost_parameter", ""),
        keys("worst_yielding"), "{:.2f}", "at most 2", quick=True),
    Row("ghost-beam", CUTS, "cantilever 4 cells deep, deflection relative to the deflection with a "
        "very small penalty: g = 1/90, 1/9, 1/3, 1; by the law (default), adaptive",
        each("ghost_parameter", ""), beam(4), "{:.3f}, {:.3f}, {:.3f}, {:.3f}; {:.3f}, {:.3f}",
        "an independent code: 0.996, 0.964, 0.902, 0.762", quick=True),
    Row("cuts-3d", CUTS, "elastic block in 3D, 20³ cells, cut at 1e-6, 0.001, 0.1, 0.5, 0.9 of a "
        "cell, CG with multigrid: most iterations of a solution at the worst cut, at the best cut: "
        "ghost penalty; aggregation",
        each("solid_3d", *(f"--cells 20 --cuts 1e-6,1e-3,.1,.5,.9 --stabilisation {stabilisation}"
                           for stabilisation in ("ghost", "aggregation"))),
        linear_iterations, "{:.0f}, {:.0f}; {:.0f}, {:.0f}", "the same at all cuts"),
    Row("cuts-random", CUTS, "the same for 30 random draws of cut (1e-6 to 1 of a cell), cells (14 "
        "to 22) and ν (up to 0.45): most iterations of a solution at the worst draw, at the best "
        "draw: linear functions, GIMP with ghost penalty; with aggregation",
        each("solid_3d", *(f"--cells 14,22 --random 30 --nu 0.45 --steps 1 --basis {basis} "
                           f"--stabilisation {stabilisation}"
                           for stabilisation in ("ghost", "aggregation")
                           for basis in ("linear", "gimp"))),
        linear_iterations, "{:.0f}, {:.0f}, {:.0f}, {:.0f}; {:.0f}, {:.0f}, {:.0f}, {:.0f}",
        "bounded"),
    Row("cuts-refined", CUTS, "the same block with 16³ cells, halved up to 2, 4 times towards an "
        "upper corner, cut at 1e-6, 0.3 of a cell: most iterations of a solution at the worst cut, "
        "at the best cut: multigrid of the lattice; GAMG",
        each("solid_3d", *(f"--cells 16 --cuts 1e-6,.3 --steps 1 --levels {levels} "
                           f"--solver {solver}"
                           for solver in ("own", "gamg") for levels in (2, 4))),
        linear_iterations, "; ".join(2 * ["{:.0f}, {:.0f}, {:.0f}, {:.0f}"]), "as few as without"),
    Row("cuts-cost", CUTS, "calls of the stabilisations' code per step, without stabilisation",
        each("benchmark", f"--repeat 1 --cases 1x64 --bases gimp --stabilisations none {ALONE}"),
        lambda a: [a["stabilisations"]["gimp 1x64 none"]["stabilisation_calls_per_step"]], "{:.0f}",
        quick=True),
    Row("collapse", PLASTIC, "collapse of a block, 9216 points, 40 steps: Newton iterations per "
        "step, median observed order", each("elastoplastic_collapse", ""),
        keys("max_newton_iterations", "newton_order"), "at most {:.0f}, {:.2f}", "8, 2"),
    Row("slope", PLASTIC, "slope failure, 9 runs each: finished runs with ghost penalty, "
        "aggregation, no stabilisation (decided by rounding errors)",
        each("slope_failure", "--table"), finished,
        "{:.0f}, {:.0f}, {:.0f}", "Coombs (2023): all with ghost stabilisation, some without"),
    Row("safety", PLASTIC, "factor of safety of a slope of two to one, φ = 20°, c/γH = 0.05, GIMP, "
        "F-bar, h = 1 m", each("factor_of_safety", ""), keys("factor"), "{:.3f}",
        "Griffiths & Lane (1999): 1.4"),
    Row("cylinder", PLASTIC, "thick cylinder on a grid that does not fit it: largest error of the "
        "pressure, error of the limit load; GIMP, quadratic splines, linear functions",
        each("thick_cylinder", "--basis gimp", "--basis bspline2", "--basis linear"),
        lambda *answers: [100 * a[k] for a in answers
                          for k in ("max_pressure_error", "limit_load_error")],
        "{:.2f} %, {:+.2f} %; {:.2f} %, {:+.2f} %; {:.2f} %, {:+.2f} %", "Hill's closed form"),
    Row("cam-clay", FOOTING, "Cam-Clay at 90 kPa, h = 0.5 m, quadratic splines: settlement in the "
        "centre, mean, against conforming elements; small strain against large",
        each("footing", "", "--strain small"),
        lambda a, small: [100 * a["deviation_centre"], 100 * a["deviation_mean"],
                          100 * (small["settlement_centre"] / a["settlement_centre"] - 1)],
        "{:+.1f} %, {:+.1f} %; {:+.0f} %", "conforming elements in `tests/reference`"),
    Row("prandtl", FOOTING, "Prandtl's limit, smooth rigid footing, cells of 0.05 m at the edge, "
        "F-bar: GIMP, linear functions, quadratic splines; GIMP without F-bar",
        each("footing", *(f"--law tresca-perfect {o}" for o in (
            "--basis gimp", "--basis linear", "--basis bspline2", "--basis gimp --fbar off"))),
        lambda *answers: [100 * a["bearing_error"] for a in answers],
        "{:+.2f} %, {:+.2f} %, {:+.2f} %; {:+.1f} %", "(2 + π) c"),
    Row("tresca", FOOTING, "hardening Tresca clay at 70 kPa, h = 0.5 m, 2² points, settlement in "
        "the centre without and with F-bar: linear functions, GIMP, quadratic splines (m)",
        each("footing", "--law tresca --compare"), settlements,
        "{:.3f}, {:.3f}; {:.3f}, {:.3f}; {:.3f}, {:.3f}", "conforming elements 0.929"),
    Row("bar", MOTION, "vibrating bar, GIMP, h = 1 m, Δt = 0.1 s: energy kept over 5 periods with "
        "consistent mass, ghost penalty and PIC; with lumped mass, FLIP and PIC",
        each("vibrating_bar", "--h 1", "--h 1 --mass lumped --mapping flip",
             "--h 1 --mass lumped --mapping pic"),
        lambda *answers: [a["energy"][5] for a in answers], "{:.5f}; {:.5f}, {:.4f}",
        "an independent code: 0.99977; 0.99877, 0.6906", quick=True),
    Row("bar-period", MOTION, "the same: period (s) with consistent mass, h = 1 and 0.5 m",
        each("vibrating_bar", "--h 1", "--h 0.5"), keys("period"), "{:.4f}, {:.4f}",
        "an independent code: 10.0028, 10.0011; exact 10.0002", quick=True),
    Row("expansion", MOTION, "affine velocities at the nodes, worst of four cuts: error with "
        "consistent mass and ghost penalty; with lumped mass",
        each("expansion", "", "--mass lumped --mapping flip"),
        lambda *answers: [max(a["velocity_error"]) for a in answers], "{:.0e}, {:.2f}",
        "rounding errors; an independent code: 0.25", quick=True),
    Row("turning", MOTION, "one rotation of a disc, R = 4 h, consistent mass with ghost penalty "
        "and PIC: angular momentum and energy kept by explicit steps, by the midpoint rule",
        each("rotating_disc", "--integrator explicit --mapping pic", ""),
        lambda *answers: [
            f for a in answers for f in (abs(1 - a["angular_momentum"]), a["energy"])
        ],
        "1 − L/L₀ = {:.0e}, E/E₀ = {:.3f}; {:.0e}, {:.3f}", "an independent code: 1e-14, 0.998"),
    Row("discs", MOTION, "two discs collide, contact at the nodes with a gap test, h = 0.025 m: "
        "time of first contact (s), least kinetic energy, rebound",
        each("colliding_discs", "--integrator explicit --contact gap --h 0.025"),
        keys("kinetic_below_99_percent", "min_kinetic", "rebound"), "{:.3f}, {:.3f}, {:.3f}",
        "conforming elements: 1.586, 0.053, 0.908"),
    Row("energy-block", ENERGY, "a cut block 4, 8, 16 cells high under its weight, Newmark with "
        "ghost penalty, c Δt/h = 1/4: share of the peak energy lost in two periods (%); a quarter "
        "of the step", each("energies", *(
            f"--scene block --cells {n} --dt {dt}"
            for n, dt in ((4, 1.7e-3), (8, 8.5e-4), (16, 4.25e-4), (4, 4.25e-4), (8, 2.125e-4)))),
        keys("lost"), "{:.2f}, {:.2f}, {:.2f}; {:.2f}, {:.2f}", "at most 1, 0.2, 0.1"),
    Row("energy-bodies", ENERGY, "34 random bodies in free motion, c Δt/h = 0.2 to 1: median, "
        "least, and largest energy (%): Newmark; generalised-α; explicit",
        each("energies", *(f"--scene bodies{o}" for o in (
            "", " --integrator generalised-alpha", " --integrator explicit"))),
        keys("median", "worst", "most"), "; ".join(["{:.2f}, {:.2f}, {:.2f}"] * 3),
        "median at least 99.9, least 99 (explicit 99.5), largest 100.2"),
    Row("energy-impact", ENERGY, "a free rigid disc hits a free elastic block: energy at the end, "
        "largest energy (%): Newmark with ghost penalty, 1 ms; 0.5 ms; with aggregation, 0.5 ms; "
        "generalised-α, ρ∞ = 1, 1 ms; explicit, 0.5 ms", each("energies", *(
            f"--scene impact {o}" for o in (
                "--dt 1e-3", "--dt 5e-4", "--stabilisation aggregation",
                "--integrator generalised-alpha --dt 1e-3", "--integrator explicit"))),
        of_impacts, "; ".join(["{:.2f}, {:.2f}"] * 5), "100; at most 100.1"),
    Row("energy-friction", ENERGY, "the same with friction, μ = 0.3, and 0.5 m/s across: energy "
        "that friction took, energy that the integrator lost (%): 1 ms; 0.5 ms",
        each("energies", *(f"--scene impact --friction 0.3 --dt {dt}" for dt in (1e-3, 5e-4))),
        of_friction, "{:.2f}, {:.3f}; {:.2f}, {:.3f}", "the second at most 1 % of the first"),
    Row("energy-impacts", ENERGY, "random rigid discs and boxes hit random elastic ones: median, "
        "least, largest energy (%), failed runs: 100 with Newmark; 50 explicit",
        each("energies", "--scene impacts --count 100",
             "--scene impacts --count 50 --integrator explicit"),
        keys("median", "worst", "most", "failed"),
        "; ".join(["{:.2f}, {:.2f}, {:.2f}, {:.0f}"] * 2), "at most 100.1; none"),
    Row("energy-discs", ENERGY, "two elastic discs with separate fields collide: energy at the "
        "end, largest energy (%): head-on; off-centre by 0.3 m; the same with friction, μ = 0.3",
        each("energies", *(
            f"--scene discs {o}" for o in ("", "--aside 0.3", "--aside 0.3 --friction 0.3"))),
        of_impacts, "{:.2f}, {:.2f}; {:.2f}, {:.2f}; {:.2f}, {:.2f}", "at most 100.1"),
)  # fmt: skip
