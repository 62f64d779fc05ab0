"""The plain program of each step of the course, copied from its page, is what has run for it."""

from __future__ import annotations

import ast
import subprocess
import sys

import pytest
from bs4 import BeautifulSoup
from conftest import DOCS, HTML, width
from selenium.webdriver.common.by import By

STEPS = sorted(path.stem for path in (HTML / "course").glob("step_*.html"))
# its program runs again, from the text that a reader copies
AGAIN = "step_5_rigid_body"


def printed(page: str) -> str:
    """What the program printed when the site was built."""
    tree = BeautifulSoup((HTML / "course" / f"{page}.html").read_text(), "html.parser")
    return "".join(part.get_text() for part in tree.select(".sphx-glr-script-out pre")).strip()


def statements(program: str) -> str:
    """A program without its comments and its first text."""
    tree = ast.parse(program)
    if ast.get_docstring(tree) is not None:
        tree.body.pop(0)
    return ast.dump(tree)


@pytest.mark.parametrize("page", STEPS)
def test_copied(page, site, browser, tmp_path):
    width(browser, 1280)
    browser.get(f"{site}course/{page}.html")
    program = browser.find_element(By.CSS_SELECTOR, ".plain-program pre").get_property(
        "textContent"
    )
    assert len([line for line in program.splitlines() if line.strip()]) <= 60
    assert printed(page)
    # what has run for the page
    assert statements(program) == statements((DOCS / "course" / f"{page}.py").read_text())
    if page == AGAIN:
        (tmp_path / "case.py").write_text(program)
        run = subprocess.run(
            [sys.executable, "case.py"], cwd=tmp_path, capture_output=True, text=True, timeout=600
        )
        assert run.returncode == 0, run.stderr
        assert run.stdout.strip() == printed(page)


def test_there_are_eight():
    assert len(STEPS) == 8
