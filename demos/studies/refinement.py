# %% [markdown]
# # Refined spaces: error against unknowns and time
#
# A rectangular grid stays; its cells are the roots of trees, and halve where smaller ones are
# wanted. What does that gain over a uniform grid, and over one with graded lines?
#
# - `column`: a column under its weight (`column_compaction.py`). The stress is smooth, and leaves
#   gain little. Where soil flows into smaller leaves its points split, and each half keeps the
#   stress of the whole. Leaves that go down with their soil avoid this.
# - `footing`: a rigid smooth strip footing, Prandtl's $(2 + \pi)\,c$ (`footing.py`). The error
#   comes from the edge.
# - `corner`: an L-shaped body with the exact displacement of the re-entrant corner on its outer
#   sides, $u \sim r^{0.5445}$. A uniform grid has this order in the energy norm; leaves of size
#   $\sqrt r/n$ regain the first order.
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

import footing
import numpy as np
from mpi4py import MPI
from options import Options, option
from refinement_scenes import column, corner, cut_block, figures_of_footing, patch
from scene import finish, say

import dolfinmpm as mpm
from dolfinmpm import study

CURVES, CHECKS = ("column", "footing", "corner"), ("conditioning", "patch")


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
    places: int = option(200, "of a cut block", least=1)
    trees: int = option(20, "random ones", least=1)
    dimension: int = option(2, "of conditioning and patches", choices=(2, 3))
    stabilisation: str = option("ghost", choices=("ghost", "aggregation"))


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


def runs_of(part, args):
    """Runs of a part: kind of grid, size of its cells, figures."""
    if part == "column":
        # compiled loops are read from their cache
        column(50 / 8, steps=1)
        for n in args.column:
            yield "uniform", 50 / n, column(50 / n)
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
                yield name, 1 / n, corner(n, kind)
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


def unknowns_for(rows, error):
    """Unknowns that a curve needs for an error; between its runs, or straight on beyond them."""
    n, e = (np.log([row[name] for row in rows]) for name in ("unknowns", "error"))
    k = max(1, min(len(rows) - 1, int(np.searchsorted(-e, -math.log(error)))))
    slope = (n[k] - n[k - 1]) / (e[k] - e[k - 1])
    return float(np.exp(n[k] + slope * (math.log(error) - e[k])))


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
    best = kinds["leaves"][-1]
    if len(kinds.get("uniform", ())) > 1:
        needed = unknowns_for(kinds["uniform"], best["error"])
        figures[part] |= {"share": best["unknowns"] / needed, "least_error": best["error"]}
        say(
            f"{part:8s} a uniform grid needs {needed:.0f} unknowns for an error of "
            f"{best['error']:.2e}, leaves {best['unknowns']}"
        )
if "conditioning" in args.parts:
    # each rank takes its share of the places
    comm = MPI.COMM_WORLD
    own = [
        cut_block(k, args.dimension, args.stabilisation)
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
        patch(k, args.dimension, args.stabilisation)
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
