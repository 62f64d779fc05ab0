"""PETSc options: each problem has its own, from the script, the database or the command line."""

from __future__ import annotations

import gc
import sys

import pytest
import ufl
from conftest import unit_grid
from dolfinx import fem
from petsc4py import PETSc

import dolfinmpm as mpm
from dolfinmpm import errors


def problem_of(**options):
    grid = unit_grid("quadrilateral", 4)
    points = mpm.fill(grid, mpm.Box((0, 0), (1, 0.6)), 2, 1.0)
    V = mpm.Space(grid, "gimp")
    g = fem.Constant(grid, (0.0, 0.0))
    F = mpm.momentum(mpm.materials.Hencky(E=10.0, nu=0.3), points, V.increment, V.test)
    F -= ufl.inner(g, V.test) * points.dX
    problem = mpm.QuasiStatic(F, V.increment, points, mpm.fixed(V, "bottom"), **options)
    g.value[1] = -0.5
    return problem


def linear(problem):
    """What solves, which the first step chooses."""
    if problem.newton.linear.snes is None:
        problem.step()
    ksp = problem.newton.linear.snes.getKSP()
    return ksp.getType(), ksp.getPC().getType()


KRYLOV = {"ksp_type": "cg", "pc_type": "jacobi", "ksp_rtol": 1e-10}


def test_options_of_one_problem_do_not_reach_the_next():
    gc.collect()
    before = PETSc.Options().getAll()
    first = problem_of(petsc_options=KRYLOV)
    second = problem_of()
    assert linear(first) == ("cg", "jacobi")
    assert linear(second) == ("preonly", "cholesky")
    first.step()
    # factors and solvers that are made anew after a failure have them too
    first.newton.linear.forget()
    assert linear(first) == ("cg", "jacobi")
    del first, second
    gc.collect()
    assert PETSc.Options().getAll() == before


def test_options_in_the_database_reach_every_problem():
    database = PETSc.Options()
    database["mpm_ksp_type"], database["mpm_pc_type"] = "cg", "jacobi"
    try:
        one, other = problem_of(), problem_of(petsc_options={"pc_type": "none"})
        assert linear(one) == linear(other) == ("cg", "jacobi")
        assert linear(problem_of(options_prefix="other_")) == ("preonly", "cholesky")
    finally:
        database.delValue("mpm_ksp_type")
        database.delValue("mpm_pc_type")
    assert linear(problem_of()) == ("preonly", "cholesky")


def test_options_on_the_command_line(monkeypatch):
    words = ["-mpm_ksp_type", "cg", "--own", "3", "-mpm_pc_type", "jacobi", "-mpm_ksp_rtol", "1e-9"]
    monkeypatch.setattr(sys, "argv", ["case.py", *words, "-mpm_ksp_converged_maxits"])
    problem = problem_of(petsc_options={"ksp_type": "gmres"})
    assert linear(problem) == ("cg", "jacobi")
    assert problem.newton.linear.snes.getKSP().getTolerances()[0] == 1e-9
    problem.step()


def test_iterations_are_newtons_with_any_linear_solver():
    direct, krylov = problem_of().step(), problem_of(petsc_options=KRYLOV).step()
    assert krylov.iterations == direct.iterations == len(direct.residuals) - 1
    assert krylov.residuals[-1] == pytest.approx(direct.residuals[-1], abs=1e-9)


def test_options_that_nothing_reads_are_told():
    problem = problem_of(petsc_options={"ksp_tpye": "cg", "pc_type": "jacobi", "ksp_type": "cg"})
    words = "ksp_tpye = 'cg', and nothing .* has read it; did you mean 'ksp_type'"
    with pytest.warns(errors.UnreadOptionWarning, match=words) as told:
        problem.step()
    assert len(told) == 1
    # once
    problem.step()
    with pytest.warns(errors.UnreadOptionWarning, match=r"fieldsplit_u_pc_type = 'lu', and [^;]*$"):
        problem_of(petsc_options={"fieldsplit_u_pc_type": "lu"}).step()


def test_info_tells_the_solver_that_options_have_chosen():
    def told(options):
        problem = problem_of(petsc_options=options)
        problem.step()
        (line,) = [line for line in problem.info().splitlines() if "linear solver" in line]
        return line.removeprefix("linear solver: ")

    assert told({}).startswith("Cholesky by CHOLMOD: ")
    for options, words in (
        ({"pc_factor_mat_solver_type": "mumps"}, "LU by MUMPS: chosen by options"),
        ({"pc_type": "cholesky"}, "Cholesky by MUMPS: chosen by options"),
        ({"pc_type": "lu", "pc_factor_mat_solver_type": "petsc"}, "LU by PETSC: chosen by options"),
        (KRYLOV, "CG with jacobi: chosen by options"),
        ({"ksp_type": "gmres"}, "GMRES with Cholesky by CHOLMOD: chosen by options"),
    ):
        assert told(options) == words
