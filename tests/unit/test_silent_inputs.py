"""Mistakes that had no effect, or a wrong one, without a word."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI

import dolfinmpm as mpm
from dolfinmpm._platform.errors import FormError, ParameterError, UnknownNameError

SOIL = mpm.materials.Hencky(E=1e7, nu=0.3)


class Block:
    """A block of soil, its space, its form, and its weight."""

    def __init__(self):
        lines = np.linspace(0, 2, 5)
        self.grid = mpm.create_lattice(MPI.COMM_WORLD, [lines, lines])
        self.points = mpm.fill(self.grid, mpm.Box((0, 0), (2, 1)), 2, 1800.0)
        self.V, self.Q = mpm.Space(self.grid, "gimp"), mpm.Space(self.grid, "gimp", shape=())
        self.u, self.v = self.V.increment, self.V.test
        self.g = fem.Constant(self.grid, (0.0, -9.81))
        self.F = mpm.momentum(SOIL, self.points, self.u, self.v)
        self.bcs = mpm.fixed(self.V, "bottom")
        self.top = mpm.Surface(self.points, lambda x: np.isclose(x[1], 1.0), normal=(0, 1))

    def weight(self, *tag):
        return ufl.inner(self.points.density * self.g, self.v) * self.points.dX(*tag)

    def problem(self, F):
        return mpm.QuasiStatic(F, self.u, self.points, self.bcs)

    def wet(self, **given):
        fields, tests = (self.u, self.Q.increment), (self.v, self.Q.test)
        options = {"permeability": 1e-8, "porosity": 0.4, "drained": self.top, **given}
        return mpm.poromechanics(SOIL, self.points, fields, tests, **options)


@pytest.mark.parametrize(
    ("name", "hint"),
    [
        ("gravty", "a variable"),
        ("gravity", "a term of the form"),
        ("dt", "step\\(t\\) is told"),
        ("maxiter", "did you mean max_iterations"),
    ],
)
def test_a_name_that_a_problem_does_not_read(name, hint):
    s = Block()
    problem = s.problem(s.F - s.weight())
    with pytest.raises(ParameterError, match=f"has no argument {name}, .*{hint}"):
        setattr(problem, name, 1.0)
    problem.step()


def test_a_class_of_the_user_may_have_names_of_its_own():
    class Mine(mpm.QuasiStatic):
        def __init__(self, *given):
            super().__init__(*given)
            self.label = "mine"

    s = Block()
    assert Mine(s.F, s.u, s.points, s.bcs).label == "mine"


def test_a_field_that_points_do_not_have():
    s = Block()
    with pytest.raises(UnknownNameError, match=r"no field 'velocity'.*mpm\.Explicit gives it"):
        s.points.velocity = (0.0, -1.0)
    with pytest.raises(UnknownNameError, match="did you mean 'density'"):
        s.points.densty = 1.0
    with pytest.raises(UnknownNameError, match="no field 'axisymmetric'"):
        s.points.axisymmetric = True
    s.points.density = 1900.0
    assert (s.points["density"] == 1900.0).all()


def test_arguments_of_spaces_and_faces_are_read_once():
    s = Block()
    wall = mpm.Boundary.from_side(s.points, "bottom")
    for thing, name, words in (
        (s.V, "domains", "is read once"),
        (s.V, "levels", "no attribute"),
        (s.V, "domain", "did you mean domains"),
        (s.top, "normal", "is read once"),
        (wall, "follows", "is read once"),
        (wall, "penalty", "no attribute"),
    ):
        with pytest.raises(ParameterError, match=f"{name} = 1 of this .*{words}"):
            setattr(thing, name, 1)


def test_a_load_that_is_there_twice():
    s = Block()
    F = s.F - s.weight()
    with pytest.raises(FormError, match=r"twice for the same points.*runs again adds its term"):
        s.problem(F - s.weight())
    load = s.top.traction((0.0, -1e3), s.v)
    with pytest.raises(FormError, match="twice for the same points"):
        s.problem(F + load + load)
    # a factor, another constant and other points are no mistake
    s.problem(F + 2 * load)
    s.problem(F - ufl.inner(s.points.density * fem.Constant(s.grid, (1.0, 0.0)), s.v) * s.points.dX)
    s.points["tag"] = (s.points["x"][:, 0] > 1.0).astype(np.int32)
    s.problem(s.F - s.weight(0) - s.weight(1))
    with pytest.raises(FormError, match="twice for the same points"):
        s.problem(s.F - s.weight() - s.weight(1))
    side = mpm.Surface(s.points, lambda x: np.isclose(x[0], 2.0), normal=(1, 0))
    beds = (mpm.springs(face, s.u, s.v, stiffness=1e6) for face in (s.top, side))
    s.problem(sum(beds, s.F))
    bed = mpm.springs(s.top, s.u, s.v, stiffness=1e6)
    with pytest.raises(FormError, match=r"springs at 'surface1', 1e\+06 Pa/m twice"):
        s.problem(s.F + bed + bed)


def test_a_face_has_one_condition_on_the_pressure():
    s = Block()
    for given in ({"seepage": s.top}, {"ponded": [(s.top, 2.0)]}):
        (what,) = given
        with pytest.raises(ParameterError, match=rf"'surface1' is in drained= and in {what}="):
            s.wet(**given)
    with pytest.raises(ParameterError, match="is in drained= and in drained="):
        s.wet(drained=[(s.top, 0.0), (s.top, 20e3)])
    s.wet(inflow=[(s.top, 1e-8)])  # a well beside the free water


def test_a_modulus_in_another_unit():
    s = Block()
    with pytest.raises(ParameterError, match=r"modulus = 10000 Pa is far from .* 1\.34615e\+07 Pa"):
        s.wet(modulus=1e4)
    s.wet(modulus=5e6)


def test_springs_are_not_told_to_be_a_contact():
    s = Block()
    with pytest.raises(FormError, match=r"springs at .* write F \+= \.\.\.$"):
        s.problem(s.F - mpm.springs(s.top, s.u, s.v, stiffness=1e6))


def test_a_film_that_nobody_closes(tmp_path):
    """It had been lost without a word."""
    s = Block()
    film = mpm.animate(s.points, tmp_path / "lost.gif", "density")
    film.write(0.0)
    with pytest.warns(mpm.errors.DolfinMPMWarning, match=r"lost\.gif has frames, .* film\.close"):
        del film


def test_a_footing_in_another_unit():
    """Its load had been 7 % too low."""
    s = Block()
    c = fem.Constant(s.grid, 1e-3)
    foot = mpm.RigidFooting(s.top, c, E=1e4)
    with pytest.raises(
        ParameterError, match=r"RigidFooting on 'surface1' has E = 10000 Pa, .* 1e\+03 times"
    ):
        s.problem(s.F + foot.contact(s.u, s.v))
    s.problem(s.F + mpm.RigidFooting(s.top, c, E=5e6).contact(s.u, s.v))


def test_an_absorbing_side_in_steps_without_time():
    s = Block()
    s.bcs = mpm.absorbing(s.V, "bottom", density=1800.0, p_speed=300.0)
    with pytest.raises(ParameterError, match=r"side at 'bottom' acts by velocities"):
        s.problem(s.F)


def test_a_rigid_motion_that_nothing_holds():
    """Rounding had moved the block sideways, on one rank in another way than on two."""
    s = Block()
    s.bcs = mpm.rollers(s.V, "bottom")
    with pytest.warns(mpm.errors.FreeMotionWarning, match="rigid motions along x, and without"):
        s.problem(s.F - s.weight()).step()
    # springs, or the condition of the message, hold it
    side = mpm.Surface(s.points, lambda x: np.isclose(x[0], 2.0), normal=(1, 0))
    s.problem(s.F + mpm.springs(side, s.u, s.v, stiffness=1e6)).step()
    s.bcs = s.bcs + mpm.rollers(s.V, "left")
    s.problem(s.F - s.weight()).step()
