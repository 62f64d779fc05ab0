# %% [markdown]
# # Which parameters a cone's resistance hangs on
#
# The cone of `demos/cone.py` penetrates clay. `study.differentiate` finds how its resistance
# changes with the clay's strength, shear modulus and Poisson's ratio, and with the friction on the
# cone. Teh and Houlsby's (1991) factor is $N = 4/3\,(1 + \ln I)(1.25 + I/2000)$ with $I = G/c_u$.
# Its resistance has the logarithmic derivatives $1 - N'/N$ by the strength and $N'/N$ by the shear
# modulus, with $N' = dN/d\ln I$. By dimensions, their sum is one in any calculation.
#
# Points that touch the cone, or yield, in another step make kinks. Derivatives are those between
# kinks, and reach no further. Poisson's ratio has kinks close by: in twelve steps a point or two
# yield or not if it changes by a thousandth, and in one step a corner touches or not. `--reach
# 1e-3` tells these steps, and shows that differences of whole runs approach the derivative once
# they stay between the kinks: +0.224 by changes of 1e-3, +0.227 by changes of 1e-4 and by the
# derivative.
#
# The penalty of contact is 2 in place of 5. With 5 a step fails in some runs and not in others,
# by rounding, and is halved. Such runs differ by half a per cent.

# %%
from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from derivative_scenes import MPI, history_of
from options import Options, natural, positive
from scene import finish, say

import dolfinmpm as mpm
from dolfinmpm import study


# %%
@dataclass
class Input(Options):
    """What a cone's resistance hangs on."""

    steps: int = natural(40, "steps of a tenth of the radius")
    index: float = positive(100.0, "rigidity index G/c_u")
    friction: float = positive(0.05, "friction coefficient of the cone")
    reach: float | None = positive(None, "change of Poisson's ratio that is looked at for kinks")


args = Input.parse()
START, H = 6.0, 0.5


# %%
def scene(m):
    """The cone in clay, from a depth of six radii."""
    radii = mpm.zoned_line(0.0, 40.0, (0.0, 2.5), (0, 5, 9))
    heights = mpm.zoned_line(-53.0, 3.0, (-13.0, -3.0), (9, 20, 6))
    grid = mpm.create_lattice(MPI.COMM_WORLD, [radii, heights])
    shoulder = math.sqrt(3) - START
    meridian = [(0, -START), (1, shoulder), (1, 20.0), (-1, 20.0), (-1, shoulder)]
    cone = mpm.RigidBody(mpm.Polygon(meridian), increment=(0, -0.1), fillet=H, name="cone")

    def beside(x):
        gap, normal, _ = cone.surface.probe(np.ascontiguousarray(x.T))
        return (x[1] < 0) & (gap > H / 4 * np.abs(normal).sum(axis=1))

    ground = mpm.Where(beside, low=np.array([0.0, heights[0]]), high=np.array([40.0, 0.0]))
    points = mpm.fill(grid, ground, per_cell=2, density=1800.0, axisymmetric=True)
    V = mpm.Space(grid, basis="gimp", domains="volume")
    u, v = V.increment, V.test
    clay = mpm.materials.Tresca(2 * (1 + m["nu"]) * m["G"], m["nu"], m["cu"])
    F = mpm.momentum(clay, points, u, v, fbar=True)
    F += mpm.contact(cone, points, u, v, friction=m["friction"], penalty=2.0)
    bcs = mpm.prescribed(V, "left", 0) + mpm.prescribed(V, "right", 0) + mpm.fixed(V, "bottom")
    ghost = mpm.Stabilisation("ghost", factor=0.1)
    problem = mpm.QuasiStatic(F, u, points, bcs, stabilisation=ghost, tolerance=1e-8)
    measured = {"resistance": lambda: cone.force[1] / math.pi}
    return study.Run(problem, [problem.step] * args.steps, measured)


cu = 10e3
parameters = {"cu": cu, "G": args.index * cu, "nu": 0.45, "friction": args.friction}
found = study.differentiate(scene, parameters)

# %%
# means over the last third of the way, where the resistance is steady
last = slice(-(args.steps // 3), None)
resistance = found.figures["resistance"][last]
of = {k: float(np.mean(d[last]) / resistance.mean()) for k, d in
      found.derivatives["resistance"].items()}  # fmt: skip
N = 4 / 3 * (1 + math.log(args.index)) * (1.25 + args.index / 2000)
slope = 4 / 3 * (1.25 + args.index / 2000 + (1 + math.log(args.index)) * args.index / 2000)
exact = {"cu": 1 - slope / N, "G": slope / N}
say(f"cone factor {resistance.mean() / cu:.2f}, Teh and Houlsby {N:.2f}")
for name, value in of.items():
    beside_it = f", Teh and Houlsby {exact[name]:+.3f}" if name in exact else ""
    say(f"one per cent more {name}: {value:+.3f} per cent of resistance{beside_it}")
for note in found.notes:
    say(note)

# %%
differences, kinks = {}, []
if args.reach is not None:
    rest = {k: v for k, v in parameters.items() if k != "nu"}
    wide = study.differentiate(
        lambda m: scene({**rest, **m}), {"nu": parameters["nu"]}, epsilon=args.reach
    )
    kinks = wide.notes
    for note in kinks:
        say(note)
    for h in (args.reach, args.reach / 10):
        up, down = (
            history_of(scene, {**parameters, "nu": parameters["nu"] * (1 + sign * h)})["resistance"]
            for sign in (1, -1)
        )
        differences[h] = float(np.mean((up - down)[last]) / (2 * h * resistance.mean()))
        say(f"differences of whole runs by changes of nu by {h:g}: {differences[h]:+.3f}")
finish(args, {"factor": float(resistance.mean() / cu), "elasticities": of, "exact": exact,
              "kinks": kinks, "differences": differences, "seconds": found.seconds})  # fmt: skip
