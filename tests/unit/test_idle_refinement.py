"""Sizes for refined spaces that are not below those of the cells are told."""

from __future__ import annotations

import re
import warnings

import numpy as np
import pytest
import ufl
from mpi4py import MPI

import dolfinmpm as mpm

SOIL = mpm.materials.Tresca(1e7, 0.3, cohesion=1e9)


def told(refine):
    """Messages of a step in cells of 1 m with these sizes."""
    grid = mpm.create_lattice(MPI.COMM_WORLD, [np.arange(5.0), np.arange(5.0)])
    points = mpm.fill(grid, mpm.Box((0, 0), (4, 3)), 2, 1800.0)
    V = mpm.Space(grid, "gimp", refine=refine(points), levels=1)
    F = mpm.momentum(SOIL, points, V.increment, V.test)
    F -= ufl.inner(points.density * ufl.as_vector((0.0, -9.81)), V.test) * points.dX
    problem = mpm.QuasiStatic(F, V.increment, points, mpm.fixed(V, "bottom"))
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        problem.step()
        problem.step()
    return [str(w.message) for w in found if w.category is mpm.errors.IdleConditionWarning]


def near(size):
    ball = mpm.RigidBody(mpm.Ball((2, 2), 0.5), increment=(0, 0))
    return lambda points: mpm.near(ball, size)


@pytest.mark.parametrize(
    ("refine", "least"),
    [
        (near(200.0), "200 m near a body refines nothing.* is 200 m"),
        (near(1.01), "1.01 m near a body"),
        (lambda points: mpm.where_it_yields(points, 50.0), "50 m where plastic_strain"),
        (
            lambda points: lambda x: np.where(x[0] < 2, 25.0, np.inf),
            "a function refines nothing.* is 25 m",
        ),
    ],
)
def test_sizes_that_are_too_large_are_told_once(refine, least):
    found = told(refine)
    assert len(found) == 1
    assert re.search(f"refine = {least}.*Give sizes below 1 m", found[0])


@pytest.mark.parametrize(
    "refine",
    [
        near(0.5),
        # all cells have this size
        near(1.0),
        lambda points: lambda x: np.ones(x.shape[1]),
        lambda points: lambda x: np.where(x[0] < 2, 0.5, np.inf),
        # nothing yields yet, and nothing is wanted yet
        lambda points: mpm.where_it_yields(points, 0.5),
        lambda points: lambda x: np.full(x.shape[1], np.inf),
        # fine cells are wanted above the body
        lambda points: lambda x: np.where(x[1] > 3.5, 0.5, 1.0),
    ],
)
def test_sizes_that_refine_now_or_later_are_not_told(refine):
    assert told(refine) == []
