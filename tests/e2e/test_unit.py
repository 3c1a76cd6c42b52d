"""The page of a unit: the cause first, and all that an operator needs in the window; what undo offers; and a
second tap within a second, which does nothing.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import pytest
from playwright.sync_api import Locator, Page, ViewportSize, expect

from tests.e2e.conftest import TOO_WIDE, OpensPages
from tests.e2e.pages import FITTED, PANEL, opened
from tests.e2e.site import Site, eventually
from tests.sizes import sizes

PHONE: ViewportSize = {"width": 360, "height": 800}
PARTS = {
    1280: [
        *(".cause", ".plate__now", ".plate__ladder", ".plate__set", ".plate__trend", ".plate__inputs"),
        ".plate__outputs",
    ],
    360: [".cause", ".plate__speed", ".ladder", ".plate__dock .button"],
}
COVERED = """part => {
  const { left, right, top, bottom } = part.getBoundingClientRect();
  if (top < 0 || bottom > innerHeight) return `${top} to ${bottom} of ${innerHeight}`;
  const hit = document.elementFromPoint((left + right) / 2, bottom - 3);
  return part.contains(hit) ? "" : hit?.outerHTML.slice(0, 90);
}"""
"""What lies over the end of a part, or how far it is out of the window; empty where it is seen to its end."""
ENDS = "each => each.map(part => part.getBoundingClientRect().bottom)"
STRIPS_PX = 56 + 24
"""Of the change tray below, and of a simulated line above the page: each may be there or not."""

SMALL, LOW = {"width": 360, "height": 640}, {"width": 640, "height": 400}
"""LOW is the panel at 200 %."""


def test_what_an_operator_needs_is_in_the_window(shared_page: OpensPages) -> None:
    page = opened(shared_page(viewport=PANEL), "/units/line/3")
    for size in (PANEL, PHONE):
        page.set_viewport_size(size)
        page.evaluate(FITTED)
        parts = {part: page.locator(part).evaluate(COVERED) for part in PARTS[size["width"]]}
        assert {part: why for part, why in parts.items() if why} == {}
        if size == PANEL:
            ends = page.locator(".plate__set, .plate__outputs").evaluate_all(ENDS)
            assert max(ends) <= PANEL["height"] - STRIPS_PX


@pytest.mark.parametrize(
    ("path", "size"),
    sizes(("/units/line/3", LOW), ("/units/line/3", SMALL), ("/setpoints", LOW), ("/", LOW)),
)
def test_a_small_window_opens_at_the_head_of_the_page_leaves_it_half_and_loses_nothing(
    shared_page: OpensPages, path: str, size: Any
) -> None:
    page = opened(shared_page(viewport=size), path)
    assert page.evaluate("scrollY") == 0
    top, end = page.evaluate(
        """[document.querySelector(".top").getBoundingClientRect().bottom,
            Math.min(...[...document.querySelectorAll(".rail, .plate__dock, .setpoints__act")]
              .filter(bar => bar.matches(".rail") || getComputedStyle(bar).position === "sticky")
              .map(bar => bar.getBoundingClientRect().top))]"""
    )
    assert end - top >= size["height"] / 2
    assert not page.evaluate(TOO_WIDE)


@pytest.mark.soak
def test_a_stopped_unit_names_its_broken_rung_and_an_alarm_one_press_from_its_response(
    site: Site, shared_page: OpensPages
) -> None:
    page = opened(shared_page(viewport=PANEL), "/units/line/2")
    with site.line.stopped(2):
        expect(page.locator(".ladder")).to_have_attribute("data-is", "e-stop urgent")
        expect(page.locator(".ladder__broken:visible")).to_have_count(1)
        expect(page.locator(".cause")).to_contain_text("Stopped: emergency stop active")
        expect(page.locator(".cause")).to_contain_text("Check the emergency stop chain")
        alarm = page.locator(".cause > .alarm-words")
        expect(alarm).to_contain_text("active since")
        box = alarm.bounding_box()
        assert box is not None
        assert box["height"] >= 48
        alarm.click()
        expect(page.get_by_text("Go to the machine, find the reason")).to_be_visible()


def test_a_speed_is_set_by_three_presses_and_the_number_with_nothing_to_close(
    site: Site, shared_page: OpensPages
) -> None:
    page = opened(shared_page(viewport=PHONE), "/units/line/4")
    presses = 0

    def press(selector: str) -> None:
        nonlocal presses
        page.locator(selector).click()
        presses += 1

    press(".plate__dock .button")
    for key in "93.5":
        page.locator(f'.pad [data-pad="{key}"]').click()
    press("button[value=now]")
    expect(page.locator("dialog[open]")).to_have_count(0)
    press("#set-review [data-review-act]")
    expect(page.locator("#setpoint-error [data-review-done=good]")).to_be_in_viewport(ratio=1)
    expect(page.locator("[data-review]")).to_have_count(0)
    assert (presses, site.unit(4)["commanded"]) == (3, "93.5")


# --- undo offers the value before the command that it follows, or is not offered ----------------------

UNIT = 8


@pytest.fixture
def unit_page(site: Site, shared_page: OpensPages) -> Page:
    """The page of a unit at 115.0."""
    site.set_speed(UNIT, value="115.0")
    found = shared_page(viewport=PANEL)
    found.goto(f"{site.url}/units/line/{UNIT}")
    expect(found.locator("body")).to_have_attribute("data-link", "live")
    expect(found.locator("#setpoint")).to_have_value("115.0")
    return found


@pytest.fixture
def page(unit_page: Page) -> Page:
    """The page of the unit set to 111.0, with the way back to 115.0 on it."""
    unit_page.locator("#setpoint").fill("111.0")
    send(unit_page, "Set now")
    expect(undo(unit_page)).to_have_text("Undo: set 115.0…")
    return unit_page


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


def test_what_was_typed_is_a_draft_on_the_next_page_until_it_is_staged(site: Site, unit_page: Page) -> None:
    unit_page.locator("#setpoint").fill("66.6")
    unit_page.goto("/alarms")
    unit_page.goto(f"/units/line/{UNIT}")
    expect(unit_page.locator("[data-draft]")).to_contain_text("not sent")
    expect(unit_page.locator("#setpoint")).to_have_value("66.6")
    unit_page.get_by_role("button", name="Discard draft").click()
    expect(unit_page.locator("#setpoint")).not_to_have_value("66.6")
    step, before = unit_page.locator(".nudges button").first, site.writes()
    unit_page.locator("#setpoint").fill(f"{66.6 - float(step.inner_text()):.1f}")
    step.click()  # of what is typed
    expect(unit_page.locator("#setpoint")).to_have_value("66.6")
    assert site.writes() == before
    unit_page.get_by_role("button", name="Stage…").click()
    unit_page.locator("[data-review-act]").click()
    expect(unit_page.locator("[data-review-done=good]")).to_be_visible()
    assert site.unit(UNIT)["staged"] == "66.6"
    unit_page.goto("/alarms")
    unit_page.goto(f"/units/line/{UNIT}")
    expect(unit_page.locator("#setpoint")).not_to_have_value("66.6")
    expect(unit_page.locator("[data-draft]")).to_have_count(0)
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


# --- a second tap; the time of the page is the test's -------------------------------------------------

CLOCK = """const real = Date.now;
Date.now = () => Number(sessionStorage.getItem("test-now") ?? real());
Object.defineProperty(performance, "timeOrigin", { get: Date.now });
Object.defineProperty(Event.prototype, "timeStamp", { get: () => 0 });"""
TAPPED = 7


@pytest.fixture
def still_page(site: Site, browser_page: OpensPages) -> Page:
    """The page of a unit, on which no time passes."""
    site.set_speed(TAPPED, value="100.0")
    found = browser_page(viewport=PANEL, taps=True)
    found.add_init_script(CLOCK)
    found.goto(f"{site.url}/units/line/{TAPPED}")
    expect(found.locator("body[data-link=live]")).to_be_attached()
    expect(found.locator("#setpoint")).to_have_value("100.0")
    found.evaluate("sessionStorage.setItem('test-now', Date.now())")
    return found


@pytest.fixture
def step(still_page: Page) -> Locator:
    return still_page.get_by_role("button", name="Up by 0.2")


def let_pass(page: Page, ms: int) -> None:
    # A press is dropped while the response to the one before is on its way.
    expect(page.locator(".htmx-request")).to_have_count(0)
    page.evaluate("ms => sessionStorage.setItem('test-now', Date.now() + ms)", ms)


def commanded(site: Site) -> str:
    found: str = site.unit(TAPPED)["commanded"]
    return found


def test_a_second_tap_does_not_confirm_what_the_first_one_opened(site: Site, still_page: Page) -> None:
    still_page.locator("#setpoint").fill("110.0")
    still_page.get_by_role("button", name="Set now").click()
    act = still_page.locator("[data-review-act]")
    expect(act).to_be_visible()
    place = still_page.get_by_role("button", name="Set now", include_hidden=True).bounding_box()
    assert place is not None
    x, y = place["x"] + place["width"] / 2, place["y"] + place["height"] / 2
    act.evaluate(
        """(act, [x, y]) => {
            const { left, top, width, height } = act.getBoundingClientRect();
            act.style.translate = `${x - left - width / 2}px ${y - top - height / 2}px`;
        }""",
        [x, y],
    )
    still_page.mouse.click(x, y)
    expect(act).to_be_visible()
    expect(still_page.locator("[data-pending]")).to_have_count(0)
    let_pass(still_page, 1000)
    still_page.mouse.click(x, y)
    expect(still_page.locator("[data-review-done=good]")).to_be_visible()
    assert commanded(site) == "110.0"


@pytest.fixture
def stopped(site: Site) -> Iterator[str]:
    """The id of an alarm to acknowledge."""
    site.line.remote.do("input", unit=TAPPED, input="estop", on=True)
    with site.api() as client:
        query = {"unit": TAPPED, "state": "unack_active"}

        def found() -> list[str]:
            alarms = client.get("/alarms", params=query).json()["alarms"]
            return [alarm["id"] for alarm in alarms if alarm["code"] == "estop_active"]

        yield eventually(found, "an alarm")[0]
        site.line.remote.do("input", unit=TAPPED, input="estop", on=False)
        eventually(
            lambda: client.get("/alarms", params=query | {"state": "normal"}).json()["alarms"], "normal"
        )


@pytest.mark.soak
def test_a_second_tap_presses_nothing_on_the_page_that_the_first_one_opened(
    site: Site, still_page: Page, stopped: str
) -> None:
    still_page.goto(f"{site.url}/alarms/{stopped}")
    place = still_page.locator("main").get_by_role("button", name="Acknowledge alarm").bounding_box()
    assert place is not None
    x, y = place["x"] + 20, place["y"] + 20
    still_page.mouse.click(x, y)
    expect(still_page).to_have_url(re.compile(r"/alarms(\?.*)?$"))
    still_page.evaluate(
        """([x, y]) => {
            const button = document.createElement("button");
            button.style.cssText = `position: fixed; z-index: 99; left: ${x - 50}px; top: ${y - 50}px;
                width: 100px; height: 100px`;
            button.addEventListener("click", () => (button.dataset.pressed = ""));
            button.id = "under-the-finger";
            document.body.append(button);
        }""",
        [x, y],
    )
    under = still_page.locator("#under-the-finger")
    still_page.mouse.click(x, y)
    expect(under).not_to_have_attribute("data-pressed", "")
    let_pass(still_page, 1000)
    still_page.mouse.click(x, y)
    expect(under).to_have_attribute("data-pressed", "")
