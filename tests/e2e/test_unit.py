"""The page of a unit: the cause first, and all that an operator needs in the window."""

from __future__ import annotations

from typing import Any

import pytest
from playwright.sync_api import expect

from tests.e2e.conftest import OpensPages
from tests.e2e.pages import opened
from tests.e2e.site import Site
from tests.sizes import sizes

PANEL, PHONE = {"width": 1280, "height": 800}, {"width": 360, "height": 800}
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


@pytest.mark.parametrize("size", [PANEL, PHONE], ids=["panel", "phone"])
def test_what_an_operator_needs_is_in_the_window(shared_page: OpensPages, size: Any) -> None:
    page = opened(shared_page(viewport=size), "/units/line/3")
    parts = {part: page.locator(part).evaluate(COVERED) for part in PARTS[size["width"]]}
    assert {part: why for part, why in parts.items() if why} == {}


SMALL, LOW = {"width": 360, "height": 640}, {"width": 640, "height": 400}
"""LOW is the panel at 200 %."""


@pytest.mark.parametrize(
    ("path", "size"), sizes(("/units/line/3", LOW), ("/units/line/3", SMALL), ("/setpoints", LOW))
)
def test_a_small_window_opens_at_the_head_of_the_page_and_leaves_it_half(
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


@pytest.mark.soak
def test_a_stopped_unit_names_its_broken_rung_and_an_alarm_one_press_from_its_response(
    site: Site, shared_page: OpensPages
) -> None:
    page = opened(shared_page(viewport=PANEL), "/units/line/2")
    site.line.remote.do("input", unit=2, input="estop", on=True)
    try:
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
    finally:
        site.line.remote.do("input", unit=2, input="estop", on=False)


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
