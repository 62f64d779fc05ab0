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
                                        increment=lambda x: np.nan if last else 0.0))  # fmt: skip
    assert "must be finite" in text
    # stresses that are too few on one rank, or changed there only
    own = len(s.points)
    text = _ends(lambda: s.points.__setitem__("stress", np.zeros((own + last, 3, 3))))
    assert "field 'stress' should have shape" in text
    # a function that is not a number on one rank
    f = fem.Function(s.S.function_space, name="pressure")
    problem = s.solver(form=s.F - f * s.v[0] * s.points.dX)
    f.x.array[:] = np.nan if last else 0.0
    assert "function pressure is not finite in the term" in _ends(problem.step)
    f.x.array[:] = 0.0
    problem = s.solver()
    problem.step()
    one = s.points["id"] == 0
    s.points["V"][one] *= 2.0
    assert "must be det(F) V0" in _ends(problem.step)
    s.points["V"][one] /= 2.0
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


def _last(one, other):
    """The second on the last rank, the first on others."""
    return other if COMM.rank == COMM.size - 1 else one


def _differs(call, *words) -> None:
    """A call must end in an error on all ranks whose message has these words, and both values."""
    text = _ends(call)
    # the message is the same on all ranks
    assert set(COMM.allgather(text)) == {text}
    for word in (*words, "on rank 0", f"on rank {COMM.size - 1}; every rank must"):
        assert word in text, (word, text)


def of_different_ranks():
    """Calls that are not the same on all ranks, or are given something else."""
    s = scene()
    before = s.points["x"].copy()
    if COMM.size > 1:
        _different_bodies(s)
        _different_problems(s)
        _different_calls(s)
    # and nothing is left of what was refused
    return {"way": float(COMM.allreduce(np.abs(s.points["x"] - before).sum()))}


def _different_bodies(s) -> None:
    box = mpm.Box((0, 0), (2, 1))
    lower = mpm.Box((0, 0), (2, _last(1.0, 0.5)))
    of = "differs between ranks: "
    _differs(lambda: mpm.fill(s.grid, box, _last(2, 3), 1.0), f"per_cell {of}2 on", "3 on")
    _differs(lambda: mpm.fill(s.grid, box, 2, _last(1.0, 2.0)), f"density {of}1.0 on", "2.0 on")
    _differs(lambda: mpm.fill(s.grid, box, 2, _last(1.0, lambda x: 1 + x[0])), "density", "a func")
    _differs(lambda: mpm.fill(s.grid, lower, 2, 1.0), f"high of shape {of}(2.0, 1.0)", "(2.0, 0.5)")
    _differs(lambda: mpm.fill(s.grid, box, 2, 1.0, tag=_last(0, 1)), f"tag {of}0 on", "1 on")
    _differs(lambda: mpm.fill(s.grid, _last(box, mpm.Disc((1, 1), 0.5)), 2, 1.0), "kind of shape")
    _differs(lambda: mpm.Space(s.grid, _last("linear", "gimp")), f"basis {of}'linear'", "'gimp'")
    _differs(lambda: mpm.Space(s.grid, shape=_last(None, ())), f"shape {of}None on", "() on")
    _differs(lambda: mpm.Space(_last(s.grid, s.grid), tag=_last(None, 2)), f"tag {of}None")
    _differs(lambda: mpm.fixed(s.V, _last("left", "bottom")), f"where {of}('left',)", "('bottom',)")
    _differs(lambda: mpm.prescribed(s.V, "left", _last(0, 1)), f"component {of}0 on")
    _differs(lambda: mpm.moving(s.V, "left", 0, velocity=_last(1.0, 2.0)), f"velocity {of}1.0 on")
    _differs(lambda: mpm.Surface(s.points, lambda x: x[1] > 0.99, (_last(0, 1), _last(1, 0))), "no")
    _differs(lambda: mpm.Boundary.from_side(s.points, _last("left", "right")), f"side {of}'left'")
    corners = [(0, 0), (2, 0), (2, _last(1.0, 0.9)), (0, 1)]
    _differs(lambda: mpm.Boundary.from_polygon(s.points, corners), "vertices differs", "0.9")
    _differs(lambda: mpm.create_lattice(COMM, [[0, 1, _last(2, 3)], [0, 1]]), "lines differs")
    _differs(lambda: s.set_stress(strain=_last("large", "small")), f"strain {of}'large'")
    law = mpm.materials.Hencky(1e4, _last(0.3, 0.2))
    _differs(lambda: s.set_stress(law=law), f"nu of law {of}0.3 on", "0.2 on")
    _differs(lambda: s.plot(_last("a.png", "b.png")), f"path {of}'a.png' on", "'b.png' on")
    _differs(lambda: s.points.add_field(_last("one", "two"), value=lambda x: x[0]), f"name {of}")


def _different_problems(s) -> None:
    def loaded(g, name=None):
        load = fem.Constant(s.grid, (0.0, g))
        if name is not None:
            load.name = name
        return s.momentum() - ufl.inner(load, s.v) * s.points.dX

    law = mpm.materials.Hencky(_last(1e4, 2e4), 0.3)
    of = "differs between ranks: "
    _differs(
        lambda: s.solver(form=s.momentum(law=law)), f"E of Hencky of term 1 of form {of}10000.0"
    )
    _differs(lambda: s.solver(form=loaded(_last(-1.0, -2.0))), f"form {of}(0.0, -1.0)", "-2.0)")
    _differs(lambda: s.solver(form=loaded(_last(-1.0, -2.0), "g")), f"'g' of term 2 of form {of}")
    _differs(lambda: s.solver(form=_last(2.0, 3.0) * s.F), "numbers of term 1 of form")
    weight = _last(s.points.density, s.points.V0) * s.v[1] * s.points.dX
    _differs(lambda: s.solver(form=s.F - weight), "fields of term", f"{of}('density',)", "('V0',)")
    bcs = mpm.prescribed(s.V, "left", 0, increment=_last(0.1, 0.2))
    _differs(lambda: s.solver(bcs=bcs), f"component 0 at 'left' of bcs {of}0.1 on", "0.2 on")
    stabilisation = mpm.Stabilisation("ghost", E=_last(1e4, 1e5))
    _differs(lambda: s.solver(stabilisation=stabilisation), f"E of stabilisation {of}")
    _differs(lambda: s.solver(options_prefix=_last("mpm_", "other_")), f"options_prefix {of}")
    _differs(lambda: s.path(length=_last(0.1, 0.2)), f"length {of}")
    _differs(lambda: s.motion(beta=_last(0.25, 0.3)), f"beta {of}0.25")
    _differs(lambda: s.motion(mpm.Explicit, courant=_last(0.5, 0.6)), f"courant {of}0.5")
    _differs(lambda: s.motion(mass=_last("consistent", "lumped")), f"mass {of}'consistent'")
    lids = [mpm.RigidBody(mpm.Plane((0, 1.5), (0, -1)), name="lid", increment=(0.0, v))
            for v in (0.0, _last(-1e-3, -2e-3))]  # fmt: skip
    touching = s.F + mpm.contact(lids[1], s.points, s.u, s.v)
    _differs(lambda: s.solver(form=touching), f"motion of body of contact of term 3 of form {of}")
    rubbing = s.F + mpm.contact(lids[0], s.points, s.u, s.v, friction=_last(0.1, 0.2))
    _differs(lambda: s.solver(form=rubbing), f"friction of contact of term 3 of form {of}0.1 on")
    side = mpm.Boundary.from_side(s.points, "bottom")
    held = s.F + mpm.dirichlet(side, s.u, s.v, law=s.law, penalty=_last(10.0, 20.0))
    _differs(lambda: s.solver(form=held), f"of form {of}10.0 on", "20.0 on")
    walls = lambda: mpm.signorini(side, s.u, s.v, law=s.law, friction=_last(0.0, 0.1))  # noqa: E731
    _differs(walls, f"friction {of}0.0 on")
    _differs(lambda: s.solver(form=s.F, updates=_last(None, {})), f"updates {of}None on")
    # the last rank is the first that differs from rank 0
    last = COMM.rank == COMM.size - 1
    if not last:
        s.points.add_field("of_one_rank")
    _differs(lambda: s.solver(), "fields of points", "of_one_rank")
    if last:
        s.points.add_field("of_one_rank")


def _different_calls(s) -> None:
    """A rank makes another call, or the same ones in another order."""
    calls = [lambda: mpm.Space(s.grid), lambda: s.points.gather("x")]
    if COMM.rank == COMM.size - 1:
        calls.reverse()
    for _ in range(2):
        text = _ends(calls[0])
        assert "the ranks make different calls: Space at line " in text
        assert "MaterialPoints.gather at line " in text
        assert text.count(" of arguments.py on rank ") == 2
    problem = s.solver()
    other = (lambda: problem.step(), lambda: problem.save("a.npz"), lambda: problem.info())
    for k in range(3):
        assert "QuasiStatic." in _ends(_last(other[k], other[(k + 1) % 3]))
    kinds = _last(lambda: s.motion(), lambda: s.solver())
    assert "Newmark at line" in _ends(kinds)


def steps_of_different_ranks():
    """Steps to other times, under other loads, or of other bodies, and other files."""
    s = scene()
    if COMM.size == 1:
        return {"time": 0.0}
    body = mpm.RigidBody(
        mpm.Plane((0, 1.5), (0, -1)), name="lid",
        velocity=lambda t: (0.0, _last(-1e-3, -2e-3) if t > 1.5e-3 else 0.0),
    )  # fmt: skip
    before, push = s.g.value.copy(), fem.Constant(s.grid, 0.0)
    s.g.value[:] = 0.0, -1.0
    speed = mpm.moving(s.V, "right", 1, velocity=lambda t: _last(0.0, 1e-3) if t > 3.5e-3 else 0.0)
    bcs = s.bcs + mpm.prescribed(s.V, "right", 0, increment=push) + speed
    problem = s.motion(form=s.F + mpm.contact(body, s.points, s.u, s.v), bcs=bcs)
    of = "differs between ranks: "
    _differs(lambda: problem.step(_last(1e-3, 2e-3)), f"t {of}0.001 on", "0.002 on")
    _differs(lambda: problem.step(_last(1e-3, "soon")), f"t {of}0.001 on", "'soon' on")
    problem.step(1e-3)
    _differs(lambda: problem.step(2e-3), f"motion of 'lid' {of}((0.0, -0.001),) on")
    s.g.value[1] = _last(-1.0, -2.0)
    _differs(lambda: problem.step(1.5e-3), f"constant 1 {of}(0.0, -1.0) on", "(0.0, -2.0) on")
    s.g.value[1] = -1.0
    push.value = _last(0.0, 1e-4)
    _differs(lambda: problem.step(1.5e-3), f"at 'right' {of}0.0 on", "0.0001 on")
    push.value = 0.0
    _differs(lambda: problem.step(4e-3), "differs between ranks")
    _differs(lambda: problem.save(_last("a.npz", "b.npz")), f"path {of}'a.npz' on", "'b.npz' on")
    _functions_of_one_rank(s)
    # a load that each rank has summed itself differs by rounding: whether it changed is not clear
    s.g.value[1] = _last(-1.0, -1.0 - 1e-15)
    _differs(
        lambda: problem.step(1.5e-3), "-1.000000000000001) on rank", "from one to all by bcast"
    )
    s.g.value[:] = before
    return {"time": 0.0}


def _functions_of_one_rank(s) -> None:
    """Loads and waves by functions of time that fail, or differ, on one rank after a while."""

    def late(value, good):
        """A function that is `good` at first, and what `value` returns on the last rank later."""
        return lambda t: value() if t > 1.5e-3 and _last(False, True) else good

    def fails():
        raise ValueError("only here")

    of = "differs between ranks: "
    problem = s.motion(mpm.Explicit)
    problem.courant = _last(0.8, np.nan)
    _differs(lambda: problem.step(1e-3), f"courant {of}0.8 on")
    problem = s.solver()
    problem.tolerance = _last(1e-9, 1e-8)
    _differs(problem.step, f"tolerance {of}1e-09 on")
    for rule in (mpm.Newmark, mpm.Explicit):
        for value, text in ((fails, "Error"), (lambda: (0.0, np.nan), "a "), (lambda: (0, 3), "3")):
            mass = {"mass": 10.0, "free": (True, True, False)}
            ball = mpm.RigidBody(
                mpm.Disc((1.0, 1.4), 0.5), force=late(value, (0.0, -1.0)), name="ball", **mass
            )
            points, V = s.fill(), mpm.Space(s.grid)
            u, v = V.increment, V.test
            form = s.momentum(points=points, u=u, v=v) + mpm.contact(ball, points, u, v)
            problem = rule(form, u, points, mpm.fixed(V, "bottom"))
            problem.step(1e-3)
            _differs(lambda problem=problem: problem.step(2e-3), f"load of 'ball' {of}", text)
        for value in (fails, lambda: np.nan, lambda: 0.2):
            points, V = s.fill(), mpm.Space(s.grid)
            ground = {"density": 1e3, "p_speed": 4.0, "s_speed": 2.0}
            faces = mpm.absorbing(V, "bottom", incoming=(late(value, 0.1), None), **ground)
            form = s.momentum(points=points, u=V.increment, v=V.test)
            problem = rule(form, V.increment, points, faces)
            problem.step(1e-3)
            text = f"wave 1 at 'bottom' {of}0.1 on"
            _differs(lambda problem=problem: problem.step(2e-3), text)


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
        _ends(
            lambda: mpm.prescribed(V, lambda x: x[1] > 0.5, 0, increment=lambda x: np.nan * x[0])
        ),
        _ends(lambda: mpm.Surface(points, lambda x: x[1] > 7, (0, 1))),
        _ends(lambda: mpm.plot(points, "a.foo")),
    ]
    assert "the nodes lie from [0. 0.] to [1. 1.] m" in texts[0]
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
