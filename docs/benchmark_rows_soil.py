"""Rows of `benchmarks.py` on axisymmetric bodies, contact, boundaries, and soil with water."""

from __future__ import annotations

from benchmark_rows import Answer, Row, each, keys

RINGS, STEEL, WATER = "Axisymmetric bodies", "Soil and steel", "Soil and water"
LEAVES, EXACT = "Refined spaces", "exact: 0"
GROUND = "Ground"
TOUCHING = "--contact bodies --integrator newmark --mass consistent --mapping flip"
ROUGH = "--base rough --stabilisation ghost"
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


def _plough_leaves(*answers: Answer) -> list[float]:
    """Last pull (MN), heap, unknowns, iterations per step, halvings of every answer."""
    return [f for a in answers for f in (
        1e-6 * a["last_pull"], a["heap"], a["unknowns"], a["newton_iterations"] / len(a["pulls"]),
        a["halvings"])]  # fmt: skip


def _atlas(answer: Answer) -> list[float]:
    """Finished random problems (%) with ghost penalty, aggregation, no stabilisation; number of
    problems, and of wrong results."""
    shares = [100 * answer["success"][name] for name in ("ghost", "aggregation", "none")]
    return [*shares, answer["problems"], answer["wrong"]]


def _atlas_bases(answer: Answer) -> list[float]:
    """Finished random problems (%) with ghost penalty in each basis; number of problems, and of
    wrong results."""
    bases = "linear", "gimp", "bspline2", "bspline3"
    shares = [100 * answer["success_with_ghost"][name] for name in bases]
    return [*shares, answer["problems"], answer["wrong"]]


def _leaf_corner(answer: Answer) -> list[float]:
    """Orders in the energy norm: uniform, graded lines, leaves; unknowns of leaves for their error,
    over those of a uniform grid (%)."""
    found = answer["corner"]
    kinds = "uniform", "graded lines", "leaves"
    return [*(found["orders"][kind] for kind in kinds), 100 * found["share"]]


def _leaf_cone(answer: Answer) -> list[float]:
    """Unknowns over those of leaves: uniform with the same cells, graded for the same error."""
    found = answer["cone"]
    alike = found["gain"]["uniform"]["same_cells"]["unknowns"], found["finest"]["ratio"]
    return [*alike, found["gain"]["graded lines"]["unknowns"]]


def _leaf_splines(answer: Answer) -> list[float]:
    """Orders in the energy norm: uniform, leaves; error (%) and unknowns of the finest leaves."""
    found = answer["corner"]
    last = [run for run in found["runs"] if run["grid"] == "leaves"][-1]
    orders = (found["orders"][kind] for kind in ("uniform", "leaves"))
    return [*orders, 100 * last["error"], last["unknowns"]]


def _leaf_footing(answer: Answer) -> list[float]:
    """Least errors (%) and their unknowns: uniform, graded lines, leaves; share as above (%)."""
    runs = answer["footing"]["runs"]
    last = [[r for r in runs if r["grid"] == g][-1] for g in ("uniform", "graded lines", "leaves")]
    figures = [f for r in last for f in (100 * r["error"], r["unknowns"])]
    return [*figures, 100 * answer["footing"]["share"]]


def _cone_leaves(*answers: Answer) -> list[float]:
    """Error, scatter (%), unknowns, Newton iterations per step, minutes of each run."""
    return [
        figure for a in answers
        for figure in (
            100 * a["error"], 100 * a["scatter"] / a["factor"], a["unknowns"],
            a["newton_iterations"] / len(a["depths"]), a["seconds_solve"] / 60,
        )
    ]  # fmt: skip


def _amplification(*answers: Answer) -> list[float]:
    """Largest error of the amplification (%) up to 10 and up to 20 nodes per wavelength."""
    return [100 * answer["errors"][nodes] for answer in answers for nodes in ("10", "20")]


ROWS = (
    Row("leaf-corner", LEAVES, "L-shaped body, exact singular solution: order of the energy norm "
        "on a uniform grid, between graded lines, in leaves; unknowns of leaves over those of a "
        "uniform grid with the same error (%)",
        each("refinement", "--parts corner"), _leaf_corner, "{:.2f}, {:.2f}, {:.2f}; {:.2g}",
        "exact: 0.54, 1, 1", quick=True),
    Row("leaf-splines", LEAVES, "the same with quadratic splines, 4, 8 cells per leg: order on a "
        "uniform grid, in leaves; error (%) and unknowns of the finest leaves",
        each("refinement", "--parts corner --basis bspline2 --corner 4,8"), _leaf_splines,
        "{:.2f}, {:.2f}; {:.2f}, {:.0f}", "exact: 0.54, 2", quick=True),
    Row("leaf-footing", LEAVES, "smooth strip footing on Tresca clay, F-bar: error of the load (%) "
        "and unknowns, uniform cells of 1/32 of the half-width, graded lines, leaves; unknowns of "
        "leaves over those of a uniform grid with the same error (%)",
        each("refinement", "--parts footing"), _leaf_footing,
        "{:.2f}, {:.0f}; {:.2f}, {:.0f}; {:.2f}, {:.0f}; {:.2g}", "exact: 0"),
    Row("leaf-cone", LEAVES, "smooth cone, 2 R down in Tresca clay: unknowns of uniform cells of "
        "R/4, R/16 over those of leaves of that size; of graded lines over those of leaves of R/8 "
        "for the same error",
        each("refinement", "--parts cone"), _leaf_cone, "{:.3g}, {:.3g}; {:.2g}"),
    Row("leaf-column", LEAVES, "column under its weight, leaves half as large in its lowest "
        "quarter: unknowns over those of a uniform grid with the same error (%)",
        each("refinement", "--parts column"), lambda a: [100 * a["column"]["share"]], "{:.0f}",
        quick=True),
    Row("leaf-cuts", LEAVES, "200 blocks that cut leaves of three sizes: worst over best κ(K), 2D "
        "with ghost penalty, with aggregation; 30 in 3D; largest error of patches on 20 random "
        "trees", (*each("refinement", "--parts conditioning,patch",
                        "--parts conditioning --stabilisation aggregation",
                        "--parts conditioning --dimension 3 --places 30"),),
        lambda a, b, c: [*(x["conditioning"]["spread"] for x in (a, b, c)), a["patch"]["worst"]],
        "{:.3g}, {:.3g}; {:.3g}; {:.0e}", "at most 20; rounding errors"),
    Row("leaf-spline-cuts", LEAVES, "the same with quadratic splines: ghost penalty, aggregation; "
        "16 places in 3D; patches on 60 random trees",
        (*each("refinement", "--parts conditioning,patch --trees 60 --basis bspline2",
               "--parts conditioning --stabilisation aggregation --basis bspline2",
               "--parts conditioning --dimension 3 --places 16 --basis bspline2"),),
        lambda a, b, c: [*(x["conditioning"]["spread"] for x in (a, b, c)), a["patch"]["worst"]],
        "{:.3g}, {:.3g}; {:.3g}; {:.0e}", "at most 20; rounding errors"),
    Row("leaf-slope", LEAVES, "slope with a weak zone, cells of 1 m halved where it yields: runout "
        "(m), unknowns at the end; the same on a grid of 0.5 m",
        each("slope_failure", "--refine yield", "--h 0.5"), keys("runout", "unknowns"),
        "{:.2f}, {:.0f}; {:.2f}, {:.0f}", quick=True),
    Row("screw", STEEL, "screw pile in weightless clay, cells of half the plate's radius, pitch-"
        "matched, over-flighted by half: vertical force over c_u π R², torque over 2 c_u π R³",
        each("screw_pile", ""), lambda a: [
            run[name] for run in a["runs"] for name in ("force_factor", "torque_factor")],
        "{:+.2f}, {:.2f}; {:+.2f}, {:.2f}", "pulled down by over-flighting"),
    Row("anchor", STEEL, "drag anchor in weightless clay, cells of a quarter, an eighth of the "
        "fluke: inclination of the fluke, angle at which it dives (°), tension over c_u A",
        each("drag_anchor", "", "--levels 2 --way 0.4"), lambda *answers: [
            f for a in answers for f in (a["inclination"], a["dive"], a["tension"] / 1e4)],
        "{:.1f}, {:.1f}, {:.1f}; {:.1f}, {:.1f}, {:.1f}",
        "Neubecker & Randolph (1996): 27.9, 28.6; 21.3, 23.1"),
    Row("t-bar", STEEL, "T-bar in deep clay, quadratic splines: resistance over c_u, smooth and "
        "rough, cells of R/4, of R/8; adhesion of half of the strength, R/8",
        each("t_bar", *(f"--cells {n} --adhesion {a}"
                        for n, a in ((4, 0), (4, 1), (8, 0), (8, 1), (8, 0.5)))),
        keys("factor"), "{:.2f}, {:.2f}, {:.2f}, {:.2f}; {:.2f}",
        "Randolph & Houlsby (1984): 9.14, 11.94; 10.82"),
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
        "runs with linear functions, GIMP, quadratic, cubic splines (%); number of problems; "
        "wrong results without an error",
        ("mpirun -n 2 python3 demos/studies/stability_atlas.py --stabilisation ghost --start 900 "
         "--seeds 134 --compare 0",), _atlas_bases,
        "{:.1f}, {:.1f}, {:.1f}, {:.1f}; {:.0f}; {:.0f}"),
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
    Row("turned-block", STEEL, "block turned by 0 to 45° in the grid between two plates, 1 % of "
        "strain, 8, 16 cells over its width: largest error of the force (%), faces of the body, "
        "corners of domains",
        each("turned_block", ""), percent("faces_8", "faces_16", "corners_8", "corners_16"),
        "{:.1f}, {:.1f}; {:.0f}, {:.0f}", EXACT),
    Row("discs-touching", STEEL, "two discs with separate fields collide, cells of R/4; R/8: "
        "least kinetic energy, rebound",
        each("colliding_discs", TOUCHING, f"{TOUCHING} --h 0.025"),
        keys("min_kinetic", "rebound"), "{:.3f}, {:.3f}; {:.3f}, {:.3f}",
        "conforming elements: 0.053, 0.908"),
    Row("wall", STEEL, "smooth retaining wall, φ = 33.5°: error of the thrust, passive, active (%) "
        "and passive on a fixed base, cells of 1/8, 1/16 of its height",
        each("retaining_wall", "", "--direction active", ROUGH, f"{ROUGH} --h 0.0625"),
        percent("thrust_error"), "{:+.2f}, {:+.2f}; {:+.1f}, {:+.1f}", "Rankine: 0"),
    Row("wedge", STEEL, "wedge into clay, semi-angle 15°, 20°, 30°, 45°: error of the slope of the "
        "force (%)", each("wedge", *(f"--semi-angle {a}" for a in (15, 20, 30, 45))),
        percent("slope_error"), "{:+.1f}, {:+.1f}, {:+.1f}, {:+.1f}", "Hill, Lee & Tupper 1947: 0"),
    Row("cone", STEEL, "smooth cone in Tresca clay, I_r = 100: error of the cone factor, cells of "
        "R/2, R/4 (%)",
        each("cone_penetration", "--h 0.5 --depth 17 --step 0.1", "--h 0.25 --depth 14 --step 0.1"),
        percent("error"), "{:+.1f}, {:+.1f}", "Teh & Houlsby 1991: 0"),
    Row("cone-leaves", LEAVES, "the cone with cells of R/4, R/8, R/16 that follow its tip, 8 R of "
        "way: error of the cone factor over the last 4 R, scatter (%), unknowns, Newton iterations "
        "per step, minutes",
        each("cone_penetration", "--refine --h 0.25 --depth 14", "--refine --h 0.125 --depth 14",
             "--refine --h 0.0625 --depth 14 --step 0.05"), _cone_leaves,
        "; ".join(["{:+.1f}, {:.1f}, {:.0f}, {:.1f}, {:.1f}"] * 3), "Teh & Houlsby 1991: 0"),
    Row("cone-splines", LEAVES, "the same with quadratic splines on leaves of R/4, R/8: error of "
        "the cone factor over the last 4 R, scatter (%), unknowns, iterations per step, minutes",
        each("cone_penetration", "--refine --h 0.25 --depth 14 --basis bspline2",
             "--refine --h 0.125 --depth 14 --basis bspline2"), _cone_leaves,
        "; ".join(["{:+.1f}, {:.1f}, {:.0f}, {:.1f}, {:.1f}"] * 2), "Teh & Houlsby 1991: 0"),
    Row("cone-index", LEAVES, "the same with cells of R/8, I_r = 50, 300: error (%)",
        each("cone_penetration", *(f"--refine --h 0.125 --depth 14 --rigidity-index {i}"
                                   for i in (50, 300))),
        percent("error"), "{:+.1f}, {:+.1f}", "Teh & Houlsby 1991: 0"),
    Row("cone-sand", STEEL, "cone of 0.8 m in sand, relative density 32 %, cells of 0.2 m: depth "
        "reached (m), mean resistance of the last 2 m (MPa)",
        each("cone_penetration", "--law sand --h 0.2 --step 0.04"),
        lambda a: [a["reached"], 1e-6 * a["tip_resistance"]], "{:.1f}, {:.2f}"),
    Row("cone-sand-leaves", LEAVES, "the same with cells of R/4, R/8, R/16 that follow its tip: "
        "mean resistance of the last 2 m (MPa)",
        each("cone_penetration", *(f"--law sand --refine --h {h}" for h in (0.1, 0.05, 0.025))),
        lambda *answers: [1e-6 * a["tip_resistance"] for a in answers], "{:.2f}, {:.2f}, {:.2f}"),
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
    Row("plough-leaves", LEAVES, "the share with cells of 1/4, 1/8 m that follow it, dragged by "
        "0.25 m in steps of 25 mm, in balance to 1e-6: last pull (MN), heap (m), unknowns, Newton "
        "iterations per step, halved steps",
        each("plough", "--refine --distance 0.25 --step 0.1",
             "--refine --distance 0.25 --h 0.125"), _plough_leaves,
        "; ".join(["{:.3f}, {:.2f}, {:.0f}, {:.1f}, {:.0f}"] * 2)),
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
    Row("site", GROUND, "shear waves in a layer on rock, quadratic splines, consistent mass: "
        "largest error of the amplification up to 10, up to 20 nodes per wavelength (%): Newmark; "
        "explicit", each("site_response", "", "--integrator explicit"), _amplification,
        "{:.2f}, {:.2f}; {:.2f}, {:.2f}", "at most 2 (Kramer 1996)"),
    Row("site-others", GROUND, "the same, Newmark: quadratic splines, lumped mass; GIMP, "
        "consistent mass; GIMP, lumped mass",
        each("site_response", "--mass lumped", "--basis gimp", "--basis gimp --mass lumped"),
        _amplification, "{:.0f}, {:.1f}; {:.0f}, {:.1f}; {:.0f}, {:.1f}", "0"),
    Row("sliding", GROUND, "slope with a weak layer in an earthquake: slip against a rigid block "
        "(%): waves of 2000 m/s; waves of 400 m/s, which a rigid block does not have",
        each("sliding_slope", "", "--s-speed 400"), percent("error"), "{:+.2f}; {:+.1f}",
        "Newmark's sliding block (1965): 0"),
    Row("free-field", GROUND, "two layers on rock between free-field sides, Newmark, quadratic "
        "splines: largest error of the amplification (%) up to 10, 20, 40 nodes per wavelength; "
        "the surface off that of a column alone (% of the peak)",
        each("free_field", "--parts level"), lambda a: [
            *(100 * a["level"]["errors"][n] for n in ("10", "20", "40")),
            100 * a["level"]["off_column"]],
        "{:.1f}, {:.1f}, {:.1f}; {:.3f}", "0 (Kramer 1996); 0"),
    Row("free-field-hill", GROUND, "a hill on the same ground: velocity of its top off that in "
        "wide ground (% of the peak), free-field sides, tied sides; energy left (%)",
        each("free_field", "--parts hill"), lambda a: [
            *(100 * a["hill"]["errors"][name] for name in ("free field", "tied")),
            *(100 * a["hill"]["left"][name] for name in ("free field", "tied"))],
        "{:.1f}, {:.1f}; {:.1f}, {:.1f}", "0"),
    Row("debris", GROUND, "debris flow down a valley in 3D, two ranks: error of the volume, of the "
        "momentum by the forces on bed and wall (%), of the work by the fall of the centre of mass "
        "(%), peak force on the wall (MN)", ("mpirun -n 2 python3 demos/studies/debris_flow.py",),
        lambda a: [100 * a["volume_error"], 100 * a["momentum_error"], 100 * a["work_error"],
                   1e-6 * a["peak"]], "{:.0e}, {:.2f}, {:.2f}, {:.1f}", "0, 0, 0"),
    Row("debris-plane", GROUND, "the same debris on an incline of 25° after 4 s: velocity of the "
        "centre of mass against a block (%)",
        ("mpirun -n 2 python3 demos/studies/debris_flow.py --bed plane",),
        lambda a: [100 * a["block_error"]], "{:+.2f}", "g t (sin β − μ cos β): 0"),
)  # fmt: skip
