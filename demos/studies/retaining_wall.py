# %% [markdown]
# # A smooth wall and the ground behind it: Rankine's thrusts
#
# A rigid, smooth wall is pushed into level ground with friction and cohesion, or drawn away from
# it. If the ground yields everywhere, the wall carries
#
# $$ P_p = \tfrac12 K_p \gamma H^2 + 2 c \sqrt{K_p} H, \quad K_p = \tan^2(45° + \varphi/2), $$
#
# With $K_a = 1/K_p$ and −c this is the active thrust (Rankine 1857). At large strain the ground
# becomes higher where it is pushed together. So the thrust is compared where it first stops to
# rise.
#
# The ground is at rest at first, with $K_0 = 1 - \sin\varphi$. On a smooth base (`--base smooth`)
# all of it yields. On a rough base a wedge slides up from the foot of the wall. The wall is a
# plane that touches corners of the points' domains.

# %%
import math
from dataclasses import dataclass

import numpy as np
import ufl
from grids import box_grid
from options import Options, natural, option, positive
from scene import finish, say, solver_figures

import dolfinmpm as mpm

GRAVITY = 9.81
# Cohesion that ground has at least, by γH: without any the points at its surface have no stress
LEAST = 1e-3


@dataclass
class Input(Options):
    """A smooth retaining wall is pushed into the ground, or drawn away."""

    friction_angle: float = option(33.5, "φ (degrees)", least=0, below=60)
    dilation_angle: float = option(3.5, "ψ (degrees)")
    cohesion: float = option(300.0, "c (Pa)", least=0)
    unit_weight: float = positive(1670 * GRAVITY, "γ (N/m³)")
    height: float = positive(1.0, "H (m)")
    length: float = positive(3.0, "of the ground, in heights")
    modulus: float = positive(26e6, "Young's modulus (Pa)")
    poisson: float = 0.3
    direction: str = option("passive", choices=("passive", "active"))
    wall_friction: float = option(0.0, "coefficient")
    base: str = option("smooth", choices=("smooth", "rough"))
    h: float = positive(0.125, "size of the cells (m)")
    points_per_cell: int = natural(2)
    basis: str = option("gimp", choices=("gimp", "linear", "bspline2"))
    steps: int = natural(40)
    displacement: float | None = option(None, "last one of the wall (m)")
    penalty: float | None = positive(None, "κ h/E; 100 h/m by default")
    stabilisation: str = "none"

    def _check(self):
        self.fill(penalty=100.0 * self.h)
        if self.friction_angle == 0 and self.cohesion == 0:
            raise ValueError("ground without friction and cohesion carries nothing")


def rankine(args):
    """Passive and active thrust (N/m)."""
    phi, H, c = math.radians(args.friction_angle), args.height, args.cohesion
    weight = 0.5 * args.unit_weight * H**2
    K = math.tan(math.pi / 4 + phi / 2) ** 2
    # cohesive ground does not pull at the wall: what is above the depth of no pressure stands alone
    free = 2 * c * math.sqrt(K) / args.unit_weight
    active = 0.5 * args.unit_weight / K * max(H - free, 0.0) ** 2
    return K * weight + 2 * c * math.sqrt(K) * H, active


# %%
class Scene:
    """The ground, and the wall at its left."""

    def __init__(self, args):
        H, phi = args.height, math.radians(args.friction_angle)
        n = max(2, round(H / args.h))
        self.h = h = H / n
        wide, room = round(args.length * n), 2
        ends = [(-room * h, 0.0), (wide * h, H + 2 * h)]
        grid = box_grid(ends, (wide + room, n + 2))
        density, sign = args.unit_weight / GRAVITY, 1 if args.direction == "passive" else -1
        ground = mpm.Box((0, 0), (wide * h, H))
        self.points = points = mpm.fill(grid, ground, args.points_per_cell, density)
        V = mpm.Space(grid, args.basis)
        u, v = V.increment, V.test
        sand = mpm.materials.MohrCoulomb(
            args.modulus, args.poisson, max(args.cohesion, LEAST * args.unit_weight * H),
            args.friction_angle, dilation_angle=args.dilation_angle,
        )  # fmt: skip
        rest = max(1 - math.sin(phi), args.poisson / (1 - args.poisson)) if phi else 1.0
        mpm.set_stress(sand, points, mpm.geostatic_stress(H, args.unit_weight, rest))
        # strain that makes the ground yield down to its foot, over the whole length
        passive, active = rankine(args)
        missing = abs((passive if sign > 0 else active) - 0.5 * rest * args.unit_weight * H**2)
        enough = 2.5 * missing / (0.5 * H * args.modulus) * wide * h
        self.displacement = args.displacement or max(enough, 1e-4 * H)
        self.ahead = 0.0
        self.wall = mpm.RigidBody(
            mpm.Plane((0, 0), (1, 0)), name="wall", increment=lambda t: (self.ahead, 0.0)
        )
        F = mpm.momentum(sand, points, u, v)
        F -= ufl.inner(points.density * ufl.as_vector((0.0, -GRAVITY)), v) * points.dX
        F += mpm.contact(self.wall, points, u, v, friction=args.wall_friction, penalty=args.penalty)
        bottom = mpm.rollers(V, "bottom") if args.base == "smooth" else mpm.fixed(V, "bottom")
        self.problem = mpm.QuasiStatic(
            F, u, points, mpm.rollers(V, "right") + bottom, stabilisation=args.stabilisation
        )
        self.steps, self.sign = args.steps, sign
        self.history = mpm.History()

    def step(self):
        """One step; keeps the thrust. Collective."""
        record = self.problem.step()
        self.history.record(
            displacement=abs(float(self.wall.position[0])), thrust=-float(self.wall.force[0]),
            iterations=record.iterations,
        )  # fmt: skip

    def run(self):
        """Let the wall take the thrust at rest, and push. Collective."""
        self.step()
        self.ahead = self.sign * self.displacement / self.steps
        for _ in mpm.steps(self.steps, label="wall"):
            self.step()


def reached(history, sign):
    """Thrust where it first stops to change (N/m), and the displacement there (m)."""
    s, P = history["displacement"], history["thrust"]
    slope = sign * np.diff(P) / np.diff(s)
    # within a hundredth of the first slope
    flat = np.flatnonzero(slope < 0.01 * slope[:3].max())
    k = int(flat[0]) if flat.size else len(P) - 1
    return float(P[k]), float(s[k]), bool(flat.size)


def draw(args, history, figures):
    """Thrust against displacement; rank 0 writes."""
    path = args.output / f"retaining_wall_{args.direction}.png"
    with mpm.figure(path, 4.0, 3.0) as (_, axes):
        axes.axhline(figures["exact_thrust"] / 1e3, color="k", lw=1, label="Rankine")
        s, P = history["displacement"], history["thrust"]
        axes.plot(1e3 * s, P / 1e3, "o-", ms=3, lw=1, label="material points")
        axes.set(xlabel="displacement of the wall (mm)", ylabel="thrust (kN/m)", ylim=(0, None))
        axes.legend()


# %%
args = Input.parse()
scene = Scene(args)
scene.run()
thrust, displacement, done = reached(scene.history, scene.sign)
exact = rankine(args)[0 if scene.sign > 0 else 1]
figures = {
    "thrust": thrust, "displacement_reached": displacement, "reached": done,
    "last_thrust": float(scene.history["thrust"][-1]), "exact_thrust": exact,
    "thrust_error": thrust / exact - 1 if exact else None,
    "at_rest": float(scene.history["thrust"][0]), **solver_figures(scene.problem),
}  # fmt: skip
error = f"{100 * figures['thrust_error']:+.2f} %" if exact else "which is none"
say(
    f"{args.direction} thrust {thrust:.6g} N/m at {1e3 * displacement:.3g} mm, Rankine "
    f"{exact:.6g} ({error}); last {figures['last_thrust']:.6g}; at most "
    f"{figures['max_newton_iterations']} iterations"
)
if not args.no_plot:
    draw(args, scene.history, figures)
finish(args, figures)
