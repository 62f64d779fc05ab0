"""UMATs of the demos, and small ones with faults, for tests."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI

import dolfinmpm as mpm

COMM = MPI.COMM_WORLD
FOLDER = Path(__file__).resolve().parents[1] / "demos" / "umat"
NEEDS_FORTRAN = pytest.mark.skipif(
    shutil.which("gfortran") is None, reason="UMATs need gfortran, which is not installed"
)
HEAD = """\
subroutine umat(stress, statev, ddsdde, sse, spd, scd, rpl, ddsddt, drplde, drpldt, stran, &
    dstran, time, dtime, temp, dtemp, predef, dpred, cmname, ndi, nshr, ntens, nstatv, props, &
    nprops, coords, drot, pnewdt, celent, dfgrd0, dfgrd1, noel, npt, layer, kspt, jstep, kinc)
  implicit none
  integer :: ndi, nshr, ntens, nstatv, nprops, noel, npt, layer, kspt, jstep(4), kinc, i
  real(8) :: stress(ntens), statev(*), ddsdde(ntens, ntens), sse, spd, scd, rpl, ddsddt(ntens)
  real(8) :: drplde(ntens), drpldt, stran(ntens), dstran(ntens), time(2), dtime, temp, dtemp
  real(8) :: predef(1), dpred(1), props(*), coords(3), drot(3, 3), pnewdt, celent
  real(8) :: dfgrd0(3, 3), dfgrd1(3, 3)
  character(80) :: cmname
"""
# Poisson's ratio 0, E = PROPS(1)
ELASTIC = """\
  ddsdde = 0
  do i = 1, ntens
    ddsdde(i, i) = merge(props(1), props(1)/2, i <= ndi)
  end do
  stress = stress + matmul(ddsdde, dstran)
"""
# Hochstetten sand, with intergranular strain
HOCHSTETTEN = [33, 1.0e9, 0.25, 0.55, 0.95, 1.05, 0.25, 1.5, 1e-4, 5.0, 2.0, 0.5, 6.0, 0.0]
INTERGRANULAR = [f"intergranular_{k}" for k in ("11", "22", "33", "12", "13", "23")]


def umat(name, properties, state=0, **options):
    """A UMAT of the demos."""
    return mpm.materials.UMAT(FOLDER / name, properties, state, **options)


def written(folder, body=ELASTIC, declarations="", properties=(1e6,), state=0, **options):
    """A UMAT from the body of its subroutine."""
    source = folder / "law.f90"
    source.write_text(f"{HEAD}{declarations}\n{body}\nend subroutine\n")
    return mpm.materials.UMAT(source, properties, state, **options)


def sand(void_ratio=0.7, error=1e-6, **changed):
    """Hypoplasticity of Hochstetten sand; `R=0` switches the intergranular strain off."""
    values = list(HOCHSTETTEN)
    if "R" in changed:
        values[8] = changed["R"]
    state = dict.fromkeys(INTERGRANULAR, 0.0) | {"void_ratio": void_ratio}
    return umat("hypoplasticity.f90", [*values, error], state)


def bodies(dim):
    """A body of some points, 2D, 3D or axisymmetric, twice."""
    d = 3 if dim == 3 else 2
    grid = mpm.create_lattice(COMM, [range(4)] * d)
    box = mpm.Box((0,) * d, (3,) * d)
    return [mpm.fill(grid, box, 2, 1.0, axisymmetric=dim == "axisymmetric") for _ in range(2)]


def column(law, kind, **options):
    """A column that leans on a roller and yields under its weight; steps are taken."""
    grid = mpm.create_lattice(COMM, [np.linspace(0, 4, 9), np.linspace(0, 6, 13)])
    points = mpm.fill(grid, mpm.Box((0, 0), (2, 4.2)), 2, 2000.0)
    V = mpm.Space(grid, "gimp")
    g = fem.Constant(grid, (0.0, 0.0))
    F = mpm.momentum(law, points, V.increment, V.test, strain="jaumann", **options)
    F -= ufl.inner(points.density * g, V.test) * points.dX
    bcs = mpm.rollers(V, "left") + mpm.fixed(V, "bottom")
    problem = kind(F, V.increment, points, bcs, stabilisation="ghost")
    if kind is mpm.QuasiStatic:
        for load in (2.0, 4.0, 6.0):
            g.value[1] = -load
            problem.step()
    else:
        g.value[1] = -6.0
        problem.step(0.15)
        problem.step(0.3)
    return problem
