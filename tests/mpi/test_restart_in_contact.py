"""A run that is broken off while a tool is in the ground goes on with other numbers of ranks."""

from __future__ import annotations

import shutil

import numpy as np
import pytest
from conftest import figures_of


@pytest.mark.skipif(shutil.which("mpirun") is None, reason="needs mpirun")
def test_penetration_goes_on_with_other_ranks(tmp_path):
    """1 → 2 ranks in the middle of the way down: forces, slips on corners and the tool's place."""

    script, path = "tests/mpi/run_penetration.py", str(tmp_path / "half.npz")
    whole = figures_of(script, "save", path)
    parted = figures_of(script, "load", path, ranks=2)
    assert whole["force"][1] > 0
    assert whole["dissipated"] > 0
    for name, expected in whole.items():
        a, b = np.array(parted[name], float), np.array(expected, float)
        scale = np.abs(b).max() if b.size else 0.0
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-8 * scale, err_msg=name)
