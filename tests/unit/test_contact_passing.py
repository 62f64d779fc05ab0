"""Rigid bodies and points do not pass through each other in silence, however far a step goes."""

from __future__ import annotations

import meshio
import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

import dolfinmpm as mpm
from dolfinmpm._platform.errors import (
    ConvergenceError,
    InstabilityError,
    ParameterError,
    SmallBodyWarning,
)
from dolfinmpm.contact.shapesurface import surface_of
from dolfinmpm.contact.tunnelling import entered, half_thickness, passes

STEPS_IN_TIME = mpm.Newmark, mpm.GeneralisedAlpha
# all begin a little above a block whose top is at y = 0.8; its cells are of 0.1 m
SHAPES = {
    "disc": lambda: mpm.Disc((1.0, 0.96), 0.15),
    "small disc": lambda: mpm.Disc((1.0125, 0.83), 0.02),
    "blade": lambda: mpm.Box((0.8, 0.81), (1.2, 0.815)),
}
TOO_FAR = "moves .* at once, more than"
PASSED = "points that touch 'tool' (are .* deep in it|get through it)|moves .* at once"


class Block:
    """A block that stands on a held base, and a tool above it."""

    def __init__(self, kind, shape, motion=None, **options):
        self.grid = mesh.create_rectangle(
            MPI.COMM_WORLD, [(0, 0), (2, 2)], (20, 20), mesh.CellType.quadrilateral
        )
        self.points = mpm.fill(self.grid, mpm.Box((0.7, 0.5), (1.3, 0.8)), 2, 1000.0)
        V = mpm.Space(self.grid, "gimp")
        u, v = V.increment, V.test
        of_tool = {"mass", "inertia", "gravity", "displacement"} & set(options)
        rate = "increment" if kind is mpm.QuasiStatic else "velocity"
        tool = {k: options.pop(k) for k in of_tool} | {rate: motion}
        self.tool = mpm.RigidBody(SHAPES[shape](), name="tool", **tool)
        touching = {k: options.pop(k) for k in {"penalty"} & set(options)}
        F = mpm.momentum(mpm.materials.Hencky(1e5, 0.3), self.points, u, v)
        F += mpm.contact(self.tool, self.points, u, v, **touching)
        bcs = [
            c for k in (0, 1) for c in mpm.prescribed(V, lambda x: x[1] < 0.51, k, increment=0.0)
        ]
        self.problem = kind(F, u, self.points, bcs, **options)


@pytest.mark.parametrize("kind", [mpm.QuasiStatic, mpm.Transient])
def test_a_body_that_steps_over_a_block_is_told(kind):
    """Eight cells in a step."""
    block = Block(kind, "blade", (0.0, -0.8))
    with pytest.raises(ConvergenceError, match=f"{PASSED}|the reason is"):
        block.problem.step(*([] if kind is mpm.QuasiStatic else [1.0]))
    assert block.tool.position[1] > 0.7


def test_a_body_that_passes_between_corners_is_told():
    """A disc that is smaller than a domain may get through the block."""
    block = Block(mpm.QuasiStatic, "small disc", (0.0, -0.01))
    with pytest.warns(SmallBodyWarning, match="'tool' is 0.04 m wide, and .* are 0.05 m wide"):
        block.problem.step()


@pytest.mark.filterwarnings("ignore::dolfinmpm._platform.errors.SmallBodyWarning")
@pytest.mark.parametrize("shape", list(SHAPES))
@pytest.mark.parametrize("kind", STEPS_IN_TIME)
def test_a_body_that_is_fast_is_told(kind, shape):
    """150 m/s, at which the penalty is too soft to stop anything."""
    block = Block(kind, shape, (0.0, -150.0))
    with pytest.raises(ConvergenceError, match=PASSED):
        block.problem.step(5e-3)


@pytest.mark.parametrize("shape", ["disc", "blade"])
@pytest.mark.parametrize("kind", STEPS_IN_TIME)
def test_a_free_body_does_not_pass_a_block_in_a_step(kind, shape):
    block = Block(kind, shape, (0.0, -80.0), mass=4000.0, inertia=10.0, gravity=(0, -10))
    with pytest.raises(ConvergenceError):
        block.problem.step(1e-2)
    assert block.tool.position[1] > 0.7


@pytest.mark.parametrize("prescribed", ["function", "constant"])
def test_displacements_do_not_pass_a_block(prescribed):
    block = Block(mpm.QuasiStatic, "blade", displacement=lambda t: (0.0, -0.8 * t))
    if prescribed == "constant":
        place = fem.Constant(block.grid, (0.0, 0.0))
        block = Block(mpm.QuasiStatic, "blade", displacement=place)
        place.value[1] = -0.8
    with pytest.raises(ConvergenceError, match=PASSED):
        block.problem.step()


@pytest.mark.parametrize("fused", [True, False])
@pytest.mark.parametrize("free", [True, False])
def test_explicit_steps_tell_of_bodies_that_are_too_fast(free, fused):
    mass = {"mass": 4000.0, "inertia": 10.0} if free else {}
    block = Block(mpm.Explicit, "blade", (0.0, -80.0), fused=fused, **mass)
    kind = InstabilityError if free else ParameterError
    with pytest.raises(kind, match=f"{TOO_FAR} half its mean thickness .* courant"):
        block.problem.step(1e-2)


@pytest.mark.filterwarnings("ignore:penalty = 0.0001 is")
@pytest.mark.parametrize("fused", [True, False])
def test_explicit_steps_tell_of_bodies_that_get_through_what_is_soft(fused):
    """In steps that are short enough, against a penalty that stops nothing."""
    block = Block(mpm.Explicit, "blade", (0.0, -0.3), fused=fused, penalty=1e-4)
    with pytest.raises(InstabilityError, match="points that touch 'tool'"):
        block.problem.step(0.05)
    # it came to the block, and is where the state is that is kept
    assert block.tool.position[1] == pytest.approx(0.8125 - 0.3 * block.problem.time, abs=1e-9)


def test_an_arc_length_tells_of_a_body_that_steps_over_a_block():
    grid = mesh.create_rectangle(
        MPI.COMM_WORLD, [(0, 0), (2, 2)], (20, 20), mesh.CellType.quadrilateral
    )
    points = mpm.fill(grid, mpm.Box((0.7, 0.5), (1.3, 0.8)), 2, 1000.0)
    V = mpm.Space(grid, "gimp")
    u, v = V.increment, V.test
    load = fem.Constant(grid, (0.0, -10.0))
    tool = mpm.RigidBody(SHAPES["blade"](), increment=(0.0, -0.8), name="tool")
    F = mpm.momentum(mpm.materials.Hencky(1e5, 0.3), points, u, v)
    F += mpm.contact(tool, points, u, v) - ufl.inner(load, v) * points.dX
    bcs = [c for k in (0, 1) for c in mpm.prescribed(V, lambda x: x[1] < 0.51, k, increment=0.0)]
    problem = mpm.ArcLength(F, u, points, bcs, load=load, length=1e-4)
    with pytest.raises(ConvergenceError, match=TOO_FAR):
        problem.step()


@pytest.mark.parametrize("kind", STEPS_IN_TIME)
def test_points_that_fly_do_not_pass_a_body_at_rest(kind):
    """A block flies through a blade in one step."""
    grid = mesh.create_rectangle(
        MPI.COMM_WORLD, [(0, 0), (2, 2)], (20, 20), mesh.CellType.quadrilateral
    )
    points = mpm.fill(grid, mpm.Box((0.8, 1.4), (1.2, 1.7)), 2, 1000.0)
    V = mpm.Space(grid, "gimp")
    tool = mpm.RigidBody(mpm.Box((0.5, 1.0), (1.5, 1.005)), name="tool")
    F = mpm.momentum(mpm.materials.Hencky(1e5, 0.3), points, V.increment, V.test)
    F += mpm.contact(tool, points, V.increment, V.test)
    problem = kind(F, V.increment, points)
    points["velocity"][:] = 0.0, -80.0
    with pytest.raises(ConvergenceError, match=r"rigid body from further away|points that touch"):
        problem.step(1e-2)


def test_a_step_of_two_cells_is_what_parts_of_it_are():
    """A long step, which is divided as the body's thickness asks for, and four short ones."""
    forces = []
    for steps in (1, 4):
        block = Block(mpm.QuasiStatic, "disc", (0.0, -0.2 / steps))
        for _ in range(steps):
            block.problem.step()
        forces.append(block.tool.force[1])
    assert forces[0] == pytest.approx(forces[1], rel=1e-6)
    assert forces[1] > 1e3


@pytest.mark.parametrize("kind", [mpm.Newmark, mpm.GeneralisedAlpha])
def test_a_constant_moves_a_body_as_a_function_does(kind):
    """Forces balance within the step, and the body is at its place at the end of the step."""
    found = []
    by_function = Block(kind, "disc", displacement=lambda t: (0.0, -5.0 * t))
    place = fem.Constant(by_function.grid, (0.0, 0.0))
    for block in (by_function, Block(kind, "disc", displacement=place)):
        first = block.tool.position[1]
        for k in range(1, 6):
            place.value[1] = -0.05 * k
            block.problem.step(0.01 * k)
            assert block.tool.position[1] == pytest.approx(first - 0.05 * k, abs=1e-12)
        found.append(block.points["x"])
    assert np.abs(found[0] - block.points["x0"]).max() > 1e-3
    assert np.abs(found[0] - found[1]).max() < 1e-9


def test_half_of_a_thickness():
    cube = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    facets = surface_of(mpm.Box((0, 0, 0), (1, 1, 1)), 0.0).facets
    for shape, fillet, half in (
        (mpm.Disc((3, 1), 2.0), 0.0, 1.0),
        (mpm.Ball((3, 1, 2), 3.0), 0.0, 1.0),
        (mpm.Box((3, 1), (103, 1.1)), 0.0, 0.05),
        (mpm.Box((3, 1), (103, 1.1)), 0.02, 0.05),
        (mpm.Box((3, 1, 2), (1003, 1001, 2.1)), 0.0, 0.05),
        (mpm.Cone((0, 0, 0), 0.1, np.degrees(0.5), 1000.0), 0.0, 0.1),
        (mpm.Plane((0, 0), (0, 1)), 0.0, np.inf),
        (meshio.Mesh(3 * cube + 7, [("triangle", facets)]), 0.0, 0.5),
    ):
        assert half_thickness(surface_of(shape, fillet)) == pytest.approx(half, rel=2e-3)


def test_paths_through_bodies_are_told_from_paths_beside_and_along_them():
    blade = surface_of(mpm.Box((0, 0), (1, 0.01)), 0.0)
    half = half_thickness(blade)
    through = np.array([[0.5, 0.3]]), np.array([[0.5, -5.0]])
    along = np.array([[0.1, 0.0101]]), np.array([[0.9, 0.0095]])
    beside = np.array([[1.01, 0.3]]), np.array([[1.01, -0.3]])
    around = np.array([[0.99, 0.0102]]), np.array([[1.0005, 0.004]])
    for path, passing in ((through, True), (along, False), (beside, False), (around, False)):
        gap = blade.probe(path[1])[0]
        assert (passes(blade, half, *path, gap) is not None) == passing
    assert [bool(entered(blade, half, *path)[0]) for path in (through, beside)] == [True, False]
    # from face to face of a turned box or of a triangle, by however small a step
    for corners in ([(-1, -3), (3, -1), (1, 3), (-3, 1)], [(-2, 0), (2, 0), (0, 12**0.5)]):
        solid = surface_of(mpm.Polygon(np.array(corners, float) * np.sqrt(3)), 0.0)
        half, (tip, left, right) = half_thickness(solid), solid.x[[0, -1, 1]]
        middle = (left - tip) / np.linalg.norm(left - tip) + (right - tip) / np.linalg.norm(
            right - tip
        )
        aside = 1e-6 * (right - left)
        for reach in (0.3, 0.6):
            at = tip + reach * half * middle
            path = (at + aside)[None], (at - aside)[None]
            assert solid.probe(path[0])[1] @ solid.probe(path[1])[1].T < 1e-9
            assert passes(solid, half, *path, solid.probe(path[1])[0]) is None
    # around a tip corners come to the other side without harm
    wedge = surface_of(mpm.Wedge((0, 0), np.degrees(0.3), 1.0), 0.0)
    path = np.array([[-0.001, 0.01]]), np.array([[0.001, 0.01]])
    assert passes(wedge, half_thickness(wedge), *path, wedge.probe(path[1])[0]) is None
