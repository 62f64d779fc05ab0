"""The gallery: each card has a picture and says how far its program is off, and filters work."""

from __future__ import annotations

import hashlib

import pytest
from bs4 import BeautifulSoup
from conftest import HTML, width
from selenium.webdriver.common.by import By
from selenium.webdriver.support.select import Select

PAGE = BeautifulSoup((HTML / "demos" / "index.html").read_text(), "html.parser")
CARDS = {
    card.select_one("a")["href"].removesuffix(".html"): card
    for card in PAGE.select(".gallery-card")
}


@pytest.mark.parametrize("name", CARDS)
def test_card(name):
    card = CARDS[name]
    assert card.select_one("img") is not None
    judged = card.select_one(".judged")
    assert any(letter.isdigit() for letter in judged.select_one("b").text), judged


def test_each_card_has_a_picture_of_its_own():
    files = [(HTML / "demos" / img["src"]).resolve() for img in PAGE.select(".gallery-card img")]
    sums = [hashlib.sha256(file.read_bytes()).hexdigest() for file in files]
    assert len(sums) == len(set(sums)) > 40


def test_filters(site, browser):
    width(browser, 1280)
    browser.get(site + "demos/index.html")

    def seen():
        cards = browser.find_elements(By.CSS_SELECTOR, ".gallery-card")
        return [card for card in cards if card.is_displayed()]

    assert len(seen()) == len(CARDS) > 40
    for key, value in (("physics", "soil and water"), ("dimension", "3D")):
        choice = Select(browser.find_element(By.CSS_SELECTOR, f"[data-filter={key}]"))
        choice.select_by_visible_text(value)
        assert 0 < len(seen()) < len(CARDS)
        assert all(card.get_attribute(f"data-{key}") == value for card in seen())
    count = browser.find_element(By.CSS_SELECTOR, ".gallery-count").text
    assert count == f"{len(seen())} programs"
