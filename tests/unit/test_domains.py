"""How the points' domains follow the body."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

import dolfinmpm as mpm
from dolfinmpm._platform.errors import ParameterError, PointsOutsideGridError
from dolfinmpm.basis.gimp import update_domains

F = np.array([[[4.0, 1.0], [0.0, 0.5]]])
HALF = np.array([[0.1, 0.2]])


def test_rules():
    values, Q = np.linalg.eigh(F[0].T @ F[0])
    U = (Q * np.sqrt(values)) @ Q.T
    assert update_domains(F, HALF) == pytest.approx(HALF * np.diag(U), rel=1e-13)
    assert update_domains(F, HALF, "volume") == pytest.approx(HALF * np.sqrt(2.0), rel=1e-13)
    assert np.array_equal(update_domains(F, HALF, "fixed"), HALF)
    with pytest.raises(ParameterError, match="domains = 'round'"):
        mpm.Space(grid(), "gimp", domains="round")


def grid():
    cells = mesh.CellType.quadrilateral
    return mesh.create_rectangle(MPI.COMM_SELF, [(0, 0), (80, 2)], (80, 2), cells)


def stretched(domains):
    """A strip, stretched to eight times its length by what moves all nodes."""
    background = grid()
    points = mpm.fill(background, mpm.Box((0, 0), (2, 1)), 1, 1.0)
    points["l0"][:] = points["l"][:] = 5.0, 0.5
    V = mpm.Space(background, "gimp", domains=domains)
    F = mpm.momentum(mpm.materials.Hencky(1.0, 0.0), points, V.increment, V.test)
    bcs = mpm.prescribed(V, lambda x: x[0] > -1.0, 0, increment=lambda x: x[0])
    bcs += mpm.prescribed(V, lambda x: x[0] > -1.0, 1)
    problem = mpm.QuasiStatic(F, V.increment, points, bcs)
    for _ in range(4):
        problem.step()
    return points


def test_what_spans_too_many_cells_is_told_the_stabilisation():
    with pytest.raises(PointsOutsideGridError, match="domains='volume' if the body flows"):
        stretched("stretch")
    points = stretched("fixed")
    assert points["F"][0, 0, 0] > 5.0
    assert np.all(points["l"] == points["l0"])


def forces(stress_only, strain, fbar):
    cells = mesh.CellType.quadrilateral
    background = mesh.create_rectangle(MPI.COMM_SELF, [(-1, -1), (6, 5)], (7, 6), cells)
    points = mpm.fill(background, mpm.Box((0, 0), (3, 2.3)), 2, 2000.0)
    V = mpm.Space(background, "gimp")
    u, v = V.increment, V.test
    sand = mpm.materials.MohrCoulomb(1e6, 0.3, 0.0, 22.0)
    gravity = fem.Constant(background, (0.0, -10.0))
    form = mpm.momentum(sand, points, u, v, strain=strain, fbar=fbar)
    form -= ufl.inner(points.density * gravity, v) * points.dX
    bcs = mpm.fixed(V, lambda x: x[1] < 1e-6) + mpm.prescribed(V, lambda x: x[0] < 1e-6, 0)
    problem = mpm.Explicit(form, u, points, bcs, fused=False)
    assert problem._loop._by_stress
    problem._loop._by_stress = stress_only
    problem.step(0.5)
    return points


@pytest.mark.parametrize("fbar", [True, False])
@pytest.mark.parametrize("strain", ["large", "small", "jaumann"])
def test_forces_of_explicit_steps_are_those_of_the_stress(strain, fbar):
    """What the points' stress gives is what the law gives of no increment."""
    one, other = forces(True, strain, fbar), forces(False, strain, fbar)
    assert one["plastic_strain"].max() > 0.01
    assert one["x"] == pytest.approx(other["x"], abs=1e-11)
    largest = np.abs(other["stress"]).max()
    assert one["stress"] == pytest.approx(other["stress"], abs=1e-7 * largest)


def test_explicit_steps_need_no_load():
    """A form without loads is fused too: a block flies as it was thrown."""
    cells = mesh.CellType.quadrilateral
    background = mesh.create_rectangle(MPI.COMM_SELF, [(0, 0), (6, 6)], (6, 6), cells)
    points = mpm.fill(background, mpm.Box((1.3, 1.3), (3, 3)), 2, 1000.0)
    V = mpm.Space(background, "gimp")
    form = mpm.momentum(mpm.materials.Hencky(1e4, 0.3), points, V.increment, V.test)
    problem = mpm.Explicit(form, V.increment, points)
    assert problem.unfused == ""
    points["velocity"] = np.array([1.0, 0.5])
    problem.step(0.7)
    assert points["x"] - points["x0"] == pytest.approx(np.tile([0.7, 0.35], (len(points), 1)))


def test_a_consistent_mass_is_solved_where_nodes_have_next_to_none():
    """The first guess of conjugate gradients is not p/m where m is a billionth of the others."""
    cells = mesh.CellType.quadrilateral
    background = mesh.create_rectangle(MPI.COMM_SELF, [(0, 0), (8, 8)], (8, 8), cells)
    low = 2 + 1e-6
    points = mpm.fill(background, mpm.Box((low, low), (low + 3,) * 2), 3, 1e3, aligned="body")
    V = mpm.Space(background, "bspline2")
    form = mpm.momentum(mpm.materials.Hencky(1e4, 0.3), points, V.increment, V.test)
    problem = mpm.Explicit(form, V.increment, points, mass="consistent", mapping="pic")
    points["velocity"] = 0.03 * np.sin(np.pi * (points["x"] - low - 1.5) / 3)
    first = problem.energies().kinetic
    problem.step(20.0)
    energies = problem.energies()
    assert 0.5 < (energies.kinetic + energies.strain) / first < 1.2
