"""A cone penetrates clay, and its resistance is Teh & Houlsby's.

A smooth penetrometer of 60° and the radius R is pressed into weightless clay (Tresca, I_r = G/c_u
= 100). Far below the surface its resistance is

    q_c/c_u = 4/3 (1 + ln I_r)(1.25 + I_r/2000) = 9.72

(Teh & Houlsby 1991). The cone starts at a depth of 6 R, and moves down by 5 R.

The problem is axisymmetric. The cone touches the corners of the points' domains. F-bar prevents
locking, because the clay flows at constant volume. The clay at the cone is stretched very far. So
the domains follow the volume only: otherwise they would become long and thin along the cone. The
ghost penalty stabilises the cells that the cone's surface cuts, but it also resists the flow. A
tenth of the usual factor is enough. Cells of R/2 are coarse: `demos/studies/cone_penetration.py`
takes finer cells, sand, and three dimensions.
"""

import math

import numpy as np
from mpi4py import MPI

import dolfinmpm as mpm

R, cu, index, start, way, h = 1.0, 10e3, 100.0, 6.0, 5.0, 0.5
factor = 4 / 3 * (1 + math.log(index)) * (1.25 + index / 2000)

# equal cells along the cone's way, larger ones far from it
radii = mpm.zoned_line(0.0, 40.0, (0.0, 2.5), (0, 5, 9))
heights = mpm.zoned_line(-53.0, 3.0, (-13.0, -3.0), (9, 20, 6))
grid = mpm.create_lattice(MPI.COMM_WORLD, [radii, heights])

shoulder, top = R * math.sqrt(3) - start, 20.0
meridian = [(0, -start), (R, shoulder), (R, top), (-R, top), (-R, shoulder)]
step = 0.1 * R
cone = mpm.RigidBody(mpm.Polygon(meridian), increment=(0, -step), fillet=h, name="cone")


def beside(x):
    """Whether points are in the clay, and no corner of their domains in the cone."""
    gap, normal, _ = cone.surface.probe(np.ascontiguousarray(x.T))
    return (x[1] < 0) & (gap > h / 4 * np.abs(normal).sum(axis=1))


clay = mpm.Where(beside, low=np.array([0.0, heights[0]]), high=np.array([40.0, 0.0]))
points = mpm.fill(grid, clay, per_cell=2, density=1800.0, axisymmetric=True)
V = mpm.Space(grid, basis="gimp", domains="volume")
u, v = V.increment, V.test
E = 2 * (1 + 0.45) * index * cu
F = mpm.momentum(mpm.materials.Tresca(E, 0.45, cu), points, u, v, fbar=True)
F += mpm.contact(cone, points, u, v)
bcs = mpm.prescribed(V, "left", 0) + mpm.prescribed(V, "right", 0) + mpm.fixed(V, "bottom")
ghost = mpm.Stabilisation("ghost", factor=0.1)
problem = mpm.QuasiStatic(F, u, points, bcs, stabilisation=ghost, tolerance=1e-8)

depth, resistance = [], []
for share in mpm.steps(round(way / step), label="cone"):
    record = problem.step()
    depth.append(start + share * way)
    resistance.append(record.bodies["cone"]["force"][1] / (math.pi * R**2 * cu))
last = np.array(depth) > start + 0.6 * way
found = float(np.mean(np.array(resistance)[last]))

with mpm.figure("output/cone.png", 3.4, 3.0) as (_, axes):
    axes.plot(resistance, depth, label="material points")
    axes.axvline(factor, color="k", lw=1, label="Teh & Houlsby")
    axes.set(xlabel="$q_c/c_u$", ylabel="depth of the tip (m)", xlim=(0, 15))
    axes.set_ylim(depth[-1], start)
    axes.legend()

error = found / factor - 1
if MPI.COMM_WORLD.rank == 0:
    print(f"factor {found:.2f}, {100 * error:+.1f} % from {factor:.2f}")
assert abs(error) < 0.15
