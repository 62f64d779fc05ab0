# %% [markdown]
# # NorSand: triaxial paths of Erksak sand, from very dense to loose
#
# The parameters are those that Jefferies & Been (2016, Soil Liquefaction, section 3.7) found for
# Erksak 330/0.7 sand from drained triaxial tests at 60 to 1000 kPa: Γ = 0.816, λ₁₀ = 0.031,
# M = 1.26, N = 0.35, χ = 3.5, H = 103 − 980 ψ₀, and a shear stiffness by the void ratio. The state
# parameter ψ₀ = e − e_c(p) is the only thing that differs from test to test.
#
# Their theory says exactly, for each test:
#
# - drained: at the peak the dilatancy is $D = \chi\psi_i$ and $\eta = M - (1 - N)\,D$;
# - drained, at the end: $\eta = M$ and $e = \Gamma - \lambda\ln p$;
# - undrained, at the end: $q = M p_0 \exp(-\psi_0/\lambda)$: a little looser, and little is left.
#   So loose sand liquefies, and dense sand gains strength: more than grains bear, so that this is
#   compared for ψ₀ ≥ −0.05 only.
#
# The law is the one of Borja & Andrade (2006), whose M does not depend on the state. Jefferies &
# Been's N is in M_i instead. Both have the same peak and the same critical state.

# %%
import math
from dataclasses import dataclass

import numpy as np
from options import Options, natural, option, values
from scene import finish, say

import dolfinmpm as mpm


@dataclass
class Input(Options):
    """Triaxial paths of Erksak sand by NorSand, beside the exact facts of the theory."""

    states: list[float] = option([-0.2, -0.15, -0.1, -0.05, 0.0, 0.03, 0.06], "ψ₀", least=-0.25,
                                 most=0.08, type=values(float))  # fmt: skip
    pressures: list[float] = option([60e3, 250e3, 1000e3], "(Pa)", above=0, type=values(float))
    steps: int = natural(150, "of each leg of a path")


args = Input.parse()
GAMMA, LAMBDA, M, N, CHI, NU = 0.816, 0.031 / math.log(10), 1.26, 0.35, 3.5, 0.2


def erksak(psi, p):
    """The sand with a state parameter at an isotropic pressure (Pa), and its void ratio."""
    e = GAMMA - LAMBDA * math.log(p / 1e3) + psi
    # K/σ = 260/(e − 0.355) √(p/σ), σ = 100 kPa
    K = 260 / (e - 0.355) * math.sqrt(p / 100e3) * 100e3
    tip = (1 - N) ** ((N - 1) / N)
    law = mpm.materials.NorSand(
        swelling=p / K, mu0=1.5 * K * (1 - 2 * NU) / (1 + NU), alpha=0.0, reference_pressure=p,
        M=M, N=N, chi=CHI, hardening=103.0 - 980.0 * psi, critical_void_ratio=GAMMA,
        critical_slope=LAMBDA, void_ratio=e, image_pressure=p / tip,
    )  # fmt: skip
    return law, e


def of(psi, p):
    """Rows of a drained and an undrained test, and what is exact in them."""
    law, e = erksak(psi, p)
    options = {"pressure": p, "strain": "small"}
    options |= {"steps": args.steps}
    drained = mpm.study.element_test(law, "triaxial", [-0.15, -1.5], **options)
    eta = drained["q"] / drained["p"]
    peak = int(np.argmax(eta))
    pi = drained["image_pressure"][peak]
    psi_i = drained["void_ratio"][peak] - (GAMMA - LAMBDA * math.log(pi / 1e3))
    critical = GAMMA - LAMBDA * math.log(drained["p"][-1] / 1e3)
    # the critical state comes the later, the smaller the hardening
    end = -0.15 - 350.0 / (103.0 - 980.0 * psi)
    undrained = mpm.study.element_test(law, "undrained triaxial", [-0.15, end], **options)
    left = M * p * math.exp(-psi / LAMBDA)
    return {
        "psi": psi, "p": p, "peak": float(eta[peak]), "e": e,
        "peak_exact": M - (1 - N) * CHI * psi_i,
        "end": float(eta[-1]), "void_error": float(drained["void_ratio"][-1] - critical),
        "residual": float(undrained["q"][-1] / left), "brittle": float(
            1 - undrained["q"][-1] / undrained["q"].max()),
    }, drained, undrained  # fmt: skip


# %% [markdown]
# ## The tests

# %%
rows, curves = [], {}
say("      ψ₀   p (kPa)   peak q/p   exact   end q/p   e − e_c    q/exact, undrained   lost (%)")
for p in args.pressures:
    for psi in args.states:
        row, drained, undrained = of(psi, p)
        rows.append(row)
        if p == args.pressures[len(args.pressures) // 2]:
            curves[psi] = drained, undrained
        say(f"{psi:+8.2f} {1e-3 * p:9.0f} {row['peak']:10.3f} {row['peak_exact']:7.3f} "
            f"{row['end']:9.4f} {row['void_error']:+9.1e} {row['residual']:20.4f} "
            f"{100 * row['brittle']:10.0f}")  # fmt: skip

worst = {
    "peak": max(abs(row["peak"] / row["peak_exact"] - 1) for row in rows),
    "end": max(abs(row["end"] / M - 1) for row in rows),
    "void_ratio": max(abs(row["void_error"]) for row in rows),
    "residual": max((abs(r["residual"] - 1) for r in rows if r["psi"] >= -0.05), default=0.0),
}
say("largest errors: peak {peak:.1e}, critical stress ratio {end:.1e}, critical void ratio "
    "{void_ratio:.1e}, undrained strength {residual:.1e}".format(**worst))  # fmt: skip

if not args.no_plot:
    with mpm.figure(args.output / "norsand_paths.png", 7.4, 2.7, ncols=3) as (_, (one, two, three)):
        for psi, (drained, undrained) in curves.items():
            early = -drained["strain_yy"] <= 0.2
            axial = -100 * drained["strain_yy"][early]
            one.plot(axial, (drained["q"] / drained["p"])[early], label=f"{psi:+.2f}")
            two.plot(axial, 100 * drained["volume_strain"][early])
            three.plot(1e-3 * undrained["p"], 1e-3 * undrained["q"])
        p = np.linspace(0, 500.0)
        three.plot(p, M * p, "k--", lw=0.8)
        one.set(xlabel="axial strain (%)", ylabel="q/p", title="drained")
        two.set(xlabel="axial strain (%)", ylabel="volume strain (%)", title="drained")
        three.set(xlabel="p' (kPa)", ylabel="q (kPa)", title="undrained", xlim=(0, 500))
        three.set_ylim(0, 650)
        one.legend(title="state ψ₀", fontsize=7, ncols=2)

finish(args, {"rows": rows, "worst": worst})
