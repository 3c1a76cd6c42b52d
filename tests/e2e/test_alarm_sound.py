"""Alarm sound in a browser: off by default, allowed by a press, silenced apart from acknowledging."""

from __future__ import annotations

import signal
from collections.abc import Callable
from typing import Any

import httpx
import pytest
from playwright.sync_api import Page, expect

from tests.e2e.conftest import GERMAN, OpensPages
from tests.e2e.site import Site, eventually

COUNTING = """
window.tones = 0;
const start = OscillatorNode.prototype.start;
OscillatorNode.prototype.start = function (...at) { window.tones += 1; return start.apply(this, at); };
let pressed = false;
for (const kind of ["keydown", "pointerup"])
  addEventListener(kind, () => { pressed = true; }, { capture: true });
window.AudioContext = class extends AudioContext {
  get state() { return pressed ? "running" : "suspended"; }
};
"""
"""Without a sound card a context may stay suspended: here a press decides, as the rule of browsers is."""


def tones(page: Page) -> int:
    count: int = page.evaluate("window.tones")
    return count


@pytest.mark.soak
def test_sound_is_switched_on_tested_allowed_by_a_press_and_silenced(
    site: Site, browser_page: OpensPages, flaws: Callable[..., list[str]]
) -> None:
    page = browser_page(locale=GERMAN)
    page.add_init_script(COUNTING)
    page.goto("/alarms")
    expect(page.locator("[data-sound-state]")).to_have_text("Auf diesem Gerät ist der Ton aus.")
    expect(page.locator(".sound")).to_be_hidden()
    page.get_by_role("button", name="Ton testen").press("Enter")
    eventually(lambda: tones(page) > 0, "the tone of the test")
    page.locator("[data-sound-on]").check()
    expect(page.locator("[data-sound-state]")).to_have_text("Auf diesem Gerät ist der Ton an.")

    page.goto("/events")
    expect(page.locator(".sound")).to_contain_text("Alarmton ist aus")
    allow = page.get_by_role("button", name="Alarmton erlauben")
    box = allow.bounding_box()
    assert box is not None
    assert box["height"] >= 48
    assert flaws(page, GERMAN) == []
    with site.line.stopped(5):
        allow.click()
        silence = page.get_by_role("button", name="Alarme stumm schalten")
        expect(silence).to_be_visible()
        eventually(lambda: tones(page) > 0, "the alarm sounds")
        silence.press("Enter")
        expect(page.locator(".sound")).to_be_hidden()
        with site.api("viewer") as client:
            eventually(lambda: _estop(client)["silenced"], "the server knows")
            assert _estop(client)["acknowledged"] is False


@pytest.mark.soak
@pytest.mark.provokes("WebSocket", "fetch", "ERR_")
def test_a_lost_server_sounds_where_that_was_chosen_until_it_is_silenced(
    site: Site, browser_page: OpensPages
) -> None:
    page = browser_page()
    page.add_init_script(COUNTING)
    page.goto("/alarms")
    lost = page.locator("[data-sound-lost]")
    expect(lost).not_to_be_checked()
    lost.focus()
    page.keyboard.press("Space")
    page.locator("[data-sound-on]").check()
    page.reload()
    expect(lost).to_be_checked()
    expect(page.locator("body[data-link=live]")).to_be_attached()
    page.keyboard.press("Shift")
    expect(page.locator(".sound")).to_be_hidden()
    before = tones(page)
    site.stop(signal.SIGKILL)
    try:
        silence = page.get_by_role("button", name="Silence sound")
        expect(silence).to_be_visible()
        eventually(lambda: tones(page) > before, "the lost server sounds")
        expect(page.locator(".gone")).to_be_focused()
        page.keyboard.press("Tab")
        expect(silence).to_be_focused()
        page.keyboard.press("Enter")
        expect(silence).to_be_hidden()
    finally:
        site.start()
    expect(page.locator("body[data-link=live]")).to_be_attached()
    expect(page.locator(".gone .sound")).to_have_count(0)


def _estop(client: httpx.Client) -> dict[str, Any]:
    found: list[dict[str, Any]] = client.get("/alarms", params={"unit": 5}).json()["alarms"]
    return next(alarm for alarm in found if alarm["code"] == "estop_active")
