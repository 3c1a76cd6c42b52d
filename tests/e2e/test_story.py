"""The line while its story of faults runs: nothing moves, and what is read aloud is in order."""

from __future__ import annotations

import re
from collections.abc import Callable
from itertools import product
from typing import Any

import pytest
from playwright.sync_api import Page, expect

from tests.e2e.conftest import ENGLISH, GERMAN, OpensPages
from tests.e2e.pages import PANEL, PHONE, count_shifts, opened, shifts
from tests.e2e.site import AT_REST, NO_TENSION_ALARM, Site, eventually
from tests.sizes import in_turn

SPOKEN = """root => {
  const seen = { visibilityProperty: true };
  const hidden = (each) => each.closest("[aria-hidden=true]") || !each.checkVisibility(seen);
  const texts = [];
  const walk = document.createTreeWalker(document.querySelector(root), NodeFilter.SHOW_TEXT);
  while (walk.nextNode()) {
    const text = walk.currentNode.data.replace(/\\s+/g, " ").trim();
    if (text && !hidden(walk.currentNode.parentElement)) texts.push(text);
  }
  return texts;
}"""
"""What a screen reader reads of a part of the page, in this order."""
EMPTY_STOPS = """() => [...document.querySelectorAll(
  "a[href], button, input, select, textarea, summary, [tabindex]")]
  .filter((each) => each.tabIndex >= 0 && each.checkVisibility({ visibilityProperty: true }))
  .filter((each) => !(each.ariaLabel || each.title || each.innerText?.trim() || each.labels?.length
    || each.querySelector(".visually-hidden")))
  .map((each) => each.outerHTML.slice(0, 160))"""
COUNTED_DOWN = """() => [...document.querySelectorAll(
  ":is([aria-live=polite], [role=status], [role=alert]) :is([data-until], [data-age], [data-clock])"
)].map((each) => each.outerHTML.slice(0, 160))"""
"""What changes by time alone, inside of what is announced."""


@pytest.fixture(scope="module")
def site(line_server: Callable[..., Site]) -> Site:
    """Eight units whose only alarms are those of the test."""
    return line_server(8, line_options=AT_REST, toml=NO_TENSION_ALARM)


def is_shown(page: Page, unit: int, level: str) -> None:
    expect(page.locator(f'[data-unit="line/{unit}"]').first).to_have_attribute("data-is", level)


@pytest.mark.parametrize(
    ("shown", "locale"),
    in_turn(list(product(("/", "/?view=rows"), (PANEL, PHONE))), (ENGLISH, GERMAN), first=2),
)
def test_nothing_moves_while_the_story_runs(
    site: Site, shared_page: OpensPages, shown: tuple[str, Any], locale: str
) -> None:
    site.end_alarms()
    path, size = shown
    page = opened(shared_page("operator", viewport=size, locale=locale), path)
    page.wait_for_load_state("networkidle")
    count_shifts(page, sides=("left", "top"))
    remote = site.line.remote
    try:
        remote.do("input", unit=2, input="estop", on=True)
        is_shown(page, 2, "urgent")
        remote.do("input", unit=5, input="run", on=False)
        is_shown(page, 5, "high")
        remote.do("mode", unit=7, to="local")
        is_shown(page, 7, "low")
        expect(page.locator(".top__alarm")).to_have_attribute("data-is", "urgent waiting")
        site.acknowledge_all()
        expect(page.locator(".top__alarm")).to_have_attribute("data-is", "urgent")
        silent = page.locator('[data-unit="line/6"]').first
        remote.do("fault", kind="dead", rate=1, unit=6)
        expect(silent).to_have_attribute("data-quality", re.compile("stale|offline"))
        remote.do("clear")
        expect(silent).to_have_attribute("data-quality", "online")
        if size == PANEL:
            page.locator('[data-unit="line/4"] [data-faceplate]').click()
            expect(page.locator("#faceplate-name")).to_be_visible()
            page.keyboard.press("Escape")
            expect(page.locator("#faceplate")).to_be_hidden()
    finally:
        remote.do("clear")
        remote.do("input", unit=2, input="estop", on=False)
        remote.do("input", unit=5, input="run", on=True)
        remote.do("mode", unit=7, to="remote")
    for unit in (2, 5, 7):
        is_shown(page, unit, "")
    assert shifts(page) == []


TOUCHING = """() => {
  const pressed = "a[href], button, input:not([type=hidden]), select, summary, label.check";
  const at_edge = ".top, .rail, .tray, .setpoints__act, .plate__dock, [inert], .skip, .gone, .check > input";
  const boxes = [...document.querySelectorAll(pressed)]
    .filter((each) => each.checkVisibility({ visibilityProperty: true }) && !each.closest(at_edge))
    .map((each) => [each, (each.matches("[data-faceplate]") && each.closest(".tile")) || each])
    .map(([each, whole]) => [each, whole.getBoundingClientRect()]).filter(([, box]) => box.width > 1);
  const near = [];
  for (const [one, a] of boxes) for (const [other, b] of boxes) {
    if (one === other || one.compareDocumentPosition(other) & 2) continue;
    const apart = Math.max(a.left - b.right, b.left - a.right, a.top - b.bottom, b.top - a.bottom);
    // A target over another, as the alarm of a tile, is no neighbor of it.
    if (apart > -1 && apart < 4) near.push([one.outerHTML.slice(0, 90), other.outerHTML.slice(0, 90), apart]);
  }
  return near;
}"""
"""What can be pressed less than 4 px beside something else; the bars at the edges, under which a page moves,
do not count."""


def test_eight_units_and_the_verdict_are_in_the_first_screen_of_a_phone_and_no_targets_touch(
    site: Site, shared_page: OpensPages
) -> None:
    page = opened(shared_page("operator", viewport=PHONE, locale=GERMAN, has_touch=True, is_mobile=True), "/")
    site.line.remote.do("input", unit=2, input="estop", on=True)
    try:
        is_shown(page, 2, "urgent")
        verdict = page.locator(".well__verdict > a")
        expect(verdict).to_contain_text(re.compile(r"\d\d:\d\d"))
        lines = verdict.evaluate(
            "each => each.getBoundingClientRect().height / parseFloat(getComputedStyle(each).lineHeight)"
        )
        assert round(lines) <= 2
        for tile in page.locator(".tile").all():
            expect(tile).to_be_in_viewport(ratio=1)
        assert page.evaluate(TOUCHING) == []
        page.locator('[data-unit="line/1"] [data-faceplate]').click()
        expect(page.locator(".faceplate .setter__now")).to_be_in_viewport(ratio=1)
        for path in ("/units/line/2", "/setpoints", "/alarms"):
            opened(page, path)
            expect(page.locator(".top__alarm")).to_have_attribute("data-is", re.compile("urgent"))
            assert page.evaluate(TOUCHING) == [], path
    finally:
        site.line.remote.do("input", unit=2, input="estop", on=False)
        site.end_alarms()


def test_what_is_read_aloud_of_the_line_and_the_alarms_is_in_order(
    site: Site, shared_page: OpensPages
) -> None:
    site.end_alarms()
    # Of the second unit it has come so often by now that it chatters.
    site.line.remote.do("input", unit=3, input="estop", on=True)
    try:
        page = opened(shared_page("operator", viewport=PANEL), "/?view=tiles")
        expect(page.locator(".well__verdict")).to_contain_text("Stopped")
        head = page.evaluate(SPOKEN, ".top")
        assert head[1:3] == ["1 alarm active", "1 to acknowledge"]
        overview = page.evaluate(SPOKEN, ".overview")
        assert overview[0] == "Coater"
        cause, since = re.fullmatch(r"· (.+) (since \d\d:\d\d)", overview[1]).groups()  # type: ignore[union-attr]
        assert cause == "Stopped: emergency stop active"
        brief = cause.removesuffix(" active")
        assert [text for text in overview if not text.isdigit()][2:7] == [
            *("abnormal", "/8", "live", "at speed", "ramping"),
        ]
        tile = page.evaluate(SPOKEN, '.tile[data-unit="line/3"]')
        # What is so stands at the unit, since when in the verdict: each time is on the page once.
        assert tile[:5] == ["3", "Coater", "REMOTE", "Coater:", "Emergency stop, urgent"]
        assert tile[5:8] == ["actual", "0.0", brief]
        assert sum(since in text for text in page.evaluate(SPOKEN, ".main")) == 1
        assert tile[8:11] == ["setpoint", "120.0", "m/min"]
        link = page.locator('.tile[data-unit="line/3"] .tile__alarm')
        expect(link).to_have_accessible_name("Coater: Emergency stop, urgent")
        is_announced_in_order(page)
        opened(page, "/alarms")
        row = page.evaluate(SPOKEN, "#alarms tbody tr")
        assert row[:4] == ["urgent", "Emergency stop", "Coater", "active, not acknowledged"]
        assert row[-1] == "Acknowledge"
        is_announced_in_order(page)
    finally:
        site.line.remote.do("input", unit=3, input="estop", on=False)
        eventually(lambda: site.unit(3)["inputs"]["estop"] is False, "the end of the e-stop")
        site.end_alarms()


HEADINGS_AND_CONTROLS = """root => [...document.querySelectorAll(
  `${root} :is(h1, h2, h3, a[href], button, input:not([type=hidden]), select, summary)`)]
  .filter((each) => each.checkVisibility({ visibilityProperty: true }))
  .map((each) => each.ariaLabel || each.labels?.[0]?.textContent || each.textContent)
  .map((text) => text.replace(/\\s+/g, " ").trim())"""
"""What a part of the page is passed through by, in this order."""


def test_what_is_read_aloud_of_the_other_pages_of_an_operator_is_in_order(
    site: Site, shared_page: OpensPages
) -> None:
    site.end_alarms()
    site.line.remote.do("input", unit=4, input="estop", on=True)
    site.line.remote.do("mode", unit=7, to="local")
    try:
        page = opened(shared_page("operator", viewport=PANEL), "/units/line/4")
        expect(page.locator(".cause")).to_contain_text("Stopped: emergency stop active")
        expect(page.locator(".cause .alarm-words")).to_contain_text("Emergency stop")
        head = page.locator(".top__verdict .verdict__cause")
        expect(head).to_have_text("· Stopped: emergency stop active")  # the alarm below has the time
        expect(page.locator("#setpoint")).not_to_have_value("")
        steps = page.evaluate(HEADINGS_AND_CONTROLS, ".main")
        name, before, after = (site.unit(unit)["name"] for unit in (4, 3, 5))
        assert steps[:3] == [before, f"4 {name}", after]
        assert steps[3:8] == ["Overview", "Parameters", "Trends", "Events", "Write note"]
        assert re.fullmatch(r"Emergency stop ?active since \d\d:\d\d", steps[8])
        assert steps[9:11] == [f"{name} · Setpoint", "New setpoint"]
        assert steps[11:23] == [*"789456123", "Decimal sign", "0", "Erase"]
        assert [text[:3] for text in steps[23:27]] == ["Up ", "Up ", "Dow", "Dow"]
        assert steps[27:32] == ["Set now…", "Add to tray", "Stage…", "Execute staged…", "Outputs"]
        parts = ["The last ten minutes", "Inputs", "Analog", "Golden set"]
        assert [text for text in steps[32:] if text in parts] == [parts[0], *parts]
        said = page.evaluate(SPOKEN, ".main")
        cause = said.index("Stopped: emergency stop active")  # and its alarm has the time
        assert said[cause + 1] == "Check the emergency stop chain of this unit"
        assert said.index("actual") < said.index("setpoint") < said.index("E-stop") < said.index("Setpoint")
        is_announced_in_order(page)

        opened(page, "/setpoints")
        expect(page.locator("[data-unit='line/7'] .by-mode__not")).to_be_visible()
        together = page.evaluate(HEADINGS_AND_CONTROLS, ".main")[:10]
        assert together[0] == "Setpoints"
        assert together[1] == "Select all"
        assert [text[1:] for text in together[2:6]] == [f"{n} % of each own setpoint" for n in (5, 1, 1, 5)]
        assert together[6:] == ["What to enter", "Value for all selected", "Enter values", "Clear values"]
        assert page.evaluate(HEADINGS_AND_CONTROLS, ".setpoints tbody tr:nth-child(2)") == [
            *(site.unit(2)["name"],) * 2,
            f"New setpoint of {site.unit(2)['name']}",
        ]
        row = page.evaluate(SPOKEN, ".setpoints tbody tr:nth-child(7)")
        assert (row[:2], row[-1], "LOCAL" in row) == (["7", site.unit(7)["name"]], "not in REMOTE", True)
        assert page.evaluate(HEADINGS_AND_CONTROLS, ".setpoints__act") == [
            "Add to tray",
            "Review the change…",
        ]
        is_announced_in_order(page)

        opened(page, "/?view=tiles")
        page.locator('[data-unit="line/4"] [data-faceplate]').click()
        expect(page.locator("#faceplate .faceplate__alarm")).to_be_visible()
        said = page.evaluate(SPOKEN, "#faceplate")
        assert said[0] == name
        assert said[1] == "Stopped: emergency stop active"
        assert said[2] == "REMOTE"
        in_order = [
            *["Check the emergency stop chain of this unit", "actual", "setpoint", "deviation", "Setpoint"],
            *["New setpoint", "Set now…", "Add to tray", "E-stop input active", "Emergency stop"],
        ]
        places = [said.index(text) for text in in_order]
        assert places == sorted(places)
        is_announced_in_order(page)

        opened(page, "/wallboard")
        said = page.evaluate(SPOKEN, ".main")
        assert said[:3] == ["line", "urgent", name]
        assert said[3].startswith("Stopped: emergency stop active since")
        section = page.evaluate(SPOKEN, ".section:nth-child(2)")
        assert section[0] == site.unit(2)["name"]
        assert section[-2] == "speed"
        assert re.fullmatch(r"\d+\.\d", section[-1])
        # Where a section stands there is no draw, and no word of one.
        assert page.evaluate(SPOKEN, ".section:nth-child(4)") == [name, "speed", "0.0"]
        facts = [
            text for text in said if text in ("Speed of the first unit", "Recipe", "Alarms", "Last event")
        ]
        assert facts == ["Speed of the first unit", "Recipe", "Alarms", "Last event"]
        is_announced_in_order(page)

        opened(page, "/lines")
        said = page.evaluate(SPOKEN, ".main")
        assert said[:5] == ["Lines", "1 line, the worst first", "line", "urgent", name]
        assert said[5].startswith("Stopped: emergency stop active since")
        assert said[6] == "Speed of the first unit:"
        assert re.fullmatch(r"\d alarms? active · \d to acknowledge", said[10])
        is_announced_in_order(page)
    finally:
        site.line.remote.do("input", unit=4, input="estop", on=False)
        site.line.remote.do("mode", unit=7, to="remote")
        site.end_alarms()


def is_announced_in_order(page: Page) -> None:
    """No stop of the tabulator is empty, and nothing that time alone changes is announced."""
    assert page.evaluate(EMPTY_STOPS) == []
    assert page.evaluate(COUNTED_DOWN) == []
