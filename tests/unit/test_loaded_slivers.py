"""Faces that pass a grid line, under F-bar without stabilisation."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI

import dolfinmpm as mpm
from dolfinmpm import errors
from dolfinmpm.materials import Hencky


def pulled(kind="surface", fbar=True, stabilisation="none", pull=2e4):
    """A row of clay under two equal pulls: motions of its end in both steps, and the warnings."""
    grid = mpm.create_lattice(MPI.COMM_WORLD, [np.arange(0, 4.01, 0.25), [0, 0.25, 0.5]])
    points = mpm.fill(grid, mpm.Box((1, 0), (3, 0.5)), 2, 2000.0)
    V = mpm.Space(grid, "gimp")
    load = fem.Constant(grid, (0.0, 0.0))
    F = mpm.momentum(Hencky(1e7, 0.45), points, V.increment, V.test, strain="small", fbar=fbar)
    end = mpm.Surface(points, lambda x: np.isclose(x[0], 3), (1, 0), name="end")
    if kind == "surface":
        F += end.traction(load, V.test)
    else:
        of = mpm.Boundary.from_polygon(points, [(3, 0), (3, 0.5)], closed=False, spacing=0.03)
        F += of.traction(load, V.test)
    bcs = mpm.rollers(V, "bottom", "top") + mpm.prescribed(V, lambda x: np.isclose(x[0], 1), 0)
    problem = mpm.QuasiStatic(F, V.increment, points, bcs, stabilisation=stabilisation)
    moved = [0.0]
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        for k in (1, 2):
            load.value[0] = k * pull
            problem.step()
            moved.append(end.mean_displacement()[0])
    told = [str(w.message) for w in caught if w.category is errors.SoftVolumeWarning]
    return np.diff(moved), told


@pytest.mark.parametrize("stabilisation", ["none", "soft"])
def test_a_loaded_face_that_passes_a_grid_line_is_told(stabilisation):
    moved, told = pulled(stabilisation=stabilisation)
    assert moved[1] > 1.5 * moved[0]  # wrong by far: two equal pulls move the end equally
    assert len(told) == 1
    assert f'stabilisation="{stabilisation}"' in told[0]
    assert "'end'" in told[0]


@pytest.mark.parametrize(
    "options",
    [{"stabilisation": "ghost"}, {"stabilisation": "aggregation"}, {"kind": "boundary"}],
)
def test_what_the_warning_advises_is_right(options):
    moved, told = pulled(**options)
    assert not told
    assert abs(moved[1] / moved[0] - 1) < 5e-3


def test_faces_within_a_cell_and_bodies_without_f_bar_are_not_told():
    assert not pulled(pull=-2e4)[1]
    assert not pulled(fbar=False)[1]


def test_numbers_of_the_user_with_such_names_are_no_surface():
    grid = mpm.create_lattice(MPI.COMM_WORLD, [range(4), range(4)])
    points = mpm.fill(grid, mpm.Box((0, 0), (2, 2)), 2, 2000.0)
    V = mpm.Space(grid, "gimp")
    offset, area = points.add_field("pile_offset", (), "m"), points.add_field("pile_area", (), "m")
    points["pile_area"] = 1.0
    F = mpm.momentum(Hencky(1e7, 0.3), points, V.increment, V.test, fbar=True)
    F += ufl.inner(offset * area * V.increment, V.test) * points.dX
    problem = mpm.QuasiStatic(F, V.increment, points, mpm.fixed(V, "bottom"))
    assert problem.step().halvings == 0
