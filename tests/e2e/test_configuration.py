"""The configuration file in a browser: a unit is renamed after a review, the server restarted, and the file
rolled back.
"""

from __future__ import annotations

from collections.abc import Callable

import pytest
from playwright.sync_api import expect

from tests.e2e.conftest import ENGLISH, GERMAN, OpensPages
from tests.e2e.pages import PHONE
from tests.e2e.site import AT_REST, Site

MAX_MS = 60_000
"""For a server to end and to start."""


@pytest.mark.soak
@pytest.mark.parametrize("locale", [ENGLISH, GERMAN])
def test_port_and_units_of_a_bus_fit_the_page_up_to_their_review(
    line_server: Callable[..., Site], browser_page: OpensPages, flaws: Callable[..., list[str]], locale: str
) -> None:
    page = browser_page("admin", line_server(1, line_options=AT_REST), viewport=PHONE, locale=locale)
    for path, send in (("/configuration/bus/1", False), ("/configuration/bus/0", True)):
        page.goto(path)
        assert flaws(page, locale) == []
        page.locator("#field-bus-port").fill("/dev/ttyUSB7")
        page.locator("#bus-units").fill("Unwind")
        page.locator("form:has(#bus-units) [type=submit]").click()
        expect(
            page.locator(".field__error", has_text="“Unwind”" if locale == ENGLISH else "„Unwind“")
        ).to_be_visible()
        assert flaws(page, locale) == []
        if send:
            page.locator("#bus-units").fill("1 Unwind north\n7 Nip")
            page.locator("form:has(#bus-units) [type=submit]").click()
            expect(page.locator("ins", has_text="Unwind north")).to_be_visible()
            expect(page.locator("ins", has_text="baud")).to_have_count(0)
            assert flaws(page, locale) == []


@pytest.mark.soak
@pytest.mark.provokes("WebSocket connection")
def test_a_unit_is_renamed_the_server_restarted_and_the_file_rolled_back(
    line_server: Callable[..., Site], browser_page: OpensPages, flaws: Callable[..., list[str]]
) -> None:
    site = line_server(1, line_options=AT_REST)
    before = site.config.read_text(encoding="utf-8")
    page = browser_page("admin", site, viewport=PHONE)
    page.goto("/configuration")
    page.get_by_role("link", name="Edit: line · 1 · Unwind").click()
    expect(page.get_by_label("Name", exact=True)).to_be_focused()
    assert flaws(page) == []
    page.get_by_label("Name", exact=True).fill("Unwind north")
    page.get_by_role("button", name="Review change").click()
    expect(page.locator("ins")).to_have_text('name = "Unwind north"')
    assert flaws(page) == []
    page.get_by_label("Reason").fill("a second one comes")
    page.get_by_role("button", name="Write the file").click()
    expect(page.get_by_text("Version 2 is written.")).to_be_visible()
    written = site.config.read_text(encoding="utf-8")
    assert written == before.replace('name = "Unwind"', 'name = "Unwind north"', 1)
    line = browser_page("viewer", site)
    line.goto("/")
    assert flaws(page) == []
    page.get_by_role("button", name="Restart the server").click()
    # A page that was open has the new name too.
    expect(line.get_by_text("Unwind north").first).to_be_visible(timeout=MAX_MS)
    expect(page.get_by_text("Waiting for the next start")).to_have_count(0, timeout=MAX_MS)
    page.get_by_role("link", name="Compare with the file: 1").click()
    page.get_by_role("button", name="Roll back to this version").click()
    page.get_by_role("button", name="Write the file").click()
    expect(page.get_by_role("cell", name="rolled back")).to_be_visible()
    assert site.config.read_text(encoding="utf-8") == before
