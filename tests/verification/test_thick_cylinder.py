"""The thick cylinder of `demos/studies/thick_cylinder.py` against Hill's closed form."""

from __future__ import annotations

import functools
import shutil

import numpy as np
import pytest
from conftest import figures_of

LIMIT = 0.19209e9


@functools.cache
def demo(options: str, ranks: int = 1) -> dict:
    """Figures of the study, run by interpreters of its own."""
    given = "--json", "-", "--no-plot", *options.split()
    return figures_of("demos/studies/thick_cylinder.py", *given, ranks=ranks)


@pytest.mark.parametrize(
    "options",
    [
        "",
        "--stabilisation ghost",
        pytest.param("--basis gimp", marks=pytest.mark.long),
        "--basis gimp --stabilisation ghost",
        pytest.param("--basis gimp --points-per-cell 2 --steps 16", marks=pytest.mark.long),
        pytest.param("--basis bspline3", marks=pytest.mark.long),
        pytest.param("--h 0.025", marks=pytest.mark.long),
        "--h 0.011 --stabilisation extended",
    ],
)
def test_pressure_and_limit_load_within_one_per_cent(options):
    figures = demo(options)
    assert figures["max_pressure_error"] < 0.01
    assert figures["limit_load"] == pytest.approx(LIMIT, rel=0.01)
    # with the radii that the tube has by then the small-strain solution has no excuse
    assert figures["limit_load"] == pytest.approx(figures["limit_load_of_present_radii"], rel=4e-3)
    elastic = np.array(figures["pressure"])[1:4] / np.array(figures["pressure_exact"])[1:4]
    np.testing.assert_allclose(elastic, 1, atol=3e-3)
    assert figures["halvings"] == 0


def test_newton_converges_quadratically():
    for before, last in demo("")["last_residuals"]:
        assert last < 1e-9
        assert last < 0.1 * before**1.2


def test_at_small_strains_the_difference_goes():
    figures = demo("--strength 0.024e9 --basis gimp")
    assert abs(figures["limit_load_error"]) < 2e-3
    assert figures["max_displacement_error"] < 0.01


@pytest.mark.skipif(shutil.which("mpirun") is None, reason="needs mpirun")
@pytest.mark.long
def test_ranks():
    options = "--h 0.025 --basis gimp --stabilisation ghost"
    one, three = demo(options), demo(options, ranks=3)
    np.testing.assert_allclose(three["pressure"], one["pressure"], rtol=1e-8)
