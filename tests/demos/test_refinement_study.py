"""The study of refined spaces at small sizes: orders, gains, conditioning, patches."""

from __future__ import annotations

import pytest
from conftest import figures_of


def run(study, *options):
    return figures_of(f"demos/studies/{study}.py", "--json", "-", *options)


def test_refinement(tmp_path):
    options = "--column 8,16 --footing 0.5,0.25 --lines 0.5 --leaves 0.25,0.125 --corner 4,8"
    options += " --places 8 --trees 3 --parts column,footing,corner,conditioning,patch"
    figures = run("refinement", *options.split(), "--output", str(tmp_path))
    assert figures["corner"]["orders"]["uniform"] == pytest.approx(0.54, abs=0.06)
    assert figures["corner"]["orders"]["leaves"] > 0.9
    assert figures["corner"]["share"] < 0.15
    assert figures["footing"]["share"] < 0.2
    assert len(figures["column"]["runs"]) == 6
    assert figures["conditioning"]["spread"] < 20
    assert figures["patch"]["worst"] < 1e-12
    for name in ("refinement.png", "refinement.csv"):
        assert (tmp_path / name).stat().st_size > 0


def test_refinement_of_splines():
    options = "--parts corner,conditioning,patch --basis bspline2 --corner 4,8 --places 8 --trees 3"
    figures = run("refinement", *options.split(), "--no-plot")
    assert figures["corner"]["orders"]["uniform"] == pytest.approx(0.54, abs=0.1)
    assert figures["corner"]["orders"]["leaves"] > 1.9
    assert figures["conditioning"]["spread"] < 20
    assert figures["patch"]["worst"] < 1e-12


@pytest.mark.long
def test_refinement_at_a_cone(tmp_path):
    options = "--parts cone --cone 1,0.5 --cone-lines 1,0.5 --cone-leaves 1,0.5 --cone-finest .25"
    figures = run("refinement", *options.split(), "--output", str(tmp_path))
    # finer cells are nearer to the finest, and leaves need fewer unknowns than equal cells; rough
    # leaves may be near by chance
    errors = {}
    for one in figures["cone"]["runs"]:
        errors.setdefault(one["grid"], []).append(one["error"])
    for grid in ("uniform", "graded lines"):
        rough, fine = errors[grid]
        assert fine < rough
        assert errors["leaves"][1] < fine
    assert figures["cone"]["gain"]["uniform"]["same_cells"]["unknowns"] > 3
    assert figures["cone"]["finest"]["ratio"] > 12
