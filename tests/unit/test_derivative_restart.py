"""Derivatives of a run that was broken off, and of the same run in one go."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from dolfinmpm import study
from dolfinmpm._platform.errors import CheckpointError, ParameterError

sys.path.append(str(Path(__file__).resolve().parents[2] / "demos" / "studies"))
from derivative_scenes import CASES, sizes_of

# example → its parameters in this test; points begin to yield in some steps of the first
TRIED = {
    "von Mises": ["yield", "E"],
    "contact with friction": ["friction"],
    "consolidation": ["permeability"],
    "arc length": ["E"],
    "Newmark": ["density"],
    "explicit": ["velocity"],
}


class BrokenOff(RuntimeError):
    """What ends a run in the middle."""


def broken_off(scene, after):
    """An example whose run at the parameters themselves ends after some steps."""
    runs = []

    def example(m):
        run = scene(m)
        runs.append(run)
        if len(runs) > 1:
            return run

        def stop():
            raise BrokenOff

        return study.Run(run.problem, [*run.steps[:after], stop, *run.steps[after:]], run.measured)

    return example


@pytest.mark.parametrize("name", TRIED)
@pytest.mark.parametrize("estimate", [False, True])
def test_derivatives_go_on_after_an_interruption(name, estimate, tmp_path):
    if estimate and name not in ("von Mises", "arc length"):
        pytest.skip("two examples are enough for two perturbations")
    scene, every_parameter = CASES[name]
    chosen = {k: every_parameter[k] for k in TRIED[name]}
    rest = {k: v for k, v in every_parameter.items() if k not in chosen}
    scales = {k: v for k, v in sizes_of(name).items() if k in chosen}

    def example(m):
        return scene({**rest, **m})

    options = {"scales": scales, "estimate": estimate}
    whole = study.differentiate(example, chosen, **options)
    kept = {"restart": tmp_path / "kept", "every": 2}
    with pytest.raises(BrokenOff):
        study.differentiate(broken_off(example, 3), chosen, **options, **kept)
    index = json.loads((tmp_path / "kept" / "derivatives.json").read_text())
    assert index["taken"] == 2
    # the run, and one or more per parameter, of one set only
    archives = {path.name.split("_")[0] for path in (tmp_path / "kept").glob("*.npz")}
    assert archives == {"step2"}
    found = study.differentiate(example, chosen, **options, **kept)
    assert found.notes == whole.notes
    for k, by in whole.derivatives.items():
        np.testing.assert_array_equal(found.figures[k], whole.figures[k])
        for m, values in by.items():
            size = np.abs(values).max()
            np.testing.assert_allclose(found.derivatives[k][m], values, rtol=0, atol=1e-7 * size)


def test_checkpoints_of_other_parameters_are_refused(tmp_path):
    scene, parameters = CASES["von Mises"]
    kept = {"restart": tmp_path, "every": 1}
    study.differentiate(scene, {k: np.float32(v) for k, v in parameters.items()}, **kept)
    parameters = {k: float(np.float32(v)) for k, v in parameters.items()}
    with pytest.raises(ParameterError, match=r"with parameters = .* remove the old one"):
        study.differentiate(scene, {**parameters, "E": 2 * parameters["E"]}, **kept)
    with pytest.raises(ParameterError, match="has a run with epsilon = 8e-08"):
        study.differentiate(scene, parameters, epsilon=1e-6, **kept)

    def shorter(m):
        run = scene(m)
        return study.Run(run.problem, run.steps[:2], run.measured)

    with pytest.raises(ParameterError, match="has 5 steps, and this run takes 2"):
        study.differentiate(shorter, parameters, **kept)
    (tmp_path / "derivatives.json").write_text('{"made_by": ')
    with pytest.raises(CheckpointError, match=r"derivatives.json' is damaged .* begin anew"):
        study.differentiate(scene, parameters, **kept)


def test_what_cannot_be_restarted_is_refused(tmp_path):
    scene, parameters = CASES["von Mises"]

    def iterated(m):
        run = scene(m)
        return study.Run(run.problem, (step() for step in run.steps), run.measured)

    with pytest.raises(ParameterError, match="an iterator can leave out none"):
        study.differentiate(iterated, parameters, restart=tmp_path)
    with pytest.raises(ParameterError, match="restart = 3 must be a path"):
        study.differentiate(scene, parameters, restart=3)
    with pytest.raises(ParameterError, match="every = 0"):
        study.differentiate(scene, parameters, restart=tmp_path, every=0)
