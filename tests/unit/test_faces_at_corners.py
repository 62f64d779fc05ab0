"""Faces of points at right angles, where both faces have as many markers."""

import numpy as np
from mpi4py import MPI

import dolfinmpm as mpm
from dolfinmpm.body.facesofboundary import faces_of


def test_faces_do_not_depend_on_the_order_of_markers():
    """Ranks give markers in other orders; corners had the face of the first marker."""
    grid = mpm.create_lattice(MPI.COMM_SELF, [np.arange(0, 1.1, 0.25)] * 2)
    points = mpm.fill(grid, mpm.Box((0.25, 0.25), (0.75, 0.75)), per_cell=2, density=1.0)
    corners = [(0.25, 0.25), (0.75, 0.25), (0.75, 0.75), (0.25, 0.75)]
    made = mpm.Boundary.from_polygon(points, corners)
    x, area = made.markers["x"].copy(), made.markers["area"].copy()
    backward = mpm.Boundary(points, x[::-1], area[::-1])
    for ours, theirs in zip(faces_of(made), faces_of(backward)):
        np.testing.assert_array_equal(ours, theirs)
