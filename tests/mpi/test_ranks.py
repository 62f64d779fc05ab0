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


def flat(value):
    if isinstance(value, dict):
        return [x for key in sorted(value) if key != "moved" for x in flat(value[key])]
    return [x for item in value for x in flat(item)] if isinstance(value, list) else [value]


@pytest.mark.skipif(shutil.which("mpirun") is None, reason="needs mpirun")
@pytest.mark.parametrize("ranks", [2, 3])
@pytest.mark.parametrize("case", CASES)
def test_figures_do_not_depend_on_the_ranks(case, ranks):
    one, many = figures(case, 1), figures(case, ranks)
    scale = max(1e-3 * max(abs(float(x)) for x in flat(one)), 1e-300)
    few = TOLERANCES.get(case, 1e-9)
    np.testing.assert_allclose(
        np.array(flat(many), float), np.array(flat(one), float), rtol=few, atol=few * scale
    )
    if "moved" in many and case not in ("driven", "tall"):
        assert many["moved"], "no point changed rank: the scene tests nothing"
