"""The page of laws: each law taken through the same element tests, one picture per law."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import assemble

ROOT = Path(__file__).resolve().parents[2]
P = 100e3  # first pressure (Pa)


def laws() -> dict[str, tuple[str, Any]]:
    """Title → program text of the law, and the law; all of similar stiffness and strength."""
    import ufl

    import dolfinmpm as mpm

    def energy(e, K, G):
        return (K / 2 - G / 3) * sum(e) ** 2 + G * ufl.inner(e, e)

    sand = [33, 1e9, 0.25, 0.55, 0.95, 1.05, 0.25, 1.5, 1e-4, 5, 2, 0.5, 6, 0, 1e-5]
    history = [f"intergranular_{k}" for k in ("11", "22", "33", "12", "13", "23")]
    state = dict.fromkeys(history, 0.0) | {"void_ratio": 0.7}
    M, folder = mpm.materials, ROOT / "demos" / "umat"
    clay = {"swelling": 0.02, "compression": 0.1, "M": 1.2, "mu0": 5e6, "alpha": 0.0}
    clay |= {"reference_pressure": P, "preconsolidation": 1.3 * P}
    norsand = {"swelling": 0.005, "mu0": 20e6, "alpha": 0.0, "reference_pressure": P, "M": 1.25}
    norsand |= {"N": 0.2, "chi": 3.5, "hardening": 150.0, "critical_void_ratio": 0.82}
    norsand |= {"critical_slope": 0.03, "void_ratio": 0.62, "image_pressure": 50e3}
    small = {"reference_strain": 5e-4, "cohesion": 1e3, "friction_angle": 33.0, "exponent": 0.5}
    return {
        "Hencky": ("Hencky(E=20e6, nu=0.3)", M.Hencky(20e6, 0.3)),
        "NeoHookean": ("NeoHookean(E=20e6, nu=0.3), without a first pressure",
                       M.NeoHookean(20e6, 0.3)),
        "VonMises": ("VonMises(E=20e6, nu=0.3, yield_stress=100e3, hardening=1e6)",
                     M.VonMises(20e6, 0.3, yield_stress=100e3, hardening=1e6)),
        "Tresca": ("Tresca(E=20e6, nu=0.3, cohesion=50e3)", M.Tresca(20e6, 0.3, 50e3)),
        "MohrCoulomb": (
            "MohrCoulomb(E=20e6, nu=0.3, cohesion=1e3, friction_angle=33, dilation_angle=8)",
            M.MohrCoulomb(20e6, 0.3, 1e3, 33.0, dilation_angle=8.0),
        ),
        "DruckerPrager": (
            "DruckerPrager(E=20e6, nu=0.3, cohesion=1e3, friction_angle=33, dilation_angle=8)",
            M.DruckerPrager(20e6, 0.3, 1e3, 33.0, dilation_angle=8.0),
        ),
        "CamClay": (
            "CamClay(swelling=0.02, compression=0.1, M=1.2, mu0=5e6, alpha=0, "
            "reference_pressure=100e3, preconsolidation=130e3)",
            M.CamClay(**clay),
        ),
        "NorSand": (
            "NorSand(swelling=0.005, mu0=20e6, alpha=0, reference_pressure=100e3, M=1.25, N=0.2, "
            "chi=3.5, hardening=150, critical_void_ratio=0.82, critical_slope=0.03, "
            "void_ratio=0.62, image_pressure=50e3): dense sand",
            M.NorSand(**norsand),
        ),
        "HardinDrnevich": (
            "HardinDrnevich(G=60e6, nu=0.2, reference_strain=5e-4, cohesion=1e3, "
            "friction_angle=33, exponent=0.5)",
            M.HardinDrnevich(60e6, 0.2, **small),
        ),
        "EnergyWithYield": (
            "EnergyWithYield(energy, yield_stress=100e3, K=16.7e6, G=7.7e6)",
            M.EnergyWithYield(energy, yield_stress=100e3, K=16.7e6, G=7.7e6),
        ),
        "UMAT": (
            'UMAT("demos/umat/hypoplasticity.f90", ...): dense Hochstetten sand',
            M.UMAT(folder / "hypoplasticity.f90", sand, state),
        ),
    }  # fmt: skip


def draw(law: Any, path: Path, pressure: float) -> None:
    """Drained and undrained triaxial compression, an oedometer and cyclic simple shear."""
    import dolfinmpm as mpm

    test = mpm.study.element_test
    drained = test(law, "triaxial", -0.1, pressure=pressure)
    undrained = test(law, "undrained triaxial", -0.1, pressure=pressure)
    oedometer = test(law, "oedometer", [-4e5, -1e5, -8e5], by="stress", pressure=pressure, steps=50)
    shear = test(law, "simple shear", [0.02, -0.02, 0.02], pressure=pressure, steps=50)
    kPa, percent = 1e-3, 100
    with mpm.figure(path, 9.0, 2.2, ncols=4) as (_, (first, second, third, fourth)):
        first.plot(-percent * drained["strain_yy"], kPa * drained["q"], label="drained")
        first.plot(-percent * undrained["strain_yy"], kPa * undrained["q"], label="undrained")
        first.set(xlabel="axial strain (%)", ylabel="q (kPa)", title="triaxial")
        first.legend()
        second.plot(kPa * drained["p"], kPa * drained["q"])
        second.plot(kPa * undrained["p"], kPa * undrained["q"])
        second.set(xlabel="p' (kPa)", ylabel="q (kPa)", title="stress paths")
        third.plot(-kPa * oedometer["stress_yy"], -percent * oedometer["strain_yy"])
        third.set(xlabel="vertical stress (kPa)", ylabel="strain (%)", title="oedometer")
        third.invert_yaxis()
        fourth.plot(percent * shear["strain_xy"], kPa * shear["stress_xy"])
        fourth.set(xlabel="shear strain (%)", ylabel="shear stress (kPa)", title="simple shear")


def write_page(write: Any, source: Path, runs: bool) -> None:
    """Write reference/laws.md, and the pictures if programs run or a picture is missing."""
    folder, page = source / "reference" / "laws", source / "reference" / "laws.md"
    sources = Path(__file__), *sorted((ROOT / "demos" / "umat").glob("*.f*"))
    runs = runs and not assemble.is_made(page, *sources)
    lines = [
        "# Laws by element tests",
        "",
        "Each law goes through the same tests at a first pressure of 100 kPa, by",
        "{func}`dolfinmpm.study.element_test`: triaxial compression to 10 % of axial strain,",
        "drained and undrained; an oedometer with unloading; and simple shear with turns.",
        "The build of the site draws the pictures.",
        "[How to take a law through a test](../howto/umat.md).",
        "",
    ]
    for name, (text, law) in laws().items():
        picture = folder / f"{name}.png"
        if runs or not picture.exists():
            draw(law, picture, 0.0 if name == "NeoHookean" else P)
        lines += [f"## {name}", "", f"`{text}`", "", f"![{name}](laws/{name}.png)", ""]
    write(page, "\n".join(lines))
    if runs:
        assemble.mark_made(page, *sources)
