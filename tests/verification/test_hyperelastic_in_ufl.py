"""Growing tissue, stated in UFL by the study `hyperelastic_in_ufl.py`, against its solution."""

from __future__ import annotations

import functools
import shutil
from pathlib import Path

import numpy as np
import pytest
from conftest import figures_of

ROOT = Path(__file__).parents[2]
# its tests look at the same runs
pytestmark = pytest.mark.xdist_group("hyperelastic in UFL")


@functools.cache
def demo(*options: str, ranks: int = 1) -> dict:
    """Figures of the study, run by interpreters of its own."""
    return figures_of(
        "demos/studies/hyperelastic_in_ufl.py", "--json", "-", "--no-plot", *options, ranks=ranks
    )


def assert_exact(figures, displacement, stress, rest):
    assert figures["displacement_error"] < displacement
    assert figures["stress_error"] < stress
    assert figures["area_ratio"] == pytest.approx(figures["area_ratio_exact"], rel=rest)
    assert figures["stored_energy"] == pytest.approx(figures["stored_energy_exact"], rel=rest)
    assert figures["halvings"] == 0
    assert figures["max_newton_iterations"] <= 5


def test_the_disc_grows_to_its_exact_shape():
    assert_exact(demo(), 1e-3, 0.08, 3e-3)


@pytest.mark.parametrize(
    "options",
    [
        pytest.param(("--law", "gent"), marks=pytest.mark.long),
        pytest.param(("--growth", "0.4"), marks=pytest.mark.long),
        pytest.param(("--growth=-0.3",), marks=pytest.mark.long),
        pytest.param(
            ("--poisson", "0", "--modulus", "7e5", "--radius", "3"), marks=pytest.mark.long
        ),
    ],
)
def test_other_energies_and_other_growth(options):
    assert_exact(demo(*options), 3e-3, 0.13, 8e-3)


@pytest.mark.parametrize("cells", [(8, 16), pytest.param((16, 32), marks=pytest.mark.long)])
def test_the_error_falls_with_refinement(cells):
    # 16 is the study's own number
    coarse, fine = (demo() if n == 16 else demo("--cells", str(n)) for n in cells)
    displacement, stress = (1.5, 1.1) if cells[0] == 8 else (2 / 1.5, 1.2 / 1.1)
    assert coarse["displacement_error"] > displacement * fine["displacement_error"]
    assert coarse["stress_error"] > stress * fine["stress_error"]


def test_ones_own_energy_and_penalty_are_those_of_the_library():
    assert demo()["difference_from_library"] < 1e-13


@pytest.mark.long
def test_ones_own_penalty_is_that_of_the_library_as_a_stabilisation():
    ghost = demo("--stabilisation", "ghost")
    assert ghost["difference_from_library"] < 1e-13
    for name in ("displacement_error", "stress_error", "stored_energy", "condition_number"):
        assert ghost[name] == pytest.approx(demo()[name], rel=1e-8)


def test_what_the_penalty_is_for():
    figures = demo()
    assert figures["condition_number"] < 3e3
    assert figures["bare_condition_number"] > 1e6
    # and it does not cost accuracy
    assert figures["displacement_error"] < figures["bare_displacement_error"]
    assert figures["stress_error"] < figures["bare_stress_error"]
    assert figures["newton_iterations"] <= figures["bare_newton_iterations"]


@pytest.mark.long
def test_without_the_penalty():
    figures = demo()
    bare = demo("--stabilisation", "none")
    for name in ("displacement_error", "stress_error", "newton_iterations"):
        assert bare[name] == pytest.approx(figures[f"bare_{name}"], rel=1e-6)


@pytest.mark.long
@pytest.mark.skipif(shutil.which("mpirun") is None, reason="needs mpirun")
def test_figures_do_not_depend_on_the_ranks():
    one, many = demo(), demo(ranks=3)
    assert many["ranks"] == 3
    assert many["migrated"] > 0
    assert many["points"] == one["points"]
    assert many["difference_from_library"] < 1e-13
    for name in ("displacement_error", "stress_error", "area_ratio", "stored_energy"):
        assert many[name] == pytest.approx(one[name], rel=1e-9)
    assert many["condition_number"] == pytest.approx(one["condition_number"], rel=1e-6)
    np.testing.assert_allclose(many["area_ratio_exact"], one["area_ratio_exact"], rtol=1e-12)
