"""A panel on the wall, worked by touch: account, home, dark, cleaning; and the pages as an installed app."""

from __future__ import annotations

import re
import signal
from collections.abc import Callable, Iterator
from functools import cache, partial
from typing import Any

import pytest
from playwright.sync_api import Browser, BrowserContext, Page, expect

from tests.e2e.conftest import FORGETS_TAPS, OpensPages, focus
from tests.e2e.pages import LIVE, PANEL
from tests.e2e.site import AT_REST, Site, eventually
from tests.e2e.site import site as one_site

HOME = "/units/line/2"
PIN = "471193"
FAKE_LOCK = """
window.locks = [];
Object.defineProperty(navigator, "wakeLock", {value: {request: async kind => {
    const lock = {kind, released: false};
    window.locks.push(lock);
    return lock;
}}});
"""


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    """Two units, and a server that a test may kill."""
    with one_site(tmp_path_factory.mktemp("kiosk"), 2, line_options=AT_REST) as made:
        yield made


@pytest.fixture(scope="module")
def panels(site: Site, browser: Browser) -> Callable[[str], Any]:
    """Return the cookies of a panel. An admin adds two on the page: one to look, one to operate."""
    context = browser.new_context(base_url=site.url)
    context.add_init_script(FORGETS_TAPS)
    page = context.new_page()
    page.goto("/login?next=/users")
    page.get_by_label("Name").fill("admin")
    page.get_by_label("Password").fill("collect house bakery stable")
    page.get_by_role("button", name="Log in").click()
    for name, role in (("wall", None), ("first", "operator")):
        page.get_by_role("button", name="Add a panel").click()
        form = page.locator('form[action="/users/panels"]')
        form.get_by_label("Name").fill(name)
        if role is not None:
            form.get_by_label("Role").select_option(role)
        form.get_by_label("PIN").fill(PIN)
        form.get_by_label("Home page").fill(HOME)
        form.get_by_role("button", name="Add the panel").click()
        expect(page.locator(f'[data-user="{name}"]')).to_contain_text("panel")
    context.close()
    return cache(partial(_signed_in, browser, site))


def _signed_in(browser: Browser, site: Site, name: str) -> Any:
    context = browser.new_context(base_url=site.url)
    context.add_init_script(FORGETS_TAPS)
    page = context.new_page()
    page.goto("/login?panel=true")
    page.get_by_label("Panel").fill(name)
    pin = page.get_by_role("textbox", name="PIN")
    pin.fill("9")
    page.get_by_role("button", name="Log in").click()
    expect(page.locator(".notice")).to_contain_text("wrong name or PIN")
    expect(pin).to_be_focused()
    for digit in f"{PIN}7":
        page.get_by_role("button", name=digit, exact=True).click()
    page.get_by_role("button", name="Erase").click()
    page.get_by_role("button", name="Log in").click()
    expect(page).to_have_url(HOME)
    state = context.storage_state()
    context.close()
    return state


@pytest.fixture
def panel(browser: Browser, site: Site, panels: Callable[[str], Any]) -> Iterator[Callable[..., Page]]:
    """``panel("first", "/")``: a page of a panel with a touch screen and a clock that the test can set."""
    contexts: list[BrowserContext] = []

    def open_page(name: str, path: str, *, clock: bool = False) -> Page:
        context = browser.new_context(
            base_url=site.url, storage_state=panels(name), viewport=PANEL, has_touch=True
        )
        contexts.append(context)
        context.add_init_script(FORGETS_TAPS)
        page = context.new_page()
        page.add_init_script(FAKE_LOCK)
        if clock:
            page.clock.install()
        page.goto(path)
        expect(page.locator(LIVE)).to_be_attached()
        return page

    yield open_page
    for context in contexts:
        context.close()


def tap(page: Page, selector: str) -> None:
    """A finger on the middle of an element, whatever lies over it."""
    box = page.locator(selector).first.bounding_box()
    assert box is not None, selector
    page.touchscreen.tap(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)


def expect_controls(page: Page) -> None:
    """Wait until the unit can be set: after a leap of the page's clock, it has no controls until it has
    responded.
    """
    expect(page.locator(".main:not([inert]) form.setter:not([inert])")).to_be_attached()


@pytest.mark.soak
def test_a_panel_only_looks_unless_it_is_given_more(panel: Callable[..., Page]) -> None:
    wall = panel("wall", HOME)
    expect(wall.locator(".main [data-command]")).to_have_count(0)
    assert (
        wall.request.post("/units/line/2/nudge", form={"step": "1", "id": "x" * 32, "scale": "-"}).status
        == 403
    )
    first_page = panel("first", HOME)
    expect(first_page.locator("#setpoint")).to_be_visible()


@pytest.mark.soak
def test_a_panel_stays_awake_and_renews_the_lock_when_it_is_shown_again(panel: Callable[..., Page]) -> None:
    page = panel("wall", "/")
    eventually(lambda: page.evaluate("window.locks.length") == 1, "one wake lock")
    page.evaluate("document.dispatchEvent(new Event('visibilitychange'))")
    assert page.evaluate("window.locks.length") == 1
    page.evaluate("window.locks[0].released = true; document.dispatchEvent(new Event('visibilitychange'))")
    eventually(lambda: page.evaluate("window.locks.length") == 2, "another wake lock")


@pytest.mark.soak
def test_full_screen_is_entered_and_left(panel: Callable[..., Page]) -> None:
    page = panel("wall", "/")
    button = page.locator("[data-full-screen]")
    page.locator("[popovertarget=user-menu]").tap()
    button.tap()
    eventually(lambda: page.evaluate("document.fullscreenElement !== null"), "the complete screen")
    page.locator("[popovertarget=user-menu]").tap()
    button.tap()
    eventually(lambda: page.evaluate("document.fullscreenElement === null"), "the window again")


@pytest.mark.soak
def test_the_first_touch_after_dark_only_wakes(site: Site, panel: Callable[..., Page]) -> None:
    page = panel("first", HOME, clock=True)
    tap(page, ".nudges button >> nth=2")
    expect(page.locator("#setpoint-error")).to_contain_text("verified")
    before = len(site.writes())
    page.clock.fast_forward("11:00")
    expect(page.locator(".cover--dark")).to_be_visible()
    expect(page.locator(".cover--dark")).to_contain_text("all 2 at speed")
    expect(page.locator(".cover--dark [data-clock]")).to_have_text(re.compile(r"\d\d:\d\d:\d\d"))
    tap(page, ".nudges button >> nth=2")
    expect(page.locator(".cover")).to_have_count(0)
    assert len(site.writes()) == before
    expect_controls(page)
    tap(page, ".nudges button >> nth=2")
    eventually(lambda: len(site.writes()) == before + 1, "the second touch")


@pytest.mark.soak
def test_a_key_after_dark_only_wakes(site: Site, panel: Callable[..., Page]) -> None:
    page = panel("first", HOME, clock=True)
    button = page.locator(".nudges button").nth(2)
    focus(button)
    before = len(site.writes())
    page.clock.fast_forward("11:00")
    expect(page.locator(".cover--dark")).to_be_visible()
    page.keyboard.press("Enter")
    expect(page.locator(".cover")).to_have_count(0)
    assert len(site.writes()) == before
    expect_controls(page)
    expect(button).to_be_focused()
    page.keyboard.press("Enter")
    eventually(lambda: len(site.writes()) == before + 1, "the second key")


@pytest.mark.soak
def test_an_untouched_panel_goes_home_and_leaves_no_review_open(
    site: Site, panel: Callable[..., Page]
) -> None:
    page = panel("first", "/", clock=True)
    page.get_by_role("button", name="Set line to zero").tap()
    expect(page.locator("dialog[open]")).to_have_count(1)
    page.clock.fast_forward("05:30")
    expect(page).to_have_url(HOME)
    expect(page.locator(LIVE)).to_be_attached()
    # Untouched since: the first touch here only wakes it.
    page.clock.fast_forward("00:10")
    expect(page.locator(".cover--guard")).to_be_attached()
    before = len(site.writes())
    tap(page, ".nudges button >> nth=2")
    expect(page.locator(".cover")).to_have_count(0)
    assert len(site.writes()) == before


@pytest.mark.soak
def test_a_panel_with_an_active_condition_does_not_go_dark(site: Site, panel: Callable[..., Page]) -> None:
    page = panel("wall", HOME, clock=True)
    page.clock.fast_forward("11:00")
    expect(page.locator(".cover--dark")).to_be_visible()
    with site.line.stopped(1):
        expect(page.locator(".cover--dark")).to_have_count(0)


@pytest.mark.soak
def test_cleaning_by_touch_sets_nothing(site: Site, panel: Callable[..., Page]) -> None:
    page = panel("first", HOME, clock=True)
    before = len(site.writes())
    page.locator("[popovertarget=user-menu]").tap()
    page.locator("[data-clean]").tap()
    expect(page.locator(".cover--clean")).to_contain_text("30 s")
    for _ in range(3):
        tap(page, ".nudges button >> nth=2")
        page.keyboard.press("Enter")
    expect(page).to_have_url(HOME)
    page.clock.run_for(31_000)
    expect(page.locator(".cover")).to_have_count(0)
    assert len(site.writes()) == before


@pytest.mark.soak
@pytest.mark.provokes("WebSocket", "fetch", "ERR_")
def test_without_a_network_it_shows_a_notice_and_comes_back(browser_page: OpensPages) -> None:
    page = browser_page(viewport=PANEL, service_workers="allow")
    page.goto("/")
    page.evaluate("navigator.serviceWorker.ready.then(() => true)")
    page.context.set_offline(True)
    page.goto("/setpoints")
    expect(page.locator("h1")).to_have_text("No connection to Lineside")
    expect(page.locator("[data-live]")).to_have_count(0)
    background = page.locator(".gone").evaluate("element => getComputedStyle(element).display")
    assert background != "none", "the kept page has lost its style"
    page.context.set_offline(False)
    expect(page).to_have_url("/setpoints")
    expect(page.locator(LIVE)).to_be_attached()


@pytest.mark.soak
@pytest.mark.provokes("WebSocket", "fetch", "ERR_", "script")
def test_a_form_pressed_as_the_server_dies_is_not_sent_again(site: Site, browser_page: OpensPages) -> None:
    page = browser_page(viewport=PANEL, service_workers="allow")
    page.goto(HOME)
    page.evaluate("navigator.serviceWorker.ready.then(() => true)")
    expect(page.locator(LIVE)).to_be_attached()
    page.locator("summary").click()
    page.locator("#reason").fill("belt off")
    site.stop(signal.SIGKILL)
    try:
        # As fast as a finger could be: before the page has noticed.
        page.evaluate(
            """() => {
            document.body.dataset.link = "live";
            document.querySelector('form[action$="/block"]').requestSubmit();
        }"""
        )
        expect(page.locator("h1")).to_have_text("No connection to Lineside")
    finally:
        site.start()
    expect(page).to_have_url(HOME)
    expect(page.locator(LIVE)).to_be_attached()
    assert site.unit(2)["blocked"] is None
