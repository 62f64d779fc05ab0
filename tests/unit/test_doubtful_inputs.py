"""Inputs that are far from usual ones, and names or states that a run does not have."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from dolfinmpm.errors import DoubtfulInputWarning, ParameterError, UnknownNameError
from mpi4py import MPI

import dolfinmpm as mpm


def block():
    grid = mpm.create_lattice(MPI.COMM_WORLD, [range(3), range(3)])
    points = mpm.fill(grid, mpm.Box((0, 0), (2, 1)), per_cell=2, density=2000.0)
    V = mpm.Space(grid, "gimp")
    F = mpm.momentum(mpm.materials.Hencky(1e6, 0.3), points, V.increment, V.test)
    return points, V, F


def scene(m):
    points, V, _ = block()
    F = mpm.momentum(mpm.materials.Hencky(m["E"], 0.3), points, V.increment, V.test)
    problem = mpm.QuasiStatic(F, V.increment, points, mpm.fixed(V, "bottom"))
    return mpm.study.Run(problem, [problem.step], {"top": lambda: points["x"].max()})


def test_second_inertia_is_told():
    points, V, F = block()
    a = mpm.acceleration(points, V.increment)
    F += points.density * ufl.inner(a, V.test) * points.dX
    with pytest.warns(DoubtfulInputWarning, match="Newmark has that of the points' density"):
        mpm.Newmark(F, V.increment, points, mpm.fixed(V, "bottom"))


@pytest.mark.parametrize("factor", [500.0, "share"])
def test_added_mass_is_not_told(factor, recwarn):
    points, V, F = block()
    factor = 0.5 * points.density if factor == "share" else factor
    F += factor * ufl.inner(mpm.acceleration(points, V.increment), V.test) * points.dX
    mpm.Newmark(F, V.increment, points, mpm.fixed(V, "bottom"))
    assert not [w for w in recwarn if w.category is DoubtfulInputWarning]


def test_record_in_centimetres_is_told(recwarn):
    wave = np.sin(2 * np.pi * np.linspace(0.0, 1.0, 101))
    time = np.linspace(0.0, 1.0, 101)
    mpm.InputMotion(time, acceleration=3.0 * wave).corrected()(0.5)
    mpm.InputMotion(time, velocity=3.0 * wave)(0.5)
    assert not [w for w in recwarn if w.category is DoubtfulInputWarning]
    with pytest.warns(DoubtfulInputWarning, match=r"scaled\(0.01\)"):
        mpm.InputMotion(time, acceleration=300.0 * wave).corrected()(0.5)


def test_scene_that_asks_for_another_parameter():
    with pytest.raises(UnknownNameError, match=r"parameter 'E', and those .* are G: give it"):
        mpm.study.differentiate(scene, {"G": 1e6})


def test_energy_with_the_wrong_sign():
    with pytest.raises(ParameterError, match="the energy falls with every strain"):
        mpm.materials.EnergyWithYield(lambda e: -1e6 * sum(e) ** 2 - 5e5 * ufl.inner(e, e))


def test_state_of_another_problem():
    points, V, F = block()
    problem = mpm.QuasiStatic(F, V.increment, points, mpm.fixed(V, "bottom"))
    with pytest.raises(ParameterError, match=r"the state has no .* give what state"):
        problem.set_state({})
    with pytest.raises(ParameterError, match="state = None"):
        problem.set_state(None)
    problem.set_state(problem.state())


def test_traction_of_a_term_is_a_vector():
    points, V, _ = block()
    top = mpm.Surface(points, lambda x: np.isclose(x[1], 1), normal=(0, 1))
    with pytest.raises(ParameterError, match="wind"):
        top.term(3.0, V.test, "wind")


@pytest.mark.parametrize("level", [3.0, 30e3])
def test_pressure_in_place_of_a_level_is_told(level, recwarn):
    points, V, _ = block()
    top = mpm.Surface(points, lambda x: np.isclose(x[1], 1), normal=(0, 1))
    P = mpm.Space(points.grid, "gimp", shape=())
    unknowns, tests = [V.increment, P.increment], [V.test, P.test]
    soil = mpm.materials.Hencky(1e6, 0.3)
    mpm.poromechanics(
        soil, points, unknowns, tests, permeability=1e-6, porosity=0.4, ponded=[(top, level)]
    )
    told = [str(w.message) for w in recwarn if w.category is DoubtfulInputWarning]
    assert bool(told) == (level > 1e4)
    assert all("the height of the surface plus 3.058 m" in message for message in told)
