"""No control of a page lies on another one or on a text, is cut, or is too near to another one."""

from __future__ import annotations

from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

from tests.e2e.conftest import ENGLISH, GERMAN, OpensPages
from tests.e2e.site import Site
from tests.e2e.test_phone_length import PATHS
from tests.sizes import sizes

JAMS = (Path(__file__).parent / "jams.js").read_text(encoding="utf-8")
SIZES = ((360, 800), (1280, 800), (1920, 1080))
ADD_STYLE = """style => {
  const sheet = new CSSStyleSheet();
  sheet.replaceSync(style);
  document.adoptedStyleSheets.push(sheet);
}"""
MORE = ["/?view=matrix", "/docs", "/help", "/wallboard", "/alarms/line.1.estop_active.0"]


def jams(page: Page, path: str) -> list[str]:
    """Those of a page, each with the width at which it was seen."""
    page.goto(path)
    expect(page.locator("h1").first).to_be_attached()
    return jams_as_shown(page)


def jams_as_shown(page: Page) -> list[str]:
    """Those of what a page shows now."""
    found = []
    for width, height in SIZES:
        page.set_viewport_size({"width": width, "height": height})
        page.evaluate("() => new Promise(requestAnimationFrame)")
        found += [f"{width} px: {jam}" for jam in page.evaluate(JAMS)]
    return found


def test_nothing_jams_on_the_page_of_a_unit_and_beside_the_line(site: Site, shared_page: OpensPages) -> None:
    page = shared_page("engineer", site=site, locale=GERMAN)
    assert jams(page, "/units/line/1") == []
    page.goto("/?view=tiles")
    page.locator('[data-unit="line/5"] [data-faceplate]').click()
    expect(page.locator("#faceplate #setpoint")).to_be_visible()
    assert page.evaluate(JAMS) == []


def test_a_message_and_the_undo_of_a_command_do_not_jam(site: Site, shared_page: OpensPages) -> None:
    page = shared_page("engineer", site=site, locale=GERMAN, viewport={"width": 1280, "height": 800})
    page.goto("/units/line/2")
    page.locator(".setting .nudges button").nth(1).click()
    expect(page.locator(".setting .undo:visible")).to_be_visible()
    page.goto("/units/line/2")
    page.locator("#setpoint").fill("90,0")
    page.locator(".setter__tray").click()
    expect(page.locator("#setpoint-error [data-added]")).to_be_visible()
    expect(page.locator(".setting .undo-place .undo")).to_be_visible()
    assert jams_as_shown(page) == []


@pytest.mark.parametrize(
    ("style", "words"),
    sizes(
        (".setter__now { margin-block-start: -30px }", "lies on"),
        (".pad { display: none } .setter { gap: 0 }", "too near"),
        (".pad { block-size: 90px; overflow: hidden }", "is cut by"),
        (".card__head { margin-block-end: -60px }", "lies on the text"),
    ),
)
def test_a_jam_is_found(site: Site, shared_page: OpensPages, style: str, words: str) -> None:
    page = shared_page("engineer", site=site, viewport={"width": 1280, "height": 800})
    page.goto("/units/line/1")
    expect(page.locator("body[data-link=live]")).to_be_attached()
    page.evaluate(ADD_STYLE, style)
    # Its buttons are disabled until the unit is online.
    page.wait_for_function(f"words => ({JAMS})().some(jam => jam.includes(words))", arg=words)


@pytest.mark.soak
@pytest.mark.parametrize("locale", [ENGLISH, GERMAN])
@pytest.mark.parametrize("path", [*PATHS, *MORE])
def test_nothing_jams_on_any_page(past_site: Site, shared_page: OpensPages, path: str, locale: str) -> None:
    assert jams(shared_page("engineer", site=past_site, locale=locale), path) == []


@pytest.mark.soak
def test_no_key_lies_on_a_step_in_the_narrowest_window(site: Site, shared_page: OpensPages) -> None:
    page = shared_page("engineer", site=site, locale=GERMAN, viewport={"width": 320, "height": 640})
    page.goto("/units/line/1")
    expect(page.locator("#setpoint")).to_be_visible()
    assert page.evaluate(JAMS) == []
