"""Step 4. Time: implicit and explicit steps

The same weak form runs in time. An elastic bar is fixed at one end and swings in its first mode.
Its period is 4 L/c with the wave speed c = √(E/ρ), here 4 s. You compare an implicit and an
explicit integrator, and look at the energy.
"""

# %%
# A bar of 10 m. Each point carries its velocity (m/s), a field of the points. Set the velocity
# before the first step.

import numpy as np
from dolfinx import mesh
from mpi4py import MPI

import dolfinmpm as mpm

L, E, rho = 10.0, 100.0, 1.0
grid = mesh.create_interval(MPI.COMM_WORLD, 44, [0.0, 11.0])
V = mpm.Space(grid, basis="gimp")


def swing(make, dt, label):
    """Times, momentum and energy of the bar over two periods."""
    points = mpm.fill(grid, mpm.Box((0.0,), (L,)), per_cell=2, density=rho)
    points.add_field("velocity", (1,), "m/s", lambda x: 0.1 * np.sin(np.pi * x.T / (2 * L)))
    F = mpm.momentum(mpm.materials.Hencky(E, nu=0.0), points, V.increment, V.test)
    problem = make(F, V.increment, points, mpm.fixed(V, "left"))
    history = mpm.History()
    for t in mpm.times(8.0, dt=dt, label=label):
        problem.step(t)
        now = problem.energies()
        history.record(t=t, momentum=problem.momentum()[0], energy=now.kinetic + now.strain)
    return history


# %%
# Newmark's method solves a Newton problem per step. Its step may be long. ``Explicit`` needs no
# matrix. It divides the time between two results into as many stable steps as it needs.

runs = {
    "Newmark": swing(mpm.Newmark, 0.1, "Newmark"),
    "explicit": swing(mpm.Explicit, 0.1, "explicit"),
}

# %%
# The period follows from the zeros of the momentum.


def period(history):
    """Twice the time between two zeros of the momentum."""
    t, p = history["t"], history["momentum"]
    k = np.flatnonzero(p[:-1] * p[1:] < 0)[:3]
    zeros = t[k] - p[k] * (t[k + 1] - t[k]) / (p[k + 1] - p[k])
    return zeros[2] - zeros[0]


for name, history in runs.items():
    if grid.comm.rank == 0:
        kept = history["energy"][-1] / history["energy"][0]
        print(f"{name}: period {period(history):.3f} s, energy kept {kept:.4f}")
    assert abs(period(history) / 4.0 - 1) < 0.01

with mpm.figure("output/time.png", 4.5, 2.6) as (_, axes):
    for name, history in runs.items():
        line = "-" if name == "Newmark" else "--"
        axes.plot(history["t"], history["momentum"], line, label=name)
    axes.set(xlabel="time (s)", ylabel="momentum (kg m/s)")
    axes.legend()

# %%
# What it shows
# -------------
# Both find the period. ``problem.energies()`` lists where energy goes: kinetic, strain, and what
# the mapping and the integrator make or lose.
#
# Try next
# --------
# - ``make=mpm.GeneralisedAlpha``.
# - ``functools.partial(mpm.Explicit, mapping="pic")``: this mapping loses energy.
# - :doc:`Sand that collapses </demos/column_collapse>` in explicit steps.
