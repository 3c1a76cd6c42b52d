"""The line as used by a person who knows only the command, the configuration and the API."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import httpx
import pytest
from playwright.sync_api import expect

from tests.e2e.conftest import ENGLISH, GERMAN, OpensPages
from tests.e2e.site import Site
from tests.sizes import in_turn

OFFICE = {"width": 1280, "height": 800}


def test_the_page_shows_the_units_values(site: Site, shared_page: OpensPages) -> None:
    page = shared_page("viewer", viewport=OFFICE)
    page.goto("/")
    for unit in range(1, 9):
        raw = site.line.remote.do("state", unit=unit)["commanded"]
        expect(page.locator(f'[data-live="line/{unit}.commanded"]').first).to_have_text(f"{raw / 10:.1f}")


BOXES = """selector => [...document.querySelectorAll(selector)].map(each => {
  const { x, y, width, height } = each.getBoundingClientRect();
  return [each.className, ...[x, y + scrollY, width, height].map(Math.round)].join(" ");
})"""
KEEP_THEIR_PLACES = ".tile, .tile__actual, .tile__actual .value__number, .totals > [data-is], .views"


@pytest.mark.parametrize(
    ("size", "locale"), [(OFFICE, ENGLISH), ({"width": 360, "height": 740}, GERMAN)], ids=["panel", "phone"]
)
def test_no_tile_moves_when_an_emergency_stop_comes_or_a_unit_is_opened(
    site: Site, browser_page: OpensPages, size: Any, locale: str
) -> None:
    site.end_alarms()
    page = browser_page("operator", viewport=size, locale=locale)
    page.goto("/?view=tiles")
    expect(page.locator("body")).to_have_attribute("data-link", "live")
    before = page.evaluate(BOXES, KEEP_THEIR_PLACES)
    try:
        site.line.remote.do("input", unit=2, input="estop", on=True)
        expect(page.locator('.tile[data-unit="line/2"]')).to_have_attribute("data-is", "urgent")
        expect(page.locator(".top__alarm")).not_to_have_attribute("data-is", "")
        assert page.evaluate(BOXES, KEEP_THEIR_PLACES) == before
        page.locator('[data-unit="line/4"] [data-faceplate]').click()
        expect(page.locator("#faceplate-name")).to_be_visible()
        assert page.evaluate(BOXES, KEEP_THEIR_PLACES) == before
        page.locator(".faceplate__state .status__text").evaluate(
            "each => each.textContent = 'cause '.repeat(40)"
        )
        rows = page.locator(".faceplate__state").evaluate("each => [each.scrollHeight, each.clientHeight]")
        assert rows[0] == rows[1], "a long cause lies over what follows"
    finally:
        site.line.remote.do("input", unit=2, input="estop", on=False)


@pytest.mark.parametrize(
    ("opened", "locale"),
    in_turn(
        [("/login", None), ("/users", "admin"), ("/account", "viewer"), ("/nothing", "viewer")],
        (ENGLISH, GERMAN),
        first=2,
    ),
)
def test_a_page_beside_the_line_is_accessible(
    shared_page: OpensPages, flaws: Callable[..., list[str]], opened: tuple[str, str | None], locale: str
) -> None:
    path, role = opened
    page = shared_page(role, locale=locale)
    page.goto(path)
    assert flaws(page, locale) == []


FOR_A_PHONE = [
    "/users",
    "/account",
    "/nothing",
    "/events",
    "/sets",
    "/sets/compare",
    "/recipes",
    "/batch/line",
]
SMALL_TARGETS = """() => [...document.querySelectorAll("main :is(button, .button, select, input, .check)")]
  .filter((each) => each.checkVisibility() && each.getBoundingClientRect().height < 48)
  .filter((each) => !each.closest(".check") || each.matches(".check"))
  .map((each) => each.outerHTML.slice(0, 120))"""
HIDDEN_TO_THE_SIDE = """() => [...document.querySelectorAll("main .table-wrap")]
  .filter((each) => each.scrollWidth > each.clientWidth + 1).map((each) => each.ariaLabel)"""


@pytest.mark.soak
def test_the_pages_around_the_line_fit_a_phone_in_a_glove(browser_page: OpensPages) -> None:
    page = browser_page("admin", viewport={"width": 360, "height": 740}, has_touch=True, is_mobile=True)
    for path in FOR_A_PHONE:
        page.goto(path)
        assert page.evaluate("document.documentElement.scrollWidth <= innerWidth"), path
        assert page.evaluate(SMALL_TARGETS) == [], path
        assert page.evaluate(HIDDEN_TO_THE_SIDE) == [], path


@pytest.mark.soak
def test_a_user_is_added_given_a_role_disabled_and_removed(
    shared_page: OpensPages, axe: Callable[..., list[str]]
) -> None:
    page = shared_page("admin", viewport={"width": 1920, "height": 1080})
    page.goto("/users")
    card = page.locator("section", has=page.get_by_role("heading", name="Add a user"))
    card.get_by_label("Name").fill("with space")
    card.get_by_label("Password").fill("a good new one")
    card.get_by_role("button", name="Add the user").click()
    expect(page.get_by_role("alert")).to_contain_text("write 1 to 40 letters, digits")
    assert axe(page) == []
    card.get_by_label("Name").fill("karin")
    card.get_by_label("Password").fill("a good new one")
    card.get_by_role("button", name="Add the user").click()
    row = page.locator("[data-user=karin]")
    row.get_by_role("combobox").select_option("engineer")
    row.get_by_role("button", name="Change the role").click()
    expect(row.get_by_role("combobox")).to_have_value("engineer")
    row.get_by_role("button", name="Disable the user").click()
    assert axe(page) == []
    row.get_by_role("button", name="Remove the user").click()
    expect(page.locator("#review")).to_contain_text("is deleted permanently")
    page.get_by_role("button", name="Remove karin").click()
    expect(row).to_have_count(0)


@pytest.mark.soak
def test_a_token_is_revoked_after_a_confirmation(
    site: Site, shared_page: OpensPages, axe: Callable[..., list[str]]
) -> None:
    page = shared_page("admin", viewport={"width": 360, "height": 740})
    page.goto("/users")
    card = page.locator("section", has=page.get_by_role("heading", name="New token"))
    card.get_by_label("Name").fill("plc")
    card.get_by_role("button", name="Create the token").click()
    token = page.locator("[data-token]").inner_text()
    revoke = page.get_by_role("button", name="Revoke the token: plc")
    revoke.click()
    expect(page.locator("#review")).to_contain_text("Never used")
    assert axe(page) == []
    page.get_by_role("button", name="Cancel").click()
    bearer = {"Authorization": f"Bearer {token}"}
    assert httpx.get(f"{site.url}/api/v1/me", headers=bearer).status_code == 200
    revoke.click()
    page.get_by_role("button", name="Revoke plc").click()
    expect(revoke).to_have_count(0)
    assert httpx.get(f"{site.url}/api/v1/me", headers=bearer).status_code == 401
