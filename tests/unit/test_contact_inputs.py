"""Rigid bodies and contacts that cannot be: a named error, or a right answer."""

from __future__ import annotations

import gc

import meshio
import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

import dolfinmpm as mpm
from dolfinmpm._platform.errors import ConvergenceError, FormError, OverlapWarning, ParameterError
from dolfinmpm.contact.shapesurface import surface_of

CUBE = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
FACES = surface_of(mpm.Box((0, 0, 0), (1, 1, 1)), 0.0).facets


def stl(path, facets, x=CUBE):
    meshio.write(path, meshio.Mesh(x, [("triangle", facets)]), file_format="stl")
    return str(path)


def test_a_surface_mesh_is_read_as_it_was_written(tmp_path):
    body = mpm.RigidBody(stl(tmp_path / "cube.stl", FACES))
    x = np.random.default_rng(0).uniform(-0.5, 1.5, (500, 3))
    box = surface_of(mpm.Box((0, 0, 0), (1, 1, 1)), 0.0)
    np.testing.assert_allclose(body.surface.probe(x)[0], box.probe(x)[0], atol=1e-7)
    np.testing.assert_allclose(body.position, 0.5, atol=1e-7)
    # Gmsh's own format, with corners that facets share
    meshio.write(tmp_path / "cube.msh", meshio.Mesh(CUBE, [("triangle", FACES)]), "gmsh")
    again = mpm.RigidBody(tmp_path / "cube.msh")
    np.testing.assert_allclose(again.surface.probe(x)[0], box.probe(x)[0], atol=1e-12)


def test_a_ring_of_lines_is_a_body_in_2d(tmp_path):
    at = 2 * np.pi * np.arange(64) / 64
    x = np.column_stack([np.cos(at), np.sin(at), 0 * at])
    ring = np.column_stack([np.arange(64), np.roll(np.arange(64), -1)])
    body = mpm.RigidBody(meshio.Mesh(x, [("line", ring)]))
    assert body.surface.probe(np.array([[0.0, 0.5], [2.0, 0.0]]))[0] == pytest.approx(
        [-0.5, 1.0], abs=2e-3
    )
    with pytest.raises(ParameterError, match="inside out"):
        mpm.RigidBody(meshio.Mesh(x, [("line", ring[:, ::-1])]))
    with pytest.raises(ParameterError, match="is open: 2 corners"):
        mpm.RigidBody(meshio.Mesh(x, [("line", ring[1:])]))


def test_broken_meshes_are_refused(tmp_path):
    path = tmp_path / "cube.stl"
    turned = FACES.copy()
    turned[3] = turned[3, ::-1]
    flat = np.vstack([FACES, [[0, 1, 0]]])
    for facets, words in (
        (FACES[1:], "is open: 3 edges at the rim of a hole have one facet only"),
        (FACES[:, ::-1], "inside out"),
        (turned, "normals disagree"),
        (np.vstack([FACES, FACES[:1]]), "meets itself"),
    ):
        with pytest.raises(ParameterError, match=words):
            mpm.RigidBody(stl(path, facets))
    with pytest.raises(ParameterError, match=r"have no area, such as facet \d+ at \["):
        mpm.RigidBody(meshio.Mesh(CUBE, [("triangle", flat)]))
    with pytest.raises(ParameterError, match="must be finite"):
        mpm.RigidBody(meshio.Mesh(CUBE * [np.nan, 1, 1], [("triangle", FACES)]))
    with pytest.raises(ParameterError, match="has triangles"):
        mpm.RigidBody(meshio.Mesh(CUBE, [("tetra", np.array([[0, 1, 2, 4]]))]))
    with pytest.raises(OSError, match="no file"):
        mpm.RigidBody(str(tmp_path / "missing.stl"))
    half = "$MeshFormat\n4.1 0 8\n$EndMeshFormat\n$Nodes\n1 2 3\n"
    for name, text in (("a.stl", "no mesh\n"), ("a.msh", "no mesh\n"), ("b.msh", half)):
        (tmp_path / name).write_text(text)
        with pytest.raises(OSError, match=rf"cannot read .*{name}, which is broken, or of another"):
            mpm.RigidBody(tmp_path / name)


@pytest.mark.parametrize(
    ("low", "size", "out", "words"),
    [
        (5.0, 0.9, False, r"inside out in one part: the normals of the part at \[5. 5. 5.\] m"),
        (0.25, 0.5, True, "has a part within another"),
        (0.5, 1.0, True, "crosses itself"),
        (0.5, 0.9, False, "crosses itself"),
        (5.0, 1.0, True, None),
        (0.25, 0.5, False, None),
    ],
)
def test_parts_of_a_mesh(low, size, out, words):
    """A second cube: the nearest facet would tell the wrong side of parts that are inside out."""
    second = FACES if out else FACES[:, ::-1]
    x = np.concatenate([CUBE, low + size * CUBE])
    both = meshio.Mesh(x, [("triangle", np.concatenate([FACES, second + len(CUBE)]))])
    if words is not None:
        with pytest.raises(ParameterError, match=words):
            mpm.RigidBody(both)
        return
    middle = np.full((1, 3), low + 0.5 * size)
    gap = mpm.RigidBody(both).surface.probe(middle)[0]
    assert gap == pytest.approx(-0.5 * size if out else 0.5 * size)


def test_bodies_that_cannot_be():
    disc = mpm.Disc((0, 0), 1)
    constant = fem.Constant(mesh.create_unit_interval(MPI.COMM_WORLD, 2), 0.0)
    for call, words in (
        (lambda: mpm.RigidBody(disc - disc), "is none of a rigid body"),
        (lambda: mpm.RigidBody("Disc"), "no file"),
        (lambda: mpm.RigidBody(disc, velocity=(1, 2, 3)), "2 finite numbers"),
        (lambda: mpm.RigidBody(disc, velocity=lambda t: t), "2 finite numbers"),
        (lambda: mpm.RigidBody(disc, angular_velocity=np.nan), "1 finite numbers"),
        (lambda: mpm.RigidBody(disc, displacement=(0, 1)), "function of time or a dolfinx"),
        (lambda: mpm.RigidBody(disc, displacement=constant), "must have 2"),
        (lambda: mpm.RigidBody(disc, velocity=(0, 0), displacement=lambda t: (0, t)), "only one"),
        (lambda: mpm.RigidBody(disc, velocity=(0, 0), increment=(0, 0)), "given at once; give"),
        (lambda: mpm.RigidBody(disc, rotation_increment=(0, 1)), "1 finite numbers"),
        (lambda: mpm.RigidBody(disc, fillet=-1.0), "fillet"),
        (lambda: mpm.RigidBody(disc, name="a disc"), "identifier"),
        (lambda: mpm.RigidBody(disc, mass=0.0, inertia=1.0), "mass = 0 kg"),
        (lambda: mpm.RigidBody(disc, mass=1.0), "needs its inertia"),
        (lambda: mpm.RigidBody(disc, mass=1.0, inertia=-1.0), "inertia = -1"),
        (lambda: mpm.RigidBody(disc, gravity=(0, -1)), "acts on a mass"),
        (lambda: mpm.RigidBody(disc, free=(True, False), force=(0, 1)), "must have 3 values"),
        (lambda: mpm.Plane((0, 0), (0, 0)), "point and a normal"),
        (lambda: mpm.Wedge((0, 0), 95.0, 1.0), "semi_angle = 95 degrees"),
        (lambda: mpm.Cone((0, 0, 0), 1.0, 30.0, 1.0), "length = 1 m"),
    ):
        with pytest.raises((ParameterError, OSError), match=words):
            call()


class Block:
    """A block under a disc that moves down."""

    def __init__(self, middle=(0.5, 1.5), motion=(0.0, -0.05), kind=mpm.QuasiStatic, **options):
        grid = mesh.create_rectangle(
            MPI.COMM_WORLD, [(0, 0), (1, 1.25)], (4, 5), mesh.CellType.quadrilateral
        )
        self.points = mpm.fill(grid, mpm.Box((0, 0), (1, 1)), 2, 1000.0)
        self.V = mpm.Space(grid, "gimp")
        name = "velocity" if kind is mpm.Explicit else "increment"
        name = "displacement" if callable(motion) else name
        self.body = mpm.RigidBody(mpm.Disc(middle, 0.5), name="disc", **{name: motion})
        self.F = mpm.momentum(mpm.materials.Hencky(1e5, 0.3), self.points, *self.uv)
        self.F += mpm.contact(self.body, self.points, *self.uv, penalty=12.5, **options)
        if kind is not None:
            bcs = mpm.rollers(self.V, "left", "right") + mpm.fixed(self.V, "bottom")
            self.problem = kind(self.F, self.V.increment, self.points, bcs)

    @property
    def uv(self):
        return self.V.increment, self.V.test


def test_contacts_that_cannot_be():
    block = Block(kind=None)
    points, (u, v) = block.points, block.uv
    other = Block(kind=None)
    ball = mpm.RigidBody(mpm.Ball((0, 0, 0), 1))
    face = mpm.Surface(other.points, lambda x: np.isclose(x[1], 1), (0, 1))
    for call, words in (
        (lambda: mpm.contact(mpm.Disc((0, 0), 1), points, u, v), "must be a RigidBody"),
        (lambda: mpm.contact(ball, points, u, v), "body in 3D"),
        (lambda: mpm.contact(block.body, points, v, u), "u = a test function"),
        (lambda: mpm.contact(block.body, points, u, v, friction=-0.1), "friction = -0.1"),
        (lambda: mpm.contact(block.body, points, u, v, penalty=0.0), "penalty = 0"),
        (lambda: mpm.contact(block.body, points, u, v, stiffness_per_area=-1), "Pa/m"),
        (lambda: mpm.contact(block.body, points, u, v, penetration=0.0), "penetration = 0 m"),
        (lambda: mpm.contact(block.body, points, u, v, surface=face), "of other points"),
        (lambda: mpm.contact(block.body, points, u, v, corners="all"), '"domains", "material"'),
    ):
        with pytest.raises(ParameterError, match=words):
            call()
    momentum = mpm.momentum(mpm.materials.Hencky(1e5, 0.3), points, u, v)
    with pytest.raises(FormError, match="is added: write F"):
        mpm.QuasiStatic(momentum - mpm.contact(block.body, points, u, v), u, points)
    energy = 1e5 * ufl.inner(ufl.grad(u), ufl.grad(u)) * points.dX
    form = ufl.derivative(energy, u, v) + mpm.contact(block.body, points, u, v)
    with pytest.raises(ParameterError, match="stiffness_per_area"):
        mpm.QuasiStatic(form, u, points, mpm.fixed(block.V, "bottom"))


def test_points_touch_a_body_in_one_contact():
    block = Block(kind=None)
    points, (u, v), bcs = block.points, block.uv, mpm.fixed(block.V, "bottom")
    points["tag"][:] = np.where(points["x"][:, 0] < 0.5, 1, 2)
    top = mpm.Surface(points, lambda x: np.isclose(x[1], 1), (0, 1), name="top")
    side = mpm.Surface(points, lambda x: np.isclose(x[0], 0), (-1, 0), name="side")
    momentum = mpm.momentum(mpm.materials.Hencky(1e5, 0.3), points, u, v)

    def contact(**options):
        return mpm.contact(block.body, points, u, v, **options)

    again = contact()
    for both in (
        again + again, contact() + contact(friction=0.3), contact(tag=1) + contact(),
        contact(tag=1) + contact(tag=(2, 1)), contact(surface=top) + contact(),
        contact(surface=top) + contact(surface=top, tag=2),
    ):  # fmt: skip
        with pytest.raises(FormError, match="contact with 'disc' twice for the same points"):
            mpm.QuasiStatic(momentum + both, u, points, bcs)
    # of points and of faces that share nothing
    for both in (contact(tag=1) + contact(tag=2), contact(surface=top) + contact(surface=side)):
        mpm.QuasiStatic(momentum + both, u, points, bcs)


def test_a_body_is_moved_by_one_problem():
    one, other = Block(), Block(kind=None)
    F = mpm.momentum(mpm.materials.Hencky(1e5, 0.3), other.points, *other.uv)
    F += mpm.contact(one.body, other.points, *other.uv)
    bcs = mpm.rollers(other.V, "left", "right") + mpm.fixed(other.V, "bottom")
    late = mpm.QuasiStatic(F, other.uv[0], other.points, bcs)
    one.problem.step()
    with pytest.raises(ParameterError, match="'disc' has been moved by another problem"):
        late.step()
    # also where the other problem is not there any more
    body, place = one.body, one.body.position.copy()
    del one
    gc.collect()
    with pytest.raises(ParameterError, match="'disc' has been moved by another problem"):
        late.step()
    np.testing.assert_array_equal(body.position, place)


@pytest.mark.parametrize("kind", [mpm.QuasiStatic, mpm.Explicit])
def test_a_next_stage_goes_on_with_a_body(kind):
    """A second problem of the same points; then the first one cannot go on."""
    block = Block(motion=lambda t: (0.0, -0.05 * t))
    block.problem.step()
    place = block.body.position[1]
    bcs = mpm.rollers(block.V, "left", "right") + mpm.fixed(block.V, "bottom")
    stage = kind(block.F, block.uv[0], block.points, bcs)
    time = () if kind is mpm.QuasiStatic else (1e-3,)
    stage.step(*time)
    assert block.body.position[1] < place
    with pytest.raises(ParameterError, match="make a body per problem"):
        block.problem.step()


def test_half_of_a_body_of_revolution_is_refused():
    """Its face on the axis is the nearest way out for points beside the axis."""
    grid = mpm.create_lattice(MPI.COMM_WORLD, [range(5), range(5)])
    points = mpm.fill(grid, mpm.Box((0, 0), (4, 2)), 2, 1.0, axisymmetric=True)
    V = mpm.Space(grid, "gimp")
    for left, right in ((-1.0, 1.0), (1.0, 2.0)):  # a pile, a ring
        pile = mpm.RigidBody(mpm.Box((left, 2), (right, 5)), increment=(0, -0.1))
        mpm.contact(pile, points, V.increment, V.test)
    half = mpm.RigidBody(mpm.Box((0, 2), (1, 5)), increment=(0, -0.1))
    with pytest.raises(ParameterError, match=r"face on the axis.*mirror image"):
        mpm.contact(half, points, V.increment, V.test)


def test_points_within_a_body_are_told_of():
    block = Block(middle=(0.5, 1.2))
    with pytest.raises(ParameterError, match="material points are inside 'disc' before"):
        block.problem.step()


def test_a_slight_overlap_is_pressed_out():
    block = Block(middle=(0.5, 1.48), motion=(0, 0))
    assert block.problem.step().halvings == 0
    assert block.body.force[1] > 0


def test_corners_far_within_a_body_are_told_of_once():
    block = Block(middle=(0.5, 1.44), motion=(0, 0))
    with pytest.warns(
        OverlapWarning, match="corners of 2 points begin within 'disc', by up to 0.0589 m"
    ):
        block.problem.step()
    block.problem.step()


def test_a_tool_outside_of_the_grid_touches_nothing():
    block = Block(middle=(5.0, 7.0))
    block.problem.step()
    np.testing.assert_array_equal(block.body.force, 0.0)
    np.testing.assert_array_equal(block.points["x"], block.points["x0"])


@pytest.mark.parametrize("friction", [0.0, 3.0])
def test_no_friction_and_much_of_it(friction):
    block = Block(motion=(0.01, -0.03), friction=friction)
    for _ in range(3):
        block.problem.step()
    assert block.body.force[1] > 0
    (contact,) = block.problem.bodies.contacts
    across = np.abs(block.points["contact1_tangential_force"]).max()
    assert (across > 0) == (friction > 0)
    assert contact.dissipated >= 0


def test_a_tool_that_is_faster_than_a_cell_a_step_takes_several_parts():
    slow = Block(motion=(0, -0.3 / 4))
    for _ in range(4):
        slow.problem.step()
    fast = Block(middle=(0.5, 3.5), motion=(0, -2.3))
    record = fast.problem.step()
    assert record.parts >= 10
    np.testing.assert_allclose(fast.body.position, slow.body.position)
    assert fast.body.force[1] == pytest.approx(slow.body.force[1], rel=0.05)
    explicit = Block(motion=(0, -1e9), kind=mpm.Explicit)
    with pytest.raises(ParameterError, match="more than a cell"):
        explicit.problem.step(1e-3)


def test_a_free_body_that_nothing_holds_is_told():
    """Smaller steps would not help."""
    for free, middle, words in (
        ((False, True, False), 1.6, "'disc' is free in the components 1 .* nothing touches it"),
        (None, 1.499, "in the components 0, 1, 2 .* contact does not hold it in all of them"),
    ):
        block = Block(kind=None)
        disc = mpm.RigidBody(mpm.Disc((0.5, middle), 0.5), force=(0, -1), free=free, name="disc")
        F = mpm.momentum(mpm.materials.Hencky(1e5, 0.3), block.points, *block.uv)
        F += mpm.contact(disc, block.points, *block.uv)
        bcs = mpm.rollers(block.V, "left", "right") + mpm.fixed(block.V, "bottom")
        with pytest.raises(ConvergenceError, match=words) as told:
            mpm.QuasiStatic(F, block.V.increment, block.points, bcs).step()
        assert "take smaller steps" not in str(told.value)
        assert "give the contact friction" in str(told.value)


def test_a_motion_is_of_the_steps_that_a_problem_takes():
    block = Block(kind=None)
    bcs = mpm.fixed(block.V, "bottom")
    for kind in (mpm.Newmark, mpm.Explicit, mpm.Transient):
        with pytest.raises(ParameterError, match="increment is the motion of 'disc' per step"):
            kind(block.F, block.uv[0], block.points, bcs)
    F = mpm.momentum(mpm.materials.Hencky(1e5, 0.3), block.points, *block.uv)
    for motion in ({"velocity": (0.0, -0.05)}, {"angular_velocity": 0.1}):
        body = mpm.RigidBody(mpm.Disc((0.5, 1.5), 0.5), name="disc", **motion)
        with pytest.raises(ParameterError, match="is the motion of 'disc' per second"):
            mpm.QuasiStatic(
                F + mpm.contact(body, block.points, *block.uv), block.uv[0], block.points
            )
    # a velocity at first, of a free body that is put down before it is let go
    free = mpm.RigidBody(
        mpm.Disc((0.5, 1.5), 0.5), velocity=(0.0, -0.05), mass=1.0, inertia=1.0, name="disc"
    )
    mpm.QuasiStatic(F + mpm.contact(free, block.points, *block.uv), block.uv[0], block.points)


def test_a_free_body_in_time_needs_a_mass():
    block = Block(kind=None, motion=None)
    ball = mpm.RigidBody(mpm.Disc((0.5, 1.5), 0.5), force=(0, -1), free=(False, True, False))
    F = block.F + mpm.contact(ball, block.points, *block.uv)
    for kind in (mpm.Newmark, mpm.Explicit):
        with pytest.raises(ParameterError, match="has no mass"):
            kind(F, block.V.increment, block.points)


def test_a_force_presses_a_free_body_into_the_ground():
    block = Block(kind=None)
    force = fem.Constant(block.points.grid, (0.0, 0.0))
    ball = mpm.RigidBody(
        mpm.Disc((0.5, 1.495), 0.5), force=force, free=(False, True, False), name="ball"
    )
    u, v = block.uv
    F = mpm.momentum(mpm.materials.Hencky(1e5, 0.3), block.points, u, v)
    F += mpm.contact(ball, block.points, u, v, friction=0.2, penalty=12.5)
    problem = mpm.QuasiStatic(F, u, block.points, mpm.fixed(block.V, "bottom"))
    for load in (500.0, 1000.0, 2000.0):
        force.value[1] = -load
        problem.step()
        assert ball.force[1] == pytest.approx(load, rel=1e-8)
    assert ball.position[1] < 1.495
