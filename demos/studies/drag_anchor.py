# %% [markdown]
# # A drag anchor dives into clay
#
# A plate, the fluke of an anchor, lies in weightless clay of one strength and is dragged by a line.
# The line pulls at the pad eye, which is fixed to the fluke above it. The fluke's way forward is
# given; its heave and its pitch follow from equilibrium with the line, so that the anchor finds
# its own path. One half is solved, symmetric about y = 0.
#
# Neubecker & Randolph (1996, doi 10.1139/t96-027, after OTC 7712, 1995) follow an anchor so:
#
# - it moves along its fluke;
# - the angle $\theta_w$ between fluke and line is that at which the line goes from the pad eye
#   through the fluke's centre;
# - the line has the angle $\theta_a$ to the horizontal at the pad eye, $T\theta_a^2/2 = \bar Q z$
#   at a depth z, where the line, of the width b, cuts through clay with $\bar Q = N_c\,b\,s_u$.
#
# Then the fluke's inclination is $\theta_w - \theta_a$, and the path follows from it. The line
# itself is that equation here too; the anchor is not. Its forces on the line are those of the step
# before, so that steps are short.
#
# What comes out:
#
# - The fluke is laid at 35°, and pitches within a third of a metre to the attitude that the line
#   asks for. In cells of 0.125 m (`--levels 2 --way 0.4`) it is inclined by 25.3° over the second
#   half of the way, by 21.3° after Neubecker and Randolph. It dives at 19.3°, after them at 23.1°.
#   The tension is 31 kN, 3.1 strengths on the fluke's area.
# - In cells of 0.25 m the inclination is 25.1°, after them 27.9°. But the fluke dives at 14.8°
#   only, after them at 28.6°, and the tension is 50 kN: such cells hold a blunt fluke that is
#   thinner than they are.
# - Gaps stay open behind the fluke, because the clay has no weight.
# - A fluke that is laid at 22° finds no equilibrium in the first step.

# %%
from __future__ import annotations

import math
import time
from dataclasses import dataclass

import numpy as np
from driven_bodies import Clay, closed
from options import Options, option, positive
from scene import finish, say, solver_figures

import dolfinmpm as mpm

STRENGTH, LENGTH, START = 10e3, 1.0, 1.75  # Pa, m, m
BEARING = 7.6  # N_c of a line in clay


@dataclass
class Input(Options):
    """An anchor is dragged through clay."""

    way: float = positive(0.5, "of the drag (m)")
    step: float = positive(0.025, "of the way (m)")
    inclination: float = option(35.0, "of the fluke at first (degrees)", least=0, most=80)
    eye: float = option(
        50.0, "between fluke and the way to the pad eye (degrees)", above=0, most=90
    )
    arm: float = positive(0.75, "from the fluke's centre to the pad eye (m)")
    thickness: float = positive(0.2, "of the fluke (m)")
    line: float = positive(0.03, "width of the line (m)")
    levels: int = option(1, "how often cells of 0.5 m are halved near the fluke", least=1, most=4)


# %%
def fluke(args):
    """The fluke, 1 m by 1 m, inclined; forward and down is the way that its tip points."""
    a = math.radians(args.inclination)
    along, normal = (
        np.array([math.cos(a), 0, -math.sin(a)]),
        np.array([math.sin(a), 0, math.cos(a)]),
    )
    centre, t, s = np.array([0.0, 0.0, -START]), args.thickness / 2, LENGTH / 2
    # a blunt edge behind, a sharp one in front
    section = [(-s, -t), (0.6 * s, -t), (s, 0.0), (0.6 * s, t), (-s, t)]
    x = [centre + p * along + n * normal + (0.0, y, 0.0) for y in (-s, s) for p, n in section]
    n = len(section)
    rim = [(k, k + n, (k + 1) % n + n, (k + 1) % n) for k in range(n)]
    return closed(x, [tuple(range(n)), tuple(range(2 * n - 1, n - 1, -1)), *rim])


class Line:
    """Force and moment (N, N m) of the line on half of the anchor, about the fluke's centre."""

    def __init__(self, args):
        self.args, self.anchor = args, None
        self.tension = self.angle = 0.0

    def inclination(self):
        """Of the fluke now (radians)."""
        return math.radians(self.args.inclination + float(self.anchor.angle[1]))

    def pull(self):
        """Forces in x and z that balance the clay in x, at the line's angle."""
        if self.anchor is None:
            return 0.0, 0.0
        forward = max(0.0, -float(self.anchor.force[0]))
        depth = -float(self.anchor.position[2]) - self.args.arm * 0.5
        side = BEARING * self.args.line * STRENGTH * depth / 2  # half of the anchor
        # T θ²/2 = Q z, where T cos θ balances the clay; no line is steeper than 40° at first
        self.angle = math.sqrt(2 * side / max(forward, 4 * side))
        self.tension = forward / math.cos(self.angle)
        return forward, self.tension * math.sin(self.angle)

    def force(self, t):
        """Force of the line (N) that the fluke's motion follows; its way in x is given."""
        return 0.0, 0.0, self.pull()[1]

    def moment(self, t):
        """Moment of the line about the fluke's centre (N m)."""
        forward, up = self.pull()
        if self.anchor is None:
            return 0.0, 0.0, 0.0
        to_eye = math.radians(self.args.eye) - self.inclination()
        arm = self.args.arm * np.array([math.cos(to_eye), math.sin(to_eye)])
        return 0.0, arm[1] * forward - arm[0] * up, 0.0


def predicted(args, ways, tension, start):
    """Depths of the fluke's centre after Neubecker and Randolph, for a tension (N, whole)."""
    depths = [start]
    for step in np.diff(ways):
        below = depths[-1] - 0.5 * args.arm
        angle = math.sqrt(2 * BEARING * args.line * STRENGTH * below / tension)
        depths.append(depths[-1] + step * math.tan(math.radians(args.eye) - angle))
    return np.array(depths)


# %%
def run(args):
    """Drag the anchor; returns figures and the clay. Collective."""
    started, going, line = time.perf_counter(), [0.0], Line(args)
    anchor = mpm.RigidBody(
        fluke(args), increment=lambda t: (args.step * going[0], 0.0, 0.0),
        centre=(0.0, 0.0, -START), free=(False, False, True, False, True, False),
        force=line.force, moment=line.moment, name="anchor",
    )  # fmt: skip
    line.anchor = anchor
    clay = Clay((-1.5, 0.0, -3.5), (2.5, 1.5, 0.0), 0.5, args.levels, anchor, strength=STRENGTH)
    clay.problem.step()
    going[0], history = 1.0, mpm.History()
    for k in range(round(args.way / args.step)):
        clay.problem.step()
        line.pull()
        history.record(
            way=(k + 1) * args.step, depth=-float(anchor.position[2]), tension=2 * line.tension,
            inclination=math.degrees(line.inclination()), angle=math.degrees(line.angle),
        )  # fmt: skip
    names = "way", "depth", "tension", "inclination", "angle"
    way, depth, tension, inclination, angle = (history[name] for name in names)
    half = len(way) // 2
    mean = float(np.mean(tension[half:]))
    # from the middle of the way on, so that the first contact is past
    moved = np.arctan2(depth[-1] - depth[half], way[-1] - way[half])
    path = predicted(args, way[half:], mean, depth[half])
    figures = {
        "curve": [history[name].tolist() for name in names],
        "tension": mean,
        # T cos θ_w on the fluke's front, w t s_u; N_c of the edge in Neubecker and Randolph is 9
        "front_factor": mean
        * math.cos(math.radians(args.eye))
        / (LENGTH * args.thickness * STRENGTH),
        "dive": math.degrees(moved),
        "inclination": float(np.mean(inclination[half:])),
        "angle": float(np.mean(angle[half:])),
        "inclination_predicted": args.eye - float(np.mean(angle[half:])),
        "dive_predicted": math.degrees(math.atan2(path[-1] - path[0], way[-1] - way[half])),
        "depth": float(depth[-1]),
        "depth_predicted": float(path[-1]),
        "h": 0.5 / 2**args.levels,
        **solver_figures(clay.problem),
        "seconds": time.perf_counter() - started,
    }
    say(
        f"drag of {way[-1]:g} m: tension {mean / 1e3:.1f} kN at {figures['angle']:.1f}°, the fluke "
        f"inclined by {figures['inclination']:.1f}° ({figures['inclination_predicted']:.1f}° after "
        f"Neubecker and Randolph), diving at {figures['dive']:.1f}° "
        f"({figures['dive_predicted']:.1f}°); {figures['unknowns']} unknowns, "
        f"{figures['newton_iterations']} iterations, {figures['seconds']:.0f} s"
    )
    return figures, clay


def picture(path, args, figures):
    """Draw the fluke's path and the tension over the way."""
    way, depth, tension, *_ = np.array(figures["curve"])
    half = len(way) // 2
    with mpm.figure(path, 6.5, 2.6, ncols=2) as (_, (left, right)):
        left.plot(way, depth, marker="o", ms=3, label="material points")
        expected = predicted(args, way[half:], figures["tension"], depth[half])
        left.plot(way[half:], expected, "k--", lw=1, label="Neubecker & Randolph")
        left.set(xlabel="distance (m)", ylabel="depth of the fluke (m)")
        left.invert_yaxis()
        left.legend()
        right.plot(way, tension / 1e3, marker="o", ms=3)
        right.set(xlabel="distance (m)", ylabel="tension at the pad eye (kN)", ylim=(0, None))


# %%
args = Input.parse()
figures, clay = run(args)
if not args.no_plot:
    picture(args.output / "drag_anchor.png", args, figures)
    mpm.plot(
        clay.points, args.output / "drag_anchor_clay.png", "plastic_strain", cut=("y", 0.01),
        bodies=[clay.body], limits=(0, 0.5), cmap="YlOrRd",
    )  # fmt: skip
finish(args, figures)
