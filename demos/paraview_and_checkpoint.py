"""Files for ParaView, a checkpoint, and a restart that goes on with the same bits.

A ball of rubber falls on a floor and jumps up again. In the middle of the impact the run saves a
checkpoint, and goes on to its end. Then everything is built anew, as in another process on another
day. The second run loads the checkpoint and goes on from there.

The same input gives the same bits on one rank. So positions, velocities and stresses of all points
are equal in both runs, to the last bit. On several ranks they are equal if the number of ranks and
the partition of the grid are the same. DOLFINx's partition is another one now and then, and the
last digits then differ. On another number of ranks the checkpoint loads, too.

In ParaView open `output/paraview_and_checkpoint/whole.pvd` (points), and beside it
`whole_grid.pvd` (active cells) and `whole_bodies.pvd` (the floor). `rest.pvd` is of the second run,
with the times after the checkpoint.
"""

import numpy as np
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

import dolfinmpm as mpm

R, drop, g = 0.5, 1.0, 9.81  # m, m, m/s²
times = np.linspace(0.025, 1.0, 40)  # of the files (s)
stop = 19  # steps before the checkpoint
folder = "output/paraview_and_checkpoint"


def build():
    """Grid, points, form and problem, and the floor. A restart builds the same again."""
    cells = mesh.CellType.quadrilateral
    grid = mesh.create_rectangle(MPI.COMM_WORLD, [(-1, -0.25), (1, 2.25)], (16, 20), cells)
    points = mpm.fill(grid, mpm.Ball((0, R + drop), R), per_cell=3, density=1000.0)
    V = mpm.Space(grid, basis="gimp")
    u, v = V.increment, V.test
    floor = mpm.RigidBody(mpm.Plane((0, 0), (0, 1)), name="floor")
    rubber = mpm.materials.NeoHookean(E=2e5, nu=0.3)
    gravity = fem.Constant(grid, (0.0, -g))
    F = mpm.momentum(rubber, points, u, v)
    F -= ufl.inner(points.density * gravity, v) * points.dX
    F += mpm.contact(floor, points, u, v)
    return mpm.Explicit(F, u, points, mapping="apic"), floor


def go_on(problem, floor, name):
    """Take the steps that are left, with a ParaView series; heights of the ball (m)."""
    points, heights = problem.points, []
    series = mpm.ParaView(
        f"{folder}/{name}.pvd",
        points,
        fields=["displacement", "velocity", "stress"],
        active=True,
        bodies=[floor],
    )
    for t in times[len(problem.history) :]:
        problem.step(float(t))
        series.write(float(t))
        volume = points.comm.allreduce(points["V0"].sum())
        heights.append(points.comm.allreduce(points["V0"] @ points["x"][:, 1]) / volume)
        if len(problem.history) == stop:
            problem.save(f"{folder}/stopped.npz")
    return heights


whole, floor = build()
heights = go_on(whole, floor, "whole")

second, floor = build()
second.load(f"{folder}/stopped.npz")
after = go_on(second, floor, "rest")

names = "id", "x", "F", "velocity", "stress"
ours, theirs = (problem.points.gather(*names) for problem in (whole, second))
difference = 0.0
if ours is not None:
    difference = max(float(np.abs(a - b).max()) for a, b in zip(ours, theirs))
difference = MPI.COMM_WORLD.bcast(difference)

with mpm.figure("output/paraview_and_checkpoint.png", 3.5, 2.6) as (_, axes):
    t = np.linspace(0, np.sqrt(2 * drop / g), 50)
    axes.plot(t, R + drop - 0.5 * g * t**2, color="0.6", lw=2.5, label="free fall")
    axes.plot(times, heights, label="first run")
    axes.plot(times[stop:], after, "o", ms=3, label="restarted")
    axes.axvline(times[stop - 1], color="k", lw=0.8, ls="--")
    axes.set(xlabel="time (s)", ylabel="height of the ball's middle (m)", ylim=(0, 1.6))
    axes.legend()

if MPI.COMM_WORLD.rank == 0:
    print(f"{len(after)} steps after the restart: largest difference {difference:g}")
assert len(after) == len(times) - stop
# on several ranks the partitions of the two grids may differ
assert difference <= (0.0 if MPI.COMM_WORLD.size == 1 else 1e-8)
