"""Patch test, rigid motion and the conditioning of cut cells."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from conftest import dense, unit_grid
from dolfinx import fem, mesh
from mpi4py import MPI

import dolfinmpm as mpm


def anywhere(x):
    return np.full(x.shape[1], True)


def linear_motion(grid, V, A):
    """Conditions that move the outer nodes by A x."""
    d = grid.geometry.dim

    def outer(x):
        return np.any((x[:d] < 1e-9) | (x[:d] > 1 - 1e-9), axis=0)

    return [
        c
        for i in range(d)
        for c in mpm.prescribed(V, outer, i, increment=lambda x, i=i: A[i] @ x[:d])
    ]


@pytest.mark.parametrize("law", [mpm.materials.Hencky, mpm.materials.NeoHookean])
def test_patch(any_grid, law):
    """A linear motion of the edge makes the same strain and stress at every point."""
    grid = any_grid
    d = grid.geometry.dim
    per_cell = 2
    points = mpm.fill(grid, mpm.Box((0.0,) * d, (1.0,) * d), per_cell, 1.0)
    V = mpm.Space(grid, "linear")
    # the edge moves inwards everywhere, so that no point leaves the grid
    A = 0.05 * np.array([[-1.0, 0.4, 0.2], [0.3, -0.8, 0.5], [0.1, 0.6, -0.9]])[:d, :d]
    # the points integrate a distorted cell only approximately: there all nodes are moved
    affine = grid.topology.cell_type in (mesh.CellType.triangle, mesh.CellType.tetrahedron)
    everywhere = [
        c
        for i in range(d)
        for c in mpm.prescribed(V, anywhere, i, increment=lambda x, i=i: A[i] @ x[:d])
    ]
    bcs = linear_motion(grid, V, A) if affine or d == 1 else everywhere
    F = mpm.momentum(law(E=100.0, nu=0.3), points, V.increment, V.test)
    problem = mpm.QuasiStatic(F, V.increment, points, bcs)
    x = points["x"].copy()
    record = problem.step()
    np.testing.assert_allclose(points["F"], np.broadcast_to(np.eye(d) + A, points["F"].shape),
                               atol=1e-9)  # fmt: skip
    np.testing.assert_allclose(points["x"], x + x @ A.T, atol=1e-9)
    np.testing.assert_allclose(points["V"], np.linalg.det(np.eye(d) + A) * points["V0"], rtol=1e-9)
    stress = points["stress"]
    np.testing.assert_allclose(stress, np.broadcast_to(stress[0], stress.shape), atol=1e-6)
    assert np.abs(stress).max() > 1.0
    assert record.iterations <= 6


@pytest.mark.parametrize("basis", ["linear", "gimp"])
def test_patch_on_a_rectangular_grid(basis):
    """Points that tile the cells evenly integrate a linear motion exactly."""
    grid = unit_grid("quadrilateral", 4)
    points = mpm.fill(grid, mpm.Box((0, 0), (1, 1)), 2, 1.0)
    V = mpm.Space(grid, basis)
    A = np.array([[-0.05, 0.02], [0.015, -0.04]])
    law = mpm.materials.Hencky(E=100.0, nu=0.3)
    F = mpm.momentum(law, points, V.increment, V.test)
    mpm.QuasiStatic(F, V.increment, points, linear_motion(grid, V, A)).step()
    np.testing.assert_allclose(points["F"], np.broadcast_to(np.eye(2) + A, points["F"].shape),
                               atol=1e-10)  # fmt: skip


@pytest.mark.parametrize("law", [mpm.materials.Hencky, mpm.materials.NeoHookean])
@pytest.mark.parametrize("kind", ["quadrilateral", "triangle", "hexahedron"])
def test_rigid_motion_makes_no_stress(kind, law):
    grid = unit_grid(kind, 6)
    d = grid.geometry.dim
    points = mpm.fill(grid, mpm.Box((0.35,) * d, (0.65,) * d), 2, 1.0)
    V = mpm.Space(grid, "linear")
    angle = 0.4
    R = np.eye(d)
    R[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    centre, shift = np.full(d, 0.5), np.full(d, 0.03)

    def motion(i):
        return lambda x: ((R - np.eye(d)) @ (x[:d].T - centre).T)[i] + shift[i]

    bcs = [c for i in range(d) for c in mpm.prescribed(V, anywhere, i, increment=motion(i))]
    F = mpm.momentum(law(E=1e6, nu=0.3), points, V.increment, V.test)
    problem = mpm.QuasiStatic(F, V.increment, points, bcs)
    for _ in range(3):
        problem.step()
    turned = np.linalg.matrix_power(R, 3)
    np.testing.assert_allclose(points["F"], np.broadcast_to(turned, points["F"].shape), atol=1e-12)
    assert np.abs(points["stress"]).max() < 1e-9 * 1e6


def condition_of_a_cut(scaling, cut=1e-6, h=1.0):
    """κ(K) of a column whose uppermost cell is filled to the share `cut`."""
    grid = mesh.create_rectangle(MPI.COMM_WORLD, [(0, 0), (h, 6 * h)], (1, 6),
                                 mesh.CellType.quadrilateral)  # fmt: skip
    points = mpm.fill(grid, mpm.Box((0, 0), (h, (4 + cut) * h)), 2, 1.0)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    F = mpm.momentum(mpm.materials.Hencky(E=1.0, nu=0.0), points, u, v)
    if scaling:
        F += mpm.ghost(points, u, v, gamma=1 / 30, scaling=scaling)
    problem = mpm.QuasiStatic(
        F, u, points, mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
    )
    return np.linalg.cond(dense(problem.stiffness()))


def test_ghost_penalty_bounds_the_condition_of_a_nearly_empty_cell():
    assert condition_of_a_cut(None, 1e-11) > 1e10 or condition_of_a_cut(None, 1e-9) > 1e10
    bounded = [condition_of_a_cut("scaled", cut) for cut in (1e-9, 1e-6, 1e-3, 0.5)]
    assert max(bounded) < 1e3
    # and it does so in any unit of length, which the literal form does not
    same = [condition_of_a_cut("scaled", 1e-6, h) for h in (1e-3, 1e3)]
    np.testing.assert_allclose(same, bounded[1], rtol=1e-6)
    assert condition_of_a_cut("literal", 1e-6, 1e-3) > 1e6


def test_ghost_penalty_leaves_linear_motions_alone():
    """Its row sums are zero, and so is its force on a linear increment."""
    grid = unit_grid("quadrilateral", 5)
    points = mpm.fill(grid, mpm.Box((0.2, 0.2), (0.8, 0.75)), 2, 1.0)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    F = mpm.momentum(mpm.materials.Hencky(E=0.001, nu=0.0), points, u, v)
    F += mpm.ghost(points, u, v, gamma=1e3)
    (blocks,) = mpm.QuasiStatic(F, u, points).activate().blocks_of("stiffness")
    assert blocks.values.size > 0
    x = V.function_space.tabulate_dof_coordinates()[:, :2]
    A = np.array([[1.0, 0.3], [0.2, -0.7]])
    force = np.zeros_like(x)
    from dolfinmpm.assembly.stencilsums import add_product

    size = np.abs(blocks.values).max()
    add_product(blocks, [x @ A.T + 1.0], [force])
    assert np.abs(force).max() < 1e-10 * size
    add_product(blocks, [x**2], [force])
    assert np.abs(force).max() > 1e-3 * size


def test_energy_of_ones_own_in_ufl_equals_the_built_in_law():
    grid = unit_grid("quadrilateral", 4)
    E, nu = 50.0, 0.3
    lmbda, mu = E * nu / ((1 + nu) * (1 - 2 * nu)), E / (2 * (1 + nu))
    results = []
    for own in (False, True):
        points = mpm.fill(grid, mpm.Box((0.2, 0), (0.7, 0.8)), 2, 1.0)
        V = mpm.Space(grid, "gimp")
        u, v = V.increment, V.test
        g = fem.Constant(grid, (0.0, 0.0))
        if own:
            D = (ufl.Identity(2) + ufl.grad(u)) * points.F
            J = ufl.det(D)
            psi = mu / 2 * (ufl.tr(D.T * D) - 2) - mu * ufl.ln(J) + lmbda / 2 * ufl.ln(J) ** 2
            F = ufl.derivative(psi * points.dX, u, v)
        else:
            F = mpm.momentum(mpm.materials.NeoHookean(E=E, nu=nu), points, u, v)
        F -= ufl.inner(g, v) * points.dX
        problem = mpm.QuasiStatic(F, u, points, mpm.fixed(V, "bottom"))
        for k in range(3):
            g.value[:] = 0.1 * (k + 1), -1.5 * (k + 1)
            problem.step()
        results.append(points["x"].copy())
    np.testing.assert_allclose(results[0], results[1], atol=1e-12)
