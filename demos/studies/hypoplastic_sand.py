# %% [markdown]
# # Hypoplastic sand: published curves, and what the theory says exactly
#
# The UMAT `demos/umat/hypoplasticity.f90` is the law of von Wolffersdorff (1996) with the
# intergranular strain of Niemunis & Herle (1997).
#
# **Published curves.** Mendez, Pasculli, Mendez & Sciarra (2021, doi 10.1007/s11440-020-01135-z)
# fit the eight parameters to two oedometers and three drained triaxial tests of a sand. The example
# of their program GA-cal (arXiv 2211.13652) has the tests, the parameters and the computed curves.
# The parameters are printed with two decimals. So our curves differ from theirs by the rounding,
# and by their steps: each parameter is moved by half of its last digit, and the sum of all changes
# is the band in which the published curve may be.
#
# **Exact facts** of the theory, for Hochstetten sand (von Wolffersdorff 1996):
#
# - the loosest state is compressed along $e = e_{i0}\exp(-(3p/h_s)^n)$ (Bauer 1996);
# - triaxial compression ends with the friction angle $\varphi_c$, at $e = e_{c0}\exp(-(3p/h_s)^n)$;
# - a long straight path makes the intergranular strain as large as $R$;
# - after it a turn by 180° has $m_R$ times, a turn by 90° $m_T$ times the hypoelastic stiffness.

# %%
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from options import Options, natural
from scene import finish, say

import dolfinmpm as mpm


@dataclass
class Input(Options):
    """Hypoplasticity beside published curves and the exact facts of its theory."""

    steps: int = natural(100, "of each path")


args = Input.parse()
SOURCE = Path(__file__).resolve().parents[1] / "umat" / "hypoplasticity.f90"
STRAINS = [f"intergranular_{k}" for k in ("11", "22", "33", "12", "13", "23")]
# φ_c (degrees), h_s (Pa), n, e_d0, e_c0, e_i0, α, β, R, m_R, m_T, β_r, χ
HOCHSTETTEN = [33.0, 1.0e9, 0.25, 0.55, 0.95, 1.05, 0.25, 1.5, 1e-4, 5.0, 2.0, 0.5, 6.0]
# φ_c (degrees), h_s (GPa), n, e_c0, α, β, e_i0/e_c0, e_d0/e_c0 as printed, and their last digits
FITTED = np.array([33.38, 1.23, 0.24, 1.04, 0.20, 1.22, 1.10, 0.58])
DIGIT = 0.01

# Published curves: vertical stress (kPa) and void ratio, of oedometers from 25 kPa with half of it
# on the sides
OEDOMETERS = {
    0.730: [(44.4, 0.7241), (73.2, 0.7181), (170.6, 0.7063), (343.4, 0.6946), (623.7, 0.6830),
            (1024.1, 0.6720)],
    0.695: [(45.3, 0.6896), (75.7, 0.6842), (179.6, 0.6734), (365.2, 0.6627), (666.9, 0.6520),
            (1098.0, 0.6420)],
}  # fmt: skip
# Axial strain (%), q (kPa) and volume strain (%), of triaxial tests from a pressure (kPa) and e
TRIAXIALS = {
    (100.0, 0.69): [(0.525, 79.6, -0.406), (1.05, 145.5, -0.633), (2.1, 247.2, -0.767),
                    (3.15, 318.8, -0.641), (4.2, 366.2, -0.357), (6.3, 408.1, 0.455),
                    (8.4, 408.5, 1.376), (9.975, 397.2, 2.054)],
    (200.0, 0.67): [(0.525, 139.0, -0.416), (1.05, 257.7, -0.669), (2.1, 447.6, -0.870),
                    (3.15, 588.9, -0.810), (4.2, 690.2, -0.586), (6.3, 797.0, 0.146),
                    (8.4, 818.3, 1.041), (9.975, 804.8, 1.725)],
    (300.0, 0.66): [(0.525, 191.4, -0.423), (1.05, 357.1, -0.692), (2.1, 626.8, -0.936),
                    (3.15, 832.4, -0.923), (4.2, 985.0, -0.742), (6.3, 1159.6, -0.083),
                    (8.4, 1210.2, 0.766), (9.975, 1201.2, 1.434)],
}  # fmt: skip
# Measured in the same tests: e at 25, 100, 400, 1000 kPa; q (kPa) at every 2.105 % of strain
OEDOMETERS_MEASURED = {0.730: (0.730, 0.714, 0.689, 0.672), 0.695: (0.695, 0.679, 0.661, 0.642)}
TRIAXIALS_MEASURED = {
    100.0: (0, 245, 338, 377, 396), 200.0: (0, 495, 690, 779, 814),
    300.0: (0, 691, 982, 1120, 1181),
}  # fmt: skip


def sand(e, values, error=1e-8):
    """The law with a first void ratio; the last property is the largest error of a substep."""
    return mpm.materials.UMAT(
        SOURCE, [*values, 0.0, error], dict.fromkeys(STRAINS, 0.0) | {"void_ratio": e}
    )


def fitted(values):
    """Properties of the fitted sand, without intergranular strain."""
    phi, hs, n, ec, alpha, beta, ei, ed = values
    return [phi, 1e9 * hs, n, ed * ec, ec, ei * ec, alpha, beta, 0.0, 5.0, 2.0, 0.5, 6.0]


def test_of(law, path, to, **options):
    return mpm.study.element_test(law, path, to, strain="small", steps=args.steps, **options)


# %% [markdown]
# ## The published curves


# %%
def curves(values):
    """Void ratios of the oedometers, then q and volume strain (%) of the triaxial tests, at the
    published points; and the whole paths."""
    points, paths = [], []
    for e, rows in OEDOMETERS.items():
        stress = 1e3 * np.array([row[0] for row in rows])
        law = sand(e, fitted(values))
        first = (-12.5e3, -25e3, -12.5e3)
        test = test_of(law, "oedometer", -1.1e6, by="stress", stress=first)
        points.append(np.interp(stress, -test["stress_yy"], test["void_ratio"]))
        paths.append((-1e-3 * test["stress_yy"], test["void_ratio"]))
    for (p, e), rows in TRIAXIALS.items():
        strain = np.array([row[0] for row in rows])
        test = test_of(sand(e, fitted(values)), "triaxial", -0.1, pressure=1e3 * p)
        axial, volume = -100 * test["strain_yy"], 100 * test["volume_strain"]
        points += [np.interp(strain, axial, 1e-3 * test["q"]), np.interp(strain, axial, volume)]
        paths.append((axial, 1e-3 * test["q"], volume))
    return points, paths


def in_percent(differences):
    """Largest differences: of e, of q over its largest (%), of the volume strain (%)."""
    e = max(np.abs(d).max() for d in differences[:2])
    q = max(
        100 * np.abs(d).max() / max(row[1] for row in rows)
        for d, rows in zip(differences[2::2], TRIAXIALS.values())
    )
    return [float(e), float(q), float(max(np.abs(d).max() for d in differences[3::2]))]


found, paths = curves(FITTED)
published = [np.array([row[1] for row in rows]) for rows in OEDOMETERS.values()]
for rows in TRIAXIALS.values():
    published += [np.array([row[1] for row in rows]), np.array([row[2] for row in rows])]
off = in_percent([a - b for a, b in zip(found, published)])
band = [np.zeros_like(row) for row in found]
for k in range(len(FITTED)):
    moved = curves(FITTED + 0.5 * DIGIT * np.eye(len(FITTED))[k])[0]
    band = [b + np.abs(m - f) for b, m, f in zip(band, moved, found)]
allowed = in_percent(band)
say(f"published curves: void ratio off by {off[0]:.4f}, q by {off[1]:.2f} % of the peak, volume "
    f"strain by {off[2]:.3f} %; rounded parameters allow {allowed[0]:.4f}, {allowed[1]:.2f} %, "
    f"{allowed[2]:.3f} %")  # fmt: skip

# %% [markdown]
# ## Exact facts

# %%
phi, hs, n, ed0, ec0, ei0, *_, radius, m_r, m_t, _, _ = HOCHSTETTEN
plain = [*HOCHSTETTEN[:8], 0.0, *HOCHSTETTEN[9:]]
loosest = ei0 * np.exp(-((3 * 10e3 / hs) ** n))
bauer = test_of(sand(loosest, plain), "isotropic", -1e6, by="stress", pressure=10e3)
facts = {"bauer": float(np.abs(bauer["void_ratio"] / (
    ei0 * np.exp(-((3 * bauer["p"] / hs) ** n))) - 1).max())}  # fmt: skip

ends = {}
for name, e in (("dense", 0.65), ("loose", 0.95)):
    test = test_of(sand(e, HOCHSTETTEN), "triaxial", -1.5, pressure=100e3)
    q, p = test["q"][-1], test["p"][-1]
    angle = np.degrees(np.arcsin(q / (2 * 100e3 + q)))
    critical = ec0 * np.exp(-((3 * p / hs) ** n))
    ends[name] = (angle, test["void_ratio"][-1] / critical - 1)
facts["angle"] = {name: float(one[0]) for name, one in ends.items()}
facts["critical"] = {name: float(one[1]) for name, one in ends.items()}


def turned(strain):
    """A path of 30 R of compression along y, and then a small step to other strains."""
    legs = [{"strain": {"yy": -30 * radius}, "steps": args.steps}, {"strain": strain, "steps": 1}]
    law = sand(0.7, HOCHSTETTEN)
    return mpm.study.element_test(law, legs, pressure=100e3, strain="small")


def hypoelastic(test, k):
    """f_s L of the theory at a row of a history: L_yyyy and L_xyxy (per γ) (Pa)."""
    stress = np.diag([test[f"stress_{i}{i}"][k] for i in "xyz"])
    e, trace = test["void_ratio"][k], np.trace(stress)
    sine = np.sin(np.radians(phi))
    a = np.sqrt(3) * (3 - sine) / (2 * np.sqrt(2) * sine)
    hat = stress / trace
    dev = hat - np.eye(3) / 3
    square = np.sum(dev * dev)
    tan = np.sqrt(3 * square)
    cos3 = -np.sqrt(6) * np.trace(dev @ dev @ dev) / square**1.5
    F = np.sqrt(tan**2 / 8 + (2 - tan**2) / (2 + np.sqrt(2) * tan * cos3)) - tan / np.sqrt(8)
    ei = ei0 * np.exp(-((-trace / hs) ** n))
    alpha, beta = HOCHSTETTEN[6:8]
    rest = 3 + a * a - a * np.sqrt(3) * ((ei0 - ed0) / (ec0 - ed0)) ** alpha
    fs = hs / n * (ei / e) ** beta * (1 + ei) / ei * (-trace / hs) ** (1 - n) / rest
    fs /= np.sum(hat * hat)
    return fs * (F**2 + a * a * hat[1, 1] ** 2), fs * F**2 / 2


last, tiny = args.steps, 1e-9
back, across = turned({"yy": -30 * radius + tiny}), turned({"xy": tiny})
normal, shear = hypoelastic(back, last)
facts["m_R"] = float((back["stress_yy"][-1] - back["stress_yy"][last]) / tiny / normal)
facts["m_T"] = float((across["stress_xy"][-1] - across["stress_xy"][last]) / tiny / shear)
size = np.sqrt(sum(back[name][last] ** 2 for name in STRAINS[:3]))
facts["radius"] = float(size / radius)
say(f"Bauer's law to {facts['bauer']:.0e}; friction angle at the end "
    f"{facts['angle']['dense']:.2f}, {facts['angle']['loose']:.2f}° ({phi:.0f}); critical "
    f"void ratio off by {100 * facts['critical']['dense']:+.2f}, "
    f"{100 * facts['critical']['loose']:+.2f} %; "
    f"|h|/R {facts['radius']:.4f}; stiffness over hypoelastic: turn by 180° {facts['m_R']:.3f} "
    f"({m_r}), by 90° {facts['m_T']:.3f} ({m_t})")  # fmt: skip

if not args.no_plot:
    with mpm.figure(args.output / "hypoplastic_sand.png", 7.4, 2.6, ncols=3) as (_, axes):
        one, two, three = axes
        for k, ((e, rows), (stress, void)) in enumerate(zip(OEDOMETERS.items(), paths)):
            one.plot(stress, void, f"C{k}")
            one.plot(*zip(*rows), f"C{k}o", ms=4, mfc="none")
            one.plot((25, 100, 400, 1000), OEDOMETERS_MEASURED[e], f"C{k}x", ms=4)
        one.set(xlabel="vertical stress (kPa)", ylabel="void ratio", title="oedometer")
        for k, ((p, _), rows) in enumerate(TRIAXIALS.items()):
            axial, q, volume = paths[2 + k]
            strain, high, wide = zip(*rows)
            two.plot(axial, q, f"C{k}")
            two.plot(strain, high, f"C{k}o", ms=4, mfc="none")
            two.plot(2.105 * np.arange(5), TRIAXIALS_MEASURED[p], f"C{k}x", ms=4)
            three.plot(axial, volume, f"C{k}")
            three.plot(strain, wide, f"C{k}o", ms=4, mfc="none")
        two.set(xlabel="axial strain (%)", ylabel="q (kPa)", title="triaxial")
        three.set(xlabel="axial strain (%)", ylabel="volume strain (%)", title="triaxial")
        for style, label in (("k-", "this law"), ("ko", "published"), ("kx", "measured")):
            one.plot([], [], style, ms=4, mfc="none", label=label)
        one.legend()

finish(args, {
    "published_error": off, "rounding": allowed, "facts": facts, "expected_m_R": m_r,
    "expected_m_T": m_t, "expected_angle": phi,
})  # fmt: skip
