# %% [markdown]
# # Explicit steps: how many points per second
#
# A block of side 1 m shears and turns everywhere. So every point strains in every step, and with
# a plastic law every point yields. The speed is points times steps over the time of the steps,
# without start, compilation and output. All cases run in turn, several times, and the median is
# printed, because a shared machine changes its speed from minute to minute. For the same reason
# other codes (`--peers warp,taichi`, where their packages are installed) run in the same session.
# They have the same scene, basis, law and double precision, and their points end at the same
# places. Under `mpirun` the time is that of all ranks together. With `--tools` rigid bodies rub
# along the upper side of the block. Each case then runs without them, with them, and with them in
# general steps that are not fused. With `--axisymmetric` the block is the section of a ring.

# %%
from __future__ import annotations

import importlib.util
import statistics
import time
from dataclasses import dataclass

import numpy as np
import ufl
from dolfinx import fem
from explicit_peers import PEERS, neo_hookean
from grids import box_grid
from mpi4py import MPI
from options import Options, natural, option
from scene import finish, say

import dolfinmpm as mpm

E, NU, DENSITY = 1e6, 0.3, 1000.0
LAWS = {
    "neo-hookean": lambda: mpm.materials.NeoHookean(E=E, nu=NU),
    "hencky": lambda: mpm.materials.Hencky(E=E, nu=NU),
    "von-mises": lambda: mpm.materials.VonMises(E=E, nu=NU, radius=20.0),
    "mohr-coulomb": lambda: mpm.materials.MohrCoulomb(
        E=E, nu=NU, cohesion=1.0, friction_angle=20.0, dilation_angle=0.0
    ),
}
MARGIN = 10
TOOLS = ("plane", "ball", "box")


@dataclass
class Input(Options):
    """Points times steps a second of explicit steps."""

    laws: list[str] = option(list(LAWS), "of " + ", ".join(LAWS), choices=tuple(LAWS))
    bases: list[str] = option(
        ["bspline2"], "linear, gimp, bspline2, bspline3; averaged-bspline2 averages it over domains"
    )
    schemes: list[str] = option(["usl"])
    mapping: str = "flip"
    points: int = option(100_000, "about so many")
    dimension: int = option(2, choices=(2, 3))
    axisymmetric: bool = option(False, "a ring, with the axis 1 m beside the block")
    points_per_cell: int = natural(2, "in each direction")
    steps: int = natural(100, "in each run that is timed")
    repeat: int = 5
    tools: list[str] = option([], "of " + ", ".join(TOOLS), choices=tuple(TOOLS))
    peers: list[str] = option([], "of " + ", ".join(PEERS), choices=tuple(PEERS))

    def _check(self):
        if self.peers and (MPI.COMM_WORLD.size > 1 or self.dimension > 2):
            raise ValueError("other codes are run on one rank and in two dimensions")
        if self.axisymmetric and (self.peers or self.tools or self.dimension > 2):
            raise ValueError("a ring has two dimensions, no tools and no other codes beside it")


args = Input.parse()
comm, d = MPI.COMM_WORLD, args.dimension
cells = max(1, round(args.points ** (1 / d) / args.points_per_cell))
h = 1.0 / cells
COURANT = 0.3
# the block's lower corner (m)
CORNER = np.array([1.0 if args.axisymmetric else 0.0, 0.0, 0.0][:d])


def swirl(x):
    """Velocities that strain everywhere (m/s)."""
    v = np.zeros_like(x)
    v[:, 0], v[:, 1] = 2 * np.sin(6 * x[:, 1]), -2 * np.sin(6 * x[:, 0])
    if x.shape[1] == 3:
        v[:, 2] = np.sin(6 * x[:, 0])
    return v


def rigid(name):
    """A rigid body that moves along the block's upper side, 1 µm above it."""
    middle, top = (0.5,) * (d - 1), 1.0 + 1e-6
    shape = {
        "plane": lambda: mpm.Plane((*middle, top), (0,) * (d - 1) + (-1,)),
        "ball": lambda: mpm.Ball((*middle, top + 0.3), 0.3),
        "box": lambda: mpm.Box((0.3,) * (d - 1) + (top,), (0.7,) * (d - 1) + (top + 0.5,)),
    }[name]()
    fillet = 0.02 if name == "box" else 0.0
    return mpm.RigidBody(shape, fillet=fillet, velocity=(0.3,) + (0,) * (d - 2) + (-0.3,))


class Ours:
    """A block in this package, ready to be timed."""

    def __init__(self, law, basis, scheme, tool=None, fused=True):
        n = [cells + 2 * MARGIN] * d
        grid = box_grid([CORNER - MARGIN * h, CORNER + 1 + MARGIN * h], n)
        block, rings = mpm.Box(CORNER, CORNER + 1), {"axisymmetric": args.axisymmetric}
        self.points = mpm.fill(grid, block, args.points_per_cell, DENSITY, **rings)
        averaged = basis.startswith("averaged-")
        name = basis.removeprefix("averaged-")
        splines = {"averaged": averaged} if name.startswith("bspline") else {}
        V = mpm.Space(grid, name, **splines)
        gravity = fem.Constant(grid, (0.0, -10.0, 0.0)[:d])
        F = mpm.momentum(LAWS[law](), self.points, V.increment, V.test)
        F -= ufl.inner(self.points.density * gravity, V.test) * self.points.dX
        if tool is not None:
            u, v = V.increment, V.test
            F += mpm.contact(rigid(tool), self.points, u, v, friction=0.3, penalty=1.0)
        # general steps take ten times as long
        self.share = 1.0 if fused else 0.1
        self.points.add_field("velocity", (d,), "m/s")
        self.points["velocity"] = swirl(self.points["x"] - CORNER)
        self.problem = mpm.Explicit(
            F, V.increment, self.points, mpm.fixed(V, "bottom"), scheme=scheme,
            mapping=args.mapping, courant=COURANT, fused=fused,
        )  # fmt: skip
        self.longest = COURANT * self.problem.critical_step()
        self.number = self.points.total
        self.yields = law in ("von-mises", "mohr-coulomb")

    def __call__(self, steps):
        """Take about so many steps; returns how many it took, and how long they were (s)."""
        steps = max(2, round(self.share * steps))
        record = self.problem.step(self.problem.time + (steps - 0.01) * self.longest)
        return record.parts, record.dt

    def yielding(self):
        """Share of the points that have yielded. Collective."""
        if not self.yields:
            return None
        yielded = int(np.count_nonzero(self.points["plastic_strain"] > 0))
        return comm.allreduce(yielded) / self.number


class Peer:
    """The block in another code, whose functions have their centres on the grid's lines."""

    def __init__(self, name):
        reference = first.points
        shift = (MARGIN + 0.5) * h
        self.number = reference.total
        scene = {
            "x": reference["x0"] + shift, "v": swirl(reference["x0"]), "h": h, "dt": first_dt,
            "side": cells + 2 * MARGIN + 2, "held": 1, **neo_hookean(E, NU),
            "mass": DENSITY / self.number, "V0": 1.0 / self.number,
        }  # fmt: skip
        self.go, positions = PEERS[name](scene)
        self.positions = lambda: positions() - shift

    def __call__(self, steps):
        """Take so many steps; returns how many, and how long they are (s)."""
        self.go(steps)
        return steps, first_dt


# %% [markdown]
# ## Cases
# Everything is compiled, and runs a few steps, before anything is timed.

# %%
cases = {}
for basis in args.bases:
    for scheme in args.schemes:
        for law in args.laws:
            cases[f"{law} {basis} {scheme}"] = Ours(law, basis, scheme)
            for tool in args.tools:
                name = f"{law} {basis} {scheme} {tool}"
                cases[name] = Ours(law, basis, scheme, tool)
                cases[f"{name} general"] = Ours(law, basis, scheme, tool, fused=False)
if args.peers:
    # how far, and in which steps, others are to go for the comparison
    first = Ours("neo-hookean", "bspline2", "usl")
    first_steps, first_dt = first(5)
for name in args.peers:
    if importlib.util.find_spec(name) is None:
        say(f"{name} is not installed: pip install {'warp-lang' if name == 'warp' else name}")
        continue
    cases[name] = Peer(name)
for name in args.peers:
    if name in cases:
        # a speed is worth nothing unless the same work is done
        cases[name](first_steps)
        x = first.points["x"]
        way = np.abs(x - first.points["x0"]).max()
        away = float(np.abs(cases[name].positions() - x).max() / way)
        say(f"{name}: points end {away:.1e} of the largest way from ours")
        assert away < 1e-9, name
for case in cases.values():
    case(5)

speeds: dict[str, list[float]] = {name: [] for name in cases}
for _ in range(args.repeat):
    for name, case in cases.items():
        comm.barrier()
        started = time.perf_counter()
        taken, _ = case(args.steps)
        comm.barrier()
        seconds = time.perf_counter() - started
        speeds[name].append(1e-6 * case.number * taken / seconds)

figures = {}
for name, case in cases.items():
    speed, best = statistics.median(speeds[name]), max(speeds[name])
    share = case.yielding() if isinstance(case, Ours) else None
    unfused = case.problem.unfused if isinstance(case, Ours) else None
    bodies = case.problem.bodies.all if isinstance(case, Ours) else []
    figures[name] = {
        "points": case.number, "million_point_steps_per_second": speed, "best": best,
        "yielding": share, "unfused": unfused,
        "force": [float(np.linalg.norm(body.force)) for body in bodies],
    }  # fmt: skip
    say(
        f"{name:32s} {case.number:8d} points: {speed:6.2f} million point-steps/s (best {best:.2f})"
        + (f", {share:.1%} of the points yield" if share is not None else "")
        + "".join(f", {force:.3g} N on the tool" for force in figures[name]["force"])
        + (f"; not fused: {unfused}" if unfused else "")
    )

# %% [markdown]
# ## Picture


# %%
if not args.no_plot and comm.rank == 0:
    with mpm.figure(args.output / "explicit_speed.png", 6.0, 0.6 + 0.32 * len(cases)) as (_, ax):
        names = list(cases)[::-1]
        widths = [figures[name]["million_point_steps_per_second"] for name in names]
        bars = ax.barh(names, widths, color=["0.6" if n in PEERS else "C0" for n in names])
        ax.bar_label(bars, fmt="%.1f", padding=3)
        ax.set(xlabel="million points times steps per second", xlim=(0, 1.15 * max(widths)))
        ax.grid(visible=False, axis="y")

finish(args, {"cases": figures, "ranks": comm.size})
