"""Rows of `benchmarks.py` on laws of soil, derivatives, calibration and reliability."""

from __future__ import annotations

from benchmark_rows import Answer, Row, each

LAWS = "Laws of soil by element tests"
PARAMETERS = "Derivatives, calibration and reliability"


def _worst_derivative(answer: Answer) -> list[float]:
    """Largest error of elastic examples, and of the others."""
    rows = [(row["case"].startswith("elastic"), row["error"]) for row in answer["rows"]]
    return [max(error for elastic, error in rows if elastic is kind) for kind in (True, False)]


def _cost_of_parameters(*answers: Answer) -> list[float]:
    """Time of the first parameter and of each further one, over that of a run (%)."""
    return [100 * answer[name] for answer in answers for name in ("first", "further")]


ROWS = (
    Row("hypoplasticity", LAWS, "hypoplastic sand with published parameters, oedometers and "
        "triaxial tests: largest differences of void ratio, q (% of the peak), volume strain (%) "
        "from the published curves; differences that the rounded parameters allow",
        each("hypoplastic_sand", ""), lambda a: [*a["published_error"], *a["rounding"]],
        "{:.4f}, {:.1f}, {:.2f}; {:.4f}, {:.1f}, {:.2f}", "Mendez et al. 2021: 0"),
    Row("hypoplasticity-facts", LAWS, "hypoplastic sand: error of Bauer's compression law; "
        "friction angle at the end, dense, loose (°); |h|/R; stiffness after turns by 180°, by 90° "
        "over the hypoelastic one", each("hypoplastic_sand", ""), lambda a: [
            a["facts"]["bauer"], *a["facts"]["angle"].values(), a["facts"]["radius"],
            a["facts"]["m_R"], a["facts"]["m_T"]],
        "{:.0e}; {:.2f}, {:.2f}; {:.4f}; {:.3f}, {:.3f}",
        "0; φ_c = 33, 33; 1; m_R = 5, m_T = 2 (Niemunis & Herle 1997)"),
    Row("norsand", LAWS, "NorSand, Erksak sand, ψ₀ from −0.2 to 0.06, 60 to 1000 kPa: largest "
        "errors of the peak q/p, the critical q/p, the undrained strength (%), the critical void "
        "ratio", each("norsand_paths", ""), lambda a: [
            *(100 * a["worst"][n] for n in ("peak", "end", "residual")), a["worst"]["void_ratio"]],
        "{:.2f}, {:.3f}, {:.2f}, {:.0e}", "exact: 0 (Jefferies & Been 2016)"),
    Row("damping", LAWS, "HardinDrnevich in cycles of 1e-4 to 1 % of shear strain: largest errors "
        "of G/G₀, damping against the exact loop; fitted to sand: G/G₀, damping (%) off the "
        "published curves up to 0.03 %, at 1 %", each("damping", ""), lambda a: [
            a["error_stiffness"], a["error_damping"], a["off_published"]["stiffness"],
            a["off_middle"], a["off_published"]["damping"][-1]],
        "{:.0e}, {:.0e}; {:.3f}, {:.1f}, {:+.0f}", "exact: 0; Seed & Idriss 1970, Idriss 1990"),
    Row("derivatives", PARAMETERS, "derivatives of 30 examples by all their parameters beside "
        "differences of whole runs: largest error of elastic examples, of the others",
        each("derivatives", ""), _worst_derivative, "{:.0e}, {:.0e}", "exact: 0"),
    Row("derivatives-time", PARAMETERS, "time of the first parameter, of each further one over a "
        "run without (%): Mohr–Coulomb footing of 10 000 points; elastic block of 36 000 unknowns "
        "in 3D", each("derivatives", "--time", "--time --block"), _cost_of_parameters,
        "{:.0f}, {:.0f}; {:.0f}, {:.0f}"),
    Row("calibration", PARAMETERS, "E, cohesion and friction angle of a footing from curves with "
        "random errors, 20 sets: truths inside their 95 % intervals, of 60; most runs of a fit",
        each("calibrate_footing", ""),
        lambda a: [sum(a["counts"].values()), max(a["runs"])], "{:.0f}; {:.0f}", "57 expected"),
    Row("reliability", PARAMETERS, "slope with a random field of strength, correlation lengths of "
        "40, 10, 5 m: reliability index β; most runs with derivatives",
        each("slope_reliability", ""),
        lambda a: [*(row["beta"] for row in a["rows"]), max(row["runs"] for row in a["rows"])],
        "{:.2f}, {:.2f}, {:.2f}; {:.0f}"),
    Row("indentation", PARAMETERS, "indentation of saturated ground, cells of 0.5 m: stiffness "
        "(kN/m); error of its derivative by dimensions; force with the modulus found in one step "
        "over the measured one, less 1", each("indentation", "--checked E"),
        lambda a: [a["stiffness"] / 1e3, a["by_dimensions"], abs(a["missed"])],
        "{:.0f}; {:.0e}; {:.0e}", "GeoWarp, cells of 0.25 m: 1357; 0; 0"),
)  # fmt: skip
