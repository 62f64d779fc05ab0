"""A hot and a cold half of a turning disc come to one temperature: your own physics in UFL.

The disc is insulated. At first its temperature is the slowest mode of an insulated disc,

    T = J₁(j r/R) cos θ (1 K),   J₁'(j) = 0,  j = 1.8412.

In the disc's own frame there is conduction alone. So the mode keeps its shape, and its amplitude is
exp(−t/τ) with τ = ρ c R²/(k j²) (Carslaw & Jaeger 1959). Meanwhile the disc turns once through the
grid.

The heat equation is two lines of UFL. The points carry the temperature with them, so that no term
of convection is needed, and none smears the temperature. The edge of the disc cuts cells anywhere.
An insulated edge needs no condition. A ghost penalty holds the temperature of cells with little of
the disc in them.
"""

import numpy as np
import ufl
from dolfinx import mesh
from mpi4py import MPI
from scipy.special import j1

import dolfinmpm as mpm

R, density, capacity, k = 1.0, 7800.0, 500.0, 50.0  # m, kg/m³, J/(kg K), W/(m K)
j, steps = 1.841184, 100
tau = density * capacity * R**2 / (k * j**2)  # s: nine days

corners, cells = [(-1.25, -1.25), (1.25, 1.25)], (40, 40)
grid = mesh.create_rectangle(MPI.COMM_WORLD, corners, cells, mesh.CellType.quadrilateral)
points = mpm.fill(grid, mpm.Ball((0, 0), R), per_cell=3, density=density, exact=True)
V, W = mpm.Space(grid, basis="gimp"), mpm.Space(grid, basis="gimp", shape=())
u, v, T, q = V.increment, V.test, W.increment, W.test

# Points take their fields with them to other cells and other ranks.
points.add_field("mode")
r = np.hypot(*points["x0"].T)
points["mode"] = j1(j * r / R) * points["x0"][:, 0] / r
points.add_field("temperature", unit="K")
points["temperature"] = points["mode"]

# Backward Euler: T is the temperature at the end of the step, `before` at its start.
before = mpm.carried(points, "temperature", T, unit="K")
F = density * capacity * (T - before) / points.dt * q * points.dX
F += k * ufl.inner(ufl.grad(T), ufl.grad(q)) * points.dx

# All nodes turn by 3.6° per step. So any equation of the motion does; a body that moves by forces
# has `mpm.momentum` here.
F += ufl.inner(u, v) * points.dX
s, c = np.sin(2 * np.pi / steps), np.cos(2 * np.pi / steps) - 1
turn = [lambda x: c * x[0] - s * x[1], lambda x: s * x[0] + c * x[1]]
bcs = []
for i, increment in enumerate(turn):
    bcs += mpm.prescribed(V, lambda x: np.isfinite(x[0]), i, increment=increment)
problem = mpm.Transient(
    F, [u, T], points, bcs, stabilisation=["none", mpm.Stabilisation("ghost", E=k)]
)


def share_of_mode():
    """The amplitude of the mode in the temperature (K)."""
    mode = points["V0"] * points["mode"]
    both = np.array([mode @ points["temperature"], mode @ points["mode"]])
    both = grid.comm.allreduce(both)
    return float(both[0] / both[1])


curve, shown = mpm.History(), {0.0: points.gather("x", "temperature")}
for number, t in enumerate(mpm.times(tau, dt=tau / steps, label="heat"), start=1):
    problem.step(t)
    curve.record(t=t / tau, amplitude=share_of_mode())
    if number in (30, 100):
        shown[number / steps] = points.gather("x", "temperature")

with mpm.figure("output/diffusion.png", 7.0, 1.9, ncols=4) as (figure, axes):
    for ax, (t, found) in zip(axes, shown.items()):
        if found is not None:
            drawn = ax.scatter(
                *found[0].T, s=0.8, c=found[1], cmap="RdBu_r", vmin=-0.6, vmax=0.6, lw=0
            )
        ax.set(aspect="equal", title=rf"$t = {t:g}\,\tau$", xlim=(-1.1, 1.1), ylim=(-1.1, 1.1))
        ax.set(xlabel="$x$ (m)", ylabel="$y$ (m)" if t == 0 else "")
    if found is not None:
        figure.colorbar(drawn, ax=axes[2], shrink=0.8, label="temperature (K)")
    times = np.linspace(0, 1, 50)
    axes[3].plot(times, np.exp(-times), color="k", lw=1, label="exact")
    axes[3].plot(curve["t"][9::10], curve["amplitude"][9::10], "o", ms=3, label="points")
    axes[3].set(xlabel=r"$t/\tau$", title="amplitude (K)", ylim=(0, 1.05))
    axes[3].legend()

amplitude = curve["amplitude"][-1]
if grid.comm.rank == 0:
    print(f"amplitude {amplitude:.4f} after one turn, exact {np.exp(-1):.4f}")
assert abs(amplitude - np.exp(-1)) < 0.004
