"""Faults of UMATs and of their use, which are told by name."""

from __future__ import annotations

import shutil

import numpy as np
import pytest
from mpi4py import MPI
from umats import ELASTIC, NEEDS_FORTRAN, bodies, column, umat, written

import dolfinmpm as mpm
from dolfinmpm.kinematics import strain_formulation

pytestmark = NEEDS_FORTRAN
COMM = MPI.COMM_WORLD


@pytest.mark.parametrize(
    ("trouble", "told"),
    [
        ("stress(1) = sqrt(-dtime)", "not finite"),
        ("call xit", "XIT"),
        ("stop 'no such sand'", "STOP"),
        ("error stop 4", "STOP"),
        ("allocate(nowhere(-1_8 + 2_8**60))\nstress(1) = nowhere(1)", "error at run time"),
    ],
)
def test_a_call_that_fails_in_a_step_is_told(tmp_path, trouble, told):
    body = f"{ELASTIC}  if (stress(2) < -1d3) then\n{trouble}\nend if"
    law = written(tmp_path, body, "  real(8), pointer, save :: nowhere(:)")
    with pytest.raises(mpm.errors.ConvergenceError, match=told):
        column(law, mpm.QuasiStatic)


@pytest.mark.parametrize("trouble", ["statev(2) = 1d0", "statev(2) = statev(2) + 0d0"])
@pytest.mark.parametrize("kind", [mpm.QuasiStatic, mpm.Explicit])
def test_a_write_behind_the_state_is_told_in_a_step(tmp_path, kind, trouble):
    """As where soil yields, which the first call does not reach."""
    body = f"{ELASTIC}  if (stress(2) < -1d3) {trouble}"
    law = written(tmp_path, body, state=1)
    assert law.check(stress=0.0) == []
    with pytest.raises(mpm.errors.DolfinMPMError, match=r"behind the last number of STATEV \(give"):
        column(law, kind)


@pytest.mark.parametrize(
    ("body", "state", "told"),
    [
        (ELASTIC + "statev(3) = 1d0", 2, r"1 numbers behind the 2 numbers of STATEV: give state=3"),
        (ELASTIC + "stress(1) = stress(1) + props(4)", 0, "reads numbers beyond an array: STRESS"),
        (ELASTIC + "statev(1) = statev(2)", 1, "reads numbers beyond an array: STATEV"),
        ("call xit", 0, "stops the analysis by a call of XIT"),
        ("print *, 'no such sand'\n call xit", 0, "no such sand"),
        ("nowhere => null()\n stress(1) = stress(1) + nowhere(ntens)", 0, "crashes with SIGSEGV"),
        ("stop 3", 0, "exit code 3"),
        ("error stop 'no clay'", 0, r"exit code 1(?s:.*)no clay"),
    ],
)
def test_a_faulty_umat_is_told_before_the_first_step(tmp_path, body, state, told):
    law = written(tmp_path, body, "  real(8), pointer :: nowhere(:)", state=state)
    points = bodies(2)[0]
    V = mpm.Space(points.grid, "gimp")
    F = mpm.momentum(law, points, V.increment, V.test, strain="jaumann")
    with pytest.raises(mpm.errors.UserLawError, match=told):
        mpm.QuasiStatic(F, V.increment, points, mpm.fixed(V, "bottom")).step()
    with pytest.raises(mpm.errors.UserLawError, match=told):
        law.check()


def test_a_source_that_does_not_compile_or_link_is_told(tmp_path):
    with pytest.raises(mpm.errors.UserLawError, match=r"law\.f90:\d+(?s:.*)Error:"):
        written(tmp_path, "  stress = nonsense(")
    with pytest.raises(mpm.errors.UserLawError, match="calls lubksb_, which it does not contain"):
        written(tmp_path, "  call lubksb(stress)")
    other = tmp_path / "other.f90"
    other.write_text("subroutine vumat\nend subroutine\n")
    with pytest.raises(mpm.errors.UserLawError, match="no SUBROUTINE UMAT"):
        mpm.materials.UMAT(other)
    with pytest.raises(mpm.errors.ParameterError, match="is not there"):
        mpm.materials.UMAT(tmp_path / "missing.f")
    with pytest.raises(mpm.errors.ParameterError, match=r"must end in \.f"):
        mpm.materials.UMAT(tmp_path / "law.c")


def test_without_a_compiler_the_message_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setattr(shutil, "which", lambda name: None)
    with pytest.raises(mpm.errors.MissingPackageError, match="apt-get install gfortran"):
        written(tmp_path)


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"state": -1}, "state"),
        ({"state": ["a", "a"]}, "different words"),
        ({"state": ["void ratio"]}, "different words"),
        ({"state": {"e": np.nan}}, "finite"),
        ({"properties": [1e6, np.inf]}, "properties"),
        ({"name": "x" * 81}, "80 ASCII"),
        ({"flags": "-O3"}, "list of words"),
    ],
)
def test_bad_arguments(tmp_path, options, told):
    with pytest.raises(mpm.errors.ParameterError, match=told):
        written(tmp_path, **options)


def test_large_strain_and_reduced_strength_are_refused():
    law = umat("elastic.f", [1e6, 0.3])
    points = bodies(2)[0]
    V = mpm.Space(points.grid, "gimp")
    with pytest.raises(mpm.errors.ParameterError, match='strain="jaumann"'):
        mpm.momentum(law, points, V.increment, V.test)
    with pytest.raises(mpm.errors.ParameterError, match="does not tell its strength"):
        strain_formulation(law, points, "small").weaken(1.5)


def test_another_law_cannot_go_on_with_the_points_unless_a_stress_is_set():
    problem = column(umat("elastic.f", [1e6, 0.3]), mpm.QuasiStatic)
    points = problem.points
    V = mpm.Space(points.grid, "gimp")
    law = mpm.materials.Hencky(1e6, 0.3)
    F = mpm.momentum(law, points, V.increment, V.test, strain="jaumann")
    with pytest.raises(mpm.errors.StateError, match="under a UMAT"):
        mpm.QuasiStatic(F, V.increment, points, mpm.fixed(V, "bottom")).step()
    mpm.set_stress(law, points, points["stress"], strain="jaumann")
    mpm.QuasiStatic(F, V.increment, points, mpm.fixed(V, "bottom"))


def test_the_check_finds_state_between_points_and_wrong_tangents(tmp_path):
    kept = written(tmp_path, ELASTIC + "count = count + 1\nstress(1) = stress(1) + count",
                   "  real(8), save :: count = 0")  # fmt: skip
    assert "keeps state between points" in kept.check()[0]
    last = written(tmp_path, ELASTIC + "stress = stress + 1d-3*last\nlast = stress(1)",
                   "  real(8), save :: last = 0")  # fmt: skip
    assert "keeps state between points" in last.check()[0]
    once = written(tmp_path, "if (first) factor = 2\nfirst = .false.\n" + ELASTIC,
                   "  logical, save :: first = .true.\n  real(8), save :: factor")  # fmt: skip
    assert once.check() == []
    wrong = written(tmp_path, ELASTIC + "ddsdde(2, 1) = ddsdde(1, 1)/10")
    (fault,) = wrong.check()
    assert "DDSDDE(2,1) = 100000 Pa" in fault
    (fault,) = written(tmp_path, "ddsdde = 0").check()
    assert "gives the same stress for every DSTRAN" in fault
    with pytest.raises(mpm.errors.ParameterError, match="4 or 6"):
        wrong.check(components=5)


def test_arguments_that_a_umat_overwrites_are_its_own(tmp_path):
    """Properties, sizes, increments, times and the rotation: the results are those without."""
    writes = """
    props(1) = 2*props(1)
    ntens = 3
    nprops = 0
    ndi = 1
    dstran = 7
    stran = 7
    drot = 7
    dfgrd0 = 7
    dfgrd1 = 7
    coords = 7
    time = 7
    dtime = 7
    """
    found = []
    for k, body in enumerate((ELASTIC, ELASTIC + writes)):
        (tmp_path / str(k)).mkdir()
        law = written(tmp_path / str(k), body)
        assert law.check() == []
        found.append(column(law, mpm.QuasiStatic).points)
    assert np.array_equal(found[1]["stress"], found[0]["stress"])
    assert np.array_equal(found[1]["total_strain"], found[0]["total_strain"])
