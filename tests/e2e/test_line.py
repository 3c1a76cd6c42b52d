"""The line, its wallboard, the pages around it, and how anything is found."""

from __future__ import annotations

from collections.abc import Callable
from math import atan, degrees
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

from tests.e2e.conftest import ENGLISH, OpensPages
from tests.e2e.limits import PAGE_MS
from tests.e2e.pages import PANEL, PHONE
from tests.e2e.site import Site
from tests.e2e.test_screen import opened
from tests.sizes import sizes


def test_the_page_shows_the_units_values_and_its_legend_is_one_key_away(
    site: Site, shared_page: OpensPages
) -> None:
    page = opened(shared_page("viewer", viewport=PANEL, locale=ENGLISH), "/")
    for unit in range(1, 9):
        raw = site.line.remote.do("state", unit=unit)["commanded"]
        expect(page.locator(f'[data-live="line/{unit}.commanded"]').first).to_have_text(f"{raw / 10:.1f}")
    page.keyboard.press("?")
    expect(page.locator("#legend")).to_contain_text("Only an outline")
    page.keyboard.press("Escape")
    expect(page.locator("#legend")).to_be_hidden()


@pytest.mark.soak
def test_a_user_is_added_given_a_role_disabled_and_removed(
    shared_page: OpensPages, axe: Callable[..., list[str]]
) -> None:
    page = shared_page("admin", viewport={"width": 1920, "height": 1080})
    page.goto("/users")
    page.get_by_role("button", name="Add a user").click()
    drawer = page.get_by_role("dialog", name="Add a user")
    drawer.get_by_label("Name").fill("with space")
    drawer.get_by_label("Password").fill("a good new one")
    drawer.get_by_role("button", name="Add the user").click()
    # It is open on the page that refuses it.
    expect(drawer).to_contain_text("write 1 to 40 letters, digits")
    assert axe(page) == []
    drawer.get_by_label("Name").fill("karin")
    drawer.get_by_label("Password").fill("a good new one")
    drawer.get_by_role("button", name="Add the user").click()
    row, drawer = page.locator("[data-user=karin]"), page.get_by_role("dialog", name="karin")
    row.get_by_role("button", name="Edit").click()
    drawer.get_by_role("combobox").select_option("engineer")
    drawer.get_by_role("button", name="Change the role").click()
    expect(row).to_contain_text("engineer")
    row.get_by_role("button", name="Edit").click()
    expect(drawer.get_by_role("combobox")).to_have_value("engineer")
    drawer.get_by_role("button", name="Disable the user").click()
    expect(row).to_contain_text("(disabled)")
    assert axe(page) == []
    row.get_by_role("button", name="Edit").click()
    drawer.get_by_role("button", name="Remove the user").click()
    expect(page.locator("#review")).to_contain_text("is deleted permanently")
    page.get_by_role("button", name="Remove karin").click()
    expect(row).to_have_count(0)


@pytest.mark.soak
def test_it_can_be_installed(browser_page: OpensPages) -> None:
    page = browser_page(viewport=PANEL, service_workers="allow")
    page.goto("/")
    page.evaluate("navigator.serviceWorker.ready.then(() => true)")
    devtools = page.context.new_cdp_session(page)
    manifest = devtools.send("Page.getAppManifest")
    assert manifest["errors"] == []
    assert [
        error["errorId"] for error in devtools.send("Page.getInstallabilityErrors")["installabilityErrors"]
    ] in (
        [],
        ["in-incognito"],
    )
    stated = page.request.get("/manifest.webmanifest").json()
    assert stated["display"] == "standalone"
    assert {page.request.get(icon["src"]).status for icon in stated["icons"]} == {200}
    assert {Path(icon["src"]).suffix for icon in stated["icons"]} == {".svg", ".png"}


# --- anything is found by keyboard, over any page, and on a phone under the thumb ---------------------


@pytest.mark.parametrize("judge", sizes("axe", "flaws"))
def test_a_parameter_is_found_and_opened_by_keyboard(
    shared_page: OpensPages, request: pytest.FixtureRequest, judge: str
) -> None:
    page = opened(shared_page("engineer", viewport=PANEL, locale=ENGLISH), "/units/line/1")
    page.keyboard.press("Control+k")
    page.keyboard.type("accel")
    place = page.locator(".find__place").first
    expect(place).to_contain_text("(parameter 6)")
    assert request.getfixturevalue(judge)(page) == []
    page.keyboard.press("ArrowDown")
    expect(place).to_be_focused()
    page.keyboard.press("Enter")
    page.wait_for_url("**/units/line/1/parameters#parameter-6", timeout=PAGE_MS)


@pytest.mark.soak
def test_a_phone_has_the_other_pages_one_press_away(
    shared_page: OpensPages, flaws: Callable[..., list[str]]
) -> None:
    page = opened(shared_page("engineer", viewport=PHONE, locale=ENGLISH), "/")
    expect(page.locator(".rail__item:visible")).to_have_count(5)
    page.get_by_role("button", name="More").click()
    recipes = page.get_by_role("navigation").get_by_role("link", name="Recipes")
    expect(recipes).to_be_in_viewport(ratio=1)
    assert flaws(page, ENGLISH) == []
    recipes.click()
    page.wait_for_url("**/recipes", timeout=PAGE_MS)


# --- the wallboard: readable across the hall, complete in one window ----------------------------------

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
    page.set_viewport_size(HALL)
    # At once, as the next reading writes its own words.
    fitted = page.locator(".wall__cause").evaluate(
        """(cause, text) => {
            cause.textContent = text;
            dispatchEvent(new Event("resize"));
            return cause.closest("[data-fitted]").dataset.fitted;
        }""",
        LONG,
    )
    assert fitted != "0"
