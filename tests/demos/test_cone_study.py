"""The study of a cone that penetrates the ground, at small sizes."""

from __future__ import annotations

import numpy as np
import pytest
from test_studies import run


@pytest.mark.long
def test_a_cone_in_clay(tmp_path):
    options = "--h", "0.5", "--step", "0.1", "--depth", "8.5", "--width", "15"
    found = run("cone_penetration", *options, "--output", str(tmp_path), ranks=2)
    assert not found["reason"]
    assert found["reached"] == pytest.approx(8.5)
    # cells of half the radius are coarse
    assert abs(found["error"]) < 0.15
    assert found["scatter"] < 0.1 * found["factor"]
    assert found["halvings"] <= 2
    assert (tmp_path / "cone_penetration_tresca_axisymmetric.png").stat().st_size > 0


def test_cells_that_follow_the_tip(tmp_path):
    """Cells around the tip alone find the force of a grid that is fine all along the way."""
    options = "--h", "0.25", "--step", "0.1", "--depth", "7.5", "--width", "15"
    alike = "--ghost", "0.03", "--penalty", "1", "--fbar", "volumes", "--no-plot"
    fine = run("cone_penetration", *options, *alike)
    found = run("cone_penetration", "--refine", *options, "--output", str(tmp_path))
    assert not found["reason"]
    assert found["halvings"] == 0
    last = slice(-5, None)
    ratio = np.mean(found["factors"][last]) / np.mean(fine["factors"][last])
    assert ratio == pytest.approx(1.0, abs=0.05)
    assert found["unknowns"] < fine["unknowns"]
    assert (tmp_path / "cone_penetration_tresca_axisymmetric.png").stat().st_size > 0


def test_the_law_of_clay_decides(tmp_path):
    """Von Mises' clay that is as strong in simple shear as Tresca's carries less at the cone."""
    options = "--refine", "--h", "0.5", "--step", "0.1", "--depth", "6.5", "--width", "15"
    laws = "tresca", "shear", "compression"
    found = [run("cone_penetration", *options, "--criterion", law, "--no-plot") for law in laws]
    tresca, shear, compression = (one["factor_late"] for one in found)
    assert shear < 0.97 * tresca
    assert compression == pytest.approx(tresca, rel=0.05)
    for one in found:
        assert one["factor_late"] == pytest.approx(np.mean(one["factors"]))
        assert one["factor_lu"] * (1 + one["late_from_lu"]) == pytest.approx(one["factor_late"])


@pytest.mark.parametrize(
    "stabilisation", ["ghost", pytest.param("aggregation", marks=pytest.mark.long)]
)
def test_a_cone_in_sand(tmp_path, stabilisation):
    """It is harder the deeper it goes, and the shaft carries what friction it has."""
    options = "--law", "sand", "--h", "0.2", "--step", "0.04", "--depth", "0.96", "--width", "4"
    found = run(
        "cone_penetration", *options, "--stabilisation", stabilisation, "--output", str(tmp_path)
    )
    assert not found["reason"]
    depth, force, shaft = (np.array(found[name]) for name in ("depths", "forces", "shaft"))
    shoulder = depth - 0.4 * 3**0.5
    assert force[-1] > 2 * force[np.searchsorted(depth, 0.5)] > 0
    assert not shaft[shoulder < -0.1].any()
    assert 0 < shaft[-1] < 0.3 * force[-1]
    assert (tmp_path / "cone_penetration_sand_axisymmetric.png").stat().st_size > 0


@pytest.mark.long
def test_a_quarter_of_a_cone_in_three_dimensions(tmp_path):
    """As soon as the gaps beside it are closed it carries what the body of revolution does."""
    options = "--h", "0.5", "--step", "0.1", "--depth", "7.2", "--zone", "1.5"
    options = *options, "--width", "8", "--growth", "2"
    flat = run("cone_penetration", *options, "--no-plot")
    whole = run("cone_penetration", *options, "--dimension", "3", "--output", str(tmp_path))
    assert not whole["reason"]
    last = slice(-3, None)
    ratio = np.mean(whole["factors"][last]) / np.mean(flat["factors"][last])
    assert ratio == pytest.approx(1.0, abs=0.1)
    assert (tmp_path / "cone_penetration_tresca_3.png").stat().st_size > 0


@pytest.mark.long
def test_drainage_decides_what_a_cone_carries(tmp_path):
    """Between what is drained and Teh & Houlsby's factor, half of it near v d/c_v = 3."""
    options = "--curve", "--velocities", "0.01,3,30,1000", "--depth", "8"
    found = run("cone_penetration", *options, "--output", str(tmp_path))
    assert not any(one["reason"] for one in found["runs"])
    assert 1.3 < found["drained_ratio"] < 4
    assert 1 < found["V50"] < 15
    assert found["runs"][-1]["factor"] == pytest.approx(9.72, rel=0.15)
    assert found["runs"][-1]["pore_ratio"] > 0.5
    for name, way in (("factor", -1), ("pore_ratio", 1)):
        assert np.all(way * np.diff([one[name] for one in found["runs"]]) > 0)
    assert (tmp_path / "cone_penetration_curve.png").stat().st_size > 0


@pytest.mark.long
def test_a_cone_in_water_is_the_same_on_two_ranks():
    """A step may have two solutions, as corners pass the tip; rounding does not choose of them."""
    options = "--partly", "--depth", "5", "--no-plot"
    one, two = (run("cone_penetration", *options, ranks=ranks) for ranks in (1, 2))
    assert not one["reason"]
    # one step is halved: it begins from increments of the last step that lead it away
    assert one["halvings"] == two["halvings"] <= 2
    assert one["newton_iterations"] == two["newton_iterations"] <= 100
    np.testing.assert_allclose(two["factors"], one["factors"], rtol=1e-8)
