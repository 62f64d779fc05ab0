"""Checkpoints: the same bits after a restart, named errors, and a file that is always whole."""

from __future__ import annotations

import json

import numpy as np
import pytest
import ufl
from conftest import COMM, start
from dolfinx import fem, mesh
from scenes import arch

import dolfinmpm as mpm

QUADRILATERAL = mesh.CellType.quadrilateral


def block(law=None, basis="gimp", cells=(6, 4), kind=QUADRILATERAL, width=6.0, load=0.9, **options):
    """A block under its weight; `step` takes the next one of a run."""
    grid = mesh.create_rectangle(COMM, [(0, 0), (width, 4)], cells, kind)
    points = mpm.fill(grid, mpm.Box((0, 0), (3, 2.7)), 2, 1000.0)
    V = mpm.Space(grid, basis)
    g = fem.Constant(grid, (0.0, 0.0))
    law = law or mpm.materials.VonMises(E=1e6, nu=0.3, radius=lambda x: 5e3 + 1e3 * x[1])
    F = mpm.momentum(law, points, V.increment, V.test)
    F -= ufl.inner(points.density * g, V.test) * points.dX
    options = {"stabilisation": mpm.Stabilisation("ghost", E=1e6), **options}
    problem = mpm.QuasiStatic(F, V.increment, points, mpm.rollers(V, "left", "bottom"), **options)

    def step():
        g.value[1] = -load * (len(problem.history) + 1)
        return problem.step()

    return problem, step


def hollow():
    """A soft wall with hollows: points come into empty cells and leave them again."""
    grid = mesh.create_rectangle(COMM, [(0, 0), (5, 12)], (5, 12), QUADRILATERAL)

    def wall(x):
        y = x[1] % 3
        hole = (x[0] > 1) & (x[0] < 2) & (y > 1.02) & (y < 1.98)
        return (x[0] < 3) & (x[1] < 9.01) & ~hole

    points = mpm.fill(grid, mpm.Where(wall), 4, 80.0)
    V = mpm.Space(grid, "linear")
    g = fem.Constant(grid, (0.0, 0.0))
    F = mpm.momentum(mpm.materials.Hencky(E=1e4, nu=0.0), points, V.increment, V.test)
    F -= ufl.inner(points.density * g, V.test) * points.dX
    bcs = mpm.fixed(V, "bottom") + mpm.rollers(V, "left")
    problem = mpm.QuasiStatic(F, V.increment, points, bcs)

    def step():
        k = len(problem.history)
        g.value[:] = 0.3 * (k % 2), -2.5 * np.sin(np.pi * k / 10) * (k < 10)
        return problem.step()

    return problem, step


def pressed():
    """A wedge in a block: every step begins from what the last one found."""
    grid = mesh.create_rectangle(COMM, [(0, 0), (6, 4)], (12, 8), QUADRILATERAL)
    points = mpm.fill(grid, mpm.Box((0, 0), (6, 2)), 2, 1000.0)
    V = mpm.Space(grid, "gimp")
    law = mpm.materials.VonMises(E=1e6, nu=0.3, radius=2e4)
    shape = mpm.Wedge((2.4, 1.95), np.degrees(0.7), 1.5)
    tool = mpm.RigidBody(shape, increment=(0.0, -0.05), name="tool")
    F = mpm.momentum(law, points, V.increment, V.test)
    F += mpm.contact(tool, points, V.increment, V.test, friction=0.3, penalty=25.0)
    bcs = mpm.rollers(V, "left", "right") + mpm.fixed(V, "bottom")
    problem = mpm.QuasiStatic(F, V.increment, points, bcs, stabilisation="aggregation")
    return problem, problem.step


def bits(problem):
    """Fields, loads and records, all but the seconds."""
    return {
        "fields": {name: values.tobytes() for name, values in problem.points.fields.items()},
        "loads": [value.tobytes() for _, value in problem.loads.converged()],
        "history": [vars(record) | {"seconds": None, "stages": None} for record in problem.history],
    }


RUNS = {
    "yielding with ghost penalty": (block, 8, (0, 3, 6)),
    "yielding with adaptive penalties": (
        lambda: block(stabilisation=mpm.Stabilisation("ghost", factor="adaptive")), 8, (0, 3),
    ),
    "triangles with adaptive penalties": (
        lambda: block(
            basis="linear", kind=mesh.CellType.triangle,
            stabilisation=mpm.Stabilisation("ghost", factor="adaptive"),
        ), 6, (3,),
    ),
    "yielding with aggregation": (lambda: block(stabilisation="aggregation"), 8, (3,)),
    "splines": (lambda: block(mpm.materials.Hencky(E=1e6, nu=0.3), "bspline2"), 6, (0, 3)),
    "triangles": (
        lambda: block(
            basis="linear", kind=mesh.CellType.triangle, stabilisation="weak-aggregation"
        ), 8, (3,),
    ),
    "halved steps": (
        lambda: block(mpm.materials.Hencky(E=1e5, nu=0.3), load=20.0, max_iterations=3), 4, (0, 1),
    ),
    "a tool": (pressed, 5, (2,)),
    "couplings kept": (hollow, 14, (2, 10)),
    "arc length": (arch, 8, (0, 4)),
    "displacement control": (lambda: arch("displacement"), 8, (4,)),
}  # fmt: skip


@pytest.mark.parametrize("name", RUNS)
def test_a_run_goes_on_bit_for_bit(name, tmp_path):
    build, steps, stops = RUNS[name]
    problem, step = build()
    for k in range(steps):
        step()
        if k in stops:
            problem.save(tmp_path / f"{k}.npz")
        if name == "halved steps" and k == 0:
            # the next step begins with a part of its load, and with the other line search
            assert problem.share < 1
            assert problem.newton.search == "cp"
    for k in stops:
        again, step = build()
        again.load(tmp_path / f"{k}.npz")
        assert len(again.history) == k + 1
        while len(again.history) < steps:
            step()
        assert bits(again) == bits(problem)


def test_a_problem_goes_back_to_what_it_saved(tmp_path):
    """Memory of the steps behind the checkpoint is gone too, that of a failed one as well."""
    problem, step = block(max_halvings=0)
    for _ in range(3):
        step()
    problem.save(tmp_path / "three.npz")
    for _ in range(4):
        step()
    reached = bits(problem)
    problem.loads.converged()[0][0].value[1] = -1e4
    with pytest.raises(mpm.errors.ConvergenceError):
        problem.step()
    problem.load(tmp_path / "three.npz")
    assert not problem.form.spaces[0].increment.x.array.any()
    assert problem.loads.converged()[0][0].value[1] == pytest.approx(-2.7)
    for _ in range(4):
        step()
    assert bits(problem) == reached


def test_fields_of_users_and_surfaces_and_prescribed_values_come_back(tmp_path):
    def build():
        grid = mesh.create_rectangle(COMM, [(0, 0), (3, 4)], (3, 4), QUADRILATERAL)
        points = mpm.fill(grid, mpm.Box((0, 0), (3, 3)), 2, 1.0, tag=3)
        V = mpm.Space(grid, "gimp")
        u, v = V.increment, V.test
        top = mpm.Surface(points, lambda x: np.isclose(x[1], 3.0), (0, 1), name="top")
        s, push = fem.Constant(grid, 0.0), fem.Constant(grid, 0.0)
        foot = mpm.RigidFooting(top, s, E=1e3)
        temperature = points.add_field("temperature", (2,), "K", 280.0)
        F = mpm.momentum(mpm.materials.NeoHookean(E=1e3, nu=0.3), points, u, v)
        F += foot.contact(u, v)
        bcs = mpm.rollers(V, "bottom") + mpm.prescribed(V, "left", 0, increment=push)
        updates = {"temperature": temperature + u}
        return mpm.QuasiStatic(F, u, points, bcs, updates=updates), foot, s, push

    problem, foot, s, push = build()
    s.value, push.value = 0.1, 0.01
    problem.step()
    problem.points["temperature"][:, 1] += problem.points["id"]
    problem.save(tmp_path / "a.npz")
    again, foot_again, s_again, push_again = build()
    again.load(tmp_path / "a.npz")
    assert bits(again) == bits(problem)
    assert (s_again.value, push_again.value) == (0.1, 0.01)
    assert foot_again.load() == foot.load() > 0
    np.testing.assert_array_equal(again.points["tag"], 3)
    for one, settlement in ((problem, s), (again, s_again)):
        settlement.value = 0.2
        one.step()
    assert bits(again) == bits(problem)


def test_loads_that_vary_in_space_come_back_by_their_nodes(tmp_path):
    """Of continuous and of discontinuous functions, vectors and scalars."""
    kind = mesh.CellType.triangle

    def build():
        grid = mesh.create_rectangle(COMM, [(0, 0), (4, 4)], (4, 4), kind)
        points = mpm.fill(grid, mpm.Box((0, 0), (3, 3)), 2, 1.0)
        V = mpm.Space(grid, "linear")
        body = fem.Function(fem.functionspace(grid, ("Lagrange", 2, (2,))))
        more = fem.Function(fem.functionspace(grid, ("DG", 1)))
        F = mpm.momentum(mpm.materials.Hencky(E=1e3, nu=0.3), points, V.increment, V.test)
        F -= ufl.inner(body, V.test) * points.dX + more * V.test[0] * points.dX
        return mpm.QuasiStatic(F, V.increment, points, mpm.fixed(V, "bottom")), body, more

    problem, body, more = build()
    body.interpolate(lambda x: (np.sin(x[0]), -(x[1] ** 2)))
    more.interpolate(lambda x: np.cos(x[1]))
    problem.step()
    problem.save(tmp_path / "a.npz")
    body.x.array[:] = 7.0  # after the last step: not of the saved state
    again, body_again, more_again = build()
    again.load(tmp_path / "a.npz")
    body.interpolate(lambda x: (np.sin(x[0]), -(x[1] ** 2)))
    for one, other in ((body, body_again), (more, more_again)):
        np.testing.assert_array_equal(other.x.array, one.x.array)


def test_a_run_that_is_killed_goes_on_bit_for_bit():
    """The limit is there for hangs alone; the script takes seconds."""
    done = start("tests/kill_and_go_on.py", "20", timeout=1200)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-4000:]
    figures = json.loads(done.stdout.splitlines()[-1])
    assert figures["kills"] == 20
    assert figures["in writing"] > 0
    assert figures["same bits"]


@pytest.mark.parametrize(
    ("levels", "basis", "other", "factor"),
    [
        (0, "gimp", "gimp", "adaptive"),
        (1, "gimp", "gimp", "adaptive"),
        (1, "gimp", "bspline2", 100.0),
    ],
)
def test_another_basis_or_penalty_goes_on_with_tensors_of_its_own(
    levels, basis, other, factor, tmp_path
):
    """Of one modulus in place of two, or of other functions: they had ended in a reshape."""

    def made(basis, factor):
        grid = mpm.create_lattice(COMM, [np.arange(0, 3.1, 1.0)] * 2)

        def size(x):
            return np.where(x[0] < 1, 0.5, 1.0) * 1.001

        V = mpm.Space(grid, basis, **({"refine": size, "levels": 1} if levels else {}))
        points = mpm.fill(grid, mpm.Box((0, 0), (2, 1.3)), 2, 1.0, refine=V)
        F = mpm.momentum(mpm.materials.Hencky(1e4, 0.3), points, V.increment, V.test)
        load = fem.Constant(grid, (0.0, 0.0))
        F -= ufl.inner(load, V.test) * points.dX
        ghost = mpm.Stabilisation("ghost", factor=factor)
        bcs = mpm.fixed(V, "bottom")
        return mpm.QuasiStatic(F, V.increment, points, bcs, stabilisation=ghost), load

    found = []
    for k in range(2):
        problem, load = made(other, 1.0 if other == basis else factor)
        if k:
            first, _ = made(basis, factor if other == basis else 1.0)
            first.step()
            first.save(tmp_path / "first.npz")
            with pytest.warns(mpm.errors.DifferentProblemWarning):
                problem.load(tmp_path / "first.npz")
        else:
            problem.step()
        load.value[1] = -10.0
        problem.step()
        found.append(problem.points["x"].copy())
    assert np.abs(found[1] - found[0]).max() < 1e-12
