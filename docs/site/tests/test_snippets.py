"""The Python programs on the pages run: all blocks of a page are one program."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import DOCS

BLOCK = re.compile(r"^```python\n(.*?)^```$", re.DOTALL | re.MULTILINE)
FOLDERS = ("howto", "theory")
PAGES = {
    str(page.relative_to(DOCS)): "\n".join(blocks)
    for folder in FOLDERS
    for page in sorted((DOCS / folder).glob("*.md"))
    if (blocks := BLOCK.findall(page.read_text()))
}


@pytest.mark.parametrize("page", PAGES)
def test_page_runs(page: str, tmp_path: Path) -> None:
    (tmp_path / "page.py").write_text(PAGES[page])
    command = [sys.executable, "-W", "error::UserWarning", "page.py"]
    run = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=600)
    assert run.returncode == 0, run.stderr[-3000:]
