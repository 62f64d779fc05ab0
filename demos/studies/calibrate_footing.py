# %% [markdown]
# # Young's modulus, cohesion and friction angle from the curve of a footing
#
# A strip footing on sand with some cohesion is loaded in steps. Its settlement, and displacements
# of three places in the ground, are "measured" as those of a run with known parameters, with random
# errors of given size. `study.calibrate` then starts from other parameters. If its 95 % intervals
# are right, each of them contains the truth for some 19 of 20 seeds of the errors.
#
# The settlement alone (`--settlement`) tells cohesion and friction angle only together: the
# intervals are two to three times as wide, and a fit takes up to 13 runs in place of 7.

# %%
from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from derivative_scenes import SAND, footing, history_of
from options import Options, natural, option, positive
from scene import finish, say

import dolfinmpm as mpm
from dolfinmpm import study


# %%
@dataclass
class Input(Options):
    """Calibrate a footing."""

    seeds: int = natural(20, "sets of errors")
    noise: float = positive(0.01, "standard deviation of the errors, over the last settlement")
    steps: int = natural(10, "steps of the load")
    cells: int = natural(12, "cells along the layer")
    settlement: bool = option(False, "measure the settlement alone")
    pressure: float = positive(120e3, "last pressure (Pa)")


args = Input.parse()
TRUTH = {name: SAND[name] for name in ("E", "cohesion", "angle")}
# beside the footing, under its edge, and under its middle (m)
PLACES = (1.3, 2.95), (1.0, 2.0), (0.1, 1.5)
START = {"E": 2e6, "cohesion": 15e3, "angle": 15.0}
REST = {**{k: v for k, v in SAND.items() if k not in TRUTH}, "pressure": args.pressure}


# %%
def scene(m):
    """The footing, with what is measured."""
    run = footing({**REST, **m}, cells=args.cells, steps=args.steps, tolerance=1e-9)
    places = [mpm.probe(run.problem.points, x) for x in PLACES]
    run.measured = {"settlement": lambda get=run.measured["settlement"]: -get()}
    if not args.settlement:
        run.measured["ground"] = lambda: np.array([place.displacement for place in places])
    return run


exact = history_of(scene, TRUTH)
say("settlement (m):", *exact["settlement"].round(4))

# %%
rows, deviation = [], args.noise * float(exact["settlement"][-1])
for seed in range(args.seeds):
    noise = np.random.default_rng(seed)
    measured = {k: v + noise.normal(0.0, deviation, v.shape) for k, v in exact.items()}
    weights = dict.fromkeys(exact, 1 / deviation)
    fit = study.calibrate(scene, START, measured, weights=weights, tolerance=1e-3)
    inside = {k: low <= TRUTH[k] <= high for k, (low, high) in fit.intervals.items()}
    rows.append({"parameters": fit.parameters, "inside": inside, "runs": len(fit.trace)})
    say(f"seed {seed}, {len(fit.trace)} runs:", str(fit).replace("\n", "; "))

# %%
if not args.no_plot:
    with mpm.figure(args.output / "calibrate_footing.png") as (_, axes):
        fit.draw(axes)
counts = {k: sum(row["inside"][k] for row in rows) for k in TRUTH}
runs = [row["runs"] for row in rows]
say("truth within the interval:", counts, f"runs {min(runs)} to {max(runs)}")
finish(args, {"rows": rows, "counts": counts, "of": args.seeds, "runs": runs})
