"""The page of errors: each named error and warning has advice, and its example makes it."""

import tomllib
from pathlib import Path

import pytest

from dolfinmpm import errors

DOCS = Path(__file__).resolve().parents[2] / "docs"
ADVICE = tomllib.loads((DOCS / "reference" / "errors.toml").read_text())


@pytest.fixture
def index(monkeypatch, tmp_path):
    monkeypatch.syspath_prepend(DOCS / "site")
    monkeypatch.chdir(tmp_path)
    return pytest.importorskip("errorindex")


def test_every_named_error_has_advice(index):
    assert set(ADVICE) == set(index.classes())


@pytest.mark.parametrize("name", sorted(ADVICE))
def test_an_example_makes_its_error(index, name):
    module = index.examples()
    example = getattr(module, name, None)
    if example is None:
        assert ADVICE[name]["when"]
    elif module.RANKS.get(name, 1) > 1:
        assert index.message_on_ranks(name, module.RANKS[name])
    else:
        assert index.message_of(name, example, getattr(errors, name))
