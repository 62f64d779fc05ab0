"""Bodies of revolution, whose points change rank: hoop terms, means, penalties, loads, motion."""

from __future__ import annotations

import numpy as np
import ufl
from dolfinx import fem, mesh

import dolfinmpm as mpm

from .common import COMM, run, sums
from .restart import REPEATABLE, goes_on

ENERGIES = ("kinetic", "strain", "external", "bodies", "contact", "initial", "dissipated")


def grid_of(cells, size):
    kind = mesh.CellType.quadrilateral
    return mesh.create_rectangle(COMM, [(0, 0), size], cells, kind)


def slump(basis, stabilisation, law=None, fbar=True, **options):
    """A cylinder on its axis that slumps under its weight and a pressure on its side."""
    grid = grid_of((12, 8), (12.0, 8.0))
    points = mpm.fill(grid, mpm.Box((0, 0), (5.3, 6.4)), 2, 1.0, axisymmetric=True)
    V = mpm.Space(grid, basis, **options)
    u, v = V.increment, V.test
    g = fem.Constant(grid, (0.0, 0.0))
    law = law or mpm.materials.Hencky(E=100.0, nu=0.45)
    side = mpm.Surface(points, lambda x: np.isclose(x[0], 5.3), (1, 0), name="side")
    F = mpm.momentum(law, points, u, v, fbar=fbar) + side.pressure(1.0, u, v)
    F -= ufl.inner(points.density * g, v) * points.dX
    bcs = mpm.rollers(V, "left") + mpm.fixed(V, "bottom")
    stabilisation = mpm.Stabilisation(stabilisation, E=100.0 if stabilisation != "ghost" else None)
    loads = [(0.0, -1.5 * k) for k in range(1, 5)]
    _, figures = run(points, V, F, bcs, loads, g, stabilisation=stabilisation)
    # the hoop stretch is the ratio of radii on every rank
    ratio = points["x"][:, 0] / points["x0"][:, 0]
    np.testing.assert_allclose(points["F"][:, 2, 2], ratio, rtol=1e-13)
    return figures | {"area": side.total_area, "volume": points.shape_volume}


def rings_bases():
    """Every basis with F-bar and a ghost penalty."""
    return {basis: slump(basis, "ghost") for basis in ("linear", "gimp", "bspline2", "bspline3")}


def rings_stabilisations():
    """Other stabilisations, a law that yields, an energy, and total increments."""
    yields = mpm.materials.VonMises(100.0, 0.3, radius=4.0, hardening=20.0)
    energy = mpm.materials.NeoHookean(100.0, 0.3)
    return {
        "aggregation": slump("gimp", "aggregation", yields),
        "weak": slump("gimp", "weak-aggregation", energy, fbar=False),
        "total": slump("linear", "ghost", configuration="total"),
    }


def _thrown(kind, **options):
    """A ring that is thrown outwards and falls."""
    grid = grid_of((12, 8), (12.0, 8.0))
    points = mpm.fill(grid, mpm.Box((2, 3), (5, 6.4)), 2, 1.0, axisymmetric=True)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    points.add_field("velocity", (2,), "m/s", lambda x: np.stack([2 + 0 * x[0], 0.1 * x[0]], 1))
    law = mpm.materials.Hencky(E=100.0, nu=0.3)
    F = mpm.momentum(law, points, u, v)
    F -= ufl.inner(points.density * ufl.as_vector((0.0, -1.0)), v) * points.dX
    problem = kind(F, u, points, mpm.rollers(V, "bottom"), **options)
    for k in range(4):
        problem.step(0.1 * (k + 1))
    energies = problem.energies()
    figures = {name: float(getattr(energies, name)) for name in ENERGIES}
    # each loss by itself may be rounding alone
    lost = [float(energies[name]) for name in sorted(energies.losses)]
    return {**figures, "losses": lost, **sums(points, "x", "F", "velocity")}


def rings_in_time():
    """Implicit and explicit steps."""
    return {
        "newmark": _thrown(mpm.Newmark, stabilisation="ghost", tolerance=1e-12),
        "explicit": _thrown(mpm.Explicit, bulk_viscosity=(0.06, 1.2)),
    }


def rings_restart():
    """A cylinder that yields and goes on from its middle."""

    def build():
        grid = grid_of((12, 6), (12.0, 6.0))
        points = mpm.fill(grid, mpm.Box((0, 0), (5, 5.4)), 2, 1000.0, axisymmetric=True)
        V = mpm.Space(grid, "gimp")
        g = fem.Constant(grid, (0.0, 0.0))
        law = mpm.materials.VonMises(E=1e6, nu=0.3, radius=1e4)
        F = mpm.momentum(law, points, V.increment, V.test)
        F -= ufl.inner(points.density * g, V.test) * points.dX
        problem = mpm.QuasiStatic(
            F, V.increment, points, mpm.rollers(V, "left", "bottom"), stabilisation="ghost",
            petsc_options=REPEATABLE, tolerance=1e-12,
        )  # fmt: skip

        def step():
            g.value[1] = -0.8 * (len(problem.history) + 1)
            return problem.step()

        return problem, step

    return goes_on(build, 5)


def rings_boundaries():
    """A ball whose hole is moved up and widened by Nitsche's method, towards a wall that rubs."""
    grid = grid_of((12, 16), (3.0, 4.0))
    middle = np.array([0.0, 1.6])
    shape = (mpm.Disc(middle, 1.4) - mpm.Disc(middle, 0.55)) & mpm.Box((0, 0), (3, 4))
    results = {}
    for stabilisation in ("ghost", "aggregation"):
        points = mpm.fill(grid, shape, 2, 1.0, axisymmetric=True)
        V = mpm.Space(grid, "gimp")
        u, v = V.increment, V.test
        law = mpm.materials.VonMises(100.0, 0.3, radius=4.0, hardening=20.0)
        hole = mpm.Boundary.from_level_set(
            points, lambda x: 0.55 - np.hypot(x[0], x[1] - middle[1])
        )
        lid = mpm.Boundary.from_polygon(
            points, [(2.9, 3.07), (0.0, 3.07)], closed=False, follows=False
        )
        c = fem.Constant(grid, 0.0)
        value = c * (ufl.as_vector((0.0, 0.5)) + 0.2 * (hole.x0 - ufl.as_vector(tuple(middle))))
        F = mpm.momentum(law, points, u, v) + mpm.dirichlet(hole, u, v, value, law=law)
        F += mpm.signorini(lid, u, v, law=law, friction=0.3)
        bcs = mpm.rollers(V, "left")
        problem = mpm.QuasiStatic(
            F,
            u,
            points,
            bcs,
            stabilisation=mpm.Stabilisation(stabilisation, E=100.0),
            tolerance=1e-12,
        )
        for k in range(3):
            c.value = 0.1 * (k + 1)
            problem.step()
        results[stabilisation] = {
            "iterations": [record.iterations for record in problem.history],
            "area": hole.total_area,
            "forces": [list(hole.force()), list(lid.force())],
            "pushes": bool(lid.force()[1] < -1e-3),
            **sums(points, "x", "F", "stress"),
        }
    return results
