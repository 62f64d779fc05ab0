"""Displacement in quadratic splines with a linear pressure against conforming Taylor–Hood elements.

A nearly incompressible block, ν = 0.4999, stands on its foot and spreads under its weight:
σ = 2μ ε − p I with p = −λ tr ε, in one step that is linear.
"""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from basix.ufl import element, mixed_element
from dolfinx import fem, mesh
from dolfinx.fem.petsc import LinearProblem
from mpi4py import MPI

import dolfinmpm as mpm
from dolfinmpm.materials.base import lame

E, NU, WEIGHT, LENGTH, HEIGHT = 1e6, 0.4999, 1e3, 2.0, 1.0
LAMBDA, MU = lame(E, NU)


def weak(u, p, v, q, measure, dim=2):
    strain = ufl.sym(ufl.grad(u))
    balance = ufl.inner(2 * MU * strain - p * ufl.Identity(dim), ufl.grad(v))
    return (balance - (ufl.tr(strain) + p / LAMBDA) * q) * measure


def conforming(n):
    """Mean volume strain, mean pressure and tip deflection of Q2–Q1 elements of size 1/n."""
    grid = mesh.create_rectangle(
        MPI.COMM_WORLD, [(0, 0), (LENGTH, HEIGHT)], (int(LENGTH * n), n),
        mesh.CellType.quadrilateral,
    )  # fmt: skip
    cell = grid.basix_cell()
    pair = mixed_element([element("Q", cell, 2, shape=(2,)), element("Q", cell, 1)])
    W = fem.functionspace(grid, pair)
    (u, p), (v, q) = ufl.TrialFunctions(W), ufl.TestFunctions(W)
    V, _ = W.sub(0).collapse()
    zero = fem.Function(V)
    facets = mesh.locate_entities_boundary(grid, 1, lambda x: np.isclose(x[1], 0))
    held = fem.locate_dofs_topological((W.sub(0), V), 1, facets)
    a = weak(u, p, v, q, ufl.dx)
    L = ufl.inner(ufl.as_vector((0.0, -WEIGHT)), v) * ufl.dx
    options = {"ksp_type": "preonly", "pc_type": "lu", "pc_factor_mat_solver_type": "mumps"}
    problem = LinearProblem(
        a, L, bcs=[fem.dirichletbc(zero, held, W.sub(0))], petsc_options=options
    )
    found = problem.solve()
    u, p = found.sub(0).collapse(), found.sub(1).collapse()
    area = LENGTH * HEIGHT

    def mean(value):
        return grid.comm.allreduce(fem.assemble_scalar(fem.form(value * ufl.dx))) / area

    return mean(ufl.div(u)), mean(p), mean(u[1])


def splines(n, stabilisation):
    """The same of material points on a grid that is larger than the body."""
    grid = mesh.create_rectangle(
        MPI.COMM_WORLD, [(-1, 0), (LENGTH + 1, HEIGHT + 1)], (int((LENGTH + 2) * n), 2 * n),
        mesh.CellType.quadrilateral,
    )  # fmt: skip
    points = mpm.fill(grid, mpm.Box((0, 0), (LENGTH, HEIGHT)), 3, 1.0)
    V, Q = mpm.Space(grid, "bspline2"), mpm.Space(grid, "linear", shape=())
    u, p = V.increment, Q.increment
    g = fem.Constant(grid, (0.0, -WEIGHT))
    F = weak(u, p, V.test, Q.test, points.dX) - ufl.inner(g, V.test) * points.dX
    for name in ("pressure", "volume", "deflection"):
        points.add_field(name)
    problem = mpm.QuasiStatic(
        F, [u, p], points, mpm.fixed(V, "bottom"),
        stabilisation=stabilisation,
        updates={"pressure": p, "volume": ufl.div(u), "deflection": u[1]},
    )  # fmt: skip
    problem.step()
    weight = points["V0"] / points["V0"].sum()
    assert points["V0"].sum() == pytest.approx(LENGTH * HEIGHT)
    return [float(weight @ points[name]) for name in ("volume", "pressure", "deflection")]


@pytest.mark.parametrize("stabilisation", ["none", "aggregation"])
def test_volume_strain_and_pressure_are_those_of_taylor_hood_elements(stabilisation):
    reference = conforming(32)
    found = splines(8, stabilisation)
    for ours, theirs in zip(found, reference):
        assert ours == pytest.approx(theirs, rel=6e-3)
    assert found[:2] == pytest.approx(reference[:2], rel=5e-3)
    # and by the law
    assert found[1] == pytest.approx(-LAMBDA * found[0], rel=1e-3)


def test_a_ghost_penalty_on_the_displacement_goes_with_the_cells():
    reference = conforming(32)
    stabilisations = [mpm.Stabilisation("ghost", E=E), "none"]
    errors = [abs(splines(n, stabilisations)[1] / reference[1] - 1) for n in (4, 8, 16)]
    assert errors[2] < 6e-3
    assert errors[2] < 0.5 * errors[1] < 0.25 * errors[0] * 1.1
