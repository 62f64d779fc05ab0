"""A published law: hypoplastic sand, from its Fortran source.

Laws for soils are published as UMATs, Fortran subroutines with the interface of Abaqus.
demos/umat/hypoplasticity.f90 is sand after von Wolffersdorff (1996), with the intergranular strain
of Niemunis and Herle (1997): stiffness depends on stress, on density and on the last turns of the
strain path. The parameters are those of Hochstetten sand.

A column of 10 m is at rest under its weight. Then gravity grows to five times its value, as in a
centrifuge. No strain is horizontal, and equilibrium alone gives the vertical stress,
σ(Y) = −ρ₀ g (10 m − Y). So every height goes through an oedometer test with known stresses.
`mpm.study.element_test` takes the law through these tests, without a grid; their strains add up to
the settlement.
"""

import sys
from pathlib import Path

import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI

import dolfinmpm as mpm

# PROPS and STATEV are listed at the top of the source. Each state variable gets a name and a first
# value, and becomes a field of the points: it is saved, drawn and moved between ranks.
source = Path(sys.argv[0]).parent / "umat" / "hypoplasticity.f90"
sand = [33.0, 1e9, 0.25, 0.55, 0.95, 1.05, 0.25, 1.5, 1e-4, 5.0, 2.0, 0.5, 6.0, 0.0, 1e-5]
history = {f"intergranular_{k}": 0.0 for k in ("11", "22", "33", "12", "13", "23")}
law = mpm.materials.UMAT(source, sand, history | {"void_ratio": 0.75})
assert law.check() == []  # no state between points, and a tangent that is one

height, density, g, K0 = 10.0, 1600.0, 9.81, 0.5
grid = mpm.create_lattice(MPI.COMM_WORLD, [np.linspace(0, 0.5, 2), np.linspace(0, 11, 23)])
points = mpm.fill(grid, mpm.Box((0, 0), (0.5, height)), per_cell=2, density=density)
V = mpm.Space(grid, basis="gimp")
u, v = V.increment, V.test
gravity = fem.Constant(grid, (0.0, -g))
F = mpm.momentum(law, points, u, v, strain="jaumann")
F -= ufl.inner(points.density * gravity, v) * points.dX
mpm.set_stress(law, points, mpm.geostatic_stress(height, density * g, K0), strain="jaumann")
bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
problem = mpm.QuasiStatic(F, u, points, bcs, stabilisation="ghost")
top = mpm.probe(points, (0.125, height))
curve = mpm.History()
for share in mpm.steps(20):
    gravity.value[1] = -g * (1 + 4 * share)
    problem.step()
    curve.record(gravity=1 + 4 * share, settlement=-float(top.displacement[1]))

# The same by oedometer tests at the middles of layers. Strains are logarithmic.
middles, layer = np.linspace(0, height, 21)[:-1] + height / 40, height / 20
settlement = 0.0
for Y in middles:
    first = -density * g * (height - Y)
    start = [K0 * first, first, K0 * first]
    test = mpm.study.element_test(law, "oedometer", 5 * first, by="stress", stress=start, steps=20)
    settlement += layer * (1 - np.exp(test["strain_yy"][-1]))

names = {"gravity": "gravity (g)", "settlement": "settlement (m)"}
curve.plot("output/published_law.png", "gravity", "settlement", labels=names)
error = abs(curve["settlement"][-1] / settlement - 1)
if MPI.COMM_WORLD.rank == 0:
    print(f"settlement {curve['settlement'][-1]:.5f} m, by oedometer tests {settlement:.5f} m")
assert error < 0.01
