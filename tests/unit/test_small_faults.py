"""Grids that points cannot lie in, copies of objects, points taken away in every step."""

from __future__ import annotations

import copy
import pickle

import basix.ufl
import numpy as np
import pytest
from dolfinx import fem, mesh
from mpi4py import MPI

import dolfinmpm as mpm

LAW = mpm.materials.Hencky(1e6, 0.3)
PYRAMID = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [0.5, 0.5, 1]]


def block(tag=None):
    """A block, with the second tag in its right half: points, space."""
    grid = mpm.create_lattice(MPI.COMM_WORLD, [range(5), range(4)])
    points = mpm.fill(grid, mpm.Box((0, 0), (4, 2)), per_cell=2, density=2000.0)
    if tag is not None:
        points["tag"] = np.where(points["x"][:, 0] > 2, tag, 0)
    return points, mpm.Space(grid, "gimp")


def prisms():
    return mesh.create_unit_cube(MPI.COMM_WORLD, 1, 1, 1, mesh.CellType.prism)


def pyramid():
    element = basix.ufl.element("Lagrange", "pyramid", 1, shape=(3,))
    cells = np.array([[0, 1, 2, 3, 4]] if MPI.COMM_WORLD.rank == 0 else [], np.int64).reshape(-1, 5)
    return mesh.create_mesh(MPI.COMM_WORLD, cells, np.array(PYRAMID, float), element)


@pytest.mark.parametrize("made", [prisms, pyramid])
def test_grids_of_prisms_and_pyramids_are_refused(made):
    """`fill` had ended in a ValueError about arrays, and spaces had been made."""
    grid, place = made(), np.full((1, 3), 0.4)
    for call in (
        lambda: mpm.fill(grid, mpm.Box((0, 0, 0), (1, 1, 1)), 2, 1.0),
        lambda: mpm.Space(grid),
        lambda: mpm.MaterialPoints.from_arrays(grid, place, [0.1], 1.0),
        lambda: mpm.cell_size(grid),
    ):
        with pytest.raises(mpm.errors.UnsupportedGridError, match=r"of kind p.* or hexahedra"):
            call()


def test_errors_are_imported_by_name():
    from dolfinmpm.errors import ConvergenceError

    assert ConvergenceError is mpm.errors.ConvergenceError


@pytest.mark.parametrize("tags", [None, (0, 1)])
def test_nitsche_refuses_a_boundary_between_tags_that_move_together(tags):
    """Of a body with tags nothing had been looked at."""
    points, V = block(tag=1)
    u, v = V.increment, V.test
    face = mpm.Boundary.from_polygon(points, [(2, 0), (2, 2)], closed=False)
    F = mpm.momentum(LAW, points, u, v, tag=tags)
    F += mpm.dirichlet(face, u, v, law=LAW, direction="normal", tag=0)
    with pytest.raises(mpm.errors.ParameterError, match=r"100 % of .*run through the body"):
        mpm.QuasiStatic(F, u, points, mpm.fixed(V, "left"), stabilisation="ghost")


def test_nitsche_takes_a_boundary_between_bodies_with_fields_of_their_own():
    points, _ = block(tag=1)
    one, other = (mpm.Space(points.grid, "gimp", tag=tag) for tag in (0, 1))
    face = mpm.Boundary.from_polygon(points, [(2, 0), (2, 2)], closed=False)
    F = mpm.dirichlet(face, one.increment, one.test, (0.01, 0.0), law=LAW, tag=0)
    for tag, V in enumerate((one, other)):
        F += mpm.momentum(LAW, points, V.increment, V.test, tag=tag)
    bcs = [*mpm.fixed(one, "left"), *mpm.fixed(other, "right")]
    fields = [one.increment, other.increment]
    mpm.QuasiStatic(F, fields, points, bcs, stabilisation="ghost").step()
    assert float(np.abs(points["x"] - points["x0"])[points["tag"] == 1].max()) < 1e-12
    assert face.force()[0] > 1e3


def test_a_tag_apart_from_the_boundary_does_not_hide_it():
    points, V = block()
    points["tag"] = np.where(points["x"][:, 0] > 3, 1, 0)
    face = mpm.Boundary.from_polygon(points, [(1, 0), (1, 2)], closed=False)
    F = mpm.momentum(LAW, points, V.increment, V.test)
    F += mpm.dirichlet(face, V.increment, V.test, law=LAW, direction="normal")
    with pytest.raises(mpm.errors.ParameterError, match="run through the body"):
        mpm.QuasiStatic(F, V.increment, points, mpm.fixed(V, "left"), stabilisation="ghost")


def test_objects_that_cannot_be_copied_say_so():
    """A copy of a boundary had shared its markers, and `pickle` had named a lambda."""
    points, _ = block()
    face = mpm.Boundary.from_polygon(points, [(4, 0), (4, 2)], closed=False)
    surface = mpm.Surface(points, lambda x: x[1] > 1.9, (0, 1))
    for one in (points, face, surface):
        for copied in (copy.copy, copy.deepcopy, pickle.dumps):
            with pytest.raises(mpm.errors.ParameterError, match="cannot be copied or pickled"):
                copied(one)
    way = fem.Constant(points.grid, (0.0, 0.0))
    moved = mpm.RigidBody(mpm.Disc((2, 2.5), 0.5), displacement=way)
    for copied in (copy.deepcopy, pickle.dumps):
        with pytest.raises(mpm.errors.ParameterError, match="a RigidBody with a dolfinx"):
            copied(moved)
    for shape in (mpm.Box((0, 0), (1, 2)), mpm.Disc((0, 0), 1.0), mpm.Plane((0, 0), (0, 1))):
        with pytest.raises(mpm.errors.ParameterError, match=r"a function of positions"):
            pickle.dumps(shape)
        places = np.array([[0.2, 0.3], [3.0, 0.5]])
        inside = shape.contains(places)
        for copied in (copy.copy(shape), copy.deepcopy(shape)):
            assert type(copied) is type(shape)
            np.testing.assert_array_equal(copied.contains(places), inside)
            copied.volume = 7.0
            assert shape.volume != 7.0


def test_points_that_were_removed_are_kept_until_the_next_step_only():
    """Positions of all points ever removed had been kept."""
    points, V = block()
    faces = [
        mpm.Boundary.from_polygon(points, [(4, 0), (4, 2)], closed=False, follows=follows)
        for follows in (True, False)
    ]
    F = mpm.momentum(LAW, points, V.increment, V.test)
    for face in faces:
        F += mpm.dirichlet(face, V.increment, V.test, law=LAW, direction="normal", method="penalty")
    problem = mpm.QuasiStatic(F, V.increment, points, mpm.fixed(V, "bottom"))
    for left in (0.5, 1.0):
        points.remove(points["x"][:, 0] < left)
        assert [len(face.removed) for face in faces] == [1, 0]
        problem.step()
        assert [len(face.removed) for face in faces] == [0, 0]
    assert not hasattr(points, "removals")
