# %% [markdown]
# # Site response: a layer on an elastic half-space, against the exact amplification
#
# A shear wave comes up through rock and meets a layer of soil. The amplification is the motion of
# the surface over that of an outcrop of the rock. At the frequency f it is (Kramer 1996, eq.
# 7.28, without damping)
#
# $$|A| = \frac{1}{\sqrt{\cos^2 kH + \alpha^2 \sin^2 kH}}, \qquad k = \frac{2\pi f}{c_s}, \quad
#   \alpha = \frac{\rho c_s}{\rho_r c_r} .$$
#
# At a depth d below the surface the numerator is cos kd; the uppermost points are such a depth.
# The layer is one cell wide, with tied sides, so that it is level ground without end. The rock is
# the absorbing base of Lysmer & Kuhlemeyer, through which the wave comes in. A short pulse has all
# frequencies: the amplification is the quotient of two Fourier transforms.
#
# The resolution of the grid is the number of nodes per wavelength, c_s/(f h). Averaged splines
# with a consistent mass follow the exact curve to 10 nodes per wavelength. A lumped mass needs
# some 40.

# %%
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI
from options import BASES, Options, natural, option, positive
from scene import finish, say

import dolfinmpm as mpm


@dataclass
class Input(Options):
    """A layer of soil on rock under a pulse from below: amplification by frequency."""

    height: float = positive(20.0, "of the layer (m)")
    s_speed: float = positive(200.0, "of the layer (m/s)")
    density: float = positive(1800.0, "of the layer (kg/m³)")
    rock_speed: float = positive(800.0, "of shear waves in the rock (m/s)")
    rock_density: float = positive(2200.0, "(kg/m³)")
    h: float = positive(1.0, "size of the cells (m)")
    points_per_cell: int = natural(2)
    basis: str = option("bspline2", choices=BASES)
    integrator: str = option("newmark", choices=("newmark", "generalised-alpha", "explicit"))
    mass: str = option("consistent", choices=("consistent", "lumped"))
    courant: float = positive(0.125, "step in units of h/c_s")
    duration: float = positive(3.0, "(s)")

    def _check(self):
        cells = self.height / self.h
        if abs(cells - round(cells)) > 1e-9 * cells:
            raise ValueError("the height must be a whole number of cells")


args = Input.parse()
H, h, cs = args.height, args.h, args.s_speed
alpha = args.density * cs / (args.rock_density * args.rock_speed)
highest = cs / (10 * h)

# %% [markdown]
# ## The pulse
# A Ricker wavelet has its peak at 0.4 of the highest frequency.

# %%
peak = 0.4 * highest
shift = 1.6 / peak
t = np.linspace(0.0, 2 * shift, 1001)
a = (np.pi * peak * (t - shift)) ** 2
wave = mpm.InputMotion(t, velocity=1e-3 * (1 - 2 * a) * np.exp(-a))

# %% [markdown]
# ## The layer
# Beside the column the grid has free cells: the column moves through the grid.

# %%
free = 4
lines = [np.arange(2 * free + 2) * h, np.arange(round(H / h) + 1) * h]
grid = mpm.create_lattice(MPI.COMM_WORLD, lines)
column = mpm.Box((free * h, 0.0), ((free + 1) * h, H))
points = mpm.fill(grid, column, args.points_per_cell, args.density)
V = mpm.Space(grid, args.basis)
u, v = V.increment, V.test
G, nu = args.density * cs**2, 0.3
soil = mpm.materials.Hencky(E=2 * G * (1 + nu), nu=nu)
F = mpm.momentum(soil, points, u, v)
rock = {"density": args.rock_density, "p_speed": 0.0, "s_speed": args.rock_speed}
bcs = mpm.absorbing(V, "bottom", **rock, incoming=(wave, None))
bcs += mpm.prescribed(V, "bottom", 1)
sides = mpm.tied(V, period=h)
options = {"prolongation": sides, "mass": args.mass}
if args.mass == "consistent":
    # tied sides leave no cut cells
    options["ghost_mass"] = 0.0
kinds = {"newmark": mpm.Newmark, "generalised-alpha": mpm.GeneralisedAlpha}
problem = kinds.get(args.integrator, mpm.Explicit)(F, u, points, bcs, **options)

top = H - 0.5 * h / args.points_per_cell
dt = args.courant * h / cs
curve = mpm.History()
for time in mpm.times(args.duration, dt=dt, label="waves"):
    problem.step(time)
    upper = points["x0"][:, 1] > top - 0.1 * h / args.points_per_cell
    sums = np.array([points["velocity"][upper, 0].sum(), upper.sum()])
    total = points.comm.allreduce(sums)
    curve.record(t=time, velocity=total[0] / total[1])

# %% [markdown]
# ## Amplification

# %%
frequency = np.linspace(0.05, 1.0, 39) * highest
left = np.exp(-2j * np.pi * np.outer(frequency, curve["t"])) @ curve["velocity"] * dt
fine = np.linspace(0.0, t[-1], 20001)
came = np.array([2 * wave(at) for at in fine])
right = np.exp(-2j * np.pi * np.outer(frequency, fine)) @ came * (fine[1] - fine[0])
found = np.abs(left / right)


def amplification(f):
    """Of the uppermost points over the outcrop, by Kramer."""
    k = 2 * np.pi * f / cs
    size = np.sqrt(np.cos(k * H) ** 2 + alpha**2 * np.sin(k * H) ** 2)
    return np.abs(np.cos(k * (H - top))) / size


exact = amplification(frequency)
error = found / exact - 1
energies = problem.energies()
balance = energies.external - energies.losses["damping"] - energies.kinetic - energies.strain
worst = {str(n): float(np.abs(error[cs / (frequency * h) >= n - 1e-9]).max()) for n in (10, 20, 40)}
say(f"amplification: largest error {100 * worst['10']:.2f} % up to 10 nodes per wavelength, "
    f"{100 * worst['20']:.2f} % up to 20, {100 * worst['40']:.2f} % up to 40")  # fmt: skip
say(f"energy: {balance / energies.external:.1e} of the wave's work is missing")

if not args.no_plot:
    with mpm.figure(args.output / "site_response.png", 6.6, 2.6, ncols=2) as (_, (left, right)):
        left.plot(curve["t"], 1e3 * curve["velocity"])
        left.set(xlabel="time (s)", ylabel="velocity of the surface (mm/s)")
        fine = np.linspace(frequency[0], frequency[-1], 600)
        right.plot(fine, amplification(fine), color="k", lw=1, label="exact")
        right.plot(frequency, found, "o", ms=3, label="material points")
        right.set(xlabel="frequency (Hz)", ylabel="surface over outcrop")
        right.legend()

finish(args, {
    "errors": worst, "frequency": frequency.tolist(), "found": found.tolist(),
    "exact": exact.tolist(), "missing_energy": balance / energies.external, "points": points.total,
})  # fmt: skip
