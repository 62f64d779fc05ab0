"""Runs that go on with other numbers of ranks."""

from __future__ import annotations

import json
import shutil
import zipfile

import numpy as np
import pytest
from conftest import figures_of

# for hangs alone
LIMIT = 1200

pytestmark = pytest.mark.skipif(shutil.which("mpirun") is None, reason="needs mpirun")


def go_on(source, target, steps, ranks, *options):
    """The file that a run has written after so many steps."""
    arguments = [str(source), str(target), str(steps), *options]
    apart = figures_of("tests/mpi/run_restart.py", *arguments, ranks=ranks, timeout=LIMIT)
    # loads that vary in space come with their cells; positions of nodes are rounded elsewhere
    assert apart < 1e-14
    return target


def content(path):
    """Fields of the points by their id, the history, and how many ranks there were."""
    with zipfile.ZipFile(path) as file:
        header = json.loads(file.read("header.json"))
    with np.load(path) as file:
        names = [name for name in file.files if name.startswith("points/")]
        fields = {name.removeprefix("points/"): file[name] for name in names}
    order = np.argsort(fields["id"])
    fields = {name: values[order] for name, values in fields.items() if name != "cell"}
    return fields, header["history"], header["ranks"]


@pytest.fixture(scope="module")
def chain(tmp_path_factory):
    """Files of a run that is broken off and goes on: 1 → 2 → 3 → 1 ranks, three steps each."""
    folder = tmp_path_factory.mktemp("chain")
    files = [go_on("", folder / "1.npz", 3, 1, "--fresh")]
    for k, ranks in enumerate((2, 3, 1)):
        files.append(go_on(files[-1], folder / f"{k + 2}.npz", 6 + 3 * k, ranks))
    return files


def test_other_ranks_go_on_to_the_same_figures(chain, tmp_path):
    whole, records, _ = content(go_on("", tmp_path / "whole.npz", 12, 1, "--fresh"))
    assert whole["plastic_strain"].max() > 0.1
    assert [content(path)[2] for path in chain] == [1, 2, 3, 1]
    fields, history, _ = content(chain[-1])
    assert fields.keys() == whole.keys()
    for name, values in whole.items():
        scale = np.abs(values).max()
        np.testing.assert_allclose(fields[name], values, rtol=0, atol=1e-12 * scale, err_msg=name)
    assert len(history) == len(records) == 12
    assert sum(record["migrated"] for record in history) > 0


@pytest.mark.long
def test_going_from_rank_to_rank_changes_no_bit(chain, tmp_path):
    before, records, _ = content(chain[1])
    source = chain[1]
    for k, ranks in enumerate((3, 1, 2)):
        source = go_on(source, tmp_path / f"{k}.npz", 6, ranks)
        fields, history, wrote = content(source)
        assert wrote == ranks
        assert history == records
        for name, values in before.items():
            assert fields[name].tobytes() == values.tobytes(), name
