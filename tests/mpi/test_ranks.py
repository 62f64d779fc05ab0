"""Every scene of `cases.py` on 1, 2 and 3 ranks: the same figures, and no hang."""

from __future__ import annotations

import functools
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

HERE = Path(__file__).parent
CASES = (
    "column",
    "triangles",
    "carried_2d",
    "carried_3d",
    "stencils_across_corners",
    "tall",
    "two_fields",
    "driven",
    "remedies_gimp",
    "remedies_linear",
    "remedies_bspline2",
    "errors_on_all_ranks",
)


@functools.cache
def figures(case: str, ranks: int) -> dict:
    # what this process's own MPI put into the environment must not reach the launcher's
    clean = {k: v for k, v in os.environ.items() if not k.startswith(("PMIX_", "OMPI_COMM_"))}
    clean["OMP_NUM_THREADS"] = "1"
    # mpi4py's runner ends all ranks when one of them raises
    script = [sys.executable, "-m", "mpi4py", str(HERE / "cases.py"), case]
    command = ["mpirun", "-n", str(ranks), *script]
    done = subprocess.run(command, env=clean, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-4000:]
    return json.loads(done.stdout.strip().splitlines()[-1])


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
    np.testing.assert_allclose(
        np.array(flat(many), float), np.array(flat(one), float), rtol=1e-9, atol=1e-9 * scale
    )
    if "moved" in many and case not in ("driven", "tall"):
        assert many["moved"], "no point changed rank: the scene tests nothing"
