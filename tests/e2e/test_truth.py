"""What the page shows when something is gone: unit, cable, worker, server, browser. A click while the link
was down is never sent.
"""

from __future__ import annotations

import os
import re
import signal
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from playwright.sync_api import expect

from tests.e2e.conftest import OpensPages
from tests.e2e.limits import START_MS
from tests.e2e.pages import LIVE, PANEL, opened
from tests.e2e.site import AT_REST, Site, eventually
from tests.sizes import sizes

LOST = "body[data-link=lost]"


@pytest.fixture(scope="module")
def own_site(line_server: Callable[..., Site]) -> Site:
    """Three units, for tests that hurt the server."""
    return line_server(3, line_options=AT_REST, turnaround_ms=250)


def workers(site: Site) -> list[int]:
    assert site.server is not None
    number = site.server.pid
    return [int(child) for child in Path(f"/proc/{number}/task/{number}/children").read_text().split()]


def test_a_dead_unit_is_hatched_and_named_and_the_others_are_not(
    own_site: Site, shared_page: OpensPages
) -> None:
    page = opened(shared_page("engineer", site=own_site, viewport=PANEL), "/")
    own_site.line.remote.do("fault", kind="dead", rate=1, unit=2)
    try:
        expect(page.locator('[data-unit="line/2"]')).to_have_attribute("data-quality", "offline")
        expect(page.locator("h1")).to_contain_text("No response since")
        expect(page.locator('[data-unit="line/1"]')).to_have_attribute("data-quality", "online")
        expect(page.locator('[data-live="line/2.actual"]')).not_to_be_empty()
        opened(page, "/units/line/2")
        assert page.locator("form.setter").evaluate("form => form.inert")
        expect(page.locator(".cause__replace")).to_be_visible()
    finally:
        own_site.line.remote.do("clear")
    expect(page.locator('[data-unit="line/2"]')).to_have_attribute("data-quality", "online")
    assert not page.locator("form.setter").evaluate("form => form.inert")


def test_a_pulled_cable_is_one_cause(
    own_site: Site, shared_page: OpensPages, browser_page: OpensPages
) -> None:
    page = opened(shared_page("engineer", site=own_site, viewport=PANEL), "/trends?span=600")
    expect(page.locator("#trend-legend .value__number").first).to_contain_text(re.compile(r"\d"))
    setpoints = opened(browser_page("engineer", site=own_site, viewport=PANEL), "/setpoints")
    typed = setpoints.locator("[data-new='line/2']")
    new_draw = setpoints.locator(".draw-typed__new:not(:empty)")
    typed.fill("121")
    expect(new_draw).not_to_have_count(0)
    own_site.line.remote.do("unplug")
    try:
        expect(new_draw).to_have_count(0)
        rows = setpoints.locator("tr[data-unit]")
        rows.evaluate_all("all => all.forEach(row => { row.dataset.quality = 'offline' })")
        expect(typed).to_be_visible()
        expect(typed).to_have_value("121")
        silent = setpoints.locator("[data-unit='line/1'] .setpoints__silent")
        expect(silent).to_be_visible()
        expect(silent).to_have_text("port closed")
        expect(page.locator("#trend-legend [data-quality=stale] .age")).to_have_count(3)
        expect(page.locator("#trend-legend .age").first).to_have_text(re.compile(r"^\d\.\d s ago$"))
        opened(page, "/")
        expect(page.locator("h1")).to_contain_text("line · Port closed since")
        expect(page.locator("[data-live='line_summary.abnormal']")).to_have_text("3")
        opened(page, "/units/line/1")
        expect(page.locator(".cause")).to_have_attribute("data-is", "")
        # As it is once the port was closed for ten seconds.
        page.locator(".plate").evaluate("plate => { plate.dataset.quality = 'offline' }")
        assert (
            page.locator(".cause__replace").evaluate("button => getComputedStyle(button).display") == "none"
        ), "the unit has no fault"
    finally:
        own_site.line.remote.do("plug")
    opened(page, "/")
    expect(page.locator("[data-live='line_summary.abnormal']")).to_have_text("0")


@pytest.mark.soak
def test_a_dead_worker_is_named_and_comes_back(own_site: Site, shared_page: OpensPages) -> None:
    page = opened(shared_page(site=own_site, viewport=PANEL), "/")
    (worker,) = workers(own_site)
    os.kill(worker, signal.SIGSTOP)
    try:
        expect(page.locator('[data-unit="line/1"]')).not_to_have_attribute("data-quality", "online")
        expect(page.locator("h1")).to_contain_text("Bus worker does not respond since")
    finally:
        os.kill(worker, signal.SIGKILL)
    expect(page.locator("[data-live='line_summary.abnormal']")).to_have_text("0", timeout=START_MS)


def test_a_server_that_does_not_respond_disables_the_controls_and_the_page_recovers(
    own_site: Site, shared_page: OpensPages
) -> None:
    page = opened(shared_page(site=own_site, viewport=PANEL), "/units/line/1")
    before = own_site.writes()
    page.locator("#setpoint").fill("55.5")
    page.get_by_role("button", name="Set now").click()
    expect(page.locator("[data-review-act]")).to_be_visible()
    assert own_site.server is not None
    own_site.server.send_signal(signal.SIGSTOP)
    try:
        expect(page.locator(LOST)).to_be_attached()
        expect(page.locator(".gone")).to_contain_text("does not respond")
        expect(page.locator("[data-review]")).to_have_count(0)
        expect(page.get_by_role("button", name="Set now")).to_have_count(0)
        page.evaluate("document.querySelector('form.setter').requestSubmit()")
    finally:
        own_site.server.send_signal(signal.SIGCONT)
    expect(page.locator(LIVE)).to_be_attached()
    expect(page.locator("#setpoint")).to_have_value("55.5")
    expect(page.locator("[data-review]")).to_have_count(0)
    assert own_site.writes() == before


CLICKED_EARLY = """async (pressed) => {
  document.body.dataset.link = "connecting";
  document.querySelector(pressed).click();
  await new Promise((resolve) => setTimeout(resolve, 300));
  document.body.dataset.link = "live";
  document.dispatchEvent(new Event("lineside:found"));
}"""


def test_a_press_before_the_first_message_is_carried_out_then(
    own_site: Site, shared_page: OpensPages
) -> None:
    page = opened(shared_page(site=own_site, viewport=PANEL), "/units/line/1")
    page.locator("#setpoint").fill("44.5")
    page.evaluate(CLICKED_EARLY, ".setter__tray")
    expect(page.locator("#setpoint-error [data-added]")).to_be_visible()
    page.evaluate(CLICKED_EARLY, ".setter__stage")
    expect(page.locator("#set-review [data-review-act]")).to_contain_text("Stage")
    page.evaluate(CLICKED_EARLY, '[hx-get="/line/zero"]')
    expect(page.locator("#review")).to_be_visible()


@pytest.mark.soak
def test_a_press_that_was_held_up_on_the_way_is_not_carried_out(
    own_site: Site, browser_page: OpensPages
) -> None:
    page = opened(browser_page(site=own_site, viewport=PANEL), "/units/line/1")
    before = own_site.writes()
    page.locator("#setpoint").fill("44.5")
    page.get_by_role("button", name="Set now").click()
    act = page.locator("[data-review-act]")
    expect(act).to_be_visible()
    page.route(
        "**/speed",
        lambda route: route.continue_(headers={**route.request.headers, "lineside-clicked-at": "1.0"}),
    )
    act.click()
    expect(page.locator("#setpoint-error [role=alert]")).to_contain_text("too late")
    assert own_site.writes() == before


@pytest.mark.provokes("WebSocket")
def test_a_killed_server_is_shown_and_everything_comes_back_with_it(
    own_site: Site, browser_page: OpensPages
) -> None:
    page = opened(browser_page(site=own_site, viewport=PANEL), "/")
    own_site.stop(signal.SIGKILL)
    expect(page.locator(LOST)).to_be_attached()
    expect(page.locator("[data-gone-cause]")).to_contain_text("closed")
    own_site.start()
    own_site.wait_for_units()
    expect(page.locator(LIVE)).to_be_attached()
    raw = own_site.unit(1)["commanded_raw"]
    expect(page.locator('[data-live="line/1.commanded"]')).to_have_text(f"{raw / 10:.1f}")


@pytest.mark.provokes("WebSocket")
def test_a_page_that_slept_prints_no_value_and_requests_a_snapshot(
    own_site: Site, browser_page: OpensPages
) -> None:
    page = opened(browser_page(site=own_site, viewport=PANEL), "/")
    page.context.set_offline(True)
    expect(page.locator(LOST)).to_be_attached()
    page.emulate_media(media="print")
    expect(page.locator(".gone__box")).to_be_visible()
    expect(page.locator(".tile").first).to_be_hidden()
    page.emulate_media(media="screen")
    own_site.set_speed(3, value="33.3")
    page.context.set_offline(False)
    expect(page.locator(LIVE)).to_be_attached()
    expect(page.locator('[data-live="line/3.commanded"]')).to_have_text("33.3")


@pytest.mark.soak
@pytest.mark.provokes("WebSocket")
def test_a_device_that_slept_shows_nothing_old_as_new(own_site: Site, browser_page: OpensPages) -> None:
    page = browser_page(site=own_site, viewport=PANEL)
    page.add_init_script(
        """window.links = [];
        document.addEventListener("lineside:lost", () => window.links.push("lost"));
        document.addEventListener("lineside:found", () => window.links.push("found"));"""
    )
    page.clock.install()
    opened(page, "/")
    # While a device sleeps its timers and the page's own clock stand still; only the time of day goes on.
    page.clock.set_system_time(datetime.now(UTC) + timedelta(hours=1))
    eventually(
        lambda: page.evaluate("window.links")[-2:] == ["lost", "found"], "lost at once, and found again"
    )
    expect(page.locator('[data-unit="line/1"]')).to_have_attribute("data-quality", "online")


@pytest.mark.soak
@pytest.mark.provokes("WebSocket")
def test_a_frozen_tab_comes_back_with_the_present_and_sends_nothing(
    own_site: Site, browser_page: OpensPages
) -> None:
    page = opened(browser_page(site=own_site, viewport=PANEL), "/units/line/3")
    page.locator("#setpoint").fill("38.5")
    page.get_by_role("button", name="Set now").click()
    expect(page.locator("[data-review-act]")).to_be_visible()
    before = own_site.writes()
    devtools = page.context.new_cdp_session(page)
    other = page.context.new_page()
    other.bring_to_front()
    devtools.send("Page.setWebLifecycleState", {"state": "frozen"})
    own_site.set_speed(3, value="36.6")
    devtools.send("Page.setWebLifecycleState", {"state": "active"})
    page.bring_to_front()
    expect(page.locator(LIVE)).to_be_attached()
    expect(page.locator('[data-live="line/3.commanded"]').first).to_have_text("36.6")
    expect(page.locator("[data-review-act]")).to_have_count(0)
    assert len(own_site.writes()) == len(before) + 1


def test_the_offline_page_is_honest(own_site: Site, shared_page: OpensPages) -> None:
    page = shared_page(None, site=own_site, viewport=PANEL)
    page.goto("/offline")
    expect(page.locator("h1")).to_have_text("No connection to Lineside")
    eventually(lambda: page.locator(".gone__box").is_visible(), "the page is drawn")


TEXTS = """
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  const texts = [];
  while (walker.nextNode()) if (walker.currentNode.data.trim()) texts.push(walker.currentNode);
"""
TRANSLATED = f"""() => {{{TEXTS}
  for (const text of texts) {{
    const font = document.createElement("font");
    font.append(document.createElement("font"));
    font.firstChild.textContent = text.data;
    text.replaceWith(font);
  }}
}}"""
"""As the translation of Chrome: each text is in another node, in two elements."""
WRITTEN_LATE = f"""() => {{{TEXTS}
  const old = texts.map(({{data}}) => data);
  setTimeout(() => texts.forEach((text, at) => {{ text.data = old[at]; }}), 3000);
}}"""
"""As an extension that puts other words into the same nodes, once it has them."""
COPIED = """() => {
  for (const one of document.querySelectorAll("main, .top")) one.replaceWith(one.cloneNode(true));
}"""
DOUBLED = """() => {
  for (const one of document.querySelectorAll("[data-live]")) one.before(one.cloneNode(true));
}"""
STATES = {1: "Stopped: emergency stop", 2: "Not in REMOTE", 3: "No response"}


def stop_all(site: Site) -> None:
    """An e-stop, LOCAL, and a unit without power."""
    site.line.remote.do("input", unit=1, input="estop", on=True)
    site.line.remote.do("mode", unit=2, to="local")
    site.line.remote.do("fault", kind="dead", rate=1, unit=3)


def run_all(site: Site) -> None:
    site.line.remote.do("clear")
    site.line.remote.do("input", unit=1, input="estop", on=False)
    site.line.remote.do("mode", unit=2, to="remote")


@pytest.mark.parametrize("change", sizes(TRANSLATED, WRITTEN_LATE, COPIED, DOUBLED))
@pytest.mark.parametrize("path", sizes("/?view=tiles", "/?view=rows", "/?view=matrix"))
def test_a_program_that_changes_the_page_leaves_no_old_state(
    own_site: Site, shared_page: OpensPages, path: str, change: str
) -> None:
    page = opened(shared_page(site=own_site, viewport=PANEL), path)
    try:
        page.evaluate(change)
        stop_all(own_site)
        for unit, text in STATES.items():
            shown = page.locator(f'[data-unit="line/{unit}"]')
            expect(shown).to_contain_text(text)
            expect(shown.get_by_text("At speed")).to_have_count(0)
        expect(page.locator('[data-unit="line/3"]')).to_have_attribute("data-quality", "offline")
        expect(page.locator("h1")).to_contain_text(STATES[1])
        expect(page).to_have_title(re.compile(r"^\(3\)"))
    finally:
        run_all(own_site)
    for unit, text in STATES.items():
        expect(page.locator(f'[data-unit="line/{unit}"]')).not_to_contain_text(text)


def test_a_page_whose_texts_are_changed_again_and_again_is_covered(
    own_site: Site, shared_page: OpensPages
) -> None:
    page = opened(shared_page(site=own_site, viewport=PANEL), "/")
    page.evaluate(f"() => {{ setInterval({TRANSLATED}, 100); }}")
    expect(page.locator(LOST)).to_be_attached()
    cover = page.locator(".gone__box")
    title = "Another program changes the texts of this page"
    expect(cover.get_by_role("heading", name=title, exact=True)).to_be_visible()
    expect(cover).to_contain_text("Turn off the browser extension or the translation")
    expect(cover.get_by_text("does not respond")).to_be_hidden()
    cover.get_by_role("link", name="Reload page").click()
    expect(page.locator(LIVE)).to_be_attached()


def test_a_page_that_a_browser_kept_is_covered_until_it_has_a_snapshot(
    own_site: Site, shared_page: OpensPages
) -> None:
    page = opened(shared_page(site=own_site, viewport=PANEL), "/")
    link = page.evaluate("""() => {
      dispatchEvent(new PageTransitionEvent("pageshow", {persisted: true}));
      return document.body.dataset.link;
    }""")
    assert link == "lost"
    expect(page.locator(LIVE)).to_be_attached()
