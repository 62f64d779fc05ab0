# %% [markdown]
# # Young's modulus, cohesion and friction angle from the curve of a footing
#
# A strip footing on sand with some cohesion is loaded in steps. Its settlement is "measured" as
# that of a run with known parameters, with a random error of given size. `study.calibrate` then
# starts from other parameters. If its 95 % intervals are right, each of them contains the truth for
# some 19 of 20 seeds of the error.

# %%
from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from derivative_scenes import SAND, footing, history_of
from options import Options, natural, positive
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
    pressure: float = positive(120e3, "last pressure (Pa)")


args = Input.parse()
TRUTH = {name: SAND[name] for name in ("E", "cohesion", "angle")}
START = {"E": 2e6, "cohesion": 15e3, "angle": 15.0}
REST = {**{k: v for k, v in SAND.items() if k not in TRUTH}, "pressure": args.pressure}


# %%
def scene(m):
    """The footing; what is measured is its settlement."""
    run = footing({**REST, **m}, cells=args.cells, steps=args.steps, tolerance=1e-9)
    run.measured = {"settlement": lambda get=run.measured["settlement"]: -get()}
    return run


exact = history_of(scene, TRUTH)["settlement"]
say("settlement (m):", *exact.round(4))

# %%
rows, deviation = [], args.noise * float(exact[-1])
for seed in range(args.seeds):
    noise = np.random.default_rng(seed).normal(0.0, deviation, exact.shape)
    fit = study.calibrate(
        scene, START, {"settlement": exact + noise}, weights={"settlement": 1 / deviation},
        tolerance=1e-3,
    )  # fmt: skip
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
