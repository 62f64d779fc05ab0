"""One small program per named error and warning: what makes it.

docs/build runs each function, checks that it makes the error of its name, and shows both on the
page of errors. `block` and `problem` are what all of them start from.
"""

from __future__ import annotations

import math
import os
import pathlib
import tempfile

import numpy as np
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

import dolfinmpm as mpm

SOIL = mpm.materials.Hencky(E=1e5, nu=0.3)

# How many ranks the others need
RANKS = {"DifferentCallsError": 2, "ImbalanceWarning": 3, "LocalValueWarning": 2}


def block(high=0.5, basis="gimp", cells=4):
    """Half a unit square of soil: points, space."""
    grid = mesh.create_unit_square(MPI.COMM_WORLD, cells, cells, mesh.CellType.quadrilateral)
    points = mpm.fill(grid, mpm.Box((0, 0), (1, high)), per_cell=2, density=1000.0)
    return points, mpm.Space(grid, basis)


def problem(points, V, *bcs, **options):
    """The soil as a quasi-static problem."""
    F = mpm.momentum(SOIL, points, V.increment, V.test)
    return mpm.QuasiStatic(F, V.increment, points, bcs, **options)


def ParameterError():
    mpm.materials.Hencky(E=-1.0, nu=0.3)


def UnknownNameError():
    points, _ = block()
    points["velocty"]


def DifferentCallsError():
    points, V = block()
    soil = problem(points, V, *mpm.fixed(V, "bottom"))
    if MPI.COMM_WORLD.rank == 0:
        soil.step()
    else:
        soil.save("block.npz")


def FieldShapeError():
    points, _ = block()
    points["stress"] = np.zeros(3)


def ShapeOutsideGridError():
    block(high=1.5)


def EmptyShapeError():
    points, _ = block()
    mpm.fill(points.grid, mpm.Disc((0.5, 0.5), 0.01), per_cell=1, density=1.0)


def UnsupportedGridError():
    grid = mesh.create_unit_square(MPI.COMM_WORLD, 4, 4)  # triangles
    mpm.Space(grid, basis="gimp")


def ConflictingConditionsError():
    points, V = block()
    up = mpm.prescribed(V, "bottom", 1, increment=0.1)
    problem(points, V, *mpm.fixed(V, "bottom"), *up).step()


def FormError():
    points, V = block()
    F = mpm.momentum(SOIL, points, V.increment, V.test)
    F -= points.density * V.test[1] * ufl.dx  # a field of the points over the whole grid
    mpm.QuasiStatic(F, V.increment, points)


def PointsOutsideGridError():
    points, V = block()
    away = mpm.prescribed(V, lambda x: x[0] > -1, 0, increment=0.2)
    still = mpm.prescribed(V, lambda x: x[0] > -1, 1, increment=0.0)
    moved = problem(points, V, *away, *still)
    for _ in range(6):
        moved.step()


def MissingPackageError():
    os.environ["PATH"] = ""  # as on a machine without gfortran
    pathlib.Path("clay.f90").write_text("subroutine umat(...)")
    mpm.materials.UMAT("clay.f90", properties=[], state=0)


def StateError():
    clay = mpm.materials.CamClay(
        swelling=0.02, compression=0.13, M=1.05, mu0=5e6, alpha=0.0,
        reference_pressure=2e4, preconsolidation=2e4,
    )  # fmt: skip
    clay.respond([[-40.0, -40.0, -40.0]])  # logarithmic strains


def UserLawError():
    source = pathlib.Path("law.f90")
    source.write_text("subroutine vumat()\nend subroutine\n")
    mpm.materials.UMAT(source)


def CheckpointError():
    points, V = block()
    problem(points, V).load("no_such_file.npz")


def ConvergenceError():
    points, V = block()
    load = fem.Constant(points.grid, (0.0, -1e7))  # far too much for this soil in one step
    F = mpm.momentum(SOIL, points, V.increment, V.test)
    F -= ufl.inner(points.density * load, V.test) * points.dX
    bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
    mpm.QuasiStatic(F, V.increment, points, bcs, max_halvings=2).step()


def UndeterminedFieldError():
    points, V = block(high=1.0)
    Q = mpm.Space(points.grid, "gimp", shape=())
    F = mpm.poromechanics(
        SOIL, points, (V.increment, Q.increment), (V.test, Q.test), porosity=0.4, permeability=1e-3
    )
    closed = mpm.rollers(
        V, "left", "right", "bottom", "top"
    )  # no water can leave, none is squeezed
    mpm.Transient(F, [V.increment, Q.increment], points, closed).step(1.0)


def InstabilityError():
    points, V = block()
    points.add_field("velocity", (2,), "m/s", lambda x: np.stack([0 * x[0], -10 * x[1]], axis=1))
    F = mpm.momentum(SOIL, points, V.increment, V.test)
    moving = mpm.Explicit(F, V.increment, points, mpm.fixed(V, "bottom"), courant=math.inf)
    for t in mpm.times(10.0, dt=0.2):  # far above the critical step
        moving.step(t)


def IdleConditionWarning():
    points, V = block()
    problem(points, V, *mpm.fixed(V, "bottom"), *mpm.fixed(V, "top")).step()


def FreeAxisWarning():
    grid = mesh.create_unit_square(MPI.COMM_WORLD, 4, 4, mesh.CellType.quadrilateral)
    box = mpm.Box((0, 0), (0.5, 0.5))
    points = mpm.fill(grid, box, per_cell=2, density=1.0, axisymmetric=True)
    V = mpm.Space(grid, "gimp")
    problem(points, V, *mpm.rollers(V, "bottom")).step()


def DegreesWarning():
    mpm.materials.MohrCoulomb(1e6, 0.3, cohesion=0.0, friction_angle=0.6)  # radians


def WideComparisonWarning():
    y0 = 5e6  # a northing (m)
    corners, quadrilaterals = [(0, y0), (10, y0 + 5)], mesh.CellType.quadrilateral
    grid = mesh.create_rectangle(MPI.COMM_WORLD, corners, (10, 5), quadrilaterals)
    mpm.prescribed(mpm.Space(grid), lambda x: np.isclose(x[1], y0), 1)


def DifferentProblemWarning():
    points, V = block()
    bottom = mpm.fixed(V, "bottom")
    problem(points, V, *bottom).save("block.npz")
    problem(points, V, *mpm.rollers(V, "bottom")).load("block.npz")


def OverlapWarning():
    points, V = block()
    F = mpm.momentum(SOIL, points, V.increment, V.test)
    plate = mpm.RigidBody(mpm.Plane((0, 0.05), (0, 1)))
    F += mpm.contact(plate, points, V.increment, V.test)
    mpm.QuasiStatic(F, V.increment, points, mpm.fixed(V, "top")).step()


def SmallBodyWarning():
    points, V = block()
    F = mpm.momentum(SOIL, points, V.increment, V.test)
    needle = mpm.RigidBody(mpm.Disc((0.5, 1.001), 0.001), increment=(0, -1e-4))
    F += mpm.contact(needle, points, V.increment, V.test)
    mpm.QuasiStatic(F, V.increment, points, mpm.fixed(V, "bottom")).step()


def RoughShapeWarning():
    grid = mesh.create_unit_square(MPI.COMM_WORLD, 4, 4, mesh.CellType.quadrilateral)
    mpm.fill(grid, mpm.Ball((0.5, 0.5), 0.26), per_cell=1, density=1.0)


def SoftVolumeWarning():
    points, V = block(basis="bspline3")
    clay = mpm.materials.CamClay(
        swelling=0.02, compression=0.13, M=1.05, mu0=5e6, alpha=0.0,
        reference_pressure=2e4, preconsolidation=2e4,
    )  # fmt: skip
    F = mpm.momentum(clay, points, V.increment, V.test, fbar=True)
    mpm.QuasiStatic(F, V.increment, points)


def UnstablePairWarning():
    points, V = block()
    Q = mpm.Space(points.grid, "gimp", shape=())
    mpm.poromechanics(
        SOIL, points, (V.increment, Q.increment), (V.test, Q.test),
        porosity=0.4, permeability=1e-3, projection="none",
    )  # fmt: skip


def UnreadOptionWarning():
    points, V = block()
    down = mpm.prescribed(V, lambda x: x[1] > 0.4, 1, increment=-0.01)
    problem(points, V, *mpm.fixed(V, "bottom"), *down, petsc_options={"ksp_tpye": "cg"}).step()


def FreeMotionWarning():
    points, V = block()
    problem(points, V, *mpm.rollers(V, "bottom")).step()  # free along x


def HeldLoadWarning():
    points, V = block()
    base = mpm.Boundary.from_polygon(points, [(0, 0), (1, 0)], closed=False)
    F = mpm.momentum(SOIL, points, V.increment, V.test)
    F += mpm.dirichlet(base, V.increment, V.test, law=SOIL)
    F += base.pressure(1e3, V.increment, V.test)
    mpm.QuasiStatic(F, V.increment, points, stabilisation="ghost")


def BuriedLoadWarning():
    points, V = block()
    middle = mpm.Boundary.from_polygon(points, [(1, 0.25), (0, 0.25)], closed=False)
    F = mpm.momentum(SOIL, points, V.increment, V.test)
    F += middle.pressure(1e3, V.increment, V.test)
    mpm.QuasiStatic(F, V.increment, points, mpm.fixed(V, "bottom"))


def IdlePointsWarning():
    points, V = block()
    points["tag"][points["x"][:, 1] < 0.4] = 3
    F = mpm.momentum(SOIL, points, V.increment, V.test, tag=0)
    mpm.QuasiStatic(F, V.increment, points, mpm.fixed(V, "bottom")).step()


def LocalValueWarning():
    points, _ = block()
    history = mpm.History()
    history.record(volume=float(points["V"].sum() + points.comm.rank))
    folder = points.comm.bcast(tempfile.mkdtemp())
    history.write(f"{folder}/volume.csv")


def LongPiecesWarning():
    points, _ = block()
    V = mpm.Space(points.grid, "gimp", refine=lambda x: np.full(x.shape[1], 0.1), levels=1)
    base = mpm.Boundary.from_polygon(points, [(0, 0), (1, 0)], closed=False)
    F = mpm.momentum(SOIL, points, V.increment, V.test)
    F += mpm.dirichlet(base, V.increment, V.test, law=SOIL)
    mpm.QuasiStatic(F, V.increment, points, stabilisation="ghost").step()


def SectionAtEndWarning():
    points, _ = block()
    mpm.section_forces(points, place=(0, 0), normal=(0, 1))  # at its base


def DoubtfulInputWarning():
    record = mpm.InputMotion([0.0, 1.0, 2.0, 3.0], acceleration=[0.0, 300.0, -300.0, 0.0])  # cm/s²
    record(3.0)


def DriftingRecordWarning():
    pulse = mpm.InputMotion([0.0, 1.0, 2.0], acceleration=[0.0, 1.0, 0.0])
    pulse(3.0)


def LostMomentumWarning():
    points, V = block()
    F = mpm.momentum(SOIL, points, V.increment, V.test)
    mpm.Explicit(F, V.increment, points, mass_cutoff=0.1)


def SingularMassWarning():
    grid = mesh.create_interval(MPI.COMM_WORLD, 44, [0.0, 22.0])
    body = mpm.Box((0.5001,), (10.5001,))  # its last cell is cut to a sliver
    points = mpm.fill(grid, body, per_cell=2, density=1.0, aligned="body")
    wave = lambda x: 1 + 0.1 * np.cos(np.pi * (x.T - 0.5001) / 10)  # noqa: E731
    points.add_field("velocity", (1,), "m/s", wave)
    V = mpm.Space(grid, "gimp")
    F = mpm.momentum(mpm.materials.Hencky(100.0, 0.0), points, V.increment, V.test)
    flying = mpm.Newmark(F, V.increment, points, mapping="flip", ghost_mass=0.0)
    for t in mpm.times(10.0, dt=0.05):
        flying.step(t)


def ImbalanceWarning():
    grid = mesh.create_unit_square(MPI.COMM_WORLD, 16, 16)  # triangles
    points = mpm.fill(grid, mpm.Box((0, 0), (0.2, 0.2)), per_cell=2, density=1.0)
    V = mpm.Space(grid, "linear")
    problem(points, V, *mpm.fixed(V, "bottom")).step()
