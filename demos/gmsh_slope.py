"""A slope of two soils from a Gmsh mesh, and its factor of safety by strength reduction.

A fill, 6 m high with a slope of 1:2, stands on a layer of softer clay. Gmsh makes a mesh of both
(its Python module is `python3-gmsh` in Debian, `python-gmsh` on conda-forge). Each soil is a
physical group, and the number of the group is the tag of the points. The points are in the
triangles. The background grid does not follow the mesh.

The strength of both soils is divided by a factor until the slope fails (Griffiths & Lane 1999, doi
10.1680/geot.1999.49.3.387). The classical answer for soil without friction is the worst of all slip
circles (Fellenius 1927): the moment of the strength along a circle over the moment of the weight.
Taylor's (1937) charts come from such circles in one soil.
"""

from pathlib import Path

import gmsh
import numpy as np
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

import dolfinmpm as mpm

comm = MPI.COMM_WORLD
density, g, interface = 1800.0, 9.81, 6.0  # kg/m³, m/s², m
strength = {1: 36e3, 2: 21.6e3}  # of the fill and of the clay, Pa
surface = [(0, 12), (18, 12), (30, 6), (48, 6)]


def write_mesh(path):
    """The triangles of both soils, with their physical groups 1 and 2."""
    gmsh.initialize()
    gmsh.option.setNumber("General.Verbosity", 2)
    geo = gmsh.model.geo
    corners = [(0, 0), (48, 0), (48, interface), (30, interface), (18, 12), (0, 12), (0, interface)]
    p = [geo.addPoint(x, y, 0, 0.7) for x, y in corners]
    between = geo.addLine(p[3], p[6])
    clay = [geo.addLine(p[a], p[b]) for a, b in [(6, 0), (0, 1), (1, 2), (2, 3)]]
    fill = [geo.addLine(p[a], p[b]) for a, b in [(3, 4), (4, 5), (5, 6)]]
    loops = {1: [*fill, -between], 2: [*clay, between]}
    faces = {tag: geo.addPlaneSurface([geo.addCurveLoop(loop)]) for tag, loop in loops.items()}
    geo.synchronize()
    for tag, face in faces.items():
        gmsh.model.addPhysicalGroup(2, [face], tag)
    gmsh.model.mesh.generate(2)
    gmsh.write(path)
    gmsh.finalize()


Path("output").mkdir(exist_ok=True)
if comm.rank == 0:
    write_mesh("output/gmsh_slope.msh")
comm.Barrier()
cells = mesh.CellType.quadrilateral
grid = mesh.create_rectangle(comm, [(0, 0), (48, 13)], (48, 13), cells)
points = mpm.MaterialPoints.from_mesh(grid, "output/gmsh_slope.msh", density)

V = mpm.Space(grid, basis="gimp")
u, v = V.increment, V.test
gravity = fem.Constant(grid, (0.0, -g))
F = -ufl.inner(points.density * gravity, v) * points.dX
for tag, c in strength.items():
    soil = mpm.materials.Tresca(E=1000 * c, nu=0.3, cohesion=c)
    F += mpm.momentum(soil, points, u, v, tag=tag, fbar=True)
bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
problem = mpm.QuasiStatic(F, u, points, bcs, stabilisation="ghost", tolerance=1e-6)
problem.step()  # its own weight
found = mpm.study.factor_of_safety(problem, 1.0, 2.0)

# Slip circles: centres and lowest points; each circle in parts of half a degree. Both moments are
# divided by the radius and by the angle of a part.
m = np.meshgrid(np.linspace(18, 30, 25), np.linspace(14, 36, 23), np.linspace(0, 10, 21))
xc, yc, low = (values.reshape(-1, 1) for values in m)
a = np.radians(np.arange(-89.75, 90, 0.5))
x, y = xc + (yc - low) * np.sin(a), yc - (yc - low) * np.cos(a)
above = np.maximum(np.interp(x, *np.transpose(surface)) - y, 0.0)
resisting = np.sum((yc - low) * np.where(y > interface, *strength.values()) * (above > 0), axis=1)
driving = np.sum(density * g * above * np.cos(a) * (xc - x), axis=1)
ratio = np.where(driving > 0, resisting / np.where(driving > 0, driving, 1.0), np.inf)
worst = np.argmin(ratio)
circles = float(ratio[worst])

# More weight has the effect of less strength: the slope fails, and the picture shows where.
gravity.value[1] *= 1.03 * found.bracket[1]
before = points.gather("x")  # by number, from all ranks
problem.step()
after = points.gather("x")
with mpm.figure("output/gmsh_slope.png", 7.2, 2.2, ncols=2, width_ratios=[5, 2]) as (fig, axes):
    failing, growth = axes
    if before is not None and after is not None:
        way = np.linalg.norm(after[0] - before[0], axis=1)
        drawn = failing.scatter(*after[0].T, s=5, c=way, lw=0)
        fig.colorbar(drawn, ax=failing, label="displacement (m)", shrink=0.5, location="top")
    failing.plot(*np.transpose(surface), color="0.4", lw=0.6)
    failing.plot([0, 30], [interface] * 2, color="0.4", lw=0.6, ls="--")
    part = above[worst] > 0
    failing.plot(x[worst, part], y[worst, part], color="k", lw=1.2, label="critical circle")
    for name, height in (("fill", 10.2), ("clay", 1.0)):
        failing.text(1, height, name, fontsize=7, bbox={"fc": "w", "ec": "none", "pad": 1})
    failing.set(aspect="equal", xlabel="$x$ (m)", ylabel="$y$ (m)", xlim=(0, 48), ylim=(0, 12.5))
    failing.legend(loc="upper right")
    # trials that ended early have smaller displacements
    done = [trial for trial in found.trials if trial.steps == 5]
    growth.plot([trial.factor for trial in done], [trial.growth for trial in done], "o", ms=3)
    growth.axvline(circles, color="k", lw=1.2, label="critical circle")
    growth.set(xlabel="factor of safety", ylabel="displacement / elastic", ylim=(0, None))
    growth.legend()

factor = found.factor
if comm.rank == 0:
    print(f"factor of safety {factor:.3f}, slip circles {circles:.3f}")
assert abs(factor / circles - 1) < 0.04
