"""Tables of studies, which one rank writes and reads for all."""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path

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
