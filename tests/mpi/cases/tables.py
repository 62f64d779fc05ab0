"""Tables of studies and films, which one rank writes for all."""

from __future__ import annotations

import hashlib
import shutil
import tempfile
from pathlib import Path

from dolfinx.mesh import CellType, create_unit_square

import dolfinmpm as mpm

from .common import COMM


def tables():
    """Rank 0 writes a table, all ranks read the same rows; orders agree on all."""
    folder = COMM.bcast(tempfile.mkdtemp() if COMM.rank == 0 else None)
    path = Path(folder) / "table.csv"
    rows = mpm.study.convergence(lambda h: COMM.allreduce(h**2 / COMM.size), [0.5, 0.25])
    mpm.study.write_table(rows, path)
    assert mpm.study.read_table(path) == rows
    COMM.barrier()
    if COMM.rank == 0:
        shutil.rmtree(folder)
    return {"order": rows[1]["error_order"]}


def films():
    """A film of a run, and one of its files: the same pictures on any number of ranks."""
    folder = Path(COMM.bcast(tempfile.mkdtemp() if COMM.rank == 0 else None))
    grid = create_unit_square(COMM, 4, 4, CellType.quadrilateral)
    points = mpm.fill(grid, mpm.Box((0, 0), (1, 0.5)), 2, 1.0)
    look = {"size": (3.1, 2.3), "dpi": 50}
    with mpm.animate(points, folder / "run.gif", "density", **look) as film:
        film.write(0.0)
    mpm.ParaView(folder / "run.pvd", points).write(0.0)
    mpm.animate(folder / "run.pvd", folder / "files.gif", "density", **look)
    found = {}
    if COMM.rank == 0:
        for name in ("run", "files"):
            content = hashlib.sha256((folder / f"{name}.gif").read_bytes()).digest()
            found[name] = int.from_bytes(content[:4])
    found = COMM.bcast(found)
    COMM.barrier()
    if COMM.rank == 0:
        shutil.rmtree(folder)
    return found
