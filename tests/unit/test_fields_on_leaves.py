"""Several fields on refined spaces, and leaves that have no points of a field."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

import dolfinmpm as mpm

LAW = mpm.materials.Hencky(1e6, 0.3)
REFINED = {"refine": lambda x: np.where(x[0] > 1.01, 0.5, 1.0), "levels": 1}


@pytest.mark.parametrize("basis", ["gimp", "linear", "bspline2"])
def test_a_body_beside_large_leaves_of_another_body_moves_without_stress(basis):
    """Nodes at its small leaves follow those of the large leaf, where only the other body is."""
    grid = mpm.create_lattice(MPI.COMM_SELF, [np.arange(5.0)] * 2)
    A, B = (mpm.Space(grid, basis, tag=tag, **REFINED) for tag in (1, 2))
    points = mpm.fill(grid, mpm.Box((0, 0), (1, 0.5)), 2, 1e3, tag=1, refine=A)
    points = points + mpm.fill(grid, mpm.Box((1, 0.75), (2.5, 2)), 2, 1e3, tag=2, refine=B)
    F = mpm.momentum(LAW, points, A.increment, A.test, tag=1)
    F += mpm.momentum(LAW, points, B.increment, B.test, tag=2)

    def top(x):
        return x[1] > 1.9

    bcs = mpm.fixed(A, "bottom") + mpm.prescribed(B, top, 0, increment=0.01)
    bcs += mpm.prescribed(B, top, 1, increment=0.0)
    problem = mpm.QuasiStatic(
        F, [A.increment, B.increment], points, bcs, stabilisation=["none", "none"]
    )
    problem.step()
    own = points["tag"] == 2
    assert np.abs((points["x"] - points["x0"])[own] - (0.01, 0.0)).max() < 1e-12
    assert np.abs(points["stress"]).max() < 1e-6 * LAW.E * 0.01


@pytest.mark.parametrize("basis", ["gimp", "bspline2"])
def test_linear_pressures_on_the_leaves_of_wider_functions(basis):
    """A drained body has the pressure of its drained side, also where its domains reach far."""
    grid = mpm.create_lattice(MPI.COMM_SELF, [np.arange(5.0)] * 2)
    V, Q = mpm.Space(grid, basis, **REFINED), mpm.Space(grid, "linear", shape=(), **REFINED)
    points = mpm.fill(grid, mpm.Box((1.0, 0.5), (3, 2)), 2, 1e3, refine=V)
    top = mpm.Surface(points, lambda x: np.isclose(x[1], 2), normal=(0, 1))
    F = mpm.poromechanics(
        LAW, points, (V.increment, Q.increment), (V.test, Q.test), porosity=0.4,
        permeability=1e-5, drained=(top, 1e3),
    )  # fmt: skip
    way = [-0.05]

    def increment(x):
        return np.full(x.shape[1], way[0])

    everywhere = {"where": lambda x: x[0] > -9}
    bcs = mpm.prescribed(V, component=0, increment=increment, **everywhere)
    bcs += mpm.prescribed(V, component=1, increment=0.0, **everywhere)
    problem = mpm.Transient(
        F, [V.increment, Q.increment], points, bcs, stabilisation=["ghost", "ghost"]
    )
    for k in range(4):
        way[0] = -0.05 if k < 2 else 0.0
        problem.step(1e6 * (k + 1))
    assert points["pressure"] == pytest.approx(1e3, abs=0.01)


@pytest.mark.parametrize("refined", [False, True])
def test_aggregation_without_a_root_nearby(refined):
    """A few points far from the body keep their nodes."""
    grid = mpm.create_lattice(MPI.COMM_SELF, [np.linspace(0, 16, 17), np.linspace(0, 2, 3)])
    points = mpm.fill(grid, mpm.Box((0, 0), (2, 1)), 2, 1.0)
    points = points + mpm.fill(grid, mpm.Box((12.3, 0), (12.6, 0.3)), 2, 1.0)
    more = {"refine": lambda x: np.ones(x.shape[1]), "levels": 1} if refined else {}
    V = mpm.Space(grid, "gimp", **more)
    F = mpm.momentum(mpm.materials.Hencky(1e3, 0.3), points, V.increment, V.test)
    F -= ufl.inner(points.density * ufl.as_vector((0.0, -1.0)), V.test) * points.dX
    problem = mpm.QuasiStatic(
        F, V.increment, points, mpm.fixed(V, "bottom"), stabilisation="aggregation"
    )
    problem.step()
    far = points["x"][:, 0] > 12
    assert np.all(points["x"][far, 1] < points["x0"][far, 1])


@pytest.mark.parametrize("basis", ["gimp", "bspline2"])
def test_conditions_without_a_node_on_leaves_are_told(basis):
    """Splines have no node on the line within the grid; on leaves no message had told it."""
    grid = mpm.create_lattice(MPI.COMM_SELF, [np.arange(5.0)] * 2)
    V, Q = mpm.Space(grid, basis, **REFINED), mpm.Space(grid, basis, shape=(), **REFINED)
    points = mpm.fill(grid, mpm.Box((0, 1), (4, 2)), 2, 1e3, refine=V)
    F = mpm.momentum(LAW, points, V.increment, V.test)

    def line(x):
        return np.isclose(x[1], 1.0 if basis == "bspline2" else 0.77)

    bcs = mpm.fixed(V, "left") + mpm.prescribed(V, line, 1)
    with pytest.warns(mpm.errors.IdleConditionWarning, match="'line' hold no node"):
        mpm.QuasiStatic(F, V.increment, points, bcs).step()
    F = mpm.poromechanics(
        LAW, points, (V.increment, Q.increment), (V.test, Q.test), porosity=0.4, permeability=1e-5
    )
    bcs = mpm.fixed(V, "left") + mpm.prescribed(Q, line, 0, value=0.0)
    problem = mpm.Transient(F, [V.increment, Q.increment], points, bcs)
    with pytest.raises(mpm.errors.ParameterError, match="pressure at 'line' hold no node"):
        problem.step(1.0)


def test_leaves_of_any_size_give_their_first_guess():
    """Values at the upper sides of leaves above 10 km had been lost, in silence."""
    iterations = []
    for size in (1.0, 2.0**20):
        cells, top = mesh.CellType.quadrilateral, 2 * size
        grid = mesh.create_rectangle(MPI.COMM_WORLD, [(0, 0), (top, top)], (8, 8), cells)
        V = mpm.Space(grid, "gimp", refine=lambda x, a=size: np.where(x[1] < a, a / 8, a), levels=1)
        points = mpm.fill(grid, mpm.Box((0, 0), (1.5 * size, 1.3 * size)), 2, 1.0, refine=V)
        g = fem.Constant(grid, (0.0, 0.0))
        F = mpm.momentum(mpm.materials.Hencky(1.0, 0.3), points, V.increment, V.test)
        F -= ufl.inner(points.density * g, V.test) * points.dX
        bcs = mpm.fixed(V, "bottom")
        problem = mpm.QuasiStatic(F, V.increment, points, bcs, stabilisation="ghost")
        steps = []
        for k in range(3):
            g.value[1] = -0.02 * (k + 1) / size
            steps.append(problem.step().iterations)
        iterations.append(steps)
        basis = problem.activate().fields[0].basis
        rows, _ = basis.values_at(basis.node_coordinates()[:, :2])
        assert rows.size == basis.nodes.size
    assert iterations[0] == iterations[1]


@pytest.mark.parametrize("kind", ["surface", "footing", "plane"])
@pytest.mark.parametrize("basis", ["gimp", "bspline2"])
def test_faces_on_a_line_of_the_grid_are_in_the_smallest_leaves(basis, kind):
    """Rounding of roots, which are larger than leaves, had put such faces beyond all leaves."""
    grid = mpm.create_lattice(MPI.COMM_SELF, [np.arange(0, 2.0), np.arange(0, 4.0)])
    V = mpm.Space(grid, basis, refine=lambda x: np.full(x.shape[1], 0.1251), levels=3)
    points = mpm.fill(grid, mpm.Box((0, 0), (1, 2)), per_cell=2, density=1.0, refine=V)
    u, v, p, E = V.increment, V.test, 1e3, 1e6
    F = mpm.momentum(mpm.materials.Hencky(E, 0.0), points, u, v, strain="small")
    top = mpm.Surface(points, lambda x: x[1] > 2 - 1e-9, normal=(0, 1))
    if kind == "surface":
        F += top.traction(fem.Constant(grid, (0.0, -p)), v)
    elif kind == "footing":
        settlement = fem.Constant(grid, 2 * p / E)
        F += mpm.RigidFooting(top, settlement, E=E, rough=False).contact(u, v)
    else:
        plane = mpm.RigidBody(mpm.Plane((0, 2), (0, -1)), increment=(0.0, -2 * p / E))
        F += mpm.contact(plane, points, u, v, penalty=1e6)
    bcs = mpm.rollers(V, "left", "right", "bottom")
    mpm.QuasiStatic(F, u, points, bcs, stabilisation="ghost").step()
    assert np.abs(points["stress"][:, 1, 1] / p + 1).max() < 1e-4
