"""Kill a run that steps and saves at random times, and go on from its file, time and again.

`kill_and_go_on.py KILLS` prints how it went as JSON. Every run is a process forked off one
that has built the problem and never stepped, so that it begins as a new one would, without
the seconds of a start. Half of the runs save a large body over and over, which are killed
while they write.
"""

from __future__ import annotations

import hashlib
import json
import os
import random
import signal
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

import dolfinmpm as mpm

STEPS = 25


def column(width, per_cell):
    """A column that yields under its growing weight."""
    grid = mesh.create_rectangle(
        MPI.COMM_WORLD, [(0, 0), (width, 12)], (width, 12), mesh.CellType.quadrilateral
    )
    points = mpm.fill(grid, mpm.Box((0, 0), (width, 10)), per_cell, 1000.0)
    V = mpm.Space(grid, "gimp")
    g = fem.Constant(grid, (0.0, 0.0))
    law = mpm.materials.VonMises(E=1e6, nu=0.3, radius=2e4)
    F = mpm.momentum(law, points, V.increment, V.test)
    F -= ufl.inner(points.density * g, V.test) * points.dX
    bcs = mpm.fixed(V, "bottom") + mpm.rollers(V, "left")
    ghost = mpm.Stabilisation("ghost", E=1e6)
    return mpm.QuasiStatic(F, V.increment, points, bcs, stabilisation=ghost), g


def go_on(problem, g, path, steps=STEPS):
    """Steps that are left, each saved."""
    if path.exists():
        problem.load(path)
    for k in range(len(problem.history), steps):
        g.value[1] = -0.12 * (k + 1)
        problem.step()
        problem.save(path)


def digest(problem):
    """All the points' bits and all records but their seconds, as one word."""
    found = hashlib.sha256()
    for name in sorted(problem.points.fields):
        found.update(np.ascontiguousarray(problem.points.fields[name]).tobytes())
    records = [vars(record) | {"seconds": None, "stages": None} for record in problem.history]
    found.update(json.dumps(records).encode())
    return found.hexdigest()


def forked(action, after=None):
    """Act in a process of its own, which may be killed so many seconds after its beginning.

    Returns whether it was killed.
    """
    child = os.fork()
    if child == 0:
        try:
            action()
        except BaseException as error:
            print(repr(error), file=sys.stderr, flush=True)
            os._exit(1)
        os._exit(0)
    if after is not None:
        time.sleep(after)
        os.kill(child, signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    assert os.WIFSIGNALED(status) or os.WEXITSTATUS(status) == 0
    return os.WIFSIGNALED(status)


def result(problem, g, path):
    """Digest of a run that ends, in a process of its own."""
    told = path.with_suffix(".digest")

    def end():
        go_on(problem, g, path)
        told.write_text(digest(problem))

    started = time.perf_counter()
    forked(end)
    return told.read_text(), time.perf_counter() - started


def parts(folder):
    """How many files killed writers have left."""
    return len(list(folder.glob("*.part-*")))


def kill_steps(kills, folder):
    """Kill a run in its steps and saves; returns kills in writing, and whether bits agree."""
    chance, in_writing = random.Random(8), 0
    problem, g = column(2, 2)
    # kernels are compiled in a process that is left alone
    forked(lambda: go_on(problem, g, folder / "first.npz", 2))
    expected, seconds = result(problem, g, folder / "whole.npz")
    path = folder / "run.npz"
    while kills:
        if forked(lambda: go_on(problem, g, path), chance.uniform(0.0, 0.4) * seconds):
            kills -= 1
            in_writing += parts(folder)
            if path.exists():
                forked(lambda: problem.load(path))
        else:
            path.unlink()  # it was done before: once more
    same = result(problem, g, path)[0] == expected
    return in_writing, same and parts(folder) == 0


def kill_saves(kills, folder):
    """Kill a run that saves a large body over and over; returns kills in writing."""
    chance, in_writing = random.Random(9), 0
    problem, _ = column(12, 12)
    target, first = folder / "large.npz", problem.points["x"].copy()
    problem.save(target)

    def save_for_ever():
        for k in range(1_000_000):
            problem.points["x"][:] = first + 1e-6 * k
            problem.share = 1.0 / (k + 1)
            problem.save(target)

    def check():
        # all in the file is of one and the same save
        problem.load(target)
        saves = round(1.0 / problem.share) - 1
        assert np.array_equal(problem.points["x"], first + 1e-6 * saves)

    for _ in range(kills):
        assert forked(save_for_ever, chance.uniform(0.05, 0.4))
        in_writing += parts(folder)
        forked(check)
    # the next writer clears up
    forked(lambda: problem.save(target))
    assert parts(folder) == 0
    return in_writing


def main(kills, folder):
    """Figures of all kills; what goes wrong in a process ends the script."""
    in_steps, same = kill_steps(kills // 2, folder)
    in_saves = kill_saves(kills - kills // 2, folder)
    return {"kills": kills, "in writing": in_steps + in_saves, "same bits": same}


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as name:
        print(json.dumps(main(int(sys.argv[1]), Path(name))))
