"""Bad inputs on every rank, and on one rank alone: errors on all ranks, and no hang."""

from __future__ import annotations

import contextlib
import re
import tempfile
import warnings

import numpy as np
import ufl
from badinputs import BAD, scene
from dolfinx import fem, mesh

import dolfinmpm as mpm
from dolfinmpm._platform import errors

from .common import COMM


def _ends(call) -> str:
    """What a call ends with on all ranks: one dolfinmpm error of one kind. Collective."""
    try:
        call()
    except errors.DolfinMPMError as error:
        kind, text = type(error).__name__, str(error)
    else:
        kind = text = "nothing"
    assert set(COMM.allgather(kind)) == {kind}, (kind, text)
    assert kind != "nothing"
    return text


def bad_inputs():
    """Every bad input ends with the same kind of error on all ranks."""
    s = scene()
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        for call, _ in BAD.values():
            _ends(lambda call=call: call(s))
    return {"tried": len(BAD)}


def of_one_rank():
    """What differs on one rank, or goes wrong on one rank only."""
    s = scene()
    last = COMM.rank == COMM.size - 1
    if COMM.size > 1:
        short = s.bcs[:-1] if last else s.bcs
        text = _ends(lambda: s.solver(bcs=short))
        assert "bcs differs between ranks" in text
        assert "every rank must build the same problem" in text
        swapped = s.bcs[::-1] if last else s.bcs
        assert "bcs differs" in _ends(lambda: s.solver(bcs=swapped))
        text = _ends(lambda: s.solver(tolerance=1e-8 if last else 1e-9))
        assert "tolerance differs between ranks: 1e-09 on rank 0" in text
        assert "stabilisation differs" in _ends(
            lambda: s.solver(stabilisation="ghost" if last else "none")
        )
        assert "petsc_options differs" in _ends(
            lambda: s.solver(petsc_options={"snes_rtol": 1e-3 if last else 1e-4})
        )

    def fails(x):
        if last:
            raise RuntimeError("only here")
        return x[0] >= 0

    assert "only here" in _ends(lambda: mpm.fixed(s.V, fails))
    wrong = lambda x: x[0] if last else x[0] >= 0  # noqa: E731
    assert "booleans" in _ends(lambda: mpm.fixed(s.V, wrong))
    text = _ends(lambda: mpm.prescribed(s.V, lambda x: x[0] >= 0, 0,
                                        lambda x: np.nan if last else 0.0))  # fmt: skip
    assert "must be finite" in text
    # a function that is not a number on one rank
    f = fem.Function(s.S.function_space, name="pressure")
    problem = s.solver(form=s.F - f * s.v[0] * s.points.dX)
    f.x.array[:] = np.nan if last else 0.0
    assert "function pressure is not finite in the term" in _ends(problem.step)
    f.x.array[:] = 0.0
    # rank 0 warns, once
    idle = [*s.bcs, *mpm.rollers(s.V, "right", "top")]
    s.g.value[:] = 0.0, -1e-3
    problem = s.solver(bcs=idle)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        problem.step()
    told = [w for w in caught if w.category is errors.IdleConditionWarning]
    assert len(told) == (COMM.rank == 0)
    # and nothing is left of what was refused
    return {"x": float(COMM.allreduce(np.abs(s.points["x"]).sum()))}


def of_few_cells():
    """Messages on ranks that have no cell and no point."""
    grid = mesh.create_rectangle(COMM, [(0, 0), (1, 1)], (1, 1), mesh.CellType.quadrilateral)
    points = mpm.fill(grid, mpm.Box((0, 0), (1, 0.5)), 2, 1.0)
    V = mpm.Space(grid)
    u, v = V.increment, V.test
    g = fem.Constant(grid, (0.0, 0.0))
    g.name = "gravity"
    F = mpm.momentum(mpm.materials.Hencky(1e3, 0.3), points, u, v) - ufl.inner(g, v) * points.dX
    texts = [
        _ends(lambda: mpm.fixed(V, lambda x: x[0] > 7)),
        _ends(lambda: mpm.prescribed(V, lambda x: x[1] > 0.5, 0, lambda x: np.nan * x[0])),
        _ends(lambda: mpm.Surface(points, lambda x: x[1] > 7, (0, 1))),
        _ends(lambda: mpm.plot(points, "a.foo")),
    ]
    assert "they lie from [0. 0.] to [1. 1.] m" in texts[0]
    assert "is nan at the node at [0. 1.] m" in texts[1]
    assert "lie between 0.5 and 0.5 m" in texts[2]
    assert "Matplotlib writes" in texts[3]
    problem = mpm.QuasiStatic(F, u, points, mpm.rollers(V, "left"), max_halvings=0)
    g.value[:] = 0.0, np.nan
    assert "gravity = [ 0. nan] is not finite" in _ends(problem.step)
    g.value[:] = 0.0, -1.0
    text = _ends(problem.step)
    assert "rigid motions along y" in text
    assert re.search(r"the worst is point \d at \[0\.\d+ 0\.25\] m", text), text
    g.value[:] = 0.0, -1e-3
    mpm.QuasiStatic(F, u, points, mpm.fixed(V, "bottom")).step()
    return {"x": float(COMM.allreduce(np.abs(points["x"]).sum()))}
