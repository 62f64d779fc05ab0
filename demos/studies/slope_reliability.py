# %% [markdown]
# # Reliability of a slope in clay with a random field of strength
#
# The undrained strength of the clay is a lognormal random field with a correlation length. Gravity
# is the load of an arc length: its factor at the end of the path is the factor of safety, since the
# strength of Tresca's law does not depend on pressure. The slope fails if the factor is below one.
# FORM of OpenTURNS finds the most likely weak zone from derivatives by the modes of the field.
#
# A shorter correlation length averages strong and weak clay along the slip surface. The variance of
# the factor falls, and β grows. Modes that are left out take variance away, too: give more modes
# for shorter lengths. `--check` compares the probability with sampling about the design point, and
# `--runs` with plain Monte Carlo sampling, whose runs go side by side on the ranks.

# %%
from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
import ufl
from derivative_scenes import grid_of
from dolfinx import fem
from mpi4py import MPI
from options import Options, natural, option, positive
from scene import finish, say

import dolfinmpm as mpm
from dolfinmpm import study


# %%
@dataclass
class Input(Options):
    """Reliability of a slope."""

    lengths: list[float] = option([40.0, 10.0, 5.0], "correlation lengths (m)", above=0)
    mean: float = positive(32e3, "mean strength (Pa)")
    coefficient: float = positive(0.3, "coefficient of variation of the strength")
    modes: int = natural(8, "modes of the field")
    cells: int = natural(16, "cells along the ground")
    steps: int = natural(5, "steps along the path")
    length: float = positive(0.004, "mean settlement per step (m)")
    check: int = option(0, "runs of the sampling, 0 for none", least=0)
    runs: int = option(0, "runs of plain Monte Carlo sampling, 0 for none", least=0)
    seed: int = natural(1, "of the sampling")


args = Input.parse()
WIDTH, FOOT, TOP = 20.0, 2.0, 7.0
GROUND = mpm.Polygon([(0, 0), (WIDTH, 0), (WIDTH, FOOT), (13, FOOT), (8, TOP), (0, TOP)])


# %%
def slope(m, comm, field):
    """A slope under a growing weight; its figure is the factor of safety less one."""
    h = WIDTH / args.cells
    rows = int(np.ceil(TOP / h)) + 1
    grid = grid_of((WIDTH, rows * h), (args.cells, rows), comm)
    points = mpm.fill(grid, GROUND, 2, 2000.0)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    weight = fem.Constant(grid, (0.0, -10.0))
    clay = mpm.materials.Tresca(20e6, 0.45, lambda x: field.at(x[:2].T, m))
    F = mpm.momentum(clay, points, u, v, fbar=True)
    F -= ufl.inner(points.density * weight, v) * points.dX
    bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
    volume = points.comm.allreduce(float(points["V0"].sum()))
    problem = mpm.ArcLength(
        F, u, points, bcs, load=weight, stabilisation="ghost", tolerance=1e-8,
        control=-v[1] / volume * points.dX, length=args.length, max_length=args.length,
    )  # fmt: skip
    measured = {"margin": lambda: problem.factor - 1.0}
    return study.Run(problem, [problem.step] * args.steps, measured)


# %%
rows = []
for length in args.lengths:
    field = study.RandomField(
        (0, 0), (WIDTH, TOP), length, mean=args.mean, coefficient=args.coefficient,
        modes=args.modes,
    )  # fmt: skip
    given = {name: study.Normal() for name in field.names}
    scene = partial(slope, field=field)
    found = study.reliability(partial(scene, comm=MPI.COMM_WORLD), given, tolerance=1e-2)
    row = {
        "length": length, "beta": found.beta, "probability": found.probability,
        "share": field.share, "runs": found.runs[0], "design": found.design,
    }  # fmt: skip
    say(
        f"correlation length {length:g} m: β = {found.beta:.3f}, probability of failure "
        f"{found.probability:.2e}, {found.runs[0]} runs with derivatives, the modes have "
        f"{field.share:.1%} of the variance"
    )
    if args.check:
        probability, variation = found.check(args.check, args.seed)
        row |= {"sampled": probability, "variation": variation}
        say(f"  sampled about the design point: {probability:.2e}, ± {variation:.1%}")
    if args.runs:
        plain = study.monte_carlo(scene, given, runs=args.runs, seed=args.seed, ranks=1)
        row |= {"plain": plain.probability, "plain_beta": plain.beta}
        say(
            f"  plain sampling: β = {plain.beta:.3f}, probability {plain.probability:.2e}, "
            f"± {plain.variation:.1%}"
        )
    rows.append(row)
    if not args.no_plot:
        # the most likely weak zone
        x, y = np.meshgrid(np.linspace(0, WIDTH, 81), np.linspace(0, TOP, 29))
        places = np.stack([x.ravel(), y.ravel()], axis=-1)
        strength = field.at(places, found.design).reshape(x.shape)
        inside = GROUND.contains(places).reshape(x.shape)
        with mpm.figure(args.output / f"slope_reliability_{length:g}.png") as (figure, axes):
            drawn = axes.contourf(x, y, np.where(inside, strength / 1e3, np.nan), 12)
            figure.colorbar(drawn, label="strength at the design point (kPa)")
            axes.set_aspect("equal")
            axes.set_title(f"correlation length {length:g} m, β = {found.beta:.2f}")
finish(args, {"rows": rows})
