"""A rigid body that moves along a fixed side of the grid."""

import numpy as np
import pytest
from mpi4py import MPI

import dolfinmpm as mpm

E, N, PUSH = 1e6, 4, 0.004  # Pa, cells per metre, m per step


class Block:
    """An elastic block of 2 m by `height`, in cells of a quarter of a metre."""

    def __init__(self, height=1.0, basis="gimp"):
        h = 1.0 / N
        lines = [np.linspace(-2 * h, 2.0, 2 * N + 3), np.linspace(0.0, 1.0 + h, N + 2)]
        grid = mpm.create_lattice(MPI.COMM_SELF, lines)
        box = mpm.Box((0, 0), (2, height))
        self.points = mpm.fill(grid, box, per_cell=2, density=1000.0)
        self.space = mpm.Space(grid, basis)
        law = mpm.materials.Hencky(E, 0.3)
        self.form = mpm.momentum(law, self.points, self.space.increment, self.space.test)

    def problem(self, body, penalty, bcs):
        u, v = self.space.increment, self.space.test
        F = self.form + mpm.contact(body, self.points, u, v, penalty=penalty)
        return mpm.QuasiStatic(F, u, self.points, bcs, stabilisation="ghost")

    @property
    def overlap(self):
        return self.points["contact1_overlap"].max()


def pushed(penalty, basis):
    block, way = Block(basis=basis), [PUSH]
    body = mpm.RigidBody(mpm.Plane((0, 0), (1, 0)), increment=lambda t: (way[0], 0.0))
    bcs = mpm.fixed(block.space, "bottom") + mpm.rollers(block.space, "right")
    return block, block.problem(body, penalty, bcs), body, way


@pytest.mark.parametrize("basis", ["gimp", "linear", "bspline2"])
def test_force_on_a_wall_does_not_grow_with_the_penalty(basis):
    forces = []
    for penalty in (200.0, 2000.0):
        _, problem, body, _ = pushed(penalty, basis)
        for _ in range(3):
            problem.step()
        forces.append(-body.force[0])
    # a penalty on the whole motion makes 0.9 to 17e5 N/m
    assert 0.0 < forces[1] < 1.2 * forces[0]
    assert forces[1] < 3e4


def test_wall_that_goes_back_leaves_nothing_behind():
    block, problem, body, way = pushed(20.0, "gimp")
    for _ in range(2):
        problem.step()
    # the lowest corners are next to the base, which holds nearly all of their motion
    assert 0.8 * 2 * PUSH < block.overlap < 2 * PUSH
    way[0] = -PUSH
    for _ in range(3):
        problem.step()
    assert abs(body.force[0]) < 1e-6 * E
    assert block.overlap == 0.0


def test_base_that_moves_with_the_wall_holds_nothing():
    block = Block()
    body = mpm.RigidBody(mpm.Plane((0, 0), (1, 0)), increment=(PUSH, 0.0))
    bcs = mpm.prescribed(block.space, "bottom", 0, increment=PUSH)
    problem = block.problem(body, 20.0, bcs + mpm.prescribed(block.space, "bottom", 1))
    for _ in range(2):
        problem.step()
    assert block.overlap < 1e-12
    assert abs(body.force[0]) < 1e-6 * E


def test_plate_presses_a_layer_thinner_than_a_cell():
    height = 0.5 / N
    block = Block(height)
    body = mpm.RigidBody(mpm.Plane((0, height), (0, -1)), increment=(0.0, -PUSH))
    problem = block.problem(body, 2000.0, mpm.fixed(block.space, "bottom"))
    for _ in range(3):
        problem.step()
    assert block.overlap == 0.0
    assert block.points["F"][:, 1, 1].mean() == pytest.approx(1 - 3 * PUSH / height, rel=0.02)


def test_free_wall_finds_balance():
    block = Block()
    body = mpm.RigidBody(
        mpm.Box((-0.5, -0.25), (0, 1.2)), mass=100.0, inertia=10.0, free=(True, False, False),
        force=(2000.0, 0.0),
    )  # fmt: skip
    bcs = mpm.fixed(block.space, "bottom") + mpm.rollers(block.space, "right")
    problem = block.problem(body, 20.0, bcs)
    assert problem.step().iterations <= 8
    assert block.overlap > 0.0
    assert body.force[0] == pytest.approx(-2000.0, rel=1e-6)


def test_wall_in_time_keeps_account_of_the_energy():
    block, T = Block(), 2.0
    block.points.add_field("velocity", (2,), "m/s")
    u, v = block.space.increment, block.space.test
    body = mpm.RigidBody(mpm.Plane((0, 0), (1, 0)), velocity=(3 * PUSH / T, 0.0))
    F = block.form + mpm.contact(body, block.points, u, v, penalty=20.0)
    bcs = mpm.fixed(block.space, "bottom") + mpm.rollers(block.space, "right")
    problem = mpm.GeneralisedAlpha(F, u, block.points, bcs, stabilisation="ghost", rho_inf=0.5)
    for k in range(20):
        problem.step(T * (k + 1) / 20)
    energies = problem.energies()
    # without overlap it is 361 J, and 612 J with ten times the penalty
    assert 0.0 < energies.external < 100.0
    assert abs(energies["integrator"]) < 0.01 * energies.external
    assert energies["friction"] > 0.0


def explicit(fused, penalty=20.0, scheme="musl"):
    """The problem after the wall has pushed for 0.1 s, and the mean force in the second half."""
    block, T, n = Block(), 0.1, 20
    block.points.add_field("velocity", (2,), "m/s")
    u, v = block.space.increment, block.space.test
    body = mpm.RigidBody(mpm.Plane((0, 0), (1, 0)), velocity=(3 * PUSH / T, 0.0))
    F = block.form + mpm.contact(body, block.points, u, v, penalty=penalty)
    bcs = mpm.fixed(block.space, "bottom") + mpm.rollers(block.space, "right")
    problem = mpm.Explicit(F, u, block.points, bcs, fused=fused, scheme=scheme)
    forces = []
    for k in range(n):
        problem.step(T * (k + 1) / n)
        forces.append(body.force[0])
    assert (problem.unfused == "") == fused
    return problem, np.mean(forces[n // 2 :])


@pytest.mark.parametrize("scheme", ["musl", "usf"])
def test_fused_steps_hold_the_same_corners(scheme):
    one, force = explicit(True, scheme=scheme)
    other, same = explicit(False, scheme=scheme)
    assert force == pytest.approx(same, rel=1e-8)
    for name in ("x", "contact1_overlap", "contact1_normal_force"):
        a, b = (p[name][np.argsort(p["id"])] for p in (one.points, other.points))
        assert np.abs(a - b).max() < 1e-9 * max(np.abs(b).max(), 1.0)
    assert one.points["contact1_overlap"].max() > PUSH
    for name in ("integrator", "friction"):
        both = one.energies()[name], other.energies()[name]
        assert abs(both[0] - both[1]) < 1e-8 * abs(one.energies().external)


def test_explicit_wall_does_not_push_the_base():
    soft, hard = (explicit(True, penalty)[1] for penalty in (20.0, 200.0))
    # without overlap they are 45 and 72 kN/m
    assert 0.0 < -hard < -1.2 * soft < 1.2e4
