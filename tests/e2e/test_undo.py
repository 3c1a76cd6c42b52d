"""Undo offers the value before the command that it follows, or is not offered."""

from __future__ import annotations

import re

import pytest
from playwright.sync_api import Locator, Page, expect

from tests.e2e.conftest import OpensPages
from tests.e2e.site import Site, eventually

UNIT = 8


@pytest.fixture
def page(site: Site, shared_page: OpensPages) -> Page:
    """The page of a unit at 115.0 that was set to 111.0, with the way back to 115.0 on it."""
    site.set_speed(UNIT, value="115.0")
    opened = shared_page(viewport={"width": 1280, "height": 800})
    opened.goto(f"{site.url}/units/line/{UNIT}")
    expect(opened.locator("body")).to_have_attribute("data-link", "live")
    expect(opened.locator("#setpoint")).to_have_value("115.0")
    opened.locator("#setpoint").fill("111.0")
    send(opened, "Set now")
    expect(undo(opened)).to_have_text("Undo: set 115.0…")
    return opened


def undo(page: Page) -> Locator:
    return page.get_by_role("button", name=re.compile("Undo"))


def send(page: Page, opens_review: str) -> None:
    """One reviewed command, until its review is gone."""
    page.get_by_role("button", name=opens_review).click()
    page.locator("[data-review-act]").click()
    expect(page.locator("[data-review-done=good]").last).to_be_visible()
    close = page.locator("dialog[open] [data-review-cancel]")
    if close.count():
        close.click()
    expect(page.locator("[data-review]")).to_have_count(0)


def stage(page: Page, value: str) -> None:
    page.locator("#setpoint").fill(value)
    send(page, "Stage…")
    expect(page.locator(f'[data-live="line/{UNIT}.staged"]').first).to_have_text(re.compile(value))


@pytest.mark.soak
def test_after_execute_staged_undo_offers_what_was_commanded_before_it(site: Site, page: Page) -> None:
    stage(page, "119.0")
    send(page, "Execute staged")
    expect(undo(page)).to_have_text("Undo: set 111.0…")
    undo(page).click()
    page.locator("[data-review-act]").click()
    expect(page.locator("[data-review-done=good]")).to_contain_text("reads 111.0")
    assert site.unit(UNIT)["commanded"] == "111.0"


@pytest.mark.soak
def test_each_command_has_its_own_undo_and_the_one_before_comes_back(page: Page) -> None:
    page.get_by_role("button", name="Up by 0.2").click()
    expect(undo(page)).to_have_text("Undo: set 111.0…")
    page.goto("/alarms")
    page.goto(f"/units/line/{UNIT}")
    undo(page).click()
    page.locator("[data-review-act]").click()
    expect(page.locator("[data-review-done=good]")).to_contain_text("reads 111.0")
    expect(undo(page)).to_have_text("Undo: set 115.0…")


def test_an_output_is_switched_back(site: Site, page: Page) -> None:
    on = site.unit(UNIT)["outputs"][2]
    page.get_by_role("button", name="Switch output 3").click()
    page.locator("[data-review-act]").click()
    result = page.locator("#outputs-result [data-review-done=good]")
    expect(result).to_be_visible()
    # The page offers it too, once it has seen the command.
    result.get_by_role("button", name=re.compile("Undo: switch output 3")).click()
    page.locator("[data-review-act]").click()
    expect(result).to_contain_text("output 3 is on" if on else "output 3 is off")
    assert site.unit(UNIT)["outputs"][2] == on


def test_what_was_typed_is_a_draft_on_the_next_page(page: Page) -> None:
    page.locator("#setpoint").fill("66.6")
    page.goto("/alarms")
    page.goto(f"/units/line/{UNIT}")
    expect(page.locator("[data-draft]")).to_contain_text("not sent")
    expect(page.locator("#setpoint")).to_have_value("66.6")
    page.get_by_role("button", name="Discard draft").click()
    expect(page.locator("#setpoint")).not_to_have_value("66.6")
    page.reload()
    expect(page.locator("[data-draft]")).to_have_count(0)


def test_what_was_staged_is_no_draft_any_more(site: Site, page: Page) -> None:
    page.locator("#setpoint").fill("66.6")
    page.get_by_role("button", name="Stage…").click()
    page.locator("[data-review-act]").click()
    expect(page.locator("[data-review-done=good]")).to_be_visible()
    assert site.unit(UNIT)["staged"] == "66.6"
    page.goto("/alarms")
    page.goto(f"/units/line/{UNIT}")
    expect(page.locator("#setpoint")).not_to_have_value("66.6")
    expect(page.locator("[data-draft]")).to_have_count(0)
    site.set_speed(UNIT, value="60.0")


@pytest.mark.soak
def test_setting_the_line_to_zero_ends_the_undo_before_it_and_has_none(site: Site, page: Page) -> None:
    before = [site.unit(number)["commanded"] for number in range(1, UNIT + 1)]
    try:
        send(page, "Set line to zero")
        # Requested apart, as an offer that lapses would be gone in time, too.
        offered = page.request.get(f"{site.url}/bus/line/undo?unit={UNIT}")
        assert offered.ok
        assert "<button" not in offered.text()
        expect(undo(page)).to_have_count(0)
    finally:
        for number, value in enumerate(before, 1):
            site.set_speed(number, value=value)


@pytest.mark.soak
def test_an_execute_is_refused_where_the_setpoint_has_moved_since_the_review(site: Site, page: Page) -> None:
    stage(page, "119.0")
    page.get_by_role("button", name="Execute staged").click()
    was = page.locator('[data-review] [name="was"]')
    expect(was).to_have_value("1110")
    was.evaluate("field => (field.value = '1150')")
    page.locator("[data-review-act]").click()
    expect(page.locator("[data-review-done=bad]")).to_be_visible()
    eventually(lambda: site.unit(UNIT)["commanded"] == "111.0", "nothing was executed")
