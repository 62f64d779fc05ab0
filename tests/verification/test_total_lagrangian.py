"""The total Lagrangian configuration: no cell is crossed, whatever the body does."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI
from scipy.integrate import quad
from scipy.optimize import brentq

import dolfinmpm as mpm

E, HEIGHT, WEIGHT = 10e3, 50.0, 800.0


def column(elements, basis="linear", configuration="total", steps=40, stabilisation="none"):
    """A 50 m column that compacts under its own weight; returns its problem."""
    h = HEIGHT / elements
    grid = mesh.create_rectangle(
        MPI.COMM_WORLD, [(0, 0), (h, HEIGHT + 2 * h)], (1, elements + 2),
        mesh.CellType.quadrilateral,
    )  # fmt: skip
    points = mpm.fill(grid, mpm.Box((0, 0), (h, HEIGHT)), 2, 80.0)
    V = mpm.Space(grid, basis, configuration=configuration)
    u, v = V.increment, V.test
    g = fem.Constant(grid, (0.0, 0.0))
    F = mpm.momentum(mpm.materials.Hencky(E=E, nu=0.0), points, u, v)
    F -= ufl.inner(points.density * g, v) * points.dX
    bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
    problem = mpm.QuasiStatic(F, u, points, bcs, stabilisation=stabilisation)
    for k in range(steps):
        g.value[1] = -10.0 * (k + 1) / steps
        problem.step()
    return problem


def settlement(X):
    """Exact displacement: τ = E ln λ and P = τ/λ = −w (H − X) give λ(X)."""

    def stretch(Y):
        load = WEIGHT * (HEIGHT - Y)
        return brentq(lambda s: E * np.log(s) / s + load, 0.05, 1.0)

    return quad(lambda Y: stretch(Y) - 1, 0.0, X, epsabs=1e-12)[0]


def error(problem):
    """Root mean square of the error of displacement, relative to the largest."""
    points = problem.points
    exact = np.array([settlement(X) for X in points["x0"][:, 1]])
    return (
        np.sqrt(np.mean((points["x"][:, 1] - points["x0"][:, 1] - exact) ** 2))
        / np.abs(exact).max()
    )


def test_linear_functions_converge_where_updated_ones_stay():
    found = [error(column(n)) for n in (8, 16, 32)]
    orders = np.log2(np.array(found[:-1]) / found[1:])
    assert orders.min() >= 1.9
    assert error(column(32, configuration="updated")) > 50 * found[-1]


@pytest.mark.parametrize(
    ("basis", "stabilisation"),
    [("gimp", "ghost"), ("bspline2", "ghost"), ("linear", "aggregation"), ("bspline2", "soft")],
)
def test_other_bases_and_stabilisations(basis, stabilisation):
    problem = column(8, basis, stabilisation=stabilisation)
    assert error(problem) < 5e-3
    assert all(record.halvings == 0 for record in problem.history)
    assert np.array_equal(problem.here.where.x, problem.points["x0"])


def test_stencils_are_made_once(monkeypatch):
    problem = column(8, steps=2)

    def broken(*_):
        raise AssertionError("stencils were made again")

    monkeypatch.setattr("dolfinmpm.basis.latticebasis.LatticeBasis.stencils", broken)
    problem.step()


def test_into_the_updated_configuration():
    """What a total Lagrangian run ends with, an updated one goes on from, in balance."""
    first = column(16, "gimp")
    points = first.points
    grid = points.grid
    V = mpm.Space(grid, "gimp")
    g = fem.Constant(grid, (0.0, -10.0))
    law = mpm.materials.Hencky(E=E, nu=0.0)
    F = mpm.momentum(law, points, V.increment, V.test)
    F -= ufl.inner(points.density * g, V.test) * points.dX
    bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
    second = mpm.QuasiStatic(F, V.increment, points, bcs)
    before = points["x"].copy()
    second.step()
    moved = np.abs(points["x"] - before).max()
    assert moved < 0.02 * np.abs(before - points["x0"]).max()
    # and back
    V = mpm.Space(grid, "gimp", configuration="total")
    F = mpm.momentum(law, points, V.increment, V.test)
    F -= ufl.inner(points.density * g, V.test) * points.dX
    bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
    third = mpm.QuasiStatic(F, V.increment, points, bcs)
    third.step()
    assert third.here.total
    assert error(third) < 2e-2


@pytest.mark.parametrize("strain", ["large", "small", "jaumann"])
@pytest.mark.parametrize("fbar", [False, True])
def test_laws_and_loads(strain, fbar):
    """A first step is the same in both configurations; so are later ones of a body that turns."""
    ends = []
    for configuration in ("updated", "total"):
        grid = mesh.create_rectangle(
            MPI.COMM_WORLD, [(0, -4), (8, 4)], (8, 8), mesh.CellType.quadrilateral
        )
        points = mpm.fill(grid, mpm.Box((0, -1), (5, 1)), 3, 1.0)
        V = mpm.Space(grid, "bspline2", configuration=configuration)
        u, v = V.increment, V.test
        p = fem.Constant(grid, 0.0)
        face = mpm.Surface(points, lambda x: np.isclose(x[1], 1.0), (0, 1))
        law = mpm.materials.VonMises(E=1e3, nu=0.3, radius=60.0, hardening=50.0)
        F = mpm.momentum(law, points, u, v, strain=strain, fbar=fbar) + face.pressure(p, u, v)
        problem = mpm.QuasiStatic(F, u, points, mpm.fixed(V, "left"), stabilisation="ghost")
        tips = []
        for k in range(4):
            p.value = 0.5 * (k + 1)
            problem.step()
            tips.append(points["x"][np.argmax(points["x0"] @ [1.0, 0.1]), 1])
        ends.append(tips)
    updated, total = np.array(ends)
    drop = np.abs(updated - 1.0)
    assert total[0] == pytest.approx(updated[0], abs=1e-9)
    assert np.all(np.abs(total - updated) < 0.05 * drop)
