"""Find anything by keyboard, over any page, and on a phone under the thumb."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from playwright.sync_api import expect

from tests.e2e.conftest import OpensPages
from tests.e2e.limits import PAGE_MS
from tests.e2e.test_screen import ENGLISH, PANEL, PHONE, opened


def test_a_parameter_is_found_and_opened_by_keyboard(
    shared_page: OpensPages, flaws: Callable[..., list[str]]
) -> None:
    page = opened(shared_page("engineer", viewport=PANEL, locale=ENGLISH), "/units/line/1")
    page.keyboard.press("Control+k")
    page.keyboard.type("accel")
    place = page.locator(".find__place").first
    expect(place).to_contain_text("(parameter 6)")
    assert flaws(page, ENGLISH) == []
    page.keyboard.press("ArrowDown")
    expect(place).to_be_focused()
    page.keyboard.press("Enter")
    page.wait_for_url("**/units/line/1/parameters#parameter-6", timeout=PAGE_MS)


@pytest.mark.soak
def test_a_phone_has_the_other_pages_one_press_away(
    shared_page: OpensPages, flaws: Callable[..., list[str]]
) -> None:
    page = opened(shared_page("engineer", viewport=PHONE, locale=ENGLISH), "/")
    assert page.locator(".rail__item:visible").count() == 5
    page.get_by_role("button", name="More").click()
    recipes = page.get_by_role("navigation").get_by_role("link", name="Recipes")
    expect(recipes).to_be_in_viewport(ratio=1)
    assert flaws(page, ENGLISH) == []
    recipes.click()
    page.wait_for_url("**/recipes", timeout=PAGE_MS)


def test_the_legend_is_one_key_away(shared_page: OpensPages) -> None:
    page = opened(shared_page("viewer", viewport=PANEL, locale=ENGLISH), "/")
    page.keyboard.press("?")
    expect(page.locator("#legend")).to_contain_text("Only an outline")
    page.keyboard.press("Escape")
    expect(page.locator("#legend")).to_be_hidden()
