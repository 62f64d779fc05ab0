"""A cone penetrates clay, and small cells and points go with it.

The cone is that of `cone.py`: smooth, 60°, radius R. It starts at a depth of 6 R in weightless clay
(Tresca, I_r = 100). Far below the surface its resistance is, after Teh & Houlsby (1991),

    q_c/c_u = 4/3 (1 + ln I_r)(1.25 + I_r/2000) = 9.72.

The grid has cells of 2 R. Near the cone they are halved twice, by `mpm.near(cone, R/2)`. The small
cells follow the cone at the start of each step. Points split where cells become smaller, and the
mass stays the same to the last digit. The film shows the small cells that follow.
"""

import math

import numpy as np
from mpi4py import MPI

import dolfinmpm as mpm

R, cu, index, start, way, step, h = 1.0, 10e3, 100.0, 6.0, 5.0, 0.1, 0.5
factor = 4 / 3 * (1 + math.log(index)) * (1.25 + index / 2000)
grid = mpm.create_lattice(MPI.COMM_WORLD, [np.arange(0, 17, 2.0), np.arange(-26, 3, 2.0)])

shoulder, top = R * math.sqrt(3) - start, 20.0
meridian = [(0, -start), (R, shoulder), (R, top), (-R, top), (-R, shoulder)]
cone = mpm.RigidBody(mpm.Polygon(meridian), increment=(0, -step), fillet=h, name="cone")

# cells of h up to 1.25 R from the cone, and larger ones with distance
near = mpm.near(cone, h, reach=1.25, growth=0.35)
V = mpm.Space(grid, basis="gimp", domains="volume", refine=near, levels=2)
box = mpm.Box((0, -26), (16, 0))
points = mpm.fill(grid, box, per_cell=2, density=1800.0, axisymmetric=True, refine=V)
gap, normal, _ = cone.surface.probe(points["x"])
points.remove(gap <= (points["l"] * np.abs(normal)).sum(axis=1))

u, v = V.increment, V.test
clay = mpm.materials.Tresca(2 * (1 + 0.45) * index * cu, 0.45, cu)
F = mpm.momentum(clay, points, u, v, fbar=True) + mpm.contact(cone, points, u, v)
bcs = mpm.prescribed(V, "left", 0) + mpm.prescribed(V, "right", 0) + mpm.fixed(V, "bottom")
ghost = mpm.Stabilisation("ghost", factor=0.1)
problem = mpm.QuasiStatic(F, u, points, bcs, stabilisation=ghost, tolerance=1e-6)

mass = points.comm.allreduce(float(points["density"] @ points["V0"]))
steps, resistance = round(way / step), []
look = {"view": ((0, 8), (-16, 1)), "bodies": [cone], "limits": (0, 1), "size": (3.0, 4.5)}
look["cmap"] = "YlOrRd"
with mpm.animate(problem, "output/refined_cone.gif", "plastic_strain", **look) as film:
    for k in range(steps):
        record = problem.step()
        resistance.append(record.bodies["cone"]["force"][1] / (math.pi * R**2 * cu))
        if k % 5 == 4:
            film.write((k + 1) * step)
found = float(np.mean(resistance[round(0.6 * steps) :]))
change = points.comm.allreduce(float(points["density"] @ points["V0"])) / mass - 1
mpm.plot(points, "output/refined_cone.png", "plastic_strain", **look)

split = sum(record.split for record in problem.history)
error = found / factor - 1
if MPI.COMM_WORLD.rank == 0:
    print(f"factor {found:.2f}, {100 * error:+.1f} % from {factor:.2f}; {split} points split")
assert split > 100
assert abs(change) < 1e-13
assert abs(error) < 0.15
