"""The plain program of each step of the course, copied from its page, gives the page's figures."""

from __future__ import annotations

import subprocess
import sys

import pytest
from bs4 import BeautifulSoup
from conftest import HTML, width
from selenium.webdriver.common.by import By

STEPS = sorted(path.stem for path in (HTML / "course").glob("step_*.html"))


def printed(page: str) -> str:
    """What the program printed when the site was built."""
    tree = BeautifulSoup((HTML / "course" / f"{page}.html").read_text(), "html.parser")
    return "".join(part.get_text() for part in tree.select(".sphx-glr-script-out pre")).strip()


@pytest.mark.parametrize("page", STEPS)
def test_copied(page, site, browser, tmp_path):
    width(browser, 1280)
    browser.get(f"{site}course/{page}.html")
    program = browser.find_element(By.CSS_SELECTOR, ".plain-program pre").get_property(
        "textContent"
    )
    assert len([line for line in program.splitlines() if line.strip()]) <= 60
    (tmp_path / "case.py").write_text(program)
    run = subprocess.run(
        [sys.executable, "case.py"], cwd=tmp_path, capture_output=True, text=True, timeout=600
    )
    assert run.returncode == 0, run.stderr
    assert printed(page)
    assert run.stdout.strip() == printed(page)


def test_there_are_eight():
    assert len(STEPS) == 8
