"""Laws from outside: UMATs, whose state moves with the points."""

from __future__ import annotations

from pathlib import Path

import ufl
from dolfinx import fem, mesh

import dolfinmpm as mpm

from .common import COMM, run, sums

SOURCE = Path(__file__).resolve().parents[3] / "demos" / "umat" / "mises.f"


def umat():
    """A leaning column that yields under its weight by a UMAT; points change rank."""
    grid = mesh.create_rectangle(COMM, [(0, 0), (6, 8)], (12, 16), mesh.CellType.quadrilateral)
    points = mpm.fill(grid, mpm.Box((1, 0), (4, 6)), 2, 1800.0)
    V = mpm.Space(grid, "gimp")
    g = fem.Constant(grid, (0.0, -9.81))
    state = {"plastic_strain": lambda x: 1e-4 * x[1]}
    law = mpm.materials.UMAT(SOURCE, [1e6, 0.3, 7e4, 1e6], state)
    F = mpm.momentum(law, points, V.increment, V.test, strain="jaumann")
    F -= ufl.inner(points.density * g, V.test) * points.dX
    mpm.set_stress(law, points, mpm.geostatic_stress(6, 1800 * 9.81, 0.5), strain="jaumann")
    loads = [(0.05 * k, -9.81 - 0.5 * k) for k in range(1, 5)]
    options = {"stabilisation": "ghost", "tolerance": 1e-11}
    _, figures = run(points, V, F, mpm.fixed(V, "bottom"), loads, g, **options)
    return figures | sums(points, "total_strain", "plastic_strain", "elastic_energy")


def umat_explicit():
    """The same UMAT in explicit steps."""
    grid = mpm.create_lattice(COMM, [range(9), range(9)])
    points = mpm.fill(grid, mpm.Box((1, 0), (4, 6)), 2, 1800.0)
    V = mpm.Space(grid, "gimp")
    law = mpm.materials.UMAT(SOURCE, [1e6, 0.3, 2e4, 1e6], ["plastic_strain"])
    F = mpm.momentum(law, points, V.increment, V.test, strain="jaumann")
    F -= ufl.inner(points.density * ufl.as_vector((1.0, -9.81)), V.test) * points.dX
    problem = mpm.Explicit(F, V.increment, points, mpm.fixed(V, "bottom"))
    problem.step(0.3)
    energies = problem.energies()
    return sums(points, "x", "stress", "plastic_strain") | {"kinetic": energies.kinetic}
