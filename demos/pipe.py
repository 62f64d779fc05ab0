"""A pipe is pressed into the seabed, with the resistance of Merifield, White and Randolph.

A smooth rigid pipe of the diameter D is pressed into weightless clay of the undrained strength s_u
(Tresca). By finite elements Merifield, White & Randolph (2008, Géotechnique 58, 461) found the
resistance at the penetration w,

    V/(D s_u) = 5.3 (w/D)^0.25.

DNV-RP-F114 has 6 in place of 5.3, for pipes with some roughness, and 3.4 (10 w/D)^0.5 for small
penetrations. These pipes are in place from the start. Here the pipe starts on the surface and goes
down by half of its diameter, and the clay heaves beside the pipe.

By symmetry, half of the pipe and of the seabed is enough. The pipe is a rigid body, and the corners
of the points' domains touch it. The clay flows around the pipe. Domains that change with the volume
alone are not drawn out by the flow. A third of the usual ghost penalty resists the flow less.
"""

import numpy as np
from mpi4py import MPI

import dolfinmpm as mpm

D, su, way, steps = 1.0, 10e3, 0.5, 25  # m, Pa, m

# cells of D/12 near the pipe, larger ones far from it
across = mpm.zoned_line(0.0, 4.0, (0.0, 1.0), (0, 12, 12))
heights = mpm.zoned_line(-4.0, 0.5, (-1.0, 0.5), (12, 18, 0))
grid = mpm.create_lattice(MPI.COMM_WORLD, [across, heights])
seabed = mpm.Box((0.0, -4.0), (4.0, 0.0))
points = mpm.fill(grid, seabed, per_cell=2, density=1600.0)
V = mpm.Space(grid, basis="gimp", domains="volume")
u, v = V.increment, V.test

pipe = mpm.RigidBody(mpm.Disc((0.0, D / 2), D / 2), increment=(0, -way / steps), name="pipe")
clay = mpm.materials.Tresca(E=500 * su, nu=0.45, cohesion=su)
F = mpm.momentum(clay, points, u, v, fbar=True) + mpm.contact(pipe, points, u, v)
bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
ghost = mpm.Stabilisation("ghost", factor=0.3)
problem = mpm.QuasiStatic(F, u, points, bcs, stabilisation=ghost, tolerance=1e-6)

curve = mpm.History()
for share in mpm.steps(steps, label="pipe"):
    record = problem.step()
    force = 2 * record.bodies["pipe"]["force"][1]  # of both halves
    curve.record(depth=share * way / D, resistance=force / (D * su))

state, outline = points.gather("x", "plastic_strain"), pipe.outline(*np.array([(0, -1), (1, 1)]))
with mpm.figure("output/pipe.png", 6.6, 2.6, ncols=2) as (figure, (left, right)):
    w = np.linspace(0.001, 0.5, 100)
    left.plot(5.3 * w**0.25, w, color="k", lw=1, label="smooth, Merifield et al.")
    low = np.minimum(6 * w**0.25, 3.4 * (10 * w) ** 0.5)
    left.plot(low, w, color="0.6", lw=1, ls="--", label="DNV-RP-F114")
    left.plot(curve["resistance"], curve["depth"], "o", ms=3, label="material points")
    left.set(xlabel="$V/(D s_u)$", ylabel="$w/D$", xlim=(0, 6), ylim=(0.52, 0))
    left.legend(loc="lower left")
    if state is not None:
        x, strain = state
        drawn = right.scatter(*x.T, s=2, c=strain, vmin=0, vmax=1, lw=0)
        figure.colorbar(drawn, ax=right, label="plastic strain")
    right.plot(*outline.reshape(-1, 2).T, color="k", lw=1)
    right.set(xlabel="$x$ (m)", ylabel="$y$ (m)", aspect="equal", xlim=(0, 1.6), ylim=(-1.1, 0.6))

# In the first tenth few corners touch, one after the other.
deep = curve["depth"] > 0.1
factor = float(np.mean(curve["resistance"][deep] / curve["depth"][deep] ** 0.25))
if grid.comm.rank == 0:
    print(f"V/(D su) = {factor:.2f} (w/D)^0.25 on average, Merifield, White & Randolph 5.3")
assert abs(factor / 5.3 - 1) < 0.06
