"""Every page in a browser: no errors, no network, no sideways scrolling, films, links."""

from __future__ import annotations

import functools
import time
from urllib.parse import unquote, urlsplit

import pytest
from bs4 import BeautifulSoup
from conftest import HTML, PAGES, requests, width
from selenium.webdriver.common.by import By

# words that a user would look for, and a page that has to be among the results
WORDS = {
    "ghost": "theory/",
    "GIMP": "theory/",
    "Gmsh": "howto/",
    "Slurm": "install",
    "ParaView": "howto/",
    "checkpoint": "howto/",
    "ConvergenceError": "reference/errors",
    "Tresca": "demos/",
    "Newmark": "theory/",
    "permeability": "theory/",
}
# what reaches beyond the right edge of the page, and cannot be scrolled to by itself
WIDER = """
const limit = document.documentElement.clientWidth;
const scrolls = e => {
    for (; e && e.tagName !== 'MAIN'; e = e.parentElement)
        if (['auto', 'scroll'].includes(getComputedStyle(e).overflowX)) return true;
    return false;
};
const wide = [...document.querySelectorAll('main *')]
    .filter(e => e.getBoundingClientRect().right > limit + 1 && !scrolls(e));
if (document.documentElement.scrollWidth > limit) wide.push(document.documentElement);
return wide.slice(0, 5).map(e => e.tagName + '.' + e.className + ': ' + e.textContent.slice(0, 40));
"""
UNDRAWN = """
return [...document.querySelectorAll('.math')].filter(e => !e.querySelector('mjx-container')).length
"""


def wait(condition, seconds: float = 20.0):
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        found = condition()
        if found:
            return found
        time.sleep(0.05)
    return condition()


@functools.cache
def tree(page: str) -> BeautifulSoup:
    return BeautifulSoup((HTML / page).read_text(), "html.parser")


@pytest.mark.parametrize("page", PAGES)
def test_page(page, site, browser):
    width(browser, 1280)
    browser.get(site + page)
    assert browser.find_elements(By.TAG_NAME, "h1")
    assert wait(lambda: browser.execute_script(UNDRAWN) == 0), "equations that are not drawn"
    assert not browser.find_elements(By.CSS_SELECTOR, "mjx-merror"), "equations with errors"
    width(browser, 360)
    assert browser.execute_script(WIDER) == []
    errors = [entry for entry in browser.get_log("browser") if entry["level"] == "SEVERE"]
    assert errors == []
    assert [url for url in requests(browser) if not url.startswith((site, "data:", "blob:"))] == []


@pytest.mark.parametrize("page", PAGES)
def test_links(page):
    """Links within the site lead to a page, a file, and a place in it."""
    broken = []
    for tag in tree(page).find_all(["a", "img", "source", "video", "script", "link"]):
        link = tag.get("href") or tag.get("src")
        if not link or urlsplit(link).scheme or link.startswith("//"):
            continue
        path, anchor = unquote(urlsplit(link).path), unquote(urlsplit(link).fragment)
        target = (HTML / page).parent.joinpath(path) if path else HTML / page
        if target.is_dir():
            target = target / "index.html"
        if not target.exists():
            broken.append(link)
        elif anchor and target.suffix == ".html" and path != "search.html":
            there = tree(str(target.resolve().relative_to(HTML)))
            if not there.find(id=anchor) and not there.find(attrs={"name": anchor}):
                broken.append(link)
    assert broken == []


@pytest.mark.parametrize("word", WORDS)
def test_search(word, site, browser):
    width(browser, 1280)
    browser.get(f"{site}search.html?q={word}")

    def results():
        links = browser.find_elements(By.CSS_SELECTOR, "#search-results li a")
        return [link.get_attribute("href") for link in links]

    assert wait(lambda: any(WORDS[word] in link for link in results())), results()


def test_light_and_dark(site, browser):
    width(browser, 1280)
    browser.get(site + "index.html")
    colours = {}
    for mode in ("light", "dark"):
        browser.execute_script(f"document.documentElement.dataset.theme = '{mode}'")
        style = "return getComputedStyle(document.body).{}"
        colours[mode] = [
            browser.execute_script(style.format(x)) for x in ("backgroundColor", "color")
        ]

    def brightness(colour):
        return sum(float(x) for x in colour.split("(")[1].rstrip(")").split(",")[:3])

    for mode, sign in (("light", 1), ("dark", -1)):
        back, text = map(brightness, colours[mode])
        assert sign * (back - text) > 400, colours
    button = browser.find_element(By.CSS_SELECTOR, ".theme-switch-button")
    before = browser.execute_script("return document.documentElement.dataset.mode")
    browser.execute_script("arguments[0].click()", button)
    assert browser.execute_script("return document.documentElement.dataset.mode") != before


def test_films_play(site, browser):
    films = [(page, i) for page in PAGES for i, _ in enumerate(tree(page).find_all("video"))]
    assert films, "the site has no film"
    width(browser, 1280)
    for page, i in films:
        browser.get(site + page)
        film = browser.find_elements(By.TAG_NAME, "video")[i]
        browser.execute_script("arguments[0].play()", film)
        assert wait(lambda film=film: float(film.get_property("currentTime")) > 0.1), page
