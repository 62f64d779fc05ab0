# %% [markdown]
# # Permeability from a record of pore pressures
#
# A layer under a load drains at its top. A piezometer in it records the pore pressure, and a gauge
# the settlement. Both are "measured" as those of a run with known parameters, with random errors.
# `study.calibrate` finds permeability and Young's modulus, starting from ten times and half of
# them. The record of pressures alone (`--pressure`) tells their product, the coefficient of
# consolidation, and neither of them.

# %%
from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from derivative_scenes import consolidation, history_of
from options import Options, natural, option, positive
from scene import finish, say

import dolfinmpm as mpm
from dolfinmpm import study


# %%
@dataclass
class Input(Options):
    """Calibrate a permeability."""

    seed: int = natural(1, "of the errors")
    noise: float = positive(0.01, "standard deviation of the errors, over the largest value")
    steps: int = natural(8, "readings")
    pressure: bool = option(False, "measure pore pressures alone")


args = Input.parse()
TRUTH = {"permeability": 1e-5, "E": 1e6}
START = {"permeability": 1e-4, "E": 0.5e6}


# %%
def scene(m):
    """The layer, with a piezometer and the mean settlement."""
    run = consolidation({"nu": 0.2, "load": 50e3, **m}, steps=args.steps)
    points, motion = run.problem.points, run.measured["motion"]
    near = mpm.probe(points, (0.5, 1.0))
    run.measured = {"pressure": lambda: near["pressure"]}
    if not args.pressure:
        run.measured["settlement"] = lambda: -motion()[1]
    return run


exact, noise = history_of(scene, TRUTH), np.random.default_rng(args.seed)
sizes = {k: args.noise * np.abs(v).max() for k, v in exact.items()}
measured = {k: v + noise.normal(0.0, sizes[k], v.shape) for k, v in exact.items()}
weights = {k: 1 / size for k, size in sizes.items()}
fit = study.calibrate(scene, START, measured, weights=weights, tolerance=1e-3)
say(fit)
if not args.no_plot:
    with mpm.figure(args.output / "calibrate_permeability.png") as (_, axes):
        fit.draw(axes, "pressure")
finish(args, {"parameters": fit.parameters, "intervals": fit.intervals, "runs": len(fit.trace)})
