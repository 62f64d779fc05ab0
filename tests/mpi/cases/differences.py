"""What ranks give differently, or only one of them: errors on all ranks, and no hang."""

from __future__ import annotations

import functools
import tempfile
import warnings
from pathlib import Path

import numpy as np
import ufl
from badinputs import scene
from dolfinx import fem, mesh

import dolfinmpm as mpm

from .arguments import _differs, _ends, _last
from .common import COMM


def more_of_different_ranks():
    """Calls that are not the same on all ranks: further public names."""
    s = scene()
    before = s.points["x"].copy()
    if COMM.size > 1:
        with tempfile.TemporaryDirectory() as folder:
            # that of rank 0, so that paths are alike
            at = Path(COMM.bcast(folder))
            for texts in (_of_bodies(s), _of_problems(s), _of_files(s, at), _of_studies(s, at)):
                for call, *words in texts:
                    _differs(call, *words)
            _on_one_rank(s, at)
            COMM.barrier()
    # the scene is shared with other cases, and none of these calls may move it
    return {"change": float(COMM.allreduce(np.abs(s.points["x"] - before).sum()))}


def _fresh(s, **options):
    points, V = s.fill(), mpm.Space(s.grid)
    F = s.momentum(points=points, u=V.increment, v=V.test)
    g = fem.Constant(s.grid, (0.0, -1e-3))
    F -= ufl.inner(points.density * g, V.test) * points.dX
    return mpm.QuasiStatic(F, V.increment, points, mpm.fixed(V, "bottom"), **options)


def _of_bodies(s):
    box = lambda x: mpm.fill(s.grid, mpm.Box((2, 0), (x, 1)), 2, 1.0)  # noqa: E731
    zone = lambda b: mpm.zoned_line(0, 4, (1, b), (2, 2, 2))  # noqa: E731
    wave = functools.partial(mpm.absorbing, s.V, "left", density=1.0)
    return [
        (lambda: mpm.probe(s.points, (0.5, _last(0.5, 0.6))), "place differs"),
        (lambda: wave(p_speed=_last(2.0, 3.0)), "p_speed differs"),
        (lambda: mpm.frictional(s.V, "left", friction=_last(0.1, 0.2)), "friction differs"),
        (lambda: mpm.create_lattice(COMM, [zone(_last(2, 2.5)), [0, 1, 2]]), "lines differs"),
        (lambda: mpm.MaterialPoints.from_csv(s.grid, _last("a.csv", "b.csv")), "path differs"),
        (lambda: s.fill().remove(tag=_last(0, 1)), "tag differs"),
        (lambda: s.fill().add(box(_last(3, 4))), "high of shape differs"),
        (lambda: mpm.partitioner(mpm.Box((0, 0), (1, _last(1, 2))), s.grid), "high of shape"),
        (lambda: mpm.Space(s.grid, "gimp", domains=_last("stretch", "fixed")), "domains differs"),
        (lambda: s.points.gather(_last("x", "V")), "names differs"),
        (lambda: mpm.RigidFooting(s.top, s.c, E=_last(1e4, 2e4)), "E differs"),
    ]


def _of_problems(s):
    V = mpm.Space(s.grid)
    side = mpm.Boundary.from_side(s.points, "left")
    explicit = functools.partial(s.motion, mpm.Explicit)
    touch = lambda: mpm.contact(  # noqa: E731
        s.tool, s.points, s.u, s.v, penetration=_last(1e-3, 2e-3)
    )
    hold = lambda x: mpm.dirichlet(side, s.u, s.v, (x, 0.0), law=s.law)  # noqa: E731
    before = lambda e: mpm.carried(s.points, "before", e)  # noqa: E731
    rate = lambda e: (s.u[0] - before(e)) * s.v[0] * s.points.dX  # noqa: E731
    on = mesh.locate_entities_boundary(s.grid, 1, lambda x: np.isclose(x[0], 0.0))
    tags = mesh.meshtags(s.grid, 1, np.sort(on), np.full(len(on), 7, np.int32))
    over = lambda data, tag: s.v[0] * ufl.Measure("ds", s.grid, subdomain_data=data)(tag)  # noqa: E731
    return [
        (lambda: s.solver(form=s.F + over(tags, _last(7, 8))), "subdomain of term"),
        (lambda: s.solver(form=s.F + over(_last(tags, None), 7)), "subdomain of term"),
        (lambda: s.solver(form=s.F + s.v[0] * s.points.dX(_last(0, 1))), "subdomain of term"),
        (lambda: s.solver(increment=_last(V.increment, s.u)), "order among the spaces of its grid"),
        (lambda: s.solver(form=s.F + touch()), "penetration of contact"),
        (lambda: s.solver(form=s.F + hold(_last(1e-3, 2e-3))), "constant"),
        (lambda: s.solver(form=s.F + hold(_last(0.0, 1e-3))), "form differs"),
        (lambda: s.solver(form=s.F + side.pressure(_last(1.0, 2.0), s.u, s.v)), "constant"),
        (lambda: s.solver(form=_last(s.F, s.F + s.ghost())), "form differs"),
        (lambda: s.solver(form=s.F + rate(s.u[_last(0, 1)])), "indices of"),
        (lambda: explicit(mapping=_last("flip", "pic")), "mapping differs"),
        (lambda: explicit(fused=_last(True, False)), "fused differs"),
        (lambda: explicit(collision=mpm.Collision((0, _last(1, 2)))), "tags of collision differs"),
        (lambda: _fresh(s).step(*_last((), (1.0,))), "t differs between ranks: None on"),
        (lambda: mpm.equilibrate(_fresh(s), tolerance=_last(1e-9, 1e-8)), "tolerance differs"),
    ]


def _of_files(s, at):
    writer = mpm.ParaView(at / "b.pvd", s.points)
    history = mpm.History()
    history.record(a=1.0)
    return [
        (lambda: _fresh(s).load(at / _last("a.npz", "b.npz")), "path differs"),
        (
            lambda: mpm.ParaView(at / "a.pvd", s.points, fields=_last(["stress"], ["F"])),
            "fields differs",
        ),
        (lambda: writer.write(_last(1.0, 2.0)), "time differs"),
        (lambda: history.write(at / _last("h.csv", "h.json")), "path differs"),
        (
            lambda: s.plot(at / "x.png", "stress", component=_last((0, 0), (1, 1))),
            "component differs",
        ),
    ]


def _of_studies(s, at):
    solver = _fresh(s)
    strength = functools.partial(mpm.study.factor_of_safety, solver, 1.0)

    def run(m):
        problem = _fresh(s)
        return mpm.study.Run(problem, [problem.step], {"y": lambda: m["a"]})

    def fitted(y, **options):
        return mpm.study.calibrate(run, {"a": 1.0}, {"y": [y]}, **options)

    return [
        (lambda: mpm.study.differentiate(run, {"a": _last(1.0, 2.0)}), "a of parameters differs"),
        (lambda: fitted(_last(3.0, 4.0)), "y of measured differs"),
        (lambda: fitted(3.0, bounds={"a": (0.5, _last(8.0, 9.0))}), "a of bounds differs"),
        (lambda: fitted(3.0, max_runs=_last(8, 9)), "max_runs differs"),
        (lambda: strength(_last(2.0, 3.0)), "high differs between ranks: 2.0 on"),
        (lambda: mpm.study.conditioning(solver, _last(1.0, 2.0)), "density differs"),
        (lambda: mpm.study.write_table([], at / _last("a.csv", "b.csv")), "path differs"),
    ]


def _recorded(at, last):
    """Records of one rank, and numbers that a rank has of its own points."""
    history = mpm.History()
    if not last:
        history.record(a=1.0)
    assert "nothing has been recorded" in _ends(lambda: history.write(at / "h.csv"))
    history = mpm.History()
    own = {"n": 1.0, "tiny": 1e-17 * last, "none": np.nan, "solve": 2.0 * last}
    for k in range(2):
        history.record(load=3.0 + last * k, sum=1.0 + 1e-12 * last, **own)
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        history.write(at / "local.csv")
    told = [str(w.message) for w in seen if w.category is mpm.errors.LocalValueWarning]
    assert len(told) == (COMM.rank == 0)
    assert all("record(load=...) differs between ranks: 3 on rank 0, 4 on" in t for t in told)
    assert all("in record 2" in t and "comm.allreduce" in t for t in told)


def _on_one_rank(s, at) -> None:
    """What is wrong on one rank alone, which the others cannot know."""
    last = COMM.rank == COMM.size - 1

    def summed(m):
        problem = _fresh(s)
        own = {"y": lambda: m["a"] * (1.0 + len(problem.points) + COMM.rank)}
        return mpm.study.Run(problem, [problem.step], own)

    text = _ends(lambda: mpm.study.differentiate(summed, {"a": 1.0}))
    assert "measured['y'] is" in text
    assert "a figure is equal on all ranks" in text
    for name, value, words in (
        ("density", np.nan, "density = nan"),
        ("density", -5.0, "density = -5.0"),
        ("V0", -1.0, "first volume = -1.0"),
        ("x", 9.0, "is not in the cell"),
    ):
        problem = _fresh(s)
        # the first rank that has points
        has = COMM.allgather(len(problem.points) > 0)
        if COMM.rank == has.index(True):
            problem.points[name] = problem.points[name] * 0 + value
        assert words in _ends(problem.step)
    # rows, vectors and records of one rank
    rows = 3 if last else [{"a": 1.0}]
    assert "rows = 3" in _ends(lambda: mpm.study.write_table(rows, at / "a.csv"))
    matrix = s.solver().stiffness()
    kernel = np.ones((1 + matrix.getLocalSize()[0], 1)) if last else None
    assert "kernel" in _ends(lambda: mpm.study.condition_number(matrix, kernel=kernel))
    kernel = np.ones((matrix.getLocalSize()[0], 1)) if last else None
    assert "vectors on the ranks" in _ends(
        lambda: mpm.study.condition_number(matrix, kernel=kernel)
    )
    _recorded(at, last)
    # functions that fail on one rank
    index = 2 if last else 0
    where = mpm.Where(lambda x: x[index] < 9)
    assert "IndexError" in _ends(lambda: mpm.fill(s.grid, where, 2, 1.0))
    level = np.nan if last else 1.0
    phi = lambda x: x[0] - level  # noqa: E731
    assert "phi = nan" in _ends(lambda: mpm.Boundary.from_level_set(s.points, phi))
    # a grid that one rank has scaled since
    grid = mesh.create_rectangle(COMM, [(0, 0), (4, 2)], (8, 4), mesh.CellType.quadrilateral)
    points, V = mpm.fill(grid, mpm.Box((0, 0), (2, 1)), 2, 1.0), mpm.Space(grid)
    if last:
        grid.geometry.x[:] *= 1000
    F = mpm.momentum(s.law, points, V.increment, V.test)
    assert "have been changed" in _ends(lambda: mpm.QuasiStatic(F, V.increment, points))
