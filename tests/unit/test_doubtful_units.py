"""Units, signs and sizes that are far from usual ones, and messages with a remedy that helps."""

from __future__ import annotations

import meshio
import numpy as np
import pytest
import ufl
from dolfinmpm.errors import (
    ConvergenceError,
    DoubtfulInputWarning,
    FieldShapeError,
    IdleConditionWarning,
    ParameterError,
    PointsOutsideGridError,
)
from mpi4py import MPI

import dolfinmpm as mpm

WEIGHT = 2000.0 * 9.81
CLAY = {"swelling": 0.02, "compression": 0.15, "M": 1.0, "mu0": 2e6, "alpha": 0.0}


class Block:
    """A block of 2 m by 1 m on a fixed bottom, in cells of 1 m."""

    def __init__(self, law=None, basis="gimp", cells=2):
        self.grid = mpm.create_lattice(MPI.COMM_WORLD, [range(cells + 1)] * 2)
        box = mpm.Box((0, 0), (2, 1))
        self.points = mpm.fill(self.grid, box, per_cell=2, density=2000.0)
        self.V = mpm.Space(self.grid, basis)
        self.u, self.v = self.V.increment, self.V.test
        self.law = mpm.materials.Hencky(1e6, 0.3) if law is None else law
        self.F = mpm.momentum(self.law, self.points, self.u, self.v)
        self.bcs = mpm.fixed(self.V, "bottom") + mpm.rollers(self.V, "left")

    def weight(self, g=-9.81):
        load = ufl.inner(self.points.density * ufl.as_vector((0.0, g)), self.v)
        return load * self.points.dX

    def problem(self, F=None, **options):
        return mpm.QuasiStatic(
            self.F - self.weight() if F is None else F, self.u, self.points, self.bcs, **options
        )


def ground(weight):
    return mpm.Deposit(1.0, mpm.Layer(0.0, weight, K0=0.5))


@pytest.mark.parametrize(
    ("weight", "told"),
    [(19.62, "in kN/m³: give it in N/m³"), (2000.0, "the density:"), (WEIGHT * 9.81, "twice")],
)
def test_unit_weight_beside_another_density(weight, told):
    block = Block()
    for stress in (ground(weight).stress, mpm.geostatic_stress(1.0, weight, 0.5)):
        with pytest.warns(DoubtfulInputWarning, match=told):
            mpm.set_stress(block.law, block.points, stress)
    with pytest.warns(DoubtfulInputWarning, match=told):
        ground(weight).body_force(block.points)


@pytest.mark.parametrize("weight", [0.0, 6e3, WEIGHT, 50 * WEIGHT])
def test_unit_weights_that_are_possible(weight):
    block = Block()
    if weight:
        mpm.set_stress(block.law, block.points, mpm.geostatic_stress(1.0, weight, 0.5))
    ground(weight).body_force(block.points)


def test_earth_pressure_in_per_cent():
    with pytest.raises(ParameterError, match="K0 = 50 must be a ratio of stresses"):
        mpm.geostatic_stress(1.0, WEIGHT, 50)


@pytest.mark.parametrize("sign", [1, -1])
def test_weight_that_acts_upward(sign):
    block = Block()
    F = block.F - block.weight(9.81) if sign < 0 else block.F + block.weight()
    with pytest.warns(DoubtfulInputWarning, match="acts upward, along the last axis"):
        block.problem(F).step()


def test_body_force_with_the_wrong_sign_or_beside_the_weight():
    block = Block()
    force = ufl.inner(ground(WEIGHT).body_force(block.points), block.v) * block.points.dX
    with pytest.warns(DoubtfulInputWarning, match="acts upward"):
        block.problem(block.F + force).step()
    block = Block()
    force = ufl.inner(ground(WEIGHT).body_force(block.points), block.v) * block.points.dX
    with pytest.warns(DoubtfulInputWarning, match="has their weight too"):
        block.problem(block.F - block.weight() - force).step()


def test_gravity_of_a_mixture_with_the_wrong_sign():
    block = Block()
    Q = mpm.Space(block.grid, "gimp", shape=())
    fields, tests = (block.u, Q.increment), (block.v, Q.test)
    water = {"permeability": 1e-6, "porosity": 0.4, "gravity": (0.0, 9.81)}
    F = mpm.poromechanics(block.law, block.points, fields, tests, **water)
    stabilisation = ["ghost", "ghost"]
    problem = mpm.Transient(F, fields, block.points, block.bcs, stabilisation=stabilisation)
    with pytest.warns(DoubtfulInputWarning, match="'gravity of mpm.poromechanics' acts upward"):
        problem.step(1.0)


def test_accelerations_that_act_upward_beside_a_weight():
    block = Block()
    block.problem(block.F - block.weight() - block.weight(3.0)).step()


def test_penalty_of_a_contact_in_another_unit():
    block = Block()
    plate = mpm.RigidBody(mpm.Box((0, 1), (2, 2)), increment=(0, -0.01))
    ends = plate, block.points, block.u, block.v
    with pytest.warns(DoubtfulInputWarning, match="less than a hundredth of the usual 5"):
        mpm.contact(*ends, penalty=1e-3)
    mpm.contact(*ends, penalty=0.1)
    mpm.contact(*ends, penalty=1e-3, penetration=1e-4)


def test_factor_of_a_ghost_penalty_that_is_a_modulus():
    with pytest.warns(DoubtfulInputWarning, match="no modulus: give that as E="):
        mpm.Stabilisation("ghost", factor=1e9)
    mpm.Stabilisation("ghost", factor=1e4)


def test_cam_clay_without_a_stress():
    law = mpm.materials.CamClay(**CLAY, reference_pressure=20e3, preconsolidation=60e3)
    block = Block(law)
    with pytest.raises(ConvergenceError, match="8 points of CamClay begin without a given stress"):
        block.problem(max_iterations=1, max_halvings=1).step()
    block = Block(law)
    problem = block.problem(block.F)
    mpm.set_stress(law, block.points, -20e3 * np.eye(3))
    problem.activate()


def test_displacements_of_a_surface_in_a_state_of_another_size():
    block = Block()
    top = mpm.Surface(block.points, lambda x: np.isclose(x[1], 1), normal=(0, 1))
    x, F = block.points["x"], block.points["F"]
    np.testing.assert_array_equal(top.displacements_of(x, F.tolist()), 0.0)
    for wrong in ((x[:1], F), (x, F[:1]), (x.T, F), (x, np.zeros((len(x), 3, 3))), (x, "F")):
        with pytest.raises(FieldShapeError, match=r"should have shape|must be an array"):
            top.displacements_of(*wrong)


def test_rigid_bodies_of_positions():
    corners = np.array([(0, 0), (1, 0), (1, 1), (0, 1)], float)
    with pytest.raises(ParameterError, match=r"shape has 4 positions.*mpm.Polygon\(corners\)"):
        mpm.RigidBody(corners)
    with pytest.raises(ParameterError, match="a body that deforms"):
        mpm.RigidBody(Block().points)
    cells = [("triangle", np.array([(0, 1, 2), (0, 2, 3)]))]
    for x in (corners, np.column_stack([corners, np.zeros(4)])):
        with pytest.raises(ParameterError, match=r"triangles in a plane.*give its outline"):
            mpm.RigidBody(meshio.Mesh(x, cells))


def test_beta_far_below_usual_ones():
    block = Block(cells=3)
    with pytest.warns(DoubtfulInputWarning, match=r"beta = 0\.01 is below .* take beta=0\.25"):
        motion = mpm.Newmark(block.F - block.weight(), block.u, block.points, block.bcs, beta=0.01)
    assert "beta=0.25" in motion.scheme.remark_on(5)
    usual = mpm.Newmark(block.F - block.weight(), block.u, block.points, block.bcs)
    assert not usual.scheme.remark_on(5)


@pytest.mark.parametrize("E", [1e3, 1.0])
def test_first_step_of_a_body_in_another_unit(E):
    block = Block(mpm.materials.Hencky(E, 0.3))
    with pytest.raises(
        (PointsOutsideGridError, ConvergenceError), match="moduli and loads in different units"
    ):
        block.problem(max_halvings=3).step()


def scene(m):
    block = Block(mpm.materials.Hencky(m.get("E0", 1e6), 0.3))
    problem = block.problem()
    return mpm.study.Run(problem, [problem.step], {"top": lambda: block.points["x"].max()})


def test_parameter_that_a_scene_has_by_another_name():
    with pytest.warns(DoubtfulInputWarning, match="'E', and .* asked for 'E0'"):
        mpm.study.differentiate(scene, {"E": 1e6})
    mpm.study.differentiate(scene, {"E0": 1e6})


def test_absorbing_side_away_from_the_body():
    block = Block(basis="bspline2", cells=3)
    sides = mpm.absorbing(block.V, "top", density=2000.0, p_speed=100.0)
    with pytest.warns(IdleConditionWarning, match="'top' of the grid is 2 m from the body"):
        mpm.Newmark(block.F, block.u, block.points, mpm.fixed(block.V, "bottom") + sides)


def test_penetration_that_faces_cannot_keep():
    grid = mpm.create_lattice(MPI.COMM_WORLD, [range(7)] * 2)
    points = mpm.fill(grid, mpm.Box((0, 0), (4, 4)), per_cell=2, density=2000.0)
    V = mpm.Space(grid, "gimp")
    plate = mpm.RigidBody(mpm.Box((-1, 4), (5, 5)), increment=(0, -0.05), name="plate")
    top = mpm.Boundary.from_polygon(points, [(4, 4), (0, 4)], closed=False)
    F = mpm.momentum(mpm.materials.Hencky(10e6, 0.3), points, V.increment, V.test)
    F += mpm.contact(plate, points, V.increment, V.test, penetration=1e-6, surface=top)
    bcs = mpm.fixed(V, "bottom") + mpm.rollers(V, "left")
    problem = mpm.QuasiStatic(F, V.increment, points, bcs, stabilisation="ghost")
    with pytest.warns(DoubtfulInputWarning, match=r"follow them no closer.*give penetration=3e-05"):
        record = problem.step()
    # without an end of the augmentation the step had 105 parts
    assert record.parts == 1
    assert record.iterations < 30
    # that of corners in place of faces, whose gaps close
    assert plate.force[1] == pytest.approx(592230, rel=1e-4)
