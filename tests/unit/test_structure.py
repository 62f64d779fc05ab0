"""The house: folders that import one way, small classes on the path of a step, no re-entry."""

from __future__ import annotations

import ast
from pathlib import Path

import numpy as np
import pytest
import ufl
from conftest import unit_grid
from dolfinx import fem

import dolfinmpm as mpm
from dolfinmpm.cut.activation import Activation, ActiveField
from dolfinmpm.dynamics.explicitbase import Settings
from dolfinmpm.solve.newton import Outcome

ROOT = Path(mpm.__file__).parent
# each folder imports from those before it only
ORDER = (
    "_platform", "grid", "basis", "body", "forms", "materials", "kinematics", "porous", "cut",
    "assembly", "terms", "contact", "io", "solve", "dynamics", "study",
)  # fmt: skip


def imports(path):
    """Folders of the package that a module imports from, at its top or in a function."""
    for node in ast.walk(ast.parse(path.read_text())):
        names = [node.module] if isinstance(node, ast.ImportFrom) else []
        names += [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
        for name in names:
            parts = (name or "").split(".")
            if parts[0] == "dolfinmpm" and len(parts) > 1:
                yield parts[1]


def test_the_top_has_folders_only():
    files = {path.name for path in ROOT.glob("*.py")}
    assert files == {"__init__.py", "__main__.py"}
    folders = {path.name for path in ROOT.iterdir() if list(path.glob("*.py"))}
    assert folders == set(ORDER)


@pytest.mark.parametrize("folder", ORDER)
def test_imports_go_one_way(folder):
    before = ORDER[: ORDER.index(folder) + 1]
    for path in (ROOT / folder).glob("*.py"):
        strange = set(imports(path)) - set(before)
        assert not strange, f"{path.relative_to(ROOT)} imports from {strange}"


def test_no_module_is_named_as_a_public_function():
    public = {name for name in mpm.__all__ if callable(getattr(mpm, name))}
    modules = {path.stem for path in ROOT.rglob("*.py")}
    assert not public & modules


def test_nothing_is_entered_again_and_no_numbering_is_compared():
    for path in ROOT.rglob("*.py"):
        text = path.read_text()
        assert "return self.activate" not in text, path
        assert "_numbering is" not in text, path


def test_classes_on_the_path_of_a_step_are_small():
    grid = unit_grid("quadrilateral", 4)
    points = mpm.fill(grid, mpm.Box((0, 0), (1, 0.6)), 2, 1.0)
    V = mpm.Space(grid, "bspline2")
    u, v = V.increment, V.test
    g = fem.Constant(grid, (0.0, -1e-3))
    F = mpm.momentum(mpm.materials.Hencky(E=10.0, nu=0.3), points, u, v, fbar=True)
    F -= ufl.inner(g, v) * points.dX
    quasistatic = mpm.QuasiStatic(F, u, points, mpm.fixed(V, "bottom"), stabilisation="ghost")
    arc = mpm.ArcLength(
        F, u, points, mpm.fixed(V, "bottom"), load=g, length=1e-3, stabilisation="ghost"
    )
    for problem in (quasistatic, arc):
        problem.step()
        operator = problem.operator()
        newton = problem.newton
        parts = [
            problem, problem.form, problem.form.grid, problem.solver, newton, newton.linear,
            operator, operator.points, operator.points.regions[0], operator.here.unknowns,
            problem.fields[0], problem.essential_conditions, problem.loads, Outcome(),
            *problem.form.regions,
        ]  # fmt: skip
        parts += [problem.path] if isinstance(problem, mpm.ArcLength) else []
        small(parts)
    for frozen in (Activation, ActiveField, Settings):
        assert frozen.__dataclass_params__.frozen
        assert len(frozen.__dataclass_fields__) <= 15


@pytest.mark.parametrize("kind", [mpm.Newmark, mpm.Explicit])
def test_classes_on_the_path_of_a_step_in_time_are_small(kind):
    problems = []
    for options in ({"mass": "consistent"}, {}) if kind is mpm.Explicit else ({},):
        grid = unit_grid("quadrilateral", 4)
        points = mpm.fill(grid, mpm.Box((0, 0), (1, 0.6)), 2, 1.0)
        V = mpm.Space(grid, "bspline2", averaged=False)
        F = mpm.momentum(mpm.materials.Hencky(E=10.0, nu=0.3), points, V.increment, V.test)
        F -= ufl.inner(ufl.as_vector((0.0, -1e-3)), V.test) * points.dX
        problem = kind(F, V.increment, points, mpm.fixed(V, "bottom"), **options)
        problem.step(1e-3)
        problems.append(problem)
    if kind is mpm.Newmark:
        return small([*problems, problems[0].motion.terms])
    assert [problem.unfused == "" for problem in problems] == [False, True]
    parts = [part for p in problems for part in (p, p.balance, p.terms, p._loop)]
    fused = problems[1]._loop
    small([*parts, fused._window, fused._window.cells, fused._prescribed, fused._arrays])


def small(parts):
    for part in parts:
        assert len(vars(part)) <= 15, (type(part).__name__, sorted(vars(part)))


def test_a_tangent_is_compiled_when_a_solver_asks():
    grid = unit_grid("quadrilateral", 4)
    points = mpm.fill(grid, mpm.Box((0, 0), (1, 0.6)), 2, 1.0)
    V = mpm.Space(grid, "gimp")
    F = mpm.momentum(mpm.materials.Hencky(E=10.0, nu=0.3), points, V.increment, V.test)
    F -= ufl.inner(ufl.as_vector((0.0, -1e-3)), V.test) * points.dX
    problem = mpm.QuasiStatic(F, V.increment, points, mpm.fixed(V, "bottom"))
    (region,) = problem.form.regions
    problem.operator().residual(np.zeros(problem.here.unknowns.owned))
    assert "tangent" not in vars(region)
    problem.step()
    assert "tangent" in vars(region)
