# %% [markdown]
# # Free-field sides: level ground is level ground, and waves of a hill leave
#
# Ground in an earthquake has no sides, but a computation has. Tied sides make the ground repeat
# itself: right for level ground, and wrong beside a hill, whose waves come back. A free-field side
# feels the stress of a column of the ground beside the body, and dashpots on the difference of both
# velocities. The column takes its steps first, under the same wave.
#
# **Level ground** of two layers on rock, between free-field sides. With $A$ and $B$ the up-going
# and the down-going wave at the top of a layer of the thickness $d$, the layer below it has (Kramer
# 1996, eq. 7.34, without damping)
#
# $$A' = \tfrac12 A (1 + \alpha) e^{ikd} + \tfrac12 B (1 - \alpha) e^{-ikd}, \qquad
#   B' = \tfrac12 A (1 - \alpha) e^{ikd} + \tfrac12 B (1 + \alpha) e^{-ikd},$$
#
# $\alpha$ being the impedance over that of the layer below, and $A = B$ at the surface. The surface
# over an outcrop of the rock is then $|A_1/A_\text{rock}|$. Strains jump between the layers, and
# quadratic splines have none of these jumps: so errors are larger than those of a single layer in
# `site_response.py`. The sides add nothing to them: the column alone has the same errors.
#
# **A hill** on the same ground, between free-field sides and between tied sides. The reference is
# ground so wide that no wave comes back from its sides in the time of the run. What counts is the
# velocity of the top of the hill, and the energy that is left in the ground. Dashpots let waves out
# that meet the side at a right angle. Part of the waves along the surface comes back. So the sides
# must be far from the hill: by default 26 m from its foot. With `--hill-width 16` they are 10 m
# from it, and the error is eight times as large.

# %%
import math
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI
from options import Options, natural, option, positive, values
from scene import finish, say

import dolfinmpm as mpm

COMM = MPI.COMM_WORLD
NU = 0.25
# from the surface down: share of the height, density (kg/m³), speed of shear waves (m/s)
LAYERS = (0.4, 1800.0, 150.0), (0.6, 1900.0, 250.0)
ROCK = {"density": 2200.0, "p_speed": 800.0 * math.sqrt(3.0), "s_speed": 800.0}
PARTS = "level", "hill"


@dataclass
class Input(Options):
    """Two layers on rock between free-field sides: level, and with a hill."""

    parts: list[str] = option(list(PARTS), ", ".join(PARTS), type=values(str, PARTS))
    height: float = positive(20.0, "of the ground above the rock (m)")
    h: float = positive(1.0, "size of the cells of level ground (m)")
    hill_h: float = positive(2.0, "size of the cells of the ground with a hill (m)")
    width: int = natural(8, "of level ground, in cells", least=2)
    points_per_cell: int = natural(2)
    courant: float = positive(0.25, "step in units of h over the speed of the upper layer")
    duration: float = positive(3.0, "of the level ground's run (s)")
    hill_width: int = natural(32, "of the ground with a hill between its sides, in cells", least=8)
    hill_duration: float = positive(0.9, "of the hill's run (s)")

    def _check(self):
        for h in (self.h, self.hill_h):
            for share, *_ in LAYERS:
                cells = share * self.height / h
                if abs(cells - round(cells)) > 1e-9 * cells:
                    raise ValueError("each layer must be a whole number of cells high")


args = Input.parse()
H = args.height
slowest = min(cs for *_, cs in LAYERS)


def pulse(peak):
    """A Ricker wavelet with its peak at a frequency (Hz), as the upward wave in the rock."""
    shift = 1.6 / peak
    t = np.linspace(0.0, 2 * shift, 1001)
    a = (np.pi * peak * (t - shift)) ** 2
    return mpm.InputMotion(t, velocity=1e-3 * (1 - 2 * a) * np.exp(-a))


# %% [markdown]
# ## The ground
# Each layer has a tag and a law of its own. `sides` are a column, or the period of tied sides.


# %%
def ground(width, h, wave, sides, hill=None):
    """Points and problem of ground of a width, with a hill (half-width, height) in its middle."""
    free = 3 * h
    top = H + (hill[1] + 2 * h if hill else 0.0)
    ends = round((width + 2 * free) / h) + 1, round(top / h) + 1
    grid = mpm.create_lattice(COMM, [h * np.arange(n) for n in ends])
    points, laws, above = None, [], H
    for tag, (share, density, cs) in enumerate(LAYERS):
        body = mpm.Box((free, above - share * H), (free + width, above))
        if tag == 0 and hill:
            x = free + 0.5 * width
            body = body | mpm.Box((x - hill[0], H), (x + hill[0], H + hill[1]))
        above -= share * H
        layer = mpm.fill(grid, body, args.points_per_cell, density, tag=tag)
        points = layer if points is None else points + layer
        E = 2 * density * cs**2 * (1 + NU)
        laws.append(mpm.materials.Hencky(E=E, nu=NU))
    V = mpm.Space(grid, "bspline2")
    F = sum(mpm.momentum(law, points, V.increment, V.test, tag=k) for k, law in enumerate(laws))
    bcs = mpm.absorbing(V, "bottom", **ROCK, incoming=(wave, None))
    if isinstance(sides, mpm.GroundColumn):
        bcs += mpm.free_field(V, "left", "right", column=sides)
        options = {}
    else:
        # tied sides of level ground leave no cut cells
        options = {"prolongation": mpm.tied(V, period=sides), "ghost_mass": 1e-3 if hill else 0.0}
    return points, mpm.Newmark(F, V.increment, points, bcs, mass="consistent", **options)


def motion(points, problem, where, end, dt, label):
    """Mean velocities of points over time, shape (times, 2); and energies."""
    curve, most = mpm.History(), 0.0
    for count, time in enumerate(mpm.times(end, dt=dt, label=label)):
        problem.step(time)
        rows = where(points["x0"])
        sums = np.append(points["velocity"][rows].sum(axis=0), rows.sum())
        total = COMM.allreduce(sums)
        if count % 10 == 0:
            energies = problem.energies()
            most = max(most, energies.kinetic + energies.strain)
        curve.record(t=time, vx=total[0] / total[2], vy=total[1] / total[2])
    energies = problem.energies()
    stored = energies.kinetic + energies.strain
    missing = energies.external - energies.losses["damping"] - stored
    return curve, stored / most, missing / energies.external


def column_of(h, wave, end, dt):
    """The motion of a column of the level ground."""
    return mpm.GroundColumn(ground(h, h, wave, h)[1], end, dt=dt)


# %% [markdown]
# ## Level ground


# %%
def amplification(f, depth):
    """Of points at a depth over the outcrop, exact."""
    up, down = np.ones_like(f, complex), np.ones_like(f, complex)
    below = [(rho, cs) for _, rho, cs in LAYERS[1:]] + [(ROCK["density"], ROCK["s_speed"])]
    for (share, rho, cs), (rho2, cs2) in zip(LAYERS, below):
        alpha, turn = rho * cs / (rho2 * cs2), np.exp(2j * np.pi * f / cs * share * H)
        up, down = (
            0.5 * (up * (1 + alpha) * turn + down * (1 - alpha) / turn),
            0.5 * (up * (1 - alpha) * turn + down * (1 + alpha) / turn),
        )
    return np.abs(np.cos(2 * np.pi * f / LAYERS[0][2] * depth) / up)


def level():
    """Amplification by frequency: found and exact."""
    h, dt = args.h, args.courant * args.h / slowest
    wave, highest = pulse(0.4 * slowest / (10 * h)), slowest / (10 * h)
    column = column_of(h, wave, args.duration, dt)
    points, problem = ground(args.width * h, h, wave, column)
    depth = 0.5 * h / args.points_per_cell
    middle = (3 + args.width // 2) * h

    def surface(x):
        return (x[:, 1] > H - 1.5 * depth) & (np.abs(x[:, 0] - middle) < h)

    curve, _, missing = motion(points, problem, surface, args.duration, dt, "level ground")
    f = np.linspace(0.05, 1.0, 39) * highest
    fine = np.linspace(0.0, wave.time[-1], 20001)
    came = np.array([2 * wave(at) for at in fine]) * (fine[1] - fine[0])

    def spectrum(t, v):
        return np.exp(-2j * np.pi * np.outer(f, t)) @ v

    came = spectrum(fine, came)
    found = np.abs(spectrum(curve["t"], curve["vx"]) * dt / came)
    beside = np.array([column.at(t)[1][-1, 0] for t in curve["t"]])
    alone = np.abs(spectrum(curve["t"], beside) * dt / came)
    exact = amplification(f, depth)
    peak = np.abs(beside).max()
    errors = {}
    for n in (10, 20, 40):
        kept = slowest / (f * h) >= n - 1e-9
        errors[str(n)] = float(np.abs(found / exact - 1)[kept].max())
    off = float(np.abs(curve["vx"] - beside).max() / peak)
    say(f"level ground: amplification off by {100 * errors['10']:.2f} % up to 10 nodes per "
        f"wavelength, {100 * errors['20']:.2f} % up to 20; its column by "
        f"{100 * np.abs(alone / exact - 1).max():.2f} %; surface off the column's by "
        f"{100 * off:.2f} % of the peak; vertical {np.abs(curve['vy']).max() / peak:.0e}; "
        f"energy off by {missing:.0e}")  # fmt: skip
    return {
        "errors": errors, "off_column": off, "missing_energy": float(missing), "f": f.tolist(),
        "column_error": float(np.abs(alone / exact - 1).max()), "found": found.tolist(),
        "exact": exact.tolist(), "vertical": float(np.abs(curve["vy"]).max() / peak),
    }  # fmt: skip


# %% [markdown]
# ## A hill


# %%
def hill():
    """The top of a hill between free-field sides, tied sides, and in wide ground."""
    h, dt = args.hill_h, args.courant * args.hill_h / slowest
    wave, end = pulse(0.5 * slowest / (10 * h)), args.hill_duration
    shape = 6 * h / 2, 3 * h
    # the fastest waves, along the lower layer, do not come back in time
    fastest = max(cs for *_, cs in LAYERS) * math.sqrt(3.0)
    wide = 2 * h * math.ceil(0.5 * fastest * (end - H / ROCK["p_speed"]) / h) + 8 * h
    narrow = args.hill_width * h
    column = column_of(h, wave, end, dt)
    curves, left = {}, {}

    def top(x):
        return x[:, 1] > H + shape[1] - 0.8 * h / args.points_per_cell

    runs = {"wide ground": (wide, wide), "free field": (narrow, column), "tied": (narrow, narrow)}
    for name, (width, sides) in runs.items():
        points, problem = ground(width, h, wave, sides, shape)
        curve, left[name], _ = motion(points, problem, top, end, dt, name)
        curves[name] = {k: curve[k] for k in ("t", "vx", "vy")}
    exact = curves["wide ground"]["vx"]
    errors = {
        name: float(np.abs(curves[name]["vx"] - exact).max() / np.abs(exact).max())
        for name in ("free field", "tied")
    }
    say(f"hill: velocity of the top off by {100 * errors['free field']:.1f} % of its peak with "
        f"free-field sides, {100 * errors['tied']:.1f} % with tied sides; energy left "
        f"{100 * left['free field']:.1f} %, {100 * left['tied']:.1f} % of the most")  # fmt: skip
    return {
        "errors": errors, "left": {k: float(v) for k, v in left.items()}, "wide": wide,
        "curves": {n: {k: v.tolist() for k, v in c.items()} for n, c in curves.items()},
    }  # fmt: skip


figures = {part: {"level": level, "hill": hill}[part]() for part in args.parts}

if not args.no_plot:
    size = 3.5 * len(figures), 2.8
    with mpm.figure(args.output / "free_field.png", *size, ncols=len(figures)) as (_, axes):
        drawn = dict(zip(figures, np.atleast_1d(axes)))
        if "level" in figures:
            found, one = figures["level"], drawn["level"]
            fine = np.linspace(found["f"][0], found["f"][-1], 600)
            depth = 0.5 * args.h / args.points_per_cell
            one.plot(fine, amplification(fine, depth), color="k", lw=1, label="exact")
            one.plot(found["f"], found["found"], "o", ms=3, label="free-field sides")
            one.set(xlabel="frequency (Hz)", ylabel="surface over outcrop", title="level ground")
            one.legend()
        if "hill" in figures:
            two = drawn["hill"]
            for name, style in (("wide ground", "k-"), ("tied", "C1-"), ("free field", "C0--")):
                curve = figures["hill"]["curves"][name]
                two.plot(curve["t"], 1e3 * np.array(curve["vx"]), style, lw=1, label=name)
            two.set(xlabel="time (s)", ylabel="velocity of the top (mm/s)", title="hill")
            two.legend()

finish(args, figures)
