# %% [markdown]
# # Derivatives of a run, beside differences of whole runs
#
# `study.differentiate` runs an example at its parameters, and at $m + \varepsilon\,\Delta m$
# beside it. The run beside it solves its equations once per substep with the tangent of the first
# run: $u' = u - K^{-1}\,[R(u; s', m') - R(u; s, m)]$. The difference of the two is the derivative.
# No derivative of a law, of a term or of a basis function is written anywhere. `--central` takes
# $m \pm \varepsilon\,\Delta m$, as paths of an arc length do anyway.
#
# Here each example also runs as a whole at $m \pm h\,\Delta m$ and $m \pm 2h\,\Delta m$, to
# tight tolerances. Richardson's rule for these four, $(4 D_h - D_{2h})/3$, is what the
# derivatives are compared with. An error is relative to the largest derivative of a figure by any
# parameter of the example, over all steps.
#
# `--time` measures what derivatives cost: a Mohr–Coulomb footing of 10 000 points with none, one
# and several parameters, in turn. `--time --block` takes an elastic block of 40 000 unknowns in 3D.

# %%
from __future__ import annotations

import statistics
import time
from dataclasses import dataclass
from functools import partial

from derivative_scenes import (
    CASES,
    SAND,
    SOFT,
    column,
    errors_of,
    footing,
    history_of,
    sizes_of,
)
from options import Options, natural, option, positive
from scene import finish, say

import dolfinmpm as mpm
from dolfinmpm import study


# %%
@dataclass
class Input(Options):
    """Derivatives of runs, and what they cost."""

    cases: str = option("", "names of examples, with semicolons between; by default all")
    difference: float = positive(1e-4, "h of the differences of whole runs")
    epsilon: float | None = positive(None, "perturbation of the runs that follow")
    central: bool = option(False, "two runs per parameter, in twice the time")
    time: bool = option(False, "measure times instead")
    block: bool = option(False, "time a block in 3D in place of the footing")
    cells: int = natural(70, "cells along the footing's layer, for --time")
    steps: int = natural(20, "steps of the footing, for --time")
    further: int = option(5, "further parameters, for --time", least=1, most=5)
    repeat: int = natural(3, "runs of each kind, for --time")


args = Input.parse()
HOW = {"central": args.central or None, "epsilon": args.epsilon}


# %%
def compare(name):
    """One row of the table: an example, and the largest error per parameter."""
    scene, parameters = CASES[name]
    found = study.differentiate(scene, parameters, scales=sizes_of(name), **HOW)
    errors = errors_of(scene, parameters, found, args.difference)
    return {"case": name, "error": max(errors.values()), "errors": errors, "notes": found.notes}


# %%
def seconds_of(call):
    """Processor time, so that what else runs on the machine does not count."""
    started = time.process_time()
    call()
    return time.process_time() - started


def example():
    """The example whose time is measured: function and parameters, the most usual ones first."""
    if args.block:
        return partial(column, dimension=3, steps=3, fine=7, tolerance=1e-9), SOFT
    # three quarters of the bearing capacity
    sand = SAND | {"pressure": 150e3}
    names = ["E", "angle", "cohesion", "pressure", "K0", "nu"]
    scene = partial(footing, cells=args.cells, steps=args.steps, tolerance=1e-9)
    return scene, {k: sand[k] for k in names}


def costs():
    """Time of runs with parameters over the time of a run without, as medians."""
    scene, parameters = example()
    further = min(args.further, len(parameters) - 1)

    def run(count):
        if count == 0:
            return lambda: history_of(scene, parameters)
        names = list(parameters)
        chosen = {k: parameters[k] for k in names[:count]}
        rest = {k: parameters[k] for k in names[count:]}
        return lambda: study.differentiate(lambda m: scene({**rest, **m}), chosen, **HOW)

    few, many = run(1), run(1 + further)
    for call in (run(0), few):
        # compilations
        call()
    rows = [[seconds_of(call) for call in (run(0), few, many)] for _ in range(args.repeat)]
    first = statistics.median((one - none) / none for none, one, _ in rows)
    each = statistics.median((all_ - one) / further / none for none, one, all_ in rows)
    return {"seconds": rows, "first": first, "further": each}


# %%
if args.time:
    figures = costs()
    say(f"first parameter {figures['first']:.0%} of a run, each further {figures['further']:.0%}")
else:
    chosen = args.cases.split(";") if args.cases else list(CASES)
    rows = [compare(name) for name in chosen]
    for row in rows:
        each = ", ".join(f"{m} {error:.0e}" for m, error in row["errors"].items())
        say(f"{row['case']:28s} {row['error']:.1e}   {each} {' '.join(row['notes'])}")
    figures = {"rows": rows}
    if not args.no_plot:
        tall = 0.9 + 0.2 * len(rows)
        with mpm.figure(args.output / "derivatives.png", 4.6, tall) as (_, axes):
            for k, row in enumerate(rows):
                # an error of zero has no place on a logarithmic axis
                found = [max(error, 1e-10) for error in row["errors"].values()]
                axes.plot(found, [k] * len(found), "o", ms=3.5, color="C0", alpha=0.7)
            axes.axvline(1e-7, color="0.6", lw=1, ls="--")
            axes.axvline(1e-5, color="k", lw=1)
            axes.set(
                xscale="log", xlim=(1e-10, 1e-4), ylim=(len(rows) - 0.5, -0.5),
                xlabel="error of the derivative by each parameter", yticks=range(len(rows)),
                yticklabels=[row["case"] for row in rows],
            )  # fmt: skip
            axes.text(1e-7, 1.0, "elastic", transform=axes.get_xaxis_transform(),
                      ha="right", va="bottom", fontsize=7, color="0.5")  # fmt: skip
            axes.text(1e-5, 1.0, "others", transform=axes.get_xaxis_transform(),
                      ha="left", va="bottom", fontsize=7)  # fmt: skip
finish(args, figures)
