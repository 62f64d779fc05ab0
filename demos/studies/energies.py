# %% [markdown]
# # Energy that is kept: blocks, free bodies, impacts
#
# Steps in time may add energy to a body, or take energy from it, without a physical cause.
# `energies` counts all of it, with losses by name.
#
# - `--scene block`: the weight of a cut elastic block acts suddenly. The figure is the share of
#   the peak energy that is lost in two periods.
# - `--scene bodies`: discs and boxes in free motion, of random laws, bases, sizes, velocities and
#   steps. The figure is the share of the first energy that is kept.
# - `--scene impact`: a free rigid disc hits a free elastic block, with friction or without.
# - `--scene impacts`: random rigid discs and boxes hit random elastic ones.
# - `--scene discs`: two elastic discs with separate fields collide. `--aside` is the offset of
#   their lines.
#
# In implicit steps contact acts by its mean force over a step. This force gives back the energy
# that it has stored. In explicit steps contact acts at the start of the step, and the points move
# by the velocities that strain them.

# %%
import math
from dataclasses import dataclass

import numpy as np
import ufl
from dolfinx import fem
from grids import box_grid
from mpi4py import MPI
from options import Options, option
from scene import finish, say

import dolfinmpm as mpm

COMM = MPI.COMM_WORLD
KINDS = {
    "newmark": mpm.Newmark, "generalised-alpha": mpm.GeneralisedAlpha, "explicit": mpm.Explicit,
}  # fmt: skip


def squares(low, high, h=0.1):
    """A grid of squares that covers a box."""
    n = [round((b - a) / h) for a, b in zip(low, high)]
    return box_grid([low, high], n)


def problem_of(args, F, u, points, bcs=()):
    """Steps in time as the command line has them."""
    options = {} if args.integrator == "explicit" else {"stabilisation": args.stabilisation}
    if args.integrator == "generalised-alpha":
        options["rho_inf"] = args.rho_inf
    return KINDS[args.integrator](F, u, points, bcs, **options)


def followed(problem, times):
    """Energy kept at the end and the most there was, by what there was and was done (%)."""
    most = 0.0
    for t in times:
        problem.step(t)
        e = problem.energies()
        there = e.kinetic + e.strain + e.bodies + e.contact
        most = max(most, there / (e.initial + e.external))
    whole = e.initial + e.external
    losses = {name: 100 * loss / whole for name, loss in e.losses.items()}
    return {"kept": 100 * there / whole, "most": 100 * most, "losses": losses}


# %%
def block(args):
    """Share of the peak energy that is lost in two periods (%)."""
    n, offset = args.cells, 0.3
    h = 1.0 / n
    grid = box_grid([(0, 0), (2.0, 1.5)], (2 * n, 3 * n // 2))
    body = mpm.Box((0.5 + offset * h, 0), (1.5 + offset * h, 1.0 - offset * h))
    points = mpm.fill(grid, body, 2, 1000.0, aligned="body")
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    gravity = fem.Constant(grid, (0.0, -9.81))
    F = mpm.momentum(mpm.materials.Hencky(1e6, 0.3), points, u, v)
    F -= ufl.inner(points.density * gravity, v) * points.dX
    problem, peak = problem_of(args, F, u, points, mpm.fixed(V, "bottom")), 0.0
    for t in mpm.times(0.24, dt=args.dt):
        problem.step(t)
        e = problem.energies()
        peak = max(peak, e.kinetic + e.strain)
    return {"lost": 100 * (e.external - e.kinetic - e.strain) / peak}


def impact(args):
    """A free rigid disc on a free elastic block."""
    R, m, speed = 0.15, 40.0, 0.6
    grid = squares((0, 0), (2, 1.5))
    points = mpm.fill(grid, mpm.Box((0.5, 0.4), (1.5, 0.9)), 2, 1000.0)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    across = 0.5 if args.friction else 0.0
    ball = mpm.RigidBody(
        mpm.Disc((1.0, 0.91 + R), R), mass=m, inertia=0.5 * m * R**2, velocity=(across, -speed)
    )
    F = mpm.momentum(mpm.materials.Hencky(E=2e6, nu=0.3), points, u, v)
    F += mpm.contact(ball, points, u, v, friction=args.friction)
    return followed(problem_of(args, F, u, points), mpm.times(0.1, dt=args.dt))


def discs(args):
    """Two elastic discs with fields of their own."""
    R, centres = 0.4, [(1.05, 1.0), (1.95, 1.0 + args.aside)]
    grid = squares((0, 0), (3, 2))
    parts = [mpm.fill(grid, mpm.Disc(c, R), 3, 1000.0, tag=k + 1) for k, c in enumerate(centres)]
    points = parts[0] + parts[1]
    spaces = [mpm.Space(grid, "gimp", tag=k) for k in (1, 2)]
    u, v = [V.increment for V in spaces], [V.test for V in spaces]
    law = mpm.materials.Hencky(1e6, 0.3)
    F = sum(mpm.momentum(law, points, u[k], v[k]) for k in (0, 1))
    at = 2 * math.pi * np.arange(60) / 60
    rims = [
        mpm.Boundary.from_polygon(
            points, [(x + R * math.cos(t), y + R * math.sin(t)) for t in at]
        )
        for x, y in centres
    ]  # fmt: skip
    F += mpm.contact_between(rims, u, v, friction=args.friction)
    points.add_field("velocity", (2,), "m/s")
    points["velocity"] = np.where((points["tag"] == 1)[:, None], 1.0, -1.0) * [1.0, 0.0]
    return followed(problem_of(args, F, u, points), mpm.times(0.25, dt=args.dt))


# %%
def free_body(args, seed):
    """A body in free motion, or None where the grid is left."""
    rng = np.random.default_rng(seed)
    h, E, nu, rho = 0.1, 1e6, rng.uniform(0.1, 0.4), 1000.0
    c = math.sqrt(E * (1 - nu) / ((1 + nu) * (1 - 2 * nu)) / rho)
    R, centre = rng.uniform(0.3, 0.6), np.array([2.0, 2.0]) + rng.uniform(-0.05, 0.05, 2)
    if rng.random() < 0.5:
        body = mpm.Disc(tuple(centre), R)
    else:
        half = np.array([R, rng.uniform(0.3, 0.6)])
        body = mpm.Box(tuple(centre - half), tuple(centre + half))
    materials = mpm.materials
    laws = (
        materials.Hencky(E, nu),
        materials.VonMises(E, nu, radius=10 * E),
        materials.NeoHookean(E, nu),
    )
    law, basis = laws[rng.integers(3)], ["gimp", "bspline2"][rng.integers(2)]
    grid = squares((0, 0), (4, 4))
    points = mpm.fill(grid, body, int(rng.integers(2, 4)), rho)
    V = mpm.Space(grid, basis)
    A = rng.normal(size=(2, 2))
    A *= rng.uniform(0.02, 0.15) * c / (np.linalg.norm(A) * R)
    points.add_field("velocity", (2,), "m/s")
    points["velocity"] = (points["x"] - centre) @ A.T
    F = mpm.momentum(law, points, V.increment, V.test)
    crossings, courant = rng.uniform(3, 8), rng.uniform(0.2, 1.0)
    count = max(1, round(crossings * 2 * R / (courant * h)))
    dt = courant * h / c
    return followed(problem_of(args, F, V.increment, points), dt * np.arange(1, count + 1))


def random_impact(args, seed):
    """A rigid disc or box on an elastic disc or box, with steps up to a fifth of the contact's."""
    rng = np.random.default_rng(seed)
    E, nu, rho = 10 ** rng.uniform(5.5, 7), rng.uniform(0, 0.4), 1000.0
    c = math.sqrt(E * (1 - nu) / ((1 + nu) * (1 - 2 * nu)) / rho)
    grid = squares((0, -1.5), (3, 2.4))
    low = np.array([0.8, 0.5]) + rng.uniform(-0.05, 0.05, 2)
    high = np.array([2.2, 1.1]) + rng.uniform(-0.05, 0.05, 2)
    round_one = rng.random() < 0.3
    body = mpm.Disc((1.5, 0.8), rng.uniform(0.3, 0.45)) if round_one else mpm.Box(low, high)
    points = mpm.fill(grid, body, int(rng.integers(2, 4)), rho)
    top = float((points["x"][:, 1] + points["l0"][:, 1]).max())
    basis = ["gimp", "linear", "bspline2", "gimp"][rng.integers(4)]
    growth = ["stretch", "volume", "fixed"][rng.integers(3)]
    V = mpm.Space(grid, basis, **({"domains": growth} if basis == "gimp" else {}))
    R, gap = rng.uniform(0.08, 0.25), rng.uniform(0.001, 0.02)
    x, kind = 1.5 + rng.uniform(-0.2, 0.2), rng.integers(3)
    y = top + gap + R * (1.45 if kind == 2 else 1.0)
    ends = (x - R, y - R), (x + R, y + R)
    angle = rng.uniform(0.1, 0.7)
    shape = [mpm.Disc((x, y), R), mpm.Box(*ends), mpm.TurnedBox(*ends, math.degrees(angle))][kind]
    m, speed = rng.uniform(0.3, 3) * rho * math.pi * R**2, rng.uniform(0.005, 0.05) * c
    rigid = mpm.RigidBody(
        shape, mass=m, inertia=0.5 * m * R**2,
        velocity=(rng.uniform(-0.5, 0.5) * speed, -speed),
        angular_velocity=math.degrees(rng.uniform(-0.3, 0.3) * speed / R),
    )  # fmt: skip
    corners, penalty = [None, "material"][rng.integers(2)], float(rng.choice([1.0, 5.0, 20.0]))
    F = mpm.momentum(mpm.materials.Hencky(E, nu), points, V.increment, V.test)
    F += mpm.contact(
        rigid, points, V.increment, V.test, friction=args.friction, corners=corners, penalty=penalty
    )
    contact = math.pi * math.sqrt(m / (0.5 * E))
    dt = contact * 10 ** rng.uniform(-2, -0.7)
    duration = gap / speed + 3 * contact
    if args.integrator == "explicit":
        dt = duration / 60
    count = max(3, round(duration / dt))
    return followed(problem_of(args, F, V.increment, points), dt * np.arange(1, count + 1))


def random_scenes(make):
    """A study of many random scenes."""

    def study(args):
        found, failed = [], {}
        for seed in range(args.first, args.first + args.count):
            try:
                found.append(make(args, seed))
            except mpm.errors.DolfinMPMError as error:
                failed[seed] = str(error)
                say(f"{seed}: {error}")
                continue
            one = found[-1]
            say(f"{seed}: {one['kept']:.3f} % kept, at most {one['most']:.3f} %")
        kept = [one["kept"] for one in found]
        return {
            "median": float(np.median(kept)), "worst": min(kept),
            "most": max(one["most"] for one in found), "failed": len(failed),
        }  # fmt: skip

    return study


SCENES = {
    "block": block, "bodies": random_scenes(free_body), "impact": impact,
    "impacts": random_scenes(random_impact), "discs": discs,
}  # fmt: skip


@dataclass
class Input(Options):
    """Energy that steps in time keep."""

    scene: str = option("impact", choices=tuple(SCENES))
    integrator: str = option("newmark", choices=tuple(KINDS))
    rho_inf: float = option(1.0, "of generalised-alpha")
    stabilisation: str | None = option(None, choices=("none", "ghost", "aggregation"))
    dt: float = option(5e-4, "step (s), where it is not random")
    cells: int = option(8, "cells in the height of the block")
    friction: float = option(0.0, "coefficient μ")
    aside: float = option(0.0, "(m), see above")
    first: int = option(0, "first seed of random scenes")
    count: int = option(34, "number of random scenes")

    def _check(self):
        self.fill(stabilisation="none" if self.integrator == "explicit" else "ghost")


def main(args):
    """Run the scene and tell its figures."""
    figures = SCENES[args.scene](args)
    for name, value in figures.items():
        say(f"{name}: {value}")
    finish(args, figures)


if __name__ == "__main__":
    main(Input.parse())
