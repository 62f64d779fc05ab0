"""Rows of `benchmarks.py` on axisymmetric bodies, contact, boundaries, and soil with water."""

from __future__ import annotations

from benchmark_rows import Answer, Row, each, keys

RINGS, STEEL, WATER = "Axisymmetric bodies", "Soil and steel", "Soil and water"
EXACT = "exact: 0"
TOUCHING = "--contact bodies --integrator newmark --mass consistent --mapping flip"
SWEEP = "--sweep --load 1e-3 --permeability constant --theta 1"


def percent(*names: str):
    """Reads relative errors by name from every answer in turn, in percent."""
    return lambda *answers: [100 * answer[name] for answer in answers for name in names]


def iterations(answer: Answer) -> list[float]:
    """Mean number of linear iterations in every run."""
    return [run["mean_iterations"] for run in answer["runs"]]


def _steady_pull(answer: Answer) -> list[float]:
    """For 20 m of ploughing: means and extremes of the pull (MN), heap, iterations per step,
    halvings, minutes."""
    steps = list(zip(answer["distances"], answer["pulls"]))
    early, late = ([1e-6 * p for x, p in steps if a < x <= b] for a, b in ((4, 12), (12, 20)))
    return [
        sum(early) / len(early), sum(late) / len(late), min(early + late), max(early + late),
        answer["heap"], answer["newton_iterations"] / len(steps), answer["halvings"],
        answer["seconds"] / 60,
    ]  # fmt: skip


def _atlas(answer: Answer) -> list[float]:
    """Finished random problems (%) with ghost penalty, aggregation, no stabilisation; number of
    problems, and of wrong results."""
    shares = [100 * answer["success"][name] for name in ("ghost", "aggregation", "none")]
    return [*shares, answer["problems"], answer["wrong"]]


def _atlas_bases(answer: Answer) -> list[float]:
    """Finished random problems (%) with ghost penalty in each basis; number of problems."""
    bases = "linear", "gimp", "bspline2", "bspline3"
    return [*(100 * answer["success_with_ghost"][name] for name in bases), answer["problems"]]


ROWS = (
    Row("cavity", RINGS, "cavity expansion, Hencky, ν = 0.3, b/a = 2: error of the pressure at "
        "r(a)/a = 1.5, cylinder and sphere (%)",
        each("cavity_expansion", "--ratio 1.5", "--ratio 1.5 --shape sphere"), percent("error"),
        "{:+.3f}, {:+.3f}", EXACT, quick=True),
    Row("cavity-tresca", RINGS, "cavity expansion, incompressible Tresca clay, F-bar, I_r = 100, "
        "a/a0 = 2: cylinder, sphere (%)",
        each("cavity_expansion", "--law tresca --ratio 2",
             "--law tresca --ratio 2 --shape sphere"), percent("error"),
        "{:+.2f}, {:+.2f}", EXACT),
    Row("shell", RINGS, "thick sphere that yields: largest error of the pressure (%)",
        each("thick_shell", ""), percent("max_pressure_error"), "{:.2f}", EXACT, quick=True),
    Row("circular", RINGS, "circular footing on Tresca clay, F-bar, smooth, rough: bearing factor",
        each("circular_footing", "--rough off", "--rough on"), keys("factor"), "{:.3f}, {:.3f}",
        "5.69, 6.05 (Cox 1961, Eason & Shield)"),
    Row("atlas", STEEL, "random slopes that slide, rigid bodies dragged through soil, collisions, "
        "soil with water, in all bases: finished runs with ghost penalty, aggregation, no "
        "stabilisation (%); number of problems; wrong results without an error",
        ("mpirun -n 2 python3 demos/studies/stability_atlas.py --start 100 --seeds 14",), _atlas,
        "{:.1f}, {:.1f}, {:.1f}; {:.0f}; {:.0f}", picture="stability_atlas.png"),
    Row("atlas-bases", STEEL, "the same problems from other seeds with ghost penalty: finished "
        "runs with linear functions, GIMP, quadratic, cubic splines (%); number of problems",
        ("mpirun -n 2 python3 demos/studies/stability_atlas.py --stabilisation ghost --start 900 "
         "--seeds 14 --compare 0",), _atlas_bases, "{:.1f}, {:.1f}, {:.1f}, {:.1f}; {:.0f}"),
    Row("plate", STEEL, "plate on a cube, contact stiffness 1e8 Pa/m: relative error of the height",
        each("plate_on_cube", "--stiffness-per-area 1e8"), keys("height_error"), "{:.0e}", EXACT,
        quick=True),
    Row("incline", STEEL, "block on an incline of 45°, μ = 0.3, 1 s: error of the displacement, "
        "Newmark, explicit (%)", each("incline", "", "--integrator explicit"),
        percent("displacement_error"), "{:+.2f}, {:+.2f}", EXACT),
    Row("hertz", STEEL, "cylinder on elastic ground, 8 cells over half the contact: error of the "
        "half-width, of the peak pressure (%)", each("hertz", "--force 1000 --resolution 8"),
        percent("half_width_error", "peak_error"), "{:+.2f}, {:+.2f}", "Hertz: 0"),
    Row("hertz-bodies", STEEL, "two elastic bodies with separate fields, cylinders; spheres: "
        "error of the half-width, of the peak pressure (%)",
        each("hertz_bodies", "", "--shape sphere"), percent("half_width_error", "peak_error"),
        "{:+.1f}, {:+.1f}; {:+.1f}, {:+.1f}", "Hertz: 0"),
    Row("discs-touching", STEEL, "two discs with separate fields collide, cells of R/4; R/8: "
        "least kinetic energy, rebound",
        each("colliding_discs", TOUCHING, f"{TOUCHING} --h 0.025"),
        keys("min_kinetic", "rebound"), "{:.3f}, {:.3f}; {:.3f}, {:.3f}",
        "conforming elements: 0.053, 0.908"),
    Row("wall", STEEL, "smooth retaining wall, φ = 33.5°: error of the thrust, passive, active (%)",
        each("retaining_wall", "", "--direction active"), percent("thrust_error"),
        "{:+.2f}, {:+.2f}", "Rankine: 0"),
    Row("wedge", STEEL, "wedge into clay, semi-angle 15°, 20°, 30°, 45°: error of the slope of the "
        "force (%)", each("wedge", *(f"--semi-angle {a}" for a in (15, 20, 30, 45))),
        percent("slope_error"), "{:+.1f}, {:+.1f}, {:+.1f}, {:+.1f}", "Hill, Lee & Tupper 1947: 0"),
    Row("cone", STEEL, "smooth cone in Tresca clay, I_r = 100: error of the cone factor, cells of "
        "R/2, R/4 (%)",
        each("cone_penetration", "--h 0.5 --depth 17 --step 0.1", "--h 0.25 --depth 14 --step 0.1"),
        percent("error"), "{:+.1f}, {:+.1f}", "Teh & Houlsby 1991: 0"),
    Row("cone-sand", STEEL, "cone of 0.8 m in sand, relative density 32 %, cells of 0.2 m: depth "
        "reached (m), mean resistance of the last 2 m (MPa)",
        each("cone_penetration", "--law sand --h 0.2 --step 0.04"),
        lambda a: [a["reached"], 1e-6 * a["tip_resistance"]], "{:.1f}, {:.2f}"),
    Row("plough", STEEL, "share 1 m deep and wide dragged through sand by 1 m, cells of 0.25 m, "
        "two ranks: pull over the last fifth (MN), heap (m), Newton iterations per step",
        ("mpirun -n 2 python3 demos/studies/plough.py",),
        lambda a: [1e-6 * a["pull"], a["heap"], a["newton_iterations"] / len(a["pulls"])],
        "{:.3f}, {:.2f}, {:.1f}"),
    Row("plough-20", STEEL, "the same by 20 m: mean pull from 4 to 12 m, from 12 to 20 m, least "
        "and largest pull from 4 m on (MN), heap (m), Newton iterations per step, halved steps, "
        "minutes",
        ("mpirun -n 2 python3 demos/studies/plough.py --distance 20",), _steady_pull,
        "{:.3f}, {:.3f}, {:.3f}–{:.3f}, {:.2f}, {:.1f}, {:.0f}, {:.0f}"),
    Row("nitsche", STEEL, "ring, fixed at its unfitted inner edge by Nitsche's method: order of "
        "the displacement with ghost penalty, with aggregation",
        each("nitsche_ring", "--cells 4,8,16 --positions 0",
             "--cells 4,8,16 --positions 0 --stabilisation aggregation"),
        lambda *answers: [answer["orders"][-1] for answer in answers], "{:.2f}, {:.2f}", "2"),
    Row("nitsche-kappa", STEEL, "the same ring in 200 positions, 4 cells over its thickness: worst "
        "over best condition number, worst one, with ghost penalty; with aggregation",
        each("nitsche_ring", "--cells 4 --positions 200",
             "--cells 4 --positions 200 --stabilisation aggregation"),
        lambda *answers: [f for a in answers for f in (max(a["kappas"]) / min(a["kappas"]),
                                                       max(a["kappas"]))],
        "{:.1f}, {:.0f}; {:.1f}, {:.0f}", "bounded"),
    Row("oedometer", WATER, "consolidation by 21 % of the height: largest error of U at "
        "T = 0.05 … 1 (%) with matched, constant, Kozeny–Carman permeability",
        each("consolidation", "--load 0.3", "--load 0.3 --permeability constant",
             "--load 0.3 --permeability kozeny-carman"), percent("U_error"),
        "{:.2f}, {:.2f}, {:.2f}", "exact, finite differences: 0", quick=True),
    Row("self-weight", WATER, "the same by the layer's own weight, by 12 % of the height: error "
        "of U, of the base pressure relative to the weight (%)",
        each("consolidation", "--scene self-weight --load 0.3 --permeability kozeny-carman"),
        percent("U_error", "base_pressure_error"), "{:.2f}, {:.2f}", "finite differences: 0",
        quick=True),
    Row("inf-sup", WATER, "inf-sup constant, displacement on cells of half the size: bodies of 4, "
        "8, 12 whole cells; least of 24 cut bodies with ghost penalties",
        each("inf_sup", "--pairs nested --stabilisations ghost"),
        lambda a: [*(w["beta"] for w in a["whole"]["nested"]), a["rows"][0]["beta_least"]],
        "{:.3f}, {:.3f}, {:.3f}; {:.3f}", "0.411, 0.407, 0.406"),
    Row("first-steps", WATER, "overshoot in first steps of 1e-8 … 1 h²/c_v, 10 cuts down to 1e-6 "
        "of a cell, ghost penalties: nested grids, equal orders (%)",
        each("consolidation", f"{SWEEP} --pair nested", f"{SWEEP} --pair gimp-gimp"),
        percent("overshoot"), "{:.2f}, {:.2f}", "at most 1"),
    Row("overshoot", WATER, "overshoot in a first step of 1e-6 h²/c_v, with and without the "
        "pressure projection",
        each("consolidation", "--load 1e-3 --stabilisation none",
             "--load 1e-3 --stabilisation none --projection none"), keys("overshoot"),
        "{:.4f}, {:.4f}", "0", quick=True),
    Row("mandel", WATER, "Mandel's slab, ν = 0.2: largest error of the pressure in the middle, "
        "displacement of the side (%)", each("mandel", ""),
        percent("pressure_centre_error", "u_x_error"), "{:.2f}, {:.2f}", EXACT, quick=True),
    Row("round", WATER, "de Leeuw's cylinder, ν = 0.2, Cryer's sphere, ν = 1/3: largest error of "
        "the pressure in the centre (%)",
        (*each("de_leeuw", ""), *each("cryer", "")), percent("centre_pressure_error"),
        "{:.2f}, {:.2f}", EXACT, quick=True),
    Row("strip", WATER, "strip footing on saturated ground, T = 0.1: E s/(qB) in the centre, at "
        "the edge", each("footing_consolidation", "--times 0.1"),
        lambda a: [a["settlement_centre"][0], a["settlement_edge"][0]], "{:.3f}, {:.3f}",
        "conforming Q2–Q1 elements: 1.493, 0.848", quick=True),
    Row("slope-water", WATER, "saturated slope of Cam-Clay, fast loading: γ'H/c at failure; the "
        "same for a slope of equal strength without water",
        each("coupled_slope", "--law cam-clay --rate fast"),
        lambda a: [run["limit"] for run in a["runs"].values()], "{:.2f}, {:.2f}",
        "Taylor 1937: 5.24"),
    Row("cone-water", WATER, "cone in saturated Cam-Clay without drainage: error of the cone "
        "factor with the clay's undrained strength (%)",
        each("cone_penetration", "--undrained"), percent("error"), "{:+.1f}",
        "Teh & Houlsby 1991: 0"),
    Row("water-3d", WATER, "square footing in 3D, 12 000 and 34 000 unknowns: linear iterations "
        "per Newton iteration", each("footing_3d", "--cells 14,20 --steps 2"), iterations,
        "{:.0f}, {:.0f}"),
)  # fmt: skip
