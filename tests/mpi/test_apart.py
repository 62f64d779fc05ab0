"""A rank that waits in vain says so once and ends the run; one that others only keep does not."""

from __future__ import annotations

import re
import shutil

import pytest
from conftest import start
from run_apart import ALONE

pytestmark = pytest.mark.skipif(shutil.which("mpirun") is None, reason="needs mpirun")

TOLD = "dolfinmpm: rank"
# those whose calls begin in other modules than the rest
SHORT = ("step", "gather", "write")


def ended(monkeypatch, name, limit, ranks=2):
    """What a run printed as errors."""
    monkeypatch.setenv("DOLFINMPM_WAIT", str(limit))
    return start("tests/mpi/run_apart.py", name, ranks=ranks, timeout=120)


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[pytest.mark.long] * (n not in SHORT)) for n in ALONE]
)
def test_a_call_of_one_rank_ends_when_the_others_have(monkeypatch, name):
    # the limit is not waited for: who has come to the end will not come back
    done = ended(monkeypatch, name, 100)
    assert done.returncode != 0
    assert done.stderr.count(TOLD) == 1
    call = "write_table" if name == "table" else name.split()[0]
    assert f"{call}, line " in done.stderr
    assert " of run_apart.py. Rank 1 has come to the end of its script." in done.stderr
    assert "All ranks are ended" in done.stderr


def test_a_call_of_one_rank_is_told_and_ended_after_the_limit(monkeypatch):
    done = ended(monkeypatch, "beside", 4, ranks=3)
    assert done.returncode != 0
    first, last = (line for line in done.stderr.splitlines() if line.startswith(TOLD))
    assert re.match(r"dolfinmpm: rank 0 has waited for [23] s in QuasiStatic.step, line ", first)
    for rank in (1, 2):
        assert f"Rank {rank} is at line " in first
    assert " of run_apart.py in no call of dolfinmpm." in first
    assert "All ranks are ended after 4 s (DOLFINMPM_WAIT = 4; 0 is never)." in first
    assert re.match(r"dolfinmpm: rank 0 has waited for [45] s in QuasiStatic.step, line ", last)
    assert last.endswith("All ranks are ended (DOLFINMPM_WAIT = 4).")


def test_the_first_call_may_be_the_one_that_waits(monkeypatch):
    done = ended(monkeypatch, "at_first", 2)
    assert done.returncode != 0
    assert re.search(r"rank 0 has waited for \d s in fill, line ", done.stderr)
    assert "Rank 1 is at line " in done.stderr
    assert done.stderr.count(TOLD) == 2


def test_ranks_that_take_long_are_waited_for(monkeypatch):
    # longer than the limit within a call, and less than that outside
    done = ended(monkeypatch, "slow", 8)
    assert done.returncode == 0, done.stderr
    assert "all are here" in done.stdout
    assert done.stderr.count(TOLD) == 1
    assert " in work, line " in done.stderr


def test_a_call_that_one_rank_left_by_an_error_ends(monkeypatch):
    done = ended(monkeypatch, "left", 2)
    assert done.returncode != 0
    assert re.search(r"rank 1 has waited for \d s in work, line ", done.stderr)
    assert "in a call that rank 1 left by an error" in done.stderr


def test_groups_of_ranks_meet_among_themselves(monkeypatch):
    done = ended(monkeypatch, "halves", 2, ranks=3)
    assert done.returncode == 0, done.stderr
    assert "masses 1.0 1.0 2.0" in done.stdout
    assert TOLD not in done.stderr


def test_a_limit_that_is_none_is_refused(monkeypatch):
    done = ended(monkeypatch, "slow", "soon")
    assert done.returncode == 1
    assert "DOLFINMPM_WAIT = 'soon' must be a number of seconds" in done.stderr
