"""Laws that yield, under all measures of strain."""

from __future__ import annotations

from unittest import mock

import numpy as np
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

import dolfinmpm as mpm
from dolfinmpm.solve import krylov, method

from .common import COMM, run, sums
from .restart import REPEATABLE


def _measure(strain):
    """A leaning column of yielding ground that starts under its weight; points change rank."""
    grid = mesh.create_rectangle(COMM, [(0, 0), (6, 8)], (12, 16), mesh.CellType.quadrilateral)
    points = mpm.fill(grid, mpm.Box((1, 0), (4, 6)), 2, 1800.0)
    V = mpm.Space(grid, "gimp")
    g = fem.Constant(grid, (0.0, -9.81))
    law = mpm.materials.VonMises(lambda x: 1e6 + 2e4 * x[1], 0.3, radius=6e4, hardening=1e6)
    F = mpm.momentum(law, points, V.increment, V.test, strain=strain)
    F -= ufl.inner(points.density * g, V.test) * points.dX
    mpm.set_stress(law, points, mpm.geostatic_stress(6, 1800 * 9.81, 0.5), strain=strain)
    start = sums(points, "stress")
    # the load goes beyond what it starts from
    loads = [(0.05 * k, -9.81 - 0.5 * k) for k in range(1, 5)]
    bcs = mpm.fixed(V, "bottom")
    problem, figures = run(points, V, F, bcs, loads, g, stabilisation="ghost")
    state = "be" if strain == "large" else "elastic_strain"
    modulus = problem.stabilisation.E
    return figures | sums(points, state, "plastic_strain") | {"start": start, "modulus": modulus}


def large_strain():
    """Initial stress, moduli that vary and plastic flow under large strain."""
    return _measure("large")


def small_strain():
    """The same under small strain."""
    return _measure("small")


def jaumann():
    """The same under Jaumann's rate."""
    return _measure("jaumann")


def _plastic(law):
    """A block that collapses, weaker in its middle, with points that change rank."""
    kind = mesh.CellType.quadrilateral
    grid = mesh.create_rectangle(COMM, [(0, 0), (16, 8)], (16, 8), kind)
    points = mpm.fill(grid, mpm.Box((0, 0), (8, 8)), 3, 1000.0)
    V = mpm.Space(grid, "gimp")
    g = fem.Constant(grid, (0.0, 0.0))
    F = mpm.momentum(law, points, V.increment, V.test)
    F -= ufl.inner(points.density * g, V.test) * points.dX
    bcs = mpm.rollers(V, "left", "bottom")
    loads = [(0.0, -10.0 * k / 20) for k in range(1, 21)]
    stabilisation = mpm.Stabilisation("ghost", E=1e6)
    # each step starts from where the last one ended, and a tight end leaves less to differ in
    options = {"stabilisation": stabilisation, "tolerance": 1e-12}
    _, figures = run(points, V, F, bcs, loads, g, **options)
    largest = COMM.allreduce(float(points["plastic_strain"].max(initial=0.0)), op=MPI.MAX)
    assert largest > 0.5
    return figures | sums(points, "plastic_strain", "be")


def _strength(x):
    return np.where((x[1] > 3) & (x[1] < 4), 1.5e4, 2e4)


def plastic():
    """Von Mises' law, whose yield stress goes with the points."""
    return _plastic(mpm.materials.VonMises(E=1e6, nu=0.3, radius=_strength))


def law_in_ufl():
    """The same law from functions in UFL, compiled by all ranks together."""

    def energy(e, lmbda, mu):
        return lmbda / 2 * (e[0] + e[1] + e[2]) ** 2 + mu * ufl.inner(e, e)

    lmbda, mu = 0.3e6 / (1.3 * 0.4), 0.5e6 / 1.3
    law = mpm.materials.EnergyWithYield(
        energy, lmbda=lmbda, mu=mu, yield_stress=lambda x: np.sqrt(1.5) * _strength(x)
    )
    return _plastic(law)


def layers():
    """A slope of two laws by tags, with an energy on top, whose points change rank."""
    grid = mesh.create_rectangle(COMM, [(0, 0), (8, 6)], (16, 12), mesh.CellType.quadrilateral)
    ground = mpm.Polygon([(0, 0), (6, 0), (3, 4), (0, 4)])
    points = mpm.fill(grid, ground, 2, 1800.0)
    y = points["x"][:, 1]
    points["tag"] = np.digitize(y, [2.0, 3.2])
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    g = fem.Constant(grid, (0.0, 0.0))
    soil = mpm.materials.VonMises(lambda x: 1e6 + 2e4 * x[1], 0.3, radius=1.5e4, hardening=1e6)
    F = mpm.momentum(soil, points, u, v, tag=0)
    F += mpm.momentum(
        mpm.materials.VonMises(2e6, 0.3, radius=_strength, hardening=1e6), points, u, v, tag=1
    )
    crust = mpm.materials.NeoHookean(lambda x: 5e5 + 1e4 * x[0], 0.3)
    F += mpm.momentum(crust, points, u, v, tag=2)
    # a term with the stress by itself, and a load on one part
    F += 0.1 * ufl.inner(mpm.stress(soil, points, u, tag=0), ufl.grad(v)) * points.dX(0)
    F -= ufl.inner(points.density * g, v) * points.dX
    F -= 500 * v[0] * points.dX((1, 2))
    loads = [(1.2 * k, -3.0 * k) for k in range(1, 9)]
    bcs = mpm.fixed(V, "bottom") + mpm.rollers(V, "left")
    _, figures = run(points, V, F, bcs, loads, g, stabilisation="ghost", tolerance=1e-12)
    yielded = COMM.allreduce(points["plastic_strain"][points["tag"] == 0].max(initial=0.0), MPI.MAX)
    assert yielded > 1e-4
    assert not points["plastic_strain"][points["tag"] == 2].any()
    return figures | sums(points, "plastic_strain", "be", "moved_under")


def incomplete_factors():
    """Ground that flows, under incomplete factors of each rank, and factors where these fail."""
    found = {}
    for name, most in (("kept", 200), ("failed", 2)):
        grid = mesh.create_rectangle(COMM, [(0, 0), (8, 4)], (16, 8), mesh.CellType.quadrilateral)
        points = mpm.fill(grid, mpm.Box((0, 0), (4, 3)), 2, 1800.0)
        V = mpm.Space(grid, "gimp")
        g = fem.Constant(grid, (0.0, 0.0))
        soil = mpm.materials.MohrCoulomb(1e6, 0.3, 2e3, 25.0, dilation_angle=0.0)
        F = mpm.momentum(soil, points, V.increment, V.test)
        F -= ufl.inner(points.density * g, V.test) * points.dX
        bcs = mpm.rollers(V, "left", "bottom")
        loads = [(0.0, -0.4 * k) for k in range(1, 6)]
        with (
            mock.patch.object(method, "_KEPT", {2: 20}),
            mock.patch.object(krylov, "_MOST_OF_INCOMPLETE", most),
        ):
            problem, figures = run(
                points, V, F, bcs, loads, g, stabilisation="ghost", tolerance=1e-12
            )
        solver = problem.newton.linear.method
        assert solver.incomplete if name == "kept" else solver.pc == "lu", solver
        assert COMM.allreduce(points["plastic_strain"].max(initial=0.0), MPI.MAX) > 1e-4
        # no point changes rank, and of blocks of ranks iterations are others than of one
        figures = {k: v for k, v in figures.items() if k not in ("moved", "iterations")}
        found[name] = figures | sums(points, "plastic_strain", "be")
    return found


def wall():
    """An elastic wall holds up Mohr–Coulomb ground that yields; bodies of two tags, joined."""
    grid = mesh.create_rectangle(COMM, [(0, 0), (8, 6)], (16, 12), mesh.CellType.quadrilateral)
    pile = mpm.Box((3.5, 1.0), (4.0, 4.5))
    ground = (mpm.Box((0, 0), (8, 2.5)) | mpm.Box((0, 2.5), (3.5, 4.0))) - pile
    points = mpm.fill(grid, ground, 2, 1800.0, tag=1) + mpm.fill(grid, pile, 2, 2400.0, tag=2)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    g = fem.Constant(grid, (0.0, 0.0))
    soil = mpm.materials.MohrCoulomb(2e7, 0.3, 5e3, 28.0, dilation_angle=4.0)
    F = mpm.momentum(soil, points, u, v, tag=1)
    F += mpm.momentum(mpm.materials.Hencky(5e8, 0.2), points, u, v, tag=2)
    F -= ufl.inner(points.density * g, v) * points.dX
    loads = [(0.0, -1.25 * k) for k in range(1, 9)]
    bcs = mpm.fixed(V, "bottom") + mpm.rollers(V, "left", "right")
    _, figures = run(points, V, F, bcs, loads, g, stabilisation="ghost", tolerance=1e-10)
    of_wall, strain = points["tag"] == 2, points["plastic_strain"]
    assert COMM.allreduce(strain[~of_wall].max(initial=0.0), MPI.MAX) > 1e-4
    assert not strain[of_wall].any()
    lean = (points["x"] - points["x0"])[of_wall, 0].max(initial=-1.0)
    assert COMM.allreduce(lean, MPI.MAX) > 1e-4
    # the wall holds: no point changes rank
    figures.pop("moved")
    return figures | sums(points, "plastic_strain", "be")


def safety_of_a_state():
    """A slope under its weight whose strength is reduced; it then goes on as if it had not been."""
    found = {}
    # a number, and a field that goes with the points
    for name, cohesion in (("number", 1e4), ("field", lambda x: 1e4 + 1e-9 * x[0])):
        # on one grid: how ranks number a grid may hang on which of them is faster
        kind = mesh.CellType.quadrilateral
        grid = mesh.create_rectangle(COMM, [(0, 0), (16, 8)], (16, 8), kind)
        one, g = _slope(cohesion, grid)
        other, g_of_other = _slope(cohesion, grid)
        one.step(), other.step()
        safety = mpm.study.factor_of_safety(one, 1.0, 2.0, tolerance=0.1)
        for problem, gravity in ((one, g), (other, g_of_other)):
            gravity.value[1] = -10.5
            problem.step()
        for field in ("x", "stress", "be"):
            np.testing.assert_array_equal(one.points[field], other.points[field])
        found[name] = {
            "bracket": safety.bracket,
            "stands": [trial.stands for trial in safety.trials],
            "growth": [trial.growth for trial in safety.trials if trial.stands],
            **sums(one.points, "x", "stress"),
        }
    return found


def _slope(cohesion, grid):
    """A slope of one to one; points of its trials change rank."""
    shape = mpm.Polygon([(0, 0), (12, 0), (6, 6), (0, 6)])
    points = mpm.fill(grid, shape, 2, 2000.0)
    V = mpm.Space(grid, "gimp")
    g = fem.Constant(grid, (0.0, -10.0))
    law = mpm.materials.MohrCoulomb(2e7, 0.3, cohesion, 25.0, dilation_angle=0.0)
    F = mpm.momentum(law, points, V.increment, V.test)
    F -= ufl.inner(points.density * g, V.test) * points.dX
    bcs = mpm.rollers(V, "left") + mpm.fixed(V, "bottom")
    options = {"tolerance": 1e-12, "petsc_options": REPEATABLE}
    problem = mpm.QuasiStatic(F, V.increment, points, bcs, stabilisation="ghost", **options)
    return problem, g
