"""One condition has one priority wherever it is shown: verdict, tile, faceplate, unit page, alarms, head,
wallboard."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from playwright.sync_api import Locator, Page, expect

from tests.e2e.conftest import OpensPages
from tests.e2e.limits import UNIT_MS
from tests.e2e.pages import PANEL, opened
from tests.e2e.site import AT_REST, NO_TENSION_ALARM, Site

UNIT = 3


@pytest.fixture(scope="module")
def site(line_server: Callable[..., Site]) -> Site:
    """Four units of which only one is ever abnormal, for one reason."""
    return line_server(4, line_options=AT_REST, toml=NO_TENSION_ALARM)


def priority(place: Locator) -> str:
    """The first word of a mark: its others are the state of the alarm."""
    return (place.get_attribute("data-is") or "").split(" ")[0]


def priorities(page: Page) -> dict[str, str]:
    """The priority of the one abnormal unit, by surface."""
    shown = {}
    opened(page, "/?view=tiles")
    tile = page.locator(f'[data-unit="line/{UNIT}"]').first
    expect(tile.locator(".alarm-priority")).not_to_have_attribute("data-is", "", timeout=UNIT_MS)
    shown["tile"] = priority(tile.locator(".alarm-priority"))
    shown["condition of the tile"] = priority(tile.locator("[data-live-is$='.level']").first)
    shown["verdict"] = priority(page.locator("[data-live-is='line_summary.level']").first)
    shown["head"] = priority(page.locator(".top__alarm"))
    tile.click()
    shown["faceplate"] = priority(page.locator(".faceplate__alarm").first)
    opened(page, f"/units/line/{UNIT}")
    shown["unit page"] = priority(page.locator(".alarm-words").first)
    page.goto("/alarms")
    shown["list of alarms"] = priority(page.locator(f'[id^="alarm-line.{UNIT}."] .alarm-priority').first)
    page.goto("/wallboard")
    section = page.locator(f'.section[data-unit="line/{UNIT}"]')
    expect(section).not_to_have_attribute("data-is", "")
    shown["section of the wallboard"] = priority(section)
    shown["verdict of the wallboard"] = priority(page.locator(".wall__verdict"))
    return shown


@pytest.mark.soak
@pytest.mark.parametrize(
    ("begin", "end"),
    [
        (
            {"action": "input", "unit": UNIT, "input": "estop", "on": True},
            {"action": "input", "unit": UNIT, "input": "estop", "on": False},
        ),
        ({"action": "fault", "unit": UNIT, "kind": "dead", "rate": 1}, {"action": "clear"}),
        ({"action": "mode", "unit": UNIT, "to": "local"}, {"action": "mode", "unit": UNIT, "to": "remote"}),
    ],
    ids=["emergency stop", "no response", "LOCAL"],
)
def test_a_condition_has_one_priority_wherever_it_is_shown(
    site: Site, browser_page: OpensPages, begin: dict[str, Any], end: dict[str, Any]
) -> None:
    page = browser_page("operator", viewport=PANEL)
    site.line.remote.do(**begin)
    try:
        shown = priorities(page)
        verdicts = {shown.pop(name) for name in ("verdict", "verdict of the wallboard")}
        assert len(set(shown.values())) == 1, shown
        [level] = set(shown.values())
        assert level, shown
        assert verdicts == {"" if level == "low" else level}, "one of low priority takes no verdict"
    finally:
        site.line.remote.do(**end)
        site.end_alarms()


COLORS = """section => ["urgent", "high", "medium"].map(level => {
  section.dataset.is = level;
  const token = Object.assign(document.createElement("i"), { style: `color: var(--${level})` });
  section.append(token);
  const roll = section.querySelector(".section__roll");
  const colors = [getComputedStyle(roll).borderTopColor, getComputedStyle(token).color];
  token.remove();
  return colors;
})"""
NUMBERS = """section => ["high", ""].map(alarm => {
  section.dataset.is = "high";
  const shape = section.querySelector(".shape");
  shape.dataset.is = alarm;
  const { content, position } = getComputedStyle(shape, "::after");
  return [content, position];
})"""
"""The number in the shape, which lies over the color only with a position; with an alarm and without."""


@pytest.mark.soak
def test_a_priority_has_its_color_on_the_wallboard(site: Site, shared_page: OpensPages) -> None:
    """The roll of a section is in the color that the priority has in the list of alarms; one of low priority
    has none at this distance."""
    page = shared_page("operator", site=site, viewport=PANEL)
    page.goto("/wallboard")
    found = page.locator(f'.section[data-unit="line/{UNIT}"]').evaluate(COLORS)
    assert [drawn for drawn, _ in found] == [stated for _, stated in found]
    assert len({drawn for drawn, _ in found}) == len(found)
    numbers = page.locator(f'.section[data-unit="line/{UNIT}"]').evaluate(NUMBERS)
    assert numbers == [['"2"', "relative"], ["none", "static"]]
