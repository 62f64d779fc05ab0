"""Branches that constants rule out are gone before Numba sees them, and nothing else."""

from __future__ import annotations

import dis

import numba
import numpy as np
import pytest

from dolfinmpm._platform.constantfolding import fold_constants
from dolfinmpm.dynamics import fused2d, fused3d
from dolfinmpm.dynamics.passes import LAW, PASSES

LIMIT = 2


def variant(kind, fine, weight=1.0):
    def run(x, count):
        total = 0.0
        if kind == LIMIT and fine:
            total += 100.0
        elif kind > LIMIT or not fine:
            total -= 100.0
        if count > 3 and (fine or kind == 1):
            total += weight
        for k in range(count):
            total += x[k] if fine else 2.0 * x[k]
        if fine or count > 1:
            total += 0.5
        if not fine:
            pass
        elif kind == 0:
            return total
        return total * weight

    return run


CASES = [(kind, fine) for kind in range(4) for fine in (True, False)]


@pytest.mark.parametrize(("kind", "fine"), CASES)
def test_same_results(kind, fine):
    x = np.arange(1.0, 7.0)
    whole = variant(kind, fine, 3.0)
    less = fold_constants(whole)
    compiled = numba.njit(less)
    for count in range(6):
        assert less(x, count) == compiled(x, count) == whole(x, count)


def test_what_cannot_be_reached_is_gone():
    whole = variant(0, False)
    less = fold_constants(whole)
    assert 100.0 in less.__code__.co_consts
    assert {"weight"} == set(loaded(less)) & {"kind", "fine", "LIMIT", "weight"}
    assert {"kind", "fine", "LIMIT"} < set(loaded(whole))
    assert 100.0 not in fold_constants(variant(1, True)).__code__.co_consts


def loaded(function):
    return [i.argval for i in dis.get_instructions(function) if i.opname.startswith("LOAD_")]


def test_variants_are_told_apart_in_the_cache():
    # Numba asks for code and cells: variants may have the same code
    first, second = (fold_constants(variant(kind, True)) for kind in (1, 3))
    assert first.__code__.co_freevars == ("fine", "kind", "weight")
    cells = [[c.cell_contents for c in f.__closure__] for f in (first, second)]
    assert cells == [[True, 1, 1.0], [True, 3, 1.0]]


def test_names_that_hide_constants_are_none():
    def run(LIMIT):
        if LIMIT == 2:
            return 1
        return 0

    assert [fold_constants(run)(k) for k in (1, 2)] == [0, 1]


def test_lines_are_those_of_the_file():
    def run(x):
        return 1 / x

    with pytest.raises(ZeroDivisionError) as caught:
        fold_constants(run)(0)
    assert caught.traceback[-1].lineno == run.__code__.co_firstlineno


def test_of_a_file_that_has_changed_nothing_is_taken(tmp_path):
    path = tmp_path / "loops.py"
    path.write_text(
        "def of(fine):\n    def run(x):\n        return x if fine else 2 * x\n    return run\n"
    )
    space = {"__name__": "loops"}
    exec(compile(path.read_text(), str(path), "exec"), space)
    run = space["of"](False)
    path.write_text(path.read_text().replace("2 * x", "3 * x"))
    assert fold_constants(run) is run
    assert run(1.0) == 2.0


@pytest.mark.parametrize("kernel", [fused2d.kernel, fused3d.kernel], ids=["2D", "3D"])
def test_fused_loops_are_pruned(kernel):
    loop = kernel(2, 0, LAW, 0, PASSES["usl"][0], False).py_func
    assert len(loop.__code__.co_code) < 0.7 * len(loop.__wrapped__.__code__.co_code)
