"""Runs that are interrupted, and what they go on with."""

from __future__ import annotations

import resource
import shutil
import tempfile
import zipfile
from pathlib import Path

import numpy as np
import ufl
from dolfinx import fem, mesh
from scenes import arch

import dolfinmpm as mpm
from dolfinmpm._platform.errors import CheckpointError

from .common import COMM, sums

# MUMPS on several ranks adds up what comes from others as it comes: its last bits are not the
# same in any two runs. One rank's factorisation, which all make, has the same ones.
REPEATABLE = {"pc_type": "redundant"}


def varying(x, k):
    """A load that varies in space, in step k."""
    return np.array([0.002 * k * x[0] * x[1], -0.01 * k * x[1]])


def block(stabilisation="ghost", basis="gimp", body=False, **options):
    """A block that yields and collapses under its weight; its points change rank."""
    kind = mesh.CellType.triangle if basis == "linear" else mesh.CellType.quadrilateral
    grid = mesh.create_rectangle(COMM, [(0, 0), (12, 6)], (12, 6), kind)
    points = mpm.fill(grid, mpm.Box((0, 0), (6, 5.4)), 2, 1000.0)
    V = mpm.Space(grid, basis)
    g = fem.Constant(grid, (0.0, 0.0))
    law = mpm.materials.VonMises(E=1e6, nu=0.3, radius=lambda x: 1e4 + 1e3 * x[1])
    F = mpm.momentum(law, points, V.increment, V.test)
    F -= ufl.inner(points.density * g, V.test) * points.dX
    b = fem.Function(fem.functionspace(grid, ("Lagrange", 2, (2,))))
    if body:
        F -= ufl.inner(points.density * b, V.test) * points.dX
    bcs = mpm.rollers(V, "left", "bottom")
    stabilisation = mpm.Stabilisation(stabilisation, E=1e6)
    problem = mpm.QuasiStatic(F, V.increment, points, bcs, stabilisation=stabilisation, **options)

    def step():
        k = len(problem.history) + 1
        g.value[1] = -0.8 * k
        b.interpolate(lambda x: varying(x, k))
        return problem.step()

    return (problem, step, b) if body else (problem, step)


def temporary_folder():
    return Path(COMM.bcast(tempfile.mkdtemp() if COMM.rank == 0 else None))


def remove(folder):
    COMM.barrier()
    if COMM.rank == 0:
        shutil.rmtree(folder)


def _bits(problem):
    """All that the points of this rank have, and the records of the steps but their times."""
    fields = {name: values.tobytes() for name, values in problem.points.fields.items()}
    return fields, [vars(record) | {"seconds": None, "stages": None} for record in problem.history]


def goes_on(build, steps, moves=True):
    """The figures of a run; one that went on in the middle has the same bits on every rank."""
    folder = temporary_folder()
    problem, step = build()
    for k in range(steps):
        step()
        if k == steps // 2:
            problem.save(folder / "middle.npz")
    again, step = build()
    again.load(folder / "middle.npz")
    while len(again.history) < steps:
        step()
    assert _bits(again) == _bits(problem)
    remove(folder)
    moved = sum(record.migrated for record in problem.history)
    figures = {"moved": moved} if moves else {}
    return figures | {"steps": steps, **sums(problem.points, "x", "F", "stress")}


def restart_ghost():
    """A column that yields, with ghost penalty."""
    return goes_on(lambda: block(petsc_options=REPEATABLE, tolerance=1e-12), 9)


def restart_aggregation():
    """The same with aggregation."""
    return goes_on(lambda: block("aggregation", petsc_options=REPEATABLE, tolerance=1e-12), 9)


def restart_triangles():
    """The same on triangles, whose roots are looked for on all ranks."""
    options = {"petsc_options": REPEATABLE, "tolerance": 1e-12}
    return goes_on(lambda: block("aggregation", "linear", **options), 9)


def restart_splines():
    """The same with splines, whose facet terms have one tensor for all that are alike."""
    options = {"petsc_options": REPEATABLE, "tolerance": 1e-12}
    return goes_on(lambda: block("ghost", "bspline2", **options), 5, moves=False)


def restart_arch():
    """An arc length that goes on."""
    return goes_on(lambda: arch(petsc_options=REPEATABLE), 9, moves=False)


def _refused(action, problem):
    """The error of every rank; nothing of the problem changes."""
    before, found = _bits(problem), ""
    try:
        action()
    except CheckpointError as error:
        found = str(error)
    assert found
    assert len(set(COMM.allgather(found))) == 1
    assert _bits(problem) == before
    return found


def restart_errors():
    """What rank 0 finds wrong with a file is raised on all ranks, and the state stays."""
    folder = temporary_folder()
    problem, step = block()
    step()
    problem.save(folder / "a.npz")
    step()
    assert "there is no file" in _refused(lambda: problem.load(folder / "b.npz"), problem)
    missing = folder / "missing" / "a.npz"
    assert "is its folder there" in _refused(lambda: problem.save(missing), problem)
    if COMM.rank == 0:
        data = (folder / "a.npz").read_bytes()
        (folder / "cut.npz").write_bytes(data[:-1000])
        with zipfile.ZipFile(folder / "a.npz") as file:
            # behind the names in front of the array
            at = file.getinfo("points/stress.npy").header_offset + 256
        (folder / "flipped.npz").write_bytes(data[:at] + bytes([data[at] ^ 1]) + data[at + 1 :])
    COMM.barrier()
    assert "cut short" in _refused(lambda: problem.load(folder / "cut.npz"), problem)
    # told only after rows have gone to other ranks
    assert "damaged" in _refused(lambda: problem.load(folder / "flipped.npz"), problem)
    other = arch()[0]
    assert "of another grid" in _refused(lambda: other.load(folder / "a.npz"), other)
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, limits[1]))
    try:
        assert "disk" in _refused(lambda: problem.save(folder / "a.npz"), problem)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    problem.load(folder / "a.npz")
    assert len(problem.history) == 1
    names = sorted(path.name for path in folder.iterdir())
    assert names == ["a.npz", "cut.npz", "flipped.npz"]
    remove(folder)
    return {"files": len(names)}
