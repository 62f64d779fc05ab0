"""A problem, turned or mirrored, has the same solution, turned or mirrored."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from dolfinx import mesh
from mpi4py import MPI

import dolfinmpm as mpm

TURNED = np.array([[0.0, -1.0], [1.0, 0.0]])
MIRRORED = np.diag([-1.0, 1.0])


CORNERS = [(0.0, 0.0), (1.62, 0.0), (1.62, 0.87), (0.87, 0.87), (0.87, 1.37), (0.0, 1.37)]


def turned_shape(Q):
    """A block with a step; its corners stay anticlockwise."""
    return mpm.Polygon([tuple(Q @ corner) for corner in CORNERS[:: round(np.linalg.det(Q))]])


def turned_lines(Q, size):
    low, high = np.sort(Q @ np.array([[0.0, 2.0], [0.0, 2.0]]), axis=1).T
    return [np.arange(a, b + size / 2, size) for a, b in zip(low, high)]


def stairs(Q, kind=mpm.QuasiStatic, basis="gimp", leaves=False, cells="squares", **options):
    """A block with a step, under a body force at an angle: displacements and stresses of points.

    Cells in the corners of the block have two equally near cells that are filled well.
    """
    lines = turned_lines(Q, 0.5 if leaves else 0.25)
    if cells == "squares":
        grid = mpm.create_lattice(MPI.COMM_WORLD, lines)
    else:
        grid = mesh.create_rectangle(
            MPI.COMM_WORLD, np.transpose(lines)[[0, -1]], (8, 8), mesh.CellType.quadrilateral
        )
        # a corner far from the block: the grid is no lattice, and has the same equal cells
        x = grid.geometry.x[:, :2]
        x[np.argmin(np.linalg.norm(x - Q @ (1.75, 1.75), axis=1))] += Q @ (0.03, 0.05)
    fine = {"refine": lambda x: np.full(x.shape[1], 0.25), "levels": 1} if leaves else {}
    V = mpm.Space(grid, basis, **fine)
    points = mpm.fill(grid, turned_shape(Q), 2, 1000.0, refine=V if leaves else None)
    u, v = V.increment, V.test
    force = Q @ (3.0, -10.0)
    F = mpm.momentum(mpm.materials.Hencky(1e5, 0.3), points, u, v)
    F -= ufl.inner(points.density * ufl.as_vector(tuple(force)), v) * points.dX
    held = mpm.fixed(V, lambda x: np.abs((Q.T @ x[:2])[1]) < 1e-9)
    problem = kind(F, u, points, held, **options)
    for k in range(2):
        problem.step(*(() if kind is mpm.QuasiStatic else (0.02 * (k + 1),)))
    order = np.lexsort(np.round(points["x0"] @ Q, 6).T)
    stress = np.einsum("ji,njk,kl->nil", Q, points["stress"][:, :2, :2], Q)
    return ((points["x"] - points["x0"]) @ Q)[order], stress[order]


@pytest.mark.parametrize("Q", [TURNED, MIRRORED], ids=["turned", "mirrored"])
@pytest.mark.parametrize(
    "options",
    [
        {"stabilisation": "ghost"},
        {"stabilisation": "ghost", "basis": "bspline2"},
        {"stabilisation": "ghost", "leaves": True},
        {"stabilisation": "ghost", "basis": "linear", "cells": "any"},
    ],
    ids=str,
)
def test_a_turned_problem_is_the_same(options, Q):
    for found, expected in zip(stairs(Q, **options), stairs(np.eye(2), **options)):
        np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(expected).max())


def pressures(Q, leaves=False):
    """Pore pressures of the block after a first step, in cells of 0.25 m."""
    fine = {"refine": lambda x: np.full(x.shape[1], 0.25), "levels": 1} if leaves else {}
    grid = mpm.create_lattice(MPI.COMM_WORLD, turned_lines(Q, 0.5 if leaves else 0.25))
    V, S = mpm.Space(grid, "gimp", **fine), mpm.Space(grid, "gimp", shape=(), **fine)
    points = mpm.fill(grid, turned_shape(Q), 2, 1000.0, refine=V if leaves else None)
    fields, tests = (V.increment, S.increment), (V.test, S.test)
    F = mpm.poromechanics(
        mpm.materials.Hencky(1e5, 0.3), points, fields, tests, porosity=0.4, permeability=1e-6,
        fluid=mpm.Fluid(density=1000.0, gravity=9.81),
    )  # fmt: skip
    force = tuple(Q @ (3.0, -10.0))
    F -= ufl.inner(points.density * ufl.as_vector(force), V.test) * points.dX
    held = mpm.fixed(V, lambda x: np.abs((Q.T @ x[:2])[1]) < 1e-9)
    mpm.Transient(F, fields, points, held, stabilisation=["ghost"] * 2).step(0.1)
    return points["pressure"][np.lexsort(np.round(points["x0"] @ Q, 6).T)]


def test_pressures_of_a_turned_body_and_of_leaves():
    expected = pressures(np.eye(2))
    for found in (
        pressures(TURNED),
        pressures(MIRRORED),
        pressures(np.eye(2), leaves=True),
    ):
        np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(expected).max())
