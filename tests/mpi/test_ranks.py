"""Every scene of `cases` on 1, 2 and 3 ranks: the same figures, and no hang."""

from __future__ import annotations

import functools
import shutil

import numpy as np
import pytest
from cases import CASES
from conftest import figures_of

# where a point yields a little earlier, rounding is carried on from step to step
TOLERANCES = {"plastic": 1e-8, "law_in_ufl": 1e-8}


@functools.cache
def figures(case: str, ranks: int) -> dict:
    return figures_of("tests/mpi/run_case.py", case, ranks=ranks, timeout=120)


def leaves(figures, path=()):
    """Every number and every list of numbers, by where it stands."""
    if isinstance(figures, dict):
        return {k: v for key in figures for k, v in leaves(figures[key], (*path, key)).items()}
    return {path: figures}


@pytest.mark.skipif(shutil.which("mpirun") is None, reason="needs mpirun")
@pytest.mark.parametrize("ranks", [2, 3])
@pytest.mark.parametrize("case", CASES)
def test_figures_do_not_depend_on_the_ranks(case, ranks):
    one, many = leaves(figures(case, 1)), leaves(figures(case, ranks))
    assert one.keys() == many.keys()
    few = TOLERANCES.get(case, 1e-9)
    for path in one.keys() - {path for path in one if path[-1] == "moved"}:
        a, b = np.array(one[path], float), np.array(many[path], float)
        # rounding may decide about a last iteration
        within = 1 if path[-1] == "iterations" else few * np.abs(a).max(initial=0.0)
        np.testing.assert_allclose(b, a, rtol=0, atol=within, err_msg=str(path))
    moved = [many[path] for path in many if path[-1] == "moved"]
    if moved and case not in ("driven", "tall"):
        assert all(moved), "no point changed rank: the scene tests nothing"
