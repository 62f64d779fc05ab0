"""The pictures of the theory section, and some of its figures.

    docker/run python3 docs/theory/figures.py              all of them: a minute
    docker/run python3 docs/theory/figures.py bases cuts   some of them

The pictures go to the folder of this file, with the same bytes each time. Figures of a picture are
also printed.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path

import matplotlib as mpl
import numpy as np
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

import dolfinmpm as mpm
from dolfinmpm import study
from dolfinmpm.body.points import GHOST_FACETS

HERE = Path(__file__).resolve().parent
COMM = MPI.COMM_WORLD
QUADRILATERAL = mesh.CellType.quadrilateral


def active() -> None:
    """Active cells, cut cells and ghost facets of a disc."""
    n, h = 10, 1.0
    grid = mesh.create_rectangle(COMM, [(0, 0), (n, n)], (n, n), QUADRILATERAL)
    points = mpm.fill(grid, mpm.Disc((5.2, 4.9), 3.3), 2, 1.0)
    V = mpm.Space(grid, "gimp")
    law = mpm.materials.Hencky(E=1.0, nu=0.3)
    F = mpm.momentum(law, points, V.increment, V.test)
    problem = mpm.QuasiStatic(F, V.increment, points, stabilisation="ghost")
    field = problem.activate().fields[0]
    middles = mesh.compute_midpoints(grid, 2, np.arange(n * n, dtype=np.int32))[:, :2]
    is_active = field.cells[: n * n]
    facets = field.entities[GHOST_FACETS].reshape(-1, 4)
    print(f"{is_active.sum()} active cells, {len(facets)} ghost facets")
    with mpm.figure(HERE / "active.svg", 3.4, 3.1) as (_, ax):
        from matplotlib.patches import Rectangle

        for (x, y), on in zip(middles, is_active):
            colour = "#cfe3f1" if on else "white"
            corner = x - h / 2, y - h / 2
            ax.add_patch(Rectangle(corner, h, h, facecolor=colour, edgecolor="0.7", lw=0.5))
        for k, (one, _, other, _) in enumerate(facets):
            a, b = middles[one], middles[other]
            middle, along = 0.5 * (a + b), np.array([a[1] - b[1], b[0] - a[0]]) / 2
            ends = np.array([middle - along, middle + along])
            ax.plot(*ends.T, color="C1", lw=2, label="ghost facets" if k == 0 else None)
        ax.plot(*points["x"].T, ".", ms=2.5, color="0.2", label="material points")
        ax.set(xlim=(0, n), ylim=(0, n), aspect="equal", xticks=[], yticks=[])
        ax.grid(False)
        ax.legend(loc="upper left", frameon=True, framealpha=1.0, borderpad=0.3)


def bases() -> None:
    """Value and gradient of one function at a point that moves."""
    grid = mesh.create_interval(COMM, 8, [0.0, 8.0])
    x = np.linspace(1.5, 7.0, 551)[:, None]
    points = mpm.MaterialPoints.from_arrays(
        grid, x, np.full(len(x), 0.5), half_length=np.full(x.shape, 0.25), density=1.0
    )
    points.overlapping = True
    law = mpm.materials.Hencky(E=1.0, nu=0.0)
    kinds = {
        "linear": ("linear", {}),
        "GIMP": ("gimp", {}),
        "quadratic spline": ("bspline2", {}),
    }
    with mpm.figure(HERE / "bases.svg", 5.6, 2.3, ncols=2) as (_, (left, right)):
        for name, (basis, options) in kinds.items():
            V = mpm.Space(grid, basis, **options)
            F = mpm.momentum(law, points, V.increment, V.test)
            field = mpm.QuasiStatic(F, V.increment, points).activate().fields[0]
            rows = [field.stencils.row(p) for p in range(len(x))]
            # the function whose mean place is in the middle
            nodes = field.basis.node_coordinates()[:, 0]
            a = int(np.argmin(abs(nodes - (4.0 if basis != "bspline2" else 4.5))))
            N, dN = np.zeros(len(x)), np.zeros(len(x))
            for p, (own, values, slopes) in enumerate(rows):
                at = np.flatnonzero(own == a)
                if at.size:
                    N[p], dN[p] = values[at[0]], slopes[at[0], 0]
            centre = (x[:, 0] * N).sum() / N.sum()
            left.plot(x - centre, N, label=name)
            right.plot(x - centre, dN, label=name)
            print(f"{name}: largest jump of the gradient {abs(np.diff(dN)).max():.3f}/h")
        left.set(xlabel="place of the point, $x_p/h$", ylabel="$S_{ap}$", xlim=(-2, 2))
        right.set(xlabel="place of the point, $x_p/h$", ylabel=r"$h\,\nabla S_{ap}$", xlim=(-2, 2))
        left.legend()


def block(offset: float, stabilisation: str) -> study.Conditioning:
    """The bar of Coombs (2023): four cells long, two points per cell, E = ρ = h = 1."""
    grid = mesh.create_interval(COMM, 8, [0.0, 8.0])
    points = mpm.fill(grid, mpm.Box(2 + offset, 6 + offset), 2, 1.0, aligned="body")
    V = mpm.Space(grid, "gimp")
    F = mpm.momentum(mpm.materials.Hencky(E=1.0, nu=0.0), points, V.increment, V.test)
    options = {"threshold": 0.995} if stabilisation == "aggregation" else {}
    chosen = mpm.Stabilisation(stabilisation, E=1.0, nu=0.0, **options)
    return study.conditioning(mpm.QuasiStatic(F, V.increment, points, stabilisation=chosen), 1.0)


def cuts() -> None:
    """Condition numbers and critical steps of a bar anywhere on the grid."""
    offsets = np.concatenate([np.geomspace(1e-6, 0.1, 16), np.linspace(0.13, 0.999, 26)])
    names = {"none": "none", "ghost": "ghost penalty", "aggregation": "aggregation"}
    with mpm.figure(HERE / "cuts.svg", 6.6, 2.3, ncols=3) as (_, (left, middle, right)):
        for kind, label in names.items():
            found = [block(float(a), kind) for a in offsets]
            left.loglog(offsets, [c.kappa_K for c in found], label=label)
            middle.loglog(offsets, [c.kappa_M for c in found], label=label)
            right.loglog(offsets, [c.dt_consistent for c in found], label=label)
            print(
                f"{label}: κ(K) {max(c.kappa_K for c in found):.4g}, "
                f"κ(M) {max(c.kappa_M for c in found):.4g}, "
                f"Δt c/h {min(c.dt_consistent for c in found):.4g} consistent, "
                f"{min(c.dt_lumped for c in found):.4g} lumped"
            )
        left.set(xlabel="offset of the bar $/h$", ylabel="$\\kappa(K)$")
        middle.set(xlabel="offset of the bar $/h$", ylabel="$\\kappa(M)$")
        right.set(xlabel="offset of the bar $/h$", ylabel=r"$\Delta t_\mathrm{crit}\,c/h$")
        left.legend()


def shear() -> None:
    """Simple shear of one cell by three strain formulations."""
    steps, last = 800, 8.0
    with mpm.figure(HERE / "shear.svg", 3.4, 2.4) as (_, ax):
        for strain in ("large", "jaumann", "small"):
            grid = mesh.create_rectangle(COMM, [(0, 0), (12, 1)], (12, 1), QUADRILATERAL)
            points = mpm.fill(grid, mpm.Box((1, 0), (2, 1)), 2, 1.0)
            V = mpm.Space(grid, "linear")
            law = mpm.materials.Hencky(E=2.0, nu=0.0)  # μ = 1
            F = mpm.momentum(law, points, V.increment, V.test, strain=strain)
            everywhere = lambda x: np.full(x.shape[1], True)  # noqa: E731
            bcs = mpm.prescribed(V, everywhere, 0, increment=lambda x: last / steps * x[1])
            bcs += mpm.prescribed(V, everywhere, 1, increment=0.0)
            problem = mpm.QuasiStatic(F, V.increment, points, bcs)
            gamma, tau = [0.0], [0.0]
            for k in range(steps):
                problem.step()
                gamma.append(last * (k + 1) / steps)
                tau.append(float(points["stress"][:, 0, 1].mean()))
            ax.plot(gamma, tau, label=strain)
            print(f"{strain}: σ₁₂/μ {np.interp(1.0, gamma, tau):.4f} at γ = 1, "
                  f"{max(tau):.4f} at most, {tau[-1]:.4f} at γ = {last:g}")  # fmt: skip
        ax.set(xlabel=r"shear $\gamma$", ylabel=r"$\sigma_{12}/\mu$", ylim=(-1.2, 2.2))
        ax.legend()


def footing(fbar: bool) -> tuple[list[float], list[float]]:
    """Settlements (m) and bearing factors of the strip footing of demos/footing.py."""
    h = 0.0625
    grid = mesh.create_rectangle(COMM, [(0, 0), (4, 2 + h)], (64, 33), QUADRILATERAL)
    points = mpm.fill(grid, mpm.Box((0, 0), (4, 2)), 2, 1000.0)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    E, c = 1e8, 10e3
    F = mpm.momentum(mpm.materials.Tresca(E, 0.33, cohesion=c), points, u, v, fbar=fbar)
    under = mpm.Surface(points, lambda x: np.isclose(x[1], 2) & (x[0] < 1), normal=(0, 1))
    settlement = fem.Constant(grid, 0.0)
    foot = mpm.RigidFooting(under, settlement, rough=False, E=E)
    F += foot.contact(u, v)
    bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
    problem = mpm.QuasiStatic(F, u, points, bcs, stabilisation="aggregation")
    down, factors = [0.0], [0.0]
    for share in mpm.steps(20, label=f"fbar={fbar}"):
        settlement.value = 4e-3 * share
        problem.step()
        down.append(4e-3 * share)
        factors.append(float(foot.load()) / c)
    return down, factors


def locking() -> None:
    """Load of a strip footing with and without F-bar."""
    with mpm.figure(HERE / "locking.svg", 3.4, 2.4) as (_, ax):
        for fbar in (False, True):
            down, factors = footing(fbar)
            ax.plot(1e3 * np.array(down), factors, label="F-bar" if fbar else "no F-bar")
            print(f"fbar={fbar}: q/c {factors[10]:.3f} at 2 mm, {factors[-1]:.3f} at 4 mm")
        ax.axhline(2 + np.pi, color="0.4", ls=":", lw=1)
        ax.text(0.05, 2 + np.pi + 0.07, r"$2+\pi$", color="0.3")
        ax.set(xlabel="settlement (mm)", ylabel="$q/c$", ylim=(0, 6.5))
        ax.legend(loc="lower right")


def swing(mass: str, mapping: mpm.Mapping) -> tuple[list[float], list[float]]:
    """Times (s) and shares of the energy of the bar of demos/vibrating_bar.py."""
    grid = mesh.create_interval(COMM, 28, [0.0, 28.0])
    points = mpm.fill(grid, mpm.Box((0.0,), (25.0,)), 2, 1.0)
    V = mpm.Space(grid, "gimp")
    F = mpm.momentum(mpm.materials.Hencky(E=100.0, nu=0.0), points, V.increment, V.test)
    points.add_field("velocity", (1,), "m/s", lambda x: 0.1 * np.sin(np.pi * x.T / 50))
    problem = mpm.Newmark(
        F, V.increment, points, mpm.fixed(V, "left"), mass=mass, mapping=mapping,
        stabilisation="ghost" if mass == "consistent" else "none",
    )  # fmt: skip
    times, energy = [0.0], [1.0]
    for t in mpm.times(50.0, dt=0.1, label=f"{mass}, {mapping.kind}"):
        problem.step(t)
        now = problem.energies()
        times.append(t)
        energy.append((now.kinetic + now.strain) / now.initial)
    return times, energy


def mappings() -> None:
    """Energy of a bar over five periods, by mass and mapping."""
    cases = [
        ("consistent", mpm.Mapping("pic"), "consistent, PIC"),
        ("lumped", mpm.Mapping("accel"), "lumped, accel"),
        ("lumped", mpm.Mapping("flip"), "lumped, FLIP"),
        ("lumped", mpm.Mapping("xpic", order=5), "lumped, XPIC(5)"),
        ("lumped", mpm.Mapping("xpic", order=2), "lumped, XPIC(2)"),
        ("lumped", mpm.Mapping("pic"), "lumped, PIC"),
    ]
    with mpm.figure(HERE / "mappings.svg", 5.6, 2.3, ncols=2) as (_, (left, right)):
        for mass, mapping, label in cases:
            times, energy = swing(mass, mapping)
            for ax in (left, right):
                ax.plot(times, energy, label=label)
            print(f"{label}: {energy[-1]:.5f} of the energy after five periods")
        left.set(xlabel="time (s)", ylabel="energy / initial energy", ylim=(0.65, 1.02))
        right.set(xlabel="time (s)", ylim=(0.985, 1.001))
        left.legend(loc="lower left")


def newton() -> None:
    """Out-of-balance forces of single steps (printed)."""
    grid = mesh.create_rectangle(COMM, [(0, 0), (1, 60)], (1, 60), QUADRILATERAL)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    gravity = fem.Constant(grid, (0.0, 0.0))
    for kind in ("none", "soft"):
        body = mpm.fill(grid, mpm.Box((0, 0), (1, 50)), 2, 80.0)
        weight = ufl.inner(body.density * gravity, v) * body.dX
        F = mpm.momentum(mpm.materials.Hencky(E=10e3, nu=0.0), body, u, v) - weight
        bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
        chosen = mpm.Stabilisation("soft", eta=1e-2) if kind == "soft" else "none"
        every = {"snes_lag_jacobian": 1}
        problem = mpm.QuasiStatic(F, u, body, bcs, stabilisation=chosen, petsc_options=every)
        counts = []
        for load in mpm.steps(40, label=kind):
            gravity.value[1] = -10.0 * load
            counts.append(problem.step().iterations)
        last = ", ".join(f"{r:.1e}" for r in problem.history[-1].residuals)
        print(f"column, {kind}: at most {max(counts)} iterations per step; last step {last}")
        gravity.value[1] = 0.0


def tangents() -> None:
    """Tangents of the laws against central differences of their stresses (printed)."""
    laws = {
        "von Mises": mpm.materials.VonMises(1e6, 0.3, yield_stress=20e3, hardening=1e5),
        "Tresca": mpm.materials.Tresca(1e6, 0.3, 10e3, ultimate_cohesion=15e3),
        "Mohr–Coulomb": mpm.materials.MohrCoulomb(1e6, 0.3, 10e3, 30.0, dilation_angle=10.0),
        "Drucker–Prager": mpm.materials.DruckerPrager(1e6, 0.3, 10e3, 30.0, dilation_angle=10.0),
        "Cam-Clay": mpm.materials.CamClay(
            swelling=0.018, compression=0.13, M=1.05, mu0=5.4e6, alpha=0.0,
            reference_pressure=20e3, preconsolidation=20e3,
        ),
    }  # fmt: skip
    rng = np.random.default_rng(1)
    strain = rng.uniform(-0.03, 0.03, (2000, 3))
    for name, law in laws.items():
        found = law.respond(strain)
        errors = []
        for j in range(3):
            step = np.zeros(3)
            step[j] = 1e-6
            two = law.respond(strain + step).stress - law.respond(strain - step).stress
            errors.append(abs(two / 2e-6 - found.tangent[:, :, j]).max(axis=1))
        error = np.max(errors, axis=0) / abs(found.tangent).max()
        changed = abs(found.internal - law.respond(0 * strain[:1]).internal).max(axis=1) > 0
        print(
            f"{name}: {changed.mean():.0%} of the strains yield, median error of the tangent "
            f"{np.median(error):.0e}, {np.mean(error < 1e-6):.1%} below 1e-6"
        )


def costs() -> None:
    """Processor time and iterations of one slope, by basis and by stabilisation (printed)."""
    import time

    bases = ("linear", "gimp", "bspline2", "bspline3")
    kinds = ("none", "ghost", "aggregation", "extended", "weak-aggregation", "soft")
    cases = [(basis, "ghost") for basis in bases] + [("gimp", kind) for kind in kinds]
    cases = list(dict.fromkeys(cases))
    taken: dict[tuple[str, str], list[float]] = {case: [] for case in cases}
    told: dict[tuple[str, str], str] = {}
    for _ in range(4):  # the first run compiles; the others take turns under the same load
        for case in cases:
            problem, gravity = _slope(*case)
            began = time.process_time()
            try:
                for share in (0.25, 0.5, 0.75, 1.0):
                    gravity.value[1] = -9.81 * share
                    problem.step()
                end = "comes to the end"
            except mpm.errors.DolfinMPMError as error:
                end = f"fails ({type(error).__name__})"
            taken[case].append(time.process_time() - began)
            rows = problem.history
            told[case] = f"{end}, {sum(row.iterations for row in rows)} iterations"
    unit = min(taken["gimp", "ghost"][1:])
    points = problem.points.total
    print(f"{points} points, unit {1e6 * unit / 4 / points:.1f} µs per point and step")
    for case in cases:
        ratio = min(taken[case][1:]) / unit
        print(*case, f"time {ratio:.2f}, {told[case]}")


def _slope(basis: str, stabilisation: str):
    """A slope of Mohr–Coulomb soil whose face cuts cells, and its gravity."""
    grid = mesh.create_rectangle(COMM, [(0, 0), (16, 8)], (96, 48), QUADRILATERAL)
    body = mpm.Polygon([(0, 0), (16, 0), (16, 2.1), (11, 2.1), (6, 6.1), (0, 6.1)])
    points = mpm.fill(grid, body, per_cell=2, density=2000.0)
    V = mpm.Space(grid, basis=basis)
    u, v = V.increment, V.test
    gravity = fem.Constant(grid, (0.0, 0.0))
    soil = mpm.materials.MohrCoulomb(50e6, 0.3, 9e3, 25.0, dilation_angle=0.0)
    F = mpm.momentum(soil, points, u, v) - ufl.inner(points.density * gravity, v) * points.dX
    bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
    options = {"stabilisation": stabilisation, "tolerance": 1e-6, "max_halvings": 3}
    return mpm.QuasiStatic(F, u, points, bcs, **options), gravity


def leaves() -> None:
    """Leaves and points beside a disc that is pressed into the ground."""
    grid = mpm.create_lattice(COMM, [np.arange(7.0), np.arange(5.0)])
    disc = mpm.RigidBody(mpm.Disc((3.0, 3.3), 0.8), increment=(0.0, 0.0))
    V = mpm.Space(grid, "gimp", refine=mpm.near(disc, 0.25, reach=0.0), levels=2)
    ground = mpm.Box((0, 0), (6, 3)) - mpm.Disc((3.0, 3.3), 0.8)
    points = mpm.fill(grid, ground, per_cell=2, density=1.0, refine=V)
    law = mpm.materials.Hencky(E=1.0, nu=0.3)
    F = mpm.momentum(law, points, V.increment, V.test)
    basis = mpm.QuasiStatic(F, V.increment, points).activate().fields[0].basis
    low, high = basis.cell_corners()
    hanging = basis.node_coordinates()[np.flatnonzero(basis.hangs), :2]
    print(f"{len(low)} leaves, {len(hanging)} hanging nodes, {points.total} points")
    with mpm.figure(HERE / "leaves.svg", 4.6, 3.1) as (_, ax):
        from matplotlib.patches import Circle, Rectangle

        for corner, end in zip(low, high):
            box = Rectangle(corner, *(end - corner), facecolor="#cfe3f1", edgecolor="0.5", lw=0.5)
            ax.add_patch(box)
        ax.add_patch(Circle((3.0, 3.3), 0.8, facecolor="0.85", edgecolor="0.3"))
        ax.plot(*points["x"].T, ".", ms=2, color="0.2", label="material points")
        ax.plot(*hanging.T, "o", ms=3.5, mfc="white", color="C1", label="hanging nodes")
        ax.set(xlim=(0, 6), ylim=(0, 4.2), aspect="equal", xticks=[], yticks=[])
        ax.grid(False)
        ax.legend(loc="upper left", frameon=True, framealpha=1.0, borderpad=0.3)


def hierarchical() -> None:
    """Quadratic splines on leaves of three sizes in 1D."""
    grid = mesh.create_interval(COMM, 8, (0.0, 8.0))
    wanted = {"refine": lambda x: 0.2503 + 0.4 * np.abs(x[0] - 4.0), "levels": 2}
    V = mpm.Space(grid, "bspline2", **wanted)
    points = mpm.fill(grid, mpm.Box((0,), (8,)), per_cell=2, density=1.0, refine=V)
    law = mpm.materials.Hencky(E=1.0, nu=0.0)
    F = mpm.momentum(law, points, V.increment, V.test)
    basis = mpm.QuasiStatic(F, V.increment, points).activate().fields[0].basis
    low, high = basis.cell_corners()
    x = np.linspace(0, 8, 1601)[:, None]
    rows, N = basis.values_at(x)
    values = (N @ basis.hanging).toarray()
    print(f"{len(low)} leaves, {(~basis.hangs).sum()} splines, sum {values.sum(axis=1).min():.15f}")
    with mpm.figure(HERE / "hierarchical.svg", 5.6, 1.9) as (_, ax):
        for level in range(3):
            own = values[:, ~basis.hangs & (basis.levelled[:, 0] == level)]
            lines = ax.plot(x[rows, 0], np.where(own > 0, own, np.nan), color=f"C{level}", lw=1.0)
            lines[0].set_label(f"cells of {2.0**-level:g}")
        ends = np.unique(np.concatenate([low[:, 0], high[:, 0]]))
        ax.vlines(ends, -0.06, 0, color="0.3", lw=0.8)
        ax.set(xlim=(0, 8), ylim=(-0.06, 1.25), xlabel="$x$", ylabel="splines")
        ax.legend(loc="upper center", ncols=3)


PARTS = active, bases, cuts, shear, locking, mappings, newton, tangents, costs, leaves, hierarchical
PICTURES = {f.__name__: f for f in PARTS}

if __name__ == "__main__":
    # no times and no random names in the files
    os.environ["SOURCE_DATE_EPOCH"] = "0"
    mpl.rcParams["svg.hashsalt"] = "theory"
    options = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    options.add_argument("names", nargs="*", help=", ".join(PICTURES))
    for name in options.parse_args().names or PICTURES:
        PICTURES[name]()
