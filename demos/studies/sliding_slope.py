# %% [markdown]
# # A slope in an earthquake, against Newmark's sliding block
#
# A long slope has a weak layer of undrained clay (Tresca, c_u) at its base. Above this layer the
# ground is stiff. In an earthquake the ground begins to slide when the acceleration of the base,
# along the slope and upwards, exceeds a_y. It slides until it has the velocity of the base again.
# Newmark (1965) takes the ground as a rigid
# block,
#
# $$a_y = \frac{c_u}{\rho H} - g \sin\beta, \qquad
#   \dot w = -a_y - a_b(t) \ \text{while it slides}, \quad w \ge 0 .$$
#
# H is the depth of the middle of the weak layer. The equation of the block is integrated in steps
# of 10 μs. The slope is one cell wide with tied sides, and moves with its base. Gravity is
# tilted, and the base has the velocity of the record.
#
# With waves of 2000 m/s the ground is almost rigid. It slips 1.8 % more than the block, and 1.0 %
# more with cells and steps half as large. With 400 m/s the ground amplifies the record, and slips
# 12 % more, which a rigid block cannot do. Domains that stretch with the layer reach into the
# ground above and weaken the layer: the slip grows by 4 %.

# %%
import math
from dataclasses import dataclass

import numpy as np
import ufl
from mpi4py import MPI
from options import BASES, Options, natural, option, positive
from scene import finish, say, solver_figures

import dolfinmpm as mpm

G = 9.81


@dataclass
class Input(Options):
    """A slope with a weak layer under a record, and Newmark's sliding block."""

    depth: float = positive(8.0, "of the base below the surface, across the slope (m)")
    angle: float = option(10.0, "of the slope (degrees)", above=0, below=45)
    density: float = positive(1900.0, "(kg/m³)")
    s_speed: float = positive(2000.0, "of shear waves in the ground (m/s)")
    yielding: float = positive(1.5, "acceleration a_y at which it slides (m/s²)")
    peak: float = positive(4.0, "of the acceleration of the record (m/s²)")
    frequency: float = positive(1.5, "of the record (Hz)")
    duration: float = positive(6.0, "of the record (s)")
    h: float = positive(0.25, "size of the cells, and thickness of the weak layer (m)")
    points_per_cell: int = natural(2)
    basis: str = option("gimp", choices=BASES)
    domains: str = option("volume", "how domains follow the points", choices=("volume", "stretch"))
    dt: float = positive(0.0025, "step (s)")
    rho_inf: float = option(0.0, "spectral radius ρ∞ of the steps", least=0, most=1)


args = Input.parse()
H, h, beta, rho = args.depth, args.h, math.radians(args.angle), args.density
middle = H - 0.5 * h
strength = rho * middle * (args.yielding + G * math.sin(beta))

# %% [markdown]
# ## The record
# Waves that grow and fade; their baseline is corrected, so that the base comes to rest.

# %%
t = np.linspace(0.0, args.duration, round(200 * args.duration) + 1)
envelope = np.sin(np.pi * t / args.duration) ** 2
waves = np.sin(2 * np.pi * args.frequency * t) + 0.4 * np.sin(5.2 * np.pi * args.frequency * t)
raw = envelope * waves
record = mpm.InputMotion(t, acceleration=args.peak * raw / np.abs(raw).max()).corrected()


def block(step=1e-5):
    """Times (s) and slip (m) of the rigid block."""
    count = round((args.duration + 1.0) / step)
    at = step * (np.arange(count) + 0.5)
    base = np.interp(at, record.time, [record.acceleration(one) for one in record.time], right=0.0)
    up = args.yielding + 2 * G * math.sin(beta)
    w, slip, out = 0.0, 0.0, np.empty(count)
    for k, a in enumerate(base):
        # the base drags the block, up to the strength of the layer in either direction
        if w > 0.0 or (w == 0.0 and a < -args.yielding):
            new = max(w + step * (-args.yielding - a), 0.0)
        elif w < 0.0 or a > up:
            new = min(w + step * (up - a), 0.0)
        else:
            new = 0.0
        slip += 0.5 * step * (w + new)
        w, out[k] = new, slip
    return at + 0.5 * step, out


# %% [markdown]
# ## The slope of material points

# %%
reach = 1.0 + max(abs(record.displacement(one)) for one in record.time)
free = math.ceil(reach / h) + 3
lines = [np.arange(2 * free + 2) * h, np.arange(round(H / h) + 2) * h]
grid = mpm.create_lattice(MPI.COMM_WORLD, lines)
left, right = free * h, (free + 1) * h
points = mpm.fill(grid, mpm.Box((left, h), (right, H)), args.points_per_cell, rho)
points += mpm.fill(grid, mpm.Box((left, 0.0), (right, h)), args.points_per_cell, rho, tag=1)
domains = {} if args.basis == "linear" else {"domains": args.domains}
V = mpm.Space(grid, args.basis, **domains)
u, v = V.increment, V.test
shear, nu = rho * args.s_speed**2, 0.3
E = 2 * shear * (1 + nu)
ground = mpm.materials.Hencky(E=E, nu=nu)
clay = mpm.materials.Tresca(E=E, nu=nu, cohesion=strength)


def stress(x):
    """Stress of the slope at rest (Pa)."""
    sigma = np.zeros((x.shape[1], 3, 3))
    for i in range(3):
        sigma[:, i, i] = -rho * G * math.cos(beta) * (H - x[1])
    sigma[:, 0, 1] = sigma[:, 1, 0] = rho * G * math.sin(beta) * (H - x[1])
    return sigma


mpm.set_stress(ground, points, stress, tag=0)
mpm.set_stress(clay, points, stress, tag=1)
gravity = ufl.as_vector((G * math.sin(beta), -G * math.cos(beta)))
F = mpm.momentum(ground, points, u, v, tag=0) + mpm.momentum(clay, points, u, v, tag=1)
F -= ufl.inner(points.density * gravity, v) * points.dX
bcs = mpm.moving(V, "bottom", 0, velocity=record) + mpm.prescribed(V, "bottom", 1)
sides = mpm.tied(V, period=h)
options = {"prolongation": sides, "mass": "lumped", "rho_inf": args.rho_inf}
problem = mpm.GeneralisedAlpha(F, u, points, bcs, **options)

curve = mpm.History()
for time in mpm.times(args.duration + 1.0, dt=args.dt, label="earthquake"):
    problem.step(time)
    upper = points["x0"][:, 1] > H - 0.6 * h / args.points_per_cell
    moved = (points["x"] - points["x0"])[upper, 0]
    total = points.comm.allreduce(np.array([moved.sum(), upper.sum()]))
    curve.record(t=time, slip=total[0] / total[1] - record.displacement(time))

at, slip = block()
found, exact = float(curve["slip"][-1]), float(slip[-1])
say(f"slip {found:.4f} m, sliding block {exact:.4f} m, {100 * (found / exact - 1):+.2f} %")

if not args.no_plot:
    with mpm.figure(args.output / "sliding_slope.png", 6.6, 2.6, ncols=2) as (_, (one, two)):
        one.plot(t, [record.acceleration(each) for each in t], lw=1)
        one.axhline(-args.yielding, color="k", lw=0.8, ls="--")
        one.set(xlabel="time (s)", ylabel="acceleration of the base (m/s²)")
        two.plot(at[::500], slip[::500], color="k", lw=1, label="sliding block")
        two.plot(curve["t"][::20], curve["slip"][::20], "o", ms=2.5, label="material points")
        two.set(xlabel="time (s)", ylabel="slip (m)")
        two.legend()

finish(args, {
    "slip": found, "block": exact, "error": found / exact - 1, "strength": strength,
    **solver_figures(problem),
})  # fmt: skip
