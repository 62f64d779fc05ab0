"""Bodies with fewer points than nodes, whose consistent mass is singular to rounding."""

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI
from petsc4py import PETSc

import dolfinmpm as mpm
from dolfinmpm._platform.errors import SingularMassWarning
from dolfinmpm.dynamics.singularmass import solution_without_null_vectors

H = 0.1


def thin_body(angle):
    """24 points of a turned box, narrower than two cells, on cubic splines."""
    grid = mesh.create_rectangle(
        MPI.COMM_WORLD, [(0.0, 0.0), (2.0, 1.5)], [20, 15], mesh.CellType.quadrilateral
    )
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    corners = np.array([[-0.2, -0.07], [0.2, -0.07], [0.2, 0.07], [-0.2, 0.07]]) @ turn.T
    shape = mpm.Polygon(np.add(corners, [1.02, 0.77]))
    points = mpm.fill(grid, shape, 2, 1000.0)
    points.add_field("velocity", (2,), "m/s")
    return grid, points


def flight(angle, stabilisation="ghost"):
    """A problem of the body, which flies and turns, is stretched and let go."""
    grid, points = thin_body(angle)
    V = mpm.Space(grid, "bspline3")
    law = mpm.materials.NeoHookean(E=4e5, nu=0.2)
    form = mpm.momentum(law, points, V.increment, V.test)
    x = points["x"] - points["x"].mean(axis=0)
    points["velocity"] = [0.5, 0.1] + 2.0 * np.column_stack([-x[:, 1] + x[:, 0], x[:, 0]])
    return mpm.Newmark(form, V.increment, points, stabilisation=stabilisation)


def run(problem, first, last):
    for k in range(first, last + 1):
        problem.step(2e-3 * k)
        e = problem.energies()
        yield (e.kinetic + e.strain) / max(e.initial, 1e-300)


@pytest.mark.parametrize(("per_cell", "singular"), [(2, True), (4, False)])
def test_explicit_steps_tell_that_forces_are_left_out(per_cell, singular):
    """A layer of one cell of splines swung at twice its frequency, without a message."""
    grid = mpm.create_lattice(MPI.COMM_WORLD, [H * np.arange(-1, 11), H * np.arange(-3, 5)])
    points = mpm.fill(grid, mpm.Box((0, 0), (8 * H, H)), per_cell, 1000.0)
    x = points["x"]
    points.add_field("velocity", (2,), "m/s")
    points["velocity"] = 0.1 * np.cos(np.pi * x[:, :1] / (8 * H)) * [0.0, 1.0]
    V = mpm.Space(grid, "bspline3")
    form = mpm.momentum(mpm.materials.Hencky(E=1e6, nu=0.2), points, V.increment, V.test)
    problem = mpm.Explicit(form, V.increment, points, mass="consistent", courant=0.3)
    if singular:
        with pytest.warns(SingularMassWarning, match="% of the forces act along motions of nodes"):
            problem.step(5e-3)
    else:
        problem.step(5e-3)
    e = problem.energies()
    assert abs(e["integrator"]) < 0.01 * e.initial


@pytest.mark.parametrize("angle", [0.3, 1.0])
def test_a_body_with_fewer_points_than_nodes_keeps_energy_and_momentum(angle, tmp_path):
    problem = flight(angle)
    points = problem.points
    mass = points["density"] * points["V0"]
    momentum = mass @ points["velocity"]
    with pytest.warns(SingularMassWarning, match="fewer points than free nodes"):
        energies = list(run(problem, 1, 10))
    problem.save(tmp_path / "ten.npz")
    energies += run(problem, 11, 40)
    assert energies[-1] > 0.995
    assert max(energies) < 1.0001
    np.testing.assert_allclose(mass @ points["velocity"], momentum, rtol=1e-6)
    again = flight(angle)
    again.load(tmp_path / "ten.npz")
    assert list(run(again, 11, 40)) == energies[10:]


def test_a_term_over_cells_goes_on_when_the_mass_gets_a_ghost_penalty():
    problem = flight(0.3, mpm.Stabilisation("soft", E=4e5, nu=0.2))
    with pytest.warns(SingularMassWarning, match="fewer points than free nodes"):
        energies = list(run(problem, 1, 8))
    assert 0.95 < energies[-1] < 1.0001


def test_a_body_with_fewer_points_than_nodes_falls_freely():
    grid, points = thin_body(0.3)
    V = mpm.Space(grid, "bspline3")
    gravity = fem.Constant(grid, (0.0, -10.0))
    law = mpm.materials.NeoHookean(E=4e5, nu=0.2)
    form = mpm.momentum(law, points, V.increment, V.test)
    form -= ufl.inner(points.density * gravity, V.test) * points.dX
    problem = mpm.Newmark(form, V.increment, points, stabilisation="ghost")
    start = points["x"].copy()
    with pytest.warns(SingularMassWarning):
        list(run(problem, 1, 10))
    fall = np.broadcast_to([0.0, -0.5 * 10.0 * 0.02**2], start.shape)
    np.testing.assert_allclose(points["x"] - start, fall, rtol=1e-9, atol=1e-11)


def test_solutions_have_no_parts_along_null_vectors():
    rng = np.random.default_rng(3)
    root = rng.random((12, 20))
    dense = root.T @ root
    M = PETSc.Mat().createDense((20, 20), array=dense, comm=MPI.COMM_SELF)
    M.convert("aij")
    f = M.createVecRight()
    f.setArray(dense @ rng.random(20))
    null = np.linalg.eigh(dense)[1][:, :8]
    # LAPACK may return any basis of these vectors: take one of them that does not depend on it
    one = null @ (null.T @ rng.random(20))
    found = solution_without_null_vectors(M, f)
    np.testing.assert_allclose(dense @ found, f.getArray(), rtol=1e-8)
    # a force on a null vector changes next to nothing; beside it stands the diagonal of the mass
    g, push = f.copy(), np.diag(dense) * one
    g.setArray(f.getArray() + 0.1 * np.linalg.norm(f.getArray()) * push / np.linalg.norm(push))
    other = solution_without_null_vectors(M, g)
    assert np.linalg.norm(root @ (other - found)) < 1e-3 * np.linalg.norm(root @ found)
    assert np.linalg.norm(other) < 10 * np.linalg.norm(found)


@pytest.mark.parametrize("basis", ["bspline2", "bspline3"])
def test_a_bar_of_one_cell_without_cuts_swings(basis, capfd):
    """Two points over three nodes, in full cells: a ghost penalty adds nothing to the mass."""
    grid = mpm.create_lattice(MPI.COMM_WORLD, [np.linspace(0.0, 10.0, 21), [0.0, 0.5]])
    points = mpm.fill(grid, mpm.Box((0.0, 0.0), (10.0, 0.5)), 2, 1.0)
    V = mpm.Space(grid, basis)
    form = mpm.momentum(mpm.materials.Hencky(1.0, 0.0), points, V.increment, V.test)
    mode = np.sin(np.pi * points["x"][:, 0] / 20.0)
    points.add_field("velocity", (2,), "m/s")
    points["velocity"] = np.column_stack([1e-3 * mode, 0.0 * mode])
    bcs = mpm.fixed(V, "left") + mpm.rollers(V, "top", "bottom")
    problem = mpm.Newmark(form, V.increment, points, bcs)
    # a period of the first mode is 4 · 10 m over 1 m/s

    def swing():
        for t in mpm.times(40.0, dt=0.5):
            problem.step(t)

    with pytest.warns(SingularMassWarning, match="fewer points than free nodes"):
        swing()
    e = problem.energies()
    assert e.kinetic + e.strain == pytest.approx(e.initial, rel=1e-6)
    np.testing.assert_allclose(points["velocity"][:, 0], 1e-3 * mode, atol=1e-5)
    out, err = capfd.readouterr()
    assert "CHOLMOD" not in out + err
