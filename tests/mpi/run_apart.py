"""What ranks do that is not the same on all of them, as `run_apart.py NAME`."""

from __future__ import annotations

import sys
import tempfile
import time

import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

import dolfinmpm as mpm
from dolfinmpm._platform.collective import collective

COMM = MPI.COMM_WORLD
FIRST = COMM.rank == 0


def problem() -> mpm.QuasiStatic:
    """A block that has taken a step. Collective."""
    grid = mesh.create_rectangle(COMM, [(0, 0), (2, 1)], (4, 2), mesh.CellType.quadrilateral)
    points = mpm.fill(grid, mpm.Box((0, 0), (2, 1)), 2, 1000.0)
    V = mpm.Space(grid)
    F = mpm.momentum(mpm.materials.Hencky(1e6, 0.3), points, V.increment, V.test)
    F -= ufl.inner(fem.Constant(grid, (0.0, -1.0)), V.test) * points.dX
    made = mpm.QuasiStatic(F, V.increment, points, mpm.fixed(V, "bottom"))
    made.step()
    return made


def motion() -> mpm.Explicit:
    """The same in explicit steps. Collective."""
    still = problem()
    space = still.form.spaces[0]
    return mpm.Explicit(still.form.given, space.increment, still.points, still.bcs)


def series(one: mpm.QuasiStatic) -> mpm.ParaView:
    """A series in a folder of this rank. Collective."""
    return mpm.ParaView(f"{FOLDER}/series.pvd", one.points)


FOLDER = COMM.bcast(tempfile.mkdtemp() if FIRST else None)


def recorded(_: object) -> mpm.History:
    """A record of one number. Not collective."""
    history = mpm.History(COMM)
    history.record(load=1.0)
    return history


# calls that rank 0 makes alone: what all make before, and the call
ALONE = {
    "step": (problem, lambda one: one.step()),
    "step in time": (motion, lambda one: one.step(1e-4)),
    "energies": (motion, lambda one: one.energies()),
    "critical_step": (motion, lambda one: one.critical_step()),
    "save": (problem, lambda one: one.save(f"{FOLDER}/a.npz")),
    "load": (problem, lambda one: one.load(f"{FOLDER}/a.npz")),
    "info": (problem, lambda one: one.info()),
    "stiffness": (problem, lambda one: one.stiffness()),
    "gather": (problem, lambda one: one.points.gather("x")),
    "remove": (problem, lambda one: one.points.remove(tag=0)),
    "plot": (problem, lambda one: mpm.plot(one.points, f"{FOLDER}/a.png")),
    "ParaView": (problem, series),
    "write": (lambda: series(problem()), lambda one: one.write(0.0)),
    "table": (problem, lambda _: mpm.study.write_table([{"a": 1}], f"{FOLDER}/a.csv")),
    "History.write": (lambda: recorded(problem()), lambda one: one.write(f"{FOLDER}/a.csv")),
    "fill": (problem, lambda one: mpm.fill(one.points.grid, mpm.Box((0, 0), (1, 1)), 2, 1.0)),
    "Space": (problem, lambda one: mpm.Space(one.points.grid, "gimp")),
    "fixed": (problem, lambda one: mpm.fixed(one.form.spaces[0], "left")),
    "set_stress": (
        problem,
        lambda one: mpm.set_stress(mpm.materials.Hencky(1e6, 0.3), one.points, lambda x: 0 * x),
    ),
}


def alone(name: str) -> None:
    """Rank 0 makes a call, the others come to their end."""
    before, call = ALONE[name]
    made = before()
    if FIRST:
        call(made)


def beside() -> None:
    """Rank 0 makes a call, the others wait in one of MPI's."""
    made = problem()
    if FIRST:
        made.step()
    COMM.Barrier()


def at_first() -> None:
    """The first call is made by rank 0 alone."""
    cells = (2, 2), mesh.CellType.quadrilateral
    grid = mesh.create_rectangle(COMM, [(0, 0), (1, 1)], *cells)
    if FIRST:
        mpm.fill(grid, mpm.Box((0, 0), (1, 1)), 2, 1.0)
    COMM.Barrier()


@collective
def work(comm: MPI.Comm, seconds: float, fails: bool = False, waits: bool = False) -> None:
    """A call whose last rank takes some seconds, or leaves it by an error that the others miss."""
    if comm.rank == comm.size - 1:
        time.sleep(seconds)
        if fails:
            raise mpm.errors.StateError("of one rank")
    elif waits:
        comm.Barrier()


def slow() -> None:
    """Ranks that take long, within a call and outside of one, are waited for."""
    work(COMM, 9.0)
    work(COMM, 0.0)
    time.sleep(6.5 * (not FIRST))
    work(COMM, 0.0)
    print("all are here", flush=True)


def left() -> None:
    """The last rank leaves a call by an error that it catches, and goes on to the next."""
    try:
        work(COMM, 0.0, fails=True, waits=True)
    except mpm.errors.StateError:
        work(COMM, 0.0)


def halves() -> None:
    """Grids of some of the ranks each: they meet among themselves, and nobody waits for others."""
    comm = COMM.Split(COMM.rank // 2)
    work(comm, 1.0 if comm.size > 1 else 0.0)
    grid = mesh.create_unit_square(comm, 4, 4, mesh.CellType.quadrilateral)
    points = mpm.fill(grid, mpm.Box((0, 0), (1, 1)), 2, 1.0 + COMM.rank // 2)
    masses = COMM.gather(comm.allreduce(float(points["density"] @ points["V0"])))
    work(COMM, 0.0)
    if FIRST:
        print("masses", *masses, flush=True)


if __name__ == "__main__":
    name = sys.argv[1]
    if name in ALONE:
        alone(name)
    else:
        {f.__name__: f for f in (beside, at_first, slow, left, halves)}[name]()
