"""Notebooks run from top to bottom in a kernel of their own, and show tables, pictures, films."""

from __future__ import annotations

from pathlib import Path

import nbformat
import pytest
from conftest import DOCS
from nbclient import NotebookClient

NOTEBOOKS = sorted(str(file.relative_to(DOCS)) for file in DOCS.glob("notebooks/*.ipynb"))


def shown(notebook: nbformat.NotebookNode) -> list[set[str]]:
    """The kinds of results of each cell of code, such as "image/png"."""
    codes = [cell for cell in notebook.cells if cell.cell_type == "code"]
    return [{kind for out in cell.outputs for kind in out.get("data", ())} for cell in codes]


def run(name: str, folder: Path) -> nbformat.NotebookNode:
    notebook = nbformat.read(DOCS / name, as_version=4)
    resources = {"metadata": {"path": str(folder)}}
    NotebookClient(notebook, timeout=600, kernel_name="python3", resources=resources).execute()
    return notebook


@pytest.mark.parametrize("name", NOTEBOOKS)
def test_notebook_is_kept_without_results(name):
    notebook = nbformat.read(DOCS / name, as_version=4)
    nbformat.validate(notebook)
    assert all(cell.get("outputs", []) == [] for cell in notebook.cells)


def test_first_steps(tmp_path):
    kinds = shown(run("notebooks/first_steps.ipynb", tmp_path))
    assert len(kinds) == 4
    assert "text/html" in kinds[0]
    assert "text/html" in kinds[1]
    assert "image/png" in kinds[2]
    assert "image/gif" in kinds[3]
