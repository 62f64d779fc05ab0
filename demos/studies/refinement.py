# %% [markdown]
# # Refined spaces: error against unknowns and time
#
# A rectangular grid stays; its cells are the roots of trees, and halve where smaller ones are
# wanted. What does that gain over a uniform grid, and over one with graded lines?
#
# - `column`: a column under its weight (`column_compaction.py`). The stress is smooth, and leaves
#   gain little; graded lines are half as far apart at the base as at the top. Where soil flows into
#   smaller leaves its points split, and each half keeps the stress of the whole. Leaves that go
#   down with their soil avoid this.
# - `footing`: a rigid smooth strip footing, Prandtl's $(2 + \pi)\,c$ (`footing.py`). The error
#   comes from the edge.
# - `corner`: an L-shaped body with the exact displacement of the re-entrant corner on its outer
#   sides, $u \sim r^{0.5445}$. A uniform grid has this order in the energy norm; leaves of size
#   $\sqrt r/n$ regain the first order. Quadratic splines (`--basis bspline2`) need leaves of
#   $r^{3/4}/n$.
# - `cone`: a smooth cone goes 2 R down in Tresca clay (`cone_penetration.py`). All grids have the
#   same ground, rounding of R/4, penalty, and F-bar by the mean volumes. There is no exact force:
#   the error is that of the mean over the last R, against leaves half as large as the smallest.
#   Unknowns of uniform cells of that size are only counted.
#
# Two more parts ask whether leaves of several sizes keep what the method promises: `conditioning`
# puts a block anywhere, so that its upper side cuts coarse and fine leaves, and takes the
# condition number of its stiffness; `patch` deforms blocks on random trees homogeneously.
#
# `--parts corner,patch` runs some of them.

# %%
from __future__ import annotations

import math
from dataclasses import dataclass

import cone_penetration
import footing
import numpy as np
from mpi4py import MPI
from options import Options, option
from refinement_scenes import DEGREES, column, corner, cut_block, figures_of_footing, patch
from scene import finish, say

import dolfinmpm as mpm
from dolfinmpm import study

CURVES, CHECKS = ("column", "footing", "corner", "cone"), ("conditioning", "patch")


@dataclass
class Input(Options):
    """Error of uniform, graded and refined grids."""

    parts: list[str] = option([*CURVES, *CHECKS], choices=CURVES + CHECKS)
    column: list[int] = option([16, 32, 64], "cells up a uniform column, of 8 and up", least=8)
    footing: list[float] = option([0.25, 0.125, 0.0625], "sizes of uniform cells (m)", above=0)
    lines: list[float] = option([0.2, 0.1, 0.05], "sizes (m) at the edge between graded lines")
    leaves: list[float] = option(
        [0.125, 0.0625, 0.03125, 0.015625], "sizes of leaves at the footing's edge (m)", above=0
    )
    corner: list[int] = option([4, 8, 16, 32], "cells along a leg", least=2)
    cone: list[float] = option([0.5, 0.25], "sizes of uniform cells (m), R = 1 m", above=0)
    cone_lines: list[float] = option([0.5, 0.25, 0.125], "between graded lines (m)", above=0)
    cone_leaves: list[float] = option([0.5, 0.25, 0.125], "of leaves at the tip (m)", above=0)
    cone_finest: float = option(0.0625, "of cells whose unknowns are only counted (m)", above=0)
    places: int = option(200, "of a cut block", least=1)
    trees: int = option(20, "random ones", least=1)
    dimension: int = option(2, "of conditioning and patches", choices=(2, 3))
    stabilisation: str = option("ghost", choices=("none", "ghost", "aggregation"))
    basis: str = option("gimp", "of corner, conditioning and patches", choices=tuple(DEGREES))


# %% [markdown]
# ## Runs
# The footing's clay has $E/c = 10^5$: it flows before its shape changes at the smallest leaves.

# %%
FOOTING = "--law tresca-perfect --modulus 1e9 --steps 20 --no-plot"


def footings(args):
    """Command lines of `footing.py`: kind of grid, size of the smallest cells (m), options."""
    for h in args.footing:
        yield "uniform", h, f"--h {h} --coarsest {h}"
    for h in args.lines:
        yield "graded lines", h, f"--h {h}"
    for h in args.leaves:
        yield "leaves", h, f"--h 0.5 --coarsest 0.5 --refine {h} --growth 0.2"


CONE = "--fbar volumes --ghost 0.03 --penalty 1 --depth 8 --width 20 --no-plot"


def cones(args):
    """Command lines of `cone_penetration.py`, as of `footings`; the finest leaves first."""
    yield "reference", 0.5 * min(args.cone_leaves), "--refine"
    for kind, sizes, words in (
        ("uniform", args.cone, "--growth 1"),
        ("graded lines", args.cone_lines, ""),
        ("leaves", args.cone_leaves, "--refine"),
    ):
        for h in sizes:
            yield kind, h, words


def cone_of(h, words):
    """Options of a cone, which is rounded alike in all cells."""
    return cone_penetration.Input.parse(f"{CONE} --h {h} --fillet {0.25 / h} {words}".split())


def count(h):
    """Unknowns of uniform cells, and of leaves, before a cone's first step."""
    found = {}
    for kind, words in ("uniform", "--growth 1"), ("leaves", "--refine"):
        problem = cone_penetration.Scene(cone_of(h, words)).problem
        found[kind] = problem.activate().unknowns.total
    return {"h": h, **found, "ratio": found["uniform"] / found["leaves"]}


def mean_force(h, words):
    """Mean factor of a cone over the last R of its way, and the figures of the run."""
    options = cone_of(h, words)
    figures, _ = cone_penetration.once(options)
    names = "unknowns", "points", "newton_iterations"
    found = {name: figures[name] for name in names}
    found["seconds"] = figures["seconds_setup"] + figures["seconds_solve"]
    if figures["reached"] < options.depth - 1e-9:
        raise RuntimeError(f"the cone ends {figures['reached']:g} m deep: {figures['reason']}")
    return figures["factor"], found


def runs_of(part, args):
    """Runs of a part: kind of grid, size of its cells, figures."""
    if part == "column":
        # compiled loops are read from their cache
        column(50 / 8, steps=1)
        for n in args.column:
            yield "uniform", 50 / n, column(50 / n)
        for n in args.column:
            yield "graded lines", 100 / (3 * n), column(50 / n, graded=True)
        for n in args.column:
            yield "leaves", 25 / n, column(25 / n, 1)
    elif part == "corner":
        corner(2, "refined")
        for name, kind in (
            ("uniform", "uniform"),
            ("graded lines", "graded"),
            ("leaves", "refined"),
        ):
            for n in args.corner:
                power = {"uniform": 1, "graded": 2, "refined": 2 * DEGREES[args.basis]}[kind]
                smallest = float(n) ** -power
                yield name, smallest, corner(n, kind, args.basis)
    elif part == "cone":
        exact = None
        for kind, h, words in cones(args):
            factor, found = mean_force(h, words)
            exact = factor if exact is None else exact
            if kind != "reference":
                yield kind, h, {"error": abs(factor / exact - 1), "factor": factor, **found}
    else:
        for kind, h, words in footings(args):
            options = footing.Input.parse((FOOTING + " " + words).split())
            yield kind, h, figures_of_footing(footing.run(options)[0])


def order(rows):
    """Order of the last two errors in the size of as many equal cells; None of one run."""
    if len(rows) < 2:
        return None
    first, last = rows[-2:]
    finer = math.sqrt(last["unknowns"] / first["unknowns"])
    return math.log(first["error"] / last["error"]) / math.log(finer)


def needed(rows, error, name):
    """Unknowns or seconds that a curve needs for an error; between its runs, or straight on.

    None of a curve whose error does not fall there.
    """
    n, e = (np.log([row[key] for row in rows]) for key in (name, "error"))
    k = next((k for k in range(1, len(e)) if e[k] <= math.log(error)), len(e) - 1)
    if not e[k] < e[k - 1]:
        return None
    slope = (n[k] - n[k - 1]) / (e[k] - e[k - 1])
    return float(np.exp(n[k] + slope * (math.log(error) - e[k])))


def against(others, leaves):
    """Unknowns and time of another kind of grid over those of the finest leaves.

    Returns:
        Those for the same error, by extrapolation if `beyond`, and those with the same smallest
        cells, where both kinds have such a run.
    """
    best, found = leaves[-1], {}
    for name in ("unknowns", "seconds"):
        value = needed(others, best["error"], name)
        found[name] = None if value is None else value / best[name]
    found["beyond"] = min(row["error"] for row in others) > best["error"]
    alike = [(a, b) for a in leaves for b in others if abs(a["h"] / b["h"] - 1) < 1e-9]
    if alike:
        a, b = min(alike, key=lambda pair: pair[0]["h"])
        found["same_cells"] = {name: b[name] / a[name] for name in ("h", "unknowns", "seconds")}
        found["same_cells"]["h"] = a["h"]
    return found


# %%
args = Input.parse()
figures = {}
for part in (p for p in CURVES if p in args.parts):
    rows = []
    for kind, h, run in runs_of(part, args):
        rows.append({"grid": kind, "h": h, **run})
        say(
            f"{part:8s} {kind:12s} h = {h:8.5f} m, {run['unknowns']:6d} unknowns: error "
            f"{run['error']:.3e}, {run['seconds']:.1f} s"
        )
    kinds = {
        kind: [r for r in rows if r["grid"] == kind]
        for kind in dict.fromkeys(r["grid"] for r in rows)
    }
    figures[part] = {"runs": rows, "orders": {k: order(found) for k, found in kinds.items()}}
    best, gain = kinds["leaves"][-1], {}
    for kind in ("uniform", "graded lines"):
        if len(kinds.get(kind, ())) < 2:
            continue
        gain[kind] = found = against(kinds[kind], kinds["leaves"])
        counts = [found["unknowns"], found["seconds"]]
        text = [f"{value:.3g}" if value is not None else "?" for value in counts]
        same = found.get("same_cells", {})
        say(
            f"{part:8s} {kind}, for the error of leaves, {best['error']:.2e}: {text[0]} times the "
            f"unknowns, {text[1]} times the time"
            + (", extrapolated" if found["beyond"] else "")
            + (
                "; with the same smallest cells, {h:g} m: {unknowns:.3g} and {seconds:.3g} "
                "times".format(**same)
                if same
                else ""
            )
        )
    figures[part] |= {"gain": gain, "least_error": best["error"]}
    share = gain.get("uniform", {}).get("unknowns")
    if share:
        figures[part]["share"] = 1 / share
    if part == "cone":
        figures[part]["finest"] = finest = count(args.cone_finest)
        say(
            "cone     {uniform} unknowns of uniform cells of {h:g} m, {leaves} of leaves: "
            "{ratio:.3g} times".format(**finest)
        )
if "conditioning" in args.parts:
    # each rank takes its share of the places
    comm = MPI.COMM_WORLD
    own = [
        cut_block(k, args.dimension, args.stabilisation, args.basis)
        for k in range(comm.rank, args.places, comm.size)
    ]
    kappa = np.sort(np.concatenate(comm.allgather(own)))
    figures["conditioning"] = {"kappa": kappa.tolist(), "spread": float(kappa[-1] / kappa[0])}
    say(
        f"κ(K) in {args.dimension}D, {args.places} places, {args.stabilisation}: {kappa[0]:.4g} to "
        f"{kappa[-1]:.4g}, {kappa[-1] / kappa[0]:.3g} times"
    )
if "patch" in args.parts:
    comm = MPI.COMM_WORLD
    own = [
        patch(k, args.dimension, args.stabilisation, args.basis)
        for k in range(comm.rank, args.trees, comm.size)
    ]
    worst = comm.allreduce(max(own, default=0.0), op=MPI.MAX)
    figures["patch"] = {"worst": float(worst)}
    say(f"patch test on {args.trees} random trees: largest error {worst:.1e}")

# %% [markdown]
# ## Picture

# %%
LABELS = {
    "column": "column: error of the stress",
    "footing": "footing: error of the load",
    "corner": "corner: error of the energy norm",
    "cone": "cone: error of the force",
}
LOOKS = {
    "uniform": {"color": "C0", "marker": "o"},
    "graded lines": {"color": "C1", "marker": "^"},
    "leaves": {"color": "C2", "marker": "s"},
}


def picture(path, curves):
    """Draw the error over unknowns above, and over time below."""
    with mpm.figure(
        path, 2.5 * len(curves) + 0.3, 4.6, nrows=2, ncols=len(curves), squeeze=False
    ) as (_, axes):
        for (upper, lower), (part, found) in zip(axes.T, curves.items()):
            for kind, look in LOOKS.items():
                rows = [r for r in found["runs"] if r["grid"] == kind]
                error = [r["error"] for r in rows]
                for ax, name in ((upper, "unknowns"), (lower, "seconds")):
                    if rows:
                        label = f"{kind}, order {found['orders'][kind] or math.nan:.2f}"
                        ax.loglog([r[name] for r in rows], error, label=label, ms=4, **look)
            upper.set(title=LABELS[part], xlabel="unknowns")
            upper.legend()
            lower.set(xlabel="time (s)")
        for row in axes:
            row[0].set_ylabel("relative error")


curves = {part: figures[part] for part in CURVES if part in figures}
if not args.no_plot and curves and MPI.COMM_WORLD.rank == 0:
    picture(args.output / "refinement.png", curves)
if not args.no_plot and curves:
    table = [{"part": part, **run} for part, found in curves.items() for run in found["runs"]]
    study.write_table(table, args.output / "refinement.csv")
finish(args, {**figures, "ranks": MPI.COMM_WORLD.size})
