"""The study of a T-bar in deep clay at a small size."""

from __future__ import annotations

import pytest
from conftest import figures_of


@pytest.mark.parametrize(("adhesion", "ranks"), [(0, 1), (1, 2)])
def test_the_bearing_factor(adhesion, ranks):
    done = figures_of(
        "demos/studies/t_bar.py", "--no-plot", f"--adhesion={adhesion}", "--cells=4", "--size=4",
        "--way=0.4", "--step=0.04", "--json", "-", ranks=ranks,
    )  # fmt: skip
    assert -0.01 < done["error"] < 0.06
    assert done["exact"] == pytest.approx(11.94 if adhesion else 9.14, abs=0.005)
