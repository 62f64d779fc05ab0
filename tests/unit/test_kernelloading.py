"""Loops of the package are loaded without what their compilation needs."""

from __future__ import annotations

import json
import sys

import numba
import pytest
from conftest import start
from numba.core import caching

from dolfinmpm._platform.kernelloading import load_at_once

# what Numba imports before it compiles
COMPILING = "numba.cpython.listobj"


@pytest.fixture
def scene(tmp_path):
    script = tmp_path / "scene.py"
    script.write_text(
        f"""
import json
import sys

import numpy as np
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

import dolfinmpm as mpm

grid = mesh.create_rectangle(MPI.COMM_WORLD, [(0, 0), (1, 1)], [4, 4], mesh.CellType.quadrilateral)
results = []
for make in (mpm.QuasiStatic, mpm.Explicit):
    points = mpm.fill(grid, mpm.Box((0, 0), (1, 0.5)), 2, 1000.0)
    V = mpm.Space(grid, "bspline2")
    law = mpm.materials.VonMises(E=1e6, nu=0.3, yield_stress=1e4)
    F = mpm.momentum(law, points, V.increment, V.test)
    F -= ufl.inner(points.density * ufl.as_vector((0.0, -10.0)), V.test) * points.dX
    problem = make(F, V.increment, points, mpm.fixed(V, "bottom"))
    problem.step(*([1e-3] if make is mpm.Explicit else []))
    results.append(float(np.sum(points["stress"])))
loaded = {COMPILING!r} in sys.modules

import numba

lists = numba.njit(lambda n: len([k * 0.5 for k in range(n)]))
print(json.dumps([loaded, results, lists(7)]))
"""
    )
    return script


def test_what_is_in_the_cache_needs_nothing_else(scene):
    # the first run may have to compile
    runs = [json.loads(start(scene).stdout.splitlines()[-1]) for _ in range(2)]
    loaded, results, number = runs[1]
    assert not loaded
    assert number == 7
    assert results == runs[0][1]


def test_functions_of_others_are_loaded_as_ever(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "own_function.py").write_text(
        "import numba\n\n@numba.njit(cache=True)\ndef half(x):\n    return 0.5 * x\n"
    )
    asked = []
    context = numba.core.registry.cpu_target.target_context
    refresh = type(context).refresh
    monkeypatch.setattr(type(context), "refresh", lambda self: asked.append(1) or refresh(self))
    import own_function

    assert own_function.half(3.0) == 1.5
    del sys.modules["own_function"]
    import own_function

    asked.clear()
    assert own_function.half(3.0) == 1.5
    assert own_function.half.stats.cache_hits
    assert asked


def test_another_way_of_loading_is_left_alone(monkeypatch):
    def load_overload(self, sig, target_context):
        return self.newer(sig, target_context)

    monkeypatch.setattr(caching.Cache, "load_overload", load_overload)
    assert not load_at_once("dolfinmpm")
    assert caching.Cache.load_overload is load_overload
