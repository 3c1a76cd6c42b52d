"""The wallboard: readable across the hall, complete in one window, accessible in both languages."""

from __future__ import annotations

from collections.abc import Callable
from math import atan, degrees

import pytest
from playwright.sync_api import Page, expect

from tests.e2e.conftest import ENGLISH, GERMAN, OpensPages
from tests.e2e.test_screen import PHONE, opened
from tests.sizes import sizes

HALL = {"width": 1920, "height": 1080}
INCH_MM, DIAGONAL_IN = 25.4, 24
MM_PER_PX = DIAGONAL_IN * INCH_MM / (HALL["width"] ** 2 + HALL["height"] ** 2) ** 0.5
DISTANCE_MM = 6000
MIN_MINUTES_OF_ARC = 16
CAPITAL_PX = """words => {
  const { fontFamily, fontSize, fontWeight } = getComputedStyle(words);
  const context = document.createElement("canvas").getContext("2d");
  context.font = `${fontWeight} ${fontSize} ${fontFamily}`;
  return context.measureText("H").actualBoundingBoxAscent;
}"""
CUT_OFF = """all => all.filter(each => each.scrollHeight > each.clientHeight + 1
  || each.scrollWidth > each.clientWidth + 1).map(each => each.className)"""
LONG = "Stopped: emergency stop active since 28 Feb, 23:59: " + "reason " * 20


def minutes_of_arc(pixels: float) -> float:
    return 60 * degrees(2 * atan(pixels * MM_PER_PX / 2 / DISTANCE_MM))


def nothing_is_cut_off(page: Page, places: str) -> None:
    """Wait until it is so: the page fits its words to the window after the window has its size."""
    page.wait_for_function(
        f"places => ({CUT_OFF})([...document.querySelectorAll(places)]).length === 0", arg=places
    )


def test_the_verdict_is_read_from_six_meters_and_nothing_is_cut_off(shared_page: OpensPages) -> None:
    page = opened(shared_page("viewer", viewport=HALL, locale=ENGLISH), "/wallboard")
    words = page.locator(".wall__words")
    expect(words).to_have_attribute("data-fitted", "0")
    assert minutes_of_arc(words.evaluate(CAPITAL_PX)) >= MIN_MINUTES_OF_ARC
    expect(page.locator(".section")).to_have_count(8)
    for size in (HALL, {"width": 1280, "height": 800}):
        page.set_viewport_size(size)
        assert page.evaluate("document.documentElement.scrollHeight - innerHeight") <= 0
        nothing_is_cut_off(page, ".wall__words, .web, .wall__fact dd")
    # Of a few sections, a roll has room for its draw above and its name below.
    page.locator(".section:nth-child(n + 4)").evaluate_all("all => all.forEach(each => each.remove())")
    for size in (HALL, {"width": 1280, "height": 800}):
        page.set_viewport_size(size)
        nothing_is_cut_off(page, ".web")
    page.locator(".wall__cause").evaluate("(cause, text) => { cause.textContent = text; }", LONG)
    page.set_viewport_size(HALL)
    expect(words).not_to_have_attribute("data-fitted", "0")
    assert words.evaluate_all(CUT_OFF) == []


@pytest.mark.parametrize("locale", sizes(ENGLISH, GERMAN))
def test_it_is_accessible_and_fits_its_window(
    shared_page: OpensPages, flaws: Callable[..., list[str]], locale: str
) -> None:
    page = opened(shared_page("viewer", viewport=PHONE, locale=locale), "/wallboard")
    expect(page.locator(".rail")).to_have_count(0)
    assert flaws(page, locale) == []
