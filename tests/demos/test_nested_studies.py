"""Nested grids for displacement and pressure: studies at small sizes."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import figures_of


def study(name: str, *options: str, ranks: int = 1) -> dict:
    return figures_of(f"demos/studies/{name}.py", "--json", "-", "--no-plot", *options, ranks=ranks)


@pytest.mark.long
def test_constants_of_nested_grids():
    pairs, stabilisations = "nested,linear-linear", "none,ghost,ghost on u,aggregation"
    options = "--places", "4", "--cells", "3", "--uncut", "4,8"
    found = study("inf_sup", *options, "--pairs", pairs, "--stabilisations", stabilisations)
    nested, equal = (found["whole"][pair] for pair in pairs.split(","))
    np.testing.assert_allclose([one["beta"] for one in nested], [0.411, 0.407], atol=6e-4)
    np.testing.assert_allclose([one["beta"] for one in equal], [0.192, 0.110], atol=6e-4)
    assert [one["null"] for one in nested + equal] == [1, 1, 8, 8]
    rows = {row["stabilisation"]: row for row in found["rows"] if row["pair"] == "nested"}
    for stabilisation in ("ghost", "aggregation"):
        row = rows[stabilisation]
        np.testing.assert_allclose(row["betas"], row["beta_uncut"], rtol=0.05)
        assert row["kappa_M"] < 200
        assert row["kappa_K"] < 10 * row["kappa_K_uncut"]
    assert rows["ghost on u"]["beta_least"] < 0.1 * rows["none"]["beta_least"]
    two = study("inf_sup", *options, "--pairs", "nested", "--stabilisations", "ghost", ranks=2)
    np.testing.assert_allclose(two["rows"][0]["betas"], rows["ghost"]["betas"], rtol=1e-9)


@pytest.mark.long
def test_constants_of_quadratic_splines_with_linear_pressures():
    """They fall with the size of the cells, cut or not, and do not with the projection."""
    options = "--places", "6", "--cells", "4", "--uncut", "4,8,16", "--stabilisations", "ghost"
    pairs = "bspline2-linear", "bspline2-linear-projected"
    found = study("inf_sup", *options, "--pairs", ",".join(pairs))
    alone, projected = ([one["beta"] for one in found["whole"][pair]] for pair in pairs)
    np.testing.assert_allclose(alone, [0.378, 0.267, 0.167], atol=6e-4)
    assert projected[0] > projected[2] > 0.5
    for row in found["rows"]:
        np.testing.assert_allclose(row["betas"], row["beta_uncut"], rtol=0.08)


def test_a_layer_on_nested_grids_consolidates():
    options = "--pair", "nested", "--h", "0.0625", "--steps", "60", "--load", "0.2"
    figures = study("consolidation", *options, "--times", "0.2,0.5,1")
    assert figures["U_error"] < 0.01
    assert figures["base_pressure_error"] < 0.01
    assert figures["overshoot"] < 0.01


@pytest.mark.long
def test_first_steps_of_all_lengths():
    options = "--sweep", "--cuts", "1e-6,0.3,0.49", "--shares", "1e-8,0.1,0.25"
    for more in (("--pair", "nested"), ("--stabilisation", "aggregation", "--theta", "1")):
        found = study("consolidation", *options, *more)
        assert np.shape(found["overshoots"]) == (3, 3)
        assert found["overshoot"] < 0.01
