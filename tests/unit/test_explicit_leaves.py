"""Explicit steps on refined spaces: what goes by the size of cells goes by that of the leaves."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from mpi4py import MPI

import dolfinmpm as mpm
from dolfinmpm.cut.essentialconditions import renumbered

LAW = mpm.materials.Hencky(E=1000.0, nu=0.3)


def block(levels, term="", basis="gimp", **options):
    """A block that falls onto the bottom, in cells of a quarter: leaves, or a grid of such cells.

    Its right side cuts cells.
    """
    lines = np.linspace(0, 3, 3 * 2 ** (2 - levels) + 1)
    grid = mpm.create_lattice(MPI.COMM_SELF, [lines, lines])
    refined = {"refine": lambda x: np.full(x.shape[1], 0.25), "levels": levels} if levels else {}
    V = mpm.Space(grid, basis, **refined)
    box = mpm.Box((0.0, 0.0), (1.9, 1.25))
    points = mpm.fill(grid, box, 2, 1.0, **({"refine": V} if levels else {}))
    u, v = V.increment, V.test
    F = mpm.momentum(LAW, points, u, v)
    F -= ufl.inner(points.density * ufl.as_vector((1.0, -10.0)), v) * points.dX
    side = [(1.9, 0.0), (1.9, 1.25)]
    if term == "wall":
        line = mpm.Boundary.from_polygon(
            points, side, closed=False, follows=False, rule=1, spacing=0.125
        )
        F += mpm.signorini(line, u, v, law=LAW)
    elif term in ("penalty", "nitsche"):
        line = mpm.Boundary.from_polygon(points, side, closed=False, rule=1, spacing=0.125)
        F += mpm.dirichlet(line, u, v, law=LAW, method=term, direction="normal")
    bcs = mpm.rollers(V, "left", "bottom")
    if term == "friction":
        bcs = mpm.frictional(V, "bottom", "left", friction=0.3)
    problem = mpm.Explicit(F, u, points, bcs, fused=False, **options)
    points["velocity"] = (0.0, -1.0)
    return problem


def state(problem, steps=20, dt=1e-3):
    """Positions, velocities and stresses after some steps, in the order of positions at first."""
    for k in range(steps):
        problem.step((k + 1) * dt)
    points = problem.points
    x = points["x0"]
    order = np.lexsort(np.round(x.T, 9))
    return [points[name][order] for name in ("x", "velocity", "stress")]


@pytest.mark.parametrize(
    ("term", "basis"), [("", "gimp"), ("wall", "gimp"), ("penalty", "gimp"), ("wall", "bspline2"),
     ("friction", "gimp"), ("friction", "bspline2")],
)  # fmt: skip
def test_leaves_of_one_size_are_a_finer_grid(term, basis):
    """Bulk viscosity, and traces that weigh light nodes, as on a grid of such cells."""
    options = {"bulk_viscosity": (0.06, 1.2)}
    fine, leaves = (state(block(levels, term, basis, **options)) for levels in (0, 2))
    for a, b in zip(fine, leaves):
        assert np.abs(a - b).max() < 1e-10 * np.abs(a).max()


@pytest.mark.parametrize("name", ["mass_cutoff", "redistribution"])
def test_filters_of_light_nodes_are_refused(name):
    with pytest.raises(mpm.errors.ParameterError, match="small leaves"):
        block(2, **{name: 0.01})
    block(0, **{name: 0.01})


def test_collisions_at_the_nodes_are_refused():
    with pytest.raises(mpm.errors.ParameterError, match="contact_between"):
        block(2, mapping="flip", collision=mpm.Collision((1, 2)))


def test_a_block_slides_on_a_frictional_side_with_leaves_that_move():
    """The normal force is the weight, so that friction slows the block by μ g."""
    place = [0.3]
    grid = mpm.create_lattice(MPI.COMM_SELF, [np.arange(5.0)] * 2)
    V = mpm.Space(
        grid, "gimp", refine=lambda x: np.where(np.abs(x[0] - place[0]) < 0.4, 0.25, 1.0), levels=2
    )
    points = mpm.fill(grid, mpm.Box((0.5, 0.0), (2.0, 1.0)), 2, 1e3, refine=V)
    F = mpm.momentum(mpm.materials.Hencky(1e5, 0.0), points, V.increment, V.test)
    F -= ufl.inner(points.density * ufl.as_vector((0.0, -9.81)), V.test) * points.dX
    sides = mpm.frictional(V, "bottom", friction=0.3)
    problem = mpm.Explicit(F, V.increment, points, sides)
    points["velocity"] = (2.0, 0.0)
    for k in range(15):
        place[0] += 0.1
        problem.step(0.02 * (k + 1))
    # the block sways on its elastic lower edge, and pushes more or less than its weight
    assert problem.momentum()[0] / 1.5e3 == pytest.approx(2.0 - 0.3 * 9.81 * 0.3, rel=0.15)
    assert points["x"][:, 1].min() > 0.0


def test_nodes_of_the_grid_are_not_taken_for_those_of_leaves():
    problem = block(2)
    leaves = problem.activate().fields[0].basis
    base = problem.fields[0].space.basis
    with pytest.raises(mpm.errors.UnsupportedGridError, match="by their positions"):
        renumbered(np.ones(base.nodes.size), base, leaves)
