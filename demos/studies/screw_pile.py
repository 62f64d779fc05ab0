# %% [markdown]
# # A screw pile is turned and pushed into clay
#
# A pile with one helical plate stands in a block of weightless clay, with the plate two radii deep.
# It is turned, and goes down by the advance ratio times its pitch per turn: 1 is pitch-matched,
# less is over-flighted. The pile is one closed surface mesh; the cells around it are leaves that
# follow it.
#
# What holds the result: on a smooth plate the pressure of the soil acts along its normal. It does
# no work on a pile that moves along its helix, so that the torque of the plate's faces is the
# vertical force on them times $p/2\pi$. What the leading edge, the shaft's tip and friction add is
# the excess. Over-flighting pulls the pile down: the plate lifts soil, and the push that is needed
# becomes smaller, and at last a pull upward (Sharif et al. 2021, doi 10.1680/jgeot.19.P.352;
# Cerfontaine et al. 2021, doi 10.1680/jgeot.20.P.277).
#
# What comes out in cells of 0.25 m, over the last third of a turn by 60°, without friction:
#
# - Pitch-matched, the pile needs a push of 19 kN, 2.4 strengths on the plate's area, and a torque
#   of 3.3 kN m. The push times $p/2\pi$ is 1.2 kN m of it. The plate's leading edge makes the rest.
# - With half the advance the clay pulls the pile down by 17 kN, and the torque is 6.2 kN m. The
#   pull still grows at the end.
#
# The plate reaches 1.5 cells beyond the shaft. The torque changes by up to three times from step to
# step, as corners meet the plate's edge. Rely on signs and orders of size, not on the figures.

# %%
from __future__ import annotations

import math
import time
from dataclasses import dataclass

import numpy as np
from driven_bodies import Clay, closed
from options import Options, natural, option, positive
from scene import finish, say, solver_figures

import dolfinmpm as mpm

RADIUS, STRENGTH = 0.5, 10e3  # m, Pa


@dataclass
class Input(Options):
    """A screw pile in clay: torque and vertical force at several advance ratios."""

    ratios: list[float] = option([1.0, 0.5], "advance per turn in pitches", least=0)
    pitch: float = positive(0.4, "of the plate (m)")
    shaft: float = positive(0.12, "radius of the shaft (m)", below=0.5)
    thickness: float = positive(0.15, "of the plate (m)")
    friction: float = option(0.0, "of the pile's surface", least=0)
    levels: int = option(1, "how often cells of 0.5 m are halved near the pile", least=1, most=4)
    turn: float = positive(60.0, "in all (degrees)")
    step: float = positive(7.5, "turn at once (degrees)")
    sides: int = natural(24, "of the polygon that stands for a circle")


# %% [markdown]
# ## The pile
# In each half plane through the axis lie six corners: two where the shaft meets the plate, two at
# the plate's rim, and the shaft's ends. The plate goes round by all but one side of the polygon.


# %%
def pile(args):
    """The pile's surface; its plate begins at z = -1 m and rises by a pitch per turn."""
    n, low, top = args.sides, -1.0 - args.shaft, 0.25
    r, t = args.shaft, args.thickness
    x = [(0.0, 0.0, low), (0.0, 0.0, top)]
    for k in range(n):
        a, z = 2 * math.pi * k / n, -1.0 + args.pitch * k / n
        for radius, height in (
            (r, low),
            (r, z),
            (RADIUS, z),
            (RADIUS, z + t),
            (r, z + t),
            (r, top),
        ):
            x.append((radius * math.cos(a), radius * math.sin(a), height))
    at = lambda k, c: 2 + 6 * (k % n) + c  # noqa: E731
    faces = []
    for k in range(n):
        faces += [(0, at(k + 1, 0), at(k, 0)), (1, at(k, 5), at(k + 1, 5))]
        if k < n - 1:
            for c in range(5):
                a, b, d, e = at(k, c), at(k + 1, c), at(k + 1, c + 1), at(k, c + 1)
                # the faces of the plate are twisted
                faces += [(a, b, d), (a, d, e)]
    # the gap: the plate's two ends, and the shaft between them
    end, begin = n - 1, 0
    faces += [tuple(at(begin, c) for c in (1, 2, 3, 4)), tuple(at(end, c) for c in (4, 3, 2, 1))]
    left, right = [0, 1, 4, 5], [0, 1, 4, 5]
    i = j = 0
    while i < 3 or j < 3:
        a, b = at(end, left[i]), at(begin, right[j])
        if j == 3 or (i < 3 and x[at(end, left[i + 1])][2] <= x[at(begin, right[j + 1])][2]):
            i += 1
            faces.append((a, b, at(end, left[i])))
        else:
            j += 1
            faces.append((a, b, at(begin, right[j])))
    return closed(x, faces)


# %%
def run(ratio, args):
    """Turn the pile at an advance ratio; returns figures, history and scene. Collective."""
    started, down = time.perf_counter(), ratio * args.pitch * args.step / 360
    # the plate rises anticlockwise, so that it goes down when it turns clockwise
    going = [0.0]
    screw = mpm.RigidBody(
        pile(args), increment=lambda t: (0.0, 0.0, -down * going[0]),
        rotation_increment=lambda t: (0.0, 0.0, -args.step * going[0]),
        centre=(0.0, 0.0, -1.0), name="pile",
    )  # fmt: skip
    size = 0.5 / 2**args.levels
    clay = Clay(
        (-1.5, -1.5, -2.5), (1.5, 1.5, 0.0), 0.5, args.levels, screw, strength=STRENGTH,
        friction=args.friction,
    )  # fmt: skip
    # corners that overlap with the pile come to rest
    clay.problem.step()
    going[0], history = 1.0, mpm.History()
    for k in range(1, round(args.turn / args.step) + 1):
        clay.problem.step()
        history.record(
            turn=k * args.step, force=float(screw.force[2]), torque=float(screw.moment[2])
        )
    last = max(1, len(history) // 3)
    force, torque = (float(np.mean(history[name][-last:])) for name in ("force", "torque"))
    area = math.pi * RADIUS**2
    figures = {
        "ratio": ratio,
        "force": force,
        "torque": torque,
        "force_factor": force / (area * STRENGTH),
        "torque_factor": torque / (2 * area * RADIUS * STRENGTH),
        "torque_by_force": torque / force,
        "lever": force * args.pitch / (2 * math.pi),
        "work": torque * math.radians(args.step) + force * down,
        "curve": [history[name].tolist() for name in ("turn", "force", "torque")],
        "h": size,
        **solver_figures(clay.problem),
        "seconds": time.perf_counter() - started,
    }
    say(
        f"advance ratio {ratio:g}: push {force / 1e3:.2f} kN, torque {torque / 1e3:.3f} kN m, push "
        f"by p/2π {figures['lever'] / 1e3:.3f} kN m; {figures['unknowns']} unknowns, "
        f"{figures['newton_iterations']} iterations, {figures['seconds']:.0f} s"
    )
    return figures, clay


def picture(path, runs):
    """Draw push and torque over the turn."""
    with mpm.figure(path, 6.5, 2.6, ncols=2) as (_, (left, right)):
        for one in runs:
            turn, force, torque = np.array(one["curve"])
            label = f"advance ratio {one['ratio']:g}"
            left.plot(turn, force / 1e3, marker="o", ms=3, label=label)
            right.plot(turn, torque / 1e3, marker="o", ms=3)
        left.set(xlabel="turn (°)", ylabel="push (kN)")
        right.set(xlabel="turn (°)", ylabel="torque (kN m)")
        left.axhline(0.0, color="0.5", lw=0.6)
        left.legend()


# %%
args = Input.parse()
runs = []
for ratio in args.ratios:
    figures, clay = run(ratio, args)
    runs.append(figures)
if not args.no_plot:
    picture(args.output / "screw_pile.png", runs)
    mpm.plot(
        clay.points, args.output / "screw_pile_clay.png", "plastic_strain", cut=("y", 0.01),
        bodies=[clay.body], limits=(0, 0.5), cmap="YlOrRd",
    )  # fmt: skip
finish(args, {"runs": runs})
