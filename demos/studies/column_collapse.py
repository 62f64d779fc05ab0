# %% [markdown]
# # A column of sand collapses
#
# Bui, Fukagawa, Sako & Ohno (2008, doi 10.1002/nag.688) piled up small aluminium bars, 0.2 m wide
# and 0.1 m high, took away the wall beside them, and measured the surface when all had come
# to rest, and the line along which the pile had failed. Nguyen and others (2017) calibrated a
# Mohr–Coulomb material by it, and Xie and others (doi 10.1002/nag.3599) compared explicit and
# implicit material point methods on it:
#
# - $E = 5.84$ MPa, $\nu = 0.3$, $\varphi = 21.9°$, no cohesion, no dilation, 2040 kg/m³
#   at $g = 10$ m/s²;
# - a fixed base, a smooth wall on the left, none on the right; the whole of gravity at $t = 0$,
#   when the sand has no stress;
# - 0.607 s, in which all motion dies down.
#
# **The law of sand without cohesion.** At the surface, and where the front of the heap breaks up,
# points lose all contact: they have been stretched, and sand has no tension.
# `mpm.materials.MohrCoulomb` returns to the apex of the pyramid, $\tau = 0$ for $c = 0$. Stress
# and elastic strain become zero, and all strain is plastic. Such a point has no stiffness. It
# falls freely, by its inertia alone, and has stress again when it is compressed. In implicit
# steps the mass in $K + 4M/\Delta t^2$ makes the equations solvable.

# %%
from __future__ import annotations

import itertools
import time
from dataclasses import dataclass

import numpy as np
import ufl
from collapse_pictures import MEASURED, PLACES, picture, variants_picture
from dolfinx import fem
from grids import box_grid
from mpi4py import MPI
from options import BASES, Options, natural, option, positive, switch
from scene import finish, say

import dolfinmpm as mpm

COLUMN = 0.01
STRAINS = "large", "small", "jaumann"
TIMES = [0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.45, 0.5]


# %%
@dataclass
class Input(Options):
    """A column of sand collapses under its weight."""

    width: float = positive(0.2, "(m)")
    height: float = positive(0.1, "(m)")
    modulus: float = positive(0.84e6, "Young's (Pa)")
    poisson: float = 0.3
    friction_angle: float = option(21.9, "(degrees)")
    density: float = positive(2040.0, "(kg/m³)")
    gravity: float = option(10.0, "(m/s²)")
    h: float = positive(0.005, "size of the cells (m)")
    points_per_cell: int = natural(2, "in each direction")
    basis: str = option("gimp", choices=BASES)
    domains: str = option("fixed", "how they grow", choices=("stretch", "volume", "fixed"))
    fbar: str = switch("on")
    means: str = option("auto", "F-bar's; see below", choices=("auto", "centres", "domains"))
    strain: str = option("large", choices=STRAINS)
    integrator: str = option("explicit", choices=("implicit", "explicit"))
    law: str = option("mohr-coulomb", choices=("mohr-coulomb", "drucker-prager"))
    duration: float = positive(0.607, "(s)")
    times: list[float] = option(TIMES, "at which to measure (s), by commas", above=0)
    scheme: str = option("musl", "explicit", choices=("musl", "usl", "usf"))
    courant: float = option(0.8, "explicit: of the stable step")
    dt: float = positive(5e-4, "implicit: step (s)")
    mass: str = option("lumped", choices=("lumped", "consistent"))
    mapping: str | None = option(None, "of velocities; see below")
    stabilisation: str = option("none", "besides that of the mass")
    full: bool = option(False, "115 200 points: E = 5.84 MPa, h = 2.5 mm, 6² a cell")
    variants: bool = option(False, "all of the lists below")
    integrators: list[str] = option(["implicit", "explicit"], choices=("implicit", "explicit"))
    bases: list[str] = option(["linear", "gimp", "bspline2"], choices=BASES)
    fbars: list[str] = option(["on", "off"], choices=("on", "off"))
    strains: list[str] = option(list(STRAINS), choices=STRAINS)

    def _check(self):
        if self.full:
            self.modulus, self.h, self.points_per_cell = 5.84e6, 0.0025, 6
        if self.times != sorted(self.times):
            raise ValueError("times must rise")
        self.times = [t for t in self.times if t < self.duration] + [self.duration]


# %% [markdown]
# ## Mass and mapping
# Explicit steps take the lumped mass and "flip", in the order "musl".
#
# Implicit ones take the lumped mass with "accel", as Xie and others do. The consistent mass with
# "pic" (`--mass consistent`) is a projection, which damps nothing in the middle of a body; but its
# ghost penalty, which it cannot do without, acts along the surface, and all sand that runs is
# near the surface. On 10 mm cells with quadratic splines, F-bar and steps of 1 ms the 99 % point
# comes to 0.349 m with it and to 0.420 m with the lumped mass, of 0.42 m in explicit steps; the
# surfaces are off the measured one by 4.7 and 2.9 mm.
#
# There is no ghost penalty of the stiffness: it would act on the increments of flow as a
# viscosity $E\,\Delta t/30$.
#
# Points' domains keep their size. With the stretch that of a point at the front, where F grows
# without bound, would come to span the whole grid: the front stops too early, and of the kinetic
# energy at 0.45 s a third is gone. That they grow with the volume (`--domains volume`) changes
# little.
#
# ## What F-bar takes the mean of
# Explicit steps with GIMP count each point in the cell of its centre ("centres"), as explicit codes
# do. Where domains share themselves out among the cells that they overlap ("domains") neighbouring
# cells have nearly the same mean, there is less freedom to change shape at constant volume, and the
# sand comes to rest later: at 0.607 s it has 15 % more kinetic energy, and before 0.4 s less than
# 2 % of a difference. Splines take means over splines one degree lower, implicit steps the
# shares of domains, whose tangent does not jump when points cross into the next cell.
#
# With $E = 5.84$ MPa, 2080 kg/m³ at 9.81 m/s², cells of 5 mm and 2² points an independent explicit
# GIMP code has 99 % of the sand left of 0.225, 0.303, 0.366, 0.406, 0.426 and 0.428 m at 0.1, 0.2,
# 0.3, 0.4, 0.5 and 0.607 s, and a kinetic energy of 1.04, 1.08, 0.750, 0.409, 0.200 and 0.107 J/m.
# The same comes out here within 0.3 % and 1.6 %, and the heights at rest within 3.3 mm. They are
# off the measured ones by 1.9 mm (root mean square). Where the heap is thin single rows of
# points count: with domains that grow with the volume it is 10.6 mm high at 0.362 m, not 12.9.


# %%
def law_of(args):
    """The law; the cone is that which fits the pyramid in plane strain."""
    E, nu, phi = args.modulus, args.poisson, args.friction_angle
    if args.law == "mohr-coulomb":
        return mpm.materials.MohrCoulomb(E, nu, cohesion=0.0, friction_angle=phi)
    return mpm.materials.DruckerPrager(
        E, nu, cohesion=0.0, friction_angle=phi, dilation_angle=0.0, fit="plane strain"
    )


def problem_of(args, integrator, basis, fbar, strain):
    """The points and the problem of one run. Collective."""
    h = args.h
    # centres of quadratic splines lie in the middle of cells
    first = -2.5 * h if basis == "bspline2" else -2.0 * h
    extent = 3.5 * args.width - first, 1.6 * args.height - first
    cells = [round(np.ceil(side / h - 1e-9)) for side in extent]
    corners = [first] * 2, [first + n * h for n in cells]
    grid = box_grid(corners, cells)
    sand = mpm.Box((0, 0), (args.width, args.height))
    points = mpm.fill(grid, sand, args.points_per_cell, args.density, aligned="body")
    V = mpm.Space(grid, basis, domains=args.domains)
    u, v = V.increment, V.test
    gravity = fem.Constant(grid, (0.0, -args.gravity))
    means = args.means
    if means == "auto":
        means = "centres" if integrator == "explicit" and V.basis.degree == 1 else "domains"
    if fbar and means == "centres":
        fbar = "centres"
    F = mpm.momentum(law_of(args), points, u, v, strain=strain, fbar=fbar)
    F -= ufl.inner(points.density * gravity, v) * points.dX
    bcs = mpm.fixed(V, lambda x: x[1] < 1e-6 * h)
    bcs += mpm.prescribed(V, lambda x: x[0] < 1e-6 * h, 0)
    kind = args.stabilisation
    stabilisation = (
        mpm.Stabilisation(kind, E=args.modulus, nu=args.poisson) if kind != "none" else "none"
    )
    options = {"stabilisation": stabilisation}
    if args.mapping is not None:
        options["mapping"] = args.mapping
    if integrator == "explicit":
        options["mass"] = args.mass
        options |= {"scheme": args.scheme, "courant": args.courant}
        return points, mpm.Explicit(F, u, points, bcs, **options)
    options["mass"] = args.mass or "consistent"
    return points, mpm.Newmark(F, u, points, bcs, **options)


# %% [markdown]
# ## What is measured
# The surface is taken as the area of sand in columns 10 mm wide over their width: the highest
# point of a column would overstate the front by single bars that fly ahead. A point's area is
# the first one, as its mass is: what flies apart gains volume in $\det F$, but no sand. It is
# spread over the width that the point had at first. The toe is where this height first falls below
# 2 mm; $x_{99}$ is what 99 % of the mass lie left of.


# %%
def surface(points, centres, width=COLUMN):
    """Area a width in columns around centres (m), shape (n,). Collective."""
    x, V, l0 = points["x"][:, 0], points["V0"], points["l0"][:, 0]
    low, high = x - l0, x + l0
    heights = np.empty(len(centres))
    for k, centre in enumerate(centres):
        # columns end at the wall
        left, right = max(centre - width / 2, 0.0), centre + width / 2
        inside = np.minimum(high, right) - np.maximum(low, left)
        # what the wall cuts off is not there to be filled
        heights[k] = np.sum(V * np.clip(inside, 0, None) / (high - low)) / (right - left)
    return points.comm.allreduce(heights, op=MPI.SUM)


def measure(points, args, problem):
    """Toe, place of 99 % (m) and kinetic energy (J/m). Collective."""
    centres = np.arange(COLUMN / 2, 3.5 * args.width, COLUMN)
    heights = surface(points, centres)
    k = int(np.argmax(heights < 0.002))
    share = (heights[k - 1] - 0.002) / (heights[k - 1] - heights[k])
    rows = points.gather("x", "V0")
    reach = None
    if rows is not None:
        order = np.argsort(rows[0][:, 0])
        mass = np.cumsum(rows[1][order])
        reach = float(rows[0][order, 0][np.searchsorted(mass, 0.99 * mass[-1])])
    strain = points["plastic_strain"]
    sums = points.comm.allreduce(np.array([strain @ points["V0"], points["V0"].sum()]), op=MPI.SUM)
    return {
        "toe": float(centres[k - 1] + COLUMN * share) if k else 0.0,
        "x99": points.comm.bcast(reach),
        "kinetic": problem.energies().kinetic,
        "plastic_strain": float(sums[0] / sums[1]),
        "max_plastic_strain": points.comm.allreduce(strain.max(initial=0.0), op=MPI.MAX),
    }


def scatter(points):
    """Root mean square of pressures about those of their cells, by that of all. Collective."""
    p, V = np.trace(points["stress"], axis1=1, axis2=2) / 3, points["V0"]
    _, cell = np.unique(points["cell"], return_inverse=True)
    mean = np.bincount(cell, V * p) / np.bincount(cell, V)
    sums = np.array([V @ (p - mean[cell]) ** 2, V @ p**2])
    sums = points.comm.allreduce(sums, op=MPI.SUM)
    return float(np.sqrt(sums[0] / sums[1]))


STATE = "x", "F", "l0", "plastic_strain"


def run(args, integrator, basis, fbar, strain, keep=()):
    """Let the column collapse; returns the figures, and the states at the times to keep."""
    started = time.perf_counter()
    points, problem = problem_of(args, integrator, basis, fbar, strain)
    ready = time.perf_counter()
    name = f"{integrator}, {basis}{', F-bar' if fbar else ''}, {strain}"
    found, states, reason = [], [], ""
    try:
        for t in args.times:
            if integrator == "explicit":
                problem.step(t)
            else:
                for now in mpm.times(t, args.dt, start=problem.time, label=name):
                    problem.step(now)
            found.append(measure(points, args, problem))
            if t in keep:
                states.append((t, points.gather(*STATE)))
    except mpm.errors.DolfinMPMError as error:
        # the run's outcome is what is asked for, good or bad
        reason = f"{type(error).__name__}: {error}"
    seconds = time.perf_counter() - ready
    heights = surface(points, PLACES)
    steps = sum(record.parts for record in problem.history)
    history = problem.history
    figures = {
        "completed": not reason,
        "reason": reason,
        **{key: [one[key] for one in found] for key in (found[0] if found else ())},
        "pressure_scatter": scatter(points),
        "places": PLACES.tolist(),
        "heights": heights.tolist(),
        "rms": float(np.sqrt(np.mean((heights - MEASURED) ** 2))),
        "reached": problem.time,
        "steps": steps,
        "newton_iterations": sum(getattr(record, "iterations", 0) for record in history),
        "halvings": sum(getattr(record, "halvings", 0) for record in history),
        "imbalance": max((record.imbalance for record in history), default=1.0),
        "points": points.total,
        "ranks": points.comm.size,
        "seconds_setup": ready - started,
        "seconds": seconds,
        "microseconds_per_point_step": 1e6 * seconds / max(steps * points.total, 1),
    }
    centres = np.arange(COLUMN / 2, 3.5 * args.width, COLUMN)
    # columns narrower than cells would show the rows of points
    profile = centres, surface(points, centres, max(COLUMN, args.h))
    toe = f"{figures['toe'][-1]:.3f}" if found else "-"
    x99 = f"{figures['x99'][-1]:.3f}" if found else "-"
    say(
        f"{name:40s} toe {toe} m, 99 % point {x99} m, RMS {1e3 * figures['rms']:.2f} mm, "
        f"{steps} steps, {seconds:.1f} s, "
        f"{figures['microseconds_per_point_step']:.2f} µs per point and step"
        + (f"\n    ended at {problem.time:.4f} s: {reason[:200]}" if reason else "")
    )
    return figures, states, profile


# %% [markdown]
# ## Trends
# What Xie and others say of the variants, each with the mean figures of those of either kind. The
# scatter is that of pressures within cells; it is checkerboards that make it large.


# %%
def trends(results):
    """What is said of the variants, and the two figures that show it."""
    runs = [one for one, _ in results if one["completed"]]
    k = int(np.searchsorted(PLACES, 0.08))

    def mean(key, **chosen):
        values = [
            one["heights"][k] if key == "crest" else one[key][-1]
            if isinstance(one[key], list) else one[key]
            for one in runs if all(one[name] in value for name, value in chosen.items())
        ]  # fmt: skip
        return float(np.mean(values)) if values else None

    cells, splines = ("linear", "gimp"), ("bspline2", "bspline3")
    on, off = ("on",), ("off",)
    rows = [
        ("no F-bar: pressures scatter in MPM and GIMP, less in splines", "pressure_scatter",
         {"basis": cells, "fbar": off}, {"basis": splines, "fbar": off}),
        ("F-bar cures the pressures of MPM and GIMP", "pressure_scatter",
         {"basis": cells, "fbar": off}, {"basis": cells, "fbar": on}),
        ("no F-bar: the height at 0.08 m is too large in MPM and GIMP, good in splines", "crest",
         {"basis": cells, "fbar": off}, {"basis": splines, "fbar": off}),
        ("without F-bar sand runs further", "x99", {"fbar": off}, {"fbar": on}),
        ("explicit steps run out further", "x99",
         {"integrator": ("explicit",)}, {"integrator": ("implicit",)}),
        ("best: splines with F-bar in implicit steps; the others", "rms",
         {"basis": splines, "fbar": on, "integrator": ("implicit",)}, {"basis": cells}),
        ("small and large strain move alike", "x99",
         {"strain": ("small",)}, {"strain": ("large",)}),
        ("plastic strain grows faster in small strain", "plastic_strain",
         {"strain": ("small",)}, {"strain": ("large",)}),
        ("Jaumann's rate is about small strain", "plastic_strain",
         {"strain": ("jaumann",)}, {"strain": ("small",)}),
    ]  # fmt: skip
    found = []
    for statement, key, one, other in rows:
        pair = mean(key, **one), mean(key, **other)
        if None not in pair:
            found.append({"statement": statement, "figure": key, "first": pair[0],
                          "second": pair[1]})  # fmt: skip
            say(f"{statement}: {key} {pair[0]:.4g} and {pair[1]:.4g}")
    return found


# %% [markdown]
# ## Runs

# %%
if __name__ == "__main__":
    args = Input.parse()
    if args.variants:
        results = []
        for integrator, basis, strain, fbar in itertools.product(
            args.integrators, args.bases, args.strains, args.fbars
        ):
            figures, _, profile = run(args, integrator, basis, fbar == "on", strain)
            chosen = {"integrator": integrator, "basis": basis, "fbar": fbar, "strain": strain}
            results.append(({**chosen, **figures}, profile))
        if not args.no_plot and MPI.COMM_WORLD.rank == 0:
            variants_picture(args.output / "column_collapse_variants.png", args, results)
        finish(args, {"runs": [one for one, _ in results], "trends": trends(results)})
    else:
        shown = [t for t in args.times if t in (0.1, 0.2, 0.3)] + [args.times[-1]]
        figures, states, profile = run(
            args, args.integrator, args.basis, args.fbar == "on", args.strain, shown
        )
        if not args.no_plot and MPI.COMM_WORLD.rank == 0 and states:
            picture(args.output / "column_collapse.png", args, figures, states, profile)
        finish(args, figures)
