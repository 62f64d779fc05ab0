"""Inputs that gave a wrong number in silence, or ended in an error of Python or NumPy."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
import ufl
from conftest import COMM
from dolfinx import fem

import dolfinmpm as mpm
from dolfinmpm import study
from dolfinmpm._platform.errors import (
    FormError,
    IdleConditionWarning,
    ParameterError,
    StateError,
)

SOIL = mpm.materials.Hencky(1e6, 0.3)


class Block:
    """A block of 2 m by 1 m with its weight, between smooth walls."""

    def __init__(self):
        self.grid = mpm.create_lattice(COMM, [np.arange(0, 2.1, 0.5), np.arange(0, 1.6, 0.5)])
        self.points = mpm.fill(self.grid, mpm.Box((0, 0), (2, 1)), 2, 1000.0)
        self.V = mpm.Space(self.grid, "gimp")
        self.u, self.v = self.V.increment, self.V.test
        self.F = mpm.momentum(SOIL, self.points, self.u, self.v)
        self.bcs = mpm.rollers(self.V, "left", "right") + mpm.fixed(self.V, "bottom")

    def weighed(self):
        g = fem.Constant(self.grid, (0.0, -10.0))
        return self.F - ufl.inner(self.points.density * g, self.v) * self.points.dX

    def solver(self, term=None, kind=mpm.QuasiStatic, **options):
        form = self.weighed() if term is None else self.F + term
        return kind(form, self.u, self.points, self.bcs, **options)

    def pressed(self, height=1.0, name="plate", **options):
        plane = mpm.Plane((0.0, height), (0.0, -1.0))
        plate = mpm.RigidBody(plane, increment=(0.0, -0.01), name=name)
        return mpm.contact(plate, self.points, self.u, self.v, **options)


# -- records, settings between steps ---------------------------------------------------


def test_two_rigid_bodies_have_two_names():
    """`record.bodies` had that of the last one, with a force of 0."""
    s = Block()
    with pytest.raises(
        ParameterError, match=r"two rigid bodies have the name 'plate'.*name=\.\.\."
    ):
        s.solver(s.pressed() + s.pressed(2.0))
    record = s.solver(s.pressed() + s.pressed(2.0, name="far")).step()
    assert set(record.bodies) == {"plate", "far"}


def test_a_courant_number_that_is_set_later():
    problem = Block().solver(kind=mpm.Explicit)
    problem.courant = 2.0
    with pytest.raises(ParameterError, match=r"courant = 2 is a share .* at most 1"):
        problem.step(0.01)
    problem.courant = 0.5
    problem.step(0.01)


@pytest.mark.parametrize("share", [0, -1.0, 2.0, np.nan, "half"])
def test_a_first_share_of_a_step(share):
    problem = Block().solver()
    problem.share = share
    with pytest.raises(ParameterError, match="share = "):
        problem.step()
    problem.share = 0.5
    assert problem.step().parts == 2


def test_a_reaction_of_no_condition():
    s = Block()
    problem = s.solver()
    problem.step()
    with pytest.raises(ParameterError, match=r"conditions = \[\] are none"):
        mpm.reaction(problem, [])
    with pytest.raises(ParameterError, match=r"tolerance = 2 must be"):
        mpm.equilibrate(Block().solver(), tolerance=2.0)


# -- contact, walls, loads -------------------------------------------------------------


def test_a_contact_so_stiff_that_rounding_is_its_force():
    """A stiffness of 1e30 Pa/m moved the block, and the force was 0."""
    s = Block()
    with pytest.raises(ParameterError, match=r"penalty = 1e\+10 must be .* at most 1e\+09"):
        s.pressed(penalty=1e10)
    with pytest.raises(ParameterError, match=r"stiffness_per_area = 1e\+30 Pa/m, more than 1e\+09"):
        s.solver(s.pressed(stiffness_per_area=1e30))
    s = Block()
    stiff = s.solver(s.pressed(penalty=1e9)).step().bodies["plate"]["force"][1]
    assert stiff == pytest.approx(27332.0, rel=1e-4)


def test_a_wall_takes_the_law_of_the_body():
    """A law of 1e3 in place of 1e6 Pa let the block sink by 0.04 m into the wall."""
    s = Block()
    wall = mpm.Boundary.from_side(s.points, "bottom")
    soft = mpm.materials.Hencky(1e3, 0.3)
    with pytest.raises(FormError, match=r"wall \(mpm.signorini\) at 'bottom' has the penalty of"):
        s.solver(mpm.signorini(wall, s.u, s.v, law=soft))
    for law in (SOIL, mpm.materials.Tresca(3e6, 0.3, 1e4)):
        one = Block()
        side = mpm.Boundary.from_side(one.points, "bottom")
        one.solver(mpm.signorini(side, one.u, one.v, law=law))


def test_a_load_where_no_body_is():
    s = Block()
    top = mpm.Boundary.from_side(s.points, "top")  # at 1.5 m, and the block ends at 1 m
    with pytest.warns(IdleConditionWarning, match=r"acts on nothing: .* beside 'top' now"):
        s.solver(top.traction((0.0, -1e3), s.v))
    end = Block()
    right = mpm.Boundary.from_side(end.points, "right")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        end.solver(right.traction((-1e3, 0.0), end.v))


# -- points, fields, faces ---------------------------------------------------------------


def test_a_field_that_is_there_already():
    points = Block().points
    points.add_field("water", (), "Pa", lambda x: x[0])
    for other in (1.0, lambda x: 2.0 * x[0]):
        with pytest.raises(ParameterError, match=r"a field 'water' already.*set points\['water'\]"):
            points.add_field("water", (), "Pa", other)
    # the same one, or none
    points.add_field("water", (), "Pa", lambda x: 1.0 * x[0])
    assert points.add_field("water") is points.water


def test_faces_that_are_far_from_their_points():
    points = Block().points
    area = np.zeros_like(points["x"])
    area[points["x"][:, 1] > 0.8, 1] = 0.25
    faces = points["x"] + [0.0, 10.0]
    with pytest.raises(ParameterError, match=r"offset = .* longer than 8 times the half-length"):
        mpm.Surface.from_arrays(points, faces, area)
    top = mpm.Surface.from_arrays(points, np.where(area > 0, points["l0"], 0.0), area)
    assert top.total_area == pytest.approx(2.0)


def test_whole_lengths_in_place_of_half_lengths():
    make = mpm.MaterialPoints.from_arrays
    grid = Block().grid
    with pytest.raises(ParameterError, match=r"a domain of 4 times .* half of the lengths"):
        make(grid, [[1.0, 1.0], [0.5, 0.5]], 0.01, 1000.0, half_length=0.1)
    make(grid, [[1.0, 1.0], [0.5, 0.5]], 0.01, 1000.0, half_length=0.05)


# -- laws, footings, rock ----------------------------------------------------------------


def test_an_attribute_that_a_law_does_not_have():
    for law, name in ((SOIL, "e"), (mpm.materials.NeoHookean(1e6, 0.3), "cohesion")):
        with pytest.raises(ParameterError, match=f"has no attribute {name}, and nothing would"):
            setattr(law, name, 5.0)
    with pytest.raises(ParameterError, match="did you mean cohesion"):
        mpm.materials.Tresca(1e6, 0.3, 1e3).cohesoin = 5.0

    class Mine(mpm.materials.Hencky):
        pass

    mine = Mine(1e6, 0.3)
    mine.note = "a class of the user"
    assert mine.note


def test_slopes_of_cam_clay_in_per_cent():
    given = {"M": 1.0, "mu0": 2e6, "alpha": 0.0}
    given |= {"reference_pressure": 20e3, "preconsolidation": 60e3}
    with pytest.raises(ParameterError, match=r"swelling = 2\.0 must be in \(0\.0, 1\.0\)"):
        mpm.materials.CamClay(swelling=2.0, compression=15.0, **given)
    mpm.materials.CamClay(swelling=0.02, compression=0.15, **given)


def test_a_footing_so_stiff_that_rounding_is_its_load():
    """It had a load of -8.7 kN in place of 27.3 kN."""
    s = Block()
    top = mpm.Surface(s.points, lambda x: np.isclose(x[1], 1.0), normal=(0, 1))
    settlement = fem.Constant(s.grid, 0.0)
    for given in ({"E": 1e18}, {"stiffness": 1e30}):
        foot = mpm.RigidFooting(top, settlement, **given)
        with pytest.raises(ParameterError, match=r"RigidFooting on .* more than 1e\+06 times that"):
            s.solver(foot.contact(s.u, s.v))
    foot = mpm.RigidFooting(top, settlement, E=1e12)
    problem = s.solver(foot.contact(s.u, s.v))
    settlement.value = 0.01
    problem.step()
    assert foot.load() == pytest.approx(27331.9, rel=1e-4)


# -- initial stress, units ---------------------------------------------------------------


def test_a_stress_that_acts_nowhere():
    for ground in (
        mpm.geostatic_stress(0.0, 10e3, 0.5),
        mpm.Deposit(-1.0, [mpm.Layer(-9.0, 10e3, 0.5)]).stress,
    ):
        with pytest.raises(
            ParameterError, match=r"gives 0 at all points, .* from 0\.125 to 0\.875"
        ):
            mpm.set_stress(SOIL, Block().points, ground)
    mpm.set_stress(SOIL, Block().points, np.zeros((3, 3)))


def test_a_stress_far_beyond_the_stiffness():
    with pytest.raises(StateError, match="need infinite strains; check that the unit is Pa"):
        mpm.set_stress(SOIL, Block().points, -1e9 * np.eye(3))


UNITS = {
    "water_weight": (
        lambda: mpm.Deposit(1.0, [mpm.Layer(0.0, 18e3, 0.5)], water_table=0.5, water_weight=1000.0),
        r"water_weight = 1000 N/m³ is the number of water's density",
    ),
    "least": (
        lambda: mpm.Deposit(1.0, [mpm.Layer(0.0, 18e3, 0.5)]).modulus(30e6, 0.5, least=5),
        "least = 5 must be",
    ),
    "reference_strain": (
        lambda: mpm.materials.HardinDrnevich(1e7, 0.3, reference_strain=0.04),
        r"reference_strain = 0\.04 must be at most 0\.03.* not per cent",
    ),
    "GPa": (lambda: mpm.Fluid(bulk_modulus=2.2), r"number of water's in GPa: give 2\.2e9 Pa"),
    "MPa": (lambda: mpm.Fluid(bulk_modulus=2.15e3), r"number of water's in MPa: give 2\.2e9 Pa"),
}


@pytest.mark.parametrize("name", UNITS)
def test_numbers_of_another_unit(name):
    make, told = UNITS[name]
    with pytest.raises(ParameterError, match=told):
        make()


def test_other_consistent_units():
    """Metres, tonnes, kN and kPa; or kgf and metres."""
    assert mpm.Fluid(1.0, bulk_modulus=2.2e6).unit_weight == 9.81
    mpm.Deposit(1.0, [mpm.Layer(0.0, 18.0, 0.5)], water_table=0.5, water_weight=9.81)
    mpm.Deposit(1.0, [mpm.Layer(0.0, 1800.0, 0.5)], water_table=0.5, water_weight=1000.0)


def test_a_table_with_a_column_twice(tmp_path):
    path = tmp_path / "table.csv"
    path.write_text("h,error,h\n1,2,3\n")
    with pytest.raises(ParameterError, match="has the column 'h' twice"):
        study.read_table(path)
